"""The Chaplygin sleigh: a rigid body on a plane with one blade."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.groupoids import SE2, Cayley, Retraction
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.scenes.settling import settling_motion
from groupoid_gni.systems import MechanicalSystem


def chaplygin_sleigh(
    mass: float = 1.0,
    inertia: float = 1.0,
    offset: float = 0.3,
    spin: float = 1.5,
    speed: float = -1.0,
    retraction: Retraction | None = None,
) -> Scene:
    """Sleigh on SE(2), reduced: three body velocities (omega, v along, v across) and nothing else.

    mass, inertia : of the body, inertia about its centre of mass.
    offset : distance a of the centre of mass ahead of the blade's contact point, along the blade.
    spin, speed : omega and the speed along the blade at the start.

    Equations: ``v' = a omega^2, omega' = -m a v omega / (J + m a^2)``, v across = 0. Exact:
    with ``k = a sqrt(2 E m) / I``, ``v = V tanh(k t + c)``, ``omega = W sech(k t + c)``,
    ``V = sqrt(2E/m)``, ``W = sqrt(2E/I)``, ``I = J + m a^2``: the sleigh settles on a straight line
    with its centre of mass in front. Position and heading are left out: nothing depends on
    them, and ``reconstruct`` gives them back.
    """
    system = MechanicalSystem(
        SE2(retraction=Cayley() if retraction is None else retraction),
        metric=lambda x, p: np.array(
            [[p.J + p.m * p.a**2, 0.0, p.m * p.a], [0.0, p.m, 0.0], [p.m * p.a, 0.0, p.m]]
        ),
        constraints=[[0.0, 0.0, 1.0]],
        parameters={"m": mass, "J": inertia, "a": offset},
    )
    start = system.state(velocity=[spin, speed, 0.0])
    return Scene(
        system,
        start,
        "Chaplygin sleigh in body velocities; position and heading left out (symmetry SE(2))",
        _exact_motion(mass, inertia, offset, spin, speed) if spin and offset else None,
    )


def _exact_motion(
    mass: float, inertia: float, offset: float, spin: float, speed: float
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """The closed form of the docstring above, through the start."""
    about_blade = inertia + mass * offset**2
    # in sqrt(m) v and sqrt(I) omega the energy is a circle
    stretch, twist = np.sqrt(mass), np.sqrt(about_blade)
    rate = offset * stretch / about_blade

    def exact(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        along, omega = settling_motion(times, rate, stretch * speed, twist * spin)
        velocity = np.stack([omega / twist, along / stretch, np.zeros_like(along)], axis=-1)
        return np.zeros((len(velocity), 0)), velocity

    return exact
