"""How the error of a quantity that is kept exactly grows: round-off like a random walk, or worse.

Unbiased rounding makes ``|E - E0|`` grow like the square root of the number of steps (Brouwer's
law); a biased rounding, or an iteration stopped early, makes it grow like the number itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.diagnostics.block_means import student_quantile
from groupoid_gni.errors import InputError
from groupoid_gni.systems import real_array
from groupoid_gni.trajectory import Trajectory

_SEGMENTS = 8
_LEAST_SAMPLES = 256
_EXPONENTS = np.linspace(0.02, 1.3, 257)


@dataclass(frozen=True)
class RoundoffGrowth:
    """Root mean square increments ``sqrt(2 noise^2 + (size lag^exponent)^2)`` over lags in steps.

    exponent, interval : 1/2 for a random walk, 1 for a steady loss; NaN for a constant record.
    size : growth in one step.  noise : of a single value, what evaluating it costs.
    confidence : of the interval, from a jackknife over 8 segments.
    """

    exponent: float
    interval: tuple[float, float]
    size: float
    noise: float
    confidence: float

    def after(self, steps: float) -> float:
        """Expected size of ``|E - E0|`` after that many steps, extrapolated."""
        return float(np.hypot(np.sqrt(2.0) * self.noise, self.size * steps**self.exponent))

    def __str__(self) -> str:
        low, high = self.interval
        return (
            f"grows like steps^{self.exponent:.2f} ({low:.2f} ... {high:.2f}), {self.size:.1e} in "
            f"one step, {self.noise:.1e} in a single value"
        )


def roundoff_growth(
    record: Trajectory | ArrayLike,
    values: ArrayLike | None = None,
    *,
    confidence: float = 0.95,
) -> RoundoffGrowth:
    """Exponent of the growth of the error of a quantity that the method keeps exactly.

    record : a run, or evenly spaced step numbers (n,).
    values : (n,) of the quantity; the energy of the run when left out.

    Increments over many lags are used rather than ``|E - E0|`` itself, which is a single path.
    Raises InputError for fewer than 256 values, values not finite, or nodes not evenly spaced.
    """
    steps, numbers = _checked(record, values)
    if not 0.5 < confidence < 1.0:
        raise InputError(f"confidence must lie between 0.5 and 1, got {confidence!r}")
    if not np.ptp(numbers):
        nan = float("nan")
        return RoundoffGrowth(nan, (nan, nan), 0.0, 0.0, confidence)
    segment = len(numbers) // _SEGMENTS
    pieces = numbers[: segment * _SEGMENTS].reshape(_SEGMENTS, segment) - numbers[0]
    lags = np.unique(np.logspace(0.0, np.log10(segment / 2.0), 24).astype(int))
    sizes = np.array(
        [np.mean((pieces[:, lag:] - pieces[:, :-lag]) ** 2, axis=1) for lag in lags]
    )
    spacing = abs(steps[1] - steps[0])
    exponent, size, noise = _fitted(lags * spacing, np.mean(sizes, axis=1))
    left_out = [
        _fitted(lags * spacing, np.mean(np.delete(sizes, k, axis=1), axis=1))[0]
        for k in range(_SEGMENTS)
    ]
    deviation = np.sqrt((_SEGMENTS - 1) * np.var(left_out))
    margin = student_quantile(confidence, _SEGMENTS - 1) * float(deviation)
    return RoundoffGrowth(
        exponent, (exponent - margin, exponent + margin), size, noise, confidence
    )


def _checked(
    record: Trajectory | ArrayLike, values: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    if isinstance(record, Trajectory):
        steps = record.node_steps.astype(float)
        numbers = record.energy() if values is None else real_array("values", values)
    elif values is None:
        raise InputError("values are missing: call roundoff_growth(run) or (steps, values)")
    else:
        steps, numbers = real_array("steps", record), real_array("values", values)
    if steps.ndim != 1 or steps.shape != numbers.shape:
        raise InputError(
            f"steps and values must have one shape (n,), got {steps.shape} and {numbers.shape}"
        )
    if len(numbers) < _LEAST_SAMPLES:
        raise InputError(f"{len(numbers)} values are too few; at least {_LEAST_SAMPLES} are needed")
    if not (np.all(np.isfinite(steps)) and np.all(np.isfinite(numbers))):
        raise InputError("steps and values must be finite; cut the record where the run failed")
    gaps = np.diff(steps)[:-1]
    if not gaps[0] or np.max(np.abs(gaps - gaps[0])) > 1e-6 * abs(gaps[0]):
        raise InputError("steps must be evenly spaced, one after the other")
    return steps[:-1], numbers[:-1]


def _fitted(lags: FloatArray, sizes: FloatArray) -> tuple[float, float, float]:
    """(exponent, size, noise) of ``2 noise^2 + (size lag^exponent)^2``, relative least squares."""
    best = (np.inf, 0.0, 0.0, 0.0)
    for exponent in _EXPONENTS:
        columns = np.stack([2.0 / sizes, lags ** (2.0 * exponent) / sizes], axis=1)
        found = np.linalg.lstsq(columns, np.ones(len(lags)), rcond=None)[0]
        if found[0] < 0.0:
            found = np.array([0.0, columns[:, 1].sum() / (columns[:, 1] ** 2).sum()])
        rest = float(np.sum((columns @ found - 1.0) ** 2))
        if found[1] > 0.0 and rest < best[0]:
            best = (rest, float(exponent), float(np.sqrt(found[1])), float(np.sqrt(found[0])))
    return best[1:]
