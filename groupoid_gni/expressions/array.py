"""Arrays of recorded numbers.

Takes what NumPy is asked to do with recorded arrays, gives recorded arrays back; what cannot be
recorded is refused by name. NumPy does the shapes and the loops; the elements do the recording.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import RecordingError
from groupoid_gni.expressions import elementwise
from groupoid_gni.expressions.scalar import Scalar

__all__ = ["RecordedArray", "apply_array_function", "apply_ufunc", "is_recorded", "plain", "wrap"]

_FLOAT_TARGET: Final = (
    "a recorded value is assigned into a float array. Build the array with gni.array([...]), or "
    "start from np.zeros_like(x) with a recorded x."
)


def _through(func: Callable[..., Any]) -> Any:
    """Make an ndarray method that goes the way of the NumPy function of the same name."""

    def method(self: RecordedArray, *args: Any, **kwargs: Any) -> Any:
        return func(self, *args, **kwargs)

    method.__doc__ = f"Give np.{func.__name__} of this array."
    return method


class RecordedArray(np.ndarray[Any, Any]):
    """An object array whose elements are Scalars and plain floats.

    It takes part in NumPy arithmetic like a float array. Results of shape () come back as the
    element itself. Comparisons give recorded conditions; there is no way to branch on them except
    gni.where. Made by `symbols`, `from_sx`, `gni.array`, and by any operation on one.

    Raises RecordingError, naming the function, for NumPy functions that cannot be recorded.
    """

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        return apply_ufunc(ufunc, method, inputs, kwargs)

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        return apply_array_function(func, args, kwargs)

    def __getitem__(self, index: Any) -> Any:
        # x[..., 0] is a 0-d array; handing out the element keeps np.array([x[..., 0], 1.0]) flat.
        found = super().__getitem__(index)
        if isinstance(found, RecordedArray) and found.ndim == 0:
            return found.item()
        return found

    def __setitem__(self, index: Any, value: Any) -> None:
        if isinstance(value, (np.ndarray, list, tuple)):
            value = np.asarray(value)
            if value.ndim and not isinstance(super().__getitem__(index), np.ndarray):
                # An object array would take the whole array as one element.
                raise RecordingError(
                    f"an array of shape {value.shape} is assigned to a single element."
                )
            value = value[()]
        super().__setitem__(index, value)

    def astype(self, dtype: Any, *args: Any, **kwargs: Any) -> Any:
        """Copy; conversions between float types leave a recorded array as it is."""
        if np.dtype(dtype).kind in "fO":
            return self.copy()
        raise RecordingError(f"astype({np.dtype(dtype)}) cannot be recorded: it needs numbers.")

    dot = _through(np.dot)
    sum = _through(np.sum)
    prod = _through(np.prod)
    mean = _through(np.mean)
    var = _through(np.var)
    std = _through(np.std)
    max = _through(np.max)
    min = _through(np.min)
    any = _through(np.any)
    all = _through(np.all)
    clip = _through(np.clip)
    round = _through(np.round)
    cumsum = _through(np.cumsum)
    cumprod = _through(np.cumprod)
    trace = _through(np.trace)
    diagonal = _through(np.diagonal)
    repeat = _through(np.repeat)
    argmax = _through(np.argmax)
    argmin = _through(np.argmin)
    argsort = _through(np.argsort)
    nonzero = _through(np.nonzero)
    sort = _through(np.sort)


def is_recorded(*values: Any) -> bool:
    """Tell whether any value is a Scalar, a RecordedArray or another object array."""
    for value in values:
        if type(value) is Scalar or (isinstance(value, np.ndarray) and value.dtype == object):
            return True
    return False


def plain(value: Any) -> Any:
    """Give a value to NumPy's own loops: recorded arrays as plain object arrays, also inside
    lists, tuples and dicts; a Scalar as an object array of shape ().
    """
    if isinstance(value, RecordedArray):
        return value.view(np.ndarray)
    if type(value) is Scalar:
        box = np.empty((), dtype=object)
        box[()] = value
        return box
    if type(value) in (list, tuple):
        return type(value)(plain(item) for item in value)
    if type(value) is dict:
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind == "c":
        raise RecordingError("complex arrays cannot be recorded. Keep real and imaginary apart.")
    return value


def wrap(result: Any) -> Any:
    """Take a result of NumPy's own loops back: the inverse of `plain`."""
    if isinstance(result, np.ndarray):
        if result.dtype != object:
            return result
        return result.item() if result.ndim == 0 else result.view(RecordedArray)
    if type(result) in (list, tuple):
        return type(result)(wrap(item) for item in result)
    return result


def apply_ufunc(ufunc: np.ufunc, method: str, inputs: Sequence[Any], kwargs: dict[str, Any]) -> Any:
    """Apply a NumPy ufunc, or one of its methods, to values of which some are recorded."""
    kwargs = dict(kwargs)
    out = kwargs.pop("out", None)
    loop = elementwise.loop_of(ufunc)
    if kwargs.pop("where", True) is not True:
        raise RecordingError(
            f"np.{ufunc.__name__}(..., where=mask) cannot be recorded. "
            "Use gni.where(condition, a, b)."
        )
    dtype = kwargs.pop("dtype", None)
    if dtype is not None and np.dtype(dtype).kind not in "fO":
        raise RecordingError(f"dtype={np.dtype(dtype)} cannot be recorded: it needs numbers.")
    arrays = [plain(value) for value in inputs]
    if method == "__call__":
        result = elementwise.call(loop, ufunc, arrays, kwargs)
    elif method == "reduce":
        result = elementwise.reduce(loop, ufunc, arrays[0], kwargs)
    elif method == "at":
        if arrays[0].dtype != object:
            raise RecordingError(_FLOAT_TARGET)
        loop.at(*arrays, **kwargs)
        return None
    else:
        result = getattr(loop, method)(*arrays, **kwargs)
    if out is not None and out[0] is not None:
        return _store(out[0], result)
    return wrap(result)


def _store(target: Array, result: Any) -> Array:
    if target.dtype != object:
        raise RecordingError(_FLOAT_TARGET)
    target[...] = result
    return target


def apply_array_function(func: Callable[..., Any], args: Any, kwargs: Any) -> Any:
    """Apply a NumPy function that is not a ufunc to values of which some are recorded."""
    # The table is built on this module, so it can only be looked up when it is needed.
    from groupoid_gni.expressions.array_functions import NATIVE, OWN

    own = OWN.get(func)
    if own is not None:
        return own(*args, **kwargs)
    if func in NATIVE:
        return wrap(func(*plain(tuple(args)), **plain(dict(kwargs))))
    name = f"{func.__module__}.{func.__name__}".replace("numpy.", "np.", 1)
    raise RecordingError(
        f"{name} cannot be recorded: its result depends on the values in a way that is not a "
        "fixed expression, or it is not supported here. Use arithmetic, gni.where or another "
        "NumPy function."
    )
