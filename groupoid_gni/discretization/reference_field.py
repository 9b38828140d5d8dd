"""The equations of motion themselves, on any groupoid, from the same seven functions.

``x' = rho(x) xi``, ``p_a' = rho_a^i dL/dx^i + <p, [xi, e_a]> + lambda mu_a`` with the multiplier
that keeps the (affine) constraint: equations (2) of the paper on a Lie algebroid.
"""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.system_expressions import SystemExpressions


def reference_field(expressions: SystemExpressions) -> ca.Function:
    """Function (theta, y) -> y' with y = (x, p) the base point and the momentum."""
    n, r = expressions.base_size, expressions.rank
    theta = ca.SX.sym("theta", expressions.parameter_size)
    y = ca.SX.sym("y", n + r)
    x, p = y[:n], y[n:]
    along_base, force = expressions.unconstrained_field(x, p, theta)
    if expressions.constraint_count:
        multipliers = expressions.multipliers(x, p, theta)
        force = force + ca.mtimes(expressions.constraints(x, theta).T, multipliers)
    return ca.Function("field", [theta, y], [ca.cse(ca.densify(ca.vertcat(along_base, force)))])
