"""Matrix Lie groups given by a basis of their Lie algebra.

Takes matrices E_a, gives hat and vee; everything else by the general formulas of ``LieGroup``.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.expressions import is_recorded
from groupoid_gni.groupoids.lie_group import LieGroup, Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction

_TOLERANCE = 1e-10
_ROUND_OFF = 1e-14


class MatrixGroup(LieGroup):
    """The connected group of matrices whose Lie algebra has the basis E_a.

    Cayley stays in a group exactly when xi^3 is in its algebra for every xi of it (then so are
    xi y xi, dcay_xi^{-1} y and half vectors). It does in quadratic groups, rigid motions, GL(n)
    and triangular matrices, not in SL(3); there, pass ``retraction=Exponential()``.

    Nothing more is known about the group, so ``element_defect`` is 0 and ``restore_element``
    leaves elements as they are: products gather round-off. Closed forms (SO2, SO3, SE2, SE3) and
    quadratic groups (QuadraticGroup) restore, and closed exponentials are 14 times faster.

    Parameters
    ----------
    basis : array_like, shape (d, n, n)
        Linearly independent matrices whose commutators lie in their span; xi are components in it.
    side : {"left", "right"}
    retraction : Retraction

    Raises
    ------
    InputError
        When the basis is dependent or not closed under the commutator, or Cayley leaves the group.
    """

    def __init__(
        self,
        basis: ArrayLike,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> None:
        matrices = _checked_matrices(type(self).__name__, basis)
        super().__init__(len(matrices), matrices.shape[1:], side=side, retraction=retraction)
        self.basis = matrices
        self._require_algebra()
        self._components = _dual_basis(type(self).__name__, matrices)

    def hat(self, xi: Array) -> Array:
        """Give xi^a E_a."""
        return np.einsum("...a,aij->...ij", xi, self.basis)

    def vee(self, matrix: Array) -> Array:
        """Give the components in the basis E_a, by its pseudo-inverse: shape (..., d).

        A matrix outside the algebra is projected onto it, orthogonally in the entrywise product.
        """
        return np.einsum("aij,...ij->...a", self._components, matrix)

    def inverse_element(self, element: Array) -> Array:
        """Give the inverse matrix; recorded, by products and traces, and one division by det.

        A recording cannot choose pivots by size: elimination would fail at poses with a quarter
        turn, where the first entry is 0.
        """
        return _inverse_by_traces(element) if is_recorded(element) else np.linalg.inv(element)

    def rotation_size(self, xi: Array) -> Array:
        """Give a bound of the moduli of the eigenvalues of hat(xi), shape (...,).

        The size of the part of hat(xi) that turns or stretches: translations do not count, as
        their unit is the user's. Over sqrt 2 where eigenvalues come in pairs. On a traceless group
        in which Cayley leaves (SL(3)) it bounds their imaginary parts, the angles, only.
        """
        turning = np.einsum("...a,aij->...ij", xi, self._turning_basis)
        return np.sqrt((turning**2).sum(axis=(-2, -1)) / self._multiplicity)

    @cached_property
    def _turning_basis(self) -> FloatArray:
        """The E_a up to the radical of the associative algebra they generate.

        In a basis that makes all E_a block triangular the radical is strictly so: leaving it out
        changes no eigenvalue.
        """
        n = self.element_shape[0]
        flat = self.basis.reshape(self.dimension, n * n)
        radical = _radical(_generated_algebra(self.basis))
        turning = flat - flat @ radical.T @ radical
        sizes = np.linalg.norm(flat, axis=-1, keepdims=True)
        return _without_round_off(turning, sizes).reshape(self.basis.shape)

    @cached_property
    def _multiplicity(self) -> float:
        """2 where eigenvalues come in pairs lambda, -lambda: all odd powers are traceless."""
        traces = np.trace(_of_unit_size(self.basis), axis1=-2, axis2=-1)
        return 2.0 if np.abs(traces).max() < _TOLERANCE else 1.0

    def _require_algebra(self) -> None:
        """Refuse a basis that is no algebra, or a Cayley map that leaves its group."""
        units = _of_unit_size(self.basis)
        span = _row_space(units.reshape(self.dimension, -1))
        products = units[:, None] @ units[None]
        outside = _distance(products - np.swapaxes(products, 0, 1), span)
        if outside.max() > _TOLERANCE:
            a, b = np.unravel_index(outside.argmax(), outside.shape)
            raise InputError(
                f"{type(self).__name__}(basis): basis[{a}] basis[{b}] - basis[{b}] basis[{a}] is "
                f"not in the span of the basis (relative distance {outside.max():.1e}), so these "
                f"matrices are no Lie algebra. Add what is missing, or check the entries."
            )
        if isinstance(self.retraction, Cayley):
            self._require_cayley(units, span)

    def _require_cayley(self, units: FloatArray, span: FloatArray) -> None:
        """Check x y z + z y x for all triples: linear in each, so the basis decides."""
        for b, middle in enumerate(units):
            triples = (units @ middle)[:, None] @ units[None]
            outside = _distance(triples + np.swapaxes(triples, 0, 1), span)
            if outside.max() > _TOLERANCE:
                a, c = np.unravel_index(outside.argmax(), outside.shape)
                raise InputError(
                    f"{type(self).__name__}(basis, retraction={self.retraction!r}): the Cayley map "
                    f"leaves this group, because E_{a} E_{b} E_{c} + E_{c} E_{b} E_{a} (E = basis) "
                    f"is not in its algebra (relative distance {outside.max():.1e}). Pass "
                    f"retraction=Exponential()."
                )

    def _options(self) -> str:
        n = self.element_shape[0]
        return f"<{n} x {n}, dimension {self.dimension}>, {super()._options()}"


def _inverse_by_traces(matrix: Array) -> Array:
    """Give the inverse by the Faddeev-LeVerrier recursion (Cayley-Hamilton)."""
    n = np.shape(matrix)[-1]
    one = np.eye(n)

    def trace(product: Array) -> Array:
        return (product * one).sum(axis=(-2, -1), keepdims=True)

    adjugate: Array = one
    for k in range(1, n):
        product = matrix @ adjugate
        adjugate = product - trace(product) * one / k
    return n * adjugate / trace(matrix @ adjugate)


def _checked_matrices(owner: str, basis: ArrayLike) -> FloatArray:
    try:
        given = np.array(basis)
        if given.dtype.kind == "c":
            raise TypeError("write a complex n x n matrix A + i B as the real [[A, -B], [B, A]]")
        matrices = given.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{owner}(basis): the basis must hold real matrices of one size: {error}."
        ) from error
    if matrices.ndim != 3 or matrices.shape[1] != matrices.shape[2] or not matrices.size:
        raise InputError(
            f"{owner}(basis): the basis must have shape (d, n, n), d square matrices; it has "
            f"{matrices.shape}. A single matrix is basis=[matrix]."
        )
    if not np.isfinite(matrices).all():
        bad = int(np.argmin(np.isfinite(matrices).all(axis=(1, 2))))
        raise InputError(f"{owner}(basis): basis[{bad}] has entries that are not finite.")
    return matrices


def _dual_basis(owner: str, matrices: FloatArray) -> FloatArray:
    """Give the matrices whose entrywise products with E_b are 1 for themselves, else 0."""
    units = _of_unit_size(matrices).reshape(len(matrices), -1)
    if len(_row_space(units)) < len(matrices):
        ranks = [len(_row_space(units[: a + 1])) for a in range(len(units))]
        first = next(a for a, rank in enumerate(ranks) if rank <= a)
        raise InputError(
            f"{owner}(basis): the basis matrices depend on one another: basis[{first}] is a "
            f"combination of those before it (or zero). Leave it out."
        )
    dual = np.linalg.pinv(units).T
    dual = _without_round_off(dual, np.linalg.norm(dual, axis=-1, keepdims=True))
    sizes = np.linalg.norm(matrices, axis=(-2, -1), keepdims=True)
    return np.asarray(dual.reshape(matrices.shape) / sizes)


def _of_unit_size(matrices: FloatArray) -> FloatArray:
    """Scale each matrix to size 1 (zero stays), so that no test depends on units."""
    sizes = np.linalg.norm(matrices, axis=(-2, -1), keepdims=True)
    return np.asarray(matrices / np.where(sizes > 0.0, sizes, 1.0))


def _row_space(rows: FloatArray) -> FloatArray:
    """Give orthonormal rows that span the same space."""
    _, sizes, directions = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(directions[sizes > _TOLERANCE * sizes.max()])


def _distance(matrices: FloatArray, span: FloatArray) -> FloatArray:
    """Give the distances of matrices (..., n, n) from the span of orthonormal rows, (...,)."""
    flat = matrices.reshape(*matrices.shape[:-2], -1)
    return np.asarray(np.linalg.norm(flat - flat @ span.T @ span, axis=-1))


def _without_round_off(rows: Array, sizes: Array) -> FloatArray:
    """Put entries to zero that are round-off for their row: the recorder sees exact zeros only."""
    return np.where(np.abs(rows) > _ROUND_OFF * sizes, rows, 0.0)


def _generated_algebra(basis: FloatArray) -> FloatArray:
    """Give orthonormal rows (m, n n) that span all sums of products of E_a, and 1."""
    n = basis.shape[-1]
    units = _of_unit_size(np.concatenate([np.eye(n)[None], basis]))
    span = _row_space(units.reshape(-1, n * n))
    while True:
        products = span.reshape(-1, 1, n, n) @ units[None]
        wider = _row_space(products.reshape(-1, n * n))
        if len(wider) == len(span):
            return span
        span = wider


def _radical(algebra: FloatArray) -> FloatArray:
    """Give orthonormal rows that span {X : tr(X Y) = 0 for all Y} (Dickson's theorem)."""
    n = round(np.sqrt(algebra.shape[1]))
    matrices = algebra.reshape(-1, n, n)
    _, sizes, directions = np.linalg.svd(np.einsum("aij,bji->ab", matrices, matrices))
    return np.asarray(directions[sizes <= _TOLERANCE * sizes.max()] @ algebra)
