"""Lie groups as groupoids over a point, with a side and a retraction.

Takes hat and vee of a matrix group, gives all seven groupoid functions, B+, B- and the bracket.
Right-trivialised tangents and lemma 9.5 as in the appendix of the paper.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import matrix_functions
from groupoid_gni.groupoids.components import batch_shape, repeated, transpose
from groupoid_gni.groupoids.lie_groupoid import LieGroupoid
from groupoid_gni.groupoids.retractions import Cayley, Retraction

if TYPE_CHECKING:
    from groupoid_gni.groupoids.matrix_group import MatrixGroup

Side = Literal["left", "right"]
"""left: body velocities, W_{k+1} = W_k tau(xi); right: space velocities, W_{k+1} = tau(xi) W_k."""


class LieGroup(LieGroupoid):
    """A Lie group of matrices, a groupoid over a point.

    A subclass gives ``dimension`` and ``element_shape`` to ``__init__`` and writes ``hat`` and
    ``vee``; everything else follows, and closed forms may override it. The functions named after
    the group (compose, exp, cay, Ad ...) take elements in their natural shape (..., n, n); the
    seven functions of the groupoid take flattened elements.

    Trivialised tangents: a left group has B+ = dtau^{-1}_{-xi}, B- = -dtau^{-1}_{xi}; a right
    group, where ``multiply(g, h)`` is the matrix product h g, has B+ = dtau^{-1}_{xi},
    B- = -dtau^{-1}_{-xi}, and minus the matrix bracket.

    Parameters
    ----------
    dimension : int
        Dimension of the group.
    element_shape : tuple of int
        Natural shape of an element.
    side : {"left", "right"}
        Body or space velocities.
    retraction : Retraction
        ``Cayley()`` or ``Exponential()``, or one of the user's.
    """

    def __init__(
        self,
        dimension: int,
        element_shape: tuple[int, ...],
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen, so sharing one is safe
    ) -> None:
        if side not in ("left", "right"):
            raise InputError(
                f"{type(self).__name__}(side={side!r}): side must be 'left' (body velocities, "
                f"W_next = W tau(xi)) or 'right' (space velocities, W_next = tau(xi) W)."
            )
        if not isinstance(retraction, Retraction):
            raise InputError(
                f"{type(self).__name__}(retraction={retraction!r}): retraction must be a value "
                f"such as Cayley() or Exponential()."
            )
        self.dimension = self.rank = dimension
        self.element_shape = element_shape
        self.example_base_point = np.zeros(0)
        self.side: Side = side
        self.retraction = retraction

    @classmethod
    def from_geomstats(
        cls,
        space: Any,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> MatrixGroup:
        """Give the group of a geomstats matrix group, in the basis of its ``lie_algebra``.

        A QuadraticGroup where the algebra is that of a form, P X + X^T P = 0 (SpecialOrthogonal),
        which restores elements and inverts them exactly; a MatrixGroup otherwise
        (SpecialEuclidean, GeneralLinear, triangular matrices). SO2, SO3, SE2 and SE3 have the bases
        of geomstats, restore elements and have closed exponentials: use them where they fit.

        Parameters
        ----------
        space : geomstats matrix group
            ``lie_algebra.basis``, ``identity``, ``belongs`` and ``compose`` are read, here only:
            nothing of geomstats is called afterwards.
        side : {"left", "right"}
        retraction : Retraction

        Raises
        ------
        InputError
            For manifolds that are no groups, points that are vectors, a space that does not agree
            with the group built from its basis, and where Cayley leaves the group.
        """
        from groupoid_gni.groupoids.from_geomstats import group_from_geomstats

        group = group_from_geomstats(space, side, retraction)
        if not isinstance(group, cls):
            raise InputError(
                f"{cls.__name__}.from_geomstats({type(space).__name__}) would give a "
                f"{type(group).__name__}: write LieGroup.from_geomstats(...)."
            )
        return group

    # The algebra.

    @abstractmethod
    def hat(self, xi: Array) -> Array:
        """Give the matrix of the algebra with components xi: (..., dimension) -> (..., n, n)."""

    @abstractmethod
    def vee(self, matrix: Array) -> Array:
        """Invert ``hat``: (..., n, n) -> (..., dimension)."""

    @cached_property
    def basis(self) -> Array:
        """The matrices E_a = hat(e_a), shape (dimension, n, n)."""
        return self.hat(np.eye(self.dimension))

    @cached_property
    def structure_constants(self) -> Array:
        """C[c, a, b] with E_a E_b - E_b E_a = C[c, a, b] E_c, whatever the side."""
        first, second = self.basis[:, None], self.basis[None]
        return np.moveaxis(self.vee(first @ second - second @ first), -1, 0)

    def ad(self, xi: Array) -> Array:
        """Give the matrix of eta -> [xi, eta] (matrix bracket), shape (..., d, d)."""
        return np.einsum("cab,...a->...cb", self.structure_constants, xi)

    def Ad(self, element: Array) -> Array:
        """Give the matrix of eta -> vee(g hat(eta) g^{-1}), shape (..., d, d)."""
        g, g_inverse = element[..., None, :, :], self.inverse_element(element)[..., None, :, :]
        return transpose(self.vee(g @ self.basis @ g_inverse))

    # The group.

    @cached_property
    def identity_element(self) -> Array:
        """The neutral element in its natural shape."""
        return np.eye(self.element_shape[0])

    def compose(self, first: Array, second: Array) -> Array:
        """Give the matrix product first second, whatever the side."""
        return first @ second

    def inverse_element(self, element: Array) -> Array:
        """Give the inverse matrix."""
        return np.linalg.inv(element)

    def flatten(self, element: Array) -> Array:
        """Give an element's entries row by row: natural shape -> (..., arrow_size)."""
        batch = batch_shape(element, len(self.element_shape))
        return np.reshape(element, (*batch, -1))

    def unflatten(self, arrow: Array) -> Array:
        """Invert ``flatten``."""
        return np.reshape(arrow, (*batch_shape(arrow), *self.element_shape))

    def element_defect(self, element: Array) -> Array:
        """Give how far a matrix is from the group, shape (...,); default 0."""
        return np.zeros(batch_shape(element, len(self.element_shape)))

    def restore_element(self, element: Array) -> Array:
        """Move a matrix towards the group by one Newton step; default: leave it."""
        return element

    def translated_basis(self, element: Array) -> Array:
        """Give d/dxi flatten(multiply(W, tau(xi))) at 0, shape (..., arrow_size, d).

        The columns are W E_a on a left group, E_a W on a right one. Only nonzero entries of E_a
        are used: recording 3 matrix products of 3 x 3 would cost 135 operations, this 12.
        """
        left = self.side == "left"
        columns = []
        for matrix in self.basis:
            moved = np.zeros_like(element)
            for k, j in zip(*np.nonzero(matrix), strict=True):
                if left:
                    moved[..., :, j] = moved[..., :, j] + element[..., :, k] * matrix[k, j]
                else:
                    moved[..., k, :] = moved[..., k, :] + element[..., j, :] * matrix[k, j]
            columns.append(self.flatten(moved))
        return np.stack(columns, axis=-1)

    largest_angle: float = matrix_functions.LARGEST_ANGLE
    """Rotation angle up to which ``log`` inverts ``exp``; pi where there is a closed form."""

    def rotation_size(self, xi: Array) -> Array:
        """Give a bound of the largest rotation angle in exp(xi), |hat(xi)|_F / sqrt 2."""
        return np.sqrt((self.hat(xi) ** 2).sum(axis=(-2, -1)) / 2)

    # The two retractions; general matrix formulas.

    def exp(self, xi: Array) -> Array:
        """Give the matrix exponential of hat(xi)."""
        return matrix_functions.exponential(self.hat(xi))

    def log(self, element: Array) -> Array:
        """Invert ``exp`` for rotation angles up to 3 (see ``matrix_functions.logarithm``)."""
        return self.vee(matrix_functions.logarithm(element))

    def dexp(self, xi: Array) -> Array:
        """Give dexp_xi, the inverse of ``dexp_inverse``."""
        return np.linalg.inv(self.dexp_inverse(xi))

    def dexp_inverse(self, xi: Array) -> Array:
        """Give dexp_xi^{-1} = sum of B_j ad^j / j!, to round-off for |ad| <= 2 pi."""
        return matrix_functions.dexp_inverse_of_ad(self.ad(xi))

    def cay(self, xi: Array) -> Array:
        """Give cay(xi) = (1 - xi/2)^{-1} (1 + xi/2)."""
        half, one = self.hat(xi) / 2, self.identity_element
        return np.linalg.solve(one - half, one + half)

    def cay_inverse(self, element: Array) -> Array:
        """Give 2 (1 + g)^{-1} (g - 1)."""
        one = self.identity_element
        return self.vee(2 * np.linalg.solve(element + one, element - one))

    def dcay(self, xi: Array) -> Array:
        """Give the matrix of y -> (1 - xi/2)^{-1} y (1 + xi/2)^{-1}."""
        half, one = (self.hat(xi) / 2)[..., None, :, :], self.identity_element
        left, right = np.linalg.inv(one - half), np.linalg.inv(one + half)
        return transpose(self.vee(left @ self.basis @ right))

    def dcay_inverse(self, xi: Array) -> Array:
        """Give the matrix of y -> (1 - xi/2) y (1 + xi/2)."""
        half, one = (self.hat(xi) / 2)[..., None, :, :], self.identity_element
        return transpose(self.vee((one - half) @ self.basis @ (one + half)))

    def cay_half(self, xi: Array) -> Array:
        """Give eta with cay(eta)^2 = cay(xi): the half-tangent of hat(xi)/2."""
        half_tangent = matrix_functions.half_tangent(self.hat(xi) / 2, iterations=6)
        return self.vee(2 * half_tangent)

    # The chosen retraction.

    def tau(self, xi: Array) -> Array:
        """Give tau(xi), an element in its natural shape. Laws: tau(0) = e, tau(xi)tau(-xi) = e."""
        return self.retraction.tau(self, xi)

    def tau_inverse(self, element: Array) -> Array:
        """Give tau^{-1}(element), shape (..., dimension)."""
        return self.retraction.inverse(self, element)

    def dtau(self, xi: Array) -> Array:
        """Give the right-trivialised tangent dtau_xi (definition 9.1), shape (..., d, d)."""
        return self.retraction.dtau(self, xi)

    def dtau_inverse(self, xi: Array) -> Array:
        """Give its inverse dtau_xi^{-1}, equation (52), shape (..., d, d)."""
        return self.retraction.dtau_inverse(self, xi)

    def half_vector(self, xi: Array) -> Array:
        """Give eta with tau(eta)^2 = tau(xi), shape (..., dimension)."""
        return self.retraction.half(self, xi)

    # The groupoid over a point.

    def source(self, g: Array) -> Array:
        """Give the point: shape (..., 0)."""
        return np.zeros((*batch_shape(g), 0))

    def target(self, g: Array) -> Array:
        """Give the point: shape (..., 0)."""
        return np.zeros((*batch_shape(g), 0))

    def identity(self, x: Array) -> Array:
        """Give the flattened neutral element."""
        return repeated(self.flatten(self.identity_element), batch_shape(x))

    def multiply(self, g: Array, h: Array) -> Array:
        """Give g h on a left group, h g on a right one (flattened elements)."""
        first, second = (g, h) if self.side == "left" else (h, g)
        return self.flatten(self.compose(self.unflatten(first), self.unflatten(second)))

    def inverse(self, g: Array) -> Array:
        """Give the flattened inverse element."""
        return self.flatten(self.inverse_element(self.unflatten(g)))

    def retract(self, x: Array, xi: Array) -> Array:
        """Give tau(xi), flattened."""
        return self.flatten(self.tau(xi))

    def lift(self, g: Array) -> Array:
        """Give tau^{-1}(g)."""
        return self.tau_inverse(self.unflatten(g))

    def anchor(self, x: Array) -> Array:
        """Give the zero map to the point, shape (..., 0, dimension)."""
        return np.zeros((*batch_shape(x), 0, self.dimension))

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give dtau^{-1}_{-xi} (left) or dtau^{-1}_{xi} (right)."""
        return self.dtau_inverse(-xi if self.side == "left" else xi)

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give -dtau^{-1}_{xi} (left) or -dtau^{-1}_{-xi} (right)."""
        return -self.dtau_inverse(xi if self.side == "left" else -xi)

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give Ad_tau(xi)^T (left) or Ad_tau(-xi)^T (right)."""
        element = self.tau(xi)
        return transpose(self.Ad(element if self.side == "left" else self.inverse_element(element)))

    def bracket(self, x: Array) -> Array:
        """Give the structure constants (left) or minus them (right), shape (..., d, d, d)."""
        sign = 1.0 if self.side == "left" else -1.0
        return repeated(sign * self.structure_constants, batch_shape(x))

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give ad_xi^T p (left) or minus it (right), with the matrix bracket."""
        rate = (transpose(self.ad(xi)) @ p[..., None])[..., 0]
        return rate if self.side == "left" else -rate

    def half(self, x: Array, xi: Array) -> Array:
        """Give ``half_vector(xi)``."""
        return self.half_vector(xi)

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the size of xi in units of the retraction's limit."""
        return self.retraction.reach(self, xi)

    def restore_arrow(self, g: Array) -> Array:
        """Restore the element (``restore_element``)."""
        return self.flatten(self.restore_element(self.unflatten(g)))

    def pose(self, arrow: Array) -> Array:
        """Give the element in its natural shape."""
        return self.unflatten(arrow)

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give the element itself as an arrow; None: the neutral element."""
        if pose is None:
            return self.identity(base_point)
        return self.flatten(np.asarray(pose))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._options()})"

    def _options(self) -> str:
        return f"side={self.side!r}, retraction={self.retraction!r}"
