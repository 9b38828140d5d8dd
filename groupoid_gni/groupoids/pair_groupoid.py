"""The pair groupoid R^n x R^n: arrows are pairs of points, the discrete tangent bundle.

The classical discrete mechanics of section 5 of the paper lives here.
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import batch_shape, join, repeated
from groupoid_gni.groupoids.pair_of_points import PairOfPoints


class PairGroupoid(PairOfPoints):
    """R^n x R^n => R^n, arrows (x0, x1), retract(x, xi) = (x, x + xi).

    B+ = 1, B- = -1, anchor 1, bracket 0.

    Parameters
    ----------
    base_dim : int
        n.
    """

    def __init__(self, base_dim: int) -> None:
        self.base_dim = self.rank = base_dim
        self.example_base_point = np.zeros(base_dim)

    def retract(self, x: Array, xi: Array) -> Array:
        """Give (x, x + xi)."""
        return join(x, x + xi)

    def lift(self, g: Array) -> Array:
        """Give x1 - x0."""
        return self.target(g) - self.source(g)

    def anchor(self, x: Array) -> Array:
        """Give the identity matrix, shape (..., n, n)."""
        return repeated(np.eye(self.rank), batch_shape(x))

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give the identity matrix, shape (..., n, n)."""
        return repeated(np.eye(self.rank), _common_batch(x, xi))

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give minus the identity matrix, shape (..., n, n)."""
        return repeated(-np.eye(self.rank), _common_batch(x, xi))

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give the identity matrix, shape (..., n, n)."""
        return repeated(np.eye(self.rank), _common_batch(x, xi))

    def bracket(self, x: Array) -> Array:
        """Give zero, shape (..., n, n, n)."""
        return repeated(np.zeros((self.rank,) * 3), batch_shape(x))

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give zero, shape (..., n)."""
        return np.zeros((*_common_batch(x, xi), self.rank))

    def half(self, x: Array, xi: Array) -> Array:
        """Give xi / 2."""
        return xi / 2

    def __repr__(self) -> str:
        return f"PairGroupoid({self.base_dim})"


def _common_batch(x: Array, xi: Array) -> tuple[int, ...]:
    return np.broadcast_shapes(batch_shape(x), batch_shape(xi))
