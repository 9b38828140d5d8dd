"""Positions, rotations and velocities of nodes, and how far two motions are apart in each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.groupoids import LieGroupoid

_ORTHOGONAL = 1e-6


class Quantity(Enum):
    """What an error is an error of.

    STATE : all base coordinates and velocity components.  POSITION : base coordinates that belong
    to no rotation.  ATTITUDE : the rotations of the base, or of the reconstructed pose where the
    base has none, as angles in radians.  VELOCITY : velocity components.
    """

    STATE = "state"
    POSITION = "position"
    ATTITUDE = "attitude"
    VELOCITY = "velocity"


@dataclass(frozen=True, eq=False)
class StateShape:
    """Which coordinates of a space are rotations, told by a point and a pose in general position.

    At the identity a motion of the plane looks like a rotation of space; and the nodes of a
    careless integrator are off the rotations.
    """

    space: LieGroupoid
    base: FloatArray
    pose: FloatArray

    @classmethod
    def of(cls, space: LieGroupoid, base_point: FloatArray) -> StateShape:
        """From an arrow that leaves a base point in no particular direction."""
        xi = 0.3 / (1.0 + np.arange(space.rank))
        arrow = np.asarray(space.retract(base_point, xi), dtype=float)
        return cls(space, np.asarray(space.target(arrow)), np.asarray(space.pose(arrow)))

    @property
    def turns_only_when_reconstructed(self) -> bool:
        """Whether the pose has a rotation and the base has none."""
        examples = self.space.split(self.base[None]) if self.base.size else []
        turning = [_without_rotation(part, part[0])[1] for part in map(np.asarray, examples)]
        pose = _without_rotation(self.pose[None], self.pose)[1]
        return bool(pose) and not any(turning)


@dataclass(frozen=True, eq=False)
class StateParts:
    """Nodes of a motion in parts.

    base, velocities : (n, base_size), (n, rank).  position : (n, k), see ``Quantity``.
    rotations : (n, d, d) matrices, one array for each rotation.
    """

    base: FloatArray
    velocities: FloatArray
    position: FloatArray
    rotations: tuple[FloatArray, ...]

    @classmethod
    def of(
        cls,
        shape: StateShape,
        base: FloatArray,
        velocities: FloatArray,
        poses: FloatArray | None = None,
    ) -> StateParts:
        """Sort base coordinates.  poses : (n, ...) reconstructed, used if the base does not turn.
        """
        flat, rotations = [], []
        if base.shape[1]:
            examples = shape.space.split(shape.base[None])
            for part, example in zip(shape.space.split(base), examples, strict=True):
                rest, turning = _without_rotation(np.asarray(part), np.asarray(example)[0])
                flat.append(rest.reshape(len(base), -1))
                rotations += turning
        if not rotations and poses is not None:
            rotations = _without_rotation(poses, shape.pose)[1]
        position = np.concatenate(flat, axis=1) if flat else np.zeros((len(base), 0))
        return cls(base, velocities, position, tuple(rotations))

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Those that this motion has."""
        return tuple(
            quantity
            for quantity, there in (
                (Quantity.STATE, True),
                (Quantity.POSITION, self.position.shape[1] > 0),
                (Quantity.ATTITUDE, len(self.rotations) > 0),
                (Quantity.VELOCITY, self.velocities.shape[1] > 0),
            )
            if there
        )

    def gaps(self, other: StateParts) -> dict[Quantity, FloatArray]:
        """(n,) largest difference at every node, of every quantity that both have."""
        found: dict[Quantity, FloatArray] = {}
        for quantity in self.quantities:
            if quantity not in other.quantities:
                continue
            if quantity is Quantity.ATTITUDE:
                pairs = zip(self.rotations, other.rotations, strict=True)
                found[quantity] = np.max([angle_between(a, b) for a, b in pairs], axis=0)
                continue
            mine, others = (_flat(parts, quantity) for parts in (self, other))
            found[quantity] = np.max(np.abs(mine - others), axis=1, initial=0.0)
        return found

    def size(self) -> float:
        """Largest base coordinate or velocity component, at least 1e-300."""
        return max(float(np.max(np.abs(_flat(self, Quantity.STATE)), initial=0.0)), 1e-300)


def _flat(parts: StateParts, quantity: Quantity) -> FloatArray:
    if quantity is Quantity.STATE:
        return np.concatenate([parts.base, parts.velocities], axis=1)
    return parts.position if quantity is Quantity.POSITION else parts.velocities


def angle_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Angle of ``first^T second``, (n, d, d) -> (n,), in radians; d is 2 or 3.

    ``|R - S| = 2 sqrt(2) sin(angle / 2)`` in the Frobenius norm, exact to round-off near 0.
    """
    apart = np.linalg.norm(first - second, axis=(-2, -1))
    return np.asarray(2.0 * np.arcsin(np.minimum(apart / (2.0 * np.sqrt(2.0)), 1.0)))


def _without_rotation(
    part: FloatArray, example: FloatArray
) -> tuple[FloatArray, list[FloatArray]]:
    """A part of the base as what is no rotation, and its rotation if there is one."""
    if part.ndim != 3 or part.shape[1] != part.shape[2]:
        return part, []
    d = part.shape[1]
    if 2 <= d <= 3 and _is_orthogonal(example):
        return np.zeros((len(part), 0)), [part]
    rigid = d >= 3 and np.array_equal(example[-1], np.eye(d)[-1])
    if rigid and _is_orthogonal(example[:-1, :-1]):
        return part[:, :-1, -1], [part[:, :-1, :-1]]
    return part, []


def _is_orthogonal(matrix: FloatArray) -> bool:
    d = len(matrix)
    return bool(np.max(np.abs(matrix.T @ matrix - np.eye(d))) < _ORTHOGONAL)
