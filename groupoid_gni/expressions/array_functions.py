"""The NumPy functions that can be recorded, besides the ufuncs.

Takes the arguments of a NumPy function, gives its recorded result; a function that stands neither
in NATIVE nor in OWN is refused by the caller.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from groupoid_gni.errors import RecordingError
from groupoid_gni.expressions import linear_algebra
from groupoid_gni.expressions.array import RecordedArray, apply_ufunc, is_recorded, plain, wrap
from groupoid_gni.expressions.elementwise import select_loop

__all__ = ["NATIVE", "OWN"]

# Functions that only move elements, or only add and multiply them: NumPy does these right on
# object arrays. A Scalar times an exact zero is the float 0.0, so the products with structural
# zeros inside dot, einsum, kron... leave nothing in the graph.
NATIVE: Final[frozenset[Callable[..., Any]]] = frozenset({
    np.concatenate, np.stack, np.vstack, np.hstack, np.dstack, np.column_stack, np.block, np.append,
    np.split, np.array_split, np.hsplit, np.vsplit, np.dsplit, np.insert, np.delete,
    np.diag, np.diagflat, np.diagonal, np.tril, np.triu, np.tile, np.repeat, np.roll, np.rot90,
    np.flip, np.fliplr, np.flipud, np.transpose, np.matrix_transpose, np.reshape, np.ravel,
    np.squeeze, np.expand_dims, np.swapaxes, np.moveaxis, np.rollaxis, np.broadcast_to,
    np.broadcast_arrays, np.atleast_1d, np.atleast_2d, np.atleast_3d, np.copy, np.take,
    np.take_along_axis, np.compress, np.meshgrid, np.resize, np.copyto, np.fill_diagonal,
    np.kron, np.cross, np.vdot, np.inner, np.outer, np.trace, np.sum,
    np.prod, np.cumsum, np.cumprod, np.diff, np.ediff1d, np.trapezoid, np.polyval,
    np.shape, np.ndim, np.size, np.real, np.imag, np.iscomplexobj, np.isrealobj, np.result_type,
    np.can_cast, np.may_share_memory, np.shares_memory,
    np.linalg.trace, np.linalg.cross, np.linalg.outer, np.linalg.diagonal,
    np.linalg.matrix_transpose,
})  # fmt: skip


def _without_empty_sums(func: Callable[..., Any]) -> Callable[..., Any]:
    """Guard a product: NumPy leaves None in object results that are sums of no terms."""

    def product(*args: Any, **kwargs: Any) -> Any:
        result = func(*plain(args), **plain(kwargs))
        if any(isinstance(factor, np.ndarray) and not factor.size for factor in args):
            result = np.zeros(np.shape(result)).astype(object)
        return wrap(result)

    return product


def _where(condition: Any, *branches: Any) -> Any:
    if len(branches) != 2:
        raise RecordingError(
            "np.where(condition) alone cannot be recorded: which indices come out depends on the "
            "values. Use gni.where(condition, a, b)."
        )
    return wrap(select_loop(*(plain(np.asanyarray(value)) for value in (condition, *branches))))


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    result = default
    for condition, choice in zip(reversed(conditions), reversed(choices), strict=True):
        result = _where(condition, choice, result)
    return result


def _clip(a: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **bounds: Any) -> Any:
    lowest, highest = bounds.get("min", a_min), bounds.get("max", a_max)
    result = a
    if lowest is not None:
        result = np.maximum(result, lowest)
    if highest is not None:
        result = np.minimum(result, highest)
    if out is not None:
        out[...] = result
        return out
    return result


def _reduction(ufunc: np.ufunc) -> Callable[..., Any]:
    def reduce(a: Any, axis: Any = None, out: Any = None, keepdims: Any = False) -> Any:
        kwargs = {"axis": axis, "out": None if out is None else (out,), "keepdims": bool(keepdims)}
        return apply_ufunc(ufunc, "reduce", (np.asanyarray(a),), kwargs)

    return reduce


def _count(a: Any, axis: Any) -> float:
    shape = np.shape(a)
    axes = range(len(shape)) if axis is None else np.atleast_1d(axis)
    return float(np.prod([shape[int(number)] for number in axes]))


def _mean(a: Any, axis: Any = None, dtype: Any = None, out: Any = None, **keepdims: Any) -> Any:
    return np.sum(a, axis=axis, out=out, **keepdims) / _count(a, axis)


def _var(
    a: Any, axis: Any = None, dtype: Any = None, out: Any = None, ddof: float = 0, **keepdims: Any
) -> Any:
    deviation = a - _mean(a, axis=axis, keepdims=True)
    total = np.sum(deviation * deviation, axis=axis, out=out, **keepdims)
    return total / (_count(a, axis) - ddof)


def _std(a: Any, *args: Any, **kwargs: Any) -> Any:
    return np.sqrt(_var(a, *args, **kwargs))


def _round(a: Any, decimals: int = 0, out: Any = None) -> Any:
    if decimals or out is not None:
        raise RecordingError("np.round can be recorded only with decimals=0 and without out.")
    return np.rint(a)


def _filled(a: Any, value: Any, dtype: Any = None, shape: Any = None, **order: Any) -> Any:
    if dtype is not None and np.dtype(dtype).kind not in "fO":
        return np.full(np.shape(a) if shape is None else shape, value, dtype)
    # An asked-for float dtype gives a recorded array all the same: it will hold recorded values.
    result = np.empty(np.shape(a) if shape is None else shape, dtype=object).view(RecordedArray)
    result[...] = value
    return result


def _zeros_like(a: Any, dtype: Any = None, order: Any = "K", **rest: Any) -> Any:
    return _filled(a, 0.0, dtype, rest.get("shape"))


def _ones_like(a: Any, dtype: Any = None, order: Any = "K", **rest: Any) -> Any:
    return _filled(a, 1.0, dtype, rest.get("shape"))


def _full_like(a: Any, fill_value: Any, dtype: Any = None, order: Any = "K", **rest: Any) -> Any:
    if not is_recorded(a) and dtype is None and not is_recorded(fill_value):
        dtype = np.result_type(a)
    return _filled(a, fill_value, dtype, rest.get("shape"))


def _sinc(x: Any) -> Any:
    angle = np.pi * _where(x == 0.0, 1e-20, x)
    return np.sin(angle) / angle


OWN: Final[dict[Callable[..., Any], Callable[..., Any]]] = {
    np.where: _where,
    np.select: _select,
    np.clip: _clip,
    np.max: _reduction(np.maximum),
    np.amax: _reduction(np.maximum),
    np.min: _reduction(np.minimum),
    np.amin: _reduction(np.minimum),
    np.any: _reduction(np.logical_or),
    np.all: _reduction(np.logical_and),
    np.mean: _mean,
    np.var: _var,
    np.std: _std,
    np.round: _round,
    np.around: _round,
    np.zeros_like: _zeros_like,
    np.empty_like: _zeros_like,
    np.ones_like: _ones_like,
    np.full_like: _full_like,
    np.sinc: _sinc,
    np.dot: _without_empty_sums(np.dot),
    np.einsum: _without_empty_sums(np.einsum),
    np.tensordot: _without_empty_sums(np.tensordot),
    np.linalg.tensordot: _without_empty_sums(np.linalg.tensordot),
    np.linalg.matmul: np.matmul,
    np.linalg.solve: linear_algebra.solve,
    np.linalg.inv: linear_algebra.inv,
    np.linalg.det: linear_algebra.det,
    np.linalg.cholesky: linear_algebra.cholesky,
    np.linalg.norm: linear_algebra.norm,
    np.linalg.vector_norm: linear_algebra.vector_norm,
    np.linalg.matrix_norm: linear_algebra.matrix_norm,
    np.linalg.multi_dot: linear_algebra.multi_dot,
    np.linalg.matrix_power: linear_algebra.matrix_power,
}
