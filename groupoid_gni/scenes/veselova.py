"""The Veselova problem: a rigid body whose turning about the vertical is prescribed."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.groupoids import SO3, ActionGroupoid, Cayley, Retraction
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import MechanicalSystem


def veselova(
    inertia: ArrayLike = (1.0, 1.5, 2.2),
    rate: float = 0.0,
    weight: ArrayLike | None = None,
    vertical: ArrayLike = (0.48, 0.6, 0.64),
    spin: ArrayLike = (0.5, 0.4, -0.75),
    retraction: Retraction | None = None,
) -> Scene:
    """Rigid body on S^2 x| SO(3) with <Omega, gamma> = c, reduced by turns about the vertical.

    gamma is the vertical seen from the body: ``gamma' = gamma x Omega``,
    ``I Omega' = I Omega x Omega + gamma x dV/dgamma + lambda gamma``.

    inertia : principal moments (I_1, I_2, I_3) in the body frame.
    rate : c; 0 forbids turning about the vertical, other values drive it.
    weight : potential ``V = <weight, gamma>``, for example m g times the centre of mass in the
        body frame, shape (3,); no potential when left out.
    vertical, spin : gamma (a unit vector) and Omega at the start, with <Omega, gamma> = c.

    First integrals: ``E - c <I Omega, gamma>`` (the energy for c = 0; the moving energy otherwise)
    and, without weight, the size of the horizontal momentum ``|K|``,
    ``K = I Omega - <I Omega, gamma> gamma`` (fixed in space).

    Left out: the heading of the body, its turn about the vertical; ``reconstruct`` gives it back.
    """
    moments = checked_numbers("inertia", inertia, (3,))
    gamma = checked_numbers("vertical", vertical, (3,))
    omega = checked_numbers("spin", spin, (3,))
    parameters = {"I": moments, "c": rate}
    if weight is not None:
        parameters["weight"] = checked_numbers("weight", weight, (3,))
    group = SO3(retraction=Cayley() if retraction is None else retraction)
    system = MechanicalSystem(
        ActionGroupoid(
            group,
            _seen_from_the_body,
            [0.48, 0.6, 0.64],
            base_defect=lambda q: np.abs((q * q).sum(axis=-1) - 1.0),
            restore_base=lambda q: q * (3.0 - (q * q).sum(axis=-1, keepdims=True)) / 2.0,
        ),
        metric=lambda x, p: np.diag(p.I),
        constraints=lambda x, p: x[None, :],
        drift=lambda x, p: p.c * x,
        potential=None if weight is None else lambda x, p: p.weight @ x,
        parameters=parameters,
    )
    return Scene(
        system,
        system.state(gamma, omega),
        "Veselova body as vertical and angular velocity seen from the body; heading left out",
    )


def _seen_from_the_body(direction: Array, turn: Array) -> Array:
    """A direction fixed in space, seen from the body before and after a turn: R^T q."""
    return (direction[..., None, :] @ turn)[..., 0, :]
