"""Equation (49) itself, for one arrow; and the equations of [28] likewise."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.discretization import (
    DiscreteLagrangian,
    SystemExpressions,
    lagrange_dalembert_function,
    next_arrow_function,
)
from groupoid_gni.errors import InputError, StepFailure
from groupoid_gni.integrators.methods import DiscreteLagrangeDAlembert
from groupoid_gni.integrators.requests import checked_step
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, real_array
from groupoid_gni.trajectory import checked_arrow

_ITERATIONS = 50


def next_arrow(
    system: MechanicalSystem,
    method: DiscreteLagrangian | DiscreteLagrangeDAlembert,
    arrow: ArrayLike,
    *,
    step: float,
) -> FloatArray:
    """The arrow h after g: ``FL-(h) = (P* - Q*) FL+(g) + 2 Q* Pi`` at ``alpha(h) = beta(g)``.

    method : a discrete Lagrangian; or ``DiscreteLagrangeDAlembert(...)``, whose h lies in M_c with
        ``FL-(h) = FL+(g) + mu^T impulse``.
    arrow : (arrow_size,), the last arrow g.  step : the step size in L_d.
    Returns (arrow_size,).  Equations (49) and (38), the sign of the affine term mended.
    Raises InputError for an arrow of the wrong shape, not finite or off its group, StepFailure when
    the solve fails.
    """
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"system must be a MechanicalSystem, not {type(system).__name__}")
    if system.control_size:
        raise InputError("next_arrow takes no control inputs; use integrate(..., controls=...)")
    space = system.space
    if not isinstance(method, (DiscreteLagrangian, DiscreteLagrangeDAlembert)):
        raise InputError(
            "expected a discrete Lagrangian or gni.DiscreteLagrangeDAlembert(...), got "
            f"{method!r}"
        )
    h = checked_step(step)
    g = real_array("arrow", arrow)
    if g.shape != (space.arrow_size,) or not np.all(np.isfinite(g)):
        raise InputError(
            f"arrow must be {space.arrow_size} finite numbers; make one with "
            f"space.retract(base, step * velocity). Got shape {g.shape}: {g}"
        )
    checked_arrow("arrow", space, g)
    x0 = np.asarray(space.source(g), dtype=float)
    xi = np.asarray(space.lift(g), dtype=float) / h
    x1 = np.asarray(space.target(g), dtype=float)
    rows = system.independent_rows(x1)
    function = _function(system, method, rows)
    q, unknowns = _solve(function, (x0, xi, h, system.parameter_vector))
    return np.asarray(space.retract(q, h * unknowns[: space.rank]), dtype=float)


def _function(
    system: MechanicalSystem,
    method: DiscreteLagrangian | DiscreteLagrangeDAlembert,
    rows: tuple[int, ...],
) -> Any:
    key = ("next_arrow", method, rows)
    if key not in system._compiled:
        expressions = SystemExpressions(system, rows)
        if isinstance(method, DiscreteLagrangian):
            made = next_arrow_function(expressions, method)
        else:
            rule = method.discrete_lagrangian
            made = lagrange_dalembert_function(expressions, rule, method.constraint)
        system._compiled[key] = made
    return system._compiled[key]


def _solve(function: Any, arguments: tuple[Any, ...]) -> tuple[FloatArray, FloatArray]:
    start = np.zeros(function.numel_in(4))
    velocity = np.array(function(*arguments, start)[5]).ravel()
    last = np.inf
    for _ in range(_ITERATIONS):
        residual, jacobian, q, *_ = (
            np.array(v) for v in function(*arguments, velocity)
        )
        if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
            break
        try:
            update = np.linalg.solve(jacobian, residual).ravel()
        except np.linalg.LinAlgError:
            break
        velocity = velocity - update
        size = float(np.max(np.abs(update), initial=0.0))
        scale = float(np.max(np.abs(velocity), initial=0.0)) + 1e-300
        if size <= 1e-15 * scale or (size >= 0.5 * last and size <= 1e-10 * scale):
            return q.ravel(), velocity
        last = size
    raise StepFailure(Outcome.NEWTON_FAILED.sentence)
