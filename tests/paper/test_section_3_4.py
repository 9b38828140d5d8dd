"""Sections 3 and 4: discrete Euler-Lagrange, Legendre transforms, momenta, (7)-(9), the solver."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from plain_mechanics import Mechanics, close, five, free, particle
from printed_schemes import (
    RULES,
    by_multipliers,
    by_projectors,
    by_reflection,
    discrete_lagrangian,
    slots,
)

import groupoid_gni as gni
from groupoid_gni.discretization import FreeFlight, SystemExpressions

H = 0.09
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


def difference(function: Callable[[Any], Any], x: Any, delta: float = 0.01) -> Any:
    """The Jacobian, (outputs, inputs), by central differences of order 8."""
    steps = delta * np.arange(-4, 5)
    columns = [
        sum(w * function(x + s * e) for w, s in zip(_WEIGHTS, steps, strict=True)) / delta
        for e in np.eye(len(x))
    ]
    return np.array(columns).T


@cache
def curved_particle() -> Mechanics:
    return particle(curved=True)


@cache
def two_rows() -> Mechanics:
    return five()


@cache
def no_rows() -> Mechanics:
    return free(particle(curved=True))


CONSTRAINED = [curved_particle, two_rows]


def run_of(mechanics: Mechanics, rule: Any, n_steps: int = 12) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            mechanics.system, mechanics.start, step=H, n_steps=n_steps, method=rule, compile=False
        )


def pair(mechanics: Mechanics) -> tuple[Any, Any]:
    """Two points that have nothing to do with the constraint."""
    q, v = mechanics.base, np.asarray(mechanics.wish)
    return q, q + H * (v + 0.3)


# Section 3.


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_free_run_satisfies_the_discrete_euler_lagrange_equations_6(rule: Any) -> None:
    mechanics = no_rows()
    action = discrete_lagrangian(mechanics, rule, H)
    q = run_of(mechanics, rule).base
    for before, here, after in zip(q, q[1:], q[2:], strict=False):
        balance = slots(action, here, after)[0] + slots(action, before, here)[1]
        close(balance, 0, 2e-15)


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_a_free_run_extremizes_the_action_sum(rule: Any) -> None:
    mechanics = no_rows()
    action = discrete_lagrangian(mechanics, rule, H)
    q = run_of(mechanics, rule, 6).base
    bumps = np.random.default_rng(5).uniform(-1, 1, q.shape)
    bumps[[0, -1]] = 0

    def action_sum(size: Any) -> Any:
        path = q + size[0] * bumps
        return np.array([sum(action(a, b) for a, b in pairwise(path))])

    assert abs(difference(action_sum, np.zeros(1))[0, 0]) < 2e-12
    bumps[-1] = 1.0
    assert abs(difference(action_sum, np.zeros(1))[0, 0]) > 0.1


@pytest.mark.parametrize("make", CONSTRAINED)
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_legendre_transforms_are_the_slot_derivatives(
    make: Callable[[], Mechanics], rule: Any
) -> None:
    mechanics = make()
    q0, q1 = pair(mechanics)
    n = len(q0)
    x, xi = ca.SX.sym("x", n), ca.SX.sym("xi", n)
    flight = FreeFlight(SystemExpressions(mechanics.system, ()), rule)
    sides = [flight.legendre_minus, flight.legendre_plus]
    both = ca.Function("both", [x, xi], [side(x, xi, H, ca.SX(0, 1)) for side in sides])
    minus, plus = (np.array(v).ravel() for v in both(q0, (q1 - q0) / H))
    first, second = slots(discrete_lagrangian(mechanics, rule, H), q0, q1)
    close(minus, -first, 2e-15)
    close(plus, second, 2e-15)


@pytest.mark.parametrize("make", CONSTRAINED)
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_momenta_of_a_run_are_pre_and_post_momenta(
    make: Callable[[], Mechanics], rule: Any
) -> None:
    """p+ = FL+(q_{k-1}, q_k) and p- = FL-(q_k, q_{k+1}), section 4."""
    mechanics = make()
    action, run = discrete_lagrangian(mechanics, rule, H), run_of(mechanics, rule)
    for k, (here, after) in enumerate(zip(run.base, run.base[1:], strict=False)):
        leave, arrive = slots(action, here, after)
        close(run.momenta_after[k], -leave, 3e-15)
        close(run.momenta_before[k + 1], arrive, 3e-15)


def two_form(action: Any, q0: Any, q1: Any) -> Any:
    """The matrix of omega_d in (q0, q1): minus the mixed derivatives beside their transpose."""
    n = len(q0)
    mixed = difference(lambda x: slots(action, q0, x)[0], q1)
    zero = np.zeros((n, n))
    return np.block([[zero, -mixed], [mixed.T, zero]])


def pulled_back(transform: Callable[[Any], Any], y: Any) -> Any:
    """The canonical form dq ^ dp pulled back by y -> (q, p)."""
    n = len(y) // 2
    canonical = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    slope = difference(transform, y)
    return slope.T @ canonical @ slope


@pytest.mark.parametrize(
    "rule", [gni.EulerA(), *(pytest.param(r, marks=pytest.mark.slow) for r in RULES[1:])], ids=str
)
def test_the_flow_keeps_the_discrete_poincare_cartan_form(rule: Any) -> None:
    mechanics = no_rows()
    system, action, n = mechanics.system, discrete_lagrangian(mechanics, rule, H), 3
    y = np.concatenate(pair(mechanics))

    def flow(y: Any) -> Any:
        return gni.next_arrow(system, rule, y, step=H)

    here = two_form(action, y[:n], y[n:])
    minus = pulled_back(lambda y: np.append(y[:n], -slots(action, y[:n], y[n:])[0]), y)
    plus = pulled_back(lambda y: np.append(y[n:], slots(action, y[:n], y[n:])[1]), y)
    close(minus, here, 2e-10)
    close(plus, here, 2e-10)
    there, turn = two_form(action, *np.split(flow(y), 2)), difference(flow, y)
    close(turn.T @ there @ turn, here, 2e-9)
    assert np.abs(there - here).max() > 0.05


def around(well: Callable[[Any], Any], horizontal: bool) -> Mechanics:
    """A particle of variable mass in the plane or in a channel, symmetric under one motion."""
    if not horizontal:
        return Mechanics(
            "turning", lambda x: (1.2 + 0.5 * np.sin(x @ x)) * np.eye(2),
            lambda x: np.zeros((0, 2)), well, None, np.array([0.8, -0.3]), [0.5, 0.9],
        )
    return Mechanics(
        "sliding", lambda x: np.diag([1.2 + 0.4 * np.cos(x[0]), 0.9 + 0.3 * x[2] ** 2, 1.5]),
        lambda x: np.array([[-x[1] - 0.4 * np.sin(x[0]), 0.0, 1.0]]), well, None,
        np.array([0.4, -0.6, 0.3]), [0.7, 0.9, 0.1],
    )


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_noether_the_discrete_momentum_map_is_kept(rule: Any) -> None:
    """J_d of section 3 for rotations: xi_Q(q) = xi (-y, x)."""
    mechanics = around(lambda x: 0.6 * (x @ x) ** 2 - 0.9 * (x @ x), False)
    action, run = discrete_lagrangian(mechanics, rule, H), run_of(mechanics, rule, 60)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    momentum = []
    for q0, q1 in zip(run.base, run.base[1:], strict=False):
        leave, arrive = slots(action, q0, q1)
        momentum.append(arrive @ turn @ q1)
        assert abs(momentum[-1] + leave @ turn @ q0) < 2e-15
    np.testing.assert_allclose(momentum, momentum[0], rtol=2e-14)
    assert np.ptp(run.energy()) > 1e-4


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_the_momentum_of_a_horizontal_symmetry_is_kept(rule: Any) -> None:
    """xi_Q = d/dy lies in D and leaves L alone, not the constraint: <FL+, xi_Q> is constant."""
    mechanics = around(lambda x: 0.7 * x[0] ** 4 + np.sin(x[0] - x[2]), True)
    run = run_of(mechanics, rule, 60)
    np.testing.assert_allclose(run.momenta_before[:, 1], run.momenta_after[0, 1], rtol=1e-13)
    np.testing.assert_allclose(run.momenta_after[:, 1], run.momenta_after[0, 1], rtol=1e-13)
    assert np.ptp(run.momenta[:, 0]) > 0.1


# Section 4.


@pytest.mark.parametrize("make", CONSTRAINED)
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_the_three_printed_forms_7_8_9_are_the_solver(
    make: Callable[[], Mechanics], rule: Any
) -> None:
    mechanics = make()
    q0, q1 = pair(mechanics)
    arrow = gni.next_arrow(mechanics.system, rule, np.append(q0, q1), step=H)
    np.testing.assert_array_equal(arrow[: len(q1)], q1)
    printed, _ = by_multipliers(mechanics, rule, H, q0, q1)
    for found in (
        by_projectors(mechanics, rule, H, q0, q1),
        by_reflection(mechanics, rule, H, q0, q1),
        printed,
    ):
        close(arrow[len(q1) :], found, 2e-15)


@pytest.mark.parametrize("make", CONSTRAINED)
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_every_step_of_a_run_solves_9_with_the_reported_multipliers(
    make: Callable[[], Mechanics], rule: Any
) -> None:
    mechanics = make()
    run = run_of(mechanics, rule, 4)
    q = run.base
    for k in range(1, len(run) - 1):
        found, impulse = by_multipliers(mechanics, rule, H, q[k - 1], q[k])
        close(q[k + 1], found, 2e-15)
        # (9a) has lambda on the other side of (2a), and for a whole step
        close(-H * run.multipliers[k], impulse, 2e-14)


@pytest.mark.parametrize("make", CONSTRAINED)
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_the_mean_of_pre_and_post_momenta_satisfies_the_constraint(
    make: Callable[[], Mechanics], rule: Any
) -> None:
    mechanics = make()
    action, run = discrete_lagrangian(mechanics, rule, H), run_of(mechanics, rule, 40)
    q, alone = run.base, []
    for before, here, after in zip(q, q[1:], q[2:], strict=False):
        arrive, leave = slots(action, before, here)[1], -slots(action, here, after)[0]
        gradients = mechanics.rows(here) @ np.linalg.inv(mechanics.metric(here))
        close(gradients @ (leave + arrive) / 2, 0, 3e-15)
        alone.append(gradients @ arrive)
    assert np.abs(alone).max() > 0.01


def test_the_evolution_is_defined_where_the_mixed_derivative_is_regular() -> None:
    """A rule whose D_12 L_d is singular is refused; the sentence after (8)."""

    @dataclass(frozen=True)
    class Blind(gni.DiscreteLagrangian):
        def average(
            self, lagrangian: Any, space: Any, source: Any, target: Any, velocity: Any, step: Any
        ) -> Any:
            return lagrangian(source, velocity * np.array([1.0, 1.0, 0.0]))

    mechanics = curved_particle()
    with pytest.raises(gni.InputError, match="singular"):
        run_of(mechanics, Blind())
    for rule in RULES:
        form = two_form(discrete_lagrangian(mechanics, rule, H), *pair(mechanics))
        assert np.linalg.cond(form) < 20


@dataclass(frozen=True)
class Skewed(gni.DiscreteLagrangian):
    """Left-invariant on a group, and not the discretization of anything symmetric."""

    def average(
        self, lagrangian: Any, space: Any, source: Any, target: Any, velocity: Any, step: Any
    ) -> Any:
        return lagrangian(source, velocity) + 0.2 * step * np.sin(velocity[0]) * velocity[1] ** 2


def test_bi_invariant_metric_keeps_the_energy_for_any_left_invariant_l_d() -> None:
    """The last paragraph of section 4, with constraints that depend on the configuration."""
    space = gni.FramedPairGroupoid(gni.SO3())

    def rows(q: Any, p: Any) -> Any:
        return np.array([[1.0, 0.4 * q[0], q[5] - 0.3]])

    system = gni.MechanicalSystem(space, metric=1.37 * np.eye(3), constraints=rows)
    start = system.state(space.example_base_point, [0.9, -0.7, 0.8], project_start=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        run = gni.integrate(system, start, step=0.15, n_steps=300, method=Skewed(), compile=False)
    for p in (run.momenta_before[1:], run.momenta_after):
        size = np.linalg.norm(p, axis=1)
        np.testing.assert_allclose(size, size[-1], rtol=1e-13)
    assert np.ptp(run.momenta_after[:, 0]) > 0.3
