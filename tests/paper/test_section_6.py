"""Section 6: affine constraints (24)-(28), affine SHAKE and RATTLE, on turning tables and more."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from plain_mechanics import (
    Mechanics,
    close,
    knife_edge,
    particle,
    rolling_ball,
    rolling_disc,
    sleigh,
    slope,
)
from printed_schemes import (
    RULES,
    SIGN_OF_THE_FORCE,
    by_multipliers,
    by_projectors,
    by_reflection,
    discrete_lagrangian,
    land,
    leap,
    slots,
    two_step,
)

import groupoid_gni as gni

BALL = "ball on a turntable"
CONSTANT_MASS = {
    "particle": lambda: particle(affine=True),
    "knife edge on a turntable": lambda: knife_edge(0.7),
    "rolling disc on a turntable": lambda: rolling_disc(0.9),
}
MAKERS = {
    **CONSTANT_MASS,
    "curved particle": lambda: particle(affine=True, curved=True),
    "sleigh on a turntable": lambda: sleigh(0.8),
    BALL: lambda: rolling_ball(0.9),
}
A, B, RATTLE = gni.EulerA(), gni.EulerB(), gni.Rattle()
H = 0.07
END = 1.2


@cache
def made(name: str) -> Mechanics:
    return MAKERS[name]()


@cache
def solution(name: str) -> tuple[Any, Any]:
    return made(name).exact(END)


def run_of(
    mechanics: Mechanics, method: Any, step: float = H, n_steps: int = 6
) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            mechanics.system, mechanics.start, step=step, n_steps=n_steps, method=method,
            compile=False,
        )


HEAVY = (BALL, "curved particle")
systems = pytest.mark.parametrize("name", MAKERS)
light_systems = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in HEAVY else []) for n in MAKERS]
)
FEW = ("particle", "sleigh on a turntable")
few_systems = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n in FEW else [pytest.mark.slow]) for n in MAKERS]
)
rules = pytest.mark.parametrize("rule", RULES, ids=str)


# The constraints, continuous and discrete.


@systems
def test_constraints_24_and_25_are_the_library_s(name: str) -> None:
    mechanics = made(name)
    q, v = mechanics.base, np.asarray(mechanics.wish)
    affine = mechanics.rows(q) @ (v - mechanics.section(q))
    p = mechanics.metric(q) @ v
    gradients = mechanics.rows(q) @ np.linalg.inv(mechanics.metric(q))
    close(gradients @ (p - mechanics.one_form(q)), affine, 3e-15)
    found = mechanics.system.constraint_residuals(q[None], v[None])[0]
    close(found, affine, 2e-15)
    assert np.abs(affine).max() > 0.05
    with pytest.raises(gni.InputError, match="constraint"):
        mechanics.system.state(q, v)
    nearest = mechanics.system.state(q, v, project_start=True)
    close(nearest.velocity, mechanics.velocity, 3e-15)


@light_systems
@pytest.mark.parametrize("method", [*RULES, gni.GNI()], ids=str)
def test_the_momentum_of_every_node_satisfies_25(name: str, method: Any) -> None:
    """For the two-step rules it is the mean of pre- and post-momenta, after (27)."""
    mechanics = made(name)
    run = run_of(mechanics, method, n_steps=20)
    close(run.momenta, (run.momenta_before + run.momenta_after) / 2, 1e-15)
    for q, p in zip(run.base, run.momenta, strict=True):
        gradients = mechanics.rows(q) @ np.linalg.inv(mechanics.metric(q))
        close(gradients @ (p - mechanics.one_form(q)), 0, 5e-15)


# Definition 6.1 and (27).


@light_systems
@rules
def test_the_printed_forms_26_and_27_are_the_solver(name: str, rule: Any) -> None:
    mechanics = made(name)
    q0 = mechanics.base
    q1 = q0 + H * (np.asarray(mechanics.wish) + 0.2)
    arrow = gni.next_arrow(mechanics.system, rule, np.append(q0, q1), step=H)[len(q0) :]
    close(arrow, by_projectors(mechanics, rule, H, q0, q1), 2e-15)
    close(arrow, by_reflection(mechanics, rule, H, q0, q1), 2e-15)
    close(arrow, by_multipliers(mechanics, rule, H, q0, q1)[0], 2e-15)


@light_systems
@rules
def test_every_step_of_a_run_is_27_with_its_multipliers(name: str, rule: Any) -> None:
    mechanics = made(name)
    run = run_of(mechanics, rule, n_steps=3)
    q = run.base
    for k in range(1, len(run) - 1):
        found, impulse = by_multipliers(mechanics, rule, H, q[k - 1], q[k])
        close(q[k + 1], found, 3e-15)
        close(-H * run.multipliers[k], impulse, 2e-14)


@light_systems
def test_only_the_class_of_y_modulo_d_matters(name: str) -> None:
    mechanics = made(name)

    def along(x: Any) -> Any:
        # any field of D: subtract its normal part; rows are independent
        wish, mu = 0.8 + 0.5 * np.cos(x[::-1]), mechanics.rows(x)
        return wish - mu.T @ np.linalg.solve(mu @ mu.T, mu @ wish)

    other = replace(mechanics, drift=lambda x: mechanics.section(x) + along(x))
    assert np.abs(other.one_form(mechanics.base) - mechanics.one_form(mechanics.base)).max() > 0.2
    run, again = (run_of(m, gni.Midpoint(), n_steps=10) for m in (mechanics, other))
    close(run.base, again.base, 3e-14)
    close(run.multipliers, again.multipliers, 3e-12)


# Section 6.1: a constant mass.


@pytest.mark.parametrize("name", CONSTANT_MASS)
@pytest.mark.parametrize("rule", SIGN_OF_THE_FORCE, ids=str)
def test_affine_shake_28_and_affine_euler_are_the_solver(name: str, rule: Any) -> None:
    mechanics, sign = made(name), SIGN_OF_THE_FORCE[rule]
    run = run_of(mechanics, rule, n_steps=12)
    q = run.base
    for k in range(1, len(run) - 1):
        found, multipliers = two_step(mechanics, sign, H, q[k - 1], q[k])
        close(q[k + 1], found, 3e-15)
        close(-run.multipliers[k], multipliers, 3e-13)
        if rule == RATTLE:
            central = (q[k + 1] - q[k - 1]) / (2 * H) - mechanics.section(q[k])
            close(mechanics.rows(q[k]) @ central, 0, 2e-14)


@pytest.mark.parametrize("name", CONSTANT_MASS)
def test_affine_rattle_is_the_solver(name: str) -> None:
    """The display after (28)."""
    mechanics = made(name)
    run = run_of(mechanics, RATTLE, n_steps=12)
    half = np.diff(run.base, axis=0) @ mechanics.metric(run.base[0]) / H
    for k in range(len(run) - 1):
        after, found = leap(mechanics, H, run.base[k], run.momenta[k], -run.multipliers[k])
        close(after, run.base[k + 1], 3e-15)
        close(found, half[k], 5e-14)
        p, multipliers = land(mechanics, 0.0, H, run.base[k + 1], half[k])
        close(p, run.momenta[k + 1], 5e-14)
        close(multipliers, -run.multipliers[k + 1], 2e-12)


# Convergence, and the projected step.


@few_systems
@pytest.mark.parametrize(
    ("method", "order"),
    [(A, 1.0), (B, 1.0), (RATTLE, 2.0), (gni.Midpoint(), 2.0), (gni.GNI(), 2.0)],
    ids=str,
)
def test_orders_with_affine_constraints(name: str, method: Any, order: float) -> None:
    mechanics, (q, v) = made(name), solution(name)
    counts = [60, 120, 240]
    found = []
    for n in counts:
        run = run_of(mechanics, method, END / n, n)
        found.append([np.abs(run.base[-1] - q).max(), np.abs(run.velocities[-1] - v).max()])
    for column in np.array(found).T:
        assert slope(END / np.array(counts), column) == pytest.approx(order, abs=0.08)


@systems
def test_the_projected_step_has_the_impact_8_in_its_middle(name: str) -> None:
    """GNI: Euler B over h/2, (8) with the affine term, Euler A over h/2, as in remark 5.5."""
    mechanics, n = made(name), len(made(name).base)
    run = run_of(mechanics, gni.GNI())
    first = discrete_lagrangian(mechanics, B, H / 2)
    second = discrete_lagrangian(mechanics, A, H / 2)
    for k, row in enumerate(run.rows[1:, run.layout.size : -1]):
        here = run.base[k]
        middle = here + H / 2 * row[:n]
        there = middle + H / 2 * row[n:]
        arrive, leave = slots(first, here, middle)[1], -slots(second, middle, there)[0]
        along, across = mechanics.projectors(middle)
        reflected = (along - across) @ arrive + 2 * across @ mechanics.one_form(middle)
        close(there, run.base[k + 1], 3e-15)
        close(leave, reflected, 5e-14)
