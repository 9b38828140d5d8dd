"""The equations of a step with a mistake in them, and rules and groupoids that cannot hold them."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np

import groupoid_gni as gni
from groupoid_gni.codegen.emitter import Emitter
from groupoid_gni.discretization import (
    FreeFlight,
    SystemExpressions,
    projected_step,
    system_expressions,
    two_step_program,
)
from groupoid_gni.discretization.elimination import cholesky, solve_linear
from groupoid_gni.discretization.system_expressions import Node
from groupoid_gni.integrators import marching, one_arrow
from groupoid_gni.systems import starts
from groupoid_gni.verification import LawReport, search
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_view import MethodView

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo
from broken import Broken
from broken_flows import with_friction

_EULER, _RATTLE = gni.EulerA(), gni.Rattle()

View = Callable[[], MethodView]


def _on(method: Any, space: gni.LieGroupoid, m: int, step: float = 0.05) -> View:
    """A method on a system with drift, potential, gyroscopic term; made anew at every call."""
    return lambda: MethodView(
        method, zoo.animal("", m, affine=True, gyroscopic=True, space=space).system, step
    )


def places(method: Any, m: int = 1, n: int = 2, step: float = 0.05) -> View:
    """On R^n x R^n: all terms depend on the place, all velocities are coordinates."""
    return _on(method, gni.PairGroupoid(n), m, step)


def body(method: Any, group: gni.LieGroup | None = None) -> View:
    """On a group: nothing depends on the place, and nothing commutes."""
    return _on(method, gni.SO3() if group is None else group, 2)


def rounder(method: Any) -> View:
    """On R x R x SO(3) with space velocities: places and rotations."""
    return _on(method, gni.AtiyahGroupoid(1, gni.SO3(side="right")), 2)


# Rules and groupoids with a mistake.


@dataclass(frozen=True)
class Nearsighted(gni.DiscreteLagrangian):
    """Looks at a component of the velocity: another one in another frame."""

    def average(self, L: Any, space: Any, x0: Any, x1: Any, xi: Any, h: Any) -> Any:
        return L(x0, xi) + h * xi[0] ** 3


class Transposed(gni.SO3):
    """Its closed form of B- is the transposed one."""

    def trivialised_tangent_minus(self, x: Any, xi: Any) -> Any:
        return super().trivialised_tangent_minus(x, xi).T


# The library with a mistake.

_minus, _plus = FreeFlight.legendre_minus, FreeFlight.legendre_plus


def _printed(self: Node, p: Any) -> Any:
    offset = self.violation(0 * p)
    impulse = solve_linear(self.gram, self.violation(p) - 2 * offset)
    return p - ca.mtimes(self.mu.T, 2 * impulse)


def _jump_of_velocity(self: Node, p: Any) -> Any:
    return p - ca.mtimes(self.normal, 2 * self.impulse(p))


def _drift_the_other_way(self: Node, p: Any) -> Any:
    return ca.mtimes(self.normal.T, p - self._gyroscopic) + ca.mtimes(self.mu, self._drift)


def _offset_without_form(self: Node, p: Any) -> Any:
    return ca.mtimes(self.normal.T, p) - ca.mtimes(self.mu, self._drift)


def _nothing_lent(self: Node, components: Any) -> Any:
    return ca.SX.zeros(self.mu.size2(), 1)


class _Euclidean(Node):
    def __init__(self, expressions: Any, x: Any, theta: Any) -> None:
        super().__init__(expressions, x, theta)
        self.normal = self.mu.T
        self.gram = ca.mtimes(self.mu, self.mu.T)
        self.lower, self.pivots = cholesky(self.gram)


class _Late(SystemExpressions):
    """Reflects where the step started."""

    def node(self, x: Any, theta: Any) -> Node:
        if not hasattr(self, "_first"):
            self._first = super().node(x, theta)
        return self._first


def _late(e: SystemExpressions, rule: Any, reconstruct: bool) -> Any:
    return two_step_program(_Late(e.system, e.active_rows), rule, reconstruct)


def _bases_matched_by_number(start: Node, end: Node, *more: Any) -> Any:
    return ca.SX.eye(start.mu.size1())


def _without_force(wrong: Any) -> Any:
    """FL with the part that comes from dl/dx left out."""

    def legendre(self: FreeFlight, x0: Any, xi: Any, h: Any, theta: Any) -> Any:
        gradients = self._gradients

        def blind(*arguments: Any) -> Any:
            by_source, by_target, by_velocity = gradients(*arguments)
            return 0 * by_source, 0 * by_target, by_velocity

        with mock.patch.object(self, "_gradients", blind):
            return wrong(self, x0, xi, h, theta)

    return legendre


def _force_not_scaled(right: Any) -> Any:
    """FL with dl/dx for h dl/dx."""
    without = _without_force(right)

    def legendre(self: FreeFlight, x0: Any, xi: Any, h: Any, theta: Any) -> Any:
        momentum = without(self, x0, xi, h, theta)
        return momentum + (right(self, x0, xi, h, theta) - momentum) / h

    return legendre


def _plus_for_minus(self: SystemExpressions, x: Any, eta: Any) -> Any:
    return -self.tangent_plus(x, eta)


def _sides_forgotten(self: gni.LieGroup, x: Any, xi: Any) -> Any:
    return self.dtau_inverse(-xi)


def _from_where_it_was(function: Any, arguments: Any) -> Any:
    _, velocity = _solve(function, arguments)
    return arguments[0], velocity


_solve, _velocity = one_arrow._solve, SystemExpressions.velocity


def _velocity_without_form(self: SystemExpressions, x: Any, p: Any, theta: Any) -> Any:
    return solve_linear(self.metric(x, theta), p)


def _all_rows(system: Any, x: Any, metric: Any) -> Any:
    return starts.IndependentRows(tuple(range(system.constraint_count)), (), (), ())


def _single_precision(self: Emitter, value: float) -> str:
    return _constant(self, float(np.float32(value)))


_constant = Emitter.constant


def _products_turned_round(self: gni.Trajectory, first: Any, arrows: Any) -> Any:
    space, products = self.system.space, [first]
    for arrow in arrows:
        products.append(space.multiply(arrow, products[-1]))
    return np.array(products)


def _first_flight_only(self: gni.Trajectory) -> Any:
    r, space = self.system.space.rank, self.system.space
    xi = self.rows[1:, self.layout.size : self.layout.size + r]
    places = zip(self.base[:-1], self.step_size * xi, strict=True)
    return np.array([space.retract(*place) for place in places])


def _part(name: str) -> Any:
    return property(lambda run: run._part(name))


_forces = gni.Trajectory.multipliers.func  # type: ignore[attr-defined]


def _impulses(self: gni.Trajectory) -> Any:
    return self.step_size * _forces(self)


def _check(make: View, mutations: tuple[tuple[Any, str, Any], ...]) -> LawReport:
    with ExitStack() as stack:
        stack.enter_context(mock.patch.dict(os.environ, GROUPOID_GNI_CACHE=""))
        # a small counterexample is not what these are for, and takes most of the time; one sample
        # in general position does
        stack.enter_context(mock.patch.object(search, "_SHRINK_SECONDS", 0.0))
        stack.enter_context(mock.patch.object(search, "_FEWEST", 1))
        for owner, name, value in mutations:
            stack.enter_context(mock.patch.object(owner, name, value))
        return check_laws(
            "broken", {"method": make()}, METHOD_EQUATION_LAWS, on_fail="return",
            expected_failures=None, examples=1, seed=0,
        )


def _broken(
    mistake: str, make: View, caught_by: str, *mutations: tuple[Any, str, Any]
) -> Broken:
    return Broken(mistake, lambda: _check(make, mutations), frozenset(caught_by.split()))


_BY_DEFINITION = "legendre_plus_by_definition legendre_minus_by_definition "
_PLUS, _MINUS = (f"{name} " for name in _BY_DEFINITION.split())
_EQUATION = "tangential_equation normal_equation "
_ALONG = "discrete_euler_lagrange momenta_belong_to_their_nodes "
_PROJECTED = "discrete_euler_lagrange impact_in_the_middle what_is_lent_is_taken_back "
_NODES = "nodes_satisfy_the_constraints "

# (48)
_TRANSFORMS = [
    _broken("FL- without the force", places(_EULER), _MINUS + _EQUATION + _ALONG,
            (FreeFlight, "legendre_minus", _without_force(_minus))),
    # the second flight, of Euler A, feels no force at its target
    _broken("FL+ without the force, projected", places(gni.GNI()),
            "discrete_euler_lagrange impact_in_the_middle " + _PLUS,
            (FreeFlight, "legendre_plus", _without_force(_plus))),
    _broken("forces not multiplied by h", places(_RATTLE), _BY_DEFINITION + _EQUATION + _ALONG,
            (FreeFlight, "legendre_minus", _force_not_scaled(_minus)),
            (FreeFlight, "legendre_plus", _force_not_scaled(_plus))),
    _broken("-B+ for B-", body(_EULER), _MINUS + _EQUATION + _ALONG,
            (SystemExpressions, "tangent_minus", _plus_for_minus)),
    # the other side, the other frame and the unreduced system have the same closed form
    _broken("B- transposed, a user's group", body(gni.GNI(), Transposed()), _MINUS + _PROJECTED),
    # here the opposite groupoid and the unreduced one derive B+ from the product, and the other
    # frame derives the bracket from B+
    _broken("B+ of a left group on a right one", rounder(_EULER),
            "frames_do_not_matter sides_do_not_matter unreduced_systems_move_alike "
            "reconstruction_is_the_unreduced_motion " + _PLUS + _EQUATION + _ALONG,
            (gni.LieGroup, "trivialised_tangent_plus", _sides_forgotten)),
]

# (49) and (38)
_IMPACTS = [
    _broken("+2 Q* Pi as printed in (38b)", places(_EULER),
            "normal_equation gauge_terms_do_not_matter " + _NODES, (Node, "reflect", _printed)),
    # its projected steps end on the constraint all the same
    _broken("+2 Q* Pi as printed, projected", places(gni.GNI()),
            "impact_in_the_middle gauge_terms_do_not_matter", (Node, "reflect", _printed)),
    _broken("the impulse as a jump of the velocity", body(_EULER),
            "impulses_annihilate_d multipliers_are_impulses_per_time frames_do_not_matter "
            + _EQUATION + _NODES, (Node, "reflect", _jump_of_velocity)),
    _broken("reflection where the step started", places(_EULER),
            "impulses_annihilate_d multipliers_are_impulses_per_time " + _NODES,
            (marching, "two_step_program", _late)),
    _broken("drift the other way", body(_EULER), "normal_equation " + _NODES,
            (Node, "violation", _drift_the_other_way)),
    _broken("Pi = G Y without A", places(_EULER),
            "normal_equation gauge_terms_do_not_matter " + _NODES,
            (Node, "violation", _offset_without_form)),
    _broken("projectors orthogonal in coordinates", body(_EULER),
            "normal_equation frames_do_not_matter " + _NODES,
            (system_expressions, "Node", _Euclidean)),
    _broken("the next arrow starts where the last one did", places(_EULER), _EQUATION,
            (one_arrow, "_solve", _from_where_it_was)),
    _broken("a projection after each step, nothing lent before", places(gni.GNI()),
            "what_is_lent_is_taken_back", (Node, "normal_vector", _nothing_lent)),
    # what is lent is O(h^3), what the bases turn by O(h)
    _broken("normal bases matched by number", places(gni.GNI(), m=2, n=3, step=0.3),
            "what_is_lent_is_taken_back choice_of_rows_does_not_matter",
            (projected_step, "_matching_isometry", _bases_matched_by_number)),
]

# Friction.
_push = FreeFlight._push


def _at_the_other_end(self: FreeFlight, end: int, *arguments: Any) -> Any:
    return _push(self, 1 - end, *arguments)


_FRICTION = [
    _broken("friction at the wrong end", with_friction(_EULER), _BY_DEFINITION + _EQUATION + _ALONG,
            (FreeFlight, "_push", _at_the_other_end)),
]

# What a run reports.
_REPORTS = [
    # then the multipliers have the wrong sign too
    _broken("momenta before and after exchanged", body(_EULER), "momenta_belong_to_their_nodes",
            (gni.Trajectory, "momenta_before", _part("after")),
            (gni.Trajectory, "momenta_after", _part("before"))),
    _broken("impulses for multipliers", body(_EULER), "multipliers_are_impulses_per_time",
            (gni.Trajectory, "multipliers", property(_impulses))),
    _broken("velocities that forget A", places(_EULER),
            "velocities_belong_to_momenta gauge_terms_do_not_matter",
            (SystemExpressions, "velocity", _velocity_without_form)),
    _broken("arrows of the first flight for the whole step", places(gni.GNI()),
            "arrows_join_the_nodes reconstruction_is_the_unreduced_motion",
            (gni.Trajectory, "arrows", property(_first_flight_only))),
    _broken("times off by one", body(_EULER), "arrows_join_the_nodes",
            (gni.Trajectory, "times", property(lambda run: (run.node_steps + 1) * run.step_size))),
    _broken("W' = g W", body(_EULER), "reconstruction_is_the_unreduced_motion",
            (gni.Trajectory, "_accumulate", _products_turned_round)),
]

# What must make no difference.
_DIFFERENCES = [
    _broken("a rule that looks at a component", body(Nearsighted()),
            "frames_do_not_matter sides_do_not_matter"),
    _broken("dependent rows kept", body(_EULER), "choice_of_rows_does_not_matter",
            (starts, "independent_rows", _all_rows)),
    _broken("constants in single precision", body(_EULER), "machine_code_is_the_expressions",
            (Emitter, "constant", _single_precision)),
]

BROKEN = [*_TRANSFORMS, *_IMPACTS, *_FRICTION, *_REPORTS, *_DIFFERENCES]
