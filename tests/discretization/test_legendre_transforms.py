"""Equation (48) taken literally, by differences of L_d along the groupoid, against the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.discretization import FreeFlight, SystemExpressions

# Weights of the central difference of order 8.
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@dataclass(frozen=True)
class Lopsided(gni.DiscreteLagrangian):
    """A discrete Lagrangian of a user: uneven weights, and a term that is nobody's L."""

    weight: float = 0.3

    def average(
        self,
        lagrangian: Callable[[Any, Any], Any],
        space: gni.LieGroupoid,
        source: Any,
        target: Any,
        velocity: Any,
        step: Any,
    ) -> Any:
        mean = self.weight * lagrangian(source, velocity)
        mean = mean + (1 - self.weight) * lagrangian(target, 0.9 * velocity)
        return mean + step * np.sin(velocity[0]) * np.cosh(velocity @ velocity)


RULES = [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint(), Lopsided()]
RULES.append(Lopsided(0.2).adjoint())


def difference(function: Callable[[Any], float], size: int, delta: float = 4e-3) -> Any:
    """The gradient at 0 by central differences of order 8."""
    steps = delta * np.arange(-4, 5)
    rows = [_WEIGHTS @ [function(s * e) for s in steps] / delta for e in np.eye(size)]
    return np.array(rows)


def discrete_lagrangian(a: zoo.Animal, rule: gni.DiscreteLagrangian, h: float) -> Any:
    """L_d as a function of an arrow, all in plain NumPy."""
    space = a.system.space

    def of_arrow(g: Any) -> float:
        x0, x1 = space.source(g), space.target(g)
        xi = space.lift(g) / h
        return float(h * rule.average(a.plain.lagrangian, space, x0, x1, xi, h))

    return of_arrow


def both_legendre_transforms(a: zoo.Animal, rule: gni.DiscreteLagrangian) -> ca.Function:
    e = SystemExpressions(a.system, tuple(range(a.system.constraint_count)))
    x, xi, h = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank), ca.SX.sym("h")
    theta = ca.SX.sym("theta", e.parameter_size)
    flight = FreeFlight(e, rule)
    outputs = [flight.legendre_minus(x, xi, h, theta), flight.legendre_plus(x, xi, h, theta)]
    return ca.Function("legendre", [x, xi, h, theta], outputs)


def _slow(name: str) -> Any:
    marks = [pytest.mark.slow] if name.startswith("SO4") and name.endswith("exp") else []
    return pytest.param(name, marks=marks)


@pytest.mark.parametrize("name", [_slow(name) for name in zoo.SPACES])
def test_legendre_transforms_are_equation_48_on_every_groupoid(name: str) -> None:
    a = zoo.animal(name, gyroscopic=True, speed=1.3)
    space, h = a.system.space, 0.11
    x, xi = a.start.base, a.start.velocity
    g = space.retract(x, h * xi)
    x1 = space.target(g)
    for rule in RULES:
        action = discrete_lagrangian(a, rule, h)

        def longer(e: Any, action: Any = action) -> float:
            return action(space.multiply(g, space.retract(x1, e)))

        def shorter(e: Any, action: Any = action) -> float:
            return action(space.multiply(space.inverse(space.retract(x, e)), g))

        minus, plus = (
            np.array(v).ravel()
            for v in both_legendre_transforms(a, rule)(x, xi, h, a.system.parameter_vector)
        )
        np.testing.assert_allclose(plus, difference(longer, space.rank), atol=3e-12)
        np.testing.assert_allclose(minus, -difference(shorter, space.rank), atol=3e-12)


def test_on_the_pair_groupoid_they_are_the_slot_derivatives_of_section_3() -> None:
    a = zoo.animal("pair 3", gyroscopic=True)
    h, x0, v = 0.2, a.start.base, a.start.velocity
    x1 = x0 + h * v
    for rule in RULES:
        action = discrete_lagrangian(a, rule, h)
        by_first = difference(lambda e, f=action: f(np.concatenate([x0 + e, x1])), 3)
        by_second = difference(lambda e, f=action: f(np.concatenate([x0, x1 + e])), 3)
        minus, plus = both_legendre_transforms(a, rule)(x0, v, h, a.system.parameter_vector)
        np.testing.assert_allclose(np.array(minus).ravel(), -by_first, atol=3e-12)
        np.testing.assert_allclose(np.array(plus).ravel(), by_second, atol=3e-12)


def test_on_a_left_group_they_are_the_trivialised_forms_of_equation_45() -> None:
    # F l_d^- = (dtau^-1_{h omega})^* D l_d, F l_d^+ = (dtau^-1_{-h omega})^* D l_d, l_d in sigma.
    inertia, h, w = np.diag([0.8, 1.3, 1.7]), 0.3, np.array([0.9, -1.2, 0.7])
    sigma = h * w
    hat = np.array([[0, -sigma[2], sigma[1]], [sigma[2], 0, -sigma[0]], [-sigma[1], sigma[0], 0]])
    for sign, retraction in ((1, gni.Cayley()), (-1, gni.Cayley())):
        system = gni.MechanicalSystem(
            gni.SO3(side="left" if sign == 1 else "right", retraction=retraction), metric=inertia
        )
        start = system.state(velocity=w)
        a = zoo.Animal("so3", system, None, start)  # type: ignore[arg-type]
        minus, plus = both_legendre_transforms(a, gni.EulerA())([], w, h, [])
        dcay_inverse = np.eye(3) - hat / 2 + np.outer(sigma, sigma) / 4
        low, high = (dcay_inverse, dcay_inverse.T)[::sign]
        np.testing.assert_allclose(np.array(minus).ravel(), low.T @ inertia @ w, atol=1e-15)
        np.testing.assert_allclose(np.array(plus).ravel(), high.T @ inertia @ w, atol=1e-15)


def test_the_printed_rolling_ball_scheme_is_recovered() -> None:
    """Momentum along the table and the cubic terms O_1 ... O_5 of section 7.4.1."""
    m, inertia, r, table, h = 1.7, 0.6, 0.8, 1.3, 0.05
    scene = gni.scenes.rolling_ball(m, r, inertia, table, (0.4, -0.9), (0.3, 0.7), 0.35)
    run = gni.integrate(scene.system, scene.start, step=h, n_steps=12, method=gni.EulerA())
    x, y = run.base.T
    omega = run.rows[1:, run.layout.size : -1][:, 2:]
    stretch = omega * (1 + h * h * (omega**2).sum(1)[:, None] / 4)
    now, last = stretch[1:], stretch[:-1]
    second = np.diff(run.base, 2, axis=0) / h
    np.testing.assert_allclose(m * r * second[:, 0] + inertia * (now - last)[:, 1], 0, atol=1e-14)
    np.testing.assert_allclose(m * r * second[:, 1] - inertia * (now - last)[:, 0], 0, atol=1e-14)
    np.testing.assert_allclose(inertia * (now - last)[:, 2], 0, atol=1e-14)
    mean = (now + last) / 2
    central = (run.base[2:] - run.base[:-2]) / (2 * h)
    rolling_x = central[:, 0] + table * y[1:-1] - r * mean[:, 1]
    rolling_y = central[:, 1] - table * x[1:-1] + r * mean[:, 0]
    np.testing.assert_allclose(rolling_x, 0, atol=1e-14)
    np.testing.assert_allclose(rolling_y, 0, atol=1e-14)
