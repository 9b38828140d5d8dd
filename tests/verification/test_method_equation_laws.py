"""The discrete equations and what must make no difference: on every shipped method, with teeth."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import FreeFlight, SystemExpressions, system_expressions
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.verification import LawReport, check_groupoid, check_method, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_variants import (
    Opposite,
    PairsOfArrows,
    Reframed,
    awkward_frame,
    coordinate_velocities,
    other_side,
)
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_methods
import zoo

RULES = [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()]
GNIS = [gni.GNI(), gni.GNI(flow=gni.Variational(gni.Midpoint()))]
METHODS = [*RULES, *GNIS]
SCENES = {
    "sleigh": lambda: gni.scenes.chaplygin_sleigh(1.3, 0.6, 0.4),
    "ball": lambda: gni.scenes.rolling_ball(1.3, 0.8, 0.45, 0.9),
    "inhomogeneous ball": lambda: gni.scenes.inhomogeneous_ball(1.7, 0.8, (0.9, 0.5, 0.7), 0.9),
}
# (animal, method, options): every method, every kind of groupoid, both sides, m from 0 to 3
ANIMALS = [
    ("pair 1", RULES[1], {"m": 0, "gyroscopic": True}),
    ("pair 3", RULES[2], {"m": 2, "affine": True, "gyroscopic": True}),
    ("SO3 right exp", RULES[3], {"m": 1, "affine": True}),
    ("SE2 left cay", GNIS[1], {"m": 2, "gyroscopic": True}),
    ("action left cay", RULES[0], {"m": 1, "affine": True, "gyroscopic": True}),
    ("framed left cay", GNIS[0], {"m": 3}),
]
EXPENSIVE = ("SO4 left exp", "SO4 right exp")


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def report_on(view: MethodView, laws: Any = METHOD_EQUATION_LAWS, **options: Any) -> LawReport:
    return check_laws(
        f"{view.method}", {"method": view}, laws,
        **{"on_fail": "raise", "expected_failures": None, "examples": 15, "seed": 0, **options},
    )


def expected_laws(method: Any, system: gni.MechanicalSystem) -> set[str]:
    """The laws that have something to say."""
    names = {law.name for law in METHOD_EQUATION_LAWS}
    rows, two_step = system.constraint_count > 0, method in RULES
    if not rows:
        names -= {"nodes_satisfy_the_constraints", "choice_of_rows_does_not_matter"}
    if not rows or two_step:
        names -= {"impact_in_the_middle", "what_is_lent_is_taken_back"}
    if not rows or not two_step:
        names -= {"normal_equation", "multipliers_are_impulses_per_time"}
    if not two_step:
        names -= {
            "tangential_equation", "momenta_belong_to_their_nodes", "impulses_annihilate_d"
        }
    if not np.any(coordinate_velocities(system.space)):
        names -= {"gauge_terms_do_not_matter"}
    return names


def tried(report: LawReport) -> set[str]:
    return {found.law.name for found in report.findings if found.evaluations >= 3}


@pytest.mark.parametrize(
    ("name", "method"),
    [("sleigh", RULES[0]), ("ball", GNIS[0]), ("inhomogeneous ball", RULES[3])], ids=str,
)
def test_laws_hold_on_the_scenes(name: str, method: Any) -> None:
    system = SCENES[name]().system
    assert tried(report_on(MethodView(method, system, 0.05))) == expected_laws(method, system)


@pytest.mark.parametrize(("name", "method", "options"), ANIMALS, ids=str)
def test_laws_hold_in_the_zoo(name: str, method: Any, options: Any) -> None:
    system = zoo.animal(name, **options).system
    assert tried(report_on(MethodView(method, system, 0.05))) == expected_laws(method, system)


def test_laws_hold_with_a_row_too_many() -> None:
    given = zoo.animal("SO3 left cay", 1, affine=True).system.plain
    row = given["constraints"](np.zeros(0), None)
    system = gni.MechanicalSystem(
        gni.SO3(), metric=given["metric"](np.zeros(0), None),
        constraints=np.concatenate([row, -0.7 * row]), drift=[0.2, -0.3, 0.4],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report_on(MethodView(gni.EulerB(), system, 0.05))


# The variants themselves.


@pytest.mark.parametrize("name", ["pair 3", "atiyah right cay", "action left cay"])
def test_variants_are_groupoids(name: str) -> None:
    space = zoo.SPACES[name]()
    for variant in (Reframed(space, awkward_frame(np.ones(space.rank))), Opposite(space),
                    PairsOfArrows(space)):
        check_groupoid(variant, examples=3)


def test_the_opposite_of_a_left_group_is_the_right_one() -> None:
    for name in ("SE2 left cay", "SO3 left exp"):
        group = zoo.SPACES[name]()
        opposite, right = Opposite(group), other_side(group)
        x, xi, eta = np.zeros(0), *0.3 * np.cos(np.arange(6.0)).reshape(2, 3)
        g, h = (right.retract(x, v) for v in (xi, eta))
        np.testing.assert_allclose(opposite.retract(x, xi), g, atol=1e-15)
        np.testing.assert_allclose(opposite.multiply(g, h), right.multiply(g, h), atol=1e-15)
        for derived in ("trivialised_tangent_plus", "trivialised_tangent_minus"):
            np.testing.assert_allclose(
                getattr(opposite, derived)(x, xi), getattr(right, derived)(x, xi), atol=1e-15
            )
        np.testing.assert_allclose(opposite.bracket(x), right.bracket(x), atol=1e-14)
        assert (group.side, right.side, other_side(right).side) == ("left", "right", "left")


def test_coordinate_velocities() -> None:
    for name, found in {
        "pair 3": [1, 1, 1], "SO3 left cay": [0, 0, 0], "SE2 left exp": [1, 0, 0],
        "SE2 left cay": [0, 0, 0], "atiyah right cay": [1, 1, 0, 0, 0],
    }.items():
        np.testing.assert_array_equal(coordinate_velocities(zoo.SPACES[name]()), found)


# Symmetries along the constraints.


def rolling_disk() -> gni.MechanicalSystem:
    """A disk rolling upright: x, y, the angle of rolling, the heading."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(4), metric=np.diag([1.3, 1.3, 0.7, 0.4]),
        constraints=lambda x, p: np.array(
            [[1.0, 0.0, -0.8 * np.cos(x[3]), 0.0], [0.0, 1.0, -0.8 * np.sin(x[3]), 0.0]]
        ),
    )


@pytest.mark.parametrize(
    ("system", "section"),
    [
        (SCENES["ball"]().system, lambda x: np.array([0.0, 0.0, 0.0, 0.0, 1.0])),
        # the spin about the vertical, in the body frame: R^T e_3
        (SCENES["inhomogeneous ball"]().system, lambda x: np.concatenate([[0.0, 0.0], x[8:]])),
        (rolling_disk(), lambda x: np.array([0.0, 0.0, 0.0, 1.0])),
    ],
    ids=["ball", "inhomogeneous ball", "disk"],
)
def test_momentum_along_the_constraints_is_kept(system: Any, section: Any) -> None:
    name = "momentum_of_a_symmetry_is_kept"
    laws = [law for law in METHOD_RUN_LAWS if law.name == name]
    for method in (gni.EulerA(), gni.GNI()):
        report = report_on(MethodView(method, system, 0.05, (section,)), laws)
        assert report[name].evaluations >= 3


# check_method.


def test_check_method_tries_both_groups_of_laws() -> None:
    system = gni.MechanicalSystem(gni.SO2(), metric=[[1.3]])
    report = check_method(gni.GNI(), system, step=0.1, examples=5)
    assert report.passed
    assert [found.law for found in report.findings] == [
        *METHOD_EQUATION_LAWS, *METHOD_RUN_LAWS, *METHOD_FLOW_LAWS
    ]
    assert report.subject.startswith("GNI(order=2) on SO2(")
    broken = check_method(
        broken_methods.Nearsighted(), zoo.animal("SO3 left cay", 0).system, on_fail="return",
        examples=3,
        expected_failures={"frames_do_not_matter": "the rule looks at a component"},
    )
    assert "frames_do_not_matter" not in {found.law.name for found in broken.failures}
    assert "sides_do_not_matter" in {found.law.name for found in broken.failures}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"method": gni.GNI}, "is the class GNI"),
        ({"method": None}, "or a discrete Lagrangian such as"),
        ({"method": gni.ReferenceFlow()}, "those of discrete mechanics"),
        ({"method": gni.GNI(flow=gni.Splitting()), "system": zoo.animal("pair 3").system},
         "needs a metric that does not depend on the base point"),
        ({"system": gni.MechanicalSystem(gni.SO2(), [[1.3]], controls=1,
                                         force=lambda x, xi, p, u: u)},
         "write numbers for them into the force"),
        ({"method": "GNI"}, "method must be a value"),
        ({"system": gni.SO3()}, "takes a method and a MechanicalSystem"),
        ({"step": -0.1}, "must be positive"),
        ({"step": "small"}, "must be a number"),
        ({"symmetries": lambda x: x}, "must be a list of functions"),
        ({"symmetries": [3.0]}, "number 0 is 3.0"),
        ({"symmetries": [lambda x: np.zeros(4)]}, "number 0 gave"),
        ({"symmetries": [lambda x: np.full(3, np.nan)]}, "number 0 gave"),
        ({"symmetries": [lambda: 0]}, "failed at the example base point"),
        ({"examples": 0}, "whole number"),
        ({"on_fail": "shout"}, "on_fail must be"),
        ({"expected_failures": {"frames_matter": "so"}}, "did you mean 'frames_do_not_matter'"),
    ],
    ids=lambda value: value if isinstance(value, str) else ",".join(value),
)
def test_check_method_says_what_is_wrong_with_a_request(given: Any, said: str) -> None:
    sound = {"method": gni.GNI(), "system": gni.MechanicalSystem(gni.SO3(), metric=np.eye(3))}
    with pytest.raises(gni.InputError, match=said):
        check_method(**{**sound, **given})


# Teeth: a relative mistake of 1e-6 is not round-off.


def _slightly_elastic(self: Node, p: Any) -> Any:
    return p - (2.0 - 1e-6) * (self.mu.T @ self.impulse(p))


def _form_slightly_scaled(self: Node, p: Any) -> Any:
    shifted = p - (1.0 + 1e-6) * self._gyroscopic
    return self.normal.T @ shifted - self.mu @ self._drift


def _slightly_scaled(original: Any) -> Any:
    return lambda *arguments: (1.0 + 1e-6) * original(*arguments)


class _SlightlyEuclidean(Node):
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.normal = self.normal + 1e-6 * self.mu.T


_PLACES, _ROUNDER = broken_methods.places, broken_methods.rounder
_SMALL = [
    ("legendre_plus_by_definition tangential_equation normal_equation discrete_euler_lagrange "
     "momenta_belong_to_their_nodes", _PLACES(gni.Rattle()),
     FreeFlight, "legendre_plus", _slightly_scaled(FreeFlight.legendre_plus)),
    ("legendre_minus_by_definition impact_in_the_middle what_is_lent_is_taken_back",
     _PLACES(gni.GNI()), FreeFlight, "legendre_minus", _slightly_scaled(FreeFlight.legendre_minus)),
    ("normal_equation nodes_satisfy_the_constraints", _PLACES(gni.EulerA()),
     Node, "reflect", _slightly_elastic),
    ("impact_in_the_middle", _PLACES(gni.GNI()), Node, "reflect", _slightly_elastic),
    ("gauge_terms_do_not_matter", _PLACES(gni.EulerA()), Node, "violation", _form_slightly_scaled),
    ("frames_do_not_matter", broken_methods.body(gni.GNI()),
     system_expressions, "Node", _SlightlyEuclidean),
    ("sides_do_not_matter unreduced_systems_move_alike reconstruction_is_the_unreduced_motion",
     _ROUNDER(gni.EulerA()), gni.LieGroup, "trivialised_tangent_plus",
     _slightly_scaled(gni.LieGroup.trivialised_tangent_plus)),
    ("velocities_belong_to_momenta", _PLACES(gni.EulerA()),
     SystemExpressions, "velocity", _slightly_scaled(SystemExpressions.velocity)),
]


@pytest.mark.parametrize(
    ("names", "make", "owner", "name", "value"), _SMALL, ids=[small[0] for small in _SMALL]
)
def test_a_mistake_of_a_millionth_is_caught(
    names: str, make: Any, owner: Any, name: str, value: Any
) -> None:
    wanted = set(names.split())
    laws = [law for law in METHOD_EQUATION_LAWS if law.name in wanted]
    with mock.patch.object(search, "_SHRINK_SECONDS", 0.0), mock.patch.object(owner, name, value):
        failures = report_on(make(), laws, on_fail="return").failures
    assert {failure.law.name for failure in failures} == wanted


def test_every_law_catches_something() -> None:
    caught = frozenset().union(*[broken.caught_by for broken in broken_methods.BROKEN])
    assert caught == {law.name for law in METHOD_EQUATION_LAWS}


# Everything.


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_laws_hold_for_every_method_everywhere(method: Any) -> None:
    turn = [str(other) for other in METHODS].index(str(method))
    for number, name in enumerate(zoo.SPACES):
        if name not in EXPENSIVE and number % len(METHODS) == turn:
            system = zoo.animal(
                name, number % 4, affine=number % 2 == 0, gyroscopic=number % 3 == 0
            ).system
            report = report_on(MethodView(method, system, 0.05))
            assert tried(report) == expected_laws(method, system)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPENSIVE)
def test_laws_hold_on_large_groupoids(name: str) -> None:
    system = zoo.animal(name, 2, affine=True).system
    for method in (gni.EulerA(), gni.GNI()):
        report_on(MethodView(method, system, 0.05))
