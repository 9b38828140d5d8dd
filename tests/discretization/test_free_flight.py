"""One free step: the explicit forms of section 5, inverse flights and adjoints (Theorem 5.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.discretization import FreeFlight, SystemExpressions
from groupoid_gni.discretization.discrete_lagrangians import Adjoint


@dataclass(frozen=True)
class Flown:
    """A flight, run to round-off by repeating its Newton update."""

    system: gni.MechanicalSystem
    rule: gni.DiscreteLagrangian

    def __call__(self, x0: Any, p0: Any, h: float) -> tuple[Any, Any, Any]:
        e = SystemExpressions(self.system, ())
        x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
        step, theta = ca.SX.sym("h"), ca.SX(self.system.parameter_vector)
        flight = FreeFlight(e, self.rule).from_momentum(x, p, step, theta, "xi")
        guess = e.velocity(x, p, theta)[list(flight.implicit)]
        outputs = [flight.target, flight.momentum, flight.velocity, flight.update]
        run = ca.Function("run", [x, p, step, flight.unknowns], outputs)
        xi = np.array(ca.Function("guess", [x, p], [guess])(x0, p0)).ravel()
        for _ in range(12):
            x1, p1, velocity, update = (np.array(v).ravel() for v in run(x0, p0, h, xi))
            xi = xi - update
        return x1, p1, velocity


def unknowns(system: gni.MechanicalSystem, rule: gni.DiscreteLagrangian) -> int:
    e = SystemExpressions(system, ())
    x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    flight = FreeFlight(e, rule).from_momentum(x, p, ca.SX.sym("h"), theta, "xi")
    return int(flight.unknowns.numel())


MASS = np.array([[1.3, 0.2, -0.1], [0.2, 0.9, 0.15], [-0.1, 0.15, 1.7]])
WIND = np.array([0.4, -0.7, 0.5])


def quartic(x: Any) -> Any:
    return 0.3 * (WIND @ x) ** 4 + 0.8 * x[0] * x[1] - 0.2 * x[2] ** 3


def force(x: Any) -> Any:
    slope = 1.2 * (WIND @ x) ** 3 * WIND
    return -slope - np.array([0.8 * x[1], 0.8 * x[0], -0.6 * x[2] ** 2])


PARTICLE = gni.MechanicalSystem(
    gni.PairGroupoid(3), metric=MASS, potential=lambda x, p: quartic(x)
)
Q, P, H = np.array([0.6, -0.3, 0.8]), np.array([-0.5, 0.9, 0.4]), 0.17


def test_euler_a_is_kick_then_drift() -> None:
    q, p, _ = Flown(PARTICLE, gni.EulerA())(Q, P, H)
    kicked = P + H * force(Q)
    np.testing.assert_allclose(p, kicked, atol=1e-15)
    np.testing.assert_allclose(q, Q + H * np.linalg.solve(MASS, kicked), atol=1e-15)


def test_euler_b_is_drift_then_kick() -> None:
    q, p, _ = Flown(PARTICLE, gni.EulerB())(Q, P, H)
    drifted = Q + H * np.linalg.solve(MASS, P)
    np.testing.assert_allclose(q, drifted, atol=1e-15)
    np.testing.assert_allclose(p, P + H * force(drifted), atol=1e-15)


def test_rattle_is_kick_drift_kick() -> None:
    q, p, _ = Flown(PARTICLE, gni.Rattle())(Q, P, H)
    half = P + H / 2 * force(Q)
    drifted = Q + H * np.linalg.solve(MASS, half)
    np.testing.assert_allclose(q, drifted, atol=1e-15)
    np.testing.assert_allclose(p, half + H / 2 * force(drifted), atol=1e-15)


def test_kick_drift_kick_of_remark_5_5_is_euler_b_after_euler_a() -> None:
    q, p, _ = Flown(PARTICLE, gni.EulerA())(Q, P, H / 2)
    q, p, _ = Flown(PARTICLE, gni.EulerB())(q, p, H / 2)
    rattled = Flown(PARTICLE, gni.Rattle())(Q, P, H)
    np.testing.assert_allclose(q, rattled[0], atol=1e-15)
    np.testing.assert_allclose(p, rattled[1], atol=1e-15)


def test_midpoint_is_the_implicit_midpoint_rule() -> None:
    q, p, _ = Flown(PARTICLE, gni.Midpoint())(Q, P, H)
    np.testing.assert_allclose(q, Q + H * np.linalg.solve(MASS, (p + P) / 2), atol=1e-14)
    np.testing.assert_allclose(p, P + H * force((q + Q) / 2), atol=1e-14)


@pytest.mark.parametrize(
    ("rule", "count"),
    [(gni.EulerA(), 0), (gni.EulerB(), 0), (gni.Rattle(), 0), (gni.Midpoint(), 3)],
)
def test_a_constant_metric_on_r_n_needs_no_solver_unless_the_force_is_taken_halfway(
    rule: gni.DiscreteLagrangian, count: int
) -> None:
    assert unknowns(PARTICLE, rule) == count


def test_only_the_components_that_need_a_solver_get_one() -> None:
    scene = gni.scenes.rolling_ball()
    assert unknowns(scene.system, gni.Rattle()) == 3


def test_a_single_explicit_component_flies_too() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), metric=[[2.3]], potential=lambda x, p: 0.7 * x[0] ** 4
    )
    q, p, _ = Flown(system, gni.EulerA())([0.8], [0.3], 0.1)
    kicked = 0.3 - 0.1 * 2.8 * 0.8**3
    np.testing.assert_allclose([q[0], p[0]], [0.8 + 0.1 * kicked / 2.3, kicked], atol=1e-15)


ANIMALS = ["pair 3", "SO3 right exp", "SE3 left cay", "SE2 right cay", "atiyah left exp",
           "framed right cay", "action left cay", "action right exp", "product cay", "SO4 left cay"]


@pytest.mark.parametrize("name", ANIMALS)
@pytest.mark.parametrize("rule", [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()])
def test_the_adjoint_flown_backwards_undoes_the_flight(
    name: str, rule: gni.DiscreteLagrangian
) -> None:
    a = zoo.animal(name, 0, gyroscopic=True)
    x0, p0, h = a.start.base, a.start.momentum, 0.12
    x1, p1, _ = Flown(a.system, rule)(x0, p0, h)
    back_x, back_p, _ = Flown(a.system, rule.adjoint())(x1, p1, -h)
    np.testing.assert_allclose(back_x, x0, atol=3e-14)
    np.testing.assert_allclose(back_p, p0, atol=3e-14)
    assert np.abs(p1 - p0).max() > 1e-3


@pytest.mark.parametrize("name", ["pair 3", "SE3 right cay", "framed left cay", "action right exp"])
def test_the_general_adjoint_of_euler_a_is_euler_b(name: str) -> None:
    a = zoo.animal(name, 0, gyroscopic=True)
    for left, right in (
        (Adjoint(gni.EulerA()), gni.EulerB()),
        (Adjoint(gni.EulerB()), gni.EulerA()),
        (Adjoint(gni.Rattle()), gni.Rattle()),
        (Adjoint(gni.Midpoint()), gni.Midpoint()),
    ):
        general = Flown(a.system, left)(a.start.base, a.start.momentum, 0.15)
        special = Flown(a.system, right)(a.start.base, a.start.momentum, 0.15)
        for one, other in zip(general, special, strict=True):
            np.testing.assert_allclose(one, other, atol=3e-14)


def test_adjoint_twice_is_the_original() -> None:
    for rule in (gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()):
        assert rule.adjoint().adjoint() == rule


@pytest.mark.parametrize("name", ANIMALS)
def test_a_flight_leaves_with_fl_minus_and_arrives_with_fl_plus(name: str) -> None:
    a = zoo.animal(name, 0, gyroscopic=True)
    e = SystemExpressions(a.system, ())
    x, xi, h = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank), ca.SX.sym("h")
    theta = ca.SX(a.system.parameter_vector)
    for rule in (gni.EulerB(), gni.Midpoint()):
        flight = FreeFlight(e, rule)
        minus = ca.Function("m", [x, xi, h], [flight.legendre_minus(x, xi, h, theta)])
        plus = ca.Function("p", [x, xi, h], [flight.legendre_plus(x, xi, h, theta)])
        x1, p1, v = Flown(a.system, rule)(a.start.base, a.start.momentum, 0.13)
        left = np.array(minus(a.start.base, v, 0.13)).ravel()
        arrived = np.array(plus(a.start.base, v, 0.13)).ravel()
        np.testing.assert_allclose(left, a.start.momentum, atol=1e-14)
        np.testing.assert_allclose(arrived, p1, atol=1e-15)
        space = a.system.space
        arrow = space.retract(a.start.base, 0.13 * v)
        np.testing.assert_allclose(x1, space.target(arrow), atol=1e-15)


@pytest.mark.parametrize("rule", [gni.Rattle(), gni.Midpoint(), gni.EulerA()], ids=str)
@pytest.mark.parametrize("metric", [np.diag([1.3, 0.8]), [[1.3, 0.4], [0.4, 0.8]]], ids=["d", "f"])
def test_the_scale_of_a_step_is_the_sum_of_absolute_values(rule: Any, metric: Any) -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=metric, potential=lambda x, p: -40.0 * (x @ x) ** 2
    )
    e = SystemExpressions(system, ())
    x, p, h = ca.SX.sym("x", 2), ca.SX.sym("p", 2), ca.SX.sym("h")
    step = FreeFlight(e, rule)
    flight = step.from_momentum(x, p, h, ca.SX(0, 1), "xi")
    slope = step._gradients(x, flight.target, flight.velocity, h, ca.SX(0, 1))[2]
    expected = ca.sum1(ca.fabs(flight.velocity * slope))
    both = ca.Function("both", [x, p, h, flight.unknowns], [flight.energy, expected])
    rng = np.random.default_rng(4)
    for _ in range(20):
        guess = rng.uniform(-2, 2, flight.unknowns.numel())
        found, wanted = both(rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), 0.4, guess)
        assert abs(float(found) - float(wanted)) <= 1e-13 * float(wanted)
