"""Derivatives of plain functions without recording: a second road to everything derived."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray

STEP = 2.0**-9
"""Truncation 576 h^8 / R^9 stays below round-off 1e-16 / h for radii of convergence R > 0.3."""

_WEIGHTS = (4.0 / 5.0, -1.0 / 5.0, 4.0 / 105.0, -1.0 / 280.0)
_COMPLEX_STEP = 1e-100  # its square underflows to nothing

Function = Callable[[Any], Any]


def central_difference(
    function: Function, x: ArrayLike, directions: ArrayLike | None = None, *, step: float = STEP
) -> FloatArray:
    """The derivative of a function by central differences of order eight.

    function : of one array of the shape of x; called at up to four steps from x.
    directions : shape (count, *x.shape); the unit vectors of a vector x when left out.
    step : multiplies the directions.  Good to 1e-13 or so for functions of size 1.
    Returns the derivative along each direction, shape (*output shape, count).
    """
    x, directions = _checked(x, directions)
    columns = []
    for direction in directions:
        terms = [
            weight * (_value(function, x + k * step * direction)
                      - _value(function, x - k * step * direction))
            for k, weight in enumerate(_WEIGHTS, start=1)
        ]
        columns.append(sum(terms) / step)
    return np.stack(columns, axis=-1)


def complex_step(
    function: Function, x: ArrayLike, directions: ArrayLike | None = None
) -> FloatArray:
    """The derivative from one complex step, exact to round-off: ``Im f(x + i h d) / h``.

    function : analytic and able to take complex arrays (no abs, no comparison).
    The rest is as for ``central_difference``.
    """
    x, directions = _checked(x, directions)
    columns = [
        np.imag(np.asarray(function(x + 1j * _COMPLEX_STEP * direction))) / _COMPLEX_STEP
        for direction in directions
    ]
    return np.stack(columns, axis=-1)


def _value(function: Function, x: FloatArray) -> FloatArray:
    return np.asarray(function(x), dtype=np.float64)


def _checked(
    x: ArrayLike, directions: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    point = np.array(x, dtype=np.float64)
    chosen = np.eye(point.size) if directions is None else np.array(directions, dtype=np.float64)
    return point, chosen.reshape(-1, *point.shape)
