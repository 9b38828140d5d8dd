"""The additive group R^n: translations, and fibre coordinates without curvature.

Elements and algebra vectors are both vectors (..., n); every retraction is the identity.
"""

from __future__ import annotations

from functools import cached_property
from math import pi

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import batch_shape, repeated
from groupoid_gni.groupoids.lie_group import LieGroup, Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction


class VectorGroup(LieGroup):
    """R^n with addition; dtau = 1, bracket 0.

    Parameters
    ----------
    dimension : int
        n, at least 1.
    side, retraction
        Without effect on a commutative group with tau(xi) = xi; kept so that all groups are alike.
    """

    def __init__(
        self,
        dimension: int,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> None:
        super().__init__(dimension, (dimension,), side=side, retraction=retraction)

    def hat(self, xi: Array) -> Array:
        """Give xi: algebra and components are the same."""
        return xi

    def vee(self, matrix: Array) -> Array:
        """Give the vector itself."""
        return matrix

    @cached_property
    def structure_constants(self) -> Array:
        """Zero, shape (n, n, n)."""
        return np.zeros((self.dimension,) * 3)

    def ad(self, xi: Array) -> Array:
        """Give zero, shape (..., n, n)."""
        return repeated(np.zeros((self.dimension,) * 2), batch_shape(xi))

    def Ad(self, element: Array) -> Array:
        """Give the identity matrix, shape (..., n, n)."""
        return self._one(element)

    @cached_property
    def identity_element(self) -> Array:
        """The zero vector."""
        return np.zeros(self.dimension)

    def compose(self, first: Array, second: Array) -> Array:
        """Give the sum."""
        return first + second

    def inverse_element(self, element: Array) -> Array:
        """Give the negative."""
        return -element

    def translated_basis(self, element: Array) -> Array:
        """Give the identity matrix, shape (..., n, n)."""
        return self._one(element)

    largest_angle = pi

    def rotation_size(self, xi: Array) -> Array:
        """Give zero: nothing turns."""
        return np.zeros(batch_shape(xi))

    def exp(self, xi: Array) -> Array:
        """Give xi."""
        return xi

    def log(self, element: Array) -> Array:
        """Give the element."""
        return element

    def dexp(self, xi: Array) -> Array:
        """Give the identity matrix."""
        return self._one(xi)

    def dexp_inverse(self, xi: Array) -> Array:
        """Give the identity matrix."""
        return self._one(xi)

    def cay(self, xi: Array) -> Array:
        """Give xi."""
        return xi

    def cay_inverse(self, element: Array) -> Array:
        """Give the element."""
        return element

    def dcay(self, xi: Array) -> Array:
        """Give the identity matrix."""
        return self._one(xi)

    def dcay_inverse(self, xi: Array) -> Array:
        """Give the identity matrix."""
        return self._one(xi)

    def cay_half(self, xi: Array) -> Array:
        """Give xi / 2."""
        return xi / 2

    def _one(self, vector: Array) -> Array:
        return repeated(np.eye(self.dimension), batch_shape(vector))

    def _options(self) -> str:
        return f"{self.dimension}, {super()._options()}"
