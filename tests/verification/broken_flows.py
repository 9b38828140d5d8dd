"""Stages, flights and compositions with a mistake in them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np

import groupoid_gni as gni
from groupoid_gni.codegen.runners import StepRunner
from groupoid_gni.discretization import (
    SystemExpressions,
    energy_preserving_flight,
    splitting_flight,
)
from groupoid_gni.discretization.broyden import Broyden
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.verification import LawReport, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import turning_frame
import zoo
from broken import Broken

_STEP = 0.05
_ENERGY, _SPLIT = gni.EnergyPreserving(), gni.Splitting()

View = Callable[[], MethodView]


def on(name: str, method: Any, m: int = 1, **options: Any) -> View:
    """A method on an animal of the zoo; made anew, so that nothing recorded is reused."""
    return lambda: MethodView(method, zoo.animal(name, m, **options).system, _STEP)


def stretched(method: Any) -> View:
    """A method in a frame that turns along the arrows."""
    return lambda: MethodView(method, turning_frame.stretched().system, 0.2)


def rubbed(space: gni.LieGroupoid, m: int = 1, **options: Any) -> gni.MechanicalSystem:
    """An animal with friction that is not along any axis, and a steady push."""
    animal = zoo.animal("", m, space=space, **options).system
    size = space.rank
    drag = np.diag(0.3 + 0.1 * np.arange(size)) + 0.2 * np.eye(size, k=1)
    push = 0.2 * np.cos(np.arange(size))
    return gni.MechanicalSystem(
        space, parameters=dict(animal.parameters), **dict(animal.plain),
        force=lambda x, xi, p: p.rate * push - drag @ xi,
    )


def with_friction(method: Any) -> View:
    """A method on R^3 x R^3 with friction."""
    return lambda: MethodView(method, rubbed(gni.PairGroupoid(3)), _STEP)


# The library with a mistake.


def _table(*stages: float, order: int) -> gni.CompositionTable:
    return gni.CompositionTable("with a mistake", order, stages, "nowhere", projected=True)


_given = StepRunner.given


def _one_stage_late(self: StepRunner, stage: int, controls: Any) -> Any:
    return _given(self, stage + 1, controls)


def _gradient_in_the_middle(function: ca.Function, start: Any, end: Any, *others: Any) -> Any:
    symbols = [ca.SX.sym("t", start.numel()), *[ca.SX.sym("o", *o.shape) for o in others]]
    slope = ca.gradient(function(*symbols), symbols[0])
    return ca.Function("slope", symbols, [slope])((start + end) / 2, *others)


def _frame_taken_for_still(e: SystemExpressions) -> bool:
    return True


def _same_order(step: splitting_flight.SplittingStep) -> splitting_flight.SplittingStep:
    return step


def _anything_goes(space: Any, columns: Any) -> None:
    pass


def _twice_the_same(self: gni.Variational, e: SystemExpressions) -> Any:
    outward, _ = _flights(self, e)
    return outward, outward


_flights = gni.Variational.flights


def _printed(self: Node, p: Any) -> Any:
    nothing = self.violation(0 * p)
    return p - ca.mtimes(self.mu.T, 2 * ca.solve(self.gram, self.violation(p) - 2 * nothing))


def _taken_for_closed(self: Broyden, closing: Any, energy: Any, scale: Any = None) -> None:
    _close(self, 0 * closing, energy, scale)


_close = Broyden.close


def _twice_the_work(run: gni.Trajectory) -> Any:
    return 2.0 * _work(run)


_work = gni.Trajectory.work


def _check(make: View, mutations: tuple[tuple[Any, str, Any], ...]) -> LawReport:
    with ExitStack() as stack:
        # one sample in general position does, and needs no shrinking
        stack.enter_context(mock.patch.object(search, "_SHRINK_SECONDS", 0.0))
        stack.enter_context(mock.patch.object(search, "_FEWEST", 1))
        for owner, name, value in mutations:
            stack.enter_context(mock.patch.object(owner, name, value))
        return check_laws(
            "broken", {"method": make()}, (*METHOD_RUN_LAWS, *METHOD_FLOW_LAWS),
            on_fail="return", expected_failures=None, examples=1, seed=0,
        )


def _broken(
    mistake: str, make: View, caught_by: str, *mutations: tuple[Any, str, Any]
) -> Broken:
    return Broken(mistake, lambda: _check(make, mutations), frozenset(caught_by.split()))


_BACK = "run_backwards_returns turned_round_motion_returns "
_ORDER = "order_is_as_claimed "
_STAGES = "composed_steps_are_products_of_stages "
_KEPT = "energy_is_kept_exactly "
_FLOWN = "energy_preserving_flights_keep_the_energy "
_BARE = "bare_stage_is_its_own_adjoint "

_COMPOSITIONS = [
    # a palindrome of the right sum is self-adjoint, and of order 2 whatever it claims
    _broken("a table that is not of its order",
            on("pair 3", gni.GNI(4, table=_table(0.4, 0.4, -0.6, 0.4, 0.4, order=4))), _ORDER),
    _broken("a table of order 4 that claims 6",
            on("SO3 left cay", gni.GNI(6, table=_table(*gni.GNI(4).fractions, order=6))), _ORDER),
    # the sum of the fractions is the same, their order is not
    _broken("every stage told the fraction of the next one", on("pair 3", gni.GNI(4)),
            _STAGES + _BACK + _ORDER, (StepRunner, "given", _one_stage_late)),
]

_FLIGHTS = [
    # as good as the true one up to the order
    _broken("the gradient in the middle for the discrete one", on("pair 3", gni.GNI(2, _ENERGY)),
            _KEPT + _FLOWN, (energy_preserving_flight, "discrete_gradient",
                             _gradient_in_the_middle)),
    _broken("a frame that turns, taken for one that does not", stretched(gni.GNI(4, _ENERGY)),
            _KEPT + _FLOWN,
            (energy_preserving_flight, "_arrows_leave_velocities_alone", _frame_taken_for_still)),
    _broken("the work of friction counted twice", with_friction(gni.GNI(2, _ENERGY)),
            _KEPT + _FLOWN, (gni.Trajectory, "work", _twice_the_work)),
    _broken("projection for reflection, energy-preserving flights",
            on("SO3 left cay", gni.GNI(2, _ENERGY)), _KEPT + _BACK + _ORDER,
            (Node, "reflect", Node.project)),
    _broken("nothing lent is closed", on("pair 3", gni.GNI(2, _ENERGY), curved=True),
            _KEPT + _BACK, (Broyden, "close", _taken_for_closed)),
    _broken("both halves of a splitting in the same order", on("SO3 left cay", gni.GNI(2, _SPLIT)),
            _BACK + _ORDER, (splitting_flight.SplittingStep, "homeward", _same_order)),
    # self-adjoint, of order 2, Casimirs kept: and not canonical
    _broken("Cayley on the screws of SE(3)", on("SE3 left cay", gni.GNI(2, _SPLIT)),
            "free_step_is_a_poisson_map", (splitting_flight, "_check_retraction", _anything_goes)),
]

_NOT_PROJECTED = [
    _broken("a bare stage without the adjoint", on("pair 3", gni.GNI(4, projection=None)),
            _BARE + _BACK + _ORDER, (gni.Variational, "flights", _twice_the_same)),
    _broken("projection for reflection, bare", on("pair 3", gni.GNI(2, projection=None)),
            _BARE + "bare_stage_tends_to_the_reflection " + _BACK + _ORDER,
            (Node, "reflect", Node.project)),
    # another mirror, and as good an involution
    _broken("+2 Q* Pi as printed, bare", on("pair 3", gni.GNI(2, projection=None), affine=True),
            "bare_stage_tends_to_the_reflection " + _ORDER, (Node, "reflect", _printed)),
    _broken("McLachlan and Perlmutter's step without the adjoint",
            on("pair 3", gni.McLachlanPerlmutter(4)), _BACK + _ORDER,
            (gni.Variational, "flights", _twice_the_same)),
    _broken("no impulse in McLachlan and Perlmutter's step",
            on("pair 3", gni.McLachlanPerlmutter(2)), _BACK + _ORDER,
            (Broyden, "close", _taken_for_closed)),
]

BROKEN = [*_COMPOSITIONS, *_FLIGHTS, *_NOT_PROJECTED]
