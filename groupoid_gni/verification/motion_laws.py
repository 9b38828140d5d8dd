"""Sections 2, 6 and 8.2: one Lagrangian, the equations of motion, starts, nonholonomy."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.errors import DependentConstraintsWarning
from groupoid_gni.verification.gaps import Gap
from groupoid_gni.verification.laws import Law, law
from groupoid_gni.verification.nonholonomy import growth
from groupoid_gni.verification.system_samples import (
    Derivative,
    along_roads,
    covector_gap,
    has_base,
    has_constraints,
    has_term,
    motions,
)
from groupoid_gni.verification.system_view import SystemView, inverse_of

_FEW = "round-off of a few small solves, in units of their condition number"
_ROADS = (
    "exact derivatives up to round-off; where a term is not analytic, differences see 1e-9 of it"
)
_TERMS = ("metric", "constraints", "potential", "drift", "gyroscopic")

_law = partial(law, "system", draw=motions, tolerance=1e-12, reason=_FEW)
_slope_law = partial(law, "system", draw=motions, tolerance=1e-12, reason=_ROADS)


# Recordings.


def _units(view: SystemView, x: FloatArray, name: str) -> FloatArray:
    """Natural sizes of the entries of a term, so that none hides behind a larger one."""
    mass = np.sqrt(np.abs(np.diag(view.term("metric", x)))) + 1e-300
    if name == "constraints":
        rows = np.linalg.norm(view.term("constraints", x) / mass, axis=1)
        return np.outer(np.where(rows > 0.0, rows, 1.0), mass)
    sizes = {"metric": np.outer(mass, mass), "drift": 1.0 / mass, "gyroscopic": mass}
    return sizes.get(name, np.ones(()))


def _largest(*arrays: FloatArray) -> float:
    return sum(float(np.max(np.abs(array), initial=0.0)) for array in arrays)


def _recorded(name: str) -> Law:
    def measure(view: SystemView, x: FloatArray, **_: FloatArray) -> Gap:
        units = _units(view, x, name)
        recorded = np.asarray(view.system.recorded(name)(x, view.theta)) / units
        plain = np.asarray(view.term(name, x), dtype=float) / units
        return Gap(recorded, plain, _largest(plain) or 1.0)

    measure.__name__ = f"recorded_{name}_is_the_plain_one"
    statement = f"recorded {name}(x) = plain {name}(x)"
    source = "the machine code is made from the recording"
    return _law(statement, "x in Q", source, applies=has_term(name))(measure)


def _slope(name: str) -> Law:
    def measure(view: SystemView, x: FloatArray, **_: FloatArray) -> Gap:
        units = _units(view, x, name)[..., None]
        recorded = np.asarray(view.system.recorded(name).derivative(0)(x, view.theta)) / units
        size = _largest(view.term(name, x) / units[..., 0])

        def against(derive: Derivative) -> Gap:
            plain = derive(partial(view.term, name), x) / units
            return Gap(recorded, plain, size + _largest(plain) or 1.0)

        return along_roads(against)

    def applies(view: SystemView) -> str | None:
        return has_term(name)(view) or has_base(view)

    measure.__name__ = f"slope_of_{name}_is_that_of_the_plain_one"
    statement = f"d/dx of the recorded {name} = d/dx of the plain {name}"
    source = "forces and the Newton rule are derivatives of the recording"
    return _slope_law(statement, "x in Q", source, applies=applies, share=0.5)(measure)


# One Lagrangian.


@_law("L(x, xi) = 1/2 G_x(xi, xi) + <A_x, xi> - V(x)", "xi in A_x G", "Section 8.2 (i)")
def lagrangian_is_the_plain_one(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """The Lagrangian of the step is the one that was given."""
    return Gap(
        np.array(view.lagrangian(x, xi)), np.array(view.plain_lagrangian(x, xi)),
        _energies(view, x, xi) or 1.0,
    )


def _energies(view: SystemView, x: FloatArray, xi: FloatArray) -> float:
    """What the terms of L amount to at that speed if nothing cancels."""
    node = view.node(x)
    speed = node.speed(xi)
    return speed**2 + speed * node.size(node.gyroscopic) + _largest(view.term("potential", x))


@_slope_law("momentum(xi) = dL/dxi", "xi in A_x G", "Section 6, after (25): p = G xi, with A")
def momentum_is_the_slope_of_the_lagrangian(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """Momentum is the derivative of the one Lagrangian."""
    node, found = view.node(x), view.momentum(x, xi)

    def against(derive: Derivative) -> Gap:
        plain = derive(partial(view.plain_lagrangian, x), xi)
        return covector_gap(node, found, plain, node.metric @ xi, node.gyroscopic)

    return along_roads(against)


@_law("velocity(momentum(xi)) = xi", "xi in A_x G", "the Legendre transform is invertible")
def velocity_inverts_momentum(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """The two Legendre transforms undo one another."""
    node = view.node(x)
    back = view.velocity(x, view.momentum(x, xi))
    scale = node.condition * (node.speed(xi) + node.size(node.gyroscopic))
    return Gap(node.lower.T @ back, node.lower.T @ xi, scale or 1.0)


@_law("energy(p) = <p, xi> - L(xi), xi = G^-1 (p - A)", "p in A*_x G", "Section 2; Section 5")
def energy_is_the_legendre_transform(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Energy comes from the same Lagrangian."""
    node = view.node(x)
    xi = node.inverse @ (p - node.gyroscopic)
    scale = node.condition * (_energies(view, x, xi) + node.size(p) * node.speed(xi))
    plain = np.sum(view.energy_terms(x, p))
    return Gap(np.array(view.energy(x, p)), plain, scale or 1.0)


@_slope_law("base_gradient(xi) = dL/dx at fixed xi", "xi in A_x G", "Section 2, (2a)",
            applies=has_base)
def base_gradient_is_the_slope_of_the_lagrangian(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """Forces come from the same Lagrangian."""
    found = view.base_gradient(x, xi)

    def against(derive: Derivative) -> Gap:
        parts = derive(lambda point: view.lagrangian_terms(point, xi), x)
        size = np.max(np.sum(np.abs(parts), axis=0)) + _energies(view, x, xi)
        return Gap(found, np.sum(parts, axis=0), float(size) or 1.0)

    return along_roads(against)


# Equations of motion.


def _external_force(view: SystemView, x: FloatArray, velocity: FloatArray) -> FloatArray:
    """f(x, v) without control inputs; zero where the system has none."""
    system = view.system
    if not system.has("force"):
        return np.zeros_like(velocity)
    inputs = np.zeros(system.control_size)
    return np.asarray(system.recorded("force")(x, velocity, view.theta, inputs), dtype=float)


class _Forces:
    """The parts of ``x', p'`` in plain NumPy.

    Anchor and bracket are differentiated from the seven functions of the groupoid.
    along_base : ``rho v``.  free : ``rho^T dL/dx + <p, [v, e_a]>``, and the external force.
    constraint : ``mu^T lambda``, from the rate of the constraints along the free motion.
    size : of every term of these, and of what turning constraints do, added up.
    """

    def __init__(
        self, view: SystemView, x: FloatArray, p: FloatArray, derive: Derivative
    ) -> None:
        node = view.node(x)
        velocity = node.inverse @ (p - node.gyroscopic)
        mass = np.sqrt(np.diag(node.metric))
        self.along_base, self.free, size = np.zeros(0), np.zeros_like(p), np.zeros_like(p)
        if x.size:
            anchor = view.derived.anchor(x)
            self.along_base = anchor @ velocity
            slopes = derive(lambda y: view.lagrangian_terms(y, velocity), x)
            self.free = anchor.T @ np.sum(slopes, axis=0)
            size = np.abs(anchor).T @ np.sum(np.abs(slopes), axis=0)
        bracket = np.einsum("c,cba,b->acb", p, view.derived.bracket(x), velocity)
        self.free = self.free + np.sum(bracket, axis=(1, 2))
        push = _external_force(view, x, velocity)
        self.free = self.free + push
        size = size + np.sum(np.abs(bracket), axis=(1, 2)) + np.abs(push)
        rate = partial(_rate_of_constraints, view, derive, x, p, self.along_base)
        self.constraint = -node.mu.T @ inverse_of(node.gram) @ rate(self.free)
        turning = node.mu.T @ inverse_of(node.gram) @ rate(np.zeros_like(p))
        self.size = node.size(turning) + float(np.linalg.norm(size / mass))


def _forces(view: SystemView, x: FloatArray, p: FloatArray, derive: Derivative) -> _Forces:
    kept, key = view.node(x).kept, (p.tobytes(), derive)
    if key not in kept:
        kept[key] = _Forces(view, x, p, derive)
    found: _Forces = kept[key]
    return found


def _natural_size(
    view: SystemView, x: FloatArray, p: FloatArray, derive: Derivative
) -> float:
    """The size of the forces at p and at a covector with the same speed in no special direction.

    What cancels at p leaves round-off that only the other one measures.
    """
    node = view.node(x)
    speed = node.speed(node.inverse @ (p - node.gyroscopic))
    awkward = np.cos(np.arange(1.0, len(p) + 1.0))
    other = node.gyroscopic + node.lower @ (speed * awkward / np.linalg.norm(awkward))
    return sum(_forces(view, x, covector, derive).size for covector in (p, other))


def _rate(
    derive: Derivative, function: Callable[[Array, Array], Any], x: FloatArray, p: FloatArray,
    along_x: FloatArray, along_p: FloatArray,
) -> FloatArray:
    """The derivative of a sum of terms ``function(x, p)`` along a direction.

    Term by term, and momenta in units of their own: differences would lose small ones.
    """
    unit = _largest(p) or 1.0
    change = derive(lambda z: function(x, z * unit), p / unit, along_p[None] / unit)
    if x.size:
        change = change + derive(lambda y: function(y, p), x, along_x[None])
    return np.asarray(np.sum(change[..., 0], axis=0))


def _rate_of_constraints(
    view: SystemView, derive: Derivative, x: FloatArray, p: FloatArray,
    along_x: FloatArray, along_p: FloatArray,
) -> FloatArray:
    """The rate of ``mu (G^-1 (p - A) - Y)`` along a direction."""
    violation = partial(view.violation_terms, rows=view.node(x).rows)
    return _rate(derive, violation, x, p, along_x, along_p)


def _constraint_force(view: SystemView, x: FloatArray, p: FloatArray) -> FloatArray:
    return np.asarray(view.node(x).mu.T @ view.multipliers(x, p))


@_law("x' = rho(x) v", "v = G^-1 (p - A), p in A*_x G", "(2) on AG", applies=has_base)
def base_moves_by_the_anchor(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The base point moves as the velocity says."""
    node = view.node(x)
    velocity = node.inverse @ (p - node.gyroscopic)
    anchor = view.derived.anchor(x)
    # how fast each coordinate moves at that speed
    units = np.abs(anchor) @ (1.0 / np.sqrt(np.diag(node.metric)))
    units[units == 0.0] = 1.0
    scale = node.condition * node.speed(velocity) or 1.0
    return Gap(view.rates(x, p)[0] / units, anchor @ velocity / units, scale)


@_slope_law("p_a' = rho_a^i dL/dx^i + <p, [v, e_a]> + lambda mu_a + f_a", "p in A*_x G",
            "(2a) on AG")
def momentum_moves_by_the_forces(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Gradient, bracket and constraint force, each where it belongs."""
    node = view.node(x)
    found, force = view.rates(x, p)[1], _constraint_force(view, x, p)

    def against(derive: Derivative) -> Gap:
        forces = _forces(view, x, p, derive)
        scale = node.condition * _natural_size(view, x, p, derive) or 1.0
        return Gap(node.in_frame(found), node.in_frame(forces.free + force), scale)

    return along_roads(against)


@_slope_law("mu^T lambda = -mu^T C^-1 d/dt (mu (v - Y)) along the free motion", "p in A*_x G",
            "the display after Theorem 5.2; (2)", applies=has_constraints)
def multipliers_are_the_dense_ones(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The multipliers are those of which the constraints have need."""
    node, found = view.node(x), _constraint_force(view, x, p)

    def against(derive: Derivative) -> Gap:
        forces = _forces(view, x, p, derive)
        scale = node.condition * _natural_size(view, x, p, derive) or 1.0
        return Gap(node.in_frame(found), node.in_frame(forces.constraint), scale)

    return along_roads(against)


@_slope_law("d/dt mu (v - Y) = 0 along the equations of motion", "p in A*_x G", "(2b), (24)",
            applies=has_constraints)
def motion_keeps_the_constraints(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The equations of motion never leave the constraint set."""
    node, (along_x, along_p) = view.node(x), view.rates(x, p)

    def against(derive: Derivative) -> Gap:
        rate = _rate_of_constraints(view, derive, x, p, along_x, along_p) / node.row_sizes
        scale = node.condition * _natural_size(view, x, p, derive)
        return Gap(rate, np.zeros_like(rate), scale or 1.0)

    return along_roads(against)


def _power_gap(view: SystemView, x: FloatArray, p: FloatArray, allowed_power: bool) -> Gap:
    """dH/dt along the equations of motion, from p moved onto the constraint set."""
    node = view.node(x)
    for _ in range(2):  # once more, for what rounding leaves of a large normal part
        p = node.along @ p + node.across @ node.offset
    along_x, along_p = view.rates(x, p)
    velocity = node.inverse @ (p - node.gyroscopic)
    power = float(_external_force(view, x, velocity) @ velocity)
    power += float(_constraint_force(view, x, p) @ node.drift) if allowed_power else 0.0

    def against(derive: Derivative) -> Gap:
        rate = _rate(derive, view.energy_terms, x, p, along_x, along_p)
        speed = node.speed(velocity, node.drift)
        scale = node.condition * _natural_size(view, x, p, derive) * speed
        return Gap(rate, np.array(power), scale or 1.0)

    return along_roads(against)


def _no_drift(view: SystemView) -> str | None:
    return "the system has a drift" if view.system.has("drift") else None


@_slope_law("dH/dt = <f, v> along the equations of motion", "mu v = 0, Y = 0, f the external force",
            "Section 1: energy is preserved when the constraints are linear", applies=_no_drift)
def motion_keeps_the_energy(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Linear constraints do no work."""
    return _power_gap(view, x, p, allowed_power=False)


@_slope_law("dH/dt = <mu^T lambda, Y> + <f, v> along the equations of motion", "mu (v - Y) = 0",
            "(24): affine constraints work along the drift alone", applies=has_term("drift"))
def constraints_work_along_the_drift(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The power of affine constraints is what the drift takes."""
    return _power_gap(view, x, p, allowed_power=True)


# Starts.


@_law("state(x, xi) = (x, v, p): p = P* (G xi + A) + Q* Pi = G v + A, mu (v - Y) = 0",
      "xi in A_x G", "(1), (24), (25)", share=0.3)
def states_are_consistent(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """A start is moved to the nearest velocity on the constraints, and is one state."""
    node, system = view.node(x), view.system
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DependentConstraintsWarning)
        state = system.state(x if x.size else None, xi, project_start=True)
    momentum = node.along @ (node.metric @ xi + node.gyroscopic) + node.across @ node.offset
    velocity = node.inverse @ (momentum - node.gyroscopic)
    size = node.speed(xi, node.drift) + node.size(node.gyroscopic)
    rows = np.asarray(view.term("constraints", x), dtype=float)
    lengths = np.linalg.norm(node.in_frame(rows.T), axis=0)
    violation = rows @ (state.velocity - node.drift) / np.where(lengths > 0.0, lengths, 1.0)
    moved = (state.base - x) * size / (1.0 + _largest(x))
    left = [node.in_frame(state.momentum), node.lower.T @ state.velocity, violation, moved]
    right = [node.in_frame(momentum), node.lower.T @ velocity, 0.0 * violation, 0.0 * moved]
    return Gap(np.concatenate(left), np.concatenate(right), node.condition * size or 1.0)


# Nonholonomy.


_rank_law = partial(
    law, "system", draw=motions, tolerance=0.5, share=0.02, applies=has_constraints, advisory=True
)


def _grown(ranks: tuple[int, ...], wanted: int) -> Gap:
    """Ranks on the left; on the right, with the last one as it should be."""
    return Gap(np.array(ranks, dtype=float), np.array([*ranks[:-1], wanted], dtype=float), 1.0)


@_rank_law(
    "rank(D + [D, D] + [Y, D]) > rank D", "x generic in Q, D = {mu v = 0}",
    "Section 2: a non-integrable distribution",
    reason="left: the ranks found. The constraints are INTEGRABLE: they confine positions, not "
    "velocities alone, and the motion is holonomic on each leaf. Nothing is wrong with a run, but "
    "positions leave the leaf by the error of the method. If you meant a nonholonomic "
    "system, look at the rows mu; if not, use coordinates on the leaf and leave the constraints "
    "out",
)
def constraints_are_not_integrable(
    view: SystemView, x: FloatArray, **_: FloatArray
) -> Gap:
    """Brackets of allowed directions leave D."""
    ranks = growth(view, x)
    stuck = len(ranks) == 1 and ranks[0] < view.system.space.rank
    return _grown(ranks, ranks[-1] + stuck)


@_rank_law(
    "D, [D, D], [D, [D, D]], ... span A_x G (and [Y, D], ... for affine constraints)",
    "x generic in Q, D = {mu v = 0}", "Section 2; Chow's theorem",
    reason="left: the ranks found, right: the last as it should be. Some combination of the "
    "constraints is integrable: it is a conserved function of position, or a symmetry that "
    "the system cannot leave. Nothing is wrong with a run. If you did not mean it, look "
    "at the rows mu; if you did, coordinates on the leaf make the system smaller",
)
def constraints_reach_everywhere(
    view: SystemView, x: FloatArray, **_: FloatArray
) -> Gap:
    """By manoeuvres, every direction can be reached."""
    return _grown(growth(view, x), view.system.space.rank)


MOTION_LAWS = (
    *(_recorded(name) for name in _TERMS), *(_slope(name) for name in _TERMS),
    lagrangian_is_the_plain_one, momentum_is_the_slope_of_the_lagrangian,
    velocity_inverts_momentum, energy_is_the_legendre_transform,
    base_gradient_is_the_slope_of_the_lagrangian, base_moves_by_the_anchor,
    momentum_moves_by_the_forces, multipliers_are_the_dense_ones, motion_keeps_the_constraints,
    motion_keeps_the_energy, constraints_work_along_the_drift, states_are_consistent,
    constraints_are_not_integrable, constraints_reach_everywhere,
)
