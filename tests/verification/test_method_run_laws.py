"""What runs keep, adjoints, orders, bookkeeping: on every shipped method, with teeth."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.verification import LawReport, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_runs
import zoo

RULES = [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()]
GNIS = [gni.GNI(), *[gni.GNI(flow=gni.Variational(rule)) for rule in RULES[2:]]]
METHODS = [*RULES, *GNIS]
SCENES = {
    "ball": gni.scenes.rolling_ball,
    "sleigh": gni.scenes.chaplygin_sleigh,
    "inhomogeneous ball": gni.scenes.inhomogeneous_ball,
}
# (animal, method, options): every method, every kind of groupoid, both sides
ANIMALS = [
    ("pair 1", GNIS[1], {"m": 0, "gyroscopic": True}),
    ("pair 3", RULES[3], {"m": 2}),
    ("SO3 right exp", RULES[0], {"m": 1, "gyroscopic": True}),
    ("SE3 left cay", GNIS[0], {"m": 3, "affine": True}),
    ("atiyah left exp", RULES[1], {"m": 2, "affine": True}),
    ("framed right cay", RULES[2], {"m": 1, "affine": True, "gyroscopic": True}),
    ("action left cay", GNIS[2], {"m": 1}),
]
EXPENSIVE = ("SO4 left exp", "SO4 right exp", "twelve", "product exp")


def report_on(view: MethodView, laws: Any = METHOD_RUN_LAWS, **options: Any) -> LawReport:
    return check_laws(
        f"{view.method}", {"method": view}, laws,
        **{"on_fail": "raise", "expected_failures": None, "examples": 15, "seed": 0, **options},
    )


def tried(report: LawReport) -> set[str]:
    return {found.law.name for found in report.findings if found.evaluations}


def on_scene(name: str, method: Any) -> MethodView:
    symmetries = (broken_runs.spin_about_the_vertical,) if name == "ball" else ()
    return MethodView(method, SCENES[name]().system, 0.05, symmetries)


ALWAYS = {
    "free_step_is_a_poisson_map", "adjoint_undoes_the_free_flight", "order_is_as_claimed",
    "equal_calls_give_equal_bits", "saving_less_changes_nothing", "pieces_make_the_run",
    "reconstruction_changes_nothing", "reconstruction_multiplies_the_arrows",
}


@pytest.mark.parametrize(
    ("name", "method"),
    [("ball", GNIS[0]), ("ball", RULES[3]), ("sleigh", RULES[0]), ("inhomogeneous ball", GNIS[2])],
    ids=str,
)
def test_laws_hold_on_the_scenes(name: str, method: Any) -> None:
    names = tried(report_on(on_scene(name, method)))
    assert names >= ALWAYS
    assert ("momentum_of_a_symmetry_is_kept" in names) == (name == "ball")


@pytest.mark.parametrize(("name", "method", "options"), ANIMALS, ids=str)
def test_laws_hold_in_the_zoo(name: str, method: Any, options: Any) -> None:
    system = zoo.animal(name, **options).system
    names = tried(report_on(MethodView(method, system, 0.05)))
    assert names >= ALWAYS
    two_step, rows = method in RULES, system.constraint_count > 0
    assert ("adjoint_undoes_the_arrow" in names) == two_step
    assert ("impulses_become_constraint_forces" in names) == (two_step and rows)
    assert ("run_backwards_returns" in names) == (method not in RULES[:2])
    assert ("momentum_in_space_is_kept" in names) == (system.space.base_size == 0)


@pytest.mark.parametrize(
    ("group", "m", "rule"),
    [(gni.SO3(side="right"), 2, RULES[0]), (gni.QuadraticGroup(np.eye(4)), 3, RULES[2])],
    ids=str,
)
def test_energy_of_a_biinvariant_metric(group: gni.LieGroup, m: int, rule: Any) -> None:
    rows = np.eye(m, group.rank) + 0.3 * np.cos(np.arange(m * group.rank)).reshape(m, -1)
    name = "energy_of_a_biinvariant_metric_is_kept"
    report = report_on(broken_runs.isotropic(rule, group, rows))
    assert report[name].evaluations > 0
    skew = gni.MechanicalSystem(group, metric=np.diag(np.arange(1.0, group.rank + 1.0)))
    laws = [law for law in METHOD_RUN_LAWS if law.name == name]
    for view in (MethodView(rule, skew, 0.1), broken_runs.isotropic(GNIS[0], group, rows)):
        assert report_on(view, laws)[name].evaluations == 0


@pytest.mark.parametrize("method", [RULES[2], RULES[3], GNIS[1], GNIS[2]], ids=str)
def test_energy_of_a_quadratic_potential(method: Any) -> None:
    name = "energy_of_a_quadratic_potential_is_kept"
    assert report_on(broken_runs.spring(method))[name].evaluations > 0


def test_energy_laws_know_where_they_do_not_apply() -> None:
    name = "energy_of_a_quadratic_potential_is_kept"
    laws = [law for law in METHOD_RUN_LAWS if law.name == name]
    animals = {
        "is not constant": zoo.animal("pair 3", curved=False),
        "R^n x R^n": zoo.animal("SO3 left cay"),
        "gyroscopic": zoo.animal("pair 3", curved=False, gyroscopic=True),
    }
    for words, animal in animals.items():
        assert words in report_on(MethodView(gni.Rattle(), animal.system, 0.05), laws)[name].note
    assert "Rattle and Midpoint" in report_on(broken_runs.spring(gni.EulerA()), laws)[name].note


# Teeth: a relative mistake of 1e-6 is not round-off.


def _slightly_scaled(self: SystemExpressions, x: Any, eta: Any) -> Any:
    return (1.0 + 1e-6) * self._plus.call_sx(x, eta).reshape((self.rank, self.rank)).T


def _slightly_elastic(self: Node, p: Any) -> Any:
    return p - (2.0 - 1e-6) * (self.mu.T @ self.impulse(p))


def failures(view: MethodView, names: set[str]) -> set[str]:
    laws = [law for law in METHOD_RUN_LAWS if law.name in names]
    with mock.patch.object(search, "_SHRINK_SECONDS", 0.0):
        return {found.law.name for found in report_on(view, laws, on_fail="return").failures}


def test_a_rule_that_is_a_little_lopsided_is_caught() -> None:
    names = {
        "adjoint_undoes_the_free_flight", "adjoint_undoes_the_arrow", "run_backwards_returns",
        "turned_round_motion_returns",
    }
    view = MethodView(broken_runs.Lopsided(0.5 + 1e-6), zoo.animal("pair 3").system, 0.05)
    assert failures(view, names) == names


def test_a_transport_that_is_a_little_long_is_caught() -> None:
    names = {
        "free_step_is_a_poisson_map", "momentum_in_space_is_kept",
        "adjoint_undoes_the_free_flight", "run_backwards_returns",
    }
    with mock.patch.object(SystemExpressions, "tangent_plus", _slightly_scaled):
        view = MethodView(gni.GNI(), zoo.animal("SO3 left cay", 0).system, 0.05)
        assert failures(view, names) == names


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: broken_runs.spring(gni.Midpoint()), "energy_of_a_quadratic_potential_is_kept"),
        (
            lambda: broken_runs.isotropic(gni.Rattle(), gni.SO3(), [[1.0, 0.4, -0.2]]),
            "energy_of_a_biinvariant_metric_is_kept",
        ),
    ],
    ids=["spring", "bi-invariant"],
)
def test_an_impact_that_loses_a_little_is_caught(make: Any, name: str) -> None:
    names = {name, "adjoint_undoes_the_arrow"}
    with mock.patch.object(Node, "reflect", _slightly_elastic):
        assert failures(make(), names) == names


def test_every_law_catches_something() -> None:
    caught = frozenset().union(*[broken.caught_by for broken in broken_runs.BROKEN])
    assert caught == {law.name for law in METHOD_RUN_LAWS}


# Everything.


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_laws_hold_for_every_method_on_a_sixth_of_the_zoo(method: Any) -> None:
    for number, name in enumerate(zoo.SPACES):
        if name not in EXPENSIVE and (number + METHODS.index(method)) % 6 == 0:
            options = {"affine": number % 2 == 0, "gyroscopic": number % 5 < 2}
            system = zoo.animal(name, number % 4, **options).system
            report_on(MethodView(method, system, 0.05))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method"),
    [("SO4 left exp", RULES[2]), ("twelve", GNIS[0]), ("product exp", GNIS[1])],
    ids=str,
)
def test_laws_hold_on_large_groupoids(name: str, method: Any) -> None:
    report_on(MethodView(method, zoo.animal(name, 2, affine=True).system, 0.05))
