"""Every hard case does what its expectation says; its numbers are in the failure message."""

from __future__ import annotations

import catalogue
import pytest
from hard_case import HardCase, Verdict, verdict

PARAMETERS = [
    pytest.param(
        case, id=f"{family}: {case.name}", marks=[pytest.mark.slow] if case.slow else []
    )
    for family, cases in catalogue.FAMILIES.items()
    for case in cases
]


@pytest.mark.parametrize("case", PARAMETERS)
def test_the_expectation_holds(case: HardCase) -> None:
    found = case.run()
    assert isinstance(found, Verdict)
    assert found.passed, f"expected: {case.expectation}; found: {found.result}"


def test_every_family_has_variants_and_every_name_is_its_own() -> None:
    names = [case.name for cases in catalogue.FAMILIES.values() for case in cases]
    assert len(set(names)) == len(names)
    assert all(len(cases) >= 3 for cases in catalogue.FAMILIES.values())


def test_a_verdict_fails_with_any_condition_and_without_one() -> None:
    assert verdict("", True, True).passed
    assert not verdict("", True, False).passed
    assert not verdict("").passed
