"""Functions for users' models, that work on floats and while a function is being recorded.

Takes floats, float arrays of any shape, or recorded values; gives the same kind back.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.expressions.array import RecordedArray, is_recorded
from groupoid_gni.expressions.scalar import Scalar

__all__ = ["array", "series_guarded", "where"]


def array(values: ArrayLike) -> Array:
    """Make an array, as np.array; a RecordedArray if something in it is recorded.

    A fresh np.array([...]) of recorded values is an ordinary object array: it cannot be inverted,
    compared or passed to np.sin next to plain numbers. This one can.

    Returns : float64 array or RecordedArray.
    Raises InputError if the nesting is ragged or an entry is not a real number.
    """
    try:
        made = np.array(values)
    except ValueError as error:
        raise InputError(f"gni.array: {error}") from error
    if made.dtype.kind in "fiub":
        return made.astype(np.float64)
    if made.dtype != object:
        raise InputError(f"gni.array needs real numbers; dtype {made.dtype} came.")
    for entry in made.flat:
        if type(entry) is not Scalar and not isinstance(entry, (float, int, np.number, np.bool_)):
            raise InputError(f"gni.array needs real numbers; {entry!r} came.")
    return made.view(RecordedArray)


def where(condition: Any, a: Any, b: Any) -> Any:
    """Take `a` where the condition holds, else `b`; all three broadcast.

    Works on floats and while recording. Both branches are evaluated, and both must stay finite
    with finite derivatives: an infinite derivative in the branch not taken still gives NaN.
    """
    values = [array(v) if isinstance(v, (list, tuple)) else v for v in (condition, a, b)]
    if not is_recorded(*values):
        return np.where(*values)[()]
    # np.asarray drops the subclass, a view brings it back: also for fresh object arrays.
    recorded = [v.view(RecordedArray) if isinstance(v, np.ndarray) and v.dtype == object else v
                for v in values]  # fmt: skip
    return np.where(*recorded)


def _horner(s: Any, coefficients: Sequence[float]) -> Any:
    value: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * s + coefficient
    return value


def series_guarded(
    s: Any, threshold: float, coefficients: Sequence[float], closed: Callable[[Any], Any]
) -> Any:
    """Evaluate an entire function of s >= 0: a polynomial below the threshold, else `closed`.

    s : float, array of any shape, or recorded.
    coefficients : those of s^0, s^1, ... of the power series at 0.
    closed : the closed form; called only with values >= threshold.

    Each branch sees s pushed to its own side of the threshold, so neither value nor derivative of
    the branch not taken can become infinite.
    """
    if not is_recorded(s):
        s = np.asarray(s, dtype=np.float64)
    near = s < threshold
    return where(
        near,
        _horner(where(near, s, threshold), coefficients),
        closed(where(near, threshold, s)),
    )
