"""Orders from errors and step sizes; times to an error from errors and times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from groupoid_gni.array_types import FloatArray

_CONFIDENCE = 0.95
_FEWEST = 3
_SCATTER, _FLAT = 0.25, 0.9
_NOT_SMALL = 0.1


@dataclass(frozen=True)
class Slope:
    """An observed order: the slope of log error over log step by least squares.

    low, high : its 95 % confidence interval (Student), taking the scatter about a straight line
    for noise.  points : how many step sizes took part.
    """

    order: float
    low: float
    high: float
    points: int

    def __str__(self) -> str:
        return f"{self.order:.2f} ± {0.5 * (self.high - self.low):.2f}"


@dataclass(frozen=True)
class TimeTo:
    """Seconds to an error.

    at_most : the loosest setting that was run (and did not fail) reaches the error already, so less
        might do.
    """

    seconds: float
    at_most: bool = False

    def __str__(self) -> str:
        return f"{'<= ' if self.at_most else ''}{seconds_text(self.seconds)}"


def seconds_text(seconds: float) -> str:
    """Seconds with three digits and a unit."""
    for unit, name in ((1.0, "s"), (1e-3, "ms"), (1e-6, "us")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds * 1e9:.3g} ns"


def fitted_slope(
    steps: Sequence[float], errors: Sequence[float], resolved: Sequence[bool], size: float
) -> Slope | None:
    """The order in a table of step sizes and errors; None where fewer than three points tell it.

    resolved : whether an error is well above that of the reference.
    size : of the motion; errors above a tenth of it are not small and take no part.
    The points are the longest row of neighbours whose local slopes are within a quarter of their
    median: before it the step is too large for the leading term, after it there is round-off.
    """
    order = [k for k in np.argsort(steps)[::-1] if _tells(errors[k], resolved[k], size)]
    if len(order) < _FEWEST:
        return None
    logs = np.log([[abs(steps[k]), errors[k]] for k in order])
    differences = np.diff(logs, axis=0)
    first, last = _straight_row(differences[:, 1] / differences[:, 0])
    points = logs[first : last + 1]
    return _least_squares(points) if len(points) >= _FEWEST else None


def _tells(error: float, resolved: bool, size: float) -> bool:
    return bool(resolved and 0.0 < error <= _NOT_SMALL * size)


def _straight_row(local: FloatArray) -> tuple[int, int]:
    """The first and last point of the longest row of similar local slopes, (0, 0) if none.

    Of rows of the same length the one with the smallest steps.
    """
    best, place = 0, (0, 0)
    for first in range(len(local)):
        for last in range(first + 1, len(local) + 1):
            row = local[first:last]
            middle = float(np.median(row))
            similar = middle > _FLAT and np.all(np.abs(row - middle) <= _SCATTER * middle)
            if similar and last - first >= best:
                best, place = last - first, (first, last)
    return place


def _least_squares(logs: FloatArray) -> Slope:
    from scipy.special import stdtrit

    x, y = (logs - np.mean(logs, axis=0)).T
    spread = float(x @ x)
    order = float(x @ y) / spread
    freedom = len(logs) - 2
    scatter = float(np.sum((y - order * x) ** 2)) / freedom
    half = float(stdtrit(freedom, 0.5 + 0.5 * _CONFIDENCE)) * float(np.sqrt(scatter / spread))
    return Slope(order, order - half, order + half, len(logs))


def time_to(
    target: float, errors: Sequence[float], seconds: Sequence[float]
) -> TimeTo | None:
    """The time to an error; settings from loose to strict. None where no setting reaches it.

    An error counts as reached by a setting when the next stricter one reaches it too: one lucky
    zero of the error is no accuracy. Between settings that do not and that do, log time is
    interpolated in log error.
    """
    held = [max(pair) for pair in zip(errors, [*errors[1:], 0.0], strict=True)]
    reached = [k for k, error in enumerate(held) if error <= target]
    if not reached:
        return None
    k = reached[0]
    if k == 0:
        return TimeTo(seconds[0], at_most=held[0] < target)
    before, after = held[k - 1], held[k]
    if not np.isfinite(before) or after <= 0.0:
        return TimeTo(seconds[k], at_most=True)
    share = np.log(before / target) / np.log(before / after)
    log_time = (1.0 - share) * np.log(seconds[k - 1]) + share * np.log(seconds[k])
    return TimeTo(float(np.exp(log_time)))
