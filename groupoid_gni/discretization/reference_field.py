"""The equations of motion themselves, on any groupoid, from the same seven functions.

``x' = rho(x) xi``, ``p_a' = rho_a^i dL/dx^i + <p, [xi, e_a]> + lambda mu_a`` with the multiplier
that keeps the (affine) constraint: equations (2) of the paper on a Lie algebroid.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.system_expressions import SystemExpressions

_LARGEST_QUADRATIC = 3
"""Rank up to which the r^2 (r + 1) / 2 coefficients of a quadratic field are few."""


def reference_field(expressions: SystemExpressions) -> ca.Function:
    """Function (theta, y) -> y' with y = (x, p) the base point and the momentum.

    theta : the physical parameters, then the control inputs.
    """
    e = expressions
    theta, x, p = _symbols(e)
    rates = ca.densify(ca.vertcat(*_equations(e, theta, x, p)))
    return ca.Function("field", [ca.vertcat(theta, e.controls), ca.vertcat(x, p)], [ca.cse(rates)])


def reference_flow(expressions: SystemExpressions, reconstruct: bool = False) -> ca.Function:
    """Function (theta, y) -> (y', y put back on its manifold, units), y = (x, p, work, W).

    work : of the external force, ``work' = <force, xi>``; there with a force only.
    W : the arrow accumulated along the motion, ``W' = d/de multiply(W, retract(x, e xi))`` at
        e = 0, (arrow size,); there with ``reconstruct`` only.
    units : what a tolerance of velocities is multiplied with: 1 for coordinates, the inertia for a
        momentum, the sum of the inertias for work, so that the masses do not matter.
    """
    e = expressions
    theta, x, p = _symbols(e)
    arrow = ca.SX.sym("W", e.space.arrow_size if reconstruct else 0)
    work = ca.SX.sym("work", 1 if e.system.has("force") else 0)
    xi = e.velocity(x, p, theta)
    inertias = ca.diag(e.metric(x, theta))
    rates = [*_equations(e, theta, x, p)]
    units = [ca.SX.ones(e.base_size), inertias]
    if e.system.has("force"):
        rates.append(ca.dot(e.force(x, xi, theta), xi))
        units.append(ca.sum1(inertias))
    restored = [e.restore_base(x), p, work]
    if reconstruct:
        rates.append(_arrow_rate(e, x, xi, arrow))
        restored.append(e.restore_arrow(arrow))
        units.append(ca.SX.ones(arrow.numel()))
    outputs = [ca.densify(ca.vertcat(*parts)) for parts in (rates, restored, units)]
    inputs = [ca.vertcat(theta, e.controls), ca.vertcat(x, p, work, arrow)]
    return ca.Function("flow", inputs, ca.cse(outputs))


def _symbols(e: SystemExpressions) -> tuple[ca.SX, ca.SX, ca.SX]:
    return (
        ca.SX.sym("theta", e.parameter_size), ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    )


def _equations(
    e: SystemExpressions, theta: ca.SX, x: ca.SX, p: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """x' and p'."""
    along_base, force = e.unconstrained_field(x, p, theta)
    if e.constraint_count:
        force = force + ca.mtimes(e.constraints(x, theta).T, e.multipliers(x, p, theta))
    few = e.rank <= _LARGEST_QUADRATIC
    if few and not e.base_size and not e.system.has("force"):
        force = _quadratic(force, p)
    return along_base, force


def _arrow_rate(e: SystemExpressions, x: ca.SX, xi: ca.SX, arrow: ca.SX) -> ca.SX:
    """``d/de multiply(W, retract(x, e xi))`` at e = 0, (arrow size,)."""
    eta = ca.SX.sym("eta", e.rank)
    direction = ca.SX.sym("xi", e.rank)
    tangent = ca.jtimes(e.multiply(arrow, e.retract(x, eta)), eta, direction)
    at_zero = ca.Function("tangent", [eta, direction, x, arrow], [tangent])
    return at_zero(ca.SX.zeros(e.rank), xi, x, arrow)


def _quadratic(force: ca.SX, p: ca.SX) -> ca.SX:
    """The same field, written out as the quadratic polynomial of p that it is over a point, (r,).

    The coefficients depend on parameters alone and leave the loop, and what is left waits for two
    products and a sum instead of a chain of solves. An external force would have to be a polynomial
    too, which nobody can tell.
    """
    r = p.numel()
    slope = ca.jacobian(force, p)
    curvature = ca.jacobian(slope, p)
    nothing = ca.SX.zeros(r)
    constant, linear = (
        ca.sparsify(ca.substitute(part, p, nothing)) for part in (force, slope)
    )
    result = []
    for a in range(r):
        terms = [constant[a]] if constant[a].nnz() else []
        terms += [linear[a, b] * p[b] for b in range(r) if linear[a, b].nnz()]
        for b in range(r):
            for c in range(b, r):
                entry = curvature[a + r * b, c]
                if entry.nnz():
                    weight = entry / 2 if b == c else entry
                    terms.append(weight * (p[b] * p[c]))
        result.append(_balanced_sum(terms))
    return ca.vertcat(*result)


def _balanced_sum(terms: list[ca.SX]) -> ca.SX:
    """Sum of the terms, halves first, so that no term waits for many others."""
    if len(terms) <= 2:
        return sum(terms, ca.SX(0))
    half = len(terms) // 2
    return _balanced_sum(terms[:half]) + _balanced_sum(terms[half:])
