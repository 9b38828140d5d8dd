"""Quadratic matrix groups {Y : Y^T P Y = P}: SO(n), Lorentz groups, symplectic groups.

Takes the matrix P, finds a basis of the algebra; tau by the general formulas of the appendix.
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import largest, transpose
from groupoid_gni.groupoids.lie_group import LieGroup, Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction

_NULL_SPACE_TOLERANCE = 1e-10


class QuadraticGroup(LieGroup):
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
        form = _checked_form(quadratic_form)
        matrices = _algebra_basis(form) if basis is None else _checked_basis(form, basis)
        super().__init__(len(matrices), form.shape, side=side, retraction=retraction)
        self.quadratic_form = form
        self.basis = matrices
        flat = matrices.reshape(len(matrices), -1)
        self._components = np.linalg.pinv(flat).T.reshape(matrices.shape)
        self._form_inverse = np.linalg.inv(form)

    def hat(self, xi: Array) -> Array:
        """Give xi^a E_a."""
        return np.einsum("...a,aij->...ij", xi, self.basis)

    def vee(self, matrix: Array) -> Array:
        """Give the components of a matrix of the algebra in the basis E_a."""
        return np.einsum("aij,...ij->...a", self._components, matrix)

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

    def _options(self) -> str:
        n = self.element_shape[0]
        return f"<P {n} x {n}, dimension {self.dimension}>, {super()._options()}"


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
    if np.linalg.cond(form) > 1e12:
        raise InputError("QuadraticGroup(P): P must be invertible.")
    return form


def _algebra_basis(form: FloatArray) -> FloatArray:
    """Give an orthonormal basis of the kernel of X -> P X + X^T P, shape (d, n, n)."""
    n = len(form)
    units = np.eye(n * n).reshape(n * n, n, n)
    images = form @ units + np.swapaxes(units, -1, -2) @ form
    _, sizes, directions = np.linalg.svd(images.reshape(n * n, n * n).T)
    kernel = directions[sizes <= _NULL_SPACE_TOLERANCE * sizes.max()]
    # Round-off entries would hide the structural zeros from the recorder.
    kernel[np.abs(kernel) < 1e-14] = 0.0
    return kernel.reshape(-1, n, n)


def _checked_basis(form: FloatArray, basis: ArrayLike) -> FloatArray:
    matrices = np.array(basis, dtype=np.float64)
    dimension = len(_algebra_basis(form))
    if matrices.shape != (dimension, *form.shape):
        raise InputError(
            f"QuadraticGroup(P, basis): the algebra has dimension {dimension}, so basis must have "
            f"shape {(dimension, *form.shape)}; it has {matrices.shape}."
        )
    defect = np.abs(form @ matrices + np.swapaxes(matrices, -1, -2) @ form).max(axis=(-2, -1))
    if defect.max() > 1e-10 * np.abs(form).max() * np.abs(matrices).max():
        raise InputError(
            f"QuadraticGroup(P, basis): basis[{defect.argmax()}] is not in the algebra, "
            f"|P X + X^T P| = {defect.max():.1e}."
        )
    if np.linalg.matrix_rank(matrices.reshape(dimension, -1)) < dimension:
        raise InputError("QuadraticGroup(P, basis): the basis matrices depend on one another.")
    return matrices
