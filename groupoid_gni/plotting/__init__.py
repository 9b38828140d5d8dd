"""Pictures of trajectories and laws. The only room that imports matplotlib.

Takes Trajectories and arrays, gives axes and figures; shows and writes nothing.
"""

from groupoid_gni.plotting.drift_panel import plot_drift
from groupoid_gni.plotting.law_figure import plot_laws
from groupoid_gni.plotting.panels import (
    plot_constraints,
    plot_energy,
    plot_path,
    plot_velocities,
    style,
)
from groupoid_gni.plotting.trajectory_figure import plot_trajectory

__all__ = [
    "plot_constraints",
    "plot_drift",
    "plot_energy",
    "plot_laws",
    "plot_path",
    "plot_trajectory",
    "plot_velocities",
    "style",
]
