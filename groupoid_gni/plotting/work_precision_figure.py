"""Error against time, and error against step size, for many methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from groupoid_gni.errors import InputError
from groupoid_gni.plotting.panels import style

# as many as do not divide the number of colours: no two peers look alike
_MARKS = "osD^vP*"


@dataclass(frozen=True)
class WorkCurve:
    """One method.

    seconds, errors : of its settings, from loose to strict.  resolved : whether an error is a
    number, or else a bound.  steps : step sizes, empty for adaptive methods.  order : the observed
    one, as text.  is_peer : drawn dashed.
    """

    name: str
    seconds: Sequence[float]
    errors: Sequence[float]
    resolved: Sequence[bool]
    steps: Sequence[float] = ()
    order: str = ""
    is_peer: bool = False


def plot_work_precision(
    curves: Sequence[WorkCurve], title: str, ylabel: str, axes: Any = None
) -> Any:
    """Two panels: error against time, error against step; hollow marks are bounds.

    axes : two axes objects; a new figure is made when left out. Returns the figure.
    """
    with style():
        if axes is None:
            figure = Figure(figsize=(10.5, 4.6 + 0.11 * len(curves)), layout="constrained")
            FigureCanvasAgg(figure)
            panels = figure.subplots(1, 2, sharey=True)
            figure.suptitle(title, fontsize=10)
        else:
            panels = np.ravel(axes)
            if len(panels) != 2:
                raise InputError(f"plot needs two axes objects, got {len(panels)}")
            figure = panels[0].figure
        by_time, by_step = panels
        for curve, look in zip(curves, _looks(curves), strict=True):
            label = f"{curve.name}: {curve.order}" if curve.order else curve.name
            _draw(by_time, 1e6 * np.asarray(curve.seconds), curve, look)
            if len(curve.steps):
                _draw(by_step, np.asarray(curve.steps), curve, look)
            by_time.plot([], [], label=label, **look)
        _finish(by_time, "microseconds of one warm run", ylabel)
        _finish(by_step, "step size", "")
        if axes is None:
            figure.legend(
                *by_time.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                fontsize=7.5, title="observed orders with 95 % intervals", title_fontsize=7.5,
            )
        else:
            by_time.legend(fontsize=6.5)
    return figure


def _looks(curves: Sequence[WorkCurve]) -> list[dict[str, Any]]:
    """Own methods in a sequence of colours, solid; peers in muted colours, dashed."""
    own = mpl.colormaps["turbo"]
    others = mpl.colormaps["Dark2"]
    count = {peer: sum(curve.is_peer is peer for curve in curves) for peer in (False, True)}
    looks, seen = [], {False: 0, True: 0}
    for curve in curves:
        peer = curve.is_peer
        k, n = seen[peer], max(count[peer] - 1, 1)
        seen[peer] += 1
        looks.append({
            "color": others(k % others.N) if peer else own(0.06 + 0.88 * k / n),
            "linestyle": "--" if peer else "-",
            "linewidth": 1.0 if peer else 1.5,
            "marker": _MARKS[k % len(_MARKS)],
            "markersize": 3.5 if peer else 4.5,
        })  # fmt: skip
    return looks


def _draw(axes: Any, across: Any, curve: WorkCurve, look: dict[str, Any]) -> None:
    errors, resolved = np.asarray(curve.errors), np.asarray(curve.resolved, dtype=bool)
    axes.loglog(across, errors, **{**look, "marker": ""})
    marks = {**look, "linestyle": ""}
    axes.loglog(across[resolved], errors[resolved], **marks)
    axes.loglog(across[~resolved], errors[~resolved], **marks, markerfacecolor="white")


def _finish(axes: Any, xlabel: str, ylabel: str) -> None:
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.grid(visible=True, which="major")
    sparse_ticks(axes)


def sparse_ticks(axes: Any) -> None:
    """Numbers at powers of ten only, or at 1, 2, 5 where there is less than a decade."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_minor_formatter(NullFormatter())
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        if high < 200.0 * low:
            # less than two decades may hold a single power of ten
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
