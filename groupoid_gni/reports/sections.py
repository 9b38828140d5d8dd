"""The parts of the report: each measures, draws its figure, and gives its text."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from groupoid_gni import scenes
from groupoid_gni.diagnostics import energy_drift
from groupoid_gni.discretization import EnergyPreserving, Rattle, Splitting
from groupoid_gni.errors import GNIWarning
from groupoid_gni.integrators import (
    GNI,
    DiscreteLagrangeDAlembert,
    Method,
    ReferenceFlow,
    integrate,
    integrate_ensemble,
)
from groupoid_gni.reports.cold_start import STEPS, cold_start
from groupoid_gni.reports.cost_model import CostModel, cost
from groupoid_gni.reports.fits import TimeTo, seconds_text
from groupoid_gni.reports.markdown import markdown_table
from groupoid_gni.reports.measurements import Measurement
from groupoid_gni.reports.peers import Peer
from groupoid_gni.reports.report_scenes import COLD, ReportScene, flows, methods_for
from groupoid_gni.reports.work_precision import WorkPrecision, work_precision
from groupoid_gni.scenes import Scene

TARGETS = (1e-3, 1e-6, 1e-9, 1e-11)
PeersOf = Callable[[str, Scene, float, bool], Sequence[Peer]]


@dataclass(frozen=True)
class Comparisons:
    """What a checkout of the sources adds to the report.

    peers : (name of the scene, scene, t_end, quick) -> peers.  notes : who is absent, and why.
    packages : whose versions are to be named.  sections : quick -> (title, text) of further parts.
    """

    peers: PeersOf
    notes: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    sections: Callable[[bool], Sequence[tuple[str, str]]] = lambda quick: ()


@dataclass(frozen=True)
class Request:
    """What to measure and where to put the figures (``folder``/figures)."""

    quick: bool
    folder: Path
    scenes: tuple[ReportScene, ...]
    say: Callable[[str], None]

    def keep(self, figure: Any, name: str, caption: str) -> str:
        """Write a figure and give the Markdown that shows it."""
        target = self.folder / "figures" / f"measured_{name}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(target, dpi=110)
        return f"![{caption}](figures/{target.name})"

    def keep_table(self, name: str, table: str, caption: str) -> str:
        """Write a long table to a page of its own, without padding, and give the link."""
        target = self.folder / "measured" / f"{name}.md"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(re.sub(r"-{4,}", "---", re.sub(r" {2,}", " ", table)) + "\n", "utf-8")
        return f"[{caption}](measured/{target.name})"


# Speed against error.


def speed_against_error(
    request: Request, comparisons: Comparisons | None
) -> tuple[str, dict[str, WorkPrecision]]:
    """For every scene a figure, the times to four errors, and a link to the whole table."""
    parts, found = [], {}
    settings: dict[str, str] = {}
    for entry in request.scenes:
        began = time.perf_counter()
        scene = entry.make()
        methods: dict[str, Method] = methods_for(scene, request.quick)
        peers = () if comparisons is None else comparisons.peers(
            entry.name, scene, entry.t_end, request.quick
        )
        made = found[entry.name] = _measured(entry, scene, methods, peers, request.quick)
        settings.update(made.peer_settings)
        figure = request.keep(made.plot(), f"speed_{entry.name}", f"{entry.name}: error and time")
        parts += [
            f"### {entry.name}",
            f"{made.scene}; t = 0 ... {made.t_end:g}. Errors are the largest of base coordinates "
            f"and velocities at the end, against {made.reference} (good to {made.estimate:.0e}).",
            figure,
            made.time_table(TARGETS),
            request.keep_table(entry.name, made.table(), "all settings"),
        ]
        request.say(f"{entry.name}: {time.perf_counter() - began:.1f} s")
    how = [f"- {name}: {text}" for name, text in settings.items() if text]
    if how:
        parts.insert(0, "Peers are set up as follows.\n\n" + "\n".join(how))
    return "\n\n".join(parts), found


def _measured(
    entry: ReportScene,
    scene: Scene,
    methods: dict[str, Method],
    peers: Sequence[Peer],
    quick: bool,
) -> WorkPrecision:
    return work_precision(
        scene, {**methods, "ReferenceFlow": flows(quick)}, entry.steps(quick), t_end=entry.t_end,
        repeats=3 if quick else 9, attitude=not quick, peers=peers,
    )  # fmt: skip


def wins_and_losses(found: dict[str, WorkPrecision]) -> str:
    """For every scene and error the fastest of the library and of the peers, in words."""
    lines, won, counted = [], 0, 0
    for name, table in found.items():
        for target in TARGETS:
            mine = _best(table, target, lambda row: not row.is_peer)
            other = _best(table, target, lambda row: row.is_peer)
            stepping = _best(table, target, lambda row: row.step is not None)
            counted += other is not None
            won += mine is not None and other is not None and mine[0] <= other[0]
            lines.append(f"- {name}, {target:.0e}: {_verdict(mine, other, stepping)}")
    head = "No peers took part." if not counted else (
        f"Of {counted} pairs of scene and error that a peer reached, the library was the faster "
        f"in {won}. ReferenceFlow is a method of the library, but one without structure; the "
        "fastest method with structure is named too."
    )
    return head + "\n\n" + "\n".join(lines)


Best = tuple[float, str, TimeTo] | None


def _best(table: WorkPrecision, target: float, wanted: Callable[[Measurement], bool]) -> Best:
    """The fastest of the wanted lines that reach the error: seconds, name, how sure that is."""
    reached = [
        (found.seconds, line, found)
        for line, (found,) in table.time_to([target]).items()
        if found is not None and wanted(table.lines[line][0])
    ]
    return min(reached, default=None, key=lambda entry: entry[0])


def _verdict(mine: Best, other: Best, stepping: Best) -> str:
    said = [
        f"{who} {found[1]} {found[2]}"
        for who, found in (("library", mine), ("peers", other), ("with structure", stepping))
        if found is not None and not (who == "with structure" and found == mine)
    ]
    if mine is None:
        said.append("not reached by the library")
    elif other is not None:
        ratio = other[0] / mine[0]
        said.append(f"won, {ratio:.3g} times faster" if ratio >= 1.0 else (
            f"lost, {1.0 / ratio:.3g} times slower"
        ))
    return "; ".join(said)


# Cost.


def cost_table(request: Request) -> str:
    """Operations, iterations and nanoseconds of every scene with a few methods."""
    rows = []
    for entry in request.scenes:
        scene = entry.make()
        for name, method in methods_for(scene, True).items():
            model = cost(
                scene, method, n_steps=300 if request.quick else 1000,
                repeats=5 if request.quick else 20,
            )  # fmt: skip
            per_place = [str(sum(model.operations[p].values())) for p in ("stage", "iteration")]
            per_step, build = model.per_step(), model.build
            rows.append([
                f"{entry.name}, {name}", str(model.state_size), *per_place, str(model.stages),
                f"{model.iterations:.2f}", f"{per_step:.0f}",
                *(f"{model.per_step(kind):.0f}" for kind in ("divide", "square root", "sine")),
                f"{model.nanoseconds:.0f}", f"{model.ir_lines}",
                *(f"{seconds:.3f}" for seconds in (build.derive, build.emit, build.compile)),
            ])  # fmt: skip
        request.say(f"cost of {entry.name}")
    heading = [
        "scene, method", "state", "per stage", "per iteration", "stages", "iterations", "per step",
        "divisions", "roots", "sines", "ns", "IR lines", "derive s", "emit s", "LLVM s",
    ]  # fmt: skip
    return (
        "Arithmetic operations are counted in the emitted code (a multiply-add is one) and "
        "multiplied with the stages and Newton iterations of a step of 0.02; ns is measured.\n\n"
        + markdown_table(heading, rows)
    )


# Energy over a long run.


def energy_over_a_long_run(request: Request) -> str:
    """A reversible and a non-reversible motion, four methods, and what the drift verdict says."""
    from groupoid_gni.plotting import plot_energy_records

    steps = 20_000 if request.quick else 1_000_000
    subjects = {
        "constrained particle, reversible": (scenes.constrained_particle(1.3, 0.9, 0.7), 0.05),
        "variable transmission, not reversible": (
            scenes.variable_transmission(gearing=(0.3, 1.0, 0.4, 0.5)), 0.05),
    }  # fmt: skip
    methods: dict[str, Method] = {
        "Lagrange-d'Alembert": DiscreteLagrangeDAlembert(), "GNI 2": GNI(), "GNI 4": GNI(order=4),
        "GNI 4, exact energy": GNI(order=4, flow=EnergyPreserving()),
        "ReferenceFlow 1e-6": ReferenceFlow(rtol=1e-6),
    }  # fmt: skip
    panels: dict[str, dict[str, Any]] = {}
    rows = []
    for title, (scene, h) in subjects.items():
        for name, method in methods.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", GNIWarning)
                run = integrate(
                    scene.system, scene.start, step=h, n_steps=steps, method=method,
                    save_every=max(1, steps // 20_000), on_failure="return",
                )  # fmt: skip
            energy = run.energy()
            change = (energy - energy[0]) / abs(energy[0])
            panels.setdefault(title, {})[name] = (run.times, change)
            rows.append([
                f"{title}: {name}", f"{run.times[-1]:.3g}", f"{np.max(np.abs(change)):.1e}",
                _drift_in_words(run), seconds_text(run.seconds),
            ])  # fmt: skip
        request.say(f"energy of {title}")
    figure = plot_energy_records(panels, "largest relative energy error so far")
    return "\n\n".join([
        request.keep(figure, "energy", "energy over a long run"),
        f"Steps of 0.05, {steps} of them.",
        markdown_table(["scene and method", "t", "largest error", "verdict", "time"], rows),
    ])  # fmt: skip


def _drift_in_words(run: Any) -> str:
    if not run.success:
        return run.outcome.name.lower()
    try:
        return str(energy_drift(run).verdict.value)
    except ValueError as refusal:
        return str(refusal).splitlines()[0][:40]


# Cold start.


def cold_starts(request: Request) -> str:
    """Three scenes, from the start of the process to the end of 10^4 steps."""
    rows = []
    for name in COLD:
        found = cold_start(name, repeats=1 if request.quick else 5)
        parts = (found.whole, found.imports, found.record, found.differentiate, found.emit,
                 found.compile, found.run)  # fmt: skip
        rows.append([name, *(f"{seconds:.3f}" for seconds in parts)])
        request.say(f"cold start of {name}")
    heading = ["scene", "whole process", "import", "record", "differentiate", "emit", "compile",
               "run"]  # fmt: skip
    return (
        f"Seconds from the start of a process to the end of {STEPS} steps of GNI(), object cache "
        "off; the parts are measured in a process of their own.\n\n" + markdown_table(heading, rows)
    )


# Ensembles and chains.


def ensembles(request: Request) -> str:
    """Throughput over lanes and threads against a loop of single runs."""
    members, steps = (64, 4000) if request.quick else (256, 20_000)
    scene = scenes.inhomogeneous_ball()
    masses = np.linspace(0.8, 1.6, members)
    masses_of = {"m": masses}
    options: dict[str, Any] = {"step": 0.02, "n_steps": steps, "method": GNI()}
    starts = [scene.system.with_parameters(m=m).state(
        scene.start.base, scene.start.velocity) for m in masses]  # fmt: skip

    def loop() -> None:
        for m, start in zip(masses, starts, strict=True):
            system = scene.system.with_parameters(m=m)
            integrate(system, start, save_every=steps, **options)

    def together(**more: Any) -> Callable[[], object]:
        return lambda: integrate_ensemble(
            scene.system, starts, parameters=masses_of, **options, **more
        )

    runs: dict[str, Callable[[], object]] = {
        "loop of integrate": loop, "1 lane": together(lanes=1), "4 lanes": together(lanes=4),
        "8 lanes": together(lanes=8), "8 lanes, 2 threads": together(lanes=8, threads=2),
    }  # fmt: skip
    for run in runs.values():
        run()
    best = dict.fromkeys(runs, np.inf)
    for _ in range(3 if request.quick else 7):
        for name, run in runs.items():
            began = time.perf_counter()
            run()
            best[name] = min(best[name], time.perf_counter() - began)
    whole = members * steps
    rows = [[name, f"{1e9 * seconds / whole:.1f}", f"{best['1 lane'] / seconds:.2f}",
             f"{best['loop of integrate'] / seconds:.2f}"] for name, seconds in best.items()]
    return (
        f"Inhomogeneous ball, GNI(), {members} masses, {steps} steps each; wall time.\n\n"
        + markdown_table(["", "ns per member and step", "times 1 lane", "times the loop"], rows)
    )  # fmt: skip


CHAINED: dict[str, Method] = {
    "GNI 2": GNI(),
    "Rattle": Rattle(),
    "GNI 4, splitting, bare": GNI(order=4, flow=Splitting(), projection=None),
}


def exponent(sizes: Sequence[int], costs: Sequence[float], least: int) -> float:
    """Slope of log cost against log size, by least squares from the size ``least`` on."""
    logs = np.log([pair for pair in zip(sizes, costs, strict=True) if pair[0] >= least])
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def _chain_costs(request: Request, sizes: Sequence[int], method: Method) -> list[CostModel]:
    return [
        cost(scenes.chain_of_skates(n), method, step=0.02, n_steps=50 if request.quick else 500,
             repeats=3 if request.quick else 7)
        for n in sizes
    ]  # fmt: skip


def chains(request: Request) -> str:
    """Cost of a step against the number of coupled bodies."""
    from groupoid_gni.plotting import plot_scaling

    sizes = (2, 5, 10, 20, 40, 80) if request.quick else (1, 2, 5, 10, 20, 50, 100, 200)
    found = {}
    for name, method in CHAINED.items():
        found[name] = _chain_costs(request, sizes, method)
        request.say(f"chains, {name}")
    times = {name: [m.nanoseconds or np.nan for m in models] for name, models in found.items()}
    growth = [
        [name, *(f"{exponent(sizes, ns, least):.2f}" for least in (1, 5, 20)),
         *(f"{ns[k] / sizes[k]:.0f}" for k in (1, -1)), f"{found[name][-1].build.total:.2f}"]
        for name, ns in times.items()
    ]  # fmt: skip
    models = found["GNI 2"]
    rows = [
        [str(n), f"{m.nanoseconds:.0f}", f"{(m.nanoseconds or 0.0) / n:.0f}", f"{m.iterations:.2f}",
         str(m.ir_lines), f"{m.build.derive:.2f}", f"{m.build.emit:.2f}", f"{m.build.compile:.2f}",
         f"{m.build.total:.2f}"]
        for n, m in zip(sizes, models, strict=True)
    ]  # fmt: skip
    figure = plot_scaling(
        sizes,
        {"ns per step": times["GNI 2"],
         "seconds to derive, emit and compile": [m.build.total for m in models]},
        "skates N", exponent(sizes, times["GNI 2"], 1),
    )  # fmt: skip
    heading = ["N", "ns per step", "per skate", "iterations", "IR lines", "derive s", "emit s",
               "LLVM s", "build s"]  # fmt: skip
    return "\n\n".join([
        "A chain of N skates joined by springs, h = 0.02. Exponents of time per step against N, "
        "least squares from the given N on; nanoseconds per skate and step at both ends; seconds "
        "to derive, emit and compile the longest chain.",
        markdown_table(["", *(f"N >= {least}" for least in (1, 5, 20)), f"ns at N = {sizes[1]}",
                        f"at {sizes[-1]}", "build s"], growth),
        "GNI 2 in detail:",
        markdown_table(heading, rows),
        request.keep(figure, "chain", "cost of a chain"),
    ])  # fmt: skip
