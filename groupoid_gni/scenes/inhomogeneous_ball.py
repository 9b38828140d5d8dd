"""The inhomogeneous (Chaplygin) ball on a rotating table, section 7.4.2, without a chart."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import ArrayLike
from groupoid_gni.groupoids import SO3, Cayley, FramedPairGroupoid, Retraction, VectorGroup
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.systems import MechanicalSystem


def inhomogeneous_ball(
    mass: float = 2.0,
    radius: float = 1.0,
    inertia: ArrayLike = (1.0, 0.5, 0.7),
    table: float = 1.0,
    position: ArrayLike = (1.0, 0.0),
    velocity: ArrayLike = (0.0, 0.75),
    attitude: ArrayLike | None = None,
    vertical_spin: float = 0.0,
    retraction: Retraction | None = None,
) -> Scene:
    """Ball with three principal moments on R^2 x SO(3) in the body frame; no chart, no singularity.

    inertia : principal moments (I_1, I_2, I_3).  attitude : rotation matrix; exp(0.5, 0.5, 0.5) of
    Figure 3 when left out.  The base point is (x, y, R row by row), the velocity (x', y', Omega)
    with Omega in the body frame; the constraints (41) use the space angular velocity R Omega.
    Defaults are those of Figure 3, left. Nothing is left out: the constraint depends on R.
    """
    group = SO3(retraction=Cayley() if retraction is None else retraction)
    system = MechanicalSystem(
        FramedPairGroupoid(VectorGroup(2), group),
        metric=lambda x, p: np.diag([p.m, p.m, p.I[0], p.I[1], p.I[2]]),
        constraints=lambda x, p: np.array(
            [
                [1.0, 0.0, -p.r * x[5], -p.r * x[6], -p.r * x[7]],
                [0.0, 1.0, p.r * x[2], p.r * x[3], p.r * x[4]],
            ]
        ),
        drift=lambda x, p: np.array([-p.Theta * x[1], p.Theta * x[0], 0.0, 0.0, 0.0]),
        parameters={"m": mass, "r": radius, "I": np.asarray(inertia), "Theta": table},
    )
    place, speed = np.array(position, dtype=float), np.array(velocity, dtype=float)
    rotation = group.exp(np.full(3, 0.5)) if attitude is None else np.array(attitude, dtype=float)
    omega = np.array(
        [
            (table * place[0] - speed[1]) / radius,
            (table * place[1] + speed[0]) / radius,
            vertical_spin,
        ]
    )
    base = np.concatenate([place, np.ravel(rotation)])
    start = system.state(base, np.concatenate([speed, rotation.T @ omega]))
    return Scene(
        system,
        start,
        "inhomogeneous ball on a rotating table, on R^2 x SO(3) in the body frame",
    )
