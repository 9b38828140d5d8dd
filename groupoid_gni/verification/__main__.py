"""``python -m groupoid_gni.verification``: every law on everything shipped, as a page and a figure.

Writes ``verified_laws.md`` and ``figures/verified_laws.png`` into a folder (docs/ by default) and
exits with 1 if a law is broken.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from groupoid_gni.plotting import plot_laws
from groupoid_gni.verification import catalogue
from groupoid_gni.verification.checks import (
    check_groupoid,
    check_method,
    check_retraction,
    check_system,
)
from groupoid_gni.verification.report import Finding, LawReport, Verdict, merged

Table = dict[str, dict[str, list[Finding]]]
"""law -> object -> its findings on all variants of the object."""


def tables(examples: int, seed: int | None, say: Callable[[str], None]) -> dict[str, Table]:
    """All findings, by chapter; examples : samples per law and variant."""
    options: dict[str, Any] = {"examples": examples, "seed": seed, "on_fail": "return"}
    spaces: dict[str, Mapping[str, Any]] = {**catalogue.groups(), **catalogue.groupoids()}
    systems = catalogue.systems_for_methods()
    methods = {name: (method, tuple(systems)) for name, method in catalogue.methods().items()}
    methods.update(catalogue.methods_on_few_systems())

    def on_systems(method: Any, names: tuple[str, ...]) -> dict[str, LawReport]:
        reports = {}
        for name in names:
            system, symmetries = systems[name]
            reports[name] = check_method(method, system, symmetries=symmetries, **options)
        return reports

    def on_variants(check: Callable[..., LawReport], variants: Any) -> dict[str, LawReport]:
        return {name: check(variant, **options) for name, variant in variants.items()}

    chapters: dict[str, dict[str, Callable[[], dict[str, LawReport]]]] = {
        "Groupoids": {
            name: partial(on_variants, check_groupoid, variants)
            for name, variants in spaces.items()
        },
        "Retractions": {
            name: partial(on_variants, check_retraction, variants)
            for name, variants in spaces.items()
        },
        "Systems": {
            name: partial(on_variants, check_system, {"": system})
            for name, (system, _) in systems.items()
        },
        "Methods": {
            name: partial(on_systems, method, names)
            for name, (method, names) in methods.items()
        },
    }
    return {chapter: _table(chapter, objects, say) for chapter, objects in chapters.items()}


def _table(
    chapter: str,
    objects: Mapping[str, Callable[[], dict[str, LawReport]]],
    say: Callable[[str], None],
) -> Table:
    table: Table = {}
    for name, reports_of in objects.items():
        began = time.perf_counter()
        reports = reports_of()
        say(f"{chapter}: {name} ({time.perf_counter() - began:.1f} s)")
        for report in reports.values():
            if report.failures:
                say(report.explain())
        for law, findings in merged(reports).items():
            table.setdefault(law, {})[name] = list(findings.values())
    return table


def cell(findings: list[Finding]) -> str:
    """The worst residual of an object's variants; a dot where the law does not apply."""
    tried = [found for found in findings if found.worst is not None]
    if not tried:
        return "·"
    worst = max(found.worst for found in tried if found.worst is not None)
    if any(found.verdict is Verdict.FAILED for found in tried):
        return f"**{worst:.0e}**"
    if any(found.verdict is Verdict.WARNED for found in tried):
        return "warns"
    if worst < 1e-20:
        return "<1e-20" if worst else "0"
    return f"{worst:.0e}"


def page(found: Mapping[str, Table], examples: int) -> str:
    """The page: one table per chapter, laws down and objects across, then the laws in words."""
    findings = [f for table in found.values() for row in table.values()
                for cells in row.values() for f in cells]
    tried = [f for f in findings if f.evaluations]
    broken = [f for f in tried if f.verdict is Verdict.FAILED]
    parts = [
        "# Verified laws",
        f"Written by `python -m groupoid_gni.verification --examples {examples}`. Cells are the "
        "worst residual over all variants of an object (sides, retractions, scenes; "
        "`groupoid_gni/verification/catalogue.py` lists them), over all samples; a dot: the law "
        "does not apply; bold: broken.",
        f"{len({f.law.name for f in tried})} laws, {len(tried)} pairs of law and variant, "
        f"{sum(f.evaluations for f in tried)} evaluations, {len(broken)} broken.",
        "![Distance of every law from being broken](figures/verified_laws.png)",
    ]
    for chapter, table in found.items():
        parts += [f"## {chapter}", _markdown(table), _in_words(table)]
    return "\n\n".join(parts) + "\n"


def _markdown(table: Table) -> str:
    objects = _objects(table)
    rows = [["law", *objects, "allowed"]]
    for law, row in table.items():
        tolerance = next(iter(row.values()))[0].law.tolerance
        cells = [cell(row.get(name, [])) for name in objects]
        if any(text != "·" for text in cells):
            rows.append([law, *cells, f"{tolerance:.0e}"])
    rule = ["---", *["--:"] * (len(objects) + 1)]
    return "\n".join("| " + " | ".join(row) + " |" for row in [rows[0], rule, *rows[1:]])


def _in_words(table: Table) -> str:
    laws = [next(iter(row.values()))[0].law for row in table.values()]
    return "\n".join(f"- **{law.name}**: `{law.statement}`, {law.context} ({law.source})"
                     for law in laws)


def _objects(table: Table) -> list[str]:
    return list(dict.fromkeys(name for row in table.values() for name in row))


def panels(found: Mapping[str, Table]) -> dict[str, tuple[list[str], list[str], Any]]:
    """For each chapter: laws, objects, worst residual over tolerance of each pair (NaN: none)."""
    made = {}
    for chapter, table in found.items():
        objects = _objects(table)
        values = np.full((len(table), len(objects)), np.nan)
        for i, row in enumerate(table.values()):
            for name, findings in row.items():
                tried = [f.worst / f.law.tolerance for f in findings if f.worst is not None]
                values[i, objects.index(name)] = max(tried, default=np.nan)
        kept = np.isfinite(values).any(axis=1)
        laws = [law for law, keep in zip(table, kept, strict=True) if keep]
        made[chapter] = (laws, objects, values[kept])
    return made


def main(arguments: list[str] | None = None) -> int:
    """Run, write, and tell whether all laws hold."""
    command = "python -m groupoid_gni.verification"
    parser = argparse.ArgumentParser(prog=command, description=__doc__)
    parser.add_argument("--examples", type=int, default=25, help="samples per law (25)")
    parser.add_argument("--seed", type=int, default=0, help="of the search; -1 for a fresh one (0)")
    parser.add_argument("--output", type=Path, default=Path("docs"), help="folder (docs)")
    given = parser.parse_args(arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = tables(given.examples, None if given.seed < 0 else given.seed, print)
    given.output.joinpath("figures").mkdir(parents=True, exist_ok=True)
    text = page(found, given.examples)
    (given.output / "verified_laws.md").write_text(text, encoding="utf-8")
    figure = given.output / "figures" / "verified_laws.png"
    plot_laws(panels(found)).savefig(figure, dpi=110)
    print(text.split("\n\n")[2])
    return int(" 0 broken" not in text)


if __name__ == "__main__":
    sys.exit(main())
