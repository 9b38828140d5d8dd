"""Laws as pytest cases: one readable case per law and object, in a user's own test suite."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from groupoid_gni.errors import BrokenLawError, BrokenLawWarning, InputError
from groupoid_gni.groupoids import LieGroup, LieGroupoid, Retraction
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.verification.algebroid_laws import ALGEBROID_LAWS
from groupoid_gni.verification.appendix_laws import APPENDIX_LAWS
from groupoid_gni.verification.checks import (
    check_groupoid,
    check_method,
    check_retraction,
    check_system,
)
from groupoid_gni.verification.convention_laws import CONVENTION_LAWS
from groupoid_gni.verification.groupoid_laws import GROUPOID_LAWS
from groupoid_gni.verification.laws import Law
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.report import LawReport, Verdict
from groupoid_gni.verification.retraction_laws import RETRACTION_LAWS
from groupoid_gni.verification.system_laws import SYSTEM_LAWS


@dataclass(frozen=True)
class _Check:
    """One check of one subject, run when its first case is."""

    laws: tuple[Law, ...]
    run: Callable[..., LawReport]
    options: dict[str, Any]

    @cached_property
    def report(self) -> LawReport:
        """The report; never raises for broken laws."""
        names = {law.name for law in self.laws}
        expected = self.options["expected_failures"]
        mine = {name: reason for name, reason in expected.items() if name in names}
        options = {**self.options, "expected_failures": mine}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BrokenLawWarning)
            return self.run(**options, on_fail="return")


@dataclass(frozen=True)
class LawCase:
    """One law on one subject; ``str(case)`` is the id of the pytest case."""

    law: Law
    name: str
    _check: _Check

    def check(self) -> None:
        """Pass, or raise BrokenLawError with the law and its numbers.

        Skips where the law does not apply, xfails where the failure was expected, and warns where
        the law only advises.
        """
        import pytest

        found = self._check.report[self.law.name]
        if found.verdict is Verdict.NOT_APPLICABLE:
            pytest.skip(found.note)
        if found.verdict is Verdict.EXPECTED:
            pytest.xfail(found.note)
        text = found.explain(self.name)
        if found.verdict is Verdict.FAILED:
            raise BrokenLawError(f"\n{text}", self._check.report)
        if found.verdict is Verdict.WARNED:
            warnings.warn(BrokenLawWarning(f"\n{text}", self._check.report), stacklevel=2)

    def __str__(self) -> str:
        return f"{self.law.name}-{self.name}"


def law_cases(
    subjects: Iterable[Any],
    *,
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> list[LawCase]:
    """One case per law and subject, for frameworks other than pytest.

    The arguments are those of ``parametrize_with_laws``.
    """
    expected = dict(expected_failures or {})
    options = {"expected_failures": expected, "examples": examples, "seed": seed}
    cases = [case for subject in subjects for case in _cases_of(subject, options)]
    unknown = set(expected) - {case.law.name for case in cases}
    if unknown:
        raise InputError(f"expected_failures names no law of these subjects: {sorted(unknown)}")
    return cases


def parametrize_with_laws(
    subjects: Iterable[Any],
    *,
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> Any:
    """Decorate a pytest function of one argument ``case``: one case per law and subject.

    subjects : groupoids, Lie groups, retractions, systems, and pairs ``(method, system)``.
    The other arguments as for ``check_groupoid``. The body of the function is ``case.check()``.
    """
    import pytest

    cases = law_cases(
        subjects, expected_failures=expected_failures, examples=examples, seed=seed
    )
    return pytest.mark.parametrize("case", cases, ids=str)


def _cases_of(subject: Any, options: dict[str, Any]) -> list[LawCase]:
    name, checks = _checks_of(subject, options)
    return [LawCase(law, name, check) for check in checks for law in check.laws]


def _checks_of(subject: Any, options: dict[str, Any]) -> tuple[str, list[_Check]]:
    def one(laws: tuple[Law, ...], check: Callable[..., LawReport], *arguments: Any) -> _Check:
        return _Check(laws, lambda **given: check(*arguments, **given), options)

    if isinstance(subject, LieGroupoid):
        axioms = (*GROUPOID_LAWS, *ALGEBROID_LAWS, *CONVENTION_LAWS)
        appendix = APPENDIX_LAWS if isinstance(subject, LieGroup) else ()
        return repr(subject), [
            one(axioms, check_groupoid, subject),
            one((*RETRACTION_LAWS, *appendix), check_retraction, subject),
        ]
    if isinstance(subject, Retraction):
        return repr(subject), [one((*RETRACTION_LAWS, *APPENDIX_LAWS), check_retraction, subject)]
    if isinstance(subject, MechanicalSystem):
        return f"system on {subject.space!r}", [one(SYSTEM_LAWS, check_system, subject)]
    if isinstance(subject, tuple) and len(subject) == 2:
        method, system = subject
        if isinstance(system, MechanicalSystem):
            laws = (*METHOD_EQUATION_LAWS, *METHOD_RUN_LAWS, *METHOD_FLOW_LAWS)
            name = f"{method} on {system.space!r}"
            return name, [one(laws, check_method, method, system)]
    raise InputError(
        "laws are known for groupoids, retractions, systems and pairs (method, system), not for "
        f"{subject!r}"
    )
