"""The equations of motion, against equations derived by hand and against tiny flights."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni.discretization import FreeFlight, SystemExpressions, reference_field

_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


def field_of(system: gni.MechanicalSystem) -> Callable[[Any, Any], tuple[Any, Any]]:
    """(x, p) -> (x', p') of the library."""
    rows = tuple(range(system.constraint_count))
    function = reference_field(SystemExpressions(system, rows))
    n = system.space.base_size

    def field(x: Any, p: Any) -> tuple[Any, Any]:
        rate = np.array(function(system.parameter_vector, np.concatenate([x, p]))).ravel()
        return rate[:n], rate[n:]

    return field


def multipliers_of(system: gni.MechanicalSystem) -> Callable[[Any, Any], Any]:
    e = SystemExpressions(system, tuple(range(system.constraint_count)))
    x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    function = ca.Function("multipliers", [x, p, theta], [e.multipliers(x, p, theta)])
    return lambda x, p: np.array(function(x, p, system.parameter_vector)).ravel()


speeds = st.floats(-2, 2)


def test_chaplygin_sleigh() -> None:
    m, inertia, a = 1.4, 0.7, 0.35
    scene = gni.scenes.chaplygin_sleigh(m, inertia, a)
    field, multipliers = field_of(scene.system), multipliers_of(scene.system)
    for omega, v in ((1.3, -0.4), (-0.7, 1.9)):
        p = np.array([(inertia + m * a * a) * omega, m * v, m * a * omega])
        omega_rate = -m * a * v * omega / (inertia + m * a * a)
        v_rate = a * omega**2
        expected = [(inertia + m * a * a) * omega_rate, m * v_rate, m * a * omega_rate]
        np.testing.assert_allclose(field(np.zeros(0), p)[1], expected, atol=1e-15)
        # Newton across the blade: the centre of mass is accelerated by a omega' + omega v.
        sideways = m * (a * omega_rate + omega * v)
        np.testing.assert_allclose(multipliers(np.zeros(0), p), sideways, atol=1e-15)


@cache
def ball(*numbers: float) -> tuple[Any, Any]:
    m, r, table, *moments = numbers
    system = gni.scenes.inhomogeneous_ball(m, r, moments, table).system
    return field_of(system), multipliers_of(system)


@settings(max_examples=25, deadline=None)
@given(v=st.lists(speeds, min_size=6, max_size=6), place=st.tuples(speeds, speeds))
def test_inhomogeneous_ball_on_a_rotating_table(v: list[float], place: Any) -> None:
    m, r, table = 1.8, 0.7, 0.9
    moments = np.array([0.9, 0.5, 0.65])
    field, multipliers = ball(m, r, table, *moments)
    rotation = gni.SO3().exp(np.array(v[:3]))
    spin, (x, y) = np.array(v[3:]), place
    omega = rotation @ spin
    # (41); then Newton and Euler with the contact force (f1, f2) at -r e3.
    velocity = np.array([r * omega[1] - table * y, -r * omega[0] + table * x])
    rows, right = np.zeros((7, 7)), np.zeros(7)  # unknown: x'', y'', Omega', f1, f2
    rows[:2, :2], rows[:2, 5:] = m * np.eye(2), -np.eye(2)
    rows[2:5, 2:5] = np.diag(moments)
    rows[2:5, 5:] = -rotation.T @ np.array([[0, r], [-r, 0], [0, 0]])
    right[2:5] = np.cross(moments * spin, spin)
    rows[5, 0], rows[5, 2:5], right[5] = 1, -r * rotation[1], -table * velocity[1]
    rows[6, 1], rows[6, 2:5], right[6] = 1, r * rotation[0], table * velocity[0]
    solution = np.linalg.solve(rows, right)
    base = np.concatenate([[x, y], rotation.ravel()])
    p = np.concatenate([m * velocity, moments * spin])
    base_rate, rate = field(base, p)
    near = {"rtol": 1e-11, "atol": 1e-11}
    hat = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
    np.testing.assert_allclose(base_rate[:2], velocity, **near)
    np.testing.assert_allclose(base_rate[2:], (rotation @ hat).ravel(), **near)
    np.testing.assert_allclose(rate[:2], m * solution[:2], **near)
    np.testing.assert_allclose(rate[2:], moments * solution[2:5], **near)
    np.testing.assert_allclose(multipliers(base, p), solution[5:], **near)


def test_heavy_top_on_the_action_groupoid() -> None:
    moments, arm = np.array([0.8, 1.1, 1.6]), np.array([0.3, -0.5, 0.9])
    space = gni.ActionGroupoid(gni.SO3(), zoo.turned_back, zoo.DIRECTION)
    top = gni.MechanicalSystem(
        space, metric=np.diag(moments), potential=lambda x, p: p.weight * (arm @ x),
        parameters={"weight": 1.7},
    )
    spin = np.array([0.6, -1.2, 0.8])
    up_rate, rate = field_of(top)(zoo.DIRECTION, moments * spin)
    np.testing.assert_allclose(up_rate, np.cross(zoo.DIRECTION, spin), atol=1e-15)
    torque = np.cross(moments * spin, spin) + 1.7 * np.cross(zoo.DIRECTION, arm)
    np.testing.assert_allclose(rate, torque, atol=1e-15)


def test_euler_equations_on_both_sides_fix_the_sign_of_the_bracket() -> None:
    inertia = np.array([[0.9, 0.1, 0.0], [0.1, 1.2, -0.2], [0.0, -0.2, 1.7]])
    spin = np.array([0.6, -1.2, 0.8])
    body = gni.MechanicalSystem(gni.SO3(side="left"), metric=inertia)
    space = gni.MechanicalSystem(gni.SO3(side="right"), metric=inertia)
    p = inertia @ spin
    nowhere = np.zeros(0)
    np.testing.assert_allclose(field_of(body)(nowhere, p)[1], np.cross(p, spin), atol=1e-15)
    np.testing.assert_allclose(field_of(space)(nowhere, p)[1], -np.cross(p, spin), atol=1e-15)


def test_curved_pair_groupoid_with_gyroscopic_term_in_christoffel_form() -> None:
    k = 0.6
    rows = np.array([[1.0, 0.0, 0.4]])

    def metric(x: Any) -> Any:
        wave = k * np.sin(x[0])
        return np.array(
            [[1.5 + x[1] ** 2, wave, 0.0], [wave, 2.0, 0.3 * x[2]], [0.0, 0.3 * x[2], 1.1]]
        )

    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda x, p: metric(x),
        constraints=lambda x, p: rows + np.array([[0.0, 1.0, 0.0]]) * x[2],
        drift=lambda x, p: np.array([0.0, 0.5 * x[0], -0.3]),
        gyroscopic=lambda x, p: np.array([0.2 * x[1] * x[2], 0.7 * x[0] ** 2, x[1]]),
        potential=lambda x, p: 0.3 * x[0] ** 4 + np.cos(x[1]) * x[2],
    )
    x = np.array([0.7, -0.4, 0.9])
    v = system.state(x, [0.3, 1.1, -0.6], project_start=True).velocity
    change = np.zeros((3, 3, 3))  # change[k] = dG/dx^k
    change[0, 0, 1] = change[0, 1, 0] = k * np.cos(x[0])
    change[1, 0, 0] = 2 * x[1]
    change[2, 1, 2] = change[2, 2, 1] = 0.3
    lowered = np.einsum("kij,j,k->i", change, v, v) - 0.5 * np.einsum("ijk,j,k->i", change, v, v)
    slope = np.array([1.2 * x[0] ** 3, -np.sin(x[1]) * x[2], np.cos(x[1])])
    form = np.array([0.2 * x[1] * x[2], 0.7 * x[0] ** 2, x[1]])
    form_change = np.array(  # [i, j] = dA_j/dx^i
        [[0, 1.4 * x[0], 0], [0.2 * x[2], 0, 1], [0.2 * x[1], 0, 0]]
    )
    field_strength = form_change - form_change.T
    free = -slope - lowered + field_strength @ v
    mu = rows + np.array([[0.0, x[2], 0.0]])
    mu_rate = np.array([[0.0, v[2], 0.0]])
    y, y_rate = np.array([0.0, 0.5 * x[0], -0.3]), np.array([0.0, 0.5 * v[0], 0.0])
    inverse = np.linalg.inv(metric(x))
    wanted = -mu_rate @ (v - y) + mu @ y_rate - mu @ inverse @ free
    force = np.linalg.solve(mu @ inverse @ mu.T, wanted)
    acceleration = inverse @ (free + mu.T @ force)
    p = metric(x) @ v + form
    p_rate = (
        metric(x) @ acceleration + np.einsum("kij,k,j->i", change, v, v) + form_change.T @ v
    )
    x_rate, rate = field_of(system)(x, p)
    np.testing.assert_allclose(x_rate, v, atol=1e-14)
    np.testing.assert_allclose(rate, p_rate, atol=1e-13)
    np.testing.assert_allclose(multipliers_of(system)(x, p), force, atol=1e-13)


@pytest.mark.parametrize("name", [n for n in zoo.SPACES if n[:3] != "SO4" or n.endswith("cay")])
def test_unconstrained_equations_are_the_derivative_of_the_free_flight(name: str) -> None:
    # Only FL- and FL+ enter here, no bracket: flights of +-h .. +-4h, differentiated at h = 0.
    a = zoo.animal(name, 0, gyroscopic=True)
    system = a.system
    e = SystemExpressions(system, ())
    x, xi, h = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank), ca.SX.sym("h")
    theta = ca.SX(system.parameter_vector)
    rule = FreeFlight(e, gni.Rattle())
    minus = rule.legendre_minus(x, xi, h, theta)
    outputs = [minus, ca.jacobian(minus, xi), rule.legendre_plus(x, xi, h, theta),
               e.target(x, h * xi)]
    function = ca.Function("f", [x, xi, h], [ca.densify(o) for o in outputs])
    x0, p0 = a.start.base, a.start.momentum
    delta, ends = 8e-3, []
    for step in delta * np.arange(-4, 5):
        v = a.start.velocity.copy()
        for _ in range(8):
            value, slope, plus, target = (np.array(o) for o in function(x0, v, step))
            v = v - np.linalg.solve(slope, value.ravel() - p0)
        ends.append(np.concatenate([target.ravel(), plus.ravel()]))
    rate = _WEIGHTS @ np.array(ends) / delta
    expected = np.concatenate(field_of(system)(x0, p0))
    np.testing.assert_allclose(expected, rate, atol=2e-11)


@pytest.mark.parametrize("name", ["pair 3", "SE3 right cay", "atiyah left exp", "framed right cay"])
def test_multipliers_are_what_finite_differences_of_a_run_leave_over(name: str) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    h = 0.01
    run = gni.integrate(
        a.system, a.start, step=h, n_steps=8, method=gni.ReferenceFlow(rtol=1e-13, atol=1e-14)
    )
    rate = _WEIGHTS @ run.momenta / h
    e = SystemExpressions(a.system, ())
    x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    free = ca.Function("f", [x, p, theta], [e.unconstrained_field(x, p, theta)[1]])
    at_node = free(run.base[4], run.momenta[4], a.system.parameter_vector)
    rest = rate - np.array(at_node).ravel()
    mu = a.plain.constraints(run.base[4])
    force, *_ = np.linalg.lstsq(mu.T, rest, rcond=None)
    np.testing.assert_allclose(mu.T @ force, rest, atol=1e-10)
    np.testing.assert_allclose(run.multipliers[4], force, atol=1e-10)


@pytest.mark.parametrize("name", ["SE3 left exp", "atiyah right cay", "action right cay"])
def test_bracket_of_the_equations_is_the_dense_sum_over_structure_functions(name: str) -> None:
    a = zoo.animal(name, 0, potential=False, curved=False)
    structure = a.system.space.bracket(a.start.base)
    p, v = a.start.momentum, a.start.velocity
    expected = np.einsum("c,cba,b->a", p, structure, v)
    np.testing.assert_allclose(field_of(a.system)(a.start.base, p)[1], expected, atol=1e-14)
