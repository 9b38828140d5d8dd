"""How other people's integrators take part in a comparison; who they are is not said here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from groupoid_gni.array_types import FloatArray


@dataclass(frozen=True)
class PeerRun:
    """What a peer did from the start to the end.

    seconds : of the integration alone, warm.
    base, velocity : (base_size,), (rank,) at the end, in the coordinates of the system.
    steps, evaluations : accepted steps and calls of the right-hand side, where known.
    """

    seconds: float
    base: FloatArray
    velocity: FloatArray
    steps: int | None = None
    evaluations: int | None = None


@dataclass(frozen=True)
class Peer:
    """Somebody else's integrator on the same problem.

    tolerances : from loose to strict.
    run : tolerance -> PeerRun. The first run of a tolerance may compile; its time is not counted.
        RuntimeError says that the integrator gave up.
    settings : how it is set up, in words.
    """

    name: str
    tolerances: tuple[float, ...]
    run: Callable[[float], PeerRun]
    settings: str = ""
