"""The engine: it counts, it finds, it shrinks, and nothing a subject does stops it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from groupoid_gni.errors import InputError
from groupoid_gni.verification import BrokenLawError, BrokenLawWarning, Gap, Verdict, gap
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.laws import Law, law


def numbers(subject: Any) -> Any:
    """Samples {x}: one vector of three."""
    one = st.floats(-10, 10)
    return st.tuples(one, one, one).map(lambda values: {"x": np.array(values)})


def rule(
    measure: Callable[..., Gap], tolerance: float = 1e-12, **options: Any
) -> Law:
    """A law of a subject that is a function of a vector."""
    options = {"draw": numbers, **options}
    return law(
        "function", "f(x) = x", "x in R^3", "this test", tolerance=tolerance, reason="none",
        **options,
    )(measure)


def identity_law(f: Any, x: Any) -> Gap:
    """f is the identity."""
    return gap(f(x), x)


def check(f: Any, *laws: Law, on_fail: str = "return", **options: Any) -> Any:
    options = {"expected_failures": None, "examples": 40, "seed": 0, **options}
    return check_laws("f", {"function": f}, laws, on_fail=on_fail, **options)


def test_a_law_that_holds_is_tried_as_often_as_asked() -> None:
    report = check(lambda x: x, rule(identity_law))
    found = report["identity_law"]
    assert found.verdict is Verdict.PASSED
    assert found.evaluations == report.evaluations == 40
    assert found.worst == 0.0


def test_a_failure_is_made_small() -> None:
    report = check(lambda x: np.where(x > 3.5, x + 1, x), rule(identity_law))
    trial = report["identity_law"].counterexample
    assert sorted(np.abs(trial.sample["x"])) == [0.0, 0.0, 4.0]
    assert not report.passed
    text = report.explain()
    assert "f(x) = x" in text
    assert "4." in text
    assert "allowed 1e-12" in text


def test_rare_failures_are_found_with_more_examples() -> None:
    report = check(lambda x: np.where(np.abs(x) > 9.7, 0, x), rule(identity_law), examples=500)
    assert not report.passed


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda x: x[:2], "inf"),
        (lambda x: x * np.nan, "inf"),
        (lambda x: 1 / 0, "ZeroDivisionError"),
        (lambda x: np.linalg.inv(np.zeros((3, 3))), "LinAlgError"),
    ],
)
def test_wrong_shapes_nan_and_exceptions_break_a_law(wrong: Any, said: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = check(wrong, rule(identity_law))
    assert not report.passed
    assert said in str(report)


def test_a_subject_cannot_change_the_sample() -> None:
    def spoiling(x: Any) -> Any:
        x += 1.0
        return x - 1.0

    report = check(spoiling, rule(identity_law))
    assert report["identity_law"].evaluations >= 40
    assert report["identity_law"].counterexample.sample["x"].max() < 10.1


def test_a_subject_that_forgets_its_answers_is_reported_all_the_same() -> None:
    calls = iter(range(10**9))
    report = check(lambda x: x + next(calls) % 3, rule(identity_law))
    assert not report.passed


def test_laws_that_do_not_apply_are_not_evaluated() -> None:
    outside = rule(identity_law, applies=lambda f: "it is a function")
    report = check(lambda x: x, outside)
    found = report["identity_law"]
    assert found.verdict is Verdict.NOT_APPLICABLE
    assert (found.evaluations, found.worst, found.note) == (0, None, "it is a function")


def test_expensive_laws_get_their_share() -> None:
    report = check(lambda x: x, rule(identity_law, share=0.1), examples=200)
    assert report.evaluations == 20
    report = check(lambda x: x, rule(identity_law, share=0.01))
    assert report.evaluations == 3  # the fewest


def test_on_fail() -> None:
    wrong = rule(identity_law)
    with pytest.raises(BrokenLawError, match=r"f\(x\) = x") as caught:
        check(np.sin, wrong, on_fail="raise")
    assert isinstance(caught.value, AssertionError)
    assert caught.value.report.failures
    with pytest.warns(BrokenLawWarning, match="identity_law") as seen:
        check(np.sin, wrong, on_fail="warn")
    assert seen[0].message.report.failures
    with pytest.raises(InputError, match="on_fail"):
        check(np.sin, wrong, on_fail="ignore")


def test_advice_warns_and_never_raises() -> None:
    advice = rule(identity_law, advisory=True)
    with pytest.warns(BrokenLawWarning, match=r"f\(x\) = x"):
        report = check(np.sin, advice, on_fail="raise")
    assert report.passed
    assert [found.law.name for found in report.warnings] == ["identity_law"]


def test_expected_failures() -> None:
    wrong = rule(identity_law)
    report = check(np.sin, wrong, expected_failures={"identity_law": "it is the sine"})
    assert report.passed
    assert report["identity_law"].verdict is Verdict.EXPECTED
    assert "it is the sine" in str(report)
    report = check(lambda x: x, wrong, expected_failures={"identity_law": "it is the sine"})
    assert report.passed
    assert "no failure was found" in report["identity_law"].note
    with pytest.raises(InputError, match="did you mean 'identity_law'"):
        check(np.sin, wrong, expected_failures={"identity": "a reason"})
    with pytest.raises(InputError, match="why"):
        check(np.sin, wrong, expected_failures={"identity_law": ""})


@pytest.mark.parametrize("examples", [0, -3, 2.5, True, "many"])
def test_the_number_of_examples_is_checked(examples: Any) -> None:
    with pytest.raises(InputError, match="examples must be a whole number"):
        check(np.sin, rule(identity_law), examples=examples)


def test_the_same_seed_gives_the_same_report() -> None:
    reports = [check(np.sin, rule(identity_law), seed=seed) for seed in (5, 5, 6)]
    worst = [report["identity_law"].worst for report in reports]
    assert worst[0] == worst[1] != worst[2]


@pytest.mark.parametrize("tolerance", [0.0, -1.0, float("nan")])
def test_a_law_needs_a_tolerance(tolerance: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        rule(identity_law, tolerance=tolerance)


def test_global_random_numbers_are_left_alone() -> None:
    np.random.seed(3)  # noqa: NPY002
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    check(np.sin, rule(identity_law))
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002
