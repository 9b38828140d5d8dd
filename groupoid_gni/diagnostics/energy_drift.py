"""Does an energy stay, drift or wander? A verdict with intervals, or an honest "undecided".

A nonholonomic integrator of order 2 keeps the energy near its value on reversible problems, lets it
drift like h^2 t on others (Modin and Verdier, Numer. Math. 145, 2020), and lets it wander like a
random walk on chaotic ones. The three look alike over short times.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.diagnostics.block_means import (
    BlockFit,
    block_means,
    normal_quantile,
    student_quantile,
)
from groupoid_gni.errors import InputError
from groupoid_gni.systems import real_array
from groupoid_gni.trajectory import Trajectory

_BLOCKS = (64, 48, 32, 24, 16)
_LEAST_SAMPLES = 8
_MISFIT = 1e-3
_NEARLY_STEADY = 0.5
_ESCAPE = 1e3
_IMMATERIAL = 1e-5
_ROUND_OFF = 8.0
_EPSILON = float(np.finfo(float).eps)
Interval = tuple[float, float]


class Drift(Enum):
    """What an energy does in the long run."""

    FLAT = "flat"
    LINEAR = "linear drift"
    RANDOM_WALK = "random walk"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class DriftReport:
    """What an energy record of a given duration does in the long run.

    verdict : Drift.  reason : why, in words.
    rate, rate_interval : energy per time, random walk allowed for in the interval.
    diffusion, diffusion_interval : D in ``Var(E(t) - E(0)) = 2 D t``, energy^2 per time.
    exponent, exponent_interval : growth of the mean squared increment with the lag; 0 for flat,
        1 for a random walk, 2 for a linear drift.
    bound : largest systematic change over the record that the rate interval allows.
    swing : largest minus smallest energy.
    duration : of the record.  blocks : means the verdict rests on (0: none).
    confidence : of the intervals and the tests.  step : h, if known.

    NaN where the record is too short or constant.
    """

    verdict: Drift
    reason: str
    rate: float
    rate_interval: Interval
    diffusion: float
    diffusion_interval: Interval
    exponent: float
    exponent_interval: Interval
    bound: float
    swing: float
    duration: float
    blocks: int
    confidence: float
    step: float | None

    @property
    def rate_over_step_squared(self) -> float:
        """Coefficient c of a rate ``c h^2``; NaN when the step is not known."""
        return float("nan") if self.step is None else self.rate / self.step**2

    def __str__(self) -> str:
        text = f"{self.verdict.value}: {self.reason}"
        if self.verdict is Drift.LINEAR and self.step is not None:
            text += f"; rate = {self.rate_over_step_squared:.3g} h^2"
        return text


def energy_drift(
    record: Trajectory | ArrayLike,
    energy: ArrayLike | None = None,
    *,
    step: float | None = None,
    confidence: float = 0.99,
) -> DriftReport:
    """Tell flat, linear drift and random walk apart.

    record : a run, or evenly spaced times (n,).
    energy : (n,) values; the energy of the run when left out (another record of the run, such as a
        moving energy, may be given).
    step : step size, for the coefficient of h^2; taken from a run.
    confidence : of intervals and tests, between 0.5 and 1.

    The record is cut into 64 to 16 blocks, the most for which the block means agree with the model
    of ``block_means``. Linear: the slope differs from zero with the random walk allowed for. Random
    walk: the likelihood needs one. Flat: neither. Where no number of blocks agrees, a change whose
    rates in the three thirds are within a factor of two is linear, with an interval that spans
    them; anything else is undecided, as is a record below 128 samples. Means that move by what
    round-off makes in so many steps, or wander by less than 1e-5 of the swing, are flat. A record
    that leaves all bounds in its last quarter is undecided, and the reason says so.
    Raises InputError when times are not evenly spaced or values not finite.
    """
    if not 0.5 < confidence < 1.0:
        raise InputError(f"confidence must lie between 0.5 and 1, got {confidence!r}")
    times, values, steps, scale = _checked_record(record, energy)
    if step is None and isinstance(record, Trajectory):
        step = record.step_size
    duration = float(abs(times[-1] - times[0])) if len(times) else 0.0
    swing = float(np.ptp(values)) if len(values) else 0.0
    common = (swing, duration, confidence, step)
    floor = _ROUND_OFF * _EPSILON * scale * np.sqrt(max(steps, 1))
    if swing == 0.0 and len(values) >= _BLOCKS[-1] * _LEAST_SAMPLES:
        zero = (0.0, 0.0)
        return _report(Drift.FLAT, "constant", (0.0, zero), (0.0, zero), _UNKNOWN, 0, *common)
    fit, fits = _fitted(values)
    if fit is None:
        reason = f"{len(values)} samples; at least {_BLOCKS[-1] * _LEAST_SAMPLES} are needed"
        return _report(Drift.UNDECIDED, reason, _UNKNOWN, _UNKNOWN, _UNKNOWN, 0, *common)
    block_time = fit.length * (times[1] - times[0])
    margin = student_quantile(confidence, fit.freedom) * fit.slope_deviation
    rate = _scaled(fit.slope, (fit.slope - margin, fit.slope + margin), block_time)
    walk = _scaled(fit.walk_variance, fit.walk_interval(confidence), 2.0 * abs(block_time))
    change = float(np.ptp(fit.means))
    escape = _escape(times, values)
    if escape:
        verdict, reason = Drift.UNDECIDED, escape
    elif change <= floor:
        verdict, reason = Drift.FLAT, f"to round-off, the means change by {change:.1e}"
    elif fits:
        verdict, reason = _verdict(fit, margin, confidence, rate, walk)
        if verdict is Drift.RANDOM_WALK and change < _IMMATERIAL * swing:
            verdict = Drift.FLAT
            reason = f"the means wander by {change:.1e}, {change / swing:.0e} of the swing"
    else:
        verdict, reason, rate = _misfit(fit, block_time, rate)
    blocks = len(fit.means)
    return _report(verdict, reason, rate, walk, fit.exponent(confidence), blocks, *common)


def _escape(times: FloatArray, values: FloatArray) -> str:
    """Whether the last quarter leaves by far what was kept before; nothing slower does that."""
    reached = np.maximum.accumulate(np.abs(values - values[0]))
    kept = reached[3 * len(values) // 4]
    if reached[-1] <= _ESCAPE * kept:
        return ""
    since = times[np.argmax(reached > _ESCAPE * kept)]
    return (
        f"the record leaves all bounds: from t = {since:g} on it is more than {_ESCAPE:.0f} times "
        "as far from its start as in the first three quarters; the run broke down there"
    )


_Estimate = tuple[float, Interval]
_UNKNOWN: _Estimate = (float("nan"), (float("nan"), float("nan")))


def _report(
    verdict: Drift,
    reason: str,
    rate: _Estimate,
    walk: _Estimate,
    exponent: _Estimate,
    blocks: int,
    swing: float,
    duration: float,
    confidence: float,
    step: float | None,
) -> DriftReport:
    return DriftReport(
        verdict, reason, *rate, *walk, *exponent,
        bound=float(np.max(np.abs(rate[1]))) * duration, swing=swing, duration=duration,
        blocks=blocks, confidence=confidence, step=step,
    )


def _scaled(value: float, interval: Interval, unit: float) -> _Estimate:
    low, high = sorted((interval[0] / unit, interval[1] / unit))
    return value / unit, (low, high)


def _checked_record(
    record: Trajectory | ArrayLike, energy: ArrayLike | None
) -> tuple[FloatArray, FloatArray, int, float]:
    """Times and values of the even part, steps they took, and the size of the energies."""
    if isinstance(record, Trajectory):
        times = record.times
        values = record.energy() if energy is None else real_array("energy", energy)
        steps = int(record.node_steps[-1])
        kinetic = np.sum(record.momenta * record.velocities, axis=1) / 2.0
    else:
        if energy is None:
            raise InputError("energy is missing: call energy_drift(run) or (times, energy)")
        times, values = real_array("times", record), real_array("energy", energy)
        steps, kinetic = times.size, np.zeros(times.size)
    if times.ndim != 1 or times.shape != values.shape:
        raise InputError(
            f"times and energy must have one and the same shape (n,), got {times.shape} and "
            f"{values.shape}"
        )
    if not (np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise InputError("times and energy must be finite; cut the record where the run failed")
    gaps = np.diff(times)
    if len(gaps) > 1:
        # a run that ends between two saved nodes has one shorter interval at its end
        if abs(gaps[-1] - gaps[0]) > 1e-6 * abs(gaps[0]):
            times, values, gaps = times[:-1], values[:-1], gaps[:-1]
        if not gaps[0] or np.max(np.abs(gaps - gaps[0])) > 1e-6 * abs(gaps[0]):
            raise InputError("times must be evenly spaced, one after the other")
    sizes = [np.max(np.abs(v[: len(values)]), initial=0.0) for v in (kinetic, values)]
    return times, values, steps, float(max(sizes))


def _fitted(values: FloatArray) -> tuple[BlockFit | None, bool]:
    """The fit with most blocks that explains the means, else the one with fewest; and which."""
    fit = None
    for blocks in _BLOCKS:
        if len(values) < blocks * _LEAST_SAMPLES:
            continue
        fit = BlockFit(*block_means(values - values[0], blocks))
        if not np.std(fit.means):
            return fit, True
        explained = fit.slow_structure() > _MISFIT
        if fit.walk_statistic > normal_quantile(0.98) ** 2:
            explained = explained and fit.single_line() > _MISFIT
        if explained:
            return fit, True
    return fit, False


def _verdict(
    fit: BlockFit, margin: float, confidence: float, rate: _Estimate, walk: _Estimate
) -> tuple[Drift, str]:
    percent = f"{100 * confidence:g} %"
    # the walk variance lies on the edge of its range when there is none: half the usual chance
    wanders = fit.walk_statistic > normal_quantile(2.0 * confidence - 1.0) ** 2
    drifts = abs(fit.slope) > margin
    interval = f"{rate[1][0]:.3g} ... {rate[1][1]:.3g}"
    diffusing = f"D = {walk[0]:.3g} ({walk[1][0]:.2g} ... {walk[1][1]:.2g})"
    if drifts:
        reason = f"{rate[0]:.4g} per time ({percent}: {interval})"
        return Drift.LINEAR, reason + (f", with a random walk of {diffusing}" if wanders else "")
    if wanders:
        return Drift.RANDOM_WALK, f"{diffusing}, no drift beyond it ({percent}: {interval})"
    return Drift.FLAT, f"rate within {interval} per time ({percent})"


def _misfit(fit: BlockFit, block_time: float, rate: _Estimate) -> tuple[Drift, str, _Estimate]:
    """A verdict where the model fails: a drift whose rate changes a little, or none."""
    thirds = np.array_split(fit.means, 3)
    slopes = [float(np.polyfit(np.arange(len(part)), part, 1)[0] / block_time) for part in thirds]
    slow, fast = min(slopes, key=abs), max(slopes, key=abs)
    if min(slopes) * max(slopes) <= 0.0:
        reason = "changes as slow as the record is long; a longer run is needed"
        return Drift.UNDECIDED, reason, rate
    by_thirds = ", ".join(f"{slope:.3g}" for slope in slopes)
    if abs(slow) < _NEARLY_STEADY * abs(fast):
        reason = f"a steady change, but not at a steady rate: {by_thirds} per time by thirds"
        return Drift.UNDECIDED, reason, rate
    ends = (min(*slopes, rate[1][0]), max(*slopes, rate[1][1]))
    return Drift.LINEAR, f"{rate[0]:.4g} per time, by thirds {by_thirds}", (rate[0], ends)
