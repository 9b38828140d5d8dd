"""Single panels: each draws one quantity of a trajectory into an axes object and returns it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.trajectory import Trajectory

INK = "#22303c"
BLUE = "#2f6fab"
RED = "#c8553d"
GOLD = "#d9a441"
GREEN = "#4d8f6b"
COLOURS = (BLUE, RED, GOLD, GREEN, "#7d5ba6", "#5b8c9c")
_MOST_POINTS = 20000


@contextmanager
def style() -> Iterator[None]:
    """The library's look, for the length of a ``with`` block; global settings are restored."""
    settings = {
        "axes.prop_cycle": f"cycler('color', {list(COLOURS)})",
        "axes.edgecolor": INK,
        "axes.labelcolor": INK,
        "axes.titlesize": 10.5,
        "axes.titlelocation": "left",
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": "#e3e7ea",
        "grid.linewidth": 0.7,
        "font.size": 9.0,
        "legend.frameon": False,
        "lines.linewidth": 1.4,
        "xtick.color": INK,
        "ytick.color": INK,
        "savefig.dpi": 150,
    }
    with mpl.rc_context(settings):
        yield


def _thinned(run: Trajectory) -> slice:
    return slice(None, None, max(1, len(run) // _MOST_POINTS))


def _logarithmic(axes: Any, times: FloatArray, values: FloatArray, **options: Any) -> None:
    # zero has no place on a logarithmic axis; show it at the round-off floor instead
    axes.semilogy(times, np.maximum(np.abs(values), 1e-17), **options)


def plot_path(axes: Any, path: FloatArray, **options: Any) -> Any:
    """A planar path, (n, 2), with its start (circle) and end (triangle) marked."""
    (line,) = axes.plot(path[:, 0], path[:, 1], **options)
    axes.plot(*path[0], "o", color=line.get_color(), markersize=5)
    axes.plot(*path[-1], "^", color=line.get_color(), markersize=6)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    return axes


def plot_energy(axes: Any, run: Trajectory, **options: Any) -> Any:
    """Change of the energy since the start, relative to its largest value."""
    energy, part = run.energy(), _thinned(run)
    scale = float(np.max(np.abs(energy))) or 1.0
    _logarithmic(axes, run.times[part], ((energy - energy[0]) / scale)[part], **options)
    axes.set_title("relative energy change")
    axes.set_xlabel("t")
    return axes


def plot_constraints(axes: Any, run: Trajectory, **options: Any) -> Any:
    """Largest relative constraint residual at every node."""
    part = _thinned(run)
    worst = np.max(np.abs(run.constraint_residuals(relative=True)), axis=1, initial=0.0)
    _logarithmic(axes, run.times[part], worst[part], **{"linewidth": 0.6, **options})
    axes.set_ylim(1e-17, 1e-12 if np.max(worst) < 1e-13 else None)
    axes.set_title("constraint residual (relative)")
    axes.set_xlabel("t")
    return axes


def plot_velocities(axes: Any, run: Trajectory, **options: Any) -> Any:
    """All velocity components over time."""
    part = _thinned(run)
    for a in range(run.velocities.shape[1]):
        axes.plot(run.times[part], run.velocities[part, a], label=f"{a}", **options)
    axes.set_title("velocity components")
    axes.set_xlabel("t")
    axes.legend(ncols=2, fontsize=8)
    return axes
