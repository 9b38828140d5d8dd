"""Figures of the report: energy over long runs, and cost against size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from groupoid_gni.array_types import FloatArray
from groupoid_gni.plotting.panels import style
from groupoid_gni.plotting.work_precision_figure import sparse_ticks

_POINTS = 300
_FLOOR = 1e-17


def plot_energy_records(
    panels: Mapping[str, Mapping[str, tuple[FloatArray, FloatArray]]], ylabel: str
) -> Any:
    """Largest error of the energy up to a time, log-log; one panel per title.

    panels : title -> name -> (times, errors), both (n,); the same names in every panel.
    Returns the figure.
    """
    with style():
        figure = Figure(figsize=(5.2 * len(panels), 3.9), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, (title, records) in zip(grid, panels.items(), strict=True):
            for name, (times, errors) in records.items():
                largest = np.maximum(np.maximum.accumulate(np.abs(errors)), _FLOOR)
                picks = np.unique(np.geomspace(1, len(times) - 1, _POINTS).astype(int))
                axes.loglog(times[picks], largest[picks], label=name)
            axes.set_title(title)
            axes.set_xlabel("t")
        grid[0].set_ylabel(ylabel)
        named = grid[0].get_legend_handles_labels()
        figure.legend(*named, loc="outside lower center", ncols=5, fontsize=7.5)
        return figure


def plot_scaling(
    sizes: Sequence[int], panels: Mapping[str, Sequence[float]], xlabel: str, slope: float
) -> Any:
    """Quantities against a size, log-log, with a line of the given slope through the first panel.

    panels : label of the vertical axis -> values.  Returns the figure.
    """
    with style():
        figure = Figure(figsize=(4.6 * len(panels), 3.4), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(panels), squeeze=False)[0]
        n = np.asarray(sizes, dtype=float)
        for k, (axes, (label, values)) in enumerate(zip(grid, panels.items(), strict=True)):
            axes.loglog(n, values, "o-")
            if k == 0:
                middle = len(n) // 2
                line = values[middle] * (n / n[middle]) ** slope
                axes.loglog(n, line, ":", color="0.4", label=f"slope {slope:.2f}")
                axes.legend(fontsize=8)
            axes.set_xlabel(xlabel)
            axes.set_ylabel(label)
            sparse_ticks(axes)
        return figure
