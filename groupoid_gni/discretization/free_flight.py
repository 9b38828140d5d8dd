"""One free (unconstrained) step: the discrete Legendre transforms (48) and their inversion.

For the arrow ``g = retract(x0, h xi)`` with target x1 and ``L_d = h l(x0, x1, xi)``,

    FL-(g) = -(h rho(x0)^T dl/dx0 + B-^T dl/dxi),     FL+(g) = h rho(x1)^T dl/dx1 + B+^T dl/dxi,

because moving the source of an arrow leaves its target alone and the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from groupoid_gni.array_types import Array
from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian
from groupoid_gni.discretization.elimination import solve_linear
from groupoid_gni.discretization.system_expressions import SystemExpressions
from groupoid_gni.expressions import RecordedFunction, record


@dataclass(frozen=True)
class Flight:
    """The expressions of one flight from (x0, p0) over the time h.

    unknowns : the velocity components that need a solver, as symbols; may be empty.
    implicit : their indices.  update : their Newton update (current minus better value).
    work : sum of |residual * update|, the squared error of the current values as an energy.
    velocity : xi, explicit components solved for and implicit ones after the Newton update.
    arrow : ``h xi``.  target, momentum : x1 and ``FL+(g)`` at that velocity.
    energy : sum of |xi * dl/dxi|, the scale of ``work``.
    """

    unknowns: ca.SX
    implicit: tuple[int, ...]
    update: ca.SX
    work: ca.SX
    velocity: ca.SX
    arrow: ca.SX
    target: ca.SX
    momentum: ca.SX
    energy: ca.SX


class FreeFlight:
    """The free step of a discrete Lagrangian, ready to be placed anywhere in a step."""

    def __init__(self, expressions: SystemExpressions, discrete: DiscreteLagrangian) -> None:
        self._expressions = expressions
        self._gradients = _gradients_of_average(expressions, discrete)

    def legendre_minus(self, x0: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """``FL-(g)`` in A* at the source."""
        e = self._expressions
        by_source, _, by_velocity = self._gradients(x0, e.target(x0, h * xi), xi, h, theta)
        moved = ca.mtimes(e.tangent_minus(x0, h * xi).T, by_velocity)
        return -(h * ca.mtimes(e.anchor(x0).T, by_source) + moved) if e.base_size else -moved

    def legendre_plus(self, x0: ca.SX, xi: ca.SX, h: ca.SX, theta: ca.SX) -> ca.SX:
        """``FL+(g)`` in A* at the target."""
        e = self._expressions
        x1 = e.target(x0, h * xi)
        _, by_target, by_velocity = self._gradients(x0, x1, xi, h, theta)
        moved = ca.mtimes(e.tangent_plus(x0, h * xi).T, by_velocity)
        return h * ca.mtimes(e.anchor(x1).T, by_target) + moved if e.base_size else moved

    def from_momentum(self, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX, name: str) -> Flight:
        """The flight with ``FL-(g) = p0``, one Newton update included.

        Groups of components whose equations are affine with a Jacobian free of xi are solved here,
        once and for all; the others become symbols called ``name``.
        """
        e = self._expressions
        xi = ca.SX.sym(name, e.rank)
        residual = self.legendre_minus(x0, xi, h, theta) - p0
        jacobian = ca.jacobian(residual, xi)
        velocity = ca.SX(xi)
        implicit: list[int] = []
        for group in _coupled_groups(jacobian):
            block = jacobian[group, group]
            if ca.depends_on(block, xi):
                implicit.extend(group)
                continue
            at_rest = ca.substitute(residual[group, 0], xi[group, 0], ca.SX.zeros(len(group), 1))
            velocity[group, 0] = -solve_linear(block, at_rest)
        implicit.sort()
        update = solve_linear(jacobian[implicit, implicit], residual[implicit, 0])
        velocity[implicit, 0] = xi[implicit, 0] - update
        arrow = h * velocity
        target = e.target(x0, arrow)
        by_velocity = self._gradients(x0, target, velocity, h, theta)[2]
        return Flight(
            unknowns=xi[implicit, 0],
            implicit=tuple(implicit),
            update=update,
            work=ca.sum1(ca.fabs(residual[implicit, 0] * update)),
            velocity=velocity,
            arrow=arrow,
            target=target,
            momentum=self.legendre_plus(x0, velocity, h, theta),
            energy=ca.sum1(ca.fabs(velocity * by_velocity)),
        )


def _coupled_groups(jacobian: ca.SX) -> list[list[int]]:
    """Connected components of the sparsity pattern of a square matrix."""
    n = jacobian.size1()
    label = list(range(n))
    for i, j in zip(*jacobian.sparsity().get_triplet(), strict=True):
        low, high = sorted((label[i], label[j]))
        label = [low if entry == high else entry for entry in label]
    return [[i for i in range(n) if label[i] == name] for name in sorted(set(label))]


def _gradients_of_average(
    expressions: SystemExpressions, discrete: DiscreteLagrangian
) -> ca.Function:
    """(x0, x1, xi, h, theta) -> the three gradients of the averaged Lagrangian l = L_d / h."""
    system, space = expressions.system, expressions.space
    sizes = {
        "source": (space.base_size,),
        "target": (space.base_size,),
        "velocity": (space.rank,),
        "step": (),
        "parameters": (expressions.parameter_size,),
    }
    lagrangian = _recorded_lagrangian(expressions)

    def average(source: Array, target: Array, velocity: Array, step: Array, flat: Array) -> Array:
        return discrete.average(
            lambda x, xi: lagrangian(x, xi, flat), space, source, target, velocity, step
        )

    average.__wrapped__ = type(discrete).average  # type: ignore[attr-defined]
    recorded = record(average, sizes, (), name=f"{type(discrete).__name__}.average")
    x0, x1 = ca.SX.sym("x0", space.base_size), ca.SX.sym("x1", space.base_size)
    xi, h = ca.SX.sym("xi", space.rank), ca.SX.sym("h")
    theta = ca.SX.sym("theta", system.parameter_layout.size)
    value = recorded.call_sx(x0, x1, xi, h, theta)
    gradients = [ca.gradient(value, variable) for variable in (x0, x1, xi)]
    return ca.Function("gradients", [x0, x1, xi, h, theta], gradients)


def _recorded_lagrangian(expressions: SystemExpressions) -> RecordedFunction:
    """L as a recorded function that can be called on recorded arrays."""
    x, xi = ca.SX.sym("x", expressions.base_size), ca.SX.sym("xi", expressions.rank)
    theta = ca.SX.sym("theta", expressions.parameter_size)
    function = ca.Function("lagrangian", [x, xi, theta], [expressions.lagrangian(x, xi, theta)])
    shapes = ((expressions.base_size,), (expressions.rank,), (expressions.parameter_size,))
    return RecordedFunction("lagrangian", function, shapes, ())
