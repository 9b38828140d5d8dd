"""Every stepping method against all laws of methods, with teeth for those of stages and flights."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.codegen.runners import StepRunner
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.verification import LawReport, check_method, check_system, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_variants import coordinate_velocities
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_flows
import turning_frame
import zoo

LAWS = (*METHOD_EQUATION_LAWS, *METHOD_RUN_LAWS, *METHOD_FLOW_LAWS)
NAMES = {law.name for law in LAWS}
ENERGY, SPLIT = gni.EnergyPreserving(), gni.Splitting()
BODY = lambda **o: zoo.animal("SO3 left cay", 1, **o).system  # noqa: E731
PLACES = lambda m=1, **o: zoo.animal("pair 3", m, **o).system  # noqa: E731
# (method, system): every flow, every order, projected and bare, with and without a force
CASES = {
    "order 4": (gni.GNI(4), PLACES),
    "order 6, energy": (gni.GNI(6, ENERGY), BODY),
    "order 8, splitting": (gni.GNI(8, SPLIT), BODY),
    "energy, a turning frame": (gni.GNI(2, ENERGY), lambda: turning_frame.stretched().system),
    "splitting, places": (gni.GNI(2, SPLIT), lambda: PLACES(2, curved=False)),
    "bare": (gni.GNI(2, projection=None), lambda: PLACES(affine=True, gyroscopic=True)),
    "bare, order 4, energy": (gni.GNI(4, ENERGY, projection=None), BODY),
    "McLachlan and Perlmutter": (gni.McLachlanPerlmutter(), PLACES),
    "McLachlan and Perlmutter, order 4": (gni.McLachlanPerlmutter(4, SPLIT), BODY),
    "[28]": (gni.DiscreteLagrangeDAlembert(), PLACES),
    "[28], lopsided": (
        gni.DiscreteLagrangeDAlembert(gni.EulerA(), gni.ConstraintAtTarget()), BODY
    ),
    "friction": (gni.GNI(4), lambda: broken_flows.rubbed(gni.SO3(), affine=True)),
    "friction, arrows": (gni.EulerB(), lambda: broken_flows.rubbed(gni.PairGroupoid(3))),
    "friction, energy": (gni.GNI(2, ENERGY), lambda: broken_flows.rubbed(gni.SO3())),
    "free": (gni.GNI(6, projection=None), lambda: PLACES(0)),
}

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def tried(report: LawReport) -> set[str]:
    return {found.law.name for found in report.findings if found.evaluations}


def expected_laws(method: Any, system: gni.MechanicalSystem) -> set[str]:
    """What of the laws is about a method, told without the view of it."""
    flow = getattr(method, "flow", gni.Variational())
    stages = isinstance(method, gni.GNI | gni.McLachlanPerlmutter)
    arrows, two_step = not stages, isinstance(method, gni.DiscreteLagrangian)
    rows, force = system.constraint_count > 0, system.has("force")
    bare = isinstance(method, gni.GNI) and method.projection is None and rows
    composed = stages and (method.order > 2 or bare)
    away = {"momentum_of_a_symmetry_is_kept", "energy_of_a_biinvariant_metric_is_kept",
            "energy_of_a_quadratic_potential_is_kept"}
    if not two_step:
        away |= {"tangential_equation", "normal_equation", "adjoint_undoes_the_arrow",
                 "impulses_become_constraint_forces"}
    if not arrows:
        away |= {"momenta_belong_to_their_nodes", "impulses_annihilate_d",
                 "multipliers_are_impulses_per_time"}
    if flow != gni.Variational():
        away |= {"legendre_plus_by_definition", "legendre_minus_by_definition",
                 "adjoint_undoes_the_free_flight"}
    if flow != gni.Variational() or (stages and method.order > 2):
        away |= {"discrete_euler_lagrange"}
    if not isinstance(method, gni.GNI) or flow != gni.Variational() or composed or not rows:
        away |= {"impact_in_the_middle", "what_is_lent_is_taken_back"}
    if not rows:
        away |= {"nodes_satisfy_the_constraints", "choice_of_rows_does_not_matter"}
    if bare:
        away |= {"nodes_satisfy_the_constraints"}
    else:
        away |= {"bare_stage_is_its_own_adjoint", "bare_stage_tends_to_the_reflection"}
    if composed or flow == SPLIT:
        away |= {"arrows_join_the_nodes"}
    if not composed:
        away |= {"composed_steps_are_products_of_stages"}
    if flow == SPLIT:
        away |= {"frames_do_not_matter", "gauge_terms_do_not_matter"}
    if not np.any(coordinate_velocities(system.space)):
        away |= {"gauge_terms_do_not_matter"}
    if system.space.base_size or force:
        away |= {"momentum_in_space_is_kept"}
    if flow == ENERGY or force:
        away |= {"free_step_is_a_poisson_map"}
    if flow != ENERGY:
        away |= {"energy_is_kept_exactly", "energy_preserving_flights_keep_the_energy"}
    lopsided = not stages and "Euler" in str(method)
    if lopsided:
        away |= {"run_backwards_returns"}
    if lopsided or force or system.has("drift") or system.has("gyroscopic"):
        away |= {"turned_round_motion_returns"}
    return NAMES - away


@pytest.mark.parametrize("case", CASES)
def test_every_stepping_method_obeys_the_laws_that_are_about_it(case: str) -> None:
    method, make = CASES[case]
    system = make()
    report = check_method(method, system, examples=1)
    assert tried(report) == expected_laws(method, system)


def test_a_system_with_friction_obeys_the_laws_of_systems() -> None:
    for system in (broken_flows.rubbed(gni.SO3()),
                   broken_flows.rubbed(gni.AtiyahGroupoid(1, gni.SO2()), affine=True)):
        assert check_system(system, examples=5).passed


# Teeth: a mistake of a millionth is not round-off.


def failures(view: MethodView, names: str) -> set[str]:
    laws = [law for law in METHOD_FLOW_LAWS if law.name in names.split()]
    with mock.patch.object(search, "_SHRINK_SECONDS", 0.0):
        report = check_laws("broken", {"method": view}, laws, on_fail="return",
                            expected_failures=None, examples=5, seed=0)
    return {found.law.name for found in report.failures}


def _slightly_elastic(self: Node, p: Any) -> Any:
    return p - (2.0 - 1e-6) * (self.mu.T @ self.impulse(p))


_given = StepRunner.given


def _slightly_longer(self: StepRunner, stage: int, controls: Any) -> Any:
    given = _given(self, stage, controls)
    given[0] *= 1.0 + 1e-6 * (stage % 5 == 1)
    return given


@pytest.mark.parametrize(
    ("names", "make", "owner", "name", "value"),
    [
        ("energy_is_kept_exactly", broken_flows.on("SO3 left cay", gni.GNI(2, ENERGY)),
         Node, "reflect", _slightly_elastic),
        ("bare_stage_is_its_own_adjoint bare_stage_tends_to_the_reflection",
         broken_flows.on("pair 3", gni.GNI(2, projection=None)),
         Node, "reflect", _slightly_elastic),
        ("composed_steps_are_products_of_stages", broken_flows.on("pair 3", gni.GNI(4)),
         StepRunner, "given", _slightly_longer),
    ],
    ids=["energy", "bare", "stages"],
)
def test_a_mistake_of_a_millionth_is_caught(
    names: str, make: Any, owner: Any, name: str, value: Any
) -> None:
    with mock.patch.object(owner, name, value):
        assert failures(make(), names) == set(names.split())


def test_energy_of_flights_sees_a_millionth_of_the_slope() -> None:
    name = "energy_preserving_flights_keep_the_energy"
    original = broken_flows.energy_preserving_flight.discrete_gradient

    def steeper(*arguments: Any) -> ca.SX:
        return (1.0 + 1e-6) * original(*arguments)

    view = broken_flows.on("pair 3", gni.GNI(2, ENERGY))
    with mock.patch.object(broken_flows.energy_preserving_flight, "discrete_gradient", steeper):
        assert failures(view(), name) == {name}


def test_every_law_catches_something() -> None:
    caught = frozenset().union(*[broken.caught_by for broken in broken_flows.BROKEN])
    assert caught >= {law.name for law in METHOD_FLOW_LAWS}


@pytest.mark.parametrize("order", [2, 4])
def test_bare_steps_keep_the_constraint_to_their_order_only(order: int) -> None:
    a = zoo.animal("pair 3", 1)

    def violation(h: float) -> float:
        run = gni.integrate(a.system, a.start, step=h, n_steps=round(0.8 / h),
                            method=gni.GNI(order, projection=None))
        return float(np.max(np.abs(run.constraint_residuals(relative=True))))

    coarse, fine = (0.1, 0.05) if order == 2 else (0.4, 0.2)
    slope = np.log2(violation(coarse) / violation(fine))
    assert order - 0.3 < slope < order + 0.7, slope
    assert violation(fine) > 1e-11
