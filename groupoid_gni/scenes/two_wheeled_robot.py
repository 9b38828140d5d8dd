"""The two-wheeled planar robot: a body on an axle with two wheels that roll."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import (
    SE2,
    Cayley,
    LieGroupoid,
    PairGroupoid,
    ProductGroupoid,
    Retraction,
    VectorGroup,
)
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.scenes.settling import settling_motion
from groupoid_gni.systems import MechanicalSystem, Parameters


def two_wheeled_robot(
    body_mass: float = 2.0,
    body_inertia: float = 0.5,
    offset: float = 0.3,
    wheel_mass: float = 0.2,
    wheel_inertia: float = 0.05,
    radius: float = 0.4,
    half_track: float = 0.6,
    detent: float = 0.0,
    wheel_angle: float = 0.0,
    spin: float = 1.5,
    speed: float = -1.0,
    retraction: Retraction | None = None,
) -> Scene:
    """Robot on R^2 x SE(2), reduced: wheel rates and body velocities of the middle of the axle.

    body_mass m_0, body_inertia J_0 : of the body, the latter about its own centre of mass.
    offset : distance l of the body's centre of mass ahead of the axle.
    wheel_mass m_1, wheel_inertia J_2 : of one wheel, the latter about the axle; a wheel is a disk,
        its inertia about its diameter is J_2 / 2.
    radius R, half_track c : of the wheels; half the distance between them.
    detent : strength k of the potential ``k sin(psi_1)`` on the first (left) wheel.
    wheel_angle : psi_1 at the start, used with a detent only.
    spin, speed : heading rate omega and forward speed u at the start.

    Velocity (psi_1', psi_2', omega, u, v), v sideways to the left. With ``m = m_0 + 2 m_1`` and
    ``J = J_0 + m_0 l^2 + 2 m_1 c^2 + J_2``,
    ``L = m/2 (u^2 + v^2) + m_0 l omega v + J/2 omega^2 + J_2/2 (psi_1'^2 + psi_2'^2)
    - k sin psi_1`` and ``v = 0, u - c omega = R psi_1', u + c omega = R psi_2'``: no side slip, and
    both wheels roll. The energy is a first integral.

    Left out: position and heading (symmetry SE(2)), the angle of the second wheel, and without a
    detent that of the first: the model is the Lie group R^2 x SE(2). Exact without a detent: with
    ``M = m + 2 J_2/R^2, I = J + 2 J_2 c^2/R^2`` the robot moves as a Chaplygin sleigh does,
    ``M u' = m_0 l omega^2, I omega' = -m_0 l u omega``.
    """
    if not (np.isfinite(radius) and radius > 0.0):
        raise InputError(f"radius must be a positive number, got {radius}")
    wheels: tuple[LieGroupoid, ...] = (VectorGroup(2),)
    parameters = {
        "m_0": body_mass, "J_0": body_inertia, "l": offset, "m_1": wheel_mass,
        "J_2": wheel_inertia, "R": radius, "c": half_track,
    }  # fmt: skip
    if detent:
        wheels = (PairGroupoid(1), VectorGroup(1))
        parameters["k"] = detent
    system = MechanicalSystem(
        ProductGroupoid(*wheels, SE2(retraction=Cayley() if retraction is None else retraction)),
        metric=_metric,
        constraints=_no_slip,
        potential=(lambda x, p: p.k * np.sin(x[0])) if detent else None,
        parameters=parameters,
    )
    left, right = (speed - half_track * spin) / radius, (speed + half_track * spin) / radius
    settles = spin and offset and not detent
    left_out = "the angle of the second wheel" if detent else "the wheels' angles"
    return Scene(
        system,
        system.state([wheel_angle] if detent else None, [left, right, spin, speed, 0.0]),
        "two-wheeled robot in wheel rates and body velocities; position, heading and "
        f"{left_out} left out",
        _exact_motion(system.parameters, spin, speed) if settles else None,
    )


def _masses(p: Any) -> tuple[Any, Any, Any]:
    """m, J and m_0 l of the docstring above."""
    turning = p.J_0 + p.m_0 * p.l**2 + 2.0 * p.m_1 * p.c**2 + p.J_2
    return p.m_0 + 2.0 * p.m_1, turning, p.m_0 * p.l


def _metric(x: Array, p: Parameters) -> Array:
    m, J, coupling = _masses(p)
    return np.array(
        [
            [p.J_2, 0.0, 0.0, 0.0, 0.0],
            [0.0, p.J_2, 0.0, 0.0, 0.0],
            [0.0, 0.0, J, 0.0, coupling],
            [0.0, 0.0, 0.0, m, 0.0],
            [0.0, 0.0, coupling, 0.0, m],
        ]
    )


def _no_slip(x: Array, p: Parameters) -> Array:
    return np.array(
        [
            [0.0, 0.0, 0.0, 0.0, 1.0],
            [-p.R, 0.0, -p.c, 1.0, 0.0],
            [0.0, -p.R, p.c, 1.0, 0.0],
        ]
    )


def _exact_motion(
    parameters: Mapping[str, FloatArray], spin: float, speed: float
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """The closed form of the docstring above, through the start."""
    p = SimpleNamespace(**parameters)
    m, J, coupling = _masses(p)
    # in sqrt(M) u and sqrt(I) omega the energy is a circle
    along, twist = np.sqrt(m + 2 * p.J_2 / p.R**2), np.sqrt(J + 2 * p.J_2 * (p.c / p.R) ** 2)
    rate = coupling / (along * twist**2)

    def exact(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        rising, fading = settling_motion(times, rate, along * speed, twist * spin)
        u, omega = rising / along, fading / twist
        wheels = (u - p.c * omega) / p.R, (u + p.c * omega) / p.R
        velocity = np.stack([*wheels, omega, u, np.zeros_like(u)], axis=-1)
        return np.zeros((len(velocity), 0)), velocity

    return exact
