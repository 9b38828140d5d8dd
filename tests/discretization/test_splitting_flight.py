"""The explicit flight: flows of single terms against exact rotations, and what it refuses."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo
from flown import Flown
from scipy.linalg import expm

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.discretization.splitting_flight import SplittingStep, _Moving

P, H = np.array([0.7, -0.5, 0.4]), 0.37
INERTIA = np.array([[1.3, 0.2, -0.1], [0.2, 0.9, 0.15], [-0.1, 0.15, 1.7]])


def hat(w: Any) -> Any:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def term(group: gni.LieGroup, u: Any, d: float, p: Any, h: float) -> tuple[Any, Any]:
    """The arrow and the momentum after the flow of d <u, p>^2 / 2 alone."""
    e = SystemExpressions(gni.MechanicalSystem(group, metric=np.eye(group.rank)), ())
    moving = _Moving(e, ca.SX(0, 1), ca.SX(p), ca.SX(h), ca.SX(0, 1))
    moving.move(ca.SX(u), ca.SX(d))
    (_, eta), = moving.pieces
    arrow = e.retract(ca.SX(0, 1), eta)
    value = ca.Function("v", [], [arrow, moving.p])()
    return np.array(value["o0"]).reshape(3, 3), np.array(value["o1"]).ravel()


@pytest.mark.parametrize("side", ["left", "right"])
def test_one_term_turns_the_body_about_a_fixed_axis(side: str) -> None:
    u, d = np.array([0.4, -0.8, 0.3]), 1.7
    speed = d * (u @ P)
    rotation = expm(H * speed * hat(u))
    exponential = gni.SO3(side=side, retraction=gni.Exponential())
    arrow, momentum = term(exponential, u, d, P, H)
    # body momenta turn back, space momenta of the opposite bracket turn along
    turned = rotation.T @ P if side == "left" else rotation @ P
    np.testing.assert_allclose(arrow, rotation, rtol=0, atol=1e-15)
    np.testing.assert_allclose(momentum, turned, rtol=0, atol=1e-15)
    # Cayley turns about the same axis by the angle 2 arctan(t |u| / 2)
    size = np.linalg.norm(u)
    angle = 2.0 * np.arctan(H * speed * size / 2.0)
    cayley, _ = term(gni.SO3(side=side), u, d, P, H)
    np.testing.assert_allclose(cayley, expm(angle * hat(u / size)), rtol=0, atol=1e-15)


def test_a_diagonal_body_is_a_product_of_three_rotations() -> None:
    principal = np.array([0.8, 1.1, 1.9])
    body = gni.MechanicalSystem(
        gni.SO3(retraction=gni.Exponential()), metric=np.diag(principal)
    )
    p = P.copy()
    for k, axis in enumerate(np.eye(3)):
        p = expm(H * p[k] / principal[k] * hat(axis)).T @ p
    np.testing.assert_allclose(
        Flown(body, gni.Splitting())(np.zeros(0), P, H)[1], p, rtol=0, atol=1e-15
    )


def test_the_terms_add_up_to_the_kinetic_energy() -> None:
    body = gni.MechanicalSystem(
        gni.SO3(), metric=lambda x, p: p.size * INERTIA, parameters={"size": 1.4}
    )
    rule = SplittingStep(SystemExpressions(body, ()))
    columns, inverse = (np.array(v) for v in rule._terms(1.4))
    terms = columns @ np.diag(inverse.ravel()) @ columns.T
    np.testing.assert_allclose(terms, np.linalg.inv(1.4 * INERTIA), rtol=0, atol=1e-14)
    flight = Flown(body, gni.Splitting())
    # at h = 0: over a time every term sees the momentum the last one left
    energy = float(flight.run(np.zeros(0), P, 0.0, flight.theta, np.zeros(0))[4])
    np.testing.assert_allclose(energy, P @ np.linalg.solve(1.4 * INERTIA, P), rtol=1e-14)


def test_on_places_it_is_drift_and_kick() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=INERTIA, potential=lambda x, p: np.sin(x[0]) * x[1] + x[2] ** 3
    )
    x = np.array([0.6, -0.3, 0.8])

    def slope(x: Any) -> Any:
        return np.array([np.cos(x[0]) * x[1], np.sin(x[0]), 3 * x[2] ** 2])

    drifted = x + H * np.linalg.solve(INERTIA, P)
    end, p = Flown(system, gni.Splitting())(x, P, H)
    np.testing.assert_allclose(end, drifted, rtol=0, atol=1e-15)
    np.testing.assert_allclose(p, P - H * slope(drifted), rtol=0, atol=1e-15)
    kicked = P - H * slope(x)
    end, p = Flown(system, gni.Splitting(), 1)(x, P, H)
    np.testing.assert_allclose(p, kicked, rtol=0, atol=1e-15)
    np.testing.assert_allclose(end, x + H * np.linalg.solve(INERTIA, kicked), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "name", ["SO3 right cay", "SE2 left cay", "SE3 left exp", "atiyah left exp", "action left cay"]
)
def test_homeward_is_the_adjoint_and_casimirs_are_kept(name: str) -> None:
    a = zoo.animal(name, 0, curved=False)
    out, home = (Flown(a.system, gni.Splitting(), end) for end in (0, 1))
    there = out(a.start.base, a.start.momentum, H)
    x, p = home(*there, -H)
    np.testing.assert_allclose(x, a.start.base, rtol=0, atol=1e-14)
    np.testing.assert_allclose(p, a.start.momentum, rtol=0, atol=1e-14)
    if name[:3] == "SO3":
        np.testing.assert_allclose(np.linalg.norm(there[1]), np.linalg.norm(p), rtol=1e-14)
    if name[:3] == "SE3":  # omega first: <M, F> and |F|
        (m, f), (m0, f0) = (np.split(v, 2) for v in (there[1], p))
        np.testing.assert_allclose([m @ f, f @ f], [m0 @ f0, f0 @ f0], rtol=1e-13)


def test_the_work_of_a_force_is_the_change_of_the_energy() -> None:
    push = np.array([0.3, -0.7, 0.4])
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=INERTIA, force=lambda x, xi, p: push * np.cos(x[1])
    )
    x = np.array([0.6, -0.3, 0.8])
    for end in (0, 1):
        flight = Flown(system, gni.Splitting(), end)
        _, p = flight(x, P, H)
        gained = (p @ np.linalg.solve(INERTIA, p) - P @ np.linalg.solve(INERTIA, P)) / 2
        np.testing.assert_allclose(flight.work(x, P, H), gained, rtol=0, atol=1e-15)


SE3_FULL = np.diag([1.1, 0.8, 0.6, 1.5, 1.5, 1.5]) + 0.1 * np.eye(6, k=3) + 0.1 * np.eye(6, k=-3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"space": gni.PairGroupoid(1), "metric": lambda x, p: np.diag(2 + np.sin(x))},
         "a metric that does not depend on the base point"),
        ({"space": gni.PairGroupoid(1), "metric": [[1.3]],
          "gyroscopic": lambda x, p: np.sin(x)}, "cannot move with a gyroscopic term"),
        ({"space": gni.SO3(), "metric": INERTIA, "force": lambda x, xi, p: -0.3 * xi},
         "a force that does not depend on the velocity"),
        ({"space": gni.SE3(), "metric": SE3_FULL}, "retraction=gni.Exponential"),
    ],
    ids=["metric", "gyroscopic", "friction", "screws"],
)
def test_what_does_not_fit_is_refused_with_a_mend(options: Any, said: str) -> None:
    system = gni.MechanicalSystem(**options)
    with pytest.raises(gni.InputError, match=said) as caught:
        gni.Splitting().flights(SystemExpressions(system, ()))
    assert "use flow" in str(caught.value) or "mend" in str(caught.value)


def test_what_fits_on_se3() -> None:
    for group, metric in [
        (gni.SE3(retraction=gni.Exponential()), SE3_FULL),
        (gni.SE3(), np.diag(np.diag(SE3_FULL))),  # rotations and translations, no screws
    ]:
        gni.Splitting().flights(SystemExpressions(gni.MechanicalSystem(group, metric=metric), ()))
