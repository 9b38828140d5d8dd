"""Methods with a mistake in what their runs keep, and the library with one in its steps."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np

import groupoid_gni as gni
from groupoid_gni.codegen import newton_rule
from groupoid_gni.codegen.runners import InterpretedStep, Progress, StepRunner
from groupoid_gni.discretization import SystemExpressions, projected_program
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.integrators import marching, preparation
from groupoid_gni.outcomes import Outcome
from groupoid_gni.verification import LawReport, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo
from broken import Broken

_STEP = 0.05
_FEW = 12

View = Callable[[], MethodView]


def _on(name: str, method: Any, step: float = _STEP) -> View:
    """A method on an animal of the zoo; made anew, so that nothing recorded is reused."""
    return lambda: MethodView(method, zoo.animal(name).system, step)


def isotropic(method: Any, group: Any, rows: Any) -> MethodView:
    """A method on a group with a bi-invariant metric and linear constraints."""
    metric = 1.37 * np.eye(group.rank)
    return MethodView(method, gni.MechanicalSystem(group, metric=metric, constraints=rows), 0.1)


def spring(method: Any) -> MethodView:
    """A method on R^3 x R^3 with a spring and a rolling knife."""
    mass = np.array([[1.3, 0.2, 0.0], [0.2, 0.9, 0.1], [0.0, 0.1, 1.6]])
    well = np.array([[1.1, 0.3, -0.2], [0.3, 1.7, 0.4], [-0.2, 0.4, 0.8]])
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=mass,
        potential=lambda x, p: 0.5 * x @ well @ x + np.array([0.3, -0.2, 0.4]) @ x,
        constraints=lambda x, p: np.array([[-x[1], 0.3 * x[2], 1.0]]),
    )
    return MethodView(method, system, 0.1)


def ball(method: Any, *symmetries: Any) -> MethodView:
    """A method on the ball on a rotating table."""
    return MethodView(method, gni.scenes.rolling_ball().system, 0.2, symmetries)


def spin_about_the_vertical(x: Any) -> Any:
    """A symmetry of the homogeneous ball that its constraints allow."""
    return np.array([0.0, 0.0, 0.0, 0.0, 1.0])


# Rules with a mistake.


class _OwnAdjoint(gni.DiscreteLagrangian):
    """Claims to be its own adjoint."""

    def adjoint(self) -> gni.DiscreteLagrangian:
        return self


@dataclass(frozen=True)
class EulerThatClaims(_OwnAdjoint):
    def average(self, L: Any, space: Any, x0: Any, x1: Any, xi: Any, h: Any) -> Any:
        return L(x0, xi)


@dataclass(frozen=True)
class Lopsided(_OwnAdjoint):
    weight: float = 0.4

    def average(self, L: Any, space: Any, x0: Any, x1: Any, xi: Any, h: Any) -> Any:
        return self.weight * L(x0, xi) + (1 - self.weight) * L(x1, xi)


@dataclass(frozen=True)
class Sum(_OwnAdjoint):
    def average(self, L: Any, space: Any, x0: Any, x1: Any, xi: Any, h: Any) -> Any:
        return L(x0, xi) + L(x1, xi)


@dataclass(frozen=True)
class HalfTheVelocity(_OwnAdjoint):
    def average(self, L: Any, space: Any, x0: Any, x1: Any, xi: Any, h: Any) -> Any:
        return L(space.target(space.retract(x0, h * xi / 2)), xi)


# The library with a mistake.


def _without_adjoint(
    expressions: Any, outward: Any, homeward: Any, fractions: Any, reconstruct: Any
) -> Any:
    return projected_program(expressions, outward, outward, fractions, reconstruct)


def _after_one_iteration(*measured: Any) -> bool:
    return True


def _without_transport(self: SystemExpressions, x: Any, eta: Any) -> Any:
    return -self.tangent_minus(x, eta)


def _trivial_transport(self: SystemExpressions, x: Any, eta: Any) -> Any:
    return ca.SX.eye(self.rank)


def _from_the_wrong_side(self: SystemExpressions, arrow: Any, then: Any) -> Any:
    return self._restore_arrow.call_sx(self._multiply.call_sx(then, arrow))


_advance, _begin = InterpretedStep.advance, StepRunner.begin
_initial_states, _multipliers = preparation._initial_states, gni.Trajectory.multipliers.func


def _half_the_force(run: gni.Trajectory) -> Any:
    two_step = run.layout.slices["before"] != run.layout.slices["after"]
    return _multipliers(run) / (2.0 if two_step else 1.0)


def _saved_one_late(
    self: InterpretedStep, parameters: Any, progress: Progress, count: int, every: int,
    controls: Any = None,
) -> Any:
    rows = []
    for _ in range(count):
        progress, row, outcome = _advance(self, parameters, progress, 1, 1)
        if outcome is not Outcome.SUCCESS:
            break
        if (progress.stage + 1) % every == 0:
            rows.append(row[0])
    return progress, np.array(rows).reshape(-1, self.program.row_size), outcome


def _forgetful(
    self: InterpretedStep, parameters: Any, progress: Progress, count: int, every: int,
    controls: Any = None,
) -> Any:
    return _advance(self, parameters, self.with_unknowns(parameters, progress, None), count, every)


def _half_impulse_forgotten(
    layout: Any, starts: Any, h: Any, force: Any, multipliers: Any, pose: Any
) -> Any:
    force = force if pose is None else np.zeros_like(force)
    return _initial_states(layout, starts, h, force, multipliers, pose)


def _left_over() -> dict[str, tuple[Any, Any]]:
    """``begin`` that goes on from what the runner's last run guessed."""
    kept: dict[int, Any] = {}

    def advance(
        self: Any, parameters: Any, progress: Progress, count: int, every: int,
        controls: Any = None,
    ) -> Any:
        end, rows, outcome = _advance(self, parameters, progress, count, every)
        kept[id(self)] = end.memory
        return end, rows, outcome

    def begin(self: StepRunner, parameters: Any, state: Any) -> Progress:
        fresh = _begin(self, parameters, state)
        memory = kept.get(id(self), fresh.memory).copy()
        memory[-1] = 0.0
        return Progress(fresh.state, memory)

    return {"advance": (InterpretedStep, advance), "begin": (StepRunner, begin)}


def _check(make: View, mutations: Mapping[str, tuple[Any, Any]]) -> LawReport:
    with ExitStack() as stack:
        # a small counterexample is not what these are for, and takes most of the time
        stack.enter_context(mock.patch.object(search, "_SHRINK_SECONDS", 0.0))
        for name, (owner, value) in mutations.items():
            stack.enter_context(mock.patch.object(owner, name, value))
        return check_laws(
            "broken", {"method": make()}, METHOD_RUN_LAWS, on_fail="return",
            expected_failures=None, examples=_FEW, seed=0,
        )


def _broken(mistake: str, make: View, caught_by: str, **mutations: tuple[Any, Any]) -> Broken:
    return Broken(mistake, lambda: _check(make, mutations), frozenset(caught_by.split()))


_BACK = "run_backwards_returns turned_round_motion_returns "
_FLIGHT = "adjoint_undoes_the_free_flight "
_ADJOINT = _FLIGHT + "adjoint_undoes_the_arrow "
_ORDER = "order_is_as_claimed "
_FORCE = "impulses_become_constraint_forces "
_FREE = "free_step_is_a_poisson_map momentum_in_space_is_kept "

# What is claimed of a rule and not true of it.
_RULES = [
    _broken("Euler A that claims to be its own adjoint",
            _on("pair 3", EulerThatClaims()), _ADJOINT + _BACK + _ORDER + _FORCE),
    _broken("weights 0.4 and 0.6 that claim order 2",
            _on("action left cay", Lopsided()), _ADJOINT + _BACK + _ORDER + _FORCE),
    # a projected step shows no arrows to follow and no impulses
    _broken("a GNI of Euler A that claims to be its own adjoint",
            _on("pair 3", gni.GNI(flow=gni.Variational(EulerThatClaims()))),
            _FLIGHT + _BACK + _ORDER),
    # twice L has the motions of L, at half the speed for the same momentum
    _broken("the sum of L at the ends for their mean", _on("pair 3", Sum()), _ORDER + _FORCE),
    # the two midpoints are O(h^3) apart: order 2 remains
    _broken("h xi / 2 for the half arrow, with Cayley",
            _on("action left cay", HalfTheVelocity()), _ADJOINT + _BACK),
    _broken("a symmetry that is none",
            lambda: ball(gni.GNI(), lambda x: np.array([0.0, 0.0, 1.0, 0.0, 0.0])),
            "momentum_of_a_symmetry_is_kept"),
]

# Flights and impacts.
_STEPS = [
    # without constraints Euler B after Euler B is as canonical as anything
    _broken("the second half of a projected step without the adjoint",
            _on("pair 3", gni.GNI()), _BACK + _ORDER,
            projected_program=(marching, _without_adjoint)),
    # what is left of the residual is of high order in h
    _broken("one Newton iteration", _on("SO3 left cay", gni.GNI(), 0.3), _FREE + _FLIGHT + _BACK,
            finished=(newton_rule, _after_one_iteration)),
    _broken("one Newton iteration, on the ball",
            lambda: ball(gni.GNI(), spin_about_the_vertical),
            "free_step_is_a_poisson_map momentum_of_a_symmetry_is_kept run_backwards_returns "
            + _FLIGHT,
            finished=(newton_rule, _after_one_iteration)),
    # on the constraint such motions are steady, nothing is ever reflected
    _broken("projection for reflection, bi-invariant metric",
            lambda: isotropic(gni.Rattle(), gni.SO3(), [[1.0, 0.4, -0.2]]),
            "energy_of_a_biinvariant_metric_is_kept adjoint_undoes_the_arrow",
            reflect=(Node, Node.project)),
    _broken("projection for reflection, spring", lambda: spring(gni.Rattle()),
            "energy_of_a_quadratic_potential_is_kept adjoint_undoes_the_arrow "
            + _BACK + _ORDER + _FORCE,
            reflect=(Node, Node.project)),
    # p' = p without constraints: the identity is canonical, and its own adjoint
    _broken("momentum not transported", _on("SO3 left cay", gni.GNI()),
            "momentum_in_space_is_kept " + _ORDER,
            tangent_plus=(SystemExpressions, _without_transport)),
    _broken("B+ = 1", _on("SE2 right exp", gni.Rattle()),
            _FREE + _ADJOINT + _BACK + _ORDER + _FORCE,
            tangent_plus=(SystemExpressions, _trivial_transport)),
    _broken("half the impulse for the force", _on("SO3 left cay", gni.Rattle()), _FORCE,
            multipliers=(gni.Trajectory, property(_half_the_force))),
]

# Bookkeeping.
_NODES = [
    _broken("saved nodes off by one", _on("SO3 left cay", gni.Rattle()),
            "saving_less_changes_nothing", advance=(InterpretedStep, _saved_one_late)),
    _broken("guesses forgotten between chunks", _on("SO3 left cay", gni.GNI()),
            "pieces_make_the_run", advance=(InterpretedStep, _forgetful)),
    _broken("no half impulse at the start when poses are wanted",
            _on("SO3 left cay", gni.Rattle()),
            "reconstruction_changes_nothing reconstruction_multiplies_the_arrows",
            _initial_states=(preparation, _half_impulse_forgotten)),
    _broken("W' = g W", _on("SO3 left cay", gni.GNI()), "reconstruction_multiplies_the_arrows",
            continue_arrow=(SystemExpressions, _from_the_wrong_side)),
    # every other run then starts from other guesses, and ends a round-off away
    Broken("guesses left over from the last run",
           lambda: _check(_on("SO3 left cay", gni.GNI()), _left_over()),
           frozenset({"equal_calls_give_equal_bits", "saving_less_changes_nothing",
                      "pieces_make_the_run", "reconstruction_changes_nothing"})),
]

BROKEN = [*_RULES, *_STEPS, *_NODES]
