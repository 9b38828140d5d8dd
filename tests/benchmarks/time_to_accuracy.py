"""The time to reach a given error at T = 10, against DOP853 in C, heyoka and SciPy.

    python tests/benchmarks/time_to_accuracy.py [--quick] [--json FILE] [--figure FILE]

Everything is warm, in one process on one core: nothing that is compiled counts. The error is the
largest one over base point and velocity in the library's coordinates at T. A setting (tolerance,
number of steps) counts as reaching an error when the next two stricter ones reach it too: one lucky
zero of the error is no accuracy. The fastest setting of each contender is timed again, interleaved
with all others; the smallest time counts.

Library times are ``run.seconds``, the loop as ``integrate`` runs it; beside it the compiled loop
called as the C is called, and all of ``integrate``.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import peers  # noqa: E402
import step_cost  # noqa: E402

import groupoid_gni as gni  # noqa: E402

T = 10.0
TARGETS = (1e-3, 1e-6, 1e-9, 1e-11)
MODELS = (peers.sleigh, peers.suslov, peers.ball)
FLOWS = ("Variational", "Splitting", "EnergyPreserving")
ORDERS = (2, 4, 6, 8)
BASELINE = "C, DOP853"
AGREEING = 3
"""Settings in a row that must reach an error."""


# Contenders.


@dataclass(frozen=True)
class Contender:
    """``run(setting)`` from the start to the end; settings from loose to strict.

    row : where it stands in the table; contenders of one row compete, the fastest counts.
    """

    row: str
    name: str
    settings: tuple[Any, ...]
    run: Callable[[Any], peers.Run]


def tolerances(first: float, last: float, per_decade: int) -> tuple[float, ...]:
    """10^-first ... 10^-last."""
    count = round((last - first) * per_decade)
    return tuple(10.0 ** -(first + k / per_decade) for k in range(count + 1))


def step_counts(first: int, most: int, per_doubling: int) -> tuple[int, ...]:
    """A geometric sequence of whole numbers."""
    count = int(per_doubling * math.log2(most / first))
    return tuple(sorted({round(first * 2 ** (k / per_doubling)) for k in range(count + 1)}))


class Library:
    """One method of the library; three ways to look at its time."""

    def __init__(self, scene: gni.scenes.Scene, method: Any, t_end: float) -> None:
        self.scene, self.method, self.t_end = scene, method, t_end
        self.walls: dict[Any, float] = {}

    def steps(self, count: int) -> peers.Run:
        """A fixed number of steps; ``run.seconds``."""
        began = time.perf_counter()
        run = gni.integrate(
            self.scene.system, self.scene.start, step=self.t_end / count, n_steps=count,
            method=self.method, save_every=count,
        )  # fmt: skip
        wall = time.perf_counter() - began
        self.walls[count] = min(wall, self.walls.get(count, math.inf))
        return peers.Run(run.seconds, np.concatenate(run.final_state), count)

    def tolerance(self, rtol: float) -> peers.Run:
        """``ReferenceFlow(rtol)``."""
        began = time.perf_counter()
        run = gni.integrate(
            self.scene.system, self.scene.start, step=self.t_end, n_steps=1,
            method=self.method(rtol),
        )  # fmt: skip
        wall = time.perf_counter() - began
        self.walls[rtol] = min(wall, self.walls.get(rtol, math.inf))
        return peers.Run(run.seconds, np.concatenate(run.final_state))

    def loop(self, count: int, repeats: int) -> float:
        """Smallest time of the compiled loop alone, called as the C is called."""
        problem = _Loop(self.scene, self.method, self.t_end / count)
        contender = problem.library(str(self.method), problem.system)
        runs = [contender.run(count * problem.stages)[:2] for _ in range(repeats)]
        n = self.scene.system.space.base_size
        if not np.allclose(runs[0][1][:n], self.steps(count).end[:n], rtol=0.0, atol=1e-9):
            raise RuntimeError(f"{self.method}: the compiled loop and integrate end apart")
        return min(seconds for seconds, _ in runs)


class _Loop(step_cost.Problem):
    """The parts of a problem of step_cost.py that its compiled loop needs."""

    def __init__(self, scene: gni.scenes.Scene, method: Any, step: float) -> None:
        self.case, self.method = SimpleNamespace(step=step), method
        self.system, self.start = scene.system, scene.start
        run = gni.integrate(self.system, self.start, step=step, n_steps=1, method=method)
        self.state, self.layout = run.rows[0, : run.layout.size].copy(), run.layout
        runner = step_cost.compiled_step(self.system, method, self.start.active_rows)
        # the compiled loop counts stages
        self.stages = runner.program.stages


def library_methods() -> dict[str, Callable[[], Any]]:
    """Fixed-step methods by name, made when asked for: not all need exist for every system."""
    methods: dict[str, Callable[[], Any]] = {
        "Rattle": lambda: gni.Rattle(),
        "McLachlan-Perlmutter": lambda: gni.McLachlanPerlmutter(),
    }
    for order in ORDERS:
        for flow in FLOWS:
            for suffix, more in (("", {}), (", unprojected", {"projection": None})):

                def make(order: int = order, flow: str = flow, more: dict = more) -> Any:
                    return gni.GNI(order=order, flow=getattr(gni, flow)(), **more)

                methods[f"GNI {order}, {flow}{suffix}"] = make
    return methods


def available(
    scene: gni.scenes.Scene, notes: list[str] | None = None
) -> dict[str, tuple[Any, gni.Trajectory]]:
    """The methods that exist and can step the scene, each after one short run."""
    found: dict[str, tuple[Any, gni.Trajectory]] = {}
    refused: dict[str, list[str]] = {}
    for name, make in library_methods().items():
        try:
            method = make()
            found[name] = method, gni.integrate(
                scene.system, scene.start, step=1e-3, n_steps=2, method=method
            )
        except (gni.GNIError, AttributeError, TypeError) as refusal:
            reason = f"{type(refusal).__name__}: {_first_line(refusal)}"
            refused.setdefault(reason, []).append(name)
    if notes is not None:
        notes += [f"left out: {'; '.join(names)}. {why}" for why, names in refused.items()]
    return found


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0][:160] if str(error) else ""


@dataclass
class Field:
    """All contenders of one model, and what could not be had."""

    contenders: list[Contender]
    libraries: dict[str, Library]
    notes: list[str] = field(default_factory=list)


def contenders_of(model: peers.Model, folder: Path, quick: bool) -> Field:
    """Everybody who runs on this machine."""
    fine = 2 if quick else 8
    found, notes = Field([], {}), []
    if step_cost.c_compiler():
        for form in model.c_forms:
            code = peers.C(form, folder)
            found.contenders.append(Contender(
                BASELINE, form.name, tolerances(1, 15, fine),
                lambda rtol, code=code: code.run(T, rtol)))  # fmt: skip
    else:
        notes.append("C: no compiler (cc)")
    if (hy := peers.heyoka_module()) is not None:
        for form in model.forms:
            for fast in (False, True):
                series = peers.Taylor(form, hy, fast)
                name = ", ".join(filter(None, (form.name, "fast_math" if fast else "")))
                found.contenders.append(Contender(
                    "heyoka, Taylor", name, tolerances(1, 16, max(1, fine // 4)),
                    lambda tol, series=series: series.run(T, tol)))  # fmt: skip
    else:
        notes.append('heyoka is not installed: pip install "groupoid-gni[peers]"')
    for method in ("DOP853", "LSODA"):
        solver = peers.SciPy(model.numpy, method)
        found.contenders.append(Contender(
            f"SciPy, {method}", "", tolerances(1, 13, max(1, fine // 2)),
            lambda rtol, solver=solver: solver.run(T, rtol)))  # fmt: skip
    flow = Library(model.scene, lambda rtol: gni.ReferenceFlow(rtol=rtol), T)
    found.libraries["ReferenceFlow"] = flow
    found.contenders.append(Contender(
        "ReferenceFlow", "", tolerances(1, 13, max(1, fine // 2)), flow.tolerance))  # fmt: skip
    for name, (method, _) in available(model.scene, notes).items():
        library = Library(model.scene, method, T)
        found.libraries[name] = library
        found.contenders.append(Contender(
            name, "", step_counts(4, 1 << 24, fine), library.steps))  # fmt: skip
    found.notes += notes
    return found


# The truth.


@dataclass(frozen=True)
class Truth:
    """The state at T, what it may be off by, and how far others are from it."""

    state: np.ndarray
    uncertainty: float
    source: str
    disagreements: dict[str, float]


def truth_of(model: peers.Model, folder: Path, t_end: float = T) -> Truth:
    """The exact motion; else C in long double, which 1e-16 and 1e-17 must agree on."""
    scene, found = model.scene, {}
    run = gni.integrate(
        scene.system, scene.start, step=t_end, n_steps=1, method=gni.ReferenceFlow(rtol=1e-13)
    )
    found["ReferenceFlow(1e-13)"] = np.concatenate(run.final_state)
    if step_cost.c_compiler():
        form = model.c_forms[0]
        found["C at 1e-15"] = peers.C(form, folder).run(t_end, 1e-15).end
        extended = peers.C(form, folder, extended=True)
        found["C, long double at 1e-16"] = extended.run(t_end, 1e-16).end
        found["C, long double at 1e-17"] = extended.run(t_end, 1e-17).end
    if scene.exact is not None:
        base, velocity = scene.exact(np.array([t_end]))
        state, source = np.concatenate([base[0], velocity[0]]), "exact motion"
        uncertainty = 4.0 * np.finfo(float).eps * max(1.0, float(np.max(np.abs(state))))
    else:
        source = list(found)[-1]
        state = found[source]
        rival = list(found)[-2] if len(found) > 1 else source
        rounding = 4.0 * np.finfo(float).eps * max(1.0, float(np.max(np.abs(state))))
        uncertainty = max(rounding, distance(found[rival], state)) if len(found) > 1 else 1e-11
    return Truth(state, uncertainty, source, {n: distance(s, state) for n, s in found.items()})


def distance(first: np.ndarray, second: np.ndarray) -> float:
    """Largest difference of two states."""
    return float(np.max(np.abs(first - second)))


# Scanning and choosing.


@dataclass(frozen=True)
class Point:
    """One setting with its error and a first impression of its time."""

    setting: Any
    error: float
    seconds: float


def scan(contender: Contender, truth: Truth, budget: float) -> list[Point]:
    """Settings from loose to strict, until the truth's digits or ``budget`` seconds are used up."""
    points: list[Point] = []
    spent = 0.0
    for setting in contender.settings:
        began = time.process_time()
        point = one_point(contender, setting, truth)
        if math.isfinite(point.error):  # a failure may search long for a way out
            spent += time.process_time() - began
        points.append(point)
        settled = [p.error < TARGETS[-1] / 10 for p in points[-2 * AGREEING :]]
        if spent > budget or (len(settled) == 2 * AGREEING and all(settled)):
            break
    return points


def one_point(contender: Contender, setting: Any, truth: Truth) -> Point:
    """The better of three short runs; infinite error for a run that failed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            runs = [contender.run(setting)]
            while len(runs) < 3 and runs[-1].seconds < 1e-3:
                runs.append(contender.run(setting))
    except (gni.StepFailure, RuntimeError):
        return Point(setting, math.inf, math.inf)
    error = distance(runs[0].end, truth.state)
    return Point(setting, error if math.isfinite(error) else math.inf,
                 min(r.seconds for r in runs))  # fmt: skip


def fastest(points: list[Point], target: float) -> Point | None:
    """The fastest setting that reaches the target together with the next stricter ones."""
    reached = [
        point
        for k, point in enumerate(points)
        if all(p.error <= target for p in points[k : k + AGREEING])
        and len(points[k : k + AGREEING]) == AGREEING
    ]
    return min(reached, key=lambda p: p.seconds) if reached else None


@dataclass(frozen=True)
class Cell:
    """One row at one error: seconds again, interleaved; for library methods all three times."""

    row: str
    target: float
    name: str
    setting: Any
    error: float
    seconds: float
    loop: float | None = None
    wall: float | None = None


def chosen(
    entries: Field, points: dict[tuple[str, str], list[Point]], target: float
) -> dict[str, tuple[Contender, Point]]:
    """The best contender of every row."""
    best: dict[str, tuple[Contender, Point]] = {}
    for contender in entries.contenders:
        point = fastest(points[contender.row, contender.name], target)
        if point is None:
            continue
        row = contender.row
        if row not in best or point.seconds < best[row][1].seconds:
            best[row] = contender, point
    return best


def timed_again(picks: list[tuple[Contender, Point]], repeats: int) -> list[float]:
    """Smallest seconds over interleaved turns; slow ones take part in the first turns only."""
    best = [math.inf] * len(picks)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for turn in range(repeats):
            for k, (contender, point) in enumerate(picks):
                if turn >= 3 and point.seconds > 0.02:
                    continue
                inner = 5 if point.seconds < 1e-3 else 1
                for _ in range(inner):
                    best[k] = min(best[k], contender.run(point.setting).seconds)
    return best


@dataclass(frozen=True)
class Result:
    """One model measured."""

    model: str
    truth: Truth
    cells: list[Cell]
    points: dict[tuple[str, str], list[Point]]
    notes: list[str]


def measure(model: peers.Model, folder: Path, quick: bool) -> Result:
    """Scan everybody, choose, time again."""
    truth = truth_of(model, folder)
    entries = contenders_of(model, folder, quick)
    budget = 0.2 if quick else 0.8
    points = {}
    for contender in entries.contenders:
        # a scan includes heyoka's compilation
        allowed = 20.0 if contender.row.startswith("heyoka") else budget
        points[contender.row, contender.name] = scan(contender, truth, allowed)
    picks, keys = [], []
    for target in TARGETS:
        if target < 3.0 * truth.uncertainty:
            entries.notes.append(f"{target:g} is below the reference's uncertainty")
            continue
        for row, pick in chosen(entries, points, target).items():
            picks.append(pick)
            keys.append((row, target))
    seconds = timed_again(picks, 5 if quick else 40)
    cells = []
    for (row, target), (contender, point), best in zip(keys, picks, seconds, strict=True):
        library = entries.libraries.get(row)
        cells.append(Cell(
            row, target, contender.name, point.setting, point.error, best,
            loop_time(library, point, quick), library and library.walls.get(point.setting),
        ))  # fmt: skip
    return Result(model.name, truth, cells, points, entries.notes)


def loop_time(library: Library | None, point: Point, quick: bool) -> float | None:
    """The compiled loop alone; None for peers and for ReferenceFlow, which has none."""
    if library is None or not isinstance(point.setting, int):
        return None
    repeats = 3 if quick or point.seconds > 0.02 else 50
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return library.loop(point.setting, repeats)


# What is printed and drawn.


def microseconds(seconds: float | None) -> str:
    """Three digits."""
    if seconds is None:
        return "-"
    value = 1e6 * seconds
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def print_result(result: Result) -> None:
    """One table: times, ratios to C."""
    print(f"\n{result.model}: microseconds to an error at T = {T:g} (times C)")
    truth = result.truth
    print(f"reference: {truth.source}, +- {truth.uncertainty:.1e}; disagreements "
          + ", ".join(f"{name} {value:.1e}" for name, value in truth.disagreements.items()))
    targets = sorted({cell.target for cell in result.cells}, reverse=True)
    rows = list(dict.fromkeys(row for row, _ in result.points))
    by = {(cell.row, cell.target): cell for cell in result.cells}
    width = max(map(len, rows)) + 2
    print(" " * width + "".join(f"{t:>20g}" for t in targets))
    for row in rows:
        line = ""
        for target in targets:
            cell, base = by.get((row, target)), by.get((BASELINE, target))
            text = microseconds(cell.seconds) if cell else "-"
            if cell and base:
                text += f" ({cell.seconds / base.seconds:.3g})"
            line += f"{text:>20s}"
        print(f"{row:{width}s}{line}")
    print("library: compiled loop called as the C is called (times C) / all of integrate()")
    for row in rows:
        cells = [by.get((row, target)) for target in targets]
        if not any(cell and cell.wall for cell in cells):
            continue
        line = ""
        for cell in cells:
            base = cell and by.get((BASELINE, cell.target))
            text = "-" if cell is None else f"{microseconds(cell.loop)}"
            if cell and cell.loop and base:
                text += f" ({cell.loop / base.seconds:.3g})"
            line += f"{text + ' / ' + microseconds(cell.wall) if cell else '-':>26s}"
        print(f"{row:{width}s}{line}")
    for note in result.notes:
        print("note:", note)


def as_data(result: Result) -> dict[str, Any]:
    """For JSON."""
    return {
        "model": result.model,
        "reference": {
            "source": result.truth.source,
            "uncertainty": result.truth.uncertainty,
            "disagreements": result.truth.disagreements,
        },
        "cells": [asdict(cell) for cell in result.cells],
        "points": {
            f"{row} | {name}": [asdict(p) for p in points if math.isfinite(p.error)]
            for (row, name), points in result.points.items()
        },
        "notes": result.notes,
    }


COLOURS = {
    "C, DOP853": "black", "heyoka, Taylor": "tab:red", "SciPy, DOP853": "0.55",
    "SciPy, LSODA": "0.75", "ReferenceFlow": "tab:green",
}  # fmt: skip


def frontier(lines: list[list[Point]]) -> list[tuple[float, float]]:
    """(microseconds, error): the fastest setting to every quarter of a decade, as in the tables.

    Of errors that one setting reaches, the smallest.
    """
    drawn: dict[float, float] = {}
    for target in 10.0 ** -np.arange(0.0, 13.75, 0.25):
        reached = [p for line in lines if (p := fastest(line, float(target))) is not None]
        if reached:
            drawn[1e6 * min(p.seconds for p in reached)] = float(target)
    return list(drawn.items())


def lines_to_draw(result: Result) -> dict[str, list[tuple[float, float]]]:
    """Peers, ReferenceFlow, and of every order the library method that gets furthest soonest."""
    by_row: dict[str, list[list[Point]]] = {}
    for (row, _), points in result.points.items():
        by_row.setdefault(row, []).append(points)
    lines = {row: frontier(found) for row, found in by_row.items()}
    drawn = {row: lines[row] for row in COLOURS if lines.get(row)}
    for order in ORDERS:
        goal = {2: 1e-4, 4: 1e-6, 6: 1e-7, 8: 1e-8}[order]
        rivals = [row for row in lines if row.startswith(f"GNI {order}") and lines[row]]
        if rivals:
            best = min(rivals, key=lambda row: _time_to(lines[row], goal))
            drawn[best] = lines[best]
    return drawn


def _time_to(line: list[tuple[float, float]], target: float) -> float:
    return min((time for time, error in line if error <= target), default=math.inf)


def figure(results: list[Result], path: Path) -> None:
    """Error against time, one panel per model."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shape = {"figsize": (4.6 * len(results), 6.4), "sharey": True, "squeeze": False}
    drawing, axes = plt.subplots(1, len(results), **shape)
    colours = plt.get_cmap("plasma")
    for axis, result in zip(axes[0], results, strict=True):
        for row, line in lines_to_draw(result).items():
            library = row.startswith("GNI")
            colour = colours((int(row[4]) - 2) / 7.5) if library else COLOURS[row]
            axis.loglog(*zip(*line, strict=True), "-" if library else "--", color=colour,
                        marker="o" if library else None, ms=2.5, lw=1.5, label=row)  # fmt: skip
            loops = [(1e6 * c.loop, c.target) for c in result.cells if c.row == row and c.loop]
            if loops:
                axis.plot(*zip(*loops, strict=True), ":", color=colour, marker="D", mfc="white",
                          ms=4, lw=1.0)  # fmt: skip
        axis.plot([], [], ":", color="0.3", marker="D", mfc="white", ms=4, lw=1.0,
                  label="compiled loop of the same alone")  # fmt: skip
        axis.set_title(result.model)
        axis.set_xlabel(f"microseconds of one warm run to T = {T:g}")
        axis.grid(True, which="major", alpha=0.25)
        axis.set_ylim(1e-13, 1.0)
        axis.legend(fontsize=7.5, loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=2)
    axes[0, 0].set_ylabel("largest error of base point and velocity")
    drawing.savefig(path, dpi=130, bbox_inches="tight")
    plt.close(drawing)


def main(arguments: Iterable[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse scans, few turns")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    parser.add_argument("--figure", type=Path, help="file for the work-precision figure")
    options = parser.parse_args(None if arguments is None else list(arguments))
    step_cost.report_machine()
    results = []
    with step_cost.one_core() as where, tempfile.TemporaryDirectory() as folder:
        print(where)
        for make in MODELS:
            result = measure(make(), Path(folder), options.quick)
            print_result(result)
            sys.stdout.flush()
            results.append(result)
    if options.json:
        options.json.write_text(json.dumps([as_data(result) for result in results], indent=1))
    if options.figure:
        figure(results, options.figure)


if __name__ == "__main__":
    main()
