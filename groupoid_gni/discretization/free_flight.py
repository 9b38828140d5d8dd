"""One free (unconstrained) step: the discrete Legendre transforms (48) and their inversion.

For the arrow ``g = retract(x0, h xi)`` with target x1 and ``L_d = h l(x0, x1, xi)``,

    FL-(g) = -(h rho(x0)^T dl/dx0 + B-^T dl/dxi),     FL+(g) = h rho(x1)^T dl/dx1 + B+^T dl/dxi,

because moving the source of an arrow leaves its target alone and the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import (
    coupled_groups,
    solve_linear,
    symmetric_inverse,
)
from groupoid_gni.discretization.flight import Flight, FlightRule
from groupoid_gni.discretization.system_expressions import SystemExpressions
from groupoid_gni.errors import InputError
from groupoid_gni.expressions import RecordedFunction, record


@dataclass(frozen=True)
class VariationalFlight(Flight):
    """The flight of a discrete Lagrangian: one arrow ``retract(x0, h xi)``.

    implicit : indices of the unknown velocity components.  jacobian : (r, r), of all equations; the
        components that need a solver are not coupled with the others.
    velocity : xi, explicit components solved for and implicit ones after the Newton update.
    arrow : ``h xi``.
    """

    implicit: tuple[int, ...]
    jacobian: ca.SX
    velocity: ca.SX
    arrow: ca.SX

    def response(self, dp: ca.SX) -> ca.SX:
        """Change of the unknowns when p0 changes by the columns of dp, to first order."""
        rows = list(self.implicit)
        return solve_linear(self.jacobian[rows, rows], dp[rows, :])

    def velocity_response(self, dp: ca.SX) -> ca.SX:
        """Change of ``velocity`` when p0 changes by the columns of dp; exact at fixed unknowns."""
        return solve_linear(self.jacobian, dp)


class FreeFlight(FlightRule):
    """The free step of a discrete Lagrangian, forced by the discrete Lagrange-d'Alembert rule.

    The virtual work of an external force f over a step is ``h w0 <f(x0, xi), .>`` at the source and
    ``h w1 <f(x1, xi), .>`` at the target, (w0, w1) the ``force_weights`` of the discrete
    Lagrangian; so the forced Legendre transforms are ``FL- - h w0 f(x0, xi)`` and
    ``FL+ + h w1 f(x1, xi)``.
    """

    def __init__(self, expressions: SystemExpressions, discrete: DiscreteLagrangian) -> None:
        self._expressions = expressions
        self._name = str(discrete)
        self._weights = discrete.force_weights
        self._gradients = _gradients_of_average(expressions, discrete)

    def _averages_kinetic_momenta(self) -> bool:
        """Whether dl/dxi is the constant G times xi: no Lagrangian at a point that xi moves."""
        e = self._expressions
        if not e.metric_is_constant:
            return False
        sizes = (e.base_size, e.base_size, e.rank, 1, e.parameter_size)
        given = [ca.SX.sym("given", size) for size in sizes]
        x0, x1, _, h, _ = given
        slope = self._gradients(*given)[2]
        return not ca.depends_on(slope, ca.vertcat(x0, x1, h))

    def legendre_minus(self, x0: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """``FL-(g)`` in A* at the source."""
        e = self._expressions
        by_source, _, by_velocity = self._gradients(x0, e.target(x0, h * xi), xi, h, theta)
        moved = ca.mtimes(e.tangent_minus(x0, h * xi).T, by_velocity)
        if e.base_size:
            moved += h * ca.mtimes(e.anchor(x0).T, by_source)
        return -(moved + self._push(0, x0, xi, h, theta))

    def legendre_plus(self, x0: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """``FL+(g)`` in A* at the target."""
        e = self._expressions
        x1 = e.target(x0, h * xi)
        _, by_target, by_velocity = self._gradients(x0, x1, xi, h, theta)
        moved = ca.mtimes(e.tangent_plus(x0, h * xi).T, by_velocity)
        if e.base_size:
            moved = h * ca.mtimes(e.anchor(x1).T, by_target) + moved
        return moved + self._push(1, x1, xi, h, theta)

    def _push(self, end: int, x: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """Impulse of the external force at the source (0) or the target (1)."""
        weight = self._weights[end]
        if not (weight and self._expressions.system.has("force")):
            return ca.SX(self._expressions.rank, 1)
        return weight * h * self._expressions.force(x, xi, theta)

    def from_momentum(
        self, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX, name: str
    ) -> VariationalFlight:
        """The flight with ``FL-(g) = p0``, one Newton update included.

        Groups of components whose equations are affine with a Jacobian free of xi are solved here,
        once and for all; the others become symbols called ``name``.
        """
        e = self._expressions
        xi = ca.SX.sym(name, e.rank)
        residual = self.legendre_minus(x0, xi, h, theta) - p0
        jacobian = ca.sparsify(ca.jacobian(residual, xi))
        if ca.sprank(jacobian) < e.rank:
            raise InputError(
                f"{self._name} is singular: its momentum does not determine the velocity. The "
                "average must depend on the velocity in every direction, as L does"
            )
        implicit, explicit = _implicit_and_explicit(jacobian, xi)
        velocity = ca.SX(xi)
        if explicit:
            unknown = xi[explicit, 0]
            at_rest = ca.substitute(residual[explicit, 0], unknown, ca.SX.zeros(len(explicit), 1))
            velocity[explicit, 0] = -_solved(jacobian[explicit, explicit], at_rest, theta)
        block = jacobian[implicit, implicit]
        update = solve_linear(block, residual[implicit, 0])
        velocity[implicit, 0] = xi[implicit, 0] - update
        arrow = h * velocity
        target = e.target(x0, arrow)
        by_velocity = self._gradients(x0, target, velocity, h, theta)[2]
        pushed = sum(
            (self._push(end, x, velocity, h, theta) for end, x in enumerate((x0, target))),
            ca.SX(e.rank, 1),
        )
        return VariationalFlight(
            unknowns=xi[implicit, 0],
            guess=lambda x, p: e.velocity(x, p, theta)[implicit, 0],
            implicit=tuple(implicit),
            jacobian=jacobian,
            update=update,
            work=ca.sum1(ca.fabs(residual[implicit, 0] * update)),
            velocity=velocity,
            arrow=arrow,
            target=target,
            momentum=self.legendre_plus(x0, velocity, h, theta),
            energy=e.kinetic_scale(velocity, by_velocity, self._averages_kinetic_momenta()),
            pieces=((x0, arrow),),
            extent=((x0, arrow),),
            velocities=velocity,
            force_work=ca.dot(pushed, velocity),
        )



def _implicit_and_explicit(jacobian: ca.SX, xi: ca.SX) -> tuple[list[int], list[int]]:
    """Components that need a solver, and those whose equations are affine and apart from them."""
    rows, _ = jacobian.sparsity().get_triplet()
    moving = ca.which_depends(jacobian.nz[:], xi, 1, True)
    turned = {row for row, depends in zip(rows, moving, strict=True) if depends}
    implicit: list[int] = []
    for group in coupled_groups(jacobian):
        if turned.intersection(group):
            implicit.extend(group)
    explicit = sorted(set(range(xi.numel())) - set(implicit))
    return sorted(implicit), explicit


def _solved(block: ca.SX, right_hand_side: ca.SX, theta: ca.SX) -> ca.SX:
    """Solve for explicit components; by the inverse, as ``raised`` does, where it is constant."""
    constants = {symbol.element_hash() for symbol in ca.symvar(theta)}
    if all(symbol.element_hash() in constants for symbol in ca.symvar(block)):
        return ca.mtimes(symmetric_inverse(block), right_hand_side)
    return solve_linear(block, right_hand_side)


def _gradients_of_average(
    expressions: SystemExpressions, discrete: DiscreteLagrangian
) -> ca.Function:
    """(x0, x1, xi, h, theta) -> the three gradients of the averaged Lagrangian l = L_d / h.

    The average is recorded with the values of L as inputs of their own, so that the chain rule can
    use ``dL/dxi = G xi + A`` directly and add up the weights of equal evaluations.
    """
    e = expressions
    sizes = {"source": e.base_size, "target": e.base_size, "velocity": e.rank}
    variables = [ca.SX.sym(name, size) for name, size in sizes.items()]
    h, theta = ca.SX.sym("h"), ca.SX.sym("theta", e.parameter_size)
    recorded, count = _recorded_average(e, discrete)
    values = ca.SX.sym("values", count)
    outputs = recorded.call_sx(*variables, h, theta, values)
    average = outputs[0]
    weights = ca.gradient(average, values)
    points = ca.reshape(outputs[1:], e.base_size + e.rank, count)
    places = [points[: e.base_size, k] for k in range(count)]
    velocities = [points[e.base_size :, k] for k in range(count)]
    forces = [e.base_gradient(x, xi, theta) for x, xi in zip(places, velocities, strict=True)]
    momenta = [e.momentum(x, xi, theta) for x, xi in zip(places, velocities, strict=True)]
    gradients = [ca.gradient(average, variable) for variable in variables]
    terms = [*_merged(weights, places, forces), *_merged(weights, velocities, momenta)]
    for weight, argument, slope in terms:
        for i, variable in enumerate(variables):
            gradients[i] += weight * ca.jtimes(argument, variable, slope, True)
    return ca.Function("gradients", [*variables, h, theta], gradients)


def _recorded_average(
    e: SystemExpressions, discrete: DiscreteLagrangian
) -> tuple[RecordedFunction, int]:
    """Record (average, points where L was asked for) with the values of L as the last input."""
    sizes = {
        "source": (e.base_size,),
        "target": (e.base_size,),
        "velocity": (e.rank,),
        "step": (),
        "parameters": (e.parameter_size,),
    }
    lagrangian = _recorded_lagrangian(e)
    asked = 0

    def counted(source: Array, target: Array, velocity: Array, step: Array, flat: Array) -> Array:
        def value(x: Array, xi: Array) -> Array:
            nonlocal asked
            asked += 1
            return lagrangian(x, xi, flat)

        return discrete.average(value, e.space, source, target, velocity, step)

    def with_values(
        source: Array, target: Array, velocity: Array, step: Array, flat: Array, values: Array
    ) -> Array:
        points: list[Array] = []

        def value(x: Array, xi: Array) -> Array:
            points.extend((x, xi))
            return values[len(points) // 2 - 1]

        average = discrete.average(value, e.space, source, target, velocity, step)
        return np.concatenate([np.reshape(average, 1), *points])

    counted.__wrapped__ = type(discrete).average  # type: ignore[attr-defined]
    with_values.__wrapped__ = type(discrete).average  # type: ignore[attr-defined]
    name = f"{type(discrete).__name__}.average"
    # the shape of the real recording needs the number of evaluations; and with the true L the
    # average is checked as a function of numbers a user can follow
    record(counted, sizes, (), name=name)
    shape = (1 + asked * (e.base_size + e.rank),)
    return record(with_values, {**sizes, "values": (asked,)}, shape, name=name), asked


def _merged(
    weights: ca.SX, arguments: list[ca.SX], slopes: list[ca.SX]
) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
    """Triples (weight, argument, slope); equal ones once, with the sum of their weights."""
    if not arguments:
        return []
    size = arguments[0].numel()
    pairs = zip(arguments, slopes, strict=True)
    shared = ca.cse(ca.horzcat(*[ca.vertcat(*pair) for pair in pairs]))
    terms: list[tuple[ca.SX, ca.SX]] = []
    for k in range(len(arguments)):
        for i, (weight, column) in enumerate(terms):
            if ca.is_equal(column, shared[:, k], 0):
                terms[i] = (weight + weights[k], column)
                break
        else:
            terms.append((weights[k], shared[:, k]))
    return [(weight, column[:size], column[size:]) for weight, column in terms]


def _recorded_lagrangian(expressions: SystemExpressions) -> RecordedFunction:
    """L as a recorded function that can be called on recorded arrays."""
    x, xi = ca.SX.sym("x", expressions.base_size), ca.SX.sym("xi", expressions.rank)
    theta = ca.SX.sym("theta", expressions.parameter_size)
    function = ca.Function("lagrangian", [x, xi, theta], [expressions.lagrangian(x, xi, theta)])
    shapes = ((expressions.base_size,), (expressions.rank,), (expressions.parameter_size,))
    return RecordedFunction("lagrangian", function, shapes, ())
