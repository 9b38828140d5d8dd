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
from groupoid_gni.plotting.report_figures import plot_energy_records, plot_scaling
from groupoid_gni.plotting.trajectory_figure import plot_trajectory
from groupoid_gni.plotting.work_precision_figure import WorkCurve, plot_work_precision

__all__ = [
    "WorkCurve",
    "plot_constraints",
    "plot_drift",
    "plot_energy",
    "plot_energy_records",
    "plot_laws",
    "plot_path",
    "plot_scaling",
    "plot_trajectory",
    "plot_velocities",
    "plot_work_precision",
    "style",
]
