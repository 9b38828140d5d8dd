"""The inhomogeneous ball in the chart (x, y, rho), R = exp(rho): section 7.4.2 as printed."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, Exponential, PairGroupoid
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import MechanicalSystem

_SINGULAR = 1e-12
"""Smallest determinant of dexp allowed at the start; it is 1 at rho = 0."""


def inhomogeneous_ball_in_a_chart(
    mass: float = 2.0,
    radius: float = 1.0,
    inertia: ArrayLike = (1.0, 0.5, 0.7),
    table: float = 1.0,
    position: ArrayLike = (1.0, 0.0),
    velocity: ArrayLike = (0.0, 0.75),
    rotation_vector: ArrayLike = (0.5, 0.5, 0.5),
    vertical_spin: float = 0.0,
) -> Scene:
    """The ball of ``inhomogeneous_ball`` on R^5 x R^5, to compare with the paper and with a chart.

    rotation_vector : rho with R = exp(rho); any of the vectors that give R. The base point is
    (x, y, rho), the velocity its time derivative. With ``EulerA()`` this is what the paper ran for
    figures 3 and 4.

    All rho of length 2 pi are one and the same attitude, so metric and constraints degenerate there
    and rho turns faster the closer it comes: runs lose their digits, then stop with NEWTON_FAILED
    or CONSTRAINTS_SINGULAR, or jump past it and are wrong, with a SurprisingStepWarning where they
    are wrong by much. ``inhomogeneous_ball`` has no such place and is the one to use.

    Raises InputError for a rotation_vector of length 2 pi, 4 pi, ...
    """
    group = SO3(retraction=Exponential())

    def metric(x: Array, p: Any) -> Array:
        to_body = group.dexp(-x[2:])
        turning = to_body.T @ np.diag(p.I) @ to_body
        nothing = np.zeros((2, 3))
        return np.block([[p.m * np.eye(2), nothing], [nothing.T, turning]])

    def constraints(x: Array, p: Any) -> Array:
        to_space = group.dexp(x[2:])
        spin = np.stack([-to_space[1], to_space[0]])
        return np.concatenate([np.eye(2), p.r * spin], axis=1)

    system = MechanicalSystem(
        PairGroupoid(5),
        metric=metric,
        constraints=constraints,
        drift=lambda x, p: np.array([-p.Theta * x[1], p.Theta * x[0], 0.0, 0.0, 0.0]),
        parameters={"m": mass, "r": radius, "I": np.asarray(inertia), "Theta": table},
    )
    place = checked_numbers("position", position, (2,))
    speed = checked_numbers("velocity", velocity, (2,))
    rho = checked_numbers("rotation_vector", rotation_vector, (3,))
    if np.linalg.det(group.dexp(rho)) < _SINGULAR:
        raise InputError(
            f"rotation_vector {rho} is a whole number of turns, where the chart is singular; the "
            "same attitude is rotation_vector = 0"
        )
    omega = np.array(
        [
            (table * place[0] - speed[1]) / radius,
            (table * place[1] + speed[0]) / radius,
            vertical_spin,
        ]
    )
    rates = np.concatenate([speed, group.dexp_inverse(rho) @ omega])
    return Scene(
        system,
        system.state(np.concatenate([place, rho]), rates),
        "inhomogeneous ball on a rotating table, in the chart (x, y, rho) of the exponential map",
    )
