"""The hard cases as one Markdown table.

    python tests/benchmarks/hard_cases.py [--quick] [--only FAMILY ...]

Prints, for every case of tests/hard_cases, why it is hard, what is expected, what happened and
whether that is the expectation. ``--quick`` leaves out the slow ones. Times go to the last line.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterable
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "hard_cases"), str(HERE.parents[1])]

import catalogue  # noqa: E402
from hard_case import HardCase, Verdict  # noqa: E402

HEADING = ("case", "why hard", "expectation", "result", "verdict")


def row(cells: Iterable[str]) -> str:
    """One line of a Markdown table; bars inside cells are escaped."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def judged(case: HardCase) -> Verdict:
    """The verdict of a case; an exception is a verdict too."""
    try:
        return case.run()
    except Exception as error:
        return Verdict(f"{type(error).__name__}: {str(error).splitlines()[0]}", False)


def show(families: Iterable[str], quick: bool) -> tuple[int, int]:
    """Print the table; returns how many cases passed and how many were run."""
    print(row(HEADING))
    print(row("---" for _ in HEADING))
    passed = count = 0
    for family in families:
        for case in catalogue.FAMILIES[family]:
            if quick and case.slow:
                continue
            found = judged(case)
            word = "as expected" if found.passed else "**not as expected**"
            print(row((case.name, f"{case.hard} ({case.source})", case.expectation, found.result,
                       word)), flush=True)  # fmt: skip
            passed, count = passed + found.passed, count + 1
    return passed, count


def main(arguments: list[str] | None = None) -> int:
    """The exit code is the number of cases that are not as expected."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave out the slow cases")
    parser.add_argument("--only", nargs="*", choices=catalogue.FAMILIES, metavar="FAMILY",
                        default=list(catalogue.FAMILIES), help="families to run")  # fmt: skip
    options = parser.parse_args(arguments)
    began = time.perf_counter()
    passed, count = show(options.only, options.quick)
    print(f"\n{passed} of {count} cases as expected, {time.perf_counter() - began:.0f} s.")
    return count - passed


if __name__ == "__main__":
    sys.exit(main())
