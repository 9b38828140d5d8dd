"""The Suslov problem: a rigid body that must not turn about an axis fixed in it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, Cayley, Retraction
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.scenes.settling import settling_motion
from groupoid_gni.systems import MechanicalSystem

_INERTIA = ((1.4, 0.0, 0.3), (0.0, 1.0, 0.2), (0.3, 0.2, 0.9))


def suslov(
    inertia: ArrayLike = _INERTIA,
    axis: ArrayLike = (0.0, 0.0, 1.0),
    spin: ArrayLike = (1.0, -0.5, 0.0),
    retraction: Retraction | None = None,
) -> Scene:
    """Rigid body on SO(3) with <a, Omega> = 0, reduced: the body angular velocity, nothing else.

    ``I Omega' = I Omega x Omega + lambda a``.

    inertia : the inertia matrix I in the body frame, shape (3, 3); principal axes not needed.
    axis : a, fixed in the body, of any length, shape (3,).
    spin : Omega at the start, shape (3,), orthogonal to a.

    Exact: with w the components of Omega in the plane orthogonal to a, J the part of I in that
    plane and b the products of inertia between the plane and a/|a|, ``J w' = (b.w) S w``, S the
    quarter turn. With ``J = C C^T, u = C^T w`` the energy is the circle |u|^2 = 2 E, and c, s, the
    components of u along and across C^-1 b, obey ``s' = k c^2, c' = -k s c`` with
    ``k = |C^-1 b| / sqrt(det J)``: tanh and sech. The body settles in the stable one of the two
    steady turns with b.w = 0; for a principal axis a (b = 0) Omega is constant.

    Left out: the attitude; nothing depends on it, and ``reconstruct`` gives it back.
    """
    a = checked_numbers("axis", axis, (3,))
    if not np.any(a):
        raise InputError("axis must not be zero: give the direction the body must not turn about")
    matrix = checked_numbers("inertia", inertia, (3, 3))
    omega = checked_numbers("spin", spin, (3,))
    system = MechanicalSystem(
        SO3(retraction=Cayley() if retraction is None else retraction),
        metric=lambda x, p: p.I,
        constraints=lambda x, p: p.a[None, :],
        parameters={"I": matrix, "a": a},
    )
    return Scene(
        system,
        system.state(velocity=omega),
        "Suslov body in body angular velocities; attitude left out (symmetry SO(3))",
        _exact_motion(matrix, a, omega),
    )


def _exact_motion(
    inertia: FloatArray, axis: FloatArray, spin: FloatArray
) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """The closed form of the docstring above, through the start."""
    # right-handed seen from the tip of the axis; the other turn would change the sign of S
    normal = axis / np.linalg.norm(axis)
    first = np.linalg.svd(normal[None, :])[2][1]
    plane = np.stack([first, np.cross(normal, first)], axis=1)
    root = np.linalg.cholesky(plane.T @ inertia @ plane)
    pull = np.linalg.solve(root, plane.T @ inertia @ normal)
    strength = float(np.linalg.norm(pull))
    start = root.T @ plane.T @ spin
    direction = pull / strength if strength else np.array([1.0, 0.0])
    # u = s S direction + c direction: c = <direction, u> is what drives the motion
    frame = np.array([[-direction[1], direction[0]], [direction[0], direction[1]]])
    back = plane @ np.linalg.solve(root.T, frame.T)
    rising, fading = frame @ start
    rate = strength / float(np.prod(np.diag(root)))

    def exact(times: FloatArray) -> tuple[FloatArray, FloatArray]:
        if fading == 0.0:
            moving = np.broadcast_to([[rising], [fading]], (2, np.size(times)))
        else:
            moving = np.stack(settling_motion(times, rate, rising, fading))
        velocity = (back @ moving).T
        return np.zeros((len(velocity), 0)), velocity

    return exact
