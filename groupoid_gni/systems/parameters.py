"""Named physical parameters and the flat vector they travel in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.systems.input_checks import real_array


class Parameters:
    """The physical parameters of a system, read as attributes: ``p.m``, ``p.Theta``."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        known = ", ".join(self.__dict__) or "none"
        raise AttributeError(f"the system has no parameter {name!r}; its parameters are: {known}")

    def __repr__(self) -> str:
        return "Parameters(" + ", ".join(f"{k}={v!r}" for k, v in self.__dict__.items()) + ")"


@dataclass(frozen=True)
class ParameterLayout:
    """How named parameters of fixed shapes lie in one flat vector."""

    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def size(self) -> int:
        """Length of the flat vector."""
        return sum(int(np.prod(shape)) for _, shape in self.shapes)

    def flatten(self, values: Mapping[str, FloatArray]) -> FloatArray:
        """One flat float vector from named values."""
        parts = [np.ravel(values[name]) for name, _ in self.shapes]
        return np.concatenate(parts) if parts else np.zeros(0)

    def namespace(self, flat: Array) -> Parameters:
        """Named views into a flat (possibly recorded) vector."""
        values, start = {}, 0
        for name, shape in self.shapes:
            size = int(np.prod(shape))
            part = flat[start : start + size]
            values[name] = part[0] if shape == () else part.reshape(shape)
            start += size
        return Parameters(values)


def checked_parameters(values: Mapping[str, Any]) -> Mapping[str, FloatArray]:
    """Finite real parameters with names that can be read as attributes, read-only."""
    if not isinstance(values, Mapping):
        raise InputError(
            f"parameters must be a mapping from names to numbers, such as dict(m=1.5), not "
            f"{values!r}"
        )
    checked = {}
    for name, value in values.items():
        if not isinstance(name, str) or not name.isidentifier() or name.startswith("__"):
            raise InputError(
                f"parameter name {name!r} cannot be read as p.name; use letters, digits and _"
            )
        array = np.array(real_array(f"parameter {name!r}", value))
        if not np.all(np.isfinite(array)):
            raise InputError(f"parameter {name!r} is not finite: {value!r}")
        array.setflags(write=False)
        checked[name] = array
    return MappingProxyType(checked)
