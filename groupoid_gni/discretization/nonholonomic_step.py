"""Equation (49) with the affine term, once for every groupoid; and the projected step.

A step is free flight and elastic impact. With ``g`` the last arrow and q its target,

    FL-(h) = R_q(FL+(g)),    R(p) = (P* - Q*) p + 2 Q* Pi,                       (49), (38)

so the next arrow h comes from one reflection and one rank x rank solve; the constraints never enter
the nonlinear equations.
"""

from __future__ import annotations

import math

import casadi as ca

from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import (
    determinant,
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
_EARLY_NODES = 12


class StepInputs:
    """Symbols every program starts from: parameters, step size, constraint scales."""

    def __init__(self, expressions: SystemExpressions) -> None:
        self.theta = ca.SX.sym("theta", expressions.parameter_size)
        self.h = ca.SX.sym("h")
        self.scales = ca.SX.sym("scales", expressions.constraint_count)
        self.all = ca.vertcat(self.theta, self.h, self.scales)

    def conditioning(self, last: Node, node: Node) -> list[Guard]:
        """Independent rows at the node, not turned over since the last one; a definite metric.

        A guard divides only by pivots that an earlier guard has found good, and the first that
        fires is the one reported: a rank drop exactly at a node is told as such.
        """
        singular, indefinite = Outcome.CONSTRAINTS_SINGULAR, Outcome.METRIC_INDEFINITE
        guards = []
        definite = ca.SX(1)
        for i, pivot in enumerate(node.metric_pivots):
            missing = _SINGULAR_PIVOT * node.metric[i, i] - pivot
            definite = ca.logic_and(definite, missing < 0)
            guards.append(Guard(ca.if_else(missing < 0, 0, 2), indefinite))
        for i, pivot in enumerate(node.pivots):
            missing = _SINGULAR_PIVOT * node.gram[i, i] - pivot
            vanished = _VANISHING_ROW * self.scales[i] - node.gram[i, i]
            worse = (ca.fmax(missing, vanished) if i else vanished) / self.scales[i]
            # where the metric fails, C fails with it, and the metric is the one to name
            worse = ca.if_else(definite, worse, -1) if node.metric_pivots else worse
            guards.append(Guard(1 + worse, singular, decisive=True))
        if node.pivots and not ca.is_equal(ca.cse(last.mu), ca.cse(node.mu), 1):
            facing = determinant(ca.mtimes(last.mu, node.normal))
            scale = math.prod(ca.vertsplit(self.scales))
            guards.append(Guard(1 - facing / scale, singular))
        return guards


def next_arrow_function(
    expressions: SystemExpressions, discrete: DiscreteLagrangian
) -> ca.Function:
    """(x0, xi_g, h, theta, xi_next) -> (residual of (49), its Jacobian, q, p+, p-, first guess)."""
    inputs = StepInputs(expressions)
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

    With constraints the state also carries the normal components of the last two p+, the (-1)^k
    part of them (the parasitic mode of the two-step recursion) now and at its largest, the largest
    impulse, and how many nodes were seen.
    """
    e, inputs = expressions, StepInputs(expressions)
    m = e.constraint_count
    layout = StateLayout.of(
        {
            "base": e.base_size,
            "before": e.rank,
            "after": e.rank,
            **({"impulses": 2 * m, "parasitic": 5} if m else {}),
            **reconstructed_part(e, reconstruct),
        }
    )
    state = ca.SX.sym("state", layout.size)
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    flight = FreeFlight(e, discrete).from_momentum(x0, p0, inputs.h, inputs.theta, "xi")
    last, node = e.node(x0, inputs.theta), e.node(flight.target, inputs.theta)
    impulse = node.impulse(flight.momentum)
    monitor = _parasitic_monitor(node, impulse, flight, state, layout)
    arrow = e.retract(x0, flight.arrow) if reconstruct else ca.SX(0, 1)
    next_state = ca.vertcat(
        e.restore_base(flight.target),
        flight.momentum,
        node.reflect(flight.momentum),
        monitor,
        reconstruction(e, state, layout, arrow) if reconstruct else ca.SX(0, 1),
    )
    guards = [
        Guard(e.reach(x0, flight.arrow), Outcome.LEFT_DOMAIN),
        *inputs.conditioning(last, node),
    ]
    guess = e.velocity(x0, p0, inputs.theta)
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=flight.unknowns,
        carried=ca.SX(0, 1),
        later=ca.SX.sym("later"),
        update=flight.update,
        next_carried=ca.SX(0, 1),
        work=flight.work,
        energy=flight.energy,
        quadratic=True,
        next_state=next_state,
        arrow_velocities=flight.velocity,
        first_guess=guess[list(flight.implicit), 0],
        first_carried=ca.SX(0, 1),
        layout=layout,
        guards=tuple(guards),
        finite=e.delicate_potential(flight.target, inputs.theta),
    )


def _parasitic_monitor(
    node: Node, impulse: ca.SX, flight: Flight, state: ca.SX, layout: StateLayout
) -> ca.SX:
    """Next impulses, then amplitude, largest amplitude, largest jump (squared), nodes seen, and the
    largest amplitude of the first nodes.

    The normal part ``mu^T c_k`` of p+ is h/2 times a smooth force plus ``(-1)^k u``; the second
    difference of c_k over four is u up to O(h^3); it needs three nodes. Sizes are squares relative
    to the sum of ``|xi dl/dxi|``, which is ``|p|^2`` in G^-1 without a gyroscopic term, so no
    square root is taken in the loop.
    """
    m = impulse.numel()
    if m == 0:
        return ca.SX(0, 1)
    impulses, record = state[layout.slices["impulses"]], state[layout.slices["parasitic"]]
    last, before_last = impulses[:m], impulses[m:]
    ends = impulse + before_last
    scale = 1 / (16 * flight.energy + 1e-300)
    enough = record[3] >= 1.5
    amplitude = ca.if_else(enough, scale * _squared(node, ends - 2 * last), 0)
    jump = ca.if_else(enough, 4 * scale * _squared(node, ends + 2 * last), 0)
    largest, largest_jump = ca.fmax(record[1], amplitude), ca.fmax(record[2], jump)
    early = ca.if_else(record[3] < _EARLY_NODES, largest, record[4])
    return ca.vertcat(impulse, last, amplitude, largest, largest_jump, record[3] + 1, early)


def _squared(node: Node, components: ca.SX) -> ca.SX:
    """Squared length of ``mu^T components`` in G^-1."""
    return ca.dot(components, ca.mtimes(node.gram, components))


def reconstructed_part(e: SystemExpressions, reconstruct: bool) -> dict[str, int]:
    """The accumulated arrow as a part of the state, when it is asked for."""
    return {"reconstructed": e.space.arrow_size} if reconstruct else {}


def reconstruction(
    e: SystemExpressions, state: ca.SX, layout: StateLayout, arrow: ca.SX
) -> ca.SX:
    """The accumulated arrow after one more."""
    return e.continue_arrow(state[layout.slices["reconstructed"]], arrow)


def projected_program(
    expressions: SystemExpressions,
    first: DiscreteLagrangian,
    second: DiscreteLagrangian,
    reconstruct: bool,
) -> StepProgram:
    """One projected step: fly h/2, reflect, fly h/2, with a normal part lent and taken back.

    ``p0 + N0 nu -> first -> R -> second -> p``, then ``p1 = p - N1 W nu`` with nu such that p1 lies
    on the constraint set; p1 is computed as the orthogonal projection of p. N = mu^T L^-T is a
    G^-1-orthonormal basis of the normal space and W the isometry nearest to ``N1^T S N0``, S the
    mean of the two inverse metrics, which makes the choice of basis irrelevant. ``second`` must be
    the adjoint of ``first`` for the step to be self-adjoint.
    """
    e, inputs = expressions, StepInputs(expressions)
    parts = {"base": e.base_size, "after": e.rank, **reconstructed_part(e, reconstruct)}
    layout = StateLayout.of(parts, aliases={"before": "after"})
    state = ca.SX.sym("state", layout.size)
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    step = _ProjectedStep(e, inputs, x0, p0, FreeFlight(e, first), FreeFlight(e, second))
    next_state = step.next_state
    if reconstruct:
        arrow = e.continue_arrow(
            e.retract(x0, step.outward.arrow),
            e.retract(step.outward.target, step.homeward.arrow),
        )
        next_state = ca.vertcat(next_state, reconstruction(e, state, layout, arrow))
    guess = e.velocity(x0, p0, inputs.theta)
    flights = (step.outward, step.homeward)
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=ca.vertcat(*[flight.unknowns for flight in flights], step.nu),
        carried=step.search.carried,
        later=step.search.later,
        update=step.update,
        next_carried=step.search.next_carried,
        work=step.outward.work + step.homeward.work + step.search.work,
        energy=step.energy,
        quadratic=False,
        next_state=next_state,
        arrow_velocities=ca.vertcat(*[flight.velocity for flight in flights]),
        first_guess=ca.vertcat(
            *[guess[list(flight.implicit), 0] for flight in flights],
            ca.SX.zeros(step.nu.numel(), 1),
        ),
        first_carried=step.search.first_carried,
        layout=layout,
        guards=tuple(step.guards),
        finite=e.delicate_potential(step.homeward.target, inputs.theta),
    )


class _ProjectedStep:
    """Start, outward flight, middle, homeward flight and end of a projected step."""

    def __init__(
        self,
        e: SystemExpressions,
        inputs: StepInputs,
        x0: ca.SX,
        p0: ca.SX,
        first: FreeFlight,
        second: FreeFlight,
    ) -> None:
        m, half = e.constraint_count, inputs.h / 2
        self.nu = ca.SX.sym("nu", m)
        start = e.node(x0, inputs.theta)
        displaced = p0 + start.normal_vector(self.nu) if m else p0
        self.outward = first.from_momentum(x0, displaced, half, inputs.theta, "xi_a")
        middle = e.node(self.outward.target, inputs.theta)
        reflected = middle.reflect(self.outward.momentum)
        self.homeward = second.from_momentum(
            self.outward.target, reflected, half, inputs.theta, "xi_b"
        )
        end = e.node(self.homeward.target, inputs.theta)
        self.energy = self.outward.energy + self.homeward.energy
        isometry = _matching_isometry(start, end, e.metric_is_constant)
        returned = end.normal_component(self.homeward.momentum)
        self.search = _Broyden(m, ca.mtimes(isometry.T, returned) - self.nu, self.energy)
        # a new nu shifts both flights; following it here saves most of an iteration. Column by
        # column, so that only the last product waits for the update
        units = ca.horzsplit(ca.SX.eye(m))
        lent = ca.horzcat(ca.SX(e.rank, 0), *[start.normal_vector(unit) for unit in units])
        to_outward = self.outward.response(lent)
        to_homeward = self.homeward.response(middle.reflect_change(lent))
        self.update = ca.vertcat(
            self.outward.update + ca.mtimes(to_outward, self.search.update),
            self.homeward.update + ca.mtimes(to_homeward, self.search.update),
            self.search.update,
        )
        self.next_state = ca.vertcat(
            e.restore_base(self.homeward.target), end.project(self.homeward.momentum)
        )
        self.guards = [
            Guard(e.reach(x0, 2 * self.outward.arrow), Outcome.LEFT_DOMAIN),
            Guard(e.reach(self.outward.target, 2 * self.homeward.arrow), Outcome.LEFT_DOMAIN),
            *inputs.conditioning(start, middle),
            *inputs.conditioning(middle, end),
        ]


class _Broyden:
    """Broyden's iteration for ``closing(nu) = 0``, kept over the steps.

    The Jacobian is -2 up to O(h) and changes by O(h^2) from step to step, so its inverse is carried
    along. ``carried`` is (inverse, last nu step, last closing).
    """

    def __init__(self, m: int, closing: ca.SX, energy: ca.SX) -> None:
        self.later = ca.SX.sym("later")
        inverse = ca.SX.sym("inverse", m, m)
        moved, before = ca.SX.sym("moved", m), ca.SX.sym("before", m)
        self.carried = ca.vertcat(ca.vec(inverse), moved, before)
        self.first_carried = ca.vertcat(ca.vec(-ca.SX.eye(m) / 2), ca.SX.zeros(2 * m, 1))
        if m == 0:
            self.update, self.next_carried, self.work = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0)
            return
        better = self._updated(inverse, moved, closing - before, energy)
        self.update = ca.mtimes(better, closing)
        self.next_carried = ca.vertcat(ca.vec(better), -self.update, closing)
        self.work = ca.sum1(ca.fabs(closing * self.update))

    def _updated(self, inverse: ca.SX, moved: ca.SX, change: ca.SX, energy: ca.SX) -> ca.SX:
        """Broyden's formula for the inverse; left alone where the last step was round-off."""
        expected = ca.mtimes(inverse, change)
        denominator = ca.dot(moved, expected)
        tells = ca.logic_and(self.later, ca.dot(moved, moved) > 1e-20 * energy)
        tells = ca.logic_and(tells, denominator > 0)
        safe = ca.if_else(tells, denominator, 1)
        row = ca.mtimes(moved.T, inverse)
        correction = ca.mtimes(moved - expected, row) / safe
        return inverse + ca.if_else(tells, correction, ca.SX.zeros(*inverse.shape))


def _matching_isometry(start: Node, end: Node, same_metric: bool) -> ca.SX:
    """The orthogonal factor W of ``N1^T S N0`` with ``S = (G0^-1 + G1^-1) / 2``."""
    m = start.mu.size1()
    if m == 0:
        return ca.SX(0, 0)
    overlap = _overlap(start, end, same_metric)
    if m == 1:
        return ca.if_else(overlap >= 0, 1, -1)
    if m == 2:
        return _polar_of_two(overlap)
    polar = overlap
    for _ in range(6):
        # Newton's iteration for the polar factor; the overlap is within O(h^2) of an isometry
        polar = (polar + solve_linear(polar.T, ca.SX.eye(m))) / 2
    return polar


def _overlap(start: Node, end: Node, same_metric: bool) -> ca.SX:
    columns = []
    for unit in ca.horzsplit(ca.SX.eye(start.mu.size1())):
        column = solve_lower(end.lower, ca.mtimes(end.normal.T, start.normal_vector(unit)))
        if not same_metric:
            raised = ca.mtimes(start.normal, solve_upper(start.lower, unit))
            column = (column + solve_lower(end.lower, ca.mtimes(end.mu, raised))) / 2
        columns.append(column)
    return ca.horzcat(*columns)


def _polar_of_two(a: ca.SX) -> ca.SX:
    """Orthogonal polar factor of a 2 x 2 matrix: A + sign(det A) cof A, normalised."""
    sign = ca.if_else(a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0] >= 0, 1, -1)
    first, second = a[0, 0] + sign * a[1, 1], a[1, 0] - sign * a[0, 1]
    length = ca.sqrt(first * first + second * second)
    first, second = first / length, second / length
    return ca.vertcat(ca.horzcat(first, -sign * second), ca.horzcat(second, sign * first))
