"""The homogeneous ball on a rotating table, section 7.4.1."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.groupoids import SO3, AtiyahGroupoid, Cayley, Retraction
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.systems import MechanicalSystem


def rolling_ball(
    mass: float = 1.0,
    radius: float = 1.0,
    inertia: float = 2.0 / 3.0,
    table: float = 1.0,
    position: ArrayLike = (1.0, 1.0),
    velocity: ArrayLike = (1.0, 1.0),
    vertical_spin: float = 0.0,
    retraction: Retraction | None = None,
) -> Scene:
    """Ball on R^2 x R^2 x SO(3), reduced by the rotations: (x, y) and five velocities.

    inertia : the moment of inertia I about any axis through the centre.
    table : angular velocity Theta of the table about (0, 0).
    The space angular velocity is omega = (omega_1, omega_2, vertical_spin) with the first two from
    rolling, equations (41): ``x' - r omega_2 + Theta y = 0``, ``y' + r omega_1 - Theta x = 0``.

    The group is right-sided (space velocities), because the constraint is. Exact: the velocity of
    the contact point turns at the constant rate ``Theta I / (I + m r^2)``. The attitude is left
    out; ``reconstruct`` gives it back.
    """
    group = SO3(side="right", retraction=Cayley() if retraction is None else retraction)
    system = MechanicalSystem(
        AtiyahGroupoid(base_dim=2, group=group),
        metric=lambda x, p: np.diag([p.m, p.m, p.I, p.I, p.I]),
        constraints=lambda x, p: np.array(
            [[1.0, 0.0, 0.0, -p.r, 0.0], [0.0, 1.0, p.r, 0.0, 0.0]]
        ),
        drift=lambda x, p: np.array([-p.Theta * x[1], p.Theta * x[0], 0.0, 0.0, 0.0]),
        parameters={"m": mass, "r": radius, "I": inertia, "Theta": table},
    )
    place, speed = np.array(position, dtype=float), np.array(velocity, dtype=float)

    def spin(q: FloatArray, v: FloatArray) -> FloatArray:
        first = (table * q[..., 0] - v[..., 1]) / radius
        second = (table * q[..., 1] + v[..., 0]) / radius
        return np.stack([first, second, np.full_like(first, vertical_spin)], axis=-1)

    start = system.state(place, np.concatenate([speed, spin(place, speed)]))
    rate = table * inertia / (inertia + mass * radius**2)

    def exact(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(times, dtype=float)[:, None]
        turned = np.array([-speed[1], speed[0]])
        v = speed * np.cos(rate * t) + turned * np.sin(rate * t)
        # sin(rate t)/rate and (1 - cos(rate t))/rate, also for a table at rest
        along = t * np.sinc(rate * t / np.pi)
        across = 0.5 * rate * (t * np.sinc(rate * t / (2.0 * np.pi))) ** 2
        q = place + speed * along + turned * across
        return q, np.concatenate([v, spin(q, v)], axis=-1)

    return Scene(
        system,
        start,
        "homogeneous ball on a rotating table, reduced by SO(3); attitude left out",
        exact,
    )
