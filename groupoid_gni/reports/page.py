"""The report: everything measured, as one page with figures."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from groupoid_gni.errors import InputError
from groupoid_gni.reports import sections as parts
from groupoid_gni.reports.deficiencies import numbered
from groupoid_gni.reports.machine_facts import machine_facts
from groupoid_gni.reports.report_scenes import SCENES
from groupoid_gni.reports.timing import one_core

PAGE = "measured_results.md"


def write_report(
    output: str | Path,
    *,
    quick: bool = False,
    scenes: Sequence[str] | None = None,
    comparisons: parts.Comparisons | None = None,
    say: Callable[[str], None] = print,
) -> Path:
    """Measure, and write ``measured_results.md`` with its figures and long tables into a folder.

    quick : coarse scans and short runs, for a look.
    scenes : names of ``report_scenes.SCENES`` to compare; all when left out. With a choice the
        parts that are about other scenes (energy, cold start, ensembles, chains, those of
        ``comparisons``) are left out.
    comparisons : peers and further parts.  say : told what has been done.
    Returns the path of the page. Raises InputError for a scene that there is not.
    """
    known = {entry.name: entry for entry in SCENES}
    chosen = tuple(known) if scenes is None else tuple(scenes)
    unknown = [name for name in chosen if name not in known]
    if unknown or not chosen:
        raise InputError(f"scenes must be some of {', '.join(known)}; got {list(chosen)}")
    began = time.perf_counter()
    folder = Path(output)
    request = parts.Request(quick, folder, tuple(known[name] for name in chosen), say)
    with one_core():
        speed, found = parts.speed_against_error(request, comparisons)
        costs = parts.cost_table(request)
    chapters = [("Speed against error", speed), ("Wins and losses", parts.wins_and_losses(found)),
                ("What a step costs", costs)]  # fmt: skip
    if scenes is None:
        chapters += _other_chapters(request, comparisons)
    chapters.append(("Known deficiencies", numbered()))
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / PAGE
    text = [_head(quick, comparisons, time.perf_counter() - began)]
    text += [f"## {title}\n\n{body}" for title, body in chapters]
    page.write_text("\n\n".join(text) + "\n", encoding="utf-8")
    return page


def _other_chapters(
    request: parts.Request, comparisons: parts.Comparisons | None
) -> list[tuple[str, str]]:
    with one_core():
        energy, chains = parts.energy_over_a_long_run(request), parts.chains(request)
    chapters = [
        ("Energy over a long run", energy),
        ("Cold start", parts.cold_starts(request)),
        ("Ensembles", parts.ensembles(request)),
        ("Many coupled bodies", chains),
    ]
    if comparisons is not None:
        chapters += comparisons.sections(request.quick)
    return chapters


def _head(quick: bool, comparisons: parts.Comparisons | None, seconds: float) -> str:
    command = "python -m groupoid_gni.report" + (" --quick" if quick else "")
    packages = () if comparisons is None else comparisons.packages
    lines = [
        "# Measured results",
        f"Written by `{command}` in {seconds:.0f} s."
        + (" A quick look: coarse scans, few repeats, short runs." if quick else ""),
        machine_facts(packages),
        "Everything that is compared runs in one process, warm, on one core, in turns; the "
        "smallest time of the repeats counts. Times of the library are those of its loop "
        "(`run.seconds`); compiling is apart. An error is printed as a number when it is at least "
        "ten times the error of the reference, or else as a bound. Times to an error are "
        'interpolated between settings, never extrapolated; "<=": the loosest setting reaches it.',
    ]
    absent = (
        ("no peers were given: run the command in a checkout of the sources, which has them in "
         "tests/benchmarks",)
        if comparisons is None
        else comparisons.notes
    )  # fmt: skip
    if absent:
        lines.append("Left out:\n\n" + "\n".join(f"- {note}" for note in absent))
    return "\n\n".join(lines)
