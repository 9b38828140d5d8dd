"""An energy record with what the drift verdict makes of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.diagnostics import Drift, DriftReport, energy_drift
from groupoid_gni.plotting.panels import BLUE, RED
from groupoid_gni.systems import real_array
from groupoid_gni.trajectory import Trajectory

_COLUMNS = 600


def plot_drift(
    axes: Any, record: Trajectory | ArrayLike, energy: ArrayLike | None = None, **options: Any
) -> Any:
    """Energy minus its first value, as a band of extremes, and the law the verdict gives it.

    record, energy, options : as for ``gni.diagnostics.energy_drift``. Drawn over the band: the line
    of a linear drift, plus and minus ``sqrt(2 D t)`` of a random walk, the level of a flat record;
    nothing when undecided.
    """
    report = energy_drift(record, energy, **options)
    if isinstance(record, Trajectory):
        times = record.times
        values = record.energy() if energy is None else real_array("energy", energy)
    else:
        times, values = real_array("times", record), real_array("energy", energy)
    change = values - values[0]
    middles, low, high = _extremes(times, change)
    axes.fill_between(middles, low, high, color=BLUE, alpha=0.45, linewidth=0.0)
    axes.plot(middles, low, color=BLUE, linewidth=0.5)
    axes.plot(middles, high, color=BLUE, linewidth=0.5)
    _draw_law(axes, report, times, change)
    axes.set_title(f"{report.verdict.value}{_law(report)}")
    axes.set_ylabel("energy change")
    axes.set_xlabel("t")
    return axes


def _extremes(times: FloatArray, change: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean time, smallest and largest change of each of up to 600 pieces."""
    pieces = min(_COLUMNS, len(times))
    cuts = np.linspace(0, len(times), pieces + 1).astype(int)[:-1]
    counts = np.diff(np.append(cuts, len(times)))
    middles = np.add.reduceat(times, cuts) / counts
    return middles, np.minimum.reduceat(change, cuts), np.maximum.reduceat(change, cuts)


def _law(report: DriftReport) -> str:
    if report.verdict is Drift.LINEAR:
        return f", {report.rate:.3g} per time"
    return f", D = {report.diffusion:.2g}" if report.verdict is Drift.RANDOM_WALK else ""


def _draw_law(axes: Any, report: DriftReport, times: FloatArray, change: FloatArray) -> None:
    level = float(np.mean(change))
    ends = np.array([times[0], times[-1]])
    if report.verdict is Drift.LINEAR:
        axes.plot(ends, level + report.rate * (ends - np.mean(times)), color=RED)
    elif report.verdict is Drift.RANDOM_WALK:
        since = np.linspace(times[0], times[-1], 200)
        spread = np.sqrt(2.0 * report.diffusion * np.abs(since - times[0]))
        axes.plot(since, spread, color=RED)
        axes.plot(since, -spread, color=RED)
    elif report.verdict is Drift.FLAT:
        axes.plot(ends, [level, level], color=RED)
