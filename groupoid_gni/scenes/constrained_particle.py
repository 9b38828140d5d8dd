"""The constrained particle: z' = y x', the smallest nonholonomic system."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.groupoids import AtiyahGroupoid, VectorGroup
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import MechanicalSystem, Parameters


def constrained_particle(
    mass: float = 1.0,
    spring_x: float = 0.0,
    spring_y: float = 0.0,
    position: ArrayLike = (0.0, 0.5),
    velocity: ArrayLike = (1.0, 0.8),
) -> Scene:
    """Particle in R^3 with z' = y x', reduced by the translations that change nothing.

    ``L = m/2 (x'^2 + y'^2 + z'^2) - (k_x x^2 + k_y y^2)/2``.

    spring_x, spring_y : stiffnesses k_x, k_y; without springs this is the free particle.
    position, velocity : (x, y) and (x', y') at the start, shape (2,); z' = y x' follows.

    Base (y), velocity (y', x', z'), on R x R x R^2. Left out: x and z, as pose (x, z); with a
    spring along x the base is (y, x) and only z is left out. ``reconstruct`` gives them back.

    Exact without a spring along x: y is free or harmonic, and ``J = x' sqrt(1 + y^2)`` is constant,
    since ``x'' = -y y' x' / (1 + y^2)``.
    """
    x, y = checked_numbers("position", position, (2,))
    vx, vy = checked_numbers("velocity", velocity, (2,))
    kept = 2 if spring_x else 1
    potential: Callable[[Array, Parameters], Array] | None = None
    parameters = {"m": mass}
    if spring_x:
        potential = _both_springs
        parameters.update(k_x=spring_x, k_y=spring_y)
    elif spring_y:
        potential = _spring_along_y
        parameters.update(k_y=spring_y)
    system = MechanicalSystem(
        AtiyahGroupoid(kept, VectorGroup(3 - kept)),
        metric=lambda q, p: p.m * np.eye(3),
        constraints=lambda q, p: np.array([[0.0, -q[0], 1.0]]),
        potential=potential,
        parameters=parameters,
    )
    left_out = "z" if spring_x else "x and z"
    solved = not spring_x and spring_y >= 0.0
    return Scene(
        system,
        system.state([y, x][:kept], [vy, vx, y * vx]),
        f"particle with z' = y x'; {left_out} left out (translations change nothing)",
        _exact_motion(np.sqrt(spring_y / mass), y, vx, vy) if solved else None,
    )


def _spring_along_y(q: Array, p: Parameters) -> Array:
    return p.k_y * q[0] ** 2 / 2


def _both_springs(q: Array, p: Parameters) -> Array:
    return (p.k_y * q[0] ** 2 + p.k_x * q[1] ** 2) / 2


def _exact_motion(
    frequency: float, height: float, speed_x: float, speed_y: float
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """The closed form of the docstring above, through the start."""
    kept = speed_x * np.sqrt(1.0 + height**2)

    def exact(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = np.asarray(times, dtype=float)
        turned = frequency * t
        # sin(w t) / w, also for w = 0
        along = t * np.sinc(turned / np.pi)
        y = height * np.cos(turned) + speed_y * along
        y_dot = speed_y * np.cos(turned) - height * frequency * np.sin(turned)
        x_dot = kept / np.sqrt(1.0 + y**2)
        return y[:, None], np.stack([y_dot, x_dot, y * x_dot], axis=-1)

    return exact
