"""Quadratic matrix groups {Y : Y^T P Y = P}: SO(n), Lorentz groups, symplectic groups.

Takes the matrix P, finds a basis of the algebra; tau by the general formulas of the appendix.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import largest, transpose
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.matrix_group import MatrixGroup
from groupoid_gni.groupoids.retractions import Cayley, Retraction

_NULL_SPACE_TOLERANCE = 1e-10
_WHOLE_NUMBER_TOLERANCE = 1e-13
_LARGEST_CONDITION = 1e12


class QuadraticGroup(MatrixGroup):
    """G = {Y : Y^T P Y = P} with algebra {X : P X + X^T P = 0} (appendix, choice (b)).

    Cayley holds wherever 1 - xi/2 is invertible; Exponential and its logarithm in the domains
    stated in ``matrix_functions``.

    Parameters
    ----------
    quadratic_form : array_like, shape (n, n)
        P, symmetric or antisymmetric and invertible: np.eye(4) gives SO(4),
        np.diag([-1., 1., 1., 1.]) the Lorentz group.
    basis : array_like, shape (d, n, n), optional
        The matrices E_a the components refer to; by default an orthonormal basis of the algebra
        (in the entrywise product), computed by a singular value decomposition.
    side : {"left", "right"}
    retraction : Retraction
    """

    def __init__(
        self,
        quadratic_form: ArrayLike,
        basis: ArrayLike | None = None,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> None:
        self.quadratic_form = form = _checked_form(quadratic_form)
        self._form_inverse = np.linalg.inv(form)
        matrices = _algebra_basis(form) if basis is None else basis
        super().__init__(matrices, side=side, retraction=retraction)

    def _require_algebra(self) -> None:
        """Refuse a basis of another algebra; that of a form is closed, and Cayley stays in it."""
        form, matrices = self.quadratic_form, self.basis
        dimension = len(_algebra_basis(form))
        if matrices.shape != (dimension, *form.shape):
            raise InputError(
                f"QuadraticGroup(P, basis): the algebra has dimension {dimension}, so basis must "
                f"have shape {(dimension, *form.shape)}; it has {matrices.shape}."
            )
        defect = np.abs(form @ matrices + transpose(matrices) @ form).max(axis=(-2, -1))
        if defect.max() > 1e-10 * np.abs(form).max() * np.abs(matrices).max():
            raise InputError(
                f"QuadraticGroup(P, basis): basis[{defect.argmax()}] is not in the algebra, "
                f"|P X + X^T P| = {defect.max():.1e}."
            )

    @cached_property
    def _turning_basis(self) -> FloatArray:
        """All of it: these algebras have no translations."""
        return self.basis

    def inverse_element(self, element: Array) -> Array:
        """Give P^{-1} Y^T P: no linear system to solve."""
        return self._form_inverse @ transpose(element) @ self.quadratic_form

    def element_defect(self, element: Array) -> Array:
        """Give the largest entry of |Y^T P Y - P| over the largest of |P|."""
        n = self.element_shape[0]
        defect = self._defect(element) / np.abs(self.quadratic_form).max()
        return largest([np.abs(defect[..., i, j]) for i in range(n) for j in range(n)])

    def restore_element(self, element: Array) -> Array:
        """Give Y - Y P^{-1} (Y^T P Y - P) / 2, a Newton step of the polar projection."""
        return element - element @ (self._form_inverse @ self._defect(element)) / 2

    def _defect(self, element: Array) -> Array:
        return transpose(element) @ self.quadratic_form @ element - self.quadratic_form


def invariant_form(basis: FloatArray) -> FloatArray | None:
    """Give the form P of the quadratic group whose algebra is the span of ``basis``, or None.

    basis : shape (d, n, n), a basis of a Lie algebra. P is symmetric or antisymmetric and
    invertible, shape (n, n), its largest entry 1. A quadratic group preserves no second form of
    the same symmetry, except multiples.
    """
    matrices = basis / np.linalg.norm(basis, axis=(-2, -1), keepdims=True)
    units = _units(basis.shape[-1])[:, None]
    changes = units @ matrices + transpose(matrices) @ units
    for sign in (1.0, -1.0):
        conditions = np.concatenate([changes, units - sign * transpose(units)], axis=1)
        kernel = _null_space(conditions)
        if len(kernel) != 1:
            continue
        form = kernel[0] / kernel[0].flat[np.abs(kernel[0]).argmax()]
        whole = np.round(form)
        form = np.where(np.abs(form - whole) < _WHOLE_NUMBER_TOLERANCE, whole, form) + 0.0
        if np.linalg.cond(form) < _LARGEST_CONDITION and len(_algebra_basis(form)) == len(basis):
            return form
    return None


def _checked_form(quadratic_form: ArrayLike) -> FloatArray:
    form = np.array(quadratic_form, dtype=np.float64)
    if form.ndim != 2 or form.shape[0] != form.shape[1]:
        raise InputError(f"QuadraticGroup(P): P must be square, its shape is {form.shape}.")
    scale = np.abs(form).max()
    asymmetry = min(np.abs(form - form.T).max(), np.abs(form + form.T).max())
    if asymmetry > 1e-12 * scale:
        raise InputError(
            f"QuadraticGroup(P): P must be symmetric or antisymmetric; P differs from both by "
            f"{asymmetry:.1e}. The group of a general P preserves both of its parts separately."
        )
    if np.linalg.cond(form) > _LARGEST_CONDITION:
        raise InputError("QuadraticGroup(P): P must be invertible.")
    return form


def _algebra_basis(form: FloatArray) -> FloatArray:
    """Give an orthonormal basis of the kernel of X -> P X + X^T P, shape (d, n, n)."""
    units = _units(len(form))
    kernel = _null_space(form @ units + transpose(units) @ form)
    # Round-off entries would hide the structural zeros from the recorder.
    kernel[np.abs(kernel) < 1e-14] = 0.0
    return kernel


def _units(n: int) -> FloatArray:
    """Give the matrices with a single entry 1, row by row, shape (n n, n, n)."""
    return np.eye(n * n).reshape(n * n, n, n)


def _null_space(images: FloatArray) -> FloatArray:
    """Give an orthonormal basis (d, n, n) of the matrices X^ij with X^ij images[ij] = 0."""
    n = round(np.sqrt(len(images)))
    _, sizes, directions = np.linalg.svd(images.reshape(n * n, -1).T, full_matrices=False)
    kernel = directions[sizes <= _NULL_SPACE_TOLERANCE * sizes.max()]
    return kernel.reshape(-1, n, n)
