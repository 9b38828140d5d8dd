"""How the cost of a step grows with the number of bodies: the chain of skates, N = 1 ... 200.

    python tests/benchmarks/chain.py [--quick]

For every N the time from the scene to machine code, split into recording, deriving, emitting and
compiling, and the time of a step; then the exponent of time per step against N, by least squares.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":  # also from a checkout that is not installed
    sys.path.insert(0, str(ROOT))

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports.sections import CHAINED, exponent  # noqa: E402

SIZES = (1, 2, 5, 10, 20, 50, 100, 200)


@dataclass(frozen=True)
class ChainCost:
    """Seconds to record, derive, emit and compile; lines of IR; nanoseconds per step."""

    skates: int
    method: str
    record: float
    derive: float
    emit: float
    compile: float
    lines: int
    step: float


def chain_cost(skates: int, method: Any, steps: int = 200, repeats: int = 5) -> ChainCost:
    """Build and run one chain; nothing is taken from the cache of object files."""
    began = time.perf_counter()
    scene = gni.scenes.chain_of_skates(skates)
    recorded = time.perf_counter() - began
    found = gni.reports.cost(scene, method, n_steps=steps, repeats=repeats)
    build = found.build
    return ChainCost(
        skates, str(method), recorded, build.derive, build.emit, build.compile, found.ir_lines,
        found.nanoseconds or math.nan,
    )


def table(costs: Sequence[ChainCost]) -> str:
    """One line per N."""
    lines = [
        "| N | record s | derive s | emit s | compile s | lines of IR | us a step | ns a step/N |",
        "|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {c.skates} | {c.record:.2f} | {c.derive:.2f} | {c.emit:.2f} | {c.compile:.2f} | "
        f"{c.lines} | {c.step / 1e3:.2f} | {c.step / c.skates:.0f} |"
        for c in costs
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Print a table per method."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="up to N = 50")
    options = parser.parse_args(arguments)
    os.environ["GROUPOID_GNI_CACHE"] = ""
    sizes = [n for n in SIZES if n <= (50 if options.quick else 200)]
    for method in CHAINED.values():
        costs = [chain_cost(n, method) for n in sizes]
        slope = exponent(sizes, [cost.step for cost in costs], 5)
        print(f"\n{method}: time per step ~ N^{slope:.2f}\n\n{table(costs)}", flush=True)


if __name__ == "__main__":
    main()
