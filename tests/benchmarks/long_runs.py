"""The time to keep energy and constraint over long runs, against DOP853 in C, heyoka and SciPy.

    python tests/benchmarks/long_runs.py [--quick] [--json FILE] [--figure FILE]
        [--only NAME ...] [--read FILE]

A run to T counts as kept within a tolerance when its relative energy error stays below it and its
violation (constraints, orthogonality) below 1e-10, all along. Times are processor times, of runs to
T = 1e4 (watching the peers is not timed: they run again without), and in proportion to T beyond.
All settings are scanned up to T = 1e4; those whose drift so far lets hope are run to 1e5 and 1e6,
unless they would take more than twice as long as the fastest that kept the tolerance, or 30 s.
SciPy is run to T = 1e3 and extrapolated, time and energy error alike in proportion to T; so marked.
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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import peers  # noqa: E402
import step_cost  # noqa: E402
import time_to_accuracy  # noqa: E402
from time_to_accuracy import BASELINE, tolerances  # noqa: E402

import groupoid_gni as gni  # noqa: E402

MODELS: dict[str, Callable[[], peers.Model]] = {
    "particle": peers.quartic_particle,
    "ball": lambda: peers.ball(0.0),
    "transmission": lambda: peers.gearbox(shifted=False),
    "transmission-shifted": peers.gearbox,
    "contact": peers.contact_oscillator,
    "contact-chaotic": lambda: peers.contact_oscillator(2.0),
}
SHORT, LONG = 1e4, 1e6
HORIZONS = (1e2, 1e3, 1e4, 1e5, 1e6)
TOLERANCES = (1e-3, 1e-6, 1e-9)
AIMS = tuple((horizon, tolerance) for horizon in (1e5, LONG) for tolerance in TOLERANCES)
VIOLATION = 1e-10
LEFT_OUT = tuple(
    f"GNI {order}, {flow}, unprojected"
    for order in time_to_accuracy.ORDERS
    for flow in ("Variational", "EnergyPreserving")
)
"""The bare stages of one flow show what leaving out the projection does."""
SAME_ON_RN = tuple(f"GNI {order}, Splitting" for order in time_to_accuracy.ORDERS)
"""There splitting is the default variational flight."""
MOST_UNUSABLE = 10
"""Settings in a row that may fail or be slow at the loose end; a third of them later."""
NODES = 20_000
"""Most nodes that are looked at in one run."""


@dataclass(frozen=True)
class Limits:
    """What one run may take by prediction: seconds to SHORT and to LONG.

    times_fastest : and beyond SHORT not more than this many times the fastest run known to keep the
        tolerance that the run is meant for.
    """

    short: float = 0.6
    long: float = 30.0
    times_fastest: float = 2.0


@dataclass
class Record:
    """What one setting did.

    per_time : seconds per unit of time, unwatched.
    kept : horizon -> largest relative energy error and largest violation up to there.
    position : horizon -> error of the state's configuration there; not for chaotic motions.
    """

    row: str
    name: str
    setting: Any
    per_time: float
    kept: dict[float, tuple[float, float]]
    position: dict[float, float]
    extrapolated: bool = False

    def keeps(self, horizon: float, tolerance: float) -> bool:
        """Within the tolerance up to the horizon, as far as is known."""
        if horizon not in self.kept:
            return False
        energy, violation = self.kept[horizon]
        return energy <= tolerance and violation <= VIOLATION


@dataclass(frozen=True)
class Watched:
    """One run: nodes and states there (library coordinates), and seconds without watching.

        Runs beyond SHORT need not be timed: nan.
    worst : extremes of |E - E0| and violation up to each node, where they are known.
    """

    times: np.ndarray
    states: np.ndarray
    seconds: float
    worst: np.ndarray | None = None


@dataclass(frozen=True)
class Contender:
    """``run(setting, t_end)`` watches one run; settings from loose to strict."""

    row: str
    name: str
    settings: tuple[Any, ...]
    run: Callable[[Any, float], Watched]


def cpu_seconds(work: Callable[[], Any]) -> float:
    """Processor time: these runs are too long to wait for a quiet machine."""
    began = time.process_time()
    work()
    return time.process_time() - began


# The four kinds of contenders.


def in_c(form: peers.HandDerived, folder: Path, per_decade: int) -> Contender:
    """DOP853, watched at the end of every step."""
    code = peers.C(form, folder)

    def run(rtol: float, t_end: float) -> Watched:
        seconds = math.nan
        if t_end <= SHORT:
            seconds = min(cpu_seconds(lambda: code.run(t_end, rtol)) for _ in range(2))
        y, reached = form.start.copy(), 0.0
        times, states, worst = [0.0], [form.library_state(y)], [np.zeros(2)]
        e0 = code.energy_and_violation(y)[0]
        for t in [h for h in HORIZONS if h <= t_end]:
            watched = np.array([*worst[-1], e0])
            code.advance(y, t - reached, rtol, watched)
            times.append(t)
            states.append(form.library_state(y))
            worst.append(watched[:2])
            reached = t
        return Watched(np.array(times), np.array(states), seconds, np.array(worst))

    return Contender(BASELINE, form.name, tolerances(3, 14, per_decade), run)


def by_series(form: peers.HandDerived, hy: Any, per_decade: int) -> Contender:
    """heyoka, watched through its dense output."""
    series = peers.Taylor(form, hy)

    def run(tolerance: float, t_end: float) -> Watched:
        series.at(tolerance)
        seconds = math.nan
        if t_end <= SHORT:
            seconds = min(cpu_seconds(lambda: series.run(t_end, tolerance)) for _ in range(2))
        times = np.linspace(0.0, t_end, NODES + 1)
        integrator = series.at(tolerance)
        *_, native = integrator.propagate_grid(times, max_steps=peers.most_steps(t_end))
        return Watched(times, form.library_state(np.asarray(native)), seconds)

    return Contender("heyoka, Taylor", form.name, tolerances(3, 16, per_decade), run)


def by_scipy(model: peers.Model) -> Contender:
    """SciPy's DOP853 with the right-hand side in NumPy; only to T = 1e3."""
    from scipy.integrate import solve_ivp

    def run(rtol: float, t_end: float) -> Watched:
        form = model.numpy
        began = time.process_time()
        solution = solve_ivp(
            form.field, (0.0, t_end), form.start, method="DOP853", rtol=rtol, atol=1e-2 * rtol
        )
        seconds = time.process_time() - began
        return Watched(solution.t, form.library_state(solution.y.T), seconds)

    return Contender("SciPy, DOP853", "", (1e-5, 1e-8, 1e-11), run)


def by_library(model: peers.Model, row: str, method: Any, per_doubling: int) -> Contender:
    """A fixed-step method; the setting is the number of steps in 100 time units."""

    def run(count: int, t_end: float) -> Watched:
        steps = round(count * t_end / 100.0)
        began = time.process_time()
        result = gni.integrate(
            model.scene.system, model.scene.start, step=100.0 / count, n_steps=steps,
            method=method, save_every=max(1, -(-steps // NODES)),
        )  # fmt: skip
        seconds = time.process_time() - began
        states = np.concatenate([result.base, result.velocities], axis=1)
        return Watched(result.times, states, seconds)

    counts = time_to_accuracy.step_counts(8, 1 << 15, per_doubling)
    return Contender(row, "", counts, run)


def by_reference_flow(model: peers.Model, per_decade: int) -> Contender:
    """``ReferenceFlow``; the setting is its tolerance."""

    def run(rtol: float, t_end: float) -> Watched:
        nodes = 200
        began = time.process_time()
        result = gni.integrate(
            model.scene.system, model.scene.start, step=t_end / nodes, n_steps=nodes,
            method=gni.ReferenceFlow(rtol=rtol),
        )  # fmt: skip
        seconds = time.process_time() - began
        states = np.concatenate([result.base, result.velocities], axis=1)
        return Watched(result.times, states, seconds)

    return Contender("ReferenceFlow", "", tolerances(3, 13, per_decade), run)


def contenders_of(
    model: peers.Model, folder: Path, quick: bool
) -> tuple[list[Contender], list[str]]:
    """Everybody who runs here, and what could not be had."""
    found, notes = [], []
    fine = 1 if quick else 2
    if step_cost.c_compiler():
        found += [in_c(form, folder, fine) for form in model.c_forms]
    else:
        notes.append("C: no compiler (cc)")
    if (hy := peers.heyoka_module()) is not None:
        found += [by_series(form, hy, 1) for form in model.forms]
    else:
        notes.append('heyoka is not installed: pip install "groupoid-gni[peers]"')
    found += [by_scipy(model), by_reference_flow(model, fine)]
    on_rn = isinstance(model.scene.system.space, gni.PairGroupoid)
    for row, (method, _) in time_to_accuracy.available(model.scene, notes).items():
        if row not in LEFT_OUT and not (on_rn and row in SAME_ON_RN):
            found.append(by_library(model, row, method, fine))
    return found, notes


# Judging runs.


class Judge:
    """Turns watched runs into records; knows the positions at the horizons where that makes sense.

    positions : horizon -> configuration and its uncertainty, from C in long double. To LONG that
        would take minutes for every model.
    """

    def __init__(self, model: peers.Model, folder: Path) -> None:
        self.model = model
        self.e0 = float(model.look(np.concatenate(
            [model.scene.start.base, model.scene.start.velocity]))[0])  # fmt: skip
        self.n = model.scene.system.space.base_size
        self.positions: dict[float, tuple[np.ndarray, float]] = {}
        if not model.chaotic and step_cost.c_compiler():
            self._find_positions(folder)

    def _find_positions(self, folder: Path) -> None:
        form = self.model.c_forms[0]
        code = peers.C(form, folder, extended=True)
        ends = [code.run(SHORT, rtol).end[: self.n] for rtol in (1e-15, 1e-16)]
        self.positions[SHORT] = ends[1], time_to_accuracy.distance(*ends)

    def record(self, contender: Contender, setting: Any, t_end: float) -> Record:
        """One run, judged at all horizons up to its end; a failed one keeps nothing."""
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                watched = contender.run(setting, t_end)
        except (gni.StepFailure, RuntimeError):
            return Record(contender.row, contender.name, setting, math.inf, {}, {})
        if watched.worst is not None:
            errors, off = watched.worst[:, 0] / abs(self.e0), watched.worst[:, 1]
        else:
            energy, off = self.model.look(watched.states)
            errors = np.abs(energy - self.e0) / abs(self.e0)
            off = np.where(np.isfinite(off), off, math.inf)
            errors = np.where(np.isfinite(errors), errors, math.inf)
        kept, position = {}, {}
        # a run to LONG has too few nodes before SHORT
        for horizon in [h for h in HORIZONS if t_end / 1e2 <= h <= t_end]:
            so_far = watched.times <= horizon * (1.0 + 1e-12)
            kept[horizon] = float(np.max(errors[so_far])), float(np.max(off[so_far]))
        if t_end in self.positions:
            truth = self.positions[t_end][0]
            position[t_end] = time_to_accuracy.distance(watched.states[-1, : self.n], truth)
        per_time = watched.seconds / t_end
        return Record(contender.row, contender.name, setting, per_time, kept, position)


def survey(judge: Judge, contender: Contender, limits: Limits) -> list[Record]:
    """Settings from loose to strict up to SHORT, until four in a row keep the last tolerance.

    And until the time rises again: with steps too long an implicit method is slow as well.
    """
    records: list[Record] = []
    unusable = 0
    by_hand = contender.row.startswith("SciPy")
    t_end, allowed = (1e3, 10.0) if by_hand else (SHORT, limits.short)
    for setting in contender.settings:
        trial = judge.record(contender, setting, 1e2)
        if trial.per_time * t_end > allowed:
            unusable += 1
            if unusable > (MOST_UNUSABLE // 3 if records else MOST_UNUSABLE):
                break
            continue
        unusable = 0
        record = judge.record(contender, setting, t_end)
        record.kept = {**trial.kept, **record.kept}
        if by_hand:
            _extrapolate(record)
        records.append(record)
        good = [r.kept.get(t_end, (1.0,))[0] < TOLERANCES[-1] / 1e2 for r in records[-4:]]
        rising = record.per_time > 1.3 * min(r.per_time for r in records)
        if len(good) == 4 and all(good) and rising:
            break
    return records


def _extrapolate(record: Record) -> None:
    """Energy error and violation in proportion to T, beyond what was run."""
    last = max(record.kept)
    energy, violation = record.kept[last]
    for horizon in [h for h in HORIZONS if h > last]:
        record.kept[horizon] = energy * horizon / last, violation * horizon / last
    record.extrapolated = True


def continued(
    judge: Judge,
    contender: Contender,
    records: list[Record],
    fastest: dict[tuple[float, float], float],
    limits: Limits,
) -> list[str]:
    """Take records on beyond SHORT, in place; returns notes on what took too long.

    fastest : (horizon, tolerance) -> seconds per unit of time of the fastest known to keep it.
    """
    slow: dict[float, float] = {}
    for horizon, tolerance in AIMS:
        allowed = limits.times_fastest * fastest.get((horizon, tolerance), math.inf)
        for record in _hopeful(records, horizon, tolerance):
            if record.per_time > min(allowed, limits.long / horizon):
                if horizon == LONG:
                    slow[tolerance] = record.per_time * LONG
                break
            if horizon not in record.kept:
                _take_on(judge, contender, record, horizon)
            if record.keeps(horizon, tolerance):
                break
    if not slow:
        return []
    texts = [f"{seconds_text(seconds)} for {tolerance:g}" for tolerance, seconds in slow.items()]
    name = ", ".join(filter(None, (contender.row, contender.name)))
    return [f"too slow to be run to {LONG:g}, by prediction: {name}, {', '.join(texts)}"]


def _take_on(judge: Judge, contender: Contender, record: Record, horizon: float) -> None:
    further = judge.record(contender, record.setting, horizon)
    lost = dict.fromkeys(HORIZONS, (math.inf, math.inf))
    record.kept.update({h: v for h, v in (further.kept or lost).items() if h > SHORT})


def _hopeful(records: list[Record], horizon: float, tolerance: float) -> list[Record]:
    """The three fastest settings whose error, growing as it did, may end within the tolerance.

    What grew by a factor from 1e3 to 1e4 is taken to grow by as much in every further decade.
    """
    hopeful = []
    decades = round(math.log10(horizon / SHORT))
    for record in records:
        if record.extrapolated or not record.keeps(SHORT, tolerance):
            continue
        before, after = record.kept[1e3][0], record.kept[SHORT][0]
        growth = min(max(after / max(before, 1e-16), 1.0), 30.0)
        if after * growth**decades <= 1.5 * tolerance:
            hopeful.append(record)
    return sorted(hopeful, key=lambda r: r.per_time)[:3]


@dataclass(frozen=True)
class Result:
    """One model measured."""

    model: str
    records: list[Record]
    uncertainties: dict[float, float]
    notes: list[str]


def measure(model: peers.Model, folder: Path, quick: bool) -> Result:
    """Everybody on one model."""
    judge = Judge(model, folder)
    limits = Limits(0.3) if quick else Limits()
    contenders, notes = contenders_of(model, folder, quick)
    everything: list[Record] = []
    fastest: dict[tuple[float, float], float] = {}
    for contender in contenders:
        records = survey(judge, contender, limits)
        if not quick:
            notes += continued(judge, contender, records, fastest, limits)
        everything += records
        for aim in AIMS:
            keeping = [r.per_time for r in everything if r.keeps(*aim) and not r.extrapolated]
            if keeping:
                fastest[aim] = min(keeping)
    uncertainties = {t: u for t, (_, u) in judge.positions.items()}
    return Result(model.name, everything, uncertainties, notes)


def best(
    result: Result, horizon: float, tolerance: float, row: str | None = None
) -> Record | None:
    """The fastest record that keeps the tolerance up to the horizon, of one row or of all."""
    keeping = [
        r for r in result.records if r.keeps(horizon, tolerance) and row in (None, r.row)
    ]
    return min(keeping, key=lambda r: r.per_time) if keeping else None


# What is printed and drawn.


def seconds_text(seconds: float) -> str:
    """Milliseconds below a second."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1.0 else f"{seconds:.3g} s"


def print_result(result: Result, horizons: Iterable[float] = (SHORT, LONG)) -> None:
    """One table per horizon: time (times C), energy error reached, position error."""
    rows = list(dict.fromkeys(r.row for r in result.records))
    width = max(map(len, rows)) + 2
    for horizon in horizons:
        known = result.uncertainties.get(horizon)
        print(f"\n{result.model}, T = {horizon:g}: time (times C), energy error"
              + (f", position error (+- {known:.0e})" if known is not None else ""))
        print(" " * width + "".join(f"{t:>34g}" for t in TOLERANCES))
        for row in rows:
            line = ""
            for tolerance in TOLERANCES:
                record = best(result, horizon, tolerance, row)
                base = best(result, horizon, tolerance, BASELINE)
                line += f"{_cell(record, base, horizon, known):>34s}"
            if line.replace("-", "").strip():
                print(f"{row:{width}s}{line}")
        nothing = [row for row in rows
                   if not any(best(result, horizon, t, row) for t in TOLERANCES)]  # fmt: skip
        if nothing:
            print("keeps none of them, or not within the time allowed:", "; ".join(nothing))
    for note in result.notes:
        print("note:", note)


def _cell(
    record: Record | None, base: Record | None, horizon: float, known: float | None
) -> str:
    if record is None:
        return "-"
    text = ("~" if record.extrapolated else "") + seconds_text(record.per_time * horizon)
    if base is not None:
        text += f" ({record.per_time / base.per_time:.2g})"
    text += f" {record.kept[horizon][0]:.0e}"
    if known is not None and horizon in record.position:
        error = record.position[horizon]
        text += f" {error:.0e}" if error > 3.0 * known else f" <{3.0 * known:.0e}"
    return text


def kind(row: str) -> str:
    """Library methods without their flow, for colours."""
    return row.split(",")[0] if row.startswith("GNI") else row


COLOURS = {
    "C, DOP853": "black", "heyoka, Taylor": "tab:red", "SciPy, DOP853": "0.6",
    "ReferenceFlow": "tab:green", "Rattle": "tab:cyan", "GNI 2": "#3b0f70", "GNI 4": "#8c2981",
    "GNI 6": "#de4968", "GNI 8": "#fe9f6d",
}  # fmt: skip


def figure(results: list[Result], path: Path) -> None:
    """Seconds against T for C, heyoka and the best library method; one row per tolerance."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shape = {"figsize": (3.5 * len(results), 9.0), "squeeze": False, "sharex": True}
    drawing, axes = plt.subplots(len(TOLERANCES), len(results), **shape)
    for column, result in enumerate(results):
        for line, tolerance in enumerate(TOLERANCES):
            axis = axes[line, column]
            _frontier(axis, result, tolerance)
            axis.grid(True, which="major", alpha=0.25)
            if line == 0:
                axis.set_title(result.model, fontsize=10)
            if line == len(TOLERANCES) - 1:
                axis.set_xlabel("T")
            if column == 0:
                axis.set_ylabel(f"energy kept to {tolerance:g}\nmicroseconds per unit of time")
    drawing.tight_layout()
    drawing.savefig(path, dpi=120)
    plt.close(drawing)


def _frontier(axis: Any, result: Result, tolerance: float) -> None:
    """Cost per unit of time against T; of the library the best method at each T, named."""
    def line(rows: list[str]) -> list[tuple[float, Record]]:
        found = []
        for horizon in HORIZONS:
            candidates = [r for row in rows if (r := best(result, horizon, tolerance, row))]
            if candidates:
                found.append((horizon, min(candidates, key=lambda r: r.per_time)))
        return found

    rows = list(dict.fromkeys(r.row for r in result.records))
    for row in ("C, DOP853", "heyoka, Taylor"):
        if points := line([row]):
            axis.loglog([t for t, _ in points], [1e6 * r.per_time for _, r in points],
                        "o--", ms=3, color=COLOURS[row], label=row)  # fmt: skip
    library = line([row for row in rows if row == "Rattle" or row.startswith("GNI")])
    if library:
        times = [t for t, _ in library]
        costs = [1e6 * r.per_time for _, r in library]
        axis.loglog(times, costs, "-", lw=1, color="tab:blue", label="library, fastest method")
        for t, cost, (_, record) in zip(times, costs, library, strict=True):
            axis.plot(t, cost, "o", ms=5, color=COLOURS[kind(record.row)])
            axis.annotate(_short(record.row), (t, cost), fontsize=6, rotation=20,
                          xytext=(2, 5), textcoords="offset points")  # fmt: skip
    axis.margins(y=0.25)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=6.5, loc="best")


def _short(row: str) -> str:
    for long, short in (("Variational", "V"), ("Splitting", "S"), ("EnergyPreserving", "E"),
                        (", unprojected", " unpr."), ("GNI ", "")):  # fmt: skip
        row = row.replace(long, short)
    return row.replace(", ", "")


def as_data(result: Result) -> dict[str, Any]:
    """For JSON."""
    return {
        "model": result.model,
        "records": [asdict(r) for r in result.records if math.isfinite(r.per_time)],
        "position uncertainty": result.uncertainties,
        "notes": result.notes,
    }


def from_data(data: dict[str, Any]) -> Result:
    """What ``as_data`` gave, read from JSON."""
    records = []
    for given in data["records"]:
        kept = {float(h): (v[0], v[1]) for h, v in given["kept"].items()}
        position = {float(h): v for h, v in given["position"].items()}
        records.append(Record(**{**given, "kept": kept, "position": position}))
    uncertainties = {float(h): v for h, v in data["position uncertainty"].items()}
    return Result(data["model"], records, uncertainties, data["notes"])


def main(arguments: Iterable[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse, up to T = 1e4 only")
    parser.add_argument("--json", type=Path, help="file for all numbers")
    parser.add_argument("--figure", type=Path, help="file for the frontier figure")
    parser.add_argument("--read", type=Path, help="print and draw what --json wrote; run nothing")
    parser.add_argument("--only", nargs="*", choices=MODELS, default=list(MODELS))
    options = parser.parse_args(None if arguments is None else list(arguments))
    if options.read:
        results = [from_data(data) for data in json.loads(options.read.read_text())]
        for result in results:
            print_result(result)
        if options.figure:
            figure(results, options.figure)
        return
    step_cost.report_machine()
    results = []
    with step_cost.one_core() as where, tempfile.TemporaryDirectory() as folder:
        print(where)
        for name in options.only:
            began = time.perf_counter()
            result = measure(MODELS[name](), Path(folder), options.quick)
            print_result(result, (SHORT,) if options.quick else (SHORT, LONG))
            print(f"({time.perf_counter() - began:.0f} s of measuring)")
            sys.stdout.flush()
            results.append(result)
            if options.json:
                data = [as_data(result) for result in results]
                options.json.write_text(json.dumps(data, indent=1))
    if options.figure:
        figure(results, options.figure)


if __name__ == "__main__":
    main()
