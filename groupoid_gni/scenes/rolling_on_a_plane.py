"""Rigid bodies that roll on a horizontal plane: what rattleback and disc share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.groupoids import SE3, ActionGroupoid, Retraction
from groupoid_gni.systems import MechanicalSystem, Parameters

ContactPoint = Callable[[Array, Parameters], Any]


def rolling_body(
    contact: ContactPoint, parameters: dict[str, Any], retraction: Retraction
) -> MechanicalSystem:
    """Body on S^2 x| SE(3), reduced by all motions of the plane, with ``V + Omega x r(gamma) = 0``.

    contact : r(gamma) in the body frame, from the centre of mass to the point of the surface whose
        outward normal is -gamma.
    parameters : m, g, the inertia matrix I about the centre of mass, and those of ``contact``.

    gamma is the vertical seen from the body, Omega its angular velocity and V the velocity of its
    centre of mass, in the body frame. ``V = m g height``, with the height ``-<gamma, r>`` that the
    vertical part of the constraint gives: it is written into the potential, so it cannot drift.
    The multipliers are the force of the plane *and* the weight, ``F - m g gamma``, body frame.
    """
    space = ActionGroupoid(
        SE3(retraction=retraction),
        _seen_from_the_body,
        [0.48, 0.6, 0.64],
        base_defect=lambda q: np.abs((q * q).sum(axis=-1) - 1.0),
        restore_base=lambda q: q * (3.0 - (q * q).sum(axis=-1, keepdims=True)) / 2.0,
    )

    def metric(x: Array, p: Parameters) -> Any:
        nothing = np.zeros((3, 3))
        return np.block([[p.I, nothing], [nothing, p.m * np.eye(3)]])

    def constraints(x: Array, p: Parameters) -> Any:
        r = contact(x, p)
        # Omega x r = -r x Omega
        turning = np.array([[0.0, r[2], -r[1]], [-r[2], 0.0, r[0]], [r[1], -r[0], 0.0]])
        return np.concatenate([turning, np.eye(3)], axis=1)

    return MechanicalSystem(
        space,
        metric=metric,
        constraints=constraints,
        potential=lambda x, p: -p.m * p.g * (x @ contact(x, p)),
        parameters=parameters,
    )


def rolling_velocity(spin: FloatArray, contact: FloatArray) -> FloatArray:
    """(Omega, V) of a body that rolls: the point at r rests, ``V = r x Omega``."""
    return np.concatenate([spin, np.cross(contact, spin)])


def _seen_from_the_body(direction: Array, motion: Array) -> Array:
    """A direction fixed in space, seen from the body before and after a motion: R^T q."""
    return (direction[..., None, :] @ motion[..., :3, :3])[..., 0, :]
