"""Between NumPy arrays of recorded numbers and CasADi expressions.

Takes one, gives the other. A flat column always holds the entries in C order (last index fastest);
CasADi matrices are stored column by column, so this is the only place that knows both orders.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import InputError
from groupoid_gni.expressions.array import RecordedArray
from groupoid_gni.expressions.scalar import Scalar, constant

__all__ = ["from_sx", "symbols", "to_sx", "to_sx_matrix"]


def symbols(name: str, shape: tuple[int, ...]) -> tuple[RecordedArray, ca.SX]:
    """Make fresh inputs.

    Returns the RecordedArray of the given shape, and the casadi.SX column, shape (size, 1), of the
    same symbols in C order.
    """
    column = ca.SX.sym(name, math.prod(shape), 1)
    return _array_of(column.elements(), shape), column


def _array_of(entries: Iterable[Any], shape: tuple[int, ...]) -> RecordedArray:
    # Constants become floats: arithmetic and elimination then see the structural zeros.
    flat = np.empty(math.prod(shape), dtype=object)
    for index, entry in enumerate(entries):
        flat[index] = float(entry) if entry.is_constant() else Scalar(entry)
    return flat.reshape(shape).view(RecordedArray)


def from_sx(column: ca.SX, shape: tuple[int, ...]) -> RecordedArray:
    """Give the RecordedArray of a column in C order (or of an SX matrix of that 2-d shape).

    Law: from_sx(to_sx(a, shape), shape) records the same entries as a.
    Raises InputError if the number of entries does not fit.
    """
    shape = tuple(shape)
    if column.shape == (math.prod(shape), 1):
        return _array_of(column.elements(), shape)
    if column.shape == shape:
        return _array_of(column.T.elements(), shape)
    raise InputError(f"from_sx: an SX of shape {column.shape} does not fill the shape {shape}.")


def _entries(value: Any, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise InputError(f"not an array of shape {shape}: {error}") from error
    if array.shape != tuple(shape):
        raise InputError(f"an array of shape {array.shape} came, shape {tuple(shape)} is expected.")
    if array.dtype.kind not in "fiubO":
        what = "complex numbers" if array.dtype.kind == "c" else f"dtype {array.dtype}"
        raise InputError(f"an array of real numbers is expected, not of {what}.")
    return array


def _expression(entry: Any) -> ca.SX:
    if type(entry) is Scalar:
        return entry.sx
    if isinstance(entry, np.ndarray) and entry.shape == ():
        return _expression(entry.item())
    if not isinstance(entry, (float, int, np.floating, np.integer, np.bool_)):
        raise InputError(f"an entry is {entry!r} (a {type(entry).__name__}), not a real number.")
    return constant(float(entry))


def _sparse(array: Array) -> ca.SX:
    """Give the SX of a 1-d or 2-d array; entries that are exactly zero are left out."""
    rows, columns, values = [], [], []
    # Column by column, the order in which CasADi stores the entries.
    flat = array.T.ravel()
    entries = flat.tolist()
    # most entries of a large matrix are zero
    if flat.dtype == float:
        places = np.flatnonzero(flat).tolist()
    else:
        places = [k for k, entry in enumerate(entries) if entry.__class__ is not float or entry]
    for index in places:
        value = _expression(entries[index])
        if not value.is_zero():
            rows.append(index % array.shape[0])
            columns.append(index // array.shape[0])
            values.append(value)
    width = 1 if array.ndim == 1 else array.shape[1]
    pattern = ca.Sparsity.triplet(array.shape[0], width, rows, columns)
    return ca.SX(pattern, ca.vertcat(*values)) if values else ca.SX(pattern)


def to_sx(value: Any, shape: tuple[int, ...]) -> ca.SX:
    """Give an array-like of floats and Scalars as an SX column in C order, shape (size, 1).

    Exact zeros are structurally zero.
    Raises InputError if the shape differs or an entry is not a real number.
    """
    return _sparse(_entries(value, shape).ravel())


def to_sx_matrix(value: Any, shape: tuple[int, int]) -> ca.SX:
    """Give an array-like of floats and Scalars as an SX matrix, exact zeros structurally zero.

    Raises InputError if the shape differs or an entry is not a real number.
    """
    return _sparse(_entries(value, shape))
