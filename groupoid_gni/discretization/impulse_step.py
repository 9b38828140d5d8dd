"""The method of McLachlan and Perlmutter (2006) on any groupoid.

Fly half the stage, take an impulse ``mu^T lambda`` of the constraint, fly the other half; lambda is
such that the constraint holds at the end. On R^n with a constant mass and the default flights that
is their equation (4.18): drift, kick with the constraint force of the middle, drift. Self-adjoint,
so that compositions raise its order.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.broyden import Broyden
from groupoid_gni.discretization.elimination import coupled_groups
from groupoid_gni.discretization.flight import FlightRule
from groupoid_gni.discretization.nonholonomic_step import accumulated
from groupoid_gni.discretization.projected_step import (
    node_layout,
    reach_guards,
    stored_velocities,
)
from groupoid_gni.discretization.step_inputs import StepInputs
from groupoid_gni.discretization.step_program import StepProgram
from groupoid_gni.discretization.system_expressions import SystemExpressions


def impulse_program(
    expressions: SystemExpressions,
    outward: FlightRule,
    homeward: FlightRule,
    fractions: tuple[float, ...],
    reconstruct: bool,
) -> StepProgram:
    """A composition of such stages; see ``projected_program`` for the arguments."""
    e, inputs = expressions, StepInputs(expressions, composed=len(fractions) > 1)
    layout, state = node_layout(e, reconstruct, {})
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    half, theta, m = inputs.h / 2, inputs.theta, e.constraint_count
    # an impulse is an odd function of the stage size
    start = e.node(x0, theta)
    search = Broyden(coupled_groups(start.gram), inputs.fraction, slope=1.0, power=1)
    first = outward.from_momentum(x0, p0, half, theta, "xi_a")
    middle = e.node(first.target, theta)
    pushed = first.momentum + ca.mtimes(middle.mu.T, search.value)
    second = homeward.from_momentum(first.target, pushed, half, theta, "xi_b")
    end = e.node(second.target, theta)
    energy = first.energy + second.energy
    impulse = end.impulse(second.momentum)
    search.close(impulse, energy, scale=end.gram)
    follow = ca.mtimes(second.response(middle.mu.T), search.change)
    flights = [first, second]
    guards = [
        *reach_guards(e, flights),
        *inputs.conditioning(start, middle),
        *inputs.conditioning(middle, end),
    ]
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=ca.vertcat(first.unknowns, second.unknowns, search.unknown),
        carried=search.carried,
        later=search.later,
        update=ca.vertcat(first.update, second.update + follow, search.update),
        next_carried=search.next_carried,
        work=first.work + second.work + search.work,
        energy=energy,
        quadratic=m == 0,
        next_state=ca.vertcat(
            e.restore_base(second.target),
            end.project(second.momentum),
            accumulated(e, state, layout, flights),
        ),
        arrow_velocities=stored_velocities(flights, fractions),
        first_guess=ca.vertcat(*[f.guess(x0, p0) for f in flights], ca.SX.zeros(m, 1)),
        first_carried=search.first_carried,
        layout=layout,
        guards=tuple(guards + search.guards),
        finite=e.delicate_potential(second.target, theta),
        fractions=fractions,
        given=inputs.given,
        control_size=e.controls.numel(),
        left=search.work,
    )
