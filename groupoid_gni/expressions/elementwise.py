"""Loops over recorded numbers: one for every NumPy ufunc that can be recorded.

Takes plain object arrays (elements: Scalars and floats), gives object arrays; knows nothing of
the array type around them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import RecordingError
from groupoid_gni.expressions.scalar import Scalar, as_scalar, select

__all__ = ["call", "loop_of", "reduce", "select_loop"]

# NumPy's own object loops do these right: they use Python's operators on the elements.
_NATIVE: Final = {
    np.add, np.subtract, np.multiply, np.divide, np.negative, np.positive, np.absolute, np.square,
    np.matmul, np.bitwise_and, np.bitwise_or, np.bitwise_xor, np.less, np.less_equal, np.greater,
    np.greater_equal, np.equal, np.not_equal,
    *(getattr(np, name) for name in ("vecdot", "matvec", "vecmat") if hasattr(np, name)),
}  # fmt: skip
_COMPARISONS: Final = {
    np.less, np.less_equal, np.greater, np.greater_equal, np.equal, np.not_equal,
}  # fmt: skip
_UNARY: Final = (
    np.sin, np.cos, np.tan, np.arcsin, np.arccos, np.arctan, np.sinh, np.cosh, np.tanh, np.arcsinh,
    np.arccosh, np.arctanh, np.exp, np.exp2, np.expm1, np.log, np.log1p, np.log2, np.log10,
    np.sqrt, np.cbrt, np.reciprocal, np.fabs, np.sign, np.floor, np.ceil, np.trunc, np.rint,
    np.conjugate, np.deg2rad, np.rad2deg, np.signbit, np.logical_not,
)  # fmt: skip
_BINARY: Final = (
    np.arctan2, np.hypot, np.power, np.float_power, np.copysign, np.fmod, np.remainder,
    np.floor_divide, np.maximum, np.minimum, np.heaviside, np.logaddexp, np.logical_xor,
)  # fmt: skip
_VALUE_TESTS: Final = {np.isfinite, np.isnan, np.isinf}


def _unary_loop(ufunc: np.ufunc, method: str) -> Any:
    recorded = getattr(Scalar, method)

    def apply(value: Any) -> Any:
        if type(value) is Scalar:
            return recorded(value)
        return ufunc(float(value)).item()

    return np.frompyfunc(apply, 1, 1)


def _binary_loop(ufunc: np.ufunc, method: str, **identity: Any) -> Any:
    recorded = getattr(Scalar, method)

    def apply(left: Any, right: Any) -> Any:
        if type(left) is Scalar or type(right) is Scalar:
            return recorded(as_scalar(left), right)
        return ufunc(float(left), float(right)).item()

    return np.frompyfunc(apply, 2, 1, **identity)


def _invert(value: Any) -> Any:
    # ~True is -2 in Python; NumPy means the logical not.
    return ~value if type(value) is Scalar else not value


def _table() -> dict[Any, Any]:
    table: dict[Any, Any] = {ufunc: ufunc for ufunc in _NATIVE}
    table.update({ufunc: _unary_loop(ufunc, ufunc.__name__) for ufunc in _UNARY})
    table.update({ufunc: _binary_loop(ufunc, ufunc.__name__) for ufunc in _BINARY})
    table[np.degrees] = table[np.rad2deg]
    table[np.radians] = table[np.deg2rad]
    table[np.fmax] = table[np.maximum]
    table[np.fmin] = table[np.minimum]
    table[np.logical_and] = _binary_loop(np.logical_and, "logical_and", identity=True)
    table[np.logical_or] = _binary_loop(np.logical_or, "logical_or", identity=False)
    table[np.invert] = np.frompyfunc(_invert, 1, 1)
    return table


_LOOPS: Final[dict[Any, Any]] = _table()

select_loop: Final[Callable[..., Any]] = np.frompyfunc(select, 3, 1)
"""Elementwise `select(condition, if_true, if_false)` with broadcasting."""


def loop_of(ufunc: np.ufunc) -> Any:
    """Give the loop that records a ufunc; RecordingError, by name, if there is none."""
    loop = _LOOPS.get(ufunc)
    if loop is not None:
        return loop
    if ufunc in _VALUE_TESTS:
        raise RecordingError(
            f"np.{ufunc.__name__} cannot be recorded: it tests a value that is not known yet. "
            "Leave the test out; the library checks for NaN and Inf itself."
        )
    raise RecordingError(f"np.{ufunc.__name__} cannot be recorded.")


def call(loop: Any, ufunc: np.ufunc, arrays: list[Any], kwargs: dict[str, Any]) -> Any:
    """Apply a loop to plain arrays, elementwise (or as a matrix product)."""
    if ufunc in _COMPARISONS:
        # Without dtype=object NumPy would ask every result for its truth value.
        kwargs = {**kwargs, "dtype": object}
    if ufunc is np.matmul and not arrays[0].size:
        # NumPy leaves None in object results that are sums of no terms.
        return loop(*(np.zeros(np.shape(array)) for array in arrays), **kwargs).astype(object)
    return loop(*arrays, **kwargs)


def reduce(loop: Any, ufunc: np.ufunc, array: Array, kwargs: dict[str, Any]) -> Any:
    """Reduce a plain array with a loop; `kwargs` as of ufunc.reduce (axis, keepdims, initial)."""
    if ufunc in _NATIVE:
        return loop.reduce(array, **kwargs)
    if not set(kwargs) <= {"axis", "keepdims"}:
        raise RecordingError(
            f"np.{ufunc.__name__}.reduce with {sorted(kwargs)} cannot be recorded."
        )
    axis = kwargs.get("axis", 0)
    axes = range(array.ndim) if axis is None else np.atleast_1d(axis)
    gone = sorted(int(number) % array.ndim for number in axes)
    kept = [number for number in range(array.ndim) if number not in gone]
    # One axis at a time is all NumPy grants to loops it does not know.
    columns = array.transpose(*kept, *gone).reshape(*(array.shape[k] for k in kept), -1)
    result = loop.reduce(columns, axis=-1)
    if not kwargs.get("keepdims", False):
        return result
    shape = [1 if number in gone else length for number, length in enumerate(array.shape)]
    return np.asarray(result, dtype=object).reshape(shape)
