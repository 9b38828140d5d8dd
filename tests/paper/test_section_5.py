"""Section 5: Euler A and B, SHAKE and RATTLE, their orders, and that A and B are adjoint."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_mechanics import (
    Mechanics,
    close,
    derivative,
    five,
    free,
    knife_edge,
    particle,
    rolling_disc,
    slope,
)
from printed_schemes import SIGN_OF_THE_FORCE, land, leap, one_step, two_step
from scipy.integrate import solve_ivp

import groupoid_gni as gni
from groupoid_gni.integrators import compiled_step

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

MAKERS = {
    "particle": particle,
    "knife edge": knife_edge,
    "rolling disc": rolling_disc,
    "five": five,
}
A, B, RATTLE = gni.EulerA(), gni.EulerB(), gni.Rattle()
RULES = [A, B, RATTLE]
H = 0.08
END = 1.2


@cache
def made(name: str) -> Mechanics:
    return free(made(name.removeprefix("free "))) if name.startswith("free ") else MAKERS[name]()


@cache
def solution(name: str) -> tuple[Any, Any]:
    return made(name).exact(END)


def run_of(
    mechanics: Mechanics, rule: Any, step: float = H, n_steps: int = 12
) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            mechanics.system, mechanics.start, step=step, n_steps=n_steps, method=rule,
            compile=False,
        )


def tilde_momenta(mechanics: Mechanics, rule: Any, run: gni.Trajectory) -> Any:
    """p~_k: the mean momentum less the share of the force that the constraint (13c), (14c) has."""
    share = SIGN_OF_THE_FORCE[rule] * run.step_size / 2
    return np.array(
        [p - share * mechanics.force(q) for q, p in zip(run.base, run.momenta, strict=True)]
    )


systems = pytest.mark.parametrize("name", MAKERS)
few_systems = pytest.mark.parametrize(
    "name",
    [
        "particle",
        "rolling disc",
        pytest.param("knife edge", marks=pytest.mark.slow),
        pytest.param("five", marks=pytest.mark.slow),
    ],
)
rules = pytest.mark.parametrize("rule", RULES, ids=str)


# The schemes.


@systems
@rules
def test_two_step_forms_11_12_and_shake_are_the_solver(name: str, rule: Any) -> None:
    mechanics = made(name)
    q0 = mechanics.base
    q1 = q0 + H * (np.asarray(mechanics.wish) + 0.3)
    arrow = gni.next_arrow(mechanics.system, rule, np.append(q0, q1), step=H)
    found, _ = two_step(mechanics, SIGN_OF_THE_FORCE[rule], H, q0, q1)
    close(arrow[len(q0) :], found, 2e-15)


@systems
@rules
def test_every_step_of_a_run_is_11_12_or_shake_with_its_multipliers(name: str, rule: Any) -> None:
    mechanics = made(name)
    run = run_of(mechanics, rule)
    q = run.base
    for k in range(1, len(run) - 1):
        found, multipliers = two_step(mechanics, SIGN_OF_THE_FORCE[rule], H, q[k - 1], q[k])
        close(q[k + 1], found, 2e-15)
        # the force of the constraint is -mu^T lambda~ in section 5 and +mu^T lambda in (2a)
        close(-run.multipliers[k], multipliers, 2e-13)


@systems
@rules
def test_momentum_forms_13_14_and_rattle_15_are_the_solver(name: str, rule: Any) -> None:
    mechanics, sign = made(name), SIGN_OF_THE_FORCE[rule]
    run = run_of(mechanics, rule)
    q, p, half = run.base, tilde_momenta(mechanics, rule, run), np.diff(run.base, axis=0)
    half = half @ mechanics.metric(q[0]) / H
    for k in range(len(run) - 1):
        after, found = leap(mechanics, H, q[k], p[k], -run.multipliers[k])
        close(after, q[k + 1], 3e-15)
        close(found, half[k], 3e-14)
        landed, multipliers = land(mechanics, sign, H, q[k + 1], half[k])
        close(landed, p[k + 1], 3e-14)
        close(multipliers, -run.multipliers[k + 1], 2e-12)
    central = (q[2:] - q[:-2]) @ mechanics.metric(q[0]) / (2 * H)
    close(p[1:-1], central, 3e-14)


@systems
@rules
def test_the_constraint_holds_at_every_node_as_printed(name: str, rule: Any) -> None:
    """(13c, e), (14c, e), (15c, e)."""
    mechanics, sign = made(name), SIGN_OF_THE_FORCE[rule]
    run = run_of(mechanics, rule)
    p = tilde_momenta(mechanics, rule, run)
    for q, momentum in zip(run.base, p, strict=True):
        gradients = mechanics.rows(q) @ np.linalg.inv(mechanics.metric(q))
        held = gradients @ (momentum + sign * H / 2 * mechanics.force(q))
        close(held, 0, 3e-15)
        if sign:
            assert np.abs(gradients @ momentum).max() > 1e-4


def displays_22_23(
    mechanics: Mechanics, sign: float, h: float, here: Any, there: Any
) -> tuple[Any, Any, Any, Any]:
    """The printed right sides less left sides of (22a, b), (23a, b); (22c); (23c)."""
    (q0, p0, l0), (q1, p1, l1) = here, there
    inverse = np.linalg.inv(mechanics.metric(q0))
    f0, f1 = mechanics.force(q0), mechanics.force(q1)
    mu0, mu1 = mechanics.rows(q0), mechanics.rows(q1)
    moved = q0 + h * inverse @ p0 - h**2 / 2 * inverse @ f0 - h**2 / 2 * inverse @ mu0.T @ l0
    kicked = p0 - h / 2 * (f0 + mu0.T @ l0 + f1 + mu1.T @ l1)
    at_the_end = mu1 @ inverse @ (p0 - h / 2 * (f0 + mu0.T @ l0 + mu1.T @ l1))
    at_the_start = -mu0 @ inverse @ (p1 + h / 2 * (f1 + mu0.T @ l0 + mu1.T @ l1))
    return moved - q1, kicked - p1, at_the_end, at_the_start


@systems
def test_one_step_forms_22_and_23_hold_along_the_solver(name: str) -> None:
    """(23c) is the constraint (14c) of the start; what decides lambda~_{k+1} is (14e)."""
    mechanics = made(name)
    for rule in (A, B):
        run = run_of(mechanics, rule)
        states = list(
            zip(run.base, tilde_momenta(mechanics, rule, run), -run.multipliers, strict=True)
        )
        for here, there in pairwise(states):
            base, momentum, end, start = displays_22_23(
                mechanics, SIGN_OF_THE_FORCE[rule], H, here, there
            )
            close(base, 0, 2e-15)
            close(momentum, 0, 3e-14)
            close(end if rule == A else start, 0, 3e-14)


# The unconstrained methods.


def test_free_euler_a_kicks_first_and_free_euler_b_drifts_first() -> None:
    mechanics = made("free particle")
    mass = mechanics.metric(mechanics.base)
    for rule in (A, B):
        run = run_of(mechanics, rule, n_steps=6)
        for k in range(6):
            q, p = run.base[k], run.momenta[k]
            if rule == A:
                p = p - H * mechanics.force(q)
                q = q + H * np.linalg.solve(mass, p)
            else:
                q = q + H * np.linalg.solve(mass, p)
                p = p - H * mechanics.force(q)
            close(run.base[k + 1], q, 3e-15)
            close(run.momenta[k + 1], p, 3e-15)


# Theorem 5.2 and its proof.


def errors(name: str, rule: Any, counts: list[int]) -> Any:
    """Largest errors of q and of p~ at the end, (counts, 2)."""
    mechanics, (q, v) = made(name), solution(name)
    found = []
    for n in counts:
        run = run_of(mechanics, rule, END / n, n)
        p = tilde_momenta(mechanics, rule, run)[-1]
        found.append(
            [np.abs(run.base[-1] - q).max(), np.abs(p - mechanics.metric(q) @ v).max()]
        )
    return np.array(found)


COUNTS = [80, 160, 320]
STEPS = END / np.array(COUNTS)


@few_systems
@pytest.mark.parametrize("rule", [A, B], ids=str)
def test_theorem_5_2_euler_a_and_b_are_globally_of_order_one(name: str, rule: Any) -> None:
    found = errors(name, rule, COUNTS)
    for column in found.T:
        assert slope(STEPS, column) == pytest.approx(1.0, abs=0.05)


@few_systems
def test_rattle_15_is_globally_of_order_two(name: str) -> None:
    for column in errors(name, RATTLE, COUNTS).T:
        assert slope(STEPS, column) == pytest.approx(2.0, abs=0.05)


def multiplier_of_17(mechanics: Mechanics, q: Any, p: Any) -> Any:
    """``C^-1 (mu_q[M^-1 p, M^-1 p] - mu M^-1 V_q)``."""
    inverse, mu = np.linalg.inv(mechanics.metric(q)), mechanics.rows(q)
    v = inverse @ p
    turning = np.einsum("jai,i,j->a", derivative(mechanics.rows, q), v, v)
    return np.linalg.solve(mu @ inverse @ mu.T, turning - mu @ inverse @ mechanics.force(q))


@systems
def test_equations_17_are_the_constrained_motion(name: str) -> None:
    mechanics = made(name)
    q, v = mechanics.base, mechanics.velocity
    p = mechanics.metric(q) @ v
    multiplier = multiplier_of_17(mechanics, q, p)
    force = -mechanics.force(q) - mechanics.rows(q).T @ multiplier
    found = np.linalg.solve(mechanics.metric(q), force)
    acceleration, opposite = mechanics.accelerations(q, v)
    close(found, acceleration, 2e-15)
    close(multiplier, -opposite, 5e-15)
    run = run_of(mechanics, A, n_steps=1)
    close(run.multipliers[0], -multiplier, 5e-15)


def staggered(
    mechanics: Mechanics, rate: Callable[[Any, Any], Any], n: int
) -> tuple[Any, Any]:
    """(18) with phi = rate, from a half step by Taylor; the end of q and p_{n-1/2}."""
    h, mass = END / n, mechanics.metric(mechanics.base)
    q, half = mechanics.base, mass @ mechanics.velocity
    half = half - h / 2 * rate(q, half)
    for _ in range(n):
        following = half
        for _ in range(60):
            last, following = following, half + h * rate(q, following)
            if np.abs(following - last).max() < 1e-15:
                break
        half = following
        q = q + h * np.linalg.solve(mass, half)
    return q, half


def force_of_19(mechanics: Mechanics) -> Callable[[Any, Any], Any]:
    return lambda q, p: -mechanics.force(q) - mechanics.rows(q).T @ multiplier_of_17(
        mechanics, q, p
    )


@pytest.mark.parametrize(
    "name", ["any phi", "rolling disc", pytest.param("particle", marks=pytest.mark.slow)]
)
def test_the_comparison_methods_18_and_19_are_of_order_one(name: str) -> None:
    mechanics = made("particle" if name == "any phi" else name)
    n, mass = len(mechanics.base), mechanics.metric(mechanics.base)
    rate = force_of_19(mechanics)
    if name == "any phi":
        def rate(q: Any, p: Any) -> Any:
            return np.sin(q[::-1]) - 0.3 * p * (p @ p) + np.cos(p[::-1]) * q

    def field(t: float, y: Any) -> Any:
        return np.append(np.linalg.solve(mass, y[n:]), rate(y[:n], y[n:]))

    y0 = np.append(mechanics.base, mass @ mechanics.velocity)
    exact = solve_ivp(field, (0, END), y0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    counts = [30, 60, 120]
    gaps = [np.abs(np.append(*staggered(mechanics, rate, k)) - exact).max() for k in counts]
    assert slope(END / np.array(counts), gaps) == pytest.approx(1.0, abs=0.06)


@systems
@rules
def test_equation_20_is_the_solver(name: str, rule: Any) -> None:
    """(20b) and what it becomes for Euler B and RATTLE: minus h V_q or h V_q / 2 inside."""
    mechanics = made(name)
    run, mass = run_of(mechanics, rule), mechanics.metric(mechanics.base)
    half = np.diff(run.base, axis=0) @ mass / H
    for k in range(1, len(run) - 1):
        q, mu = run.base[k], mechanics.rows(run.base[k])
        gradients = mu @ np.linalg.inv(mass)
        share = {A: 0.0, B: H, RATTLE: H / 2}[rule]
        fallen = half[k - 1] - share * mechanics.force(q)
        turn = 2 * mu.T @ np.linalg.solve(gradients @ mu.T, gradients @ fallen)
        found = half[k - 1] - H * mechanics.force(q) - turn
        close(half[k], found, 3e-14)


def gaps_of_the_proof(mechanics: Mechanics, n: int, naive: bool) -> tuple[float, float, float]:
    """Largest gaps of (21), of (19b) put into (20b), and of q at the end, for Euler A.

    naive : start with the pair (q0, q0 + h v0) instead of half of the first impulse.
    """
    h, mass = END / n, mechanics.metric(mechanics.base)
    q = [mechanics.base, run_of(mechanics, A, h, 1).base[1]]
    if naive:
        q[1] = q[0] + h * mechanics.velocity
    last, largest, rate = None, np.zeros(2), force_of_19(mechanics)
    for k in range(n):
        half = mass @ (q[k + 1] - q[k]) / h
        if last is not None:
            here, mu = q[k], mechanics.rows(q[k])
            gradients, v = mu @ np.linalg.inv(mass), np.linalg.solve(mass, half)
            turning = np.einsum("jai,i,j->a", derivative(mechanics.rows, here), v, v)
            right = -h * turning + h * gradients @ mechanics.force(here)
            left = -2 * gradients @ last
            step = half - last - h * rate(here, half)
            largest = np.maximum(largest, [np.abs(left - right).max(), np.abs(step).max()])
        last = half
        q.append(two_step(mechanics, 1.0, h, q[k], q[k + 1])[0])
    return largest[0], largest[1], float(np.abs(q[n] - mechanics.exact(END)[0]).max())


@pytest.mark.parametrize("name", ["particle", pytest.param("five", marks=pytest.mark.slow)])
@pytest.mark.parametrize("naive", [False, True], ids=["half impulse", "naive"])
def test_estimate_21_needs_a_start_without_parasitic_mode(name: str, naive: bool) -> None:
    """Along the solver (21) and (19b) hold up to h^2, from a naive start only up to h.

    The theorem survives: the (-1)^k part of the momenta is then O(h), and so is the error of q.
    """
    counts = [40, 80, 160]
    found = np.array([gaps_of_the_proof(made(name), n, naive) for n in counts])
    steps = END / np.array(counts)
    assert slope(steps, found[:, 0]) == pytest.approx(1.0 if naive else 2.0, abs=0.1)
    assert slope(steps, found[:, 1]) == pytest.approx(1.0 if naive else 2.0, abs=0.1)
    assert slope(steps, found[:, 2]) == pytest.approx(1.0, abs=0.1)


# Theorem 5.4, definition 5.3.


@cache
def any_particle() -> gni.MechanicalSystem:
    """A particle whose every number is a parameter, so that samples share their machine code."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda x, p: p.mass,
        constraints=lambda x, p: p.rows + np.sin(p.wave @ x) * p.tilt,
        potential=lambda x, p: p.depth * (x @ x) ** 2 + np.cos(p.wave[::-1] @ x),
        drift=lambda x, p: p.stream * np.cos(x[::-1]),
        parameters={
            "mass": np.eye(3), "rows": np.eye(2, 3), "wave": np.ones(3), "tilt": np.eye(2, 3),
            "depth": 1.0, "stream": np.ones(3),
        },
    )


def numbers(count: int, bound: float = 1.0) -> st.SearchStrategy[Any]:
    entries = st.floats(-bound, bound, allow_subnormal=False)
    return st.lists(entries, min_size=count, max_size=count).map(np.array)


@st.composite
def particles(draw: Any) -> tuple[gni.MechanicalSystem, Mechanics]:
    """A particle for the library and the same in plain NumPy, affine."""
    root, rows = draw(numbers(9, 0.3)).reshape(3, 3), draw(numbers(6, 0.3)).reshape(2, 3)
    tilt, wave = draw(numbers(6, 0.3)).reshape(2, 3), draw(numbers(3))
    depth, stream = draw(st.floats(-0.5, 0.5)), draw(numbers(3))
    mass, rows = root @ root.T + np.diag([1.3, 0.8, 1.1]), rows + np.eye(2, 3)
    system = any_particle().with_parameters(
        mass=mass, rows=rows, wave=wave, tilt=tilt, depth=depth, stream=stream
    )
    plain = Mechanics(
        "any", lambda x: mass, lambda x: rows + np.sin(wave @ x) * tilt,
        lambda x: depth * (x @ x) ** 2 + np.cos(wave[::-1] @ x),
        lambda x: stream * np.cos(x[::-1]), np.zeros(3), np.zeros(3),
    )
    return system, plain


steps = st.floats(0.02, 0.3)
ADJOINT = [(A, B), (B, A), (RATTLE, RATTLE), (gni.Midpoint(), gni.Midpoint())]


@pytest.mark.parametrize(("rule", "other"), ADJOINT, ids=lambda rule: str(rule))
@settings(max_examples=15, deadline=None)
@given(sample=particles(), h=steps, q=numbers(3), v=numbers(3, 2.0))
def test_theorem_5_4_euler_a_and_b_are_adjoint(
    rule: Any, other: Any, sample: Any, h: float, q: Any, v: Any
) -> None:
    """``(F*)^h F^-h = id`` on pairs: A leads on, B with -h leads the inverse arrows back."""
    system, space = sample[0], sample[0].space
    arrow = np.append(q, q + h * v)
    follower = gni.next_arrow(system, rule, arrow, step=h)
    back = gni.next_arrow(system, other, space.inverse(follower), step=-h)
    scale = 1.0 + np.abs(follower).max()
    close(back, space.inverse(arrow), 2e-14 * scale)


@settings(max_examples=25, deadline=None)
@given(sample=particles(), h=steps, q=numbers(3), p=numbers(3), multiplier=numbers(2))
def test_theorem_5_4_in_the_variables_of_its_proof(
    sample: Any, h: float, q: Any, p: Any, multiplier: Any
) -> None:
    """``F_A^h F_B^-h = id`` on (q, p~, lambda~) where p~ satisfies (14c) at step -h, that is (13c).

    Both ends of both steps satisfy their constraint, (22c) and (14e).
    """
    plain = sample[1]

    def held(sign: float, h: float, q: Any, p: Any) -> Any:
        gradients = plain.rows(q) @ np.linalg.inv(plain.metric(q))
        return gradients @ (p + sign * h / 2 * plain.force(q) - plain.one_form(q))

    gram = plain.rows(q) @ np.linalg.solve(plain.metric(q), plain.rows(q).T)
    p = p - plain.rows(q).T @ np.linalg.solve(gram, held(1.0, h, q, p))
    middle = one_step(plain, -1.0, -h, q, p, multiplier)
    end = one_step(plain, 1.0, h, *middle)
    scale = 1.0 + np.abs(np.concatenate([*middle, q, p])).max()
    for found, wanted in zip(end, (q, p, multiplier), strict=True):
        close(found, wanted, 2e-14 * scale / h)
    for node in ((q, p), middle[:2], end[:2]):
        close(held(1.0, h, *node), 0, 2e-14 * scale)
        close(held(-1.0, -h, *node), 0, 2e-14 * scale)


def test_theorem_5_4_needs_the_start_on_the_constraint() -> None:
    """Off (13c), ``F_A^h F_B^-h`` is the projection onto it: it is no identity on all of T*Q."""
    mechanics, h = made("particle"), 0.1
    q, p = mechanics.base, mechanics.metric(mechanics.base) @ mechanics.velocity + 0.2
    along, across = mechanics.projectors(q)
    end = one_step(mechanics, 1.0, h, *one_step(mechanics, -1.0, -h, q, p, np.array([0.7])))
    wanted = along @ p - h / 2 * across @ mechanics.force(q)
    close(end[1], wanted, 1e-14)
    assert np.abs(end[1] - p).max() > 0.1


@pytest.mark.parametrize(("rule", "other"), ADJOINT, ids=lambda rule: str(rule))
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[] if "atiyah" in n else pytest.mark.slow) for n in zoo.SMALL],
)
def test_euler_a_and_b_are_adjoint_on_every_groupoid(name: str, rule: Any, other: Any) -> None:
    a, h = zoo.animal(name, 2, affine=True, gyroscopic=True), 0.12
    space = a.system.space
    arrow = space.retract(a.start.base, h * a.start.velocity)
    follower = gni.next_arrow(a.system, rule, arrow, step=h)
    back = gni.next_arrow(a.system, other, space.inverse(follower), step=-h)
    close(back, space.inverse(arrow), 2e-14)


# Remark 5.5.


def flow(mechanics: Mechanics, rule: Any, h: float) -> Callable[[Any, Any], tuple[Any, Any]]:
    """The discrete flow of (8) on T*Q by the library's step, (q, p-) -> (q, p-) one node on."""
    rows, n = tuple(range(len(mechanics.rows(mechanics.base)))), len(mechanics.base)
    runner = compiled_step(mechanics.system, rule, rows, compile=False)
    layout = runner.program.layout
    parameters = np.concatenate([[h], np.ones(len(rows))])

    def step(q: Any, p: Any) -> tuple[Any, Any]:
        state = np.zeros(layout.size)
        state[layout.slices["base"]], state[layout.slices["after"]] = q, p
        after, _, outcome = runner.advance(parameters, runner.begin(parameters, state), 1, 1)
        assert outcome is gni.Outcome.SUCCESS
        return after.state[:n], after.state[layout.slices["after"]]

    return step


def composed(mechanics: Mechanics, rules: list[Any], n: int) -> tuple[Any, Any]:
    """End of n steps, each the flows of the rules in turn, by h / (number of rules)."""
    q, p = mechanics.base, mechanics.metric(mechanics.base) @ mechanics.velocity
    flows = [flow(mechanics, rule, END / n / len(rules)) for rule in rules]
    for _ in range(n):
        for step in flows:
            q, p = step(q, p)
    return q, p


@pytest.mark.parametrize("rules", [[A, B], [B, A]], ids=["B after A", "A after B"])
def test_remark_5_5_the_free_composition_is_stoermer_verlet(rules: list[Any]) -> None:
    """B after A kicks, drifts, kicks, which is the printed scheme; A after B drifts first."""
    mechanics = made("free particle")
    n = 10
    h, mass = END / n, mechanics.metric(mechanics.base)
    q, p = mechanics.base, mass @ mechanics.velocity
    for _ in range(n):
        if rules == [A, B]:
            p = p - h / 2 * mechanics.force(q)
            q = q + h * np.linalg.solve(mass, p)
            p = p - h / 2 * mechanics.force(q)
        else:
            q = q + h / 2 * np.linalg.solve(mass, p)
            p = p - h * mechanics.force(q)
            q = q + h / 2 * np.linalg.solve(mass, p)
    found = composed(mechanics, rules, n)
    close(found, (q, p), 5e-15)
    if rules == [A, B]:
        close(found, composed(mechanics, [RATTLE], n), 5e-15)


@few_systems
@pytest.mark.parametrize("rules", [[A, B], [B, A]], ids=["B after A", "A after B"])
def test_remark_5_5_the_composition_is_of_order_two_and_not_rattle(
    name: str, rules: list[Any]
) -> None:
    """As flows of (8) on T*Q; what the printed variables give is an erratum."""
    mechanics, counts = made(name), [16, 32, 64]
    steps = END / np.array(counts)
    ends = [composed(mechanics, rules, n)[0] for n in counts]
    gaps = [np.abs(q - solution(name)[0]).max() for q in ends]
    assert slope(steps, gaps) == pytest.approx(2.0, abs=0.1)
    apart = [
        np.abs(q - composed(mechanics, [RATTLE], n)[0]).max()
        for q, n in zip(ends, counts, strict=True)
    ]
    assert min(apart) > 1e-6
    assert slope(steps, apart) == pytest.approx(2.0, abs=0.3)
