"""The six systems of [28] as scenes: orders, constraint, energy, cost, and what reduction saves.

    python tests/benchmarks/six_systems.py [--quick]

Prints the tables of docs/six_systems.md. Orders are slopes of the largest error of base point and
velocity at the end of a short run, over four step sizes, against the equations of motion at 1e-13.
Records are of 1e5 steps. Costs are of the compiled loop, interleaved in one process on one core
(see step_cost.py); ratios are of the smallest times.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "scenes"), str(HERE.parents[1])]

import full_models  # noqa: E402
import step_cost  # noqa: E402

import groupoid_gni as gni  # noqa: E402

METHODS = {
    "EulerA": gni.EulerA(),
    "EulerB": gni.EulerB(),
    "Rattle": gni.Rattle(),
    "Midpoint": gni.Midpoint(),
    "GNI": gni.GNI(),
    "Lagrange-d'Alembert": gni.DiscreteLagrangeDAlembert(),
}
RECORDED = ("GNI", "Rattle", "Lagrange-d'Alembert")
RECORD_STEPS = 100_000
# shorter than a time slice of a busy machine
BURST = 1000
EXACT = 1e-10


@dataclass(frozen=True)
class Row:
    """One scene with what it is measured with.

    t_end, count : of the coarsest of the short runs, for the orders.
    step : of the long runs.  kept : the quantity that the true motion keeps, (nodes,).
    fulls : the models without reduction, name -> maker.
    compared, source, c_parameters : hand-written C and the scene it steps; the scene itself when
        ``compared`` is left out.
    """

    name: str
    scene: gni.scenes.Scene
    t_end: float
    count: int
    step: float
    kept: Callable[[gni.Trajectory], Any]
    fulls: dict[str, Callable[[gni.scenes.Scene], full_models.FullModel]]
    source: str = ""
    c_parameters: tuple[float, ...] = ()
    compared: gni.scenes.Scene | None = None


def energy(run: gni.Trajectory) -> Any:
    """E, (nodes,)."""
    return run.energy()


def moving_energy_of_body(run: gni.Trajectory) -> Any:
    """E - c <I Omega, gamma>, (nodes,)."""
    return run.energy() - run.system.parameters["c"] * np.sum(run.momenta * run.base, axis=1)


def moving_energy_of_ball(run: gni.Trajectory) -> Any:
    """E - Theta M_z, (nodes,)."""
    p, (x, y), v = run.system.parameters, run.base.T, run.velocities.T
    return run.energy() - p["Theta"] * (p["m"] * (x * v[1] - y * v[0]) + p["I"] * v[4])


def rows() -> list[Row]:
    """The six systems, three of them in two variants."""
    scenes, full = gni.scenes, full_models
    suslov, sleigh = scenes.suslov(), scenes.chaplygin_sleigh()
    inertia, axis = suslov.system.parameters["I"], suslov.system.parameters["a"]
    upper = inertia[np.triu_indices(3)]
    blade = [float(sleigh.system.parameters[name]) for name in ("m", "J", "a")]
    ball = (1.7, 0.8, 0.6, 0.9, (0.7, -0.2), (0.3, 0.6))
    body_ball = scenes.inhomogeneous_ball(1.7, 0.8, (0.6,) * 3, 0.9, (0.7, -0.2), (0.3, 0.6))
    free, springs = scenes.constrained_particle(), scenes.constrained_particle(1.3, 0.9, 0.7)
    heavy = scenes.veselova(rate=0.3, weight=(0.3, 0.2, 1.1), vertical=(0, 0, 1),
                            spin=(0.5, 0.4, 0.3))
    robot = {"framed": full.robot, "in coordinates": full.robot_in_coordinates}
    framed = {"framed": full.veselova}
    return [
        Row("particle, free", free, 3.0, 40, 0.05, energy, {"framed": full.particle}),
        Row("particle, springs", springs, 3.0, 40, 0.05, energy, {"framed": full.particle}),
        Row("Suslov", suslov, 4.0, 80, 0.05, energy, {"framed": full.suslov},
            "rigid_body.c", (*upper, *axis)),
        Row("sleigh", sleigh, 4.0, 80, 0.05, energy,
            {"framed": full.sleigh, "in coordinates": full.sleigh_in_coordinates},
            "sleigh.c", tuple(blade)),
        Row("Veselova", scenes.veselova(), 3.0, 60, 0.05, energy, framed),
        Row("Veselova, driven, heavy", heavy, 3.0, 60, 0.05, moving_energy_of_body, framed),
        Row("ball", scenes.rolling_ball(*ball), 4.0, 60, 0.05, moving_energy_of_ball,
            {"framed": full.ball}, "ball.c", (1.7, 0.8, 0.6, 0.6, 0.6, 0.9), body_ball),
        Row("robot", scenes.two_wheeled_robot(), 2.0, 80, 0.02, energy, robot),
        Row("robot, detent", scenes.two_wheeled_robot(detent=0.6), 2.0, 80, 0.02, energy, robot),
    ]  # fmt: skip


# Measurements.


def observed_order(row: Row, method: Any, truth: Any) -> str:
    """The slope over four step sizes, or "exact"."""
    counts, errors = row.count * 2 ** np.arange(4), []
    for n in counts:
        run = gni.integrate(row.scene.system, row.scene.start, step=row.t_end / n,
                            n_steps=int(n), save_every=int(n), method=method)  # fmt: skip
        errors.append(np.max(np.abs(np.concatenate(run.final_state) - truth)))
    if max(errors) < EXACT:
        return "exact"
    return f"{-np.polyfit(np.log(counts), np.log(errors), 1)[0]:.2f}"


def orders(row: Row) -> list[str]:
    """One cell for every method."""
    run = gni.integrate(row.scene.system, row.scene.start, step=row.t_end, n_steps=1,
                        method=gni.ReferenceFlow(rtol=1e-13))  # fmt: skip
    truth = np.concatenate(run.final_state)
    return [observed_order(row, method, truth) for method in METHODS.values()]


def records(row: Row, steps: int) -> list[str]:
    """Step, constraint and kept quantity over a long run: GNI in its first tenth and whole."""
    cells = [f"{row.step:g}"]
    residuals, changes = [], []
    for name in RECORDED:
        run = gni.integrate(row.scene.system, row.scene.start, step=row.step, n_steps=steps,
                            method=METHODS[name], on_failure="return")  # fmt: skip
        kept = row.kept(run)
        change = np.abs(kept - kept[0]) / np.abs(kept[0])
        residuals.append(np.max(np.abs(run.constraint_residuals(relative=True))))
        if name == "GNI":
            changes.append(f"{np.max(change[: steps // 10]):.1e}")
        ended = "" if run.success else f" (stopped at {run.times[-1]:.0f})"
        changes.append(f"{np.max(change):.1e}{ended}")
    return [*cells, f"{max(residuals):.1e}", *changes]


def case_of(row: Row, model: Any) -> step_cost.Case:
    """A model as a case of step_cost.py."""
    start = model.start
    base = start.base if len(start.base) else None
    return step_cost.Case(
        row.name, row.source, model.system.space, lambda space: model.system,
        base, start.velocity, row.step, BURST, row.c_parameters,
    )  # fmt: skip


def numbers_per_node(model: Any) -> int:
    """What GNI stores at a node: state, arrow velocities, Newton count."""
    return int(gni.integrate(model.system, model.start, step=0.01, n_steps=1).rows.shape[1])


def costs(row: Row, folder: Path, repeats: int) -> list[str]:
    """Nanoseconds of the scene, and ratios: full models, C; for Rattle and for GNI."""
    models = {"scene": row.scene}
    models.update({name: make(row.scene) for name, make in row.fulls.items()})
    cells = [" / ".join(str(numbers_per_node(models[name])) for name in ("scene", "framed"))]
    for scheme in step_cost.METHODS:
        problems = [(n, step_cost.Problem(case_of(row, m), scheme)) for n, m in models.items()]
        contenders = [problem.library(name, problem.system) for name, problem in problems]
        written = row.source and step_cost.c_compiler()
        if written:
            compared = step_cost.Problem(case_of(row, row.compared or row.scene), scheme)
            contenders += [
                compared.library("compared", compared.system),
                *step_cost.c_contenders(compared, folder),
            ]
        found = step_cost.interleaved(contenders, BURST, repeats, BURST)
        least = {name: cost.smallest for name, cost in found.items()}
        ratios = [f"{least[n] / least['scene']:.2f}" if n in least else ""
                  for n in ("framed", "in coordinates")]  # fmt: skip
        better = min(least[name] for name in step_cost.C_FLAGS) if written else 0.0
        times_c = f"{least['compared'] / better:.2f}" if written else ""
        cells += [f"{least['scene']:.0f}", *ratios, times_c]
    return cells


# What is printed.


def print_table(heading: list[str], body: list[list[str]]) -> None:
    """A markdown table, first column left, others right."""
    print("\n| " + " | ".join(heading) + " |")
    print("|---" + "|--:" * (len(heading) - 1) + "|")
    for cells in body:
        print("| " + " | ".join(cells) + " |")


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="short records, few turns")
    quick = parser.parse_args(arguments).quick
    length = RECORD_STEPS // 100 if quick else RECORD_STEPS
    systems = rows()
    print("Observed orders")
    print_table(["", *METHODS], [[row.name, *orders(row)] for row in systems])
    print(f"\nLargest relative change of what is kept, over {length} steps")
    with warnings.catch_warnings():
        # the parasitic mode of the two-step methods is what the records show
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        table = [[row.name, *records(row, length)] for row in systems]
    print_table(["", "h", "constraint", "GNI, first tenth", *RECORDED], table)
    print("\nCost per step")
    columns = ["ns", "framed", "coordinates", "times C"]
    heading = [f"{title} {column}" for title in ("Rattle", "GNI") for column in columns]
    with step_cost.one_core(), tempfile.TemporaryDirectory() as folder:
        table = [[row.name, *costs(row, Path(folder), 20 if quick else 400)] for row in systems]
    print_table(["", "numbers per node", *heading], table)
    print()
    step_cost.report_machine()


if __name__ == "__main__":
    main()
