"""The six systems of Iglesias-Ponte, Marrero, Martin de Diego, Martinez 2008, one picture each.

Run: python examples/six_systems.py [figure.png]

Every scene is the smallest model of its system; paths of what was left out (the particle's x and z,
the poses of sleigh and robot) are reconstructed from the arrows. Each run is compared with the
exact motion, or with the equations of motion integrated to 1e-12 where there is no closed form.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_path, style

STEP = 0.01
DARK, PALE, RED = "#22303c", "#c9d3da", "#c8553d"
HALF_TRACK = 0.6


def systems() -> dict[str, tuple[gni.scenes.Scene, float]]:
    """Scene and end time by name."""
    scenes = gni.scenes
    return {
        "constrained particle": (scenes.constrained_particle(1.3, 0.9, 0.7), 40.0),
        "Suslov": (scenes.suslov(), 25.0),
        "Chaplygin sleigh": (scenes.chaplygin_sleigh(), 9.0),
        "Veselova": (scenes.veselova(), 60.0),
        "ball on a rotating table": (scenes.rolling_ball(), 40.0),
        "two-wheeled robot": (
            scenes.two_wheeled_robot(half_track=HALF_TRACK, detent=1.6, spin=1.1, speed=-0.7),
            30.0,
        ),
    }


def largest_error(scene: gni.scenes.Scene, run: gni.Trajectory) -> float:
    """Largest error of base point and velocity over the run."""
    if scene.exact is not None:
        base, velocities = scene.exact(run.times)
    else:
        steps = {"step": run.step_size, "n_steps": len(run) - 1}
        truth = gni.integrate(
            scene.system, scene.start, method=gni.ReferenceFlow(rtol=1e-12), **steps
        )
        base, velocities = truth.base, truth.velocities
    gaps = np.abs(run.base - base), np.abs(run.velocities - velocities)
    return float(max(np.max(gap, initial=0.0) for gap in gaps))


def draw_particle(axes: Any, run: gni.Trajectory) -> None:
    """The path in space over its shadow on the (x, y) plane."""
    y, x = run.base.T
    z = run.reconstruct()[:, 0]
    floor = z.min() - 0.4 * np.ptp(z)
    axes.plot(x, y, np.full_like(z, floor), color=PALE, linewidth=0.9)
    axes.plot(x, y, z, linewidth=1.1)
    axes.plot(x[:1], y[:1], z[:1], "o", color=DARK, markersize=4)
    axes.set_zlim(floor, z.max())
    axes.set(xlabel="x", ylabel="y", zlabel="z")
    axes.tick_params(labelsize=7, pad=-2)
    axes.view_init(elev=22.0, azim=-58.0)
    axes.set_box_aspect((1, 1, 0.85), zoom=0.88)


def draw_suslov(axes: Any, run: gni.Trajectory) -> None:
    """The plane across the axis: the energy ellipse is left for the stable steady turn."""
    inertia = run.system.parameters["I"]
    b = inertia[2, :2]
    steady = np.array([-b[1], b[0]]) / np.linalg.norm(b)
    first, last = run.velocities[0, :2], run.velocities[-1, :2]
    stable = steady * np.sign(steady @ last)
    reach = 1.25 * np.max(np.linalg.norm(run.velocities, axis=1))
    axes.plot(*np.outer(stable, [0, reach]), color=DARK, linewidth=1.0, label="stable turns")
    axes.plot(*np.outer(stable, [-reach, 0]), "--", color=DARK, linewidth=1.0,
              label="unstable turns")  # fmt: skip
    angle = np.linspace(0, 2 * np.pi, 200)
    root = np.linalg.cholesky(inertia[:2, :2])
    radius = np.linalg.norm(root.T @ first)
    ellipse = np.linalg.solve(root.T, radius * np.stack([np.cos(angle), np.sin(angle)]))
    axes.plot(*ellipse, color=PALE, linewidth=3.5, label="energy", zorder=0)
    plot_path(axes, run.velocities[:, :2])
    axes.plot(*run.velocities[::25, :2].T, ".", color=RED, markersize=4, label="every 0.25")
    axes.set(xlabel="$\\Omega_1$", ylabel="$\\Omega_2$")
    axes.legend(fontsize=6.5, loc="center", bbox_to_anchor=(0.37, 0.33), handlelength=1.4)


def draw_sleigh(axes: Any, run: gni.Trajectory) -> None:
    """The path of the contact point, and the blade every half unit of time."""
    poses = run.reconstruct()
    plot_path(axes, poses[:, :2, 2])
    for pose in poses[::50]:
        tail, tip = pose[:2, 2], pose[:2, 2] + 0.7 * pose[:2, 0]
        axes.plot(*np.transpose([tail, tip]), color=DARK, linewidth=0.8)
        axes.plot(*tip, ".", color=DARK, markersize=4)


def draw_veselova(axes: Any, run: gni.Trajectory) -> None:
    """The vertical seen from the body, on the front and the back of the sphere."""
    eye = np.array([0.55, -0.6, 0.58])
    eye /= np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    up = np.cross(eye, right)
    angle = np.linspace(0, 2 * np.pi, 200)
    axes.plot(np.cos(angle), np.sin(angle), color=DARK, linewidth=0.8)
    shown = run.base @ np.stack([right, up], axis=1)
    front = (run.base @ eye > 0)[:, None]
    axes.plot(*np.where(front, np.nan, shown).T, color=PALE, linewidth=0.9)
    axes.plot(*np.where(front, shown, np.nan).T, linewidth=1.1)
    for name, axis in zip("123", np.eye(3), strict=True):
        place = np.array([right @ axis, up @ axis])
        axes.plot(*np.outer(place, [0.0, 1.0]), color=DARK, linewidth=0.6)
        axes.annotate(name, 1.06 * place, color=DARK, fontsize=8)
    axes.set_aspect("equal")
    axes.set_axis_off()


def draw_ball(axes: Any, run: gni.Trajectory) -> None:
    """The path in space, a circle, and the trace it leaves on the turning table."""
    turned = run.times * float(run.system.parameters["Theta"])
    c, s = np.cos(turned), np.sin(turned)
    x, y = run.base.T
    axes.plot(c * x + s * y, c * y - s * x, color=RED, linewidth=0.9, label="on the table")
    plot_path(axes, run.base, label="in space")
    axes.plot(0, 0, "+", color=DARK, markersize=9)
    axes.legend(fontsize=7, loc="upper right", frameon=True, framealpha=0.9, edgecolor="none")


def draw_robot(axes: Any, run: gni.Trajectory) -> None:
    """The paths of both wheels: the detent stops the left one, the right one circles about it."""
    poses = run.reconstruct()[:, -9:].reshape(-1, 3, 3)
    middle, across = poses[:, :2, 2], poses[:, :2, 1]
    left, right = middle + HALF_TRACK * across, middle - HALF_TRACK * across
    plot_path(axes, left, label="left wheel")
    plot_path(axes, right, label="right wheel", linewidth=0.9)
    for tail, tip in zip(left[:600:60], right[:600:60], strict=True):
        axes.plot(*np.transpose([tail, tip]), color=PALE, linewidth=0.9, zorder=0)
    axes.legend(fontsize=7, loc="best", frameon=True, framealpha=0.9, edgecolor="none")


TITLES = {
    "constrained particle": ("$z' = y x'$, two springs; below: its shadow", draw_particle),
    "Suslov": ("$\\Omega$ settles on a steady turn", draw_suslov),
    "Chaplygin sleigh": ("contact point; dot: centre of mass ahead", draw_sleigh),
    "Veselova": ("the vertical seen from the body", draw_veselova),
    "ball on a rotating table": ("contact point", draw_ball),
    "two-wheeled robot": ("a detent catches the left wheel", draw_robot),
}


def draw(runs: dict[str, gni.Trajectory]) -> Figure:
    """Two rows of three panels."""
    with style():
        figure = Figure(figsize=(11, 7.2), layout="constrained")
        FigureCanvasAgg(figure)
        for number, (name, run) in enumerate(runs.items()):
            kind = {"projection": "3d"} if name == "constrained particle" else {}
            axes = figure.add_subplot(2, 3, number + 1, **kind)
            text, picture = TITLES[name]
            picture(axes, run)
            axes.set_title(f"{name}\n{text}", loc="left")
    return figure


def main(target: str | Path = "output/six_systems.png") -> dict[str, float]:
    """Run, print, compare, draw; returns the largest error of each system."""
    runs, errors = {}, {}
    for name, (scene, t_end) in systems().items():
        runs[name] = gni.integrate(scene.system, scene.start, step=STEP, t_end=t_end)
        errors[name] = largest_error(scene, runs[name])
        print(runs[name].summary())
        print(f"  {scene.description}")
        print(f"  largest error {errors[name]:.2e}")
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draw(runs).savefig(target)
    print(f"Figure written to {target}")
    return errors


if __name__ == "__main__":
    main(*sys.argv[1:2])
