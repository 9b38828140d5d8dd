"""``parametrize_with_laws``: readable cases, and what a broken object says in them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.verification import BrokenLawError, law_cases, parametrize_with_laws


class Stretched(gni.PairGroupoid):
    """Its retraction does not return."""

    def retract(self, x: Any, xi: Any) -> Any:
        """Go a little too far, whatever the direction."""
        return super().retract(x, xi + 0.01 * xi * xi)


def sleigh() -> gni.MechanicalSystem:
    return gni.scenes.chaplygin_sleigh(1.3, 0.6, 0.4).system


@parametrize_with_laws([gni.SO2(side="right"), gni.Cayley(), sleigh()], examples=4)
def test_shipped_objects(case: Any) -> None:
    case.check()


def test_ids_are_readable_and_unique() -> None:
    cases = law_cases([gni.SO3(), gni.PairGroupoid(2), sleigh(), (gni.Rattle(), sleigh())])
    names = [str(case) for case in cases]
    assert len(set(names)) == len(names)
    assert "associativity-PairGroupoid(2)" in names


def broken_cases(**options: Any) -> dict[str, Any]:
    cases = law_cases([Stretched(2)], examples=10, **options)
    return {case.law.name: case for case in cases}


def test_a_broken_law_says_which_and_where() -> None:
    cases = broken_cases()
    cases["tangents_at_zero"].check()
    with pytest.raises(BrokenLawError, match="retract") as caught:
        cases["symmetry"].check()
    assert "allowed" in str(caught.value)
    assert caught.value.report is cases["symmetry"]._check.report


def test_laws_that_do_not_apply_are_skipped_and_expected_failures_are_xfailed() -> None:
    cases = law_cases([gni.SO2()], examples=3)
    outside = next(case for case in cases if case.law.name == "source_of_identity")
    with pytest.raises(pytest.skip.Exception, match="point"):
        outside.check()
    reason = "it is meant to be bent"
    case = broken_cases(expected_failures={"symmetry": reason})["symmetry"]
    with pytest.raises(pytest.xfail.Exception, match=reason):
        case.check()


def test_integrable_constraints_warn() -> None:
    flat = gni.MechanicalSystem(
        gni.PairGroupoid(3), np.diag([0.7, 1.1, 1.3]), constraints=[[0.3, -0.8, 0.5]]
    )
    warned = 0
    for case in law_cases([flat], examples=4):
        if case.law.advisory:
            with pytest.warns(gni.verification.BrokenLawWarning):
                case.check()
            warned += 1
    assert warned


def test_subjects_and_expectations_are_checked() -> None:
    with pytest.raises(gni.InputError, match="not for 'SO3'"):
        law_cases(["SO3"])
    with pytest.raises(gni.InputError, match="names no law"):
        law_cases([gni.SO2()], expected_failures={"commutativity": "why"})
