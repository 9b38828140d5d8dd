"""The mechanics of a system at one base point, as CasADi expressions.

Everything comes from one Lagrangian ``L(x, xi) = 1/2 G_x(xi, xi) + <A_x, xi> - V(x)``: momentum,
energy, the projectors of section 2, the reflection of equation (49) and the reference equations.
All vectors are SX columns; matrices come in row-major (C) order from the recordings.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from groupoid_gni.discretization.elimination import (
    cholesky,
    solve_linear,
    solve_lower,
    solve_upper,
    symmetric_inverse,
)
from groupoid_gni.expressions import RecordedFunction, record
from groupoid_gni.systems import MechanicalSystem

_PARTIAL_OPERATIONS = {
    ca.OP_LOG,
    ca.OP_LOG1P,
    ca.OP_SQRT,
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_ASIN,
    ca.OP_ACOS,
    ca.OP_ACOSH,
    ca.OP_ATANH,
    ca.OP_DIV,
    ca.OP_INV,
    ca.OP_TAN,
}


def as_matrix(column: ca.SX, rows: int, columns: int) -> ca.SX:
    """A row-major flat column as a sparse matrix without its zeros."""
    return ca.sparsify(ca.reshape(column, columns, rows).T)


class Node:
    """Metric and constraints of a system at one base point x: what a reflection needs.

    metric : G, (r, r).  mu : (m, r).  normal : G^-1 mu^T, (r, m).
    gram : C = mu G^-1 mu^T.  lower : its Cholesky factor L.  pivots : the squares L_ii^2.
    metric_pivots : those of G, to be watched; empty for a constant metric.
    """

    def __init__(self, expressions: SystemExpressions, x: ca.SX, theta: ca.SX) -> None:
        self.metric = expressions.metric(x, theta)
        self.mu = expressions.constraints(x, theta)
        self.normal = expressions.raised(x, self.mu.T, theta)
        self.gram = ca.mtimes(self.mu, self.normal)
        self.lower, self.pivots = cholesky(self.gram)
        self.metric_pivots = [] if expressions.metric_is_constant else cholesky(self.metric)[1]
        self._drift = expressions.section("drift", x, theta)
        self._gyroscopic = expressions.section("gyroscopic", x, theta)

    def violation(self, p: ca.SX) -> ca.SX:
        """``mu (G^-1 (p - A) - Y) = mu G^-1 (p - Pi)``, zero on the constraint set (25)."""
        return ca.mtimes(self.normal.T, p - self._gyroscopic) - ca.mtimes(self.mu, self._drift)

    def impulse(self, p: ca.SX) -> ca.SX:
        """Components ``C^-1 mu G^-1 (p - Pi)`` of ``Q* (p - Pi) = mu^T C^-1 mu G^-1 (p - Pi)``."""
        return solve_linear(self.gram, self.violation(p))

    def along_rows(self, dp: ca.SX) -> ca.SX:
        """Components ``C^-1 mu G^-1 dp`` of ``Q* dp = mu^T C^-1 mu G^-1 dp``."""
        return solve_linear(self.gram, ca.mtimes(self.normal.T, dp))

    def reflect_change(self, dp: ca.SX) -> ca.SX:
        """The linear part ``(P* - Q*) dp`` of the reflection."""
        return dp - ca.mtimes(self.mu.T, 2 * self.along_rows(dp))

    def reflect(self, p: ca.SX) -> ca.SX:
        """``R(p) = (P* - Q*) p + 2 Q* Pi``: the impact of equations (49) and (38), sign mended."""
        return p - ca.mtimes(self.mu.T, 2 * self.impulse(p))

    def project(self, p: ca.SX) -> ca.SX:
        """``P* p + Q* Pi``, the orthogonal projection onto the constraint set."""
        return p - ca.mtimes(self.mu.T, self.impulse(p))

    def normal_component(self, p: ca.SX) -> ca.SX:
        """``L^-1 mu G^-1 (p - Pi)``: components in the G^-1-orthonormal basis N = mu^T L^-T."""
        return solve_lower(self.lower, self.violation(p))

    def normal_vector(self, components: ca.SX) -> ca.SX:
        """``N components = mu^T L^-T components``."""
        return ca.mtimes(self.mu.T, solve_upper(self.lower, components))


class SystemExpressions:
    """CasADi expressions of a system restricted to its active constraint rows.

    Recordings of the groupoid are made once per instance. ``theta`` below is the flat column of
    physical parameters.
    """

    def __init__(self, system: MechanicalSystem, active_rows: tuple[int, ...]) -> None:
        self.system = system
        self.space = system.space
        self.active_rows = active_rows
        self.rank = system.space.rank
        self.base_size = system.space.base_size
        self.constraint_count = len(active_rows)
        self.parameter_size = system.parameter_layout.size
        self.controls = ca.SX.sym("controls", system.control_size)

    def _of_space(self, name: str, inputs: dict[str, tuple[int, ...]], shape: tuple[int, ...],
                  ) -> RecordedFunction:
        return record(getattr(self.space, name), inputs, shape, name=name)

    @cached_property
    def _at_arrow(self) -> dict[str, tuple[int, ...]]:
        return {"x": (self.base_size,), "xi": (self.rank,)}

    @cached_property
    def _target(self) -> RecordedFunction:
        space = self.space
        return record(
            lambda x, xi: space.target(space.retract(x, xi)),
            self._at_arrow,
            (self.base_size,),
            name="target(retract(x, xi))",
        )

    @cached_property
    def _plus(self) -> RecordedFunction:
        shape = (self.rank, self.rank)
        return self._of_space("trivialised_tangent_plus", self._at_arrow, shape)

    @cached_property
    def _minus(self) -> RecordedFunction:
        shape = (self.rank, self.rank)
        return self._of_space("trivialised_tangent_minus", self._at_arrow, shape)

    @cached_property
    def _coadjoint(self) -> RecordedFunction:
        return self._of_space("coadjoint", self._at_arrow, (self.rank, self.rank))

    @cached_property
    def _anchor(self) -> RecordedFunction:
        shape = (self.base_size, self.rank)
        return self._of_space("anchor", {"x": (self.base_size,)}, shape)

    @cached_property
    def _ad_star(self) -> RecordedFunction:
        return self._of_space("ad_star", {**self._at_arrow, "p": (self.rank,)}, (self.rank,))

    @cached_property
    def _metric_inverse(self) -> ca.Function:
        """theta -> G^-1 of a constant metric, exactly symmetric."""
        theta = ca.SX.sym("theta", self.parameter_size)
        metric = self.metric(ca.SX.sym("x", self.base_size), theta)
        return ca.Function("inverse", [theta], [symmetric_inverse(metric)])

    @cached_property
    def _reach(self) -> RecordedFunction:
        return self._of_space("reach", self._at_arrow, ())

    @cached_property
    def _restore(self) -> RecordedFunction:
        shape = (self.base_size,)
        return self._of_space("restore_base", {"x": shape}, shape)

    @cached_property
    def _retract(self) -> RecordedFunction:
        return self._of_space("retract", self._at_arrow, (self.space.arrow_size,))

    @cached_property
    def _multiply(self) -> RecordedFunction:
        shape = (self.space.arrow_size,)
        return self._of_space("multiply", {"first": shape, "then": shape}, shape)

    @cached_property
    def _restore_arrow(self) -> RecordedFunction:
        shape = (self.space.arrow_size,)
        return self._of_space("restore_arrow", {"arrow": shape}, shape)

    def target(self, x: ca.SX, eta: ca.SX) -> ca.SX:
        """Target of the arrow ``retract(x, eta)``."""
        return self._target.call_sx(x, eta)

    def restore_base(self, x: ca.SX) -> ca.SX:
        """x moved back onto the base manifold by one Newton step (round-off only)."""
        return self._restore.call_sx(x) if self.base_size else x

    def retract(self, x: ca.SX, eta: ca.SX) -> ca.SX:
        """The arrow ``retract(x, eta)``, flat."""
        return self._retract.call_sx(x, eta)

    def multiply(self, first: ca.SX, then: ca.SX) -> ca.SX:
        """The product of two composable arrows."""
        return self._multiply.call_sx(first, then)

    def restore_arrow(self, arrow: ca.SX) -> ca.SX:
        """An arrow moved back onto the groupoid by one Newton step (round-off only)."""
        return self._restore_arrow.call_sx(arrow)

    def continue_arrow(self, arrow: ca.SX, then: ca.SX) -> ca.SX:
        """``W_{k+1} = W_k g_k`` (Remark 7.2), kept on the groupoid to round-off."""
        return self.restore_arrow(self.multiply(arrow, then))

    def tangent_plus(self, x: ca.SX, eta: ca.SX) -> ca.SX:
        """B+ at the arrow ``retract(x, eta)``, (r, r)."""
        return as_matrix(self._plus.call_sx(x, eta), self.rank, self.rank)

    def tangent_minus(self, x: ca.SX, eta: ca.SX) -> ca.SX:
        """B- at the arrow ``retract(x, eta)``, (r, r)."""
        return as_matrix(self._minus.call_sx(x, eta), self.rank, self.rank)

    def transport(self, x: ca.SX, eta: ca.SX, p: ca.SX) -> ca.SX:
        """``-B+^T B-^-T p``: a momentum carried along ``retract(x, eta)``; Ad* on a group."""
        flat = self._coadjoint.call_sx(x, eta)
        return ca.mtimes(as_matrix(flat, self.rank, self.rank), p)

    def anchor(self, x: ca.SX) -> ca.SX:
        """The anchor rho(x), (base_size, r)."""
        return as_matrix(self._anchor.call_sx(x), self.base_size, self.rank)

    def reach(self, x: ca.SX, eta: ca.SX) -> ca.SX:
        """Size of the arrow relative to the retraction's domain."""
        return self._reach.call_sx(x, eta)

    def metric(self, x: ca.SX, theta: ca.SX) -> ca.SX:
        """G_x, (r, r)."""
        flat = self.system.recorded("metric").call_sx(x, theta)
        return as_matrix(flat, self.rank, self.rank)

    def constraints(self, x: ca.SX, theta: ca.SX) -> ca.SX:
        """The active rows of mu(x), (m, r)."""
        if not self.active_rows:
            return ca.SX(0, self.rank)
        flat = self.system.recorded("constraints").call_sx(x, theta)
        full = as_matrix(flat, self.system.constraint_count, self.rank)
        return full[list(self.active_rows), :]

    def section(self, name: str, x: ca.SX, theta: ca.SX) -> ca.SX:
        """``drift`` Y or ``gyroscopic`` A, (r,); a structural zero when left out."""
        if not self.system.has(name):
            return ca.SX(self.rank, 1)
        return ca.sparsify(self.system.recorded(name).call_sx(x, theta))

    def potential(self, x: ca.SX, theta: ca.SX) -> ca.SX:
        """V(x)."""
        if not self.system.has("potential"):
            return ca.SX(0)
        return self.system.recorded("potential").call_sx(x, theta)

    def force(self, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
        """The external force f(x, xi) in A*_x G, (r,), at the control inputs ``controls``."""
        recorded = self.system.recorded("force")
        return ca.sparsify(recorded.call_sx(x, xi, theta, self.controls))

    def delicate_potential(self, x: ca.SX, theta: ca.SX) -> ca.SX:
        """V(x) where it may stop being a number while its gradient goes on; else nothing."""
        if not self.system.has("potential"):
            return ca.SX(0, 1)
        graph = self.system.recorded("potential").function
        codes = {graph.instruction_id(k) for k in range(graph.n_instructions())}
        return self.potential(x, theta) if codes & _PARTIAL_OPERATIONS else ca.SX(0, 1)

    def lagrangian(self, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
        """``1/2 xi^T G xi + A xi - V``: the only physics in the library."""
        metric = self.metric(x, theta)
        diagonal = ca.dot(ca.diag(metric), xi * xi) / 2
        # each symmetric pair once: derivatives then have one product per entry instead of two
        above = ca.triu(metric, False)
        kinetic = diagonal + ca.dot(xi, ca.mtimes(above, xi))
        linear = ca.dot(self.section("gyroscopic", x, theta), xi)
        return kinetic + linear - self.potential(x, theta)

    def base_gradient(self, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
        """dL/dx at fixed xi, (base_size,); ``theta`` must be symbols."""
        if not self.base_size:
            return ca.SX(0, 1)
        point, velocity = ca.SX.sym("x", self.base_size), ca.SX.sym("xi", self.rank)
        slope = ca.gradient(self.lagrangian(point, velocity, theta), point)
        return ca.Function("slope", [point, velocity, theta], [slope])(x, xi, theta)

    def momentum(self, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
        """``dL/dxi = G xi + A``."""
        return ca.mtimes(self.metric(x, theta), xi) + self.section("gyroscopic", x, theta)

    def kinetic_scale(self, xi: ca.SX, p: ca.SX, kinetic: bool = True) -> ca.SX:
        """``sum_i |xi_i p_i|``: what a step's round-off is relative to.

        kinetic : p is ``G xi + A`` and nothing else. Then no term is negative where the metric is
            diagonal, and no absolute value is taken.
        """
        if kinetic and self._pairs_are_positive:
            return ca.dot(xi, p)
        return ca.sum1(ca.fabs(xi * p))

    @cached_property
    def _pairs_are_positive(self) -> bool:
        x, theta = ca.SX.sym("x", self.base_size), ca.SX.sym("theta", self.parameter_size)
        metric = ca.sparsify(self.metric(x, theta))
        return metric.sparsity().is_diag() and not self.system.has("gyroscopic")

    def velocity(self, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
        """``G^-1 (p - A)``, the inverse Legendre transform."""
        return self.raised(x, p - self.section("gyroscopic", x, theta), theta)

    def raised(self, x: ca.SX, q: ca.SX, theta: ca.SX) -> ca.SX:
        """``G_x^-1 q`` for columns q.

        A constant metric is inverted once and for all, so that velocities and reflections use the
        same rounded G^-1: solved for twice, its two roundings made the energy of long runs drift by
        3e-16 a step.
        """
        if self.metric_is_constant:
            return ca.mtimes(self._metric_inverse(theta), q)
        return solve_linear(self.metric(x, theta), q)

    def energy(self, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
        """``<p, xi> - L`` at the velocity of p."""
        xi = self.velocity(x, p, theta)
        return ca.dot(p, xi) - self.lagrangian(x, xi, theta)

    @cached_property
    def metric_is_constant(self) -> bool:
        """Whether G does not depend on the base point."""
        x, theta = ca.SX.sym("x", self.base_size), ca.SX.sym("theta", self.parameter_size)
        return not ca.depends_on(self.metric(x, theta), x)

    def node(self, x: ca.SX, theta: ca.SX) -> Node:
        """Projectors and reflection at x."""
        return Node(self, x, theta)

    def unconstrained_field(self, x: ca.SX, p: ca.SX, theta: ca.SX) -> tuple[ca.SX, ca.SX]:
        """``x' = rho xi`` and ``p_a' = rho_a^i dL/dx^i + <p, [xi, e_a]>`` without constraints."""
        xi = self.velocity(x, p, theta)
        force = ca.SX(self.rank, 1)
        if self.base_size:
            force = ca.mtimes(self.anchor(x).T, self.base_gradient(x, xi, theta))
        force += self._ad_star.call_sx(x, xi, p)
        if self.system.has("force"):
            force += self.force(x, xi, theta)
        return ca.mtimes(self.anchor(x), xi) if self.base_size else ca.SX(0, 1), force

    def multipliers(self, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
        """lambda with ``p' = f0 + mu^T lambda`` (physical force), (m,), by differentiating (25).

        ``-C^-1 d/dt (mu (xi - Y))`` along the unconstrained field, the derivative written as
        ``mu' (xi - Y) - mu Y' + mu G^-1 (f0 - A' - G' xi)``, so that nothing solved is
        differentiated, and what is constant drops out. ``theta`` must be symbols, not values.
        """
        if not self.active_rows:
            return ca.SX(0, 1)
        point, still = ca.SX.sym("x", self.base_size), ca.SX.sym("still", self.rank)
        along_base, force = self.unconstrained_field(x, p, theta)
        xi, drift = self.velocity(x, p, theta), self.section("drift", x, theta)
        momentum = ca.mtimes(self.metric(point, theta), still)
        momentum += self.section("gyroscopic", point, theta)
        changing = [
            (ca.mtimes(self.constraints(point, theta), still), xi - drift),
            (self.section("drift", point, theta), xi),
            (momentum, xi),
        ]
        turning, drifting, carried = (
            self._rate(expression, point, still, (x, held, theta, along_base))
            for expression, held in changing
        )
        node = self.node(x, theta)
        change = turning - ca.mtimes(node.mu, drifting)
        return -solve_linear(node.gram, change + ca.mtimes(node.normal.T, force - carried))

    def _rate(
        self, expression: ca.SX, point: ca.SX, still: ca.SX, values: tuple[ca.SX, ...]
    ) -> ca.SX:
        """Derivative of an expression in ``point`` along x', ``still`` held.

        values : (x, what is held, theta, x').
        """
        if not self.base_size:
            return ca.SX(expression.size1(), 1)
        speed = ca.SX.sym("speed", self.base_size)
        derivative = ca.jtimes(expression, point, speed)
        inputs = [point, still, values[2], speed]
        return ca.sparsify(ca.Function("rate", inputs, [derivative])(*values))
