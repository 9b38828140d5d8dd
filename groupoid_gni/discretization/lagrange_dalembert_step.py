"""The discrete Lagrange-d'Alembert method of [28] on any Lie groupoid, for comparison.

With g the last arrow, q its target, D_q the distribution and M_c the discrete constraint, the next
arrow h solves ``<FL-(h) - FL+(g), X> = 0`` for all X in D_q and lies in M_c:

    FL-(h) = FL+(g) + mu(q)^T impulse,     h in M_c,     alpha(h) = q.

Only the part of FL+(g) on D_q matters. Its lift to the constraint set, ``P* FL+(g) + Q* Pi``, is
the momentum at the node (the discrete nonholonomic Legendre transform of [28]), and one and the
same problem, "leave x with the momentum p", serves the start and every step.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.array_types import Array
from groupoid_gni.discretization.discrete_constraints import DiscreteConstraint
from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import solve_linear
from groupoid_gni.discretization.free_flight import FreeFlight
from groupoid_gni.discretization.nonholonomic_step import accumulated_parts
from groupoid_gni.discretization.step_inputs import StepInputs
from groupoid_gni.discretization.step_program import Guard, StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import Node, SystemExpressions
from groupoid_gni.expressions import RecordedFunction, record
from groupoid_gni.outcomes import Outcome


class ArrowConstraint:
    """The functions whose common zeros are M_c."""

    def __init__(self, expressions: SystemExpressions, constraint: DiscreteConstraint) -> None:
        self._expressions = expressions
        self._recorded = _recorded_constraint(expressions, constraint.rule)

    def __call__(self, x0: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """(m,) at the arrow ``retract(x0, h xi)``."""
        return self._recorded.call_sx(x0, self._expressions.target(x0, h * xi), xi, h, theta)


def _recorded_constraint(e: SystemExpressions, rule: DiscreteLagrangian) -> RecordedFunction:
    x, xi = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    value = ca.mtimes(e.constraints(x, theta), xi - e.section("drift", x, theta))
    sizes = {"source": (e.base_size,), "target": (e.base_size,), "velocity": (e.rank,)}
    others = {"step": (), "parameters": (e.parameter_size,)}
    violation = RecordedFunction(
        "violation",
        ca.Function("violation", [x, xi, theta], [ca.densify(value)]),
        (sizes["source"], sizes["velocity"], others["parameters"]),
        (e.constraint_count,),
    )

    def average(source: Array, target: Array, velocity: Array, step: Array, flat: Array) -> Array:
        def at(point: Array, xi: Array) -> Array:
            return violation(point, xi, flat)

        return rule.average(at, e.space, source, target, velocity, step)

    average.__wrapped__ = type(rule).average  # type: ignore[attr-defined]
    name = f"{type(rule).__name__}.average"
    return record(average, {**sizes, **others}, (e.constraint_count,), name=name)


class _Departure:
    """The arrow in M_c that leaves x with ``FL-(h) = p + mu^T impulse``, after a Newton update.

    The bordered system is eliminated: at fixed implicit velocities the flight answers to p, and so
    to the impulse, by an affine map, and the constraint then decides the impulse. Where M_c is
    affine in xi the impulse is no unknown at all.
    """

    def __init__(
        self,
        e: SystemExpressions,
        inputs: StepInputs,
        x: ca.SX,
        p: ca.SX,
        node: Node,
        free: FreeFlight,
        on_arrow: ArrowConstraint,
    ) -> None:
        h, theta = inputs.h, inputs.theta
        xi = ca.SX.sym("xi", e.rank)
        value = on_arrow(x, xi, h, theta)
        slope = ca.jacobian(value, xi)
        impulse = ca.SX.sym("impulse", e.constraint_count if ca.depends_on(slope, xi) else 0)
        flight = free.from_momentum(x, p, h, theta, "xi")
        response = flight.velocity_response(node.mu.T)
        begin = flight.velocity
        if impulse.numel():
            begin = begin + ca.mtimes(response, impulse)
        value, slope = ca.substitute([value, slope], [xi], [begin])
        change = -solve_linear(ca.mtimes(slope, response), value)
        self.velocity = begin + ca.mtimes(response, change)
        self.arrow = h * self.velocity
        self.residual = on_arrow(x, self.velocity, h, theta)
        total = impulse + change if impulse.numel() else change
        self.momentum = p + ca.mtimes(node.mu.T, total)
        implicit = list(flight.implicit)
        update = flight.unknowns - self.velocity[implicit, 0]
        block = flight.jacobian[implicit, implicit]
        self.work = ca.sum1(ca.fabs(ca.mtimes(block, update) * update))
        self.unknowns, self.update = ca.vertcat(flight.unknowns, impulse), update
        if impulse.numel():
            self.update = ca.vertcat(update, -change)
            self.work += ca.sum1(ca.fabs(value * change))
        self.energy = ca.sum1(ca.fabs(self.velocity * self.momentum))
        guess = e.velocity(x, p, theta)[implicit, 0]
        self.guess = ca.vertcat(guess, ca.SX.zeros(impulse.numel(), 1))


def lagrange_dalembert_program(
    expressions: SystemExpressions,
    discrete: DiscreteLagrangian,
    constraint: DiscreteConstraint,
    reconstruct: bool,
) -> StepProgram:
    """From arrow to arrow: arrive with ``p+ = FL+(g)``, find the arrow that leaves.

    The state holds the velocity of the arrow that leaves the node, so both momenta of the node and
    the impulse between them are known there. ``start`` makes that state from a base point and a
    momentum alone.
    """
    e, inputs = expressions, StepInputs(expressions)
    layout = _layout(e, reconstruct)
    state = ca.SX.sym("state", layout.size)
    x0, xi = state[layout.slices["base"]], state[layout.slices["leaving"]]
    free = FreeFlight(e, discrete)
    on_arrow = ArrowConstraint(e, constraint)
    x = e.restore_base(e.target(x0, inputs.h * xi))
    before = free.legendre_plus(x0, xi, inputs.h, inputs.theta)
    last, node = e.node(x0, inputs.theta), e.node(x, inputs.theta)
    p = node.project(before)
    departure = _Departure(e, inputs, x, p, node, free, on_arrow)
    pose = ca.SX(0, 1)
    if reconstruct:
        carried = state[layout.slices["reconstructed"]]
        pose = e.continue_arrow(carried, e.retract(x0, inputs.h * xi))
    arrived = (x, p, before, pose)
    guards = inputs.conditioning(last, node)
    start = _start(e, inputs, layout, free, on_arrow)
    return _program(e, inputs, layout, state, departure, arrived, guards, xi, start)


def _layout(e: SystemExpressions, reconstruct: bool) -> StateLayout:
    momenta = {"momentum": e.rank, "before": e.rank, "after": e.rank}
    leaving = {"leaving": e.rank, "on_arrow": e.constraint_count}
    return StateLayout.of(
        {"base": e.base_size, **momenta, **leaving, **accumulated_parts(e, reconstruct)}
    )


def _start(
    e: SystemExpressions,
    inputs: StepInputs,
    layout: StateLayout,
    free: FreeFlight,
    on_arrow: ArrowConstraint,
) -> StepProgram:
    """Find the first arrow; no arrow arrives, so the impulse of the start is that of the motion."""
    state = ca.SX.sym("state", layout.size)
    x, p = state[layout.slices["base"]], state[layout.slices["momentum"]]
    node = e.node(x, inputs.theta)
    departure = _Departure(e, inputs, x, p, node, free, on_arrow)
    pose = state[layout.positions("reconstructed"), 0]
    impulse = inputs.h * e.multipliers(x, p, inputs.theta)
    arrived = (x, p, departure.momentum - ca.mtimes(node.mu.T, impulse), pose)
    guards = inputs.conditioning(node, node)
    return _program(e, inputs, layout, state, departure, arrived, guards, ca.SX(e.rank, 1), None)


def _program(
    e: SystemExpressions,
    inputs: StepInputs,
    layout: StateLayout,
    state: ca.SX,
    departure: _Departure,
    arrived: tuple[ca.SX, ca.SX, ca.SX, ca.SX],
    guards: list[Guard],
    arrow_velocity: ca.SX,
    start: StepProgram | None,
) -> StepProgram:
    """The program whose step ends with a departure; ``arrived``: base, momentum, p+, pose."""
    x, p, before, pose = arrived
    reach = Guard(e.reach(x, departure.arrow), Outcome.LEFT_DOMAIN)
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=departure.unknowns,
        carried=ca.SX(0, 1),
        later=ca.SX.sym("later"),
        update=departure.update,
        next_carried=ca.SX(0, 1),
        work=departure.work,
        energy=departure.energy,
        quadratic=True,
        next_state=ca.vertcat(
            x, p, before, departure.momentum, departure.velocity, departure.residual, pose
        ),
        arrow_velocities=arrow_velocity,
        first_guess=departure.guess,
        first_carried=ca.SX(0, 1),
        layout=layout,
        guards=(reach, *guards),
        finite=e.delicate_potential(x, inputs.theta),
        start=start,
    )


def lagrange_dalembert_function(
    expressions: SystemExpressions, discrete: DiscreteLagrangian, constraint: DiscreteConstraint
) -> ca.Function:
    """The bordered system for one arrow as it stands, arguments and outputs as ``next_arrow``'s.

    (x0, xi_g, h, theta, (xi_next, impulse)) -> (residual, Jacobian, q, p+, p-, first guess).
    """
    e, inputs = expressions, StepInputs(expressions)
    x0, xi = ca.SX.sym("x0", e.base_size), ca.SX.sym("xi", e.rank)
    unknowns = ca.SX.sym("next", e.rank + e.constraint_count)
    following, impulse = unknowns[: e.rank], unknowns[e.rank :]
    free = FreeFlight(e, discrete)
    q = e.target(x0, inputs.h * xi)
    node = e.node(q, inputs.theta)
    before = free.legendre_plus(x0, xi, inputs.h, inputs.theta)
    after = before + ca.mtimes(node.mu.T, impulse)
    residual = ca.vertcat(
        free.legendre_minus(q, following, inputs.h, inputs.theta) - after,
        ArrowConstraint(e, constraint)(q, following, inputs.h, inputs.theta),
    )
    guess = ca.vertcat(
        e.velocity(q, node.project(before), inputs.theta), ca.SX.zeros(e.constraint_count, 1)
    )
    outputs = [residual, ca.jacobian(residual, unknowns), q, before, after, guess]
    arguments = [x0, xi, inputs.h, inputs.theta, unknowns]
    return ca.Function("next_arrow", arguments, [ca.densify(o) for o in outputs])
