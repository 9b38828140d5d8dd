"""From laws and a subject to a report, and what happens when laws fail."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import hypothesis

from groupoid_gni.errors import BrokenLawError, BrokenLawWarning, InputError
from groupoid_gni.verification.laws import Law
from groupoid_gni.verification.report import Finding, LawReport, Verdict, finding
from groupoid_gni.verification.search import survey

OnFail = Literal["raise", "warn", "return"]


def check_laws(
    name: str,
    subjects: Mapping[str, Any],
    laws: Iterable[Law],
    *,
    on_fail: OnFail,
    expected_failures: Mapping[str, str] | None,
    examples: int | None,
    seed: int | None,
) -> LawReport:
    """Try laws on their subjects.

    name : what the report calls the subject.
    subjects : for each group of laws, what its laws take.
    The other arguments are those of ``check_groupoid``.
    """
    laws = list(laws)
    expected = _checked_expectations(expected_failures, laws)
    require_on_fail(on_fail)
    count = hypothesis.settings().max_examples if examples is None else examples
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise InputError(f"examples must be a whole number from 1 on, not {examples!r}")
    excuses = {law.name: law.applies(subjects[law.group]) for law in laws}
    tallies = {}
    for group, subject in subjects.items():
        tried = [law for law in laws if law.group == group and excuses[law.name] is None]
        tallies.update(survey(subject, tried, count, seed))
    findings = tuple(
        Finding(law, Verdict.NOT_APPLICABLE, 0, None, None, excuse)
        if (excuse := excuses[law.name]) is not None
        else finding(tallies[law.name], expected.get(law.name))
        for law in laws
    )
    report = LawReport(name, findings)
    speak(report, on_fail)
    return report


def require_on_fail(on_fail: str) -> None:
    """Refuse anything but the three choices."""
    if on_fail not in ("raise", "warn", "return"):
        raise InputError(f'on_fail must be "raise", "warn" or "return", not {on_fail!r}')


def speak(report: LawReport, on_fail: OnFail) -> None:
    """Raise, warn or be silent; called by what a check calls, so that warnings name its caller."""
    if report.failures and on_fail == "raise":
        raise BrokenLawError(f"\n{report}", report)
    if report.failures and on_fail == "warn":
        warnings.warn(BrokenLawWarning(f"\n{report}", report), stacklevel=4)
    elif report.warnings and on_fail != "return":
        text = "\n\n".join(found.explain(report.subject) for found in report.warnings)
        warnings.warn(BrokenLawWarning(text, report), stacklevel=4)


def _checked_expectations(
    expected: Mapping[str, str] | None, laws: list[Law]
) -> Mapping[str, str]:
    known = [law.name for law in laws]
    for name, reason in (expected or {}).items():
        if name not in known:
            near = difflib.get_close_matches(name, known, 3)
            raise InputError(
                f"expected_failures names {name!r}, which is no law of this check; "
                + (f"did you mean {' or '.join(map(repr, near))}?" if near else f"laws: {known}")
            )
        if not (isinstance(reason, str) and reason.strip()):
            raise InputError(f"expected_failures[{name!r}] must say why, in a sentence")
    return expected or {}
