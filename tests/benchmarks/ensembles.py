"""Ensembles of the inhomogeneous ball: lanes and threads against a loop of single runs.

    python tests/benchmarks/ensembles.py [--quick]

64 members whose start velocities differ by up to a fifth, short runs (2000 steps) and long ones
(20000), only the last node kept. Times are wall times around the call, the smallest of the repeats,
everything in turns and compiled before. What they hold besides the compiled loop (checks, threads,
one Trajectory for each member) is the same for short runs and long ones.

All lanes of a register wait for the one that iterates longest. What that costs is the mean over
steps of the largest number of iterations among the lanes, over the mean number alone; both are
taken from the short runs. A composition waits at every stage, so for it this is a lower bound.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports.markdown import markdown_table  # noqa: E402

STEP, SHORT, LONG = 0.05, 2_000, 20_000
LANES, THREADS = (1, 4, 8), (1, 2)
METHODS = {
    "GNI 2": gni.GNI(),
    "GNI 4, splitting, bare": gni.GNI(4, flow=gni.Splitting(), projection=None),
    "Rattle": gni.Rattle(),
    "GNI 4": gni.GNI(4),
}
LOOP = "loop"


@dataclass(frozen=True)
class Members:
    """A system and its starts."""

    system: gni.MechanicalSystem
    starts: Sequence[gni.State]

    @classmethod
    def of_the_ball(cls, count: int = 64) -> Members:
        """Starts of the inhomogeneous ball, every velocity times 0.8 to 1.2."""
        scene = gni.scenes.inhomogeneous_ball()
        random = np.random.default_rng(0)
        factors = 1.0 + 0.2 * random.uniform(-1.0, 1.0, (count, len(scene.start.velocity)))
        starts = [
            scene.system.state(scene.start.base, scene.start.velocity * f, project_start=True)
            for f in factors
        ]
        return cls(scene.system, starts)

    def alone(self, method: Any, steps: int, save_every: int | None = None) -> list[Any]:
        """Every member as a run of its own; the last node only when left out."""
        return [
            gni.integrate(self.system, start, step=STEP, n_steps=steps, method=method,
                          save_every=save_every or steps)
            for start in self.starts
        ]  # fmt: skip

    def together(self, method: Any, steps: int, lanes: int, threads: int) -> gni.Ensemble:
        """All members as an ensemble."""
        return gni.integrate_ensemble(
            self.system, self.starts, step=STEP, n_steps=steps, method=method, lanes=lanes,
            threads=threads,
        )  # fmt: skip


@dataclass(frozen=True)
class EnsembleCost:
    """What a method cost.

    wall : seconds of (lanes, threads), and of LOOP.  inside : seconds of compiled loops, likewise;
    summed over threads, it also holds waiting for the interpreter lock.
    iterations : per step, alone.  slowest : lanes -> mean over steps of the largest among them.
    same_bits : whether every configuration ended where the single runs did, bit by bit.
    """

    steps: int
    wall: Mapping[Any, float]
    inside: Mapping[Any, float]
    iterations: float
    slowest: Mapping[int, float]
    same_bits: bool


def same_bits(found: Sequence[Any], wanted: Sequence[Any]) -> bool:
    """Whether all runs reach the end and agree in everything saved there, to the last bit."""
    return len(found) == len(wanted) and all(
        a.success and b.success and a.rows[-1].tobytes() == b.rows[-1].tobytes()
        for a, b in zip(found, wanted, strict=True)
    )


def slowest_of(iterations: np.ndarray, lanes: int) -> float:
    """Mean over batches and steps of the largest of ``lanes`` members; iterations (members, steps).

    Every step of a batch counts once for each of its members, so that one lane gives the mean.
    """
    batches = [iterations[begin : begin + lanes] for begin in range(0, len(iterations), lanes)]
    whole = sum(len(batch) * float(batch.max(axis=0).sum()) for batch in batches)
    return whole / iterations.size


def measured(members: Members, method: Any, steps: int, repeats: int) -> EnsembleCost:
    """Time the loop of single runs and all configurations, in turns."""
    runs: dict[Any, Callable[[], Sequence[Any]]] = {LOOP: partial(members.alone, method, steps)}
    for lanes in LANES:
        for threads in THREADS:
            runs[lanes, threads] = partial(members.together, method, steps, lanes, threads)
    wanted = members.alone(method, steps)
    same = all(same_bits(run(), wanted) for run in runs.values())
    wall, inside = dict.fromkeys(runs, np.inf), dict.fromkeys(runs, np.inf)
    for _ in range(repeats):
        for key, run in runs.items():
            began = time.perf_counter()
            found = run()
            wall[key] = min(wall[key], time.perf_counter() - began)
            inside[key] = min(inside[key], sum(one.seconds for one in found))
    every_step = members.alone(method, min(steps, SHORT), save_every=1)
    counts = np.array([run.newton_iterations for run in every_step])
    slowest = {lanes: slowest_of(counts, lanes) for lanes in LANES}
    return EnsembleCost(steps, wall, inside, float(counts.mean()), slowest, same)


def rows_of(name: str, cost: EnsembleCost) -> list[list[str]]:
    """One row for each number of lanes."""
    rows = []
    for lanes in LANES:
        one, two = (cost.wall[lanes, threads] for threads in THREADS)
        iterations = [f"{cost.iterations:.2f}", f"{cost.slowest[lanes]:.2f}"]
        rows.append([
            f"{name}, {cost.steps} steps", str(lanes), f"{1e3 * one:.1f}",
            f"{cost.wall[1, 1] / one:.2f}", f"{cost.wall[LOOP] / one:.2f}",
            f"{cost.inside[LOOP] / cost.inside[lanes, 1]:.2f}", f"{one / two:.2f}",
            *(iterations if cost.iterations else ["-", "-"]), "yes" if cost.same_bits else "NO",
        ])  # fmt: skip
    return rows


def section(quick: bool, count: int = 64) -> str:
    """The table; only the short runs when quick."""
    members = Members.of_the_ball(count)
    rows = []
    for steps, repeats in ((SHORT, 3),) if quick else ((SHORT, 15), (LONG, 5)):
        for name, method in METHODS.items():
            rows += rows_of(name, measured(members, method, steps, repeats))
    heading = ["", "lanes", "ms", "times 1 lane", "times the loop", "compiled part",
               "second thread", "iterations", "of the slowest lane", "same bits"]  # fmt: skip
    return (
        f"Inhomogeneous ball, {count} starts, h = {STEP}, last node kept; wall time of one thread, "
        "how many times the throughput of one lane and of a loop of single runs that is, the same "
        "for compiled loops without the Python around them, and what a second thread brings. "
        "Newton iterations per step, alone and of the slowest lane, for which the others wait.\n\n"
        + markdown_table(heading, rows)
    )


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="only the short runs, few repeats")
    print(section(parser.parse_args(arguments).quick))


if __name__ == "__main__":
    main()
