"""One stage of the GNI between impacts: the bare step K, and the projected step made of it.

``K_h = F_{h/2} R F*_{h/2}`` flies h/2, is reflected and flies h/2; F* is the adjoint of F, so K is
self-adjoint. It tends to the reflection and not to the identity. The projected step

    p0 + N0 nu -> K -> p1 + N1 W nu,      p1 on the constraint set,

lends a normal part before and takes it back after; it tends to the identity. N = mu^T L^-T is a
G^-1-orthonormal basis of the normal space and W the isometry nearest to ``N1^T S N0``, S the mean
of the two inverse metrics, which makes the choice of basis irrelevant.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.broyden import Broyden
from groupoid_gni.discretization.elimination import (
    between_factors,
    coupled_groups,
    larger,
    solve_linear,
)
from groupoid_gni.discretization.flight import Flight, FlightRule
from groupoid_gni.discretization.nonholonomic_step import (
    EARLY_NODES,
    accumulated,
    accumulated_parts,
)
from groupoid_gni.discretization.step_inputs import StepInputs
from groupoid_gni.discretization.step_program import Guard, StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import Node, SystemExpressions
from groupoid_gni.outcomes import Outcome

_COLUMNS = 3


def projected_program(
    expressions: SystemExpressions,
    outward: FlightRule,
    homeward: FlightRule,
    fractions: tuple[float, ...],
    reconstruct: bool,
) -> StepProgram:
    """A composition of projected steps.

    outward, homeward : the flights before and after the impact; the step is self-adjoint when each
        is the adjoint of the other.  fractions : sizes of the stages in units of the step.
    p1 is computed as the orthogonal projection of what arrives: the constraint holds to round-off
    whatever the iteration leaves.
    """
    e, inputs = expressions, StepInputs(expressions, composed=len(fractions) > 1)
    layout, state = node_layout(e, reconstruct, {})
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    step = _ProjectedStep(e, inputs, x0, p0, outward, homeward)
    flights = [step.outward, step.homeward]
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=ca.vertcat(*[flight.unknowns for flight in flights], step.search.unknown),
        carried=step.search.carried,
        later=step.search.later,
        update=step.update,
        next_carried=step.search.next_carried,
        work=step.outward.work + step.homeward.work + step.search.work,
        energy=step.energy,
        quadratic=False,
        next_state=ca.vertcat(step.next_state, accumulated(e, state, layout, flights)),
        arrow_velocities=stored_velocities(flights, fractions),
        first_guess=ca.vertcat(
            *[flight.guess(x0, p0) for flight in flights], ca.SX.zeros(e.constraint_count, 1)
        ),
        first_carried=step.search.first_carried,
        layout=layout,
        guards=tuple(step.guards),
        finite=e.delicate_potential(step.homeward.target, inputs.theta),
        fractions=fractions,
        given=inputs.given,
        control_size=e.controls.numel(),
        left=step.search.work,
    )


def bare_program(
    expressions: SystemExpressions,
    outward: FlightRule,
    homeward: FlightRule,
    fractions: tuple[float, ...],
    reconstruct: bool,
) -> StepProgram:
    """A composition of bare steps K: cheaper, and with the (-1)^k mode of the two-step recursion.

    The state carries the size of the normal part of p at the end of a step (the mode itself: zero
    on the constraint set) now and at its largest, the largest impulse of the constraint force, and
    how many nodes were seen, as the monitor of the two-step methods does. What only the end of a
    step needs, this and putting the base point back on its manifold, is done once a step.
    """
    e, inputs = expressions, StepInputs(expressions, composed=len(fractions) > 1)
    layout, state = node_layout(e, reconstruct, {"parasitic": 5} if e.constraint_count else {})
    x0, p0 = state[layout.slices["base"]], state[layout.slices["after"]]
    stage = _BareStep(e, inputs, x0, p0, outward, homeward)
    flights = [stage.outward, stage.homeward]
    after = ca.vertcat(
        stage.homeward.target,
        stage.homeward.momentum,
        state[layout.positions("parasitic"), 0],
        accumulated(e, state, layout, flights),
    )
    composed = len(fractions) > 1
    finish = _finished(e, inputs, layout, state)
    return StepProgram(
        parameters=inputs.all,
        state=state,
        unknowns=ca.vertcat(*[flight.unknowns for flight in flights]),
        carried=ca.SX(0, 1),
        later=ca.SX.sym("later"),
        update=ca.vertcat(*[flight.update for flight in flights]),
        next_carried=ca.SX(0, 1),
        work=stage.outward.work + stage.homeward.work,
        energy=stage.energy,
        # the second flight starts from the updated end of the first
        quadratic=True,
        next_state=after if composed else ca.substitute(finish, state, after),
        arrow_velocities=stored_velocities(flights, fractions),
        first_guess=ca.vertcat(*[flight.guess(x0, p0) for flight in flights]),
        first_carried=ca.SX(0, 1),
        layout=layout,
        guards=(*stage.guards, *inputs.conditioning(stage.middle, stage.middle)),
        finite=e.delicate_potential(stage.homeward.target, inputs.theta),
        fractions=fractions,
        given=inputs.given,
        control_size=e.controls.numel(),
        finish=finish if composed else None,
    )


def _finished(
    e: SystemExpressions, inputs: StepInputs, layout: StateLayout, state: ca.SX
) -> ca.SX:
    """The state at the end of a step: base point restored, normal part of p recorded."""
    theta = inputs.theta
    parts = {name: state[layout.slices[name]] for name in layout.slices if name != "before"}
    x, p = parts["base"], parts["after"]
    parts["base"] = e.restore_base(x)
    if "parasitic" in parts:
        _, largest, impulse, seen, early = ca.vertsplit(parts["parasitic"])
        node, xi = e.node(x, theta), e.velocity(x, p, theta)
        scale = 1 / (e.kinetic_scale(xi, ca.mtimes(e.metric(x, theta), xi)) + 1e-300)
        amplitude = scale * ca.sumsqr(node.normal_component(p))
        # the impulse of a stage would hold the mode itself
        force = inputs.whole * e.multipliers(x, p, theta)
        impulse = larger(scale * ca.dot(force, ca.mtimes(node.gram, force)), impulse)
        largest = larger(amplitude, largest)
        early = ca.if_else(seen < EARLY_NODES, largest, early)
        parts["parasitic"] = ca.vertcat(amplitude, largest, impulse, seen + 1, early)
    return ca.vertcat(*parts.values())


def node_layout(
    e: SystemExpressions, reconstruct: bool, more: dict[str, int]
) -> tuple[StateLayout, ca.SX]:
    """The state of a step from node to node: x, p, ``more`` (name -> size), accumulated arrows."""
    parts = {"base": e.base_size, "after": e.rank, **more, **accumulated_parts(e, reconstruct)}
    layout = StateLayout.of(parts, aliases={"before": "after"})
    return layout, ca.SX.sym("state", layout.size)


def stored_velocities(flights: list[Flight], fractions: tuple[float, ...]) -> ca.SX:
    """Velocities of the arrows of a step: of one stage only, to keep rows short."""
    if len(fractions) > 1:
        return ca.SX(0, 1)
    return ca.vertcat(*[flight.velocities for flight in flights])


def reach_guards(e: SystemExpressions, flights: list[Flight]) -> list[Guard]:
    """Every arrow of a flight within the domain of the retraction."""
    return [
        Guard(e.reach(x, 2 * eta), Outcome.LEFT_DOMAIN)
        for flight in flights
        for x, eta in flight.extent
    ]


class _BareStep:
    """Start, outward flight, impact, homeward flight: ``K_h``."""

    def __init__(
        self,
        e: SystemExpressions,
        inputs: StepInputs,
        x0: ca.SX,
        p0: ca.SX,
        outward: FlightRule,
        homeward: FlightRule,
    ) -> None:
        half, theta = inputs.h / 2, inputs.theta
        self.outward = outward.from_momentum(x0, p0, half, theta, "xi_a")
        self.middle = e.node(self.outward.target, theta)
        reflected = self.middle.reflect(self.outward.momentum)
        self.homeward = homeward.from_momentum(self.outward.target, reflected, half, theta, "xi_b")
        self.energy = self.outward.energy + self.homeward.energy
        self.guards = reach_guards(e, [self.outward, self.homeward])


class _ProjectedStep(_BareStep):
    """K with the normal part ``N0 nu`` lent and ``N1 W nu`` taken back."""

    def __init__(
        self,
        e: SystemExpressions,
        inputs: StepInputs,
        x0: ca.SX,
        p0: ca.SX,
        outward: FlightRule,
        homeward: FlightRule,
    ) -> None:
        m = e.constraint_count
        start = e.node(x0, inputs.theta)
        # nu is an even function of the stage size about the middle of the stage
        groups = coupled_groups(start.gram)
        self.search = Broyden(groups, inputs.fraction, slope=-2.0, power=2)
        nu = self.search.value
        displaced = p0 + start.normal_vector(nu) if m else p0
        super().__init__(e, inputs, x0, displaced, outward, homeward)
        end = e.node(self.homeward.target, inputs.theta)
        isometry = _matching_isometry(start, end, e.metric_is_constant, groups)
        returned = end.normal_component(self.homeward.momentum)
        self.search.close(ca.mtimes(isometry.T, returned) - nu, self.energy)
        to_outward, to_homeward = self._followed(start, nu)
        self.update = ca.vertcat(
            self.outward.update + to_outward,
            self.homeward.update + to_homeward,
            self.search.update,
        )
        self.next_state = ca.vertcat(
            e.restore_base(self.homeward.target), end.project(self.homeward.momentum)
        )
        self.guards += inputs.conditioning(start, self.middle)
        self.guards += [*inputs.conditioning(self.middle, end), *self.search.guards]

    def _followed(self, start: Node, nu: ca.SX) -> tuple[ca.SX, ca.SX]:
        """How the unknowns of both flights follow the change of nu, to first order.

        A new nu shifts both flights; following it here saves most of an iteration. Few components
        go column by column, so that only the last product waits for the change.
        """
        m = nu.numel()
        if m > _COLUMNS:
            lent = start.normal_vector(self.search.change)
            hit = self.middle.reflect_change(lent)
            return self.outward.response(lent), self.homeward.response(hit)
        columns = [start.normal_vector(unit) for unit in ca.horzsplit(ca.SX.eye(m))]
        lent = ca.horzcat(ca.SX(start.metric.size1(), 0), *columns)
        hit = self.middle.reflect_change(lent)
        change = self.search.change
        return (
            ca.mtimes(self.outward.response(lent), change),
            ca.mtimes(self.homeward.response(hit), change),
        )


def _matching_isometry(
    start: Node, end: Node, same_metric: bool, groups: list[list[int]]
) -> ca.SX:
    """The orthogonal factor W of ``N1^T S N0`` with ``S = (G0^-1 + G1^-1) / 2``.

    groups : rows coupled by C; N is block diagonal in them, and so is W.
    """
    m = start.mu.size1()
    isometry = ca.SX(m, m)
    crossed = ca.mtimes(end.normal.T, start.mu.T)
    if not same_metric:
        crossed = (crossed + ca.mtimes(end.mu, start.normal)) / 2
    for group in groups:
        first, last = start.lower[group, group], end.lower[group, group]
        overlap = between_factors(last, crossed[group, group], first)
        isometry[group, group] = _polar_factor(overlap)
    return ca.sparsify(isometry)


def _polar_factor(overlap: ca.SX) -> ca.SX:
    """Orthogonal polar factor of a matrix within O(h^2) of an isometry."""
    m = overlap.size1()
    if m == 1:
        return ca.if_else(overlap >= 0, 1, -1)
    if m == 2:
        return _polar_of_two(overlap)
    polar = overlap
    for _ in range(6):
        # Newton's iteration for the polar factor
        polar = (polar + solve_linear(polar.T, ca.SX.eye(m))) / 2
    return polar


def _polar_of_two(a: ca.SX) -> ca.SX:
    """Orthogonal polar factor of a 2 x 2 matrix: A + sign(det A) cof A, normalised."""
    sign = ca.if_else(a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0] >= 0, 1, -1)
    first, second = a[0, 0] + sign * a[1, 1], a[1, 0] - sign * a[0, 1]
    length = ca.sqrt(first * first + second * second)
    first, second = first / length, second / length
    return ca.vertcat(ca.horzcat(first, -sign * second), ca.horzcat(second, sign * first))
