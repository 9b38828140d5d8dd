"""The equations of sections 3 to 6 as the paper prints them, misprints mended, in plain NumPy.

Each function takes what the printed equation takes and solves for what it determines, with dense
linear algebra; the library is not used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from plain_mechanics import Mechanics, derivative

import groupoid_gni as gni

DiscreteLagrangian = Callable[[Any, Any], Any]
RULES = [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()]
SIGN_OF_THE_FORCE = {gni.EulerA(): 1.0, gni.EulerB(): -1.0, gni.Rattle(): 0.0}
"""The sign of (h/2) M^-1 V_q in the constraints (11b), (12b) and of remark 5.1."""


def discrete_lagrangian(mechanics: Mechanics, rule: Any, h: float) -> DiscreteLagrangian:
    """L_d(q0, q1) of (10), of (16), and of the midpoint."""

    def at(share: float) -> DiscreteLagrangian:
        return lambda q0, q1: h * mechanics.lagrangian(
            (1.0 - share) * q0 + share * q1, (q1 - q0) / h
        )

    euler_a, euler_b = at(0.0), at(1.0)
    return {
        gni.EulerA(): euler_a,
        gni.EulerB(): euler_b,
        gni.Rattle(): lambda q0, q1: 0.5 * euler_a(q0, q1) + 0.5 * euler_b(q0, q1),
        gni.Midpoint(): at(0.5),
    }[rule]


def slots(action: DiscreteLagrangian, q0: Any, q1: Any) -> tuple[Any, Any]:
    """D_1 L_d and D_2 L_d."""
    return derivative(lambda x: action(x, q1), q0), derivative(lambda x: action(q0, x), q1)


def solve(residual: Callable[[Any], Any], guess: Any) -> Any:
    """A zero of a residual, overdetermined if need be, by Gauss-Newton with differences."""
    x, delta = np.array(guess, dtype=float), 1e-5
    for _ in range(40):
        steps = delta * np.eye(len(x))
        columns = [(residual(x + step) - residual(x - step)) / (2 * delta) for step in steps]
        update = np.linalg.lstsq(np.array(columns).T, residual(x), rcond=None)[0]
        x = x - update
        if np.max(np.abs(update)) < 2e-16 * (1.0 + np.max(np.abs(x))):
            break
    return x


# Sections 4 and 6, (7)-(9) and (26)-(27): (q_{k-1}, q_k) -> q_{k+1}. Without drift Pi = 0.


def by_projectors(mechanics: Mechanics, rule: Any, h: float, q0: Any, q1: Any) -> Any:
    """(7a), (7b); (26a), (26b)."""
    action = discrete_lagrangian(mechanics, rule, h)
    along, across = mechanics.projectors(q1)
    arrival, offset = slots(action, q0, q1)[1], mechanics.one_form(q1)

    def residual(q2: Any) -> Any:
        leave = slots(action, q1, q2)[0]
        return np.concatenate(
            [along @ leave + along @ arrival, across @ (leave - arrival) + 2 * across @ offset]
        )

    return solve(residual, 2 * q1 - q0)


def by_reflection(mechanics: Mechanics, rule: Any, h: float, q0: Any, q1: Any) -> Any:
    """(8), and what it becomes with the affine term."""
    action = discrete_lagrangian(mechanics, rule, h)
    along, across = mechanics.projectors(q1)
    arrival, offset = slots(action, q0, q1)[1], mechanics.one_form(q1)
    reflected = (along - across) @ arrival + 2 * across @ offset
    return solve(lambda q2: slots(action, q1, q2)[0] + reflected, 2 * q1 - q0)


def by_multipliers(
    mechanics: Mechanics, rule: Any, h: float, q0: Any, q1: Any
) -> tuple[Any, Any]:
    """(9a), (9b); (27a), (27b): q_{k+1} and lambda_k."""
    action, n = discrete_lagrangian(mechanics, rule, h), len(q1)
    mu, gradients = mechanics.rows(q1), mechanics.rows(q1) @ np.linalg.inv(mechanics.metric(q1))
    arrival, offset = slots(action, q0, q1)[1], mechanics.one_form(q1)

    def residual(unknown: Any) -> Any:
        leave = slots(action, q1, unknown[:n])[0]
        return np.concatenate(
            [leave + arrival - mu.T @ unknown[n:], gradients @ (leave - arrival + 2 * offset)]
        )

    found = solve(residual, np.concatenate([2 * q1 - q0, np.zeros(len(mu))]))
    return found[:n], found[n:]


# Section 5 and 6.1, a constant mass M. ``sign``: +1 for Euler A, -1 for Euler B, 0 for (15), (28).


def two_step(
    mechanics: Mechanics, sign: float, h: float, q0: Any, q1: Any
) -> tuple[Any, Any]:
    """(11), (12), SHAKE of remark 5.1, (28): q_{k+1} and lambda~_k."""
    mass, mu, force = mechanics.metric(q1), mechanics.rows(q1), mechanics.force(q1)
    n, m = len(q1), len(mu)
    left = np.block([[mass / h**2, mu.T], [mu / (2 * h), np.zeros((m, m))]])
    first = mass @ (2 * q1 - q0) / h**2 - force
    second = mu @ (
        q0 / (2 * h) - sign * h / 2 * np.linalg.solve(mass, force) + mechanics.section(q1)
    )
    found = np.linalg.solve(left, np.concatenate([first, second]))
    return found[:n], found[n:]


def leap(
    mechanics: Mechanics, h: float, q: Any, p: Any, multiplier: Any
) -> tuple[Any, Any]:
    """(13a, b), (14a, b), (15a, b): (q_k, p~_k, lambda~_k) -> (q_{k+1}, p_{k+1/2})."""
    half = p - h / 2 * (mechanics.force(q) + mechanics.rows(q).T @ multiplier)
    return q + h * np.linalg.solve(mechanics.metric(q), half), half


def land(
    mechanics: Mechanics, sign: float, h: float, q: Any, half: Any
) -> tuple[Any, Any]:
    """(13d, e), (14d, e), (15d, e), affine RATTLE: (q_{k+1}, p_{k+1/2}) -> (p~, lambda~)_{k+1}."""
    mu, force = mechanics.rows(q), mechanics.force(q)
    n, m = len(q), len(mu)
    gradients = mu @ np.linalg.inv(mechanics.metric(q))
    left = np.block([[np.eye(n), h / 2 * mu.T], [gradients, np.zeros((m, m))]])
    second = gradients @ (mechanics.one_form(q) - sign * h / 2 * force)
    found = np.linalg.solve(left, np.concatenate([half - h / 2 * force, second]))
    return found[:n], found[n:]


def one_step(
    mechanics: Mechanics, sign: float, h: float, q: Any, p: Any, multiplier: Any
) -> tuple[Any, Any, Any]:
    """F_A, F_B of theorem 5.4, and RATTLE: (q, p~, lambda~)_k -> (q, p~, lambda~)_{k+1}."""
    q1, half = leap(mechanics, h, q, p, multiplier)
    return q1, *land(mechanics, sign, h, q1, half)
