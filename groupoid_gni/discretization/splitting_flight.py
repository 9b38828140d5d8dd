"""The explicit free flight: one-parameter subgroups and kicks.

With a constant metric ``G = L D L^T``, u_k the columns of L^-T and d_k = 1 / D_k,

    H = sum_k d_k <u_k, p>^2 / 2 + V(x).

``c = <u_k, p>`` is constant along the flow of the k-th term, which therefore moves with the
constant velocity ``xi = d_k c u_k``: ``x <- target(retract(x, h xi))``, and p is transported along
that arrow. Where the retraction is no exponential but stays in the one-parameter subgroup of u_k
(Cayley on SO(3)), it is the flow of another function of c: still Poisson, still reversible, without
sine and cosine. The homeward flight takes the terms in the opposite order, which makes it the
adjoint.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.discretization.elimination import unit_triangular_factor
from groupoid_gni.discretization.flight import Flight, FlightRule
from groupoid_gni.discretization.system_expressions import SystemExpressions
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import LieGroupoid

_TOLERANCE = 1e-10


@dataclass(frozen=True)
class SplittingFlight(Flight):
    """An explicit flight: no unknowns, several arrows of different sizes."""

    def response(self, dp: ca.SX) -> ca.SX:
        """Nothing: there are no unknowns."""
        return ca.SX(0, dp.size2())


class SplittingStep(FlightRule):
    """The product of the flows of all terms, kinetic ones first.

    Raises InputError where the metric depends on the base point, the Lagrangian has a gyroscopic
    term, the force depends on the velocity, or the retraction leaves a one-parameter subgroup.
    """

    def __init__(self, expressions: SystemExpressions) -> None:
        self._expressions = expressions
        self._homeward = False
        _check_system(expressions)
        theta = ca.SX.sym("theta", expressions.parameter_size)
        metric = expressions.metric(ca.SX.sym("x", expressions.base_size), theta)
        lower, pivots = unit_triangular_factor(metric)
        columns = ca.sparsify(ca.inv(lower).T)
        self._terms = ca.Function("terms", [theta], [columns, 1 / ca.vertcat(*pivots)])
        self._columns = [columns[:, k] for k in range(expressions.rank)]
        _check_retraction(expressions.space, self._columns)

    def homeward(self) -> SplittingStep:
        """The same flows in the opposite order, the adjoint."""
        other = copy(self)
        other._homeward = not self._homeward
        return other

    def from_momentum(
        self, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX, name: str
    ) -> SplittingFlight:
        """The flight from (x0, p0); ``name`` is not needed."""
        columns, inverse = self._terms(theta)
        state = _Moving(self._expressions, x0, p0, h, theta)
        order = range(self._expressions.rank)
        if self._homeward:
            state.kick()
        for k in reversed(order) if self._homeward else order:
            state.move(ca.sparsify(columns[:, k]), inverse[k])
        if not self._homeward:
            state.kick()
        return SplittingFlight(
            unknowns=ca.SX(0, 1),
            guess=lambda x, p: ca.SX(0, 1),
            update=ca.SX(0, 1),
            work=ca.SX(0),
            energy=state.energy,
            target=state.x,
            momentum=state.p,
            pieces=tuple(state.pieces),
            # the whole velocity stands for its pieces
            extent=((x0, h * self._expressions.velocity(x0, p0, theta)),),
            velocities=ca.SX(0, 1),
            force_work=state.force_work,
        )


class _Moving:
    """A point on its way through the terms."""

    def __init__(self, e: SystemExpressions, x: ca.SX, p: ca.SX, h: ca.SX, theta: ca.SX) -> None:
        self._e, self._h, self._theta = e, h, theta
        self.x, self.p = x, p
        self.pieces: list[tuple[ca.SX, ca.SX]] = []
        self.energy, self.force_work = ca.SX(0), ca.SX(0)

    def move(self, u: ca.SX, inverse_inertia: ca.SX) -> None:
        """The flow of ``d <u, p>^2 / 2``."""
        speed = inverse_inertia * ca.dot(u, self.p)
        self.energy += ca.fabs(speed * ca.dot(u, self.p))
        eta = self._h * speed * u
        self.pieces.append((self.x, eta))
        self.p = self._e.transport(self.x, eta, self.p)
        self.x = self._e.target(self.x, eta)

    def kick(self) -> None:
        """Potential and external force act for the time of the flight."""
        e = self._e
        if e.system.has("potential"):
            at_rest = ca.SX(e.rank, 1)
            slope = e.base_gradient(self.x, at_rest, self._theta)
            self.p = self.p + self._h * ca.mtimes(e.anchor(self.x).T, slope)
        if e.system.has("force"):
            push = self._h * e.force(self.x, ca.SX(e.rank, 1), self._theta)
            # the mean of the velocities before and after makes this the change of the energy
            middle = e.velocity(self.x, self.p + push / 2, self._theta)
            self.force_work += ca.dot(push, middle)
            self.p = self.p + push


def _check_system(e: SystemExpressions) -> None:
    use = "use flow=gni.Variational() or gni.EnergyPreserving()"
    if not e.metric_is_constant:
        raise InputError(
            f"Splitting() needs a metric that does not depend on the base point; {use}, or another "
            "frame in which the metric is constant"
        )
    if e.system.has("gyroscopic"):
        raise InputError(f"Splitting() cannot move with a gyroscopic term; {use}")
    if e.system.has("force"):
        x, xi = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank)
        if ca.depends_on(e.force(x, xi, ca.SX.sym("theta", e.parameter_size)), xi):
            raise InputError(
                f"Splitting() takes a force that does not depend on the velocity; {use}"
            )


def _check_retraction(space: LieGroupoid, columns: list[ca.SX]) -> None:
    """Steps along one u_k must compose to a step along u_k, and leave u_k alone.

    The columns depend on parameters; random numbers in their patterns stand for all values.
    """
    rng = np.random.default_rng(20150225)
    x = np.asarray(space.example_base_point, dtype=float)
    x = np.asarray(space.target(space.retract(x, rng.uniform(-0.3, 0.3, space.rank))), dtype=float)
    for k, column in enumerate(columns):
        u = np.zeros(space.rank)
        rows = column.sparsity().row()
        u[rows] = rng.uniform(0.4, 1.0, len(rows)) * rng.choice([-1.0, 1.0], len(rows))
        defect = _subgroup_defect(space, x, u)
        if not defect <= _TOLERANCE:
            raise InputError(
                f"Splitting() cannot follow the velocity direction {k}: two steps of the "
                f"retraction along it do not compose to one (defect {defect:.1e}), so it leaves "
                "the one-parameter subgroup. Usual mend: retraction=gni.Exponential() on the group"
            )


def _subgroup_defect(space: LieGroupoid, x: FloatArray, u: FloatArray) -> float:
    first, second = 0.31 * u, -0.17 * u
    g = np.asarray(space.retract(x, first), dtype=float)
    h = np.asarray(space.retract(np.asarray(space.target(g), dtype=float), second), dtype=float)
    along = np.asarray(space.lift(space.multiply(g, h)), dtype=float)
    across = along - u * (u @ along) / (u @ u)
    plus = np.asarray(space.trivialised_tangent_plus(x, first), dtype=float)
    minus = np.asarray(space.trivialised_tangent_minus(x, first), dtype=float)
    return float(max(np.max(np.abs(across)), np.max(np.abs(plus @ u + minus @ u))))
