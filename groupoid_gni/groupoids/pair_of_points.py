"""What all pair groupoids Q x Q share: arrows are (source, target), whatever the frame on Q."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import join
from groupoid_gni.groupoids.lie_groupoid import LieGroupoid


class PairOfPoints(LieGroupoid):
    """Q x Q => Q; a subclass adds the frame: ``retract``, ``lift`` and the base."""

    def source(self, g: Array) -> Array:
        """Give x0."""
        return g[..., : self.base_size]

    def target(self, g: Array) -> Array:
        """Give x1."""
        return g[..., self.base_size :]

    def identity(self, x: Array) -> Array:
        """Give (x, x)."""
        return join(x, x)

    def multiply(self, g: Array, h: Array) -> Array:
        """Give (x0, x1)(x1, x2) = (x0, x2)."""
        return join(self.source(g), self.target(h))

    def inverse(self, g: Array) -> Array:
        """Give (x1, x0)."""
        return join(self.target(g), self.source(g))

    def pose(self, arrow: Array) -> Array:
        """Give the target."""
        return self.target(arrow)

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give the identity at ``base_point``: the pose is where the arrow ends.

        Raises InputError for a pose that is somewhere else.
        """
        if pose is not None and not np.array_equal(np.asarray(pose), np.asarray(base_point)):
            raise InputError(f"a pose here is where the arrow ends, {base_point}; leave it out")
        return self.identity(base_point)
