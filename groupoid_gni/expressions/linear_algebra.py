"""Linear algebra on recorded matrices.

Takes the arguments of the functions of np.linalg, gives recorded results; matrices may be stacked
along leading axes. Nothing here can compare values, so pivots are chosen by structure alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import RecordingError
from groupoid_gni.expressions.array import RecordedArray, plain, wrap
from groupoid_gni.expressions.scalar import Scalar

__all__ = [
    "cholesky", "det", "inv", "matrix_norm", "matrix_power", "multi_dot", "norm", "solve",
    "vector_norm",
]  # fmt: skip

_LARGEST_BY_COFACTORS: Final = 3
_SMALLEST_CONSTANT_PIVOT: Final = 1e-3


def _matrices(a: Any, function: str) -> Array:
    array = np.asarray(a).astype(object)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2]:
        raise np.linalg.LinAlgError(
            f"np.linalg.{function}: the matrix has shape {array.shape}; it must be square."
        )
    return array


def _is_zero(entry: Any) -> bool:
    """Tell whether an entry is zero whatever the inputs are."""
    return bool(entry.sx.is_zero()) if type(entry) is Scalar else entry == 0


def _over_stack(apply: Callable[..., Any], *stacks: tuple[Array, int]) -> Any:
    """Apply a function of matrices along broadcast leading axes.

    stacks : pairs (array, number of trailing axes that belong to one matrix).
    """
    leading = np.broadcast_shapes(*(a.shape[: a.ndim - own] for a, own in stacks))
    if not leading:
        return wrap(np.asarray(apply(*(a for a, _ in stacks)), dtype=object))
    full = [np.broadcast_to(a, leading + a.shape[a.ndim - own :]) for a, own in stacks]
    results = [np.asarray(apply(*(a[k] for a in full)), dtype=object) for k in np.ndindex(leading)]
    one = results[0].shape if results else full[-1].shape[len(leading) :]
    return wrap(np.array(results, dtype=object).reshape(leading + one))


def _minor(a: Array, row: int, column: int) -> Array:
    return np.delete(np.delete(a, row, axis=0), column, axis=1)


def _det_by_cofactors(a: Array) -> Any:
    n = len(a)
    if n == 0:
        return 1.0
    if n == 1:
        return a[0, 0]
    if n == 2:
        return a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    return sum((-1.0) ** j * a[0, j] * _det_by_cofactors(_minor(a, 0, j)) for j in range(n))


def _nonzero(determinant: Any) -> Any:
    if _is_zero(determinant):
        raise np.linalg.LinAlgError("Singular matrix: its determinant is zero for all inputs.")
    return determinant


def _inverse_by_cofactors(a: Array) -> Array:
    """Invert up to 3x3; divides by the determinant only, so no zero on the diagonal can hurt."""
    n = len(a)
    cofactors = np.empty((n, n), dtype=object)
    for i, j in np.ndindex(n, n):
        cofactors[j, i] = (-1.0) ** (i + j) * _det_by_cofactors(_minor(a, i, j))
    # Expanding along the first row reuses its cofactors.
    determinant = _nonzero(sum((a[0, j] * cofactors[j, 0] for j in range(n)), 0.0))
    return cofactors / determinant


def _pivot_row(column: list[Any]) -> int:
    """Choose the pivot among the entries from the diagonal downwards.

    The diagonal if it is not structurally zero: that keeps symmetric matrices symmetric, and is
    stable for definite ones. Otherwise the largest constant, whose value is known; otherwise the
    first recorded entry.
    """
    constants = [0.0 if type(entry) is Scalar else abs(entry) for entry in column]
    largest = int(np.argmax(constants))
    if type(column[0]) is Scalar:
        if not _is_zero(column[0]):
            return 0
    elif constants[0] > _SMALLEST_CONSTANT_PIVOT * constants[largest]:
        return 0
    if constants[largest]:
        return largest
    for row, entry in enumerate(column):
        if not _is_zero(entry):
            return row
    raise np.linalg.LinAlgError("Singular matrix: a column is zero for all inputs.")


def _triangular(a: Array, b: Array) -> tuple[Array, Array, float]:
    """Eliminate below the diagonal of [a | b]; gives both and the sign of the row exchanges."""
    a, b, sign = a.copy(), b.copy(), 1.0
    n = len(a)
    for k in range(n):
        chosen = k + _pivot_row(list(a[k:, k]))
        if chosen != k:
            a[[k, chosen]], b[[k, chosen]], sign = a[[chosen, k]], b[[chosen, k]], -sign
        for i in range(k + 1, n):
            if _is_zero(a[i, k]):
                continue
            factor = a[i, k] / a[k, k]
            a[i, k] = 0.0
            a[i, k + 1 :] = a[i, k + 1 :] - factor * a[k, k + 1 :]
            b[i] = b[i] - factor * b[k]
    return a, b, sign


def _solve_one(a: Array, b: Array) -> Array:
    """Solve a x = b for one matrix b of right-hand sides, shape (n, m)."""
    n = len(a)
    if n <= _LARGEST_BY_COFACTORS:
        return _inverse_by_cofactors(a) @ b if n else b
    upper, x, _ = _triangular(a, b)
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] = x[i] - upper[i, j] * x[j]
        x[i] = x[i] / upper[i, i]
    return x


def solve(a: Any, b: Any) -> Any:
    """Solve a x = b; a (..., n, n), b (n,) or (..., n, m), as np.linalg.solve.

    Up to 3x3 by cofactors, above by elimination without exchanging rows for size.
    Raises LinAlgError if a is singular for all inputs.
    """
    matrices = _matrices(a, "solve")
    right = np.asarray(b).astype(object)
    n = matrices.shape[-1]
    if right.ndim == 1:
        if right.shape != (n,):
            raise ValueError(f"np.linalg.solve: shapes {matrices.shape} and {right.shape}.")
        return _over_stack(lambda one: _solve_one(one, right[:, None])[:, 0], (matrices, 2))
    if right.shape[-2] != n:
        raise ValueError(f"np.linalg.solve: shapes {matrices.shape} and {right.shape}.")
    return _over_stack(_solve_one, (matrices, 2), (right, 2))


def inv(a: Any) -> Any:
    """Invert a, shape (..., n, n). Raises LinAlgError if it is singular for all inputs."""
    matrices = _matrices(a, "inv")
    return solve(matrices, np.eye(matrices.shape[-1]))


def _det_one(a: Array) -> Any:
    if len(a) <= _LARGEST_BY_COFACTORS:
        return _det_by_cofactors(a)
    try:
        upper, _, result = _triangular(a, np.zeros((len(a), 0), dtype=object))
    except np.linalg.LinAlgError:
        return 0.0
    for k in range(len(a)):
        result = result * upper[k, k]
    return result


def det(a: Any) -> Any:
    """Give the determinant of a, shape (..., n, n)."""
    return _over_stack(_det_one, (_matrices(a, "det"), 2))


def _cholesky_one(a: Array) -> Array:
    n = len(a)
    lower = np.zeros((n, n)).astype(object)
    for j in range(n):
        square = a[j, j] - sum((lower[j, k] * lower[j, k] for k in range(j)), 0.0)
        if type(square) is not Scalar and square <= 0.0:
            raise np.linalg.LinAlgError("Matrix is not positive definite")
        lower[j, j] = square.sqrt() if type(square) is Scalar else float(np.sqrt(square))
        for i in range(j + 1, n):
            rest = a[i, j] - sum((lower[i, k] * lower[j, k] for k in range(j)), 0.0)
            lower[i, j] = rest / lower[j, j]
    return lower


def cholesky(a: Any, /, *, upper: bool = False) -> Any:
    """Give the lower (or upper) Cholesky factor of a positive definite a, shape (..., n, n).

    Raises LinAlgError if a pivot is a constant that is not positive.
    """
    matrices = _matrices(a, "cholesky")
    lower = _over_stack(_cholesky_one, (matrices, 2))
    return np.swapaxes(lower, -1, -2) if upper else lower


def vector_norm(x: Any, /, *, axis: Any = None, keepdims: bool = False, ord: Any = 2) -> Any:
    """Give the norm of vectors: ord 2, 1, inf. The derivative of ord 2 at zero is NaN."""
    size = abs(_recorded(x))
    if ord == 2:
        return np.sqrt(np.sum(size * size, axis=axis, keepdims=keepdims))
    if ord == 1:
        return np.sum(size, axis=axis, keepdims=keepdims)
    if ord == np.inf:
        return np.max(size, axis=axis, keepdims=keepdims)
    raise RecordingError(f"np.linalg.norm with ord={ord!r} cannot be recorded for vectors.")


def matrix_norm(x: Any, /, *, keepdims: bool = False, ord: Any = "fro") -> Any:
    """Give the norm of matrices (last two axes): ord 'fro', 1, inf."""
    if ord == "fro":
        return vector_norm(x, axis=(-2, -1), keepdims=keepdims)
    if ord in (1, np.inf):
        summed, greatest = (-2, -1) if ord == 1 else (-1, -2)
        sums = np.sum(abs(_recorded(x)), axis=summed, keepdims=True)
        result = np.max(sums, axis=greatest, keepdims=True)
        return result if keepdims else np.squeeze(result, axis=(-2, -1))
    raise RecordingError(f"np.linalg.norm with ord={ord!r} cannot be recorded for matrices.")


def _recorded(x: Any) -> RecordedArray:
    return np.asarray(x).astype(object).view(RecordedArray)


def norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """Give np.linalg.norm: of vectors with ord None, 2, 1, inf; of matrices None, 'fro', 1, inf."""
    array = _recorded(x)
    two_axes = array.ndim == 2 if axis is None else np.size(axis) == 2
    if ord is None:
        return vector_norm(array, axis=axis, keepdims=keepdims)
    if not two_axes:
        return vector_norm(array, axis=axis, keepdims=keepdims, ord=ord)
    if axis is not None:
        array = np.moveaxis(array, axis, (-2, -1))
    result = matrix_norm(array, keepdims=keepdims, ord=ord)
    return np.moveaxis(result, (-2, -1), axis) if keepdims and axis is not None else result


def multi_dot(arrays: Any, *, out: Any = None) -> Any:
    """Multiply several matrices from left to right."""
    result = arrays[0]
    for factor in arrays[1:]:
        result = np.dot(result, factor)
    return result


def matrix_power(a: Any, n: int) -> Any:
    """Raise a square matrix, shape (..., k, k), to an integer power."""
    matrices = _matrices(a, "matrix_power")
    if n < 0:
        return matrix_power(inv(matrices), -n)
    return wrap(np.linalg.matrix_power(plain(matrices), n))
