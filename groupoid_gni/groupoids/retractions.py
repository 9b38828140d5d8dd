"""Retraction maps tau : g -> G as values.

Takes a Lie group and algebra vectors, gives group elements and trivialised tangents. Appendix of
the paper: tau(0) = e, tau(xi) tau(-xi) = e, definition 9.1 for dtau, choices (a) and (b).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import asinh, pi, sinh, sqrt
from typing import TYPE_CHECKING

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.expressions import record
from groupoid_gni.groupoids.components import apply, batch_shape
from groupoid_gni.groupoids.lie_groupoid import half_by_iteration

if TYPE_CHECKING:
    from groupoid_gni.groupoids.lie_group import LieGroup

CAYLEY_REACH = 2.0 * sqrt(4.0 / 3.0) * sinh(asinh(0.75 * pi * sqrt(3.0)) / 3.0)
"""The root 1.7656... of w (1 + w^2/4) = pi, by the hyperbolic form of Cardano's formula: the
Cayley vector beyond which a free isotropic body would turn by more than half a turn in a step."""


class Retraction(ABC):
    """A retraction map, applied to any Lie group.

    A subclass writes ``tau`` and ``inverse``; they must accept recorded arrays, satisfy
    tau(0) = e, tau(xi) tau(-xi) = e and have the identity as derivative at 0. The rest is derived
    by differentiation and may be overridden. Make it a frozen dataclass, so that it has equality.

    Elements are in the natural shape of the group, algebra vectors have shape (..., dimension).
    """

    @abstractmethod
    def tau(self, group: LieGroup, xi: Array) -> Array:
        """Give tau(xi), a group element."""

    @abstractmethod
    def inverse(self, group: LieGroup, element: Array) -> Array:
        """Give tau^{-1}(element), shape (..., dimension)."""

    def dtau(self, group: LieGroup, xi: Array) -> Array:
        """Give the right-trivialised tangent dtau_xi, shape (..., d, d), equation (51)."""
        return np.linalg.inv(self.dtau_inverse(group, xi))

    def dtau_inverse(self, group: LieGroup, xi: Array) -> Array:
        """Give dtau_xi^{-1} = d/de tau^{-1}(tau(e) tau(xi)) at e = 0, equation (52)."""
        return _recorded_dtau_inverse(self, group)(xi, np.zeros(group.dimension))

    def half(self, group: LieGroup, xi: Array) -> Array:
        """Give eta with tau(eta) tau(eta) = tau(xi)."""
        whole = self.tau(group, xi)

        def remainder(eta: Array) -> Array:
            return self.inverse(group, group.compose(self.tau(group, -eta), whole))

        def commutator(a: Array, b: Array) -> Array:
            return apply(group.ad(a), b)

        return half_by_iteration(xi, remainder, commutator)

    def reach(self, group: LieGroup, xi: Array) -> Array:
        """Give the dimensionless size of xi, shape (...,); 1 is the largest the library takes."""
        return np.zeros(batch_shape(xi))


@lru_cache(maxsize=64)
def _recorded_dtau_inverse(retraction: Retraction, group: LieGroup) -> Callable[..., Array]:
    def moved(xi: Array, e: Array) -> Array:
        product = group.compose(retraction.tau(group, e), retraction.tau(group, xi))
        return retraction.inverse(group, product)

    size = (group.dimension,)
    return record(moved, {"xi": size, "e": size}, size, name="moved").derivative(1)


@dataclass(frozen=True)
class Exponential(Retraction):
    """The exponential map, choice (a) of the appendix.

    Reach 1 is the largest rotation whose logarithm the group knows: pi, or 3 by the general one.
    """

    def tau(self, group: LieGroup, xi: Array) -> Array:
        """Give exp(xi)."""
        return group.exp(xi)

    def inverse(self, group: LieGroup, element: Array) -> Array:
        """Give log(element)."""
        return group.log(element)

    def dtau(self, group: LieGroup, xi: Array) -> Array:
        """Give dexp_xi = sum of ad^j / (j+1)!."""
        return group.dexp(xi)

    def dtau_inverse(self, group: LieGroup, xi: Array) -> Array:
        """Give dexp_xi^{-1} = sum of B_j ad^j / j!."""
        return group.dexp_inverse(xi)

    def half(self, group: LieGroup, xi: Array) -> Array:
        """Give xi / 2."""
        return xi / 2

    def reach(self, group: LieGroup, xi: Array) -> Array:
        """Give the rotation angle of xi over the largest one of the group."""
        return group.rotation_size(xi) / group.largest_angle


@dataclass(frozen=True)
class Cayley(Retraction):
    """The Cayley map (1 - xi/2)^{-1} (1 + xi/2), choice (b) of the appendix.

    For groups whose algebra contains its cubes: quadratic groups, rigid motions, GL(n), triangular
    matrices. No trigonometry, no singular derivatives.
    """

    def tau(self, group: LieGroup, xi: Array) -> Array:
        """Give cay(xi)."""
        return group.cay(xi)

    def inverse(self, group: LieGroup, element: Array) -> Array:
        """Give cay^{-1}(element)."""
        return group.cay_inverse(element)

    def dtau(self, group: LieGroup, xi: Array) -> Array:
        """Give dcay_xi y = (1 - xi/2)^{-1} y (1 + xi/2)^{-1}."""
        return group.dcay(xi)

    def dtau_inverse(self, group: LieGroup, xi: Array) -> Array:
        """Give dcay_xi^{-1} y = (1 - xi/2) y (1 + xi/2)."""
        return group.dcay_inverse(xi)

    def half(self, group: LieGroup, xi: Array) -> Array:
        """Give eta with cay(eta)^2 = cay(xi); shorter than xi/2 by O(|xi|^3)."""
        return group.cay_half(xi)

    def reach(self, group: LieGroup, xi: Array) -> Array:
        """Give the length of the rotation part over CAYLEY_REACH."""
        return group.rotation_size(xi) / CAYLEY_REACH
