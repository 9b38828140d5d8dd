"""What a scene hands over."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from groupoid_gni.array_types import FloatArray
from groupoid_gni.systems import MechanicalSystem, State


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
