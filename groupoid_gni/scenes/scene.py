"""What a scene hands over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.systems import MechanicalSystem, State, real_array


@dataclass(frozen=True)
class Scene:
    """A system, a start and, where one is known, the exact motion.

    description : what is modelled, and what was left out because nothing depends on it.
    exact : times (n,) -> (base (n, base_size), velocity (n, rank)), or None.
    """

    system: MechanicalSystem
    start: State
    description: str
    exact: Callable[[FloatArray], tuple[FloatArray, FloatArray]] | None = None


def checked_numbers(name: str, given: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """An argument of a scene as finite floats of the given shape.

    Raises InputError saying what is wrong with it.
    """
    numbers = real_array(name, given)
    if numbers.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {numbers.shape}")
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{name} must be finite, got {numbers}")
    return numbers
