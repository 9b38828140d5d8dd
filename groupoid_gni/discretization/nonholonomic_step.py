"""Equation (49) with the affine term, once for every groupoid; and the projected step.

A step is free flight and elastic impact. With ``g`` the last arrow and q its target,

    FL-(h) = R_q(FL+(g)),    R(p) = (P* - Q*) p + 2 Q* Pi,                       (49), (38)

so the next arrow h comes from one reflection and one rank x rank solve; the constraints never enter
the nonlinear equations.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import (
    solve_linear,
    solve_lower,
    solve_upper,
)
from groupoid_gni.discretization.free_flight import Flight, FreeFlight
from groupoid_gni.discretization.step_program import Guard, StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import Node, SystemExpressions
from groupoid_gni.outcomes import Outcome

_SINGULAR_PIVOT = 1e-13
_VANISHING_ROW = 1e-12


class _Inputs:
    """Symbols every program starts from: parameters, step size, constraint scales."""

    def __init__(self, expressions: SystemExpressions) -> None:
        self.theta = ca.SX.sym("theta", expressions.parameter_size)
        self.h = ca.SX.sym("h")
        self.scales = ca.SX.sym("scales", expressions.constraint_count)
        self.all = ca.vertcat(self.theta, self.h, self.scales)

    def conditioning(self, node: Node) -> list[Guard]:
        """The constraints must stay independent, and no row may vanish."""
        guards = []
        for i, pivot in enumerate(node.pivots):
            if i:
                ratio = _SINGULAR_PIVOT * node.gram[i, i] / pivot
                guards.append(Guard(_not_below_zero(ratio, pivot), Outcome.CONSTRAINTS_SINGULAR))
            vanishing = _VANISHING_ROW * self.scales[i] / node.gram[i, i]
            guards.append(Guard(vanishing, Outcome.CONSTRAINTS_SINGULAR))
        return guards


def _not_below_zero(ratio: ca.SX, pivot: ca.SX) -> ca.SX:
    return ca.if_else(pivot > 0, ratio, 2)


def next_arrow_function(
    expressions: SystemExpressions, discrete: DiscreteLagrangian
) -> ca.Function:
    """(x0, xi_g, h, theta, xi_next) -> (residual of (49), its Jacobian, q, p+, p-, first guess)."""
    inputs = _Inputs(expressions)
    x0 = ca.SX.sym("x0", expressions.base_size)
    xi, following = ca.SX.sym("xi", expressions.rank), ca.SX.sym("next", expressions.rank)
    flight = FreeFlight(expressions, discrete)
    q = expressions.target(x0, inputs.h * xi)
    before = flight.legendre_plus(x0, xi, inputs.h, inputs.theta)
    after = expressions.node(q, inputs.theta).reflect(before)
    residual = flight.legendre_minus(q, following, inputs.h, inputs.theta) - after
    guess = expressions.velocity(q, after, inputs.theta)
    outputs = [residual, ca.jacobian(residual, following), q, before, after, guess]
    arguments = [x0, xi, inputs.h, inputs.theta, following]
    return ca.Function("next_arrow", arguments, [ca.densify(o) for o in outputs])


def two_step_program(
    expressions: SystemExpressions, discrete: DiscreteLagrangian, reconstruct: bool
) -> StepProgram:
    """The GNI of a discrete Lagrangian: fly from p- to the next node, reflect there.

    The state also carries the last two normal components of p+ and the largest amplitude of their
    (-1)^k part, the parasitic mode of the two-step recursion.
    """
    e, inputs = expressions, _Inputs(expressions)
    m = e.constraint_count
    layout = StateLayout.of(
        {
            "base": e.base_size,
            "before": e.rank,
            "after": e.rank,
            "normals": 2 * m,
            "parasitic": 3 if m else 0,
            "reconstructed": e.space.arrow_size if reconstruct else 0,
        }
    )
    state = ca.SX.sym("state", layout.size)
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    flight = FreeFlight(e, discrete).from_momentum(x0, p0, inputs.h, inputs.theta, "xi")
    x1 = e.restore_base(flight.target)
    node = e.node(x1, inputs.theta)
    monitor = _parasitic_monitor(node, flight, state, layout, m)
    arrow = e.retract(x0, flight.arrow) if reconstruct else ca.SX(0, 1)
    next_state = ca.vertcat(
        x1,
        flight.momentum,
        node.reflect(flight.momentum),
        monitor,
        _reconstruction(e, state, layout, arrow) if reconstruct else ca.SX(0, 1),
    )
    guards = [
        Guard(e.reach(x0, flight.arrow), Outcome.LEFT_DOMAIN),
        *inputs.conditioning(node),
    ]
    guess = e.velocity(x0, p0, inputs.theta)
    return _assemble(e, inputs, state, layout, [flight], [guess], None, next_state, guards)


def _parasitic_monitor(
    node: Node, flight: Flight, state: ca.SX, layout: StateLayout, m: int
) -> ca.SX:
    """Next values of the normals, and (amplitude, largest amplitude, largest jump), relative to p.

    The normal component z_k of p+ is h/2 times a smooth force plus ``(-1)^k u``; its second
    difference over four is u up to O(h^3). All three are measured against ``|p|`` in G^-1.
    """
    if m == 0:
        return ca.SX(0, 1)
    normals, record = state[layout.slices["normals"]], state[layout.slices["parasitic"]]
    last, before_last = normals[:m], normals[m:]
    now = node.normal_component(flight.momentum)
    size = ca.sqrt(ca.fmax(flight.energy, 1e-300))
    amplitude = ca.norm_2(now - 2 * last + before_last) / (4 * size)
    smooth = ca.norm_2(now + 2 * last + before_last) / (2 * size)
    return ca.vertcat(
        now, last, amplitude, ca.fmax(record[1], amplitude), ca.fmax(record[2], smooth)
    )


def _reconstruction(
    e: SystemExpressions, state: ca.SX, layout: StateLayout, arrow: ca.SX
) -> ca.SX:
    return e.continue_arrow(state[layout.slices["reconstructed"]], arrow)


def projected_program(
    expressions: SystemExpressions,
    first: DiscreteLagrangian,
    second: DiscreteLagrangian,
    reconstruct: bool,
) -> StepProgram:
    """One projected step: fly h/2, reflect, fly h/2, with a normal part lent and taken back.

    ``p0 + N0 nu -> first -> R -> second -> p1 - N1 W nu``, with nu such that p1 lies on the
    constraint set. N = mu^T L^-T is a G^-1-orthonormal basis of the normal space and W the isometry
    nearest to ``N1^T S N0``, S the mean of the two inverse metrics, which makes the choice of basis
    irrelevant. ``second`` must be the adjoint of ``first`` for the step to be self-adjoint.
    """
    e, inputs = expressions, _Inputs(expressions)
    m, half = e.constraint_count, inputs.h / 2
    layout = StateLayout.of(
        {
            "base": e.base_size,
            "after": e.rank,
            "reconstructed": e.space.arrow_size if reconstruct else 0,
        },
        aliases={"before": "after"},
    )
    state = ca.SX.sym("state", layout.size)
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    nu = ca.SX.sym("nu", m)
    start = e.node(x0, inputs.theta)
    displaced = p0 + start.normal_vector(nu) if m else p0
    outward = FreeFlight(e, first).from_momentum(x0, displaced, half, inputs.theta, "xi_a")
    middle = e.node(outward.target, inputs.theta)
    homeward = FreeFlight(e, second).from_momentum(
        outward.target, middle.reflect(outward.momentum), half, inputs.theta, "xi_b"
    )
    x1 = e.restore_base(homeward.target)
    end = e.node(x1, inputs.theta)
    closing = end.normal_component(homeward.momentum)
    closing = closing - ca.mtimes(_matching_isometry(start, end, m), nu)
    next_state = ca.vertcat(x1, end.project(homeward.momentum))
    if reconstruct:
        arrow = _product_of_flights(e, x0, outward, homeward)
        next_state = ca.vertcat(next_state, _reconstruction(e, state, layout, arrow))
    guards = [
        Guard(e.reach(x0, 2 * outward.arrow), Outcome.LEFT_DOMAIN),
        Guard(e.reach(outward.target, 2 * homeward.arrow), Outcome.LEFT_DOMAIN),
        *inputs.conditioning(middle),
        *inputs.conditioning(end),
    ]
    guess = e.velocity(x0, p0, inputs.theta)
    return _assemble(
        e, inputs, state, layout, [outward, homeward], [guess, guess], (nu, closing), next_state,
        guards,
    )


def _product_of_flights(
    e: SystemExpressions, x0: ca.SX, outward: Flight, homeward: Flight
) -> ca.SX:
    return e.continue_arrow(
        e.retract(x0, outward.arrow), e.retract(outward.target, homeward.arrow)
    )


def _matching_isometry(start: Node, end: Node, m: int) -> ca.SX:
    """The orthogonal factor W of ``N1^T S N0`` with ``S = (G0^-1 + G1^-1) / 2``."""
    if m == 0:
        return ca.SX(0, 0)
    from_start = _overlap(start, end, m)
    if m == 1:
        return ca.if_else(from_start >= 0, 1, -1)
    if m == 2:
        return _polar_of_two(from_start)
    polar = from_start
    for _ in range(6):
        # Newton's iteration for the polar factor; the overlap is within O(h^2) of an isometry
        polar = (polar + solve_linear(polar.T, ca.SX.eye(m))) / 2
    return polar


def _overlap(start: Node, end: Node, m: int) -> ca.SX:
    columns = []
    for i in range(m):
        unit = ca.SX(m, 1)
        unit[i] = 1
        basis_vector = start.normal_vector(unit)
        against_end = solve_lower(end.lower, ca.mtimes(end.normal.T, basis_vector))
        raised = ca.mtimes(start.normal, solve_upper(start.lower, unit))
        against_start = solve_lower(end.lower, ca.mtimes(end.mu, raised))
        columns.append((against_end + against_start) / 2)
    return ca.horzcat(*columns)


def _polar_of_two(a: ca.SX) -> ca.SX:
    """Orthogonal polar factor of a 2 x 2 matrix: A + sign(det A) cof A, normalised."""
    sign = ca.if_else(a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0] >= 0, 1, -1)
    first, second = a[0, 0] + sign * a[1, 1], a[1, 0] - sign * a[0, 1]
    length = ca.sqrt(first * first + second * second)
    first, second = first / length, second / length
    return ca.vertcat(ca.horzcat(first, -sign * second), ca.horzcat(second, sign * first))


def _assemble(
    e: SystemExpressions,
    inputs: _Inputs,
    state: ca.SX,
    layout: StateLayout,
    flights: list[Flight],
    guesses: list[ca.SX],
    closing: tuple[ca.SX, ca.SX] | None,
    next_state: ca.SX,
    guards: list[Guard],
) -> StepProgram:
    """Collect unknowns and residuals of all flights, eliminate, and close the program."""
    unknowns = [flight.unknowns for flight in flights]
    residuals = [flight.residual for flight in flights]
    first_guess = []
    for flight, guess in zip(flights, guesses, strict=True):
        first_guess.append(guess[list(flight.implicit)])
    groups = [u.numel() for u in unknowns]
    if closing is not None and closing[0].numel():
        unknowns.append(closing[0])
        residuals.append(closing[1])
        first_guess.append(ca.SX.zeros(closing[0].numel(), 1))
        groups.append(closing[0].numel())
    u, residual = ca.vertcat(*unknowns), ca.vertcat(*residuals)
    update = ca.SX(0, 1)
    if u.numel():
        update = solve_linear(ca.jacobian(residual, u), residual, groups)
    energy = ca.SX(0)
    for flight in flights:
        energy = energy + flight.energy
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=ca.densify(u),
        residual=ca.densify(residual),
        update=ca.densify(update),
        scale=energy,
        first_guess=ca.densify(ca.vertcat(*first_guess)),
        next_state=ca.densify(next_state),
        arrow_velocities=ca.densify(ca.vertcat(*[flight.velocity for flight in flights])),
        layout=layout,
        guards=tuple(guards),
    )
