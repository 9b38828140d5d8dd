"""A problem that is not reversible, for a long time: the continuously variable transmission.

    python tests/benchmarks/transmission.py [--quick] [--figure FILE]

Prints the tables of docs/how_to_choose.md and draws docs/figures/transmission.png. Records reach
t = 1e5. Energies are relative to the energy at the start. Reversibility: n steps, n steps back with
-h, largest difference of base and velocity from the start. Beside it the amplification S of small
changes of the start by the motion itself, and u S sqrt(n), what unbiased round-off would make of
it (u = 2^-53). Costs are the smallest of many bursts of the compiled loop.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "scenes"), str(HERE.parents[1])]

import measures  # noqa: E402
from six_systems import print_table  # noqa: E402

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.diagnostics import energy_drift, roundoff_growth  # noqa: E402
from groupoid_gni.diagnostics.energy_drift import Drift  # noqa: E402
from groupoid_gni.plotting import style  # noqa: E402

T_END, NODES = 1e5, 20_000
STEPS = (0.1, 0.05)
BURST, BURSTS = 1000, 40
UNIT = 2.0**-53
ASYMMETRIC = (0.3, 1.0, 0.4, 0.5)
PROBLEMS = {
    "reversible: f = sin y, e = 0": {"asymmetry": 0.0},
    "f = sin y, e = 0.5": {},
    "f = 0.3 + sin y + 0.4 cos y + 0.5 sin 2y, e = 0.5": {"gearing": ASYMMETRIC},
}

Vary = gni.Variational()
Split, Exact = gni.Splitting(), gni.EnergyPreserving()
METHODS: dict[str, Any] = {
    "Rattle": gni.Rattle(),
    **{f"GNI {p}": gni.GNI(p, Vary) for p in (2, 4, 6)},
    **{f"GNI {p}, Splitting": gni.GNI(p, Split) for p in (2, 4, 6)},
    **{f"GNI {p}, EnergyPreserving": gni.GNI(p, Exact) for p in (2, 4, 6)},
    **{
        f"GNI {p}, EnergyPreserving, bare": gni.GNI(p, Exact, projection=None) for p in (2, 4, 6)
    },
    "McLachlan-Perlmutter 2": gni.McLachlanPerlmutter(2),
    "Lagrange-d'Alembert": gni.DiscreteLagrangeDAlembert(),
}
KEEP_ENERGY = [name for name in METHODS if "EnergyPreserving" in name]
RETURNING = [name for name in METHODS if "bare" not in name]
"""A bare run ends off the constraint, and cannot be started from there."""
DRAWN = (
    "McLachlan-Perlmutter 2", "Lagrange-d'Alembert", "Rattle", "GNI 2", "GNI 4", "GNI 6",
    "GNI 2, EnergyPreserving", "GNI 6, EnergyPreserving",
)  # fmt: skip

LIBRATING = {"driver": np.pi, "driver_speed": 0.05, "quartic": 0.0, "asymmetry": 0.0}
SETTINGS: dict[str, tuple[dict[str, Any], float]] = {
    "f = sin y, e = 0.5": ({}, 0.1),
    "the same, quadratic potential": ({"quartic": 0.0}, 0.1),
    "the same, h = 0.01": ({}, 0.01),
    "the same, h = 0.001": ({}, 0.001),
    "the same, h = 0.0003": ({}, 0.0003),
    "driver librates a little, quadratic, e = 0": (LIBRATING, 0.1),
    "driver librates a little, quadratic, e = 0, h = 0.01": (LIBRATING, 0.01),
}
COMPARED = (
    "GNI 2", "GNI 4", "GNI 4, Splitting", "GNI 2, EnergyPreserving", "GNI 4, EnergyPreserving",
    "GNI 6, EnergyPreserving",
)  # fmt: skip


# Records.


@dataclass(frozen=True)
class Record:
    """What one run showed; energies relative to the start."""

    name: str
    times: Any
    errors: Any
    cells: list[str]


def drift_cell(run: gni.Trajectory, relative: Any) -> str:
    """The verdict, with the rate or the diffusion that it rests on."""
    found = energy_drift(run, relative)
    if found.verdict is Drift.LINEAR:
        return f"linear, {found.rate:.1e}"
    if found.verdict is Drift.RANDOM_WALK:
        return f"random walk, D = {found.diffusion:.1e}"
    return found.verdict.value


def growth_cell(name: str, run: gni.Trajectory, relative: Any) -> str:
    """The exponent of the growth of round-off, for methods that keep the energy."""
    if name not in KEEP_ENERGY:
        return ""
    growth = roundoff_growth(run, relative)
    return f"{growth.exponent:.2f} ({growth.interval[0]:.2f} ... {growth.interval[1]:.2f})"


def cost(scene: gni.scenes.Scene, method: Any, h: float) -> float:
    """Nanoseconds of a step."""
    seconds = [
        measures.quietly(
            scene.system, scene.start, step=h, n_steps=BURST, method=method, save_every=BURST
        ).seconds
        for _ in range(BURSTS)
    ]
    return 1e9 * min(seconds) / BURST


def record(name: str, scene: gni.scenes.Scene, h: float, t_end: float) -> Record:
    """Run to t_end and look at energy, constraint and effort."""
    steps = round(t_end / h)
    run = measures.quietly(
        scene.system, scene.start, step=h, n_steps=steps, method=METHODS[name],
        save_every=max(1, steps // NODES), on_failure="return",
    )  # fmt: skip
    energy = run.energy()
    relative = energy / energy[0]
    errors = np.abs(relative - 1.0)
    constraint = np.max(np.abs(run.constraint_residuals(relative=True)))
    done = run.node_steps[-1]
    if run.success:
        ends = [f"{errors.max():.1e}", f"{errors[-1]:.1e}", drift_cell(run, relative)]
    else:
        ends = ["without bound", f"stopped at t = {run.times[-1]:.0f}", ""]
    effort = [f"{cost(scene, METHODS[name], h):.0f}", f"{run.newton_iterations.sum() / done:.1f}"]
    growth = growth_cell(name, run, relative)
    cells = [name, f"{h:g}", *ends, growth, f"{constraint:.0e}", *effort]
    return Record(name, run.times, errors, cells)


# Reversibility.


def distance(one: Any, other: Any) -> float:
    """Largest difference of two (base, velocity)."""
    return float(np.max(np.abs(np.concatenate(one) - np.concatenate(other))))


def after(system: Any, state: Any, h: float, n: int, method: Any) -> Any:
    """(base, velocity) n steps later."""
    return measures.quietly(
        system, state, step=h, n_steps=n, method=method, save_every=n
    ).final_state


def there_and_back(scene: gni.scenes.Scene, method: Any, h: float, n: int) -> float:
    """Distance from the start after n steps and n steps back; infinite if a step failed."""
    system, start = scene.system, scene.start
    try:
        turned = system.state(*after(system, start, h, n, method))
        return distance(after(system, turned, -h, n, method), (start.base, start.velocity))
    except gni.StepFailure:
        return np.inf


def moved_starts(scene: gni.scenes.Scene, size: float) -> list[Any]:
    """Starts moved by ``size`` along each coordinate and each velocity, on the constraint."""
    system, start = scene.system, scene.start
    space, velocity = system.space, np.array(start.velocity)
    states = []
    for direction in size * np.eye(space.rank):
        base = space.target(space.retract(start.base, direction))
        states.append(system.state(base, velocity, project_start=True))
        states.append(system.state(start.base, velocity + direction, project_start=True))
    return states


def parting(scene: gni.scenes.Scene, method: Any, h: float, n: int, size: float) -> float:
    """How far starts moved by ``size`` are from the unmoved one after n steps; the largest."""
    system = scene.system
    try:
        end = after(system, scene.start, h, n, method)
        return max(
            distance(after(system, state, h, n, method), end)
            for state in moved_starts(scene, size)
        )
    except gni.StepFailure:
        return np.inf


def reversibility(name: str, scene: gni.scenes.Scene, h: float, counts: list[int]) -> list[str]:
    """Defects, their exponent, and what the motion and round-off explain of them."""
    method = METHODS[name]
    defects = [there_and_back(scene, method, h, n) for n in counts]
    exponent = np.polyfit(np.log(counts), np.log(defects), 1)[0] if np.isfinite(defects[-1]) else 0
    amplified = parting(scene, method, h, counts[-1], 1e-9) / 1e-9
    return [
        name,
        f"{h:g}",
        *(f"{defect:.0e}" for defect in defects),
        f"{exponent:.1f}",
        f"{parting(scene, method, h, counts[-1], 1e-15):.0e}",
        f"{amplified:.0f}",
        f"{UNIT * amplified * np.sqrt(counts[-1]):.0e}",
    ]


# What is drawn and printed.


def draw(panels: dict[str, list[Record]]) -> Figure:
    """Largest energy error so far over time, one panel for each problem."""
    colours = ("#8c6d31", "#7b4f9e", "#c8553d", "#9ecae1", "#4292c6", "#08519c", "#74c476",
               "#006d2c")  # fmt: skip
    dashes = ("--", ":", "-.", "-", "-", "-", "-", "-")
    with style():
        figure = Figure(figsize=(12, 4.8), layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(1, len(panels), sharey=True)
        for axis, (title, records) in zip(axes, panels.items(), strict=True):
            drawn = {found.name: found for found in records}
            for name, colour, dash in zip(DRAWN, colours, dashes, strict=True):
                found = drawn[name]
                largest = np.maximum.accumulate(np.maximum(found.errors, UNIT))[1:]
                axis.loglog(found.times[1:], largest, dash, color=colour, label=name)
            axis.set_title(title)
            axis.set_xlabel("t")
            axis.set_ylim(1e-16, 1e1)
        axes[0].set_ylabel("largest relative energy error up to t, h = 0.1")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def show_records(t_end: float) -> dict[str, list[Record]]:
    """Print the tables of long runs; returns those of the first step size."""
    heading = ["", "h", "largest", "at the end", "verdict", "growth of round-off", "constraint",
               "ns", "iterations"]  # fmt: skip
    panels: dict[str, list[Record]] = {}
    for title, options in PROBLEMS.items():
        scene = gni.scenes.variable_transmission(**options)
        records = [record(name, scene, h, t_end) for h in STEPS for name in METHODS]
        print(f"\nRelative energy error up to t = {t_end:g}, {title}")
        print_table(heading, [found.cells for found in records])
        panels[title] = records[: len(METHODS)]
    return panels


def show_reversibility(counts: list[int]) -> None:
    """Print the tables of forward and back."""
    last = f"{counts[-1]:.0e}"
    heading = ["", "h", *(f"{n:.0e}" for n in counts), "exponent", "moved by 1e-15", "S",
               "u S sqrt(n)"]  # fmt: skip
    for title, options in list(PROBLEMS.items())[1:]:
        scene = gni.scenes.variable_transmission(**options)
        print(f"\nForward and back, {title}; the last three columns after {last} steps")
        body = [reversibility(name, scene, h, counts) for h in STEPS for name in RETURNING]
        print_table(heading, body)
    print(f"\nForward and back, {last} steps: where the motion amplifies less")
    body = []
    for title, (options, h) in SETTINGS.items():
        scene = gni.scenes.variable_transmission(**options)
        defects = [there_and_back(scene, METHODS[name], h, counts[-1]) for name in COMPARED]
        amplified = parting(scene, METHODS[COMPARED[0]], h, counts[-1], 1e-9) / 1e-9
        body.append([title, f"{amplified:.0f}", f"{UNIT * amplified * np.sqrt(counts[-1]):.0e}",
                     *(f"{defect:.0e}" for defect in defects)])  # fmt: skip
    print_table(["", "S", "u S sqrt(n)", *COMPARED], body)


def main(arguments: list[str] | None = None) -> None:
    """Print everything, draw if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short runs")
    parser.add_argument("--figure", type=Path, help="where to draw the energy errors")
    options = parser.parse_args(arguments)
    panels = show_records(T_END / 50 if options.quick else T_END)
    show_reversibility([100, 1000] if options.quick else [1000, 10_000, 100_000])
    if options.figure:
        draw(panels).savefig(options.figure)


if __name__ == "__main__":
    main()
