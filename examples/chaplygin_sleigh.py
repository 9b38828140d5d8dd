"""The Chaplygin sleigh on SE(2): the projected step against the two-step RATTLE, to T = 100.

Run: python examples/chaplygin_sleigh.py [figure.png]

The true sleigh turns round once and settles on a straight line with its centre of mass in front.
The two-step scheme carries a (-1)^k mode that grows wherever the true flow contracts volume; it
reverses the sleigh again, warns, and must not be believed from there on.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_constraints, plot_energy, plot_path, style

STEP, T_END = 0.05, 100.0


def run_both(scene: gni.scenes.Scene) -> tuple[gni.Trajectory, gni.Trajectory, str]:
    """Both methods on the same start, and what the two-step method warned of."""
    settings = {"step": STEP, "t_end": T_END, "reconstruct": np.eye(3)}
    projected = gni.integrate(scene.system, scene.start, method=gni.GNI(), **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        two_step = gni.integrate(scene.system, scene.start, method=gni.Rattle(), **settings)
    return projected, two_step, "; ".join(str(w.message) for w in caught)


def draw(runs: dict[str, gni.Trajectory], exact_velocity: np.ndarray) -> Figure:
    """Path of the contact point, speed along the blade, energy and constraint."""
    with style():
        figure = Figure(figsize=(10, 7), layout="constrained")
        FigureCanvasAgg(figure)
        path, speed, energy, constraint = figure.subplots(2, 2).ravel()
        widths = {"GNI (projected)": 1.8, "Rattle (two-step)": 1.0}
        for label, run in runs.items():
            poses = run.reconstruct()
            shown = run.times <= 28.0
            plot_path(path, poses[shown, :2, 2], label=label, linewidth=widths[label])
            speed.plot(run.times, run.velocities[:, 1], label=label, linewidth=widths[label])
            plot_energy(energy, run, label=label)
            plot_constraints(constraint, run, label=label)
        times = runs["GNI (projected)"].times
        speed.plot(times[::40], exact_velocity[::40, 1], "k.", markersize=3, label="exact")
        path.set_title("contact point until t = 28 (circle: start)")
        path.legend()
        speed.set_title("speed along the blade")
        speed.set_xlabel("t")
        speed.legend(loc="center", frameon=True, framealpha=0.9, edgecolor="none")
        energy.legend()
        constraint.legend()
        figure.suptitle("Chaplygin sleigh: one settles on the straight line, the other is reversed")
    return figure


def main(target: str | Path = "output/chaplygin_sleigh.png") -> dict[str, float]:
    """Run, print, compare with the exact solution, draw; returns the numbers printed."""
    scene = gni.scenes.chaplygin_sleigh(mass=1.0, inertia=1.0, offset=0.3, spin=1.5, speed=-1.0)
    projected, two_step, warning = run_both(scene)
    exact = scene.exact(projected.times)[1]
    errors = {
        "GNI": float(np.max(np.abs(projected.velocities - exact))),
        "Rattle": float(np.max(np.abs(two_step.velocities - exact))),
    }
    print(projected.summary())
    print(two_step.summary())
    print(f"Largest error of the velocity up to T = {T_END:g} against the exact solution:")
    print(f"  GNI    {errors['GNI']:.2e}   final speed {projected.velocities[-1, 1]:+.6f}")
    print(f"  Rattle {errors['Rattle']:.2e}   final speed {two_step.velocities[-1, 1]:+.6f}")
    print(f"  exact             final speed {exact[-1, 1]:+.6f}")
    print(f"Warning: {warning}")
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draw({"GNI (projected)": projected, "Rattle (two-step)": two_step}, exact).savefig(target)
    print(f"Figure written to {target}")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:2])
