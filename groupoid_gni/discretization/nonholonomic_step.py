"""Equation (49) with the affine term, once for every groupoid.

A step is free flight and elastic impact. With ``g`` the last arrow and q its target,

    FL-(h) = R_q(FL+(g)),    R(p) = (P* - Q*) p + 2 Q* Pi,                       (49), (38)

so the next arrow h comes from one reflection and one rank x rank solve; the constraints never enter
the nonlinear equations.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import larger
from groupoid_gni.discretization.flight import Flight
from groupoid_gni.discretization.free_flight import FreeFlight
from groupoid_gni.discretization.step_inputs import StepInputs
from groupoid_gni.discretization.step_program import Guard, StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import Node, SystemExpressions
from groupoid_gni.outcomes import Outcome

EARLY_NODES = 12
"""Nodes whose parasitic amplitude counts as that of the start."""


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
            **accumulated_parts(e, reconstruct),
        }
    )
    state = ca.SX.sym("state", layout.size)
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    flight = FreeFlight(e, discrete).from_momentum(x0, p0, inputs.h, inputs.theta, "xi")
    last, node = e.node(x0, inputs.theta), e.node(flight.target, inputs.theta)
    impulse = node.impulse(flight.momentum)
    monitor = _parasitic_monitor(node, impulse, flight, state, layout)
    next_state = ca.vertcat(
        e.restore_base(flight.target),
        flight.momentum,
        node.reflect(flight.momentum),
        monitor,
        accumulated(e, state, layout, [flight]),
    )
    guards = [
        Guard(e.reach(x0, flight.arrow), Outcome.LEFT_DOMAIN),
        *inputs.conditioning(last, node),
    ]
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
        first_guess=flight.guess(x0, p0),
        first_carried=ca.SX(0, 1),
        layout=layout,
        guards=tuple(guards),
        finite=e.delicate_potential(flight.target, inputs.theta),
        given=inputs.given,
        control_size=e.controls.numel(),
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
    scale = ca.if_else(record[3] >= 1.5, 1 / (16 * flight.energy + 1e-300), 0)
    amplitude = scale * _squared(node, ends - 2 * last)
    jump = 4 * scale * _squared(node, ends + 2 * last)
    largest, largest_jump = larger(amplitude, record[1]), larger(jump, record[2])
    early = ca.if_else(record[3] < EARLY_NODES, largest, record[4])
    return ca.vertcat(impulse, last, amplitude, largest, largest_jump, record[3] + 1, early)


def _squared(node: Node, components: ca.SX) -> ca.SX:
    """Squared length of ``mu^T components`` in G^-1."""
    return ca.dot(components, ca.mtimes(node.gram, components))


def accumulated_parts(e: SystemExpressions, reconstruct: bool) -> dict[str, int]:
    """Parts of the state that add up along the motion: work of the force, arrow if asked for."""
    parts = {"work": 1} if e.system.has("force") else {}
    return {**parts, **({"reconstructed": e.space.arrow_size} if reconstruct else {})}


def accumulated(
    e: SystemExpressions, state: ca.SX, layout: StateLayout, flights: list[Flight]
) -> ca.SX:
    """Their values after the given flights."""
    parts = []
    if "work" in layout.slices:
        parts.append(state[layout.slices["work"]] + sum(flight.force_work for flight in flights))
    if "reconstructed" in layout.slices:
        pieces = [e.retract(x, eta) for flight in flights for x, eta in flight.pieces]
        arrow = pieces[0]
        for then in pieces[1:]:
            arrow = e.continue_arrow(arrow, then)
        parts.append(e.continue_arrow(state[layout.slices["reconstructed"]], arrow))
    return ca.vertcat(*parts) if parts else ca.SX(0, 1)
