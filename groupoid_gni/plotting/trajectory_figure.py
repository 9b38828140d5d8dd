"""One figure that shows a whole trajectory: motion, velocities, energy, constraint."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from groupoid_gni.errors import InputError
from groupoid_gni.plotting.panels import (
    plot_constraints,
    plot_energy,
    plot_path,
    plot_velocities,
    style,
)
from groupoid_gni.trajectory import Trajectory


def plot_trajectory(run: Trajectory, axes: Any = None) -> Any:
    """Motion in the base, velocities, energy change and constraint residual.

    axes : four axes objects in that order; a new figure is made when left out.
    Returns the matplotlib figure; nothing is shown or written.
    """
    with style():
        if axes is None:
            figure = Figure(figsize=(9.5, 6.2), layout="constrained")
            FigureCanvasAgg(figure)
            panels = figure.subplots(2, 2).ravel()
            figure.suptitle(f"{run.method_name}, step {run.step_size:g}", fontsize=10)
        else:
            panels = np.ravel(axes)
            if len(panels) != 4:
                raise InputError(f"plot needs four axes objects, got {len(panels)}")
            figure = panels[0].figure
        _plot_motion(panels[0], run)
        plot_velocities(panels[1], run)
        plot_energy(panels[2], run)
        if run.system.constraint_count:
            plot_constraints(panels[3], run)
        else:
            panels[3].set_axis_off()
    return figure


def _plot_motion(axes: Any, run: Trajectory) -> None:
    """The first two base coordinates as a path, one over time, or momenta over a point."""
    if run.base.shape[1] >= 2:
        plot_path(axes, run.base[:, :2])
        axes.set_title("base point, first two coordinates")
        return
    if run.base.shape[1] == 1:
        axes.plot(run.times, run.base[:, 0])
        axes.set_title("base point")
    else:
        axes.plot(run.times, run.momenta)
        axes.set_title("momentum components")
    axes.set_xlabel("t")
