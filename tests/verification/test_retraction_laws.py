"""check_retraction: what the library ships obeys, and the laws reach where they say they do."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.errors import BrokenLawWarning
from groupoid_gni.verification import Verdict, check_retraction
from groupoid_gni.verification.appendix_laws import APPENDIX_LAWS
from groupoid_gni.verification.differences import central_difference, complex_step
from groupoid_gni.verification.retraction_laws import EDGES, RETRACTION_LAWS, SCALES

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_retractions
import zoo

EXAMPLES = 6


def _catalogue() -> dict[str, gni.LieGroupoid]:
    """The spaces of tests/groupoids and of the zoo, each once."""
    path = Path(__file__).parents[1] / "groupoids" / "conftest.py"
    specification = importlib.util.spec_from_file_location("groupoids_of_the_tests", path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    spaces = [*module.SPACES, *(make() for make in zoo.SPACES.values())]
    return {repr(space): space for space in spaces}


def _expensive(space: gni.LieGroupoid) -> bool:
    """Large ones, and of the exponential maps all but the small left groups and one general one."""
    if isinstance(space, gni.LieGroup) and isinstance(space.retraction, gni.Exponential):
        return space.side == "right" or space.rank > 3
    return space.rank > 6


SPACES = _catalogue()
FAST = [name for name, space in SPACES.items() if not _expensive(space)]
SLOW = [name for name, space in SPACES.items() if _expensive(space)]


@pytest.mark.parametrize(
    "name", [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]
)
def test_what_is_shipped_obeys(name: str) -> None:
    space = SPACES[name]
    report = check_retraction(space, examples=EXAMPLES)
    for found in report.findings:
        assert (found.evaluations > 0) is (found.verdict is not Verdict.NOT_APPLICABLE)
    held = len(report.having(Verdict.PASSED)) + len(report.having(Verdict.EXPECTED))
    assert held >= (33 if isinstance(space, gni.LieGroup) else 12)


def test_the_general_logarithm_is_right_up_to_the_edge() -> None:
    check_retraction(gni.QuadraticGroup(np.eye(3), retraction=gni.Exponential()), examples=3)


def test_every_law_holds_somewhere_and_has_its_own_name() -> None:
    laws = [*RETRACTION_LAWS, *APPENDIX_LAWS]
    groups = [gni.SO3(), gni.SE2(retraction=gni.Exponential())]
    actor = SPACES[next(name for name in SPACES if name.startswith("ActionGroupoid"))]
    held = {
        found.law.name
        for space in (*groups, actor)
        for found in check_retraction(space, examples=3).having(Verdict.PASSED)
    }
    assert held == {law.name for law in laws}
    assert len(held) == len(laws)


def test_every_law_is_broken_by_something() -> None:
    caught = set().union(*(broken.caught_by for broken in broken_retractions.BROKEN))
    assert caught == {law.name for law in (*RETRACTION_LAWS, *APPENDIX_LAWS)}


# Where the samples go.


class Spy(gni.SO3):
    """Notes every vector whose exponential is taken."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.seen: list[float] = []

    def exp(self, xi: Any) -> Any:
        if np.asarray(xi).dtype != object:
            self.seen.append(float(np.max(np.abs(xi))))
        return super().exp(xi)


def test_scales_and_edges_are_reached() -> None:
    spy = Spy(retraction=gni.Exponential())
    check_retraction(spy, examples=10)
    sizes = np.array(spy.seen)
    assert 0.0 in sizes
    for scale in SCALES[1:]:
        assert np.any((sizes > 1e-4 * scale) & (sizes < 3.2 * scale)), scale
    largest = max(EDGES) * np.pi / np.sqrt(3.0)  # the simplest vector has equal entries
    assert np.any(np.abs(sizes / largest - 1.0) < 1e-12)
    assert np.max(sizes) < np.pi


def test_tiny_steps_are_asked_only_of_coordinates_that_can_hold_them() -> None:
    mixed = gni.QuadraticGroup(np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 3.0]]))
    for space in (gni.PairGroupoid(2), gni.FramedPairGroupoid(gni.SO3()), mixed):
        found = check_retraction(space, examples=3)["accuracy_near_zero"]
        assert found.verdict is Verdict.NOT_APPLICABLE
        assert "1 + 1e-160 is 1" in found.note


def test_a_global_retraction_has_no_edge() -> None:
    report = check_retraction(gni.VectorGroup(2), examples=3)
    for name in ("accuracy_near_the_edge", "tangents_near_the_edge"):
        assert "reach is 0" in report[name].note
    assert report["exponential_is_expm"].note == "the retraction is not the exponential map"


# Small mistakes.


def _off(function: Any, by: float = 1e-8) -> Any:
    return lambda self, *arguments: function(self, *arguments) * (1.0 + by)


CAYLEY, EXPONENTIAL = gni.Cayley(), gni.Exponential()
TANGENT = {"dtau_by_definition", "dtau_by_differences", "lemma_9_4", "tangents_are_inverse",
           "tangent_at_zero"}
INVERSE_TANGENT = {"tangent_plus_is_the_derivative", "tangent_minus_is_the_derivative",
                   "tangents_near_the_edge", "tangents_at_zero", "dtau_inverse_by_definition",
                   "tangents_are_inverse", "tangent_at_zero"}
LIFT = {"lift_undoes_retraction", "retraction_undoes_lift", "accuracy_near_zero",
        "accuracy_near_the_edge"}


@pytest.mark.parametrize(
    ("retraction", "functions", "laws"),
    [
        (CAYLEY, {"dcay": _off(gni.SO3.dcay)}, {*TANGENT, "dcay_formula", "cayley_on_rotations"}),
        (CAYLEY, {"dcay_inverse": _off(gni.SO3.dcay_inverse)},
         {*INVERSE_TANGENT, "dcay_inverse_formula", "cayley_on_rotations"}),
        (EXPONENTIAL, {"dexp": _off(gni.SO3.dexp)}, {*TANGENT, "dexp_series"}),
        (EXPONENTIAL, {"dexp_inverse": _off(gni.SO3.dexp_inverse)},
         {*INVERSE_TANGENT, "dexp_inverse_series"}),
        (CAYLEY, {"trivialised_tangent_plus": _off(gni.SO3.trivialised_tangent_plus)},
         {"tangents_change_places", "tangents_at_zero", "tangent_plus_is_the_derivative",
          "lemma_9_5_on_arrows", "momentum_transport", "tangents_near_the_edge"}),
        (CAYLEY, {"cay_half": _off(gni.SO3.cay_half, 1e-10)}, {"half_arrows", "half_vectors"}),
        (CAYLEY, {"cay_inverse": _off(gni.SO3.cay_inverse, 1e-10)}, LIFT),
        (CAYLEY, {"Ad": _off(gni.SO3.Ad)},
         {"adjoint_is_conjugation", "adjoint_is_a_representation", "adjoint_keeps_brackets",
          "lemma_9_5_tangent", "lemma_9_5_inverse"}),
        (CAYLEY, {"ad": _off(gni.SO3.ad)}, {"ad_is_the_commutator", "lemma_9_3", "lemma_9_4"}),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_mistakes_in_the_eighth_digit_are_caught(
    retraction: gni.Retraction, functions: dict[str, Any], laws: set[str]
) -> None:
    group = type("SlightlyOff", (gni.SO3,), functions)(retraction=retraction)
    report = check_retraction(group, examples=5, on_fail="return")
    assert {found.law.name for found in report.failures} == laws, report


def test_a_retraction_slightly_off_breaks_what_knows_it() -> None:
    def stretched(self: gni.SO3, xi: Any) -> Any:
        return gni.SO3.cay(self, xi * (1.0 + 1e-8))

    longer = type("Longer", (gni.SO3,), {"cay": stretched})()
    larger = type("Larger", (gni.SO3,), {"cay": _off(gni.SO3.cay, 1e-10)})()
    caught = [
        {found.law.name for found in check_retraction(group, examples=5, on_fail="return").failures}
        for group in (longer, larger)
    ]
    assert caught[0] == {
        *LIFT, "half_arrows", "half_vectors", "tangent_plus_is_the_derivative",
        "tangent_minus_is_the_derivative", "lemma_9_5_on_arrows", "momentum_transport",
        "tangents_near_the_edge", "tau_to_first_order", "lemma_9_3", "lemma_9_4",
        "dtau_by_definition", "dtau_by_differences", "dtau_inverse_by_definition",
        "lemma_9_5_tangent", "lemma_9_5_inverse", "cayley_is_the_quotient", "cayley_on_rotations",
    }
    assert caught[1] >= {
        "tau_of_zero", "tau_of_minus", "elements_stay_in_the_group", "determinant_is_one",
        "cayley_is_the_quotient", "cayley_on_rotations",
    }


# Retractions as subjects.


def test_a_retraction_is_checked_on_three_groups() -> None:
    report = check_retraction(gni.Cayley(), examples=3)
    assert report.subject == "Cayley()"
    assert [found.law for found in report.findings] == [*RETRACTION_LAWS, *APPENDIX_LAWS]
    assert report["lift_undoes_retraction"].evaluations == 18
    assert report["lemma_9_4"].evaluations == 9  # the appendix knows no sides
    assert report["cayley_on_rotations"].evaluations == 3
    assert report["cayley_on_rotations"].verdict is Verdict.PASSED
    assert report["dexp_series"].verdict is Verdict.NOT_APPLICABLE


@pytest.mark.slow
def test_the_exponential_map_is_checked_on_three_groups() -> None:
    report = check_retraction(
        gni.Exponential(), examples=5, expected_failures={"lemma_9_3": "no"}
    )
    assert report["lemma_9_3"].verdict is Verdict.PASSED
    assert report["cayley_is_the_quotient"].verdict is Verdict.NOT_APPLICABLE


def test_a_broken_retraction_names_the_group() -> None:
    half = broken_retractions.HalfOfTheVelocity()
    with pytest.warns(BrokenLawWarning, match="half_arrows fails for HalfOfTheVelocity") as caught:
        report = check_retraction(half, examples=8, on_fail="warn")
    assert Path(caught[0].filename).name == Path(__file__).name
    assert {found.law.name for found in report.failures} == {"half_arrows", "half_vectors"}
    for found in report.failures:
        assert found.counterexample.sample["subject"].startswith("SO3(side='left'")
        assert found.worst > 1e-3


@dataclass(frozen=True)
class OnlyTheTwoFunctions(gni.Retraction):
    """The Cayley map without its closed forms."""

    def tau(self, group: gni.LieGroup, xi: Any) -> Any:
        return group.cay(xi)

    def inverse(self, group: gni.LieGroup, element: Any) -> Any:
        return group.cay_inverse(element)


def test_a_retraction_of_a_user_passes() -> None:
    report = check_retraction(gni.SE2(retraction=OnlyTheTwoFunctions()), examples=10)
    assert report["accuracy_near_zero"].verdict is Verdict.PASSED
    assert report["half_arrows"].verdict is Verdict.PASSED
    assert report["accuracy_near_the_edge"].verdict is Verdict.NOT_APPLICABLE


def test_refused_arguments() -> None:
    with pytest.raises(gni.InputError, match="LieGroupoid or a Retraction, not str"):
        check_retraction("SO3")
    with pytest.raises(gni.InputError, match="no law of this check"):
        check_retraction(gni.PairGroupoid(1), expected_failures={"lemma_9_3": "a group's"})
    with pytest.raises(gni.InputError, match="on_fail"):
        check_retraction(gni.Cayley(), on_fail="shout")


# Differences.


def test_central_differences_are_exact_for_polynomials_of_degree_eight() -> None:
    powers = np.arange(9)
    found = central_difference(lambda x: x**powers, 0.7, [1.0], step=0.25)
    assert found.shape == (9, 1)
    np.testing.assert_allclose(found[:, 0], powers * 0.7 ** (powers - 1.0), atol=1e-14)


@pytest.mark.parametrize(
    ("derivative", "tolerance"), [(central_difference, 2e-13), (complex_step, 1e-15)]
)
def test_derivatives_along_directions(derivative: Any, tolerance: float) -> None:
    x = np.array([0.3, -1.2])

    def function(x: Any) -> Any:
        return np.array([[np.sin(x[0]) * x[1], np.exp(x[0])], [x[1] ** 3, x[0] / x[1]]])

    change = np.array([
        [[np.cos(0.3) * -1.2, np.sin(0.3)], [np.exp(0.3), 0.0]],
        [[0.0, 3 * 1.44], [-1 / 1.2, -0.3 / 1.44]],
    ])  # fmt: skip
    np.testing.assert_allclose(derivative(function, x), change, atol=tolerance)
    along = derivative(function, x, [[1.0, 2.0]])
    assert along.shape == (2, 2, 1)
    np.testing.assert_allclose(along[..., 0], change @ [1.0, 2.0], atol=4 * tolerance)
