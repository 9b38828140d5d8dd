"""A free flight that keeps the energy exactly, on any groupoid.

With ``zeta = h xi / 2`` the flight goes along two equal arrows through its middle point,

    x_m = target(retract(x0, zeta)),      x1 = target(retract(x_m, zeta)),

T_1 and T_2 transport momenta along them, ``q = p - A``, and

    p1 = T_2 (T_1 p0 - b),      xi = (G_0^-1 + G_1^-1)(q0 + q1) / 4,

b the discrete gradient of ``h (W - <A, xi>)``, ``W(x) = V(x) + (q0 G_x^-1 q0 + q1 G_x^-1 q1) / 4``,
along ``t -> target(retract(x_m, t))`` between -zeta and zeta, so that
``<b, xi> = Delta W - <Delta A, xi>`` to round-off. Backwards it passes the same middle point: the
flight is self-adjoint, of order 2. Since ``q1 G_1^-1 q1 / 2 - q0 G_0^-1 q0 / 2 = <q1 - q0, xi> +
Delta W - Delta V``, the energy is kept when the arrows leave xi alone, ``B+ xi = -B- xi``; in
frames that turn, b gets a part along ``G_m xi`` that makes the energy balance exact
(docs/theory.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from groupoid_gni.discretization.flight import Flight, FlightRule
from groupoid_gni.discretization.newton_update import NewtonUpdate
from groupoid_gni.discretization.system_expressions import SystemExpressions
from groupoid_gni.expressions import discrete_gradient, has_exact_differences

_TOLERANCE = 1e-11
_JUMP = 1e-14


@dataclass(frozen=True)
class EnergyPreservingFlight(Flight):
    """The flight and its Newton update."""

    solver: NewtonUpdate
    momentum_slope: ca.SX

    def response(self, dp: ca.SX) -> ca.SX:
        """Change of the unknowns when p0 changes by the columns of dp, to first order."""
        return self.solver.response(-ca.mtimes(self.momentum_slope, dp))


class EnergyPreservingStep(FlightRule):
    """Recipe of the flight; forces act at the middle point with the work ``h <f, xi>``."""

    def __init__(self, expressions: SystemExpressions) -> None:
        e = self._expressions = expressions
        # q1 enters W only through a metric that changes
        self._joint = not e.metric_is_constant
        self._height = self._recorded_height()
        self._jumps = not _is_smooth(e)
        self._balanced = self._jumps or not _arrows_leave_velocities_alone(e)
        height = self._height(*self._height.sx_in())
        self._free = not (self._balanced or e.system.has("force")) and height.is_zero()

    def _recorded_height(self) -> ca.Function:
        """(t, x_m, xi, q0, q1, theta) -> ``W - <A, xi>`` at ``target(retract(x_m, t))``."""
        e = self._expressions
        t, xi = ca.SX.sym("t", e.rank), ca.SX.sym("xi", e.rank)
        q0, q1 = ca.SX.sym("q0", e.rank), ca.SX.sym("q1", e.rank)
        middle, theta = ca.SX.sym("x", e.base_size), ca.SX.sym("theta", e.parameter_size)
        height = ca.SX(0)
        if e.base_size:
            x = e.target(middle, t)
            height = e.potential(x, theta)
            if e.system.has("gyroscopic"):
                height -= ca.dot(e.section("gyroscopic", x, theta), xi)
            if self._joint:
                height += (_raised(e, x, q0, theta) + _raised(e, x, q1, theta)) / 4
        return ca.Function("height", [t, middle, xi, q0, q1, theta], [ca.densify(height)])

    def from_momentum(
        self, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX, name: str
    ) -> EnergyPreservingFlight:
        """The flight from (x0, p0), one Newton update included."""
        e, r = self._expressions, self._expressions.rank
        unknown = ca.SX.sym(name, 2 * r if self._joint else r)
        start = ca.SX.sym("p0", r)
        equations = _Equations(self, x0, start, h, theta)
        solver = NewtonUpdate.of(equations.residual(unknown), unknown)
        slope = ca.jacobian(solver.residual, start)
        slope, residual, jacobian = ca.substitute(
            [slope, solver.residual, solver.jacobian], [start], [p0]
        )
        solver = NewtonUpdate(unknown, solver.implicit, residual, jacobian)
        equations = _Equations(self, x0, p0, h, theta)
        better = solver.better()
        x_m, x1, p1, impulse, work = equations.flown(better)
        xi, zeta = better[:r], h * better[:r] / 2
        pieces = ((x0, h * xi),) if self._free else ((x0, zeta), (x_m, zeta))
        return EnergyPreservingFlight(
            unknowns=solver.unknowns,
            guess=lambda x, p: self._first_values(x, p, theta)[list(solver.implicit), 0],
            update=solver.update,
            work=solver.work,
            # near rest the impulse of the forces is what round-off is relative to
            energy=e.kinetic_scale(xi, e.momentum(x0, xi, theta))
            + ca.dot(impulse, e.raised(x0, impulse, theta)),
            target=x1,
            momentum=p1,
            pieces=pieces,
            extent=pieces[:1],
            velocities=ca.vertcat(*[xi for _ in pieces]),
            force_work=work,
            solver=solver,
            momentum_slope=slope,
        )

    def _first_values(self, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
        xi = self._expressions.velocity(x, p, theta)
        return ca.vertcat(xi, p) if self._joint else xi


def _raised(e: SystemExpressions, x: ca.SX, q: ca.SX, theta: ca.SX) -> ca.SX:
    return ca.dot(q, e.raised(x, q, theta))


class _Equations:
    """The equations of the flight as expressions of xi, or of (xi, p1)."""

    def __init__(
        self, rule: EnergyPreservingStep, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX
    ) -> None:
        self._rule, self._e = rule, rule._expressions
        self._x0, self._p0, self._h, self._theta = x0, p0, h, theta

    def _charge(self, x: ca.SX) -> ca.SX:
        return self._e.section("gyroscopic", x, self._theta)

    def flown(self, values: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
        """Middle point, end, momentum there, impulse of all forces, work of the external one."""
        e, h, theta, rule = self._e, self._h, self._theta, self._rule
        xi = values[: e.rank]
        nothing = ca.SX(e.rank, 1)
        if rule._free:
            # nothing acts in the middle: one arrow does for two
            end = e.target(self._x0, h * xi)
            return self._x0, end, e.transport(self._x0, h * xi, self._p0), nothing, ca.SX(0)
        zeta = h * xi / 2
        x_m = e.target(self._x0, zeta)
        x1 = e.target(x_m, zeta)
        q0 = self._p0 - self._charge(self._x0)
        q1 = values[e.rank :] - self._charge(x1) if rule._joint else q0
        arguments = (x_m, xi, q0, q1, theta)
        b = h * discrete_gradient(rule._height, -zeta, zeta, *arguments)
        push, work = nothing, ca.SX(0)
        if e.system.has("force"):
            push = h * e.force(x_m, xi, theta)
            work = ca.dot(push, xi)
        arrived = e.transport(self._x0, zeta, self._p0)
        p1 = e.transport(x_m, zeta, arrived - b + push)
        if rule._balanced:
            risen = ca.dot(b, xi)
            if rule._jumps:
                before, after = (rule._height(t, *arguments) for t in (-zeta, zeta))
                risen += _jump(before, after, risen)
            along = e.transport(x_m, zeta, ca.mtimes(e.metric(x_m, theta), xi))
            missing = ca.dot(p1 - self._p0, xi) + risen - work
            p1 = p1 - along * (missing / (ca.dot(along, xi) + 1e-300))
        return x_m, x1, p1, push - b, work

    def residual(self, values: ca.SX) -> ca.SX:
        """``G_0 (xi - S (q0 + q1) / 2)``, and ``G_0^-1 (p1 - flown)`` where p1 is an unknown."""
        e, theta = self._e, self._theta
        xi = values[: e.rank]
        _, x1, p1, _, _ = self.flown(values)
        if not self._rule._joint:
            mean = (self._p0 - self._charge(self._x0) + p1 - self._charge(x1)) / 2
            return ca.mtimes(e.metric(self._x0, theta), xi) - mean
        unknown = values[e.rank :]
        mean = (self._p0 - self._charge(self._x0) + unknown - self._charge(x1)) / 2
        velocity = (e.raised(self._x0, mean, theta) + e.raised(x1, mean, theta)) / 2
        first = ca.mtimes(e.metric(self._x0, theta), xi - velocity)
        return ca.vertcat(first, e.raised(self._x0, unknown - p1, theta))


def _jump(before: ca.SX, after: ca.SX, risen: ca.SX) -> ca.SX:
    """What a change of branch adds to the difference; nothing where it is round-off."""
    jump = after - before - risen
    noise = _JUMP * (ca.fabs(before) + ca.fabs(after))
    return ca.if_else(ca.fabs(jump) > noise, jump, 0)


def _is_smooth(e: SystemExpressions) -> bool:
    """Whether the terms of the Lagrangian have no branches; those of retractions do not matter.

    A retraction branches on the size of its argument, which is the same at both ends.
    """
    names = ("metric", "potential", "gyroscopic")
    graphs = [e.system.recorded(name).function for name in names if e.system.has(name)]
    return all(has_exact_differences(graph) for graph in graphs)


def _arrows_leave_velocities_alone(e: SystemExpressions) -> bool:
    """Whether ``B+ xi = -B- xi`` along ``retract(x, xi)``, tried at random arrows."""
    space, rng = e.space, np.random.default_rng(20150225)
    x = np.asarray(space.example_base_point, dtype=float)
    for _ in range(4):
        xi = rng.uniform(-0.5, 0.5, space.rank)
        plus = np.asarray(space.trivialised_tangent_plus(x, xi), dtype=float)
        minus = np.asarray(space.trivialised_tangent_minus(x, xi), dtype=float)
        if not np.max(np.abs(plus @ xi + minus @ xi)) <= _TOLERANCE:
            return False
        x = np.asarray(space.target(space.retract(x, xi)), dtype=float)
    return True
