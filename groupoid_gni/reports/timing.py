"""Warm run times: interleaved repeats and what they say."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

_SHORT, _SLOW, _VERY_SLOW = 1e-3, 0.02, 0.5
_BURST = 4
_TURNS_OF_SLOW = 3


@dataclass(frozen=True)
class RunTimes:
    """Seconds of the repeats of one run."""

    seconds: tuple[float, ...]

    @property
    def smallest(self) -> float:
        """The least disturbed repeat."""
        return min(self.seconds)

    @property
    def median(self) -> float:
        """The middle one."""
        return float(np.median(self.seconds))

    @property
    def spread(self) -> float:
        """Distance of the quartiles, relative to the median."""
        low, high = np.percentile(self.seconds, [25.0, 75.0])
        return float((high - low) / self.median) if self.median else 0.0


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this thread, and threads it starts, on the last core it may use; where that is possible.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)


def interleaved(runs: Sequence[Callable[[], float]], repeats: int) -> list[RunTimes]:
    """Every run once in each turn; four times if below 1 ms, in three turns only if above 20 ms, in
    one if above 0.5 s.

    runs : each integrates once and returns the seconds of its loop.
    """
    seconds: list[list[float]] = [[] for _ in runs]
    for turn in range(repeats):
        for run, found in zip(runs, seconds, strict=True):
            if turn and found[0] > (_SLOW if turn >= _TURNS_OF_SLOW else _VERY_SLOW):
                continue
            found.append(run())
            if found[-1] < _SHORT:
                found += [run() for _ in range(_BURST - 1)]
    return [RunTimes(tuple(found)) for found in seconds]
