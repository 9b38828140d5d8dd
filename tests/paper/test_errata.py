"""Every misprint of docs/errata.md, in numbers: the printed form is off, the mended one is not.

Each test measures both and compares them with the page, which therefore says what is true.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_mechanics import Mechanics, close, derivative, free, hat, particle, slope
from printed_schemes import (
    by_multipliers,
    discrete_lagrangian,
    land,
    leap,
    one_step,
    slots,
    solve,
)

import groupoid_gni as gni

PAGE = Path(__file__).parents[2] / "docs" / "errata.md"
_NUMBER = r"(\d+(?:\.\d+)?(?:e-?\d+)?)"
NUMBERS = re.compile(
    r"\*\*Numbers\*\* \(`(test_\w+)`\):.*?"
    rf"printed\s+off\s+by\s+{_NUMBER},\s+mended\s+by\s+at\s+most\s+{_NUMBER}",
    re.DOTALL,
)
Compare = Callable[[Any, Any], None]
H = 0.1
A, B, RATTLE = gni.EulerA(), gni.EulerB(), gni.Rattle()


@cache
def said() -> dict[str, tuple[float, float]]:
    """What the page says, by test: how far the printed form is off, and at most the mended one."""
    found = NUMBERS.findall(PAGE.read_text("utf-8"))
    return {test: (float(printed), float(mended)) for test, printed, mended in found}


@pytest.fixture
def compare(request: pytest.FixtureRequest) -> Compare:
    """Compare what the test measured with what the page says of it."""

    def both(printed: Any, mended: Any) -> None:
        printed_said, mended_said = said()[request.node.name]
        off, left = float(np.max(np.abs(printed))), float(np.max(np.abs(mended)))
        assert off == pytest.approx(printed_said, rel=0.02), f"printed off by {off:.3g}"
        assert left <= mended_said, f"mended off by {left:.3g}"
        assert mended_said < 0.1 * printed_said

    return both


def test_the_page_and_the_tests_name_each_other() -> None:
    measuring = [
        node.name
        for node in ast.parse(Path(__file__).read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef) and "compare" in [a.arg for a in node.args.args]
    ]
    page = PAGE.read_text("utf-8")
    assert list(said()) == measuring
    numbers = [int(n) for n in re.findall(r"^### (\d+)\. ", page, re.MULTILINE)]
    assert numbers == list(range(1, len(measuring) + 1))
    assert set(re.findall(r"`(test_\w+)`", page)) >= set(measuring)


@cache
def well() -> Mechanics:
    return particle()


def quiet_run(mechanics: Mechanics, rule: Any, step: float = H, n_steps: int = 8) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            mechanics.system, mechanics.start, step=step, n_steps=n_steps, method=rule,
            compile=False,
        )


# Section 2.


def test_equation_5_has_its_projector_on_both_sides(compare: Compare) -> None:
    mechanics = particle(curved=True)
    q, v = mechanics.base, mechanics.velocity
    d = derivative(mechanics.metric, q)
    lowered = 0.5 * (np.einsum("jik->ijk", d) + np.einsum("kij->ijk", d) - d)
    metric = mechanics.metric(q)
    curving = np.linalg.solve(metric, np.einsum("ijk,j,k->i", lowered, v, v))
    bend = mechanics.accelerations(q, v)[0] + curving
    along = mechanics.projectors(q)[0].T
    pull = along @ np.linalg.solve(metric, mechanics.force(q))
    compare(printed=bend + pull, mended=along @ bend + pull)


# Section 4.


def test_equation_9b_is_not_gauge_invariant(compare: Compare) -> None:
    """L + dS/dt has the motion of L; (9b) moves elsewhere unless Pi = dS is put beside it."""
    mechanics = particle(curved=True)
    q0 = mechanics.base
    q1 = q0 + H * mechanics.velocity

    def gauge(x: Any) -> Any:
        return 0.6 * x[0] * x[1] - 0.4 * np.cos(x[2] + x[0])

    action = discrete_lagrangian(mechanics, A, H)
    mu = mechanics.rows(q1)
    gradients, form = mu @ np.linalg.inv(mechanics.metric(q1)), derivative(gauge, q1)

    def regauged(a: Any, b: Any) -> Any:
        return action(a, b) + gauge(b) - gauge(a)

    def follower(offset: Any) -> Any:
        arrive = slots(regauged, q0, q1)[1]

        def residual(unknown: Any) -> Any:
            leave = slots(regauged, q1, unknown[:3])[0]
            first = leave + arrive - mu.T @ unknown[3:]
            return np.concatenate([first, gradients @ (leave - arrive + 2 * offset)])

        return solve(residual, np.append(2 * q1 - q0, np.zeros(1)))[:3]

    wanted, _ = by_multipliers(mechanics, A, H, q0, q1)
    system = gni.MechanicalSystem(
        mechanics.system.space,
        metric=lambda x, p: mechanics.metric(x),
        constraints=lambda x, p: mechanics.rows(x),
        potential=lambda x, p: mechanics.potential(x),
        # constant, so that h <A, v> is S(q1) - S(q0) for every rule
        gyroscopic=[0.5, -0.3, 0.8],
    )
    flat = gni.next_arrow(system, A, np.append(q0, q1), step=H)[3:]
    close(flat, wanted, 3e-15)
    compare(printed=follower(np.zeros(3)) - wanted, mended=follower(form) - wanted)


# Section 5.


def defect(step: Callable[[Any], Any], y: Any) -> Any:
    """``J^T S J - S`` of a map of (q, p), S the symplectic matrix."""
    n = len(y) // 2
    form = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    slope = derivative(step, y).T
    return slope.T @ form @ slope - form


def test_euler_a_and_b_as_displayed_are_not_symplectic(compare: Compare) -> None:
    """Printed, A is the explicit Euler method (and B the implicit one)."""
    mechanics = free(well())
    inverse = np.linalg.inv(mechanics.metric(mechanics.base))

    def force(q: Any) -> Any:
        # derivative() is no complex step of a complex argument
        return 1.6 * (q @ q) * q + np.array([0.3 * q[2], 0.0, 0.3 * q[0] + 0.5])

    def printed(y: Any) -> Any:
        q, p = y[:3], y[3:]
        return np.concatenate([q + H * inverse @ p, p - H * force(q)])

    def mended(y: Any) -> Any:
        q, p = y[:3], y[3:] - H * force(y[:3])
        return np.concatenate([q + H * inverse @ p, p])

    run = quiet_run(mechanics, A, n_steps=1)
    y = np.concatenate([run.base[0], run.momenta[0]])
    there = np.concatenate([run.base[1], run.momenta[1]])
    close(mended(y), there, 2e-15)
    assert np.abs(printed(y) - there).max() > 1e-3
    compare(printed=defect(printed, y), mended=defect(mended, y))


def test_shake_of_remark_5_1_looks_back(compare: Compare) -> None:
    mechanics = well()
    run = quiet_run(mechanics, RATTLE)
    q, inverse = run.base, np.linalg.inv(mechanics.metric(run.base[0]))
    printed, mended = [], []
    for k in range(1, len(run) - 1):
        force = mechanics.force(q[k]) - mechanics.rows(q[k]).T @ run.multipliers[k]
        right = -(H**2) * inverse @ force
        printed.append(q[k + 1] - 2 * q[k] + q[k + 1] - right)
        mended.append(q[k + 1] - 2 * q[k] + q[k - 1] - right)
    compare(printed, mended)


def test_23c_leaves_the_multiplier_free(compare: Compare) -> None:
    """(23c) is (14c) at the start, true whatever lambda~_{k+1} is; (14e) decides it."""
    mechanics = well()
    q, inverse = mechanics.base, np.linalg.inv(mechanics.metric(mechanics.base))
    p = mechanics.metric(q) @ mechanics.velocity + H / 2 * mechanics.projectors(q)[
        1
    ] @ mechanics.force(q)
    multiplier = np.array([0.4])
    q1, half = leap(mechanics, H, q, p, multiplier)
    p1, next_multiplier = land(mechanics, -1.0, H, q1, half)
    mu0, mu1 = mechanics.rows(q), mechanics.rows(q1)

    def misses(momentum: Any, found: Any) -> tuple[Any, Any, Any]:
        force = mechanics.force(q1) + mu0.T @ multiplier + mu1.T @ found
        kicked = p - H / 2 * (mechanics.force(q) + force) - momentum
        start = mu0 @ inverse @ (momentum + H / 2 * force)
        end = mu1 @ inverse @ (momentum - H / 2 * mechanics.force(q1))
        return kicked, start, end

    moved = misses(p1 - H / 2 * mu1.T @ np.ones(1), next_multiplier + 1.0)
    close(np.concatenate(moved[:2]), 0, 1e-15)
    right = misses(p1, next_multiplier)
    close(np.concatenate(right), 0, 1e-15)
    compare(printed=moved[2], mended=right[2])


def backwards_b() -> dict[str, Any]:
    """The quantities of the proof of theorem 5.4: a state, and F_B^{-h} of it."""
    mechanics = well()
    q = mechanics.base
    p = mechanics.metric(q) @ mechanics.velocity - H / 2 * mechanics.projectors(q)[
        1
    ] @ mechanics.force(q)
    here = (q, p, np.array([0.4]))
    return {"mechanics": mechanics, "here": here, "there": one_step(mechanics, -1.0, -H, *here)}


def test_the_display_in_the_proof_of_theorem_5_4(compare: Compare) -> None:
    mechanics, (q, p, found), (q1, p1, found1) = backwards_b().values()
    inverse = np.linalg.inv(mechanics.metric(q))
    left = -H / 2 * inverse @ mechanics.rows(q1).T @ found1
    turn = H / 2 * inverse @ mechanics.rows(q).T @ found
    f, f1 = H / 2 * mechanics.force(q), H / 2 * mechanics.force(q1)
    printed = -inverse @ p - f - inverse @ p1 + f1 + turn
    mended = inverse @ (p + f - p1 + f1) + turn
    # with M^-1 in its place the printed signs do no harm after mu(q_k), which the proof applies
    in_the_proof = mechanics.rows(q) @ (inverse @ (-p - f - p1 + f1) + turn - left)
    close(in_the_proof, 0, 2e-15)
    compare(printed=printed - left, mended=mended - left)


def test_definition_5_3_holds_on_the_constraint_only(compare: Compare) -> None:
    mechanics, here, there = backwards_b().values()
    off = (here[0], here[1] + 0.2, here[2])
    back = one_step(mechanics, 1.0, H, *one_step(mechanics, -1.0, -H, *off))
    again = one_step(mechanics, 1.0, H, *there)
    compare(
        printed=np.concatenate([b - a for a, b in zip(off, back, strict=True)][:2]),
        mended=np.concatenate([b - a for a, b in zip(here, again, strict=True)]),
    )


def test_the_free_composition_of_remark_5_5_goes_the_other_way(compare: Compare) -> None:
    mechanics = free(well())
    inverse, force = np.linalg.inv(mechanics.metric(mechanics.base)), mechanics.force
    q, p = mechanics.base, mechanics.metric(mechanics.base) @ mechanics.velocity

    def flow_a(q: Any, p: Any) -> tuple[Any, Any]:
        p = p - H / 2 * force(q)
        return q + H / 2 * inverse @ p, p

    def flow_b(q: Any, p: Any) -> tuple[Any, Any]:
        q = q + H / 2 * inverse @ p
        return q, p - H / 2 * force(q)

    half = p - H / 2 * force(q)
    moved = q + H * inverse @ half
    display = np.concatenate([moved, half - H / 2 * force(moved)])
    run = quiet_run(mechanics, RATTLE, n_steps=1)
    close(display, np.append(run.base[1], run.momenta[1]), 2e-15)
    compare(
        printed=np.concatenate(flow_a(*flow_b(q, p))) - display,
        mended=np.concatenate(flow_b(*flow_a(q, p))) - display,
    )


def test_the_constrained_composition_of_remark_5_5_does_not_converge(compare: Compare) -> None:
    """(13) and (14) by h/2 in turn, through (q, p~, lambda~), and as flows of (8) on T*Q.

    mu p~ wants + (h/4) V_q in one and - (h/4) V_q in the other: the normal part of p_{k+1/2} falls
    by h mu M^-1 V_q a step, as if there were no constraint.
    """
    mechanics, end, n = well(), 1.2, 320
    q, v = mechanics.base, mechanics.velocity
    exact, mass = mechanics.exact(end)[0], mechanics.metric(q)
    across = mechanics.projectors(q)[1]
    multiplier = -mechanics.accelerations(q, v)[1]

    def through_the_variables(n: int) -> Any:
        h = end / n / 2
        state = (q, mass @ v - h / 2 * across @ mechanics.force(q), multiplier)
        for _ in range(n):
            state = one_step(mechanics, 1.0, h, *one_step(mechanics, -1.0, h, *state))
        return state[0]

    def reflected(q: Any, p: Any) -> Any:
        along, across = mechanics.projectors(q)
        return (along - across) @ p

    there, p, drift = q, mass @ v, end / n / 2 * np.linalg.inv(mass)
    for _ in range(n):
        there = there + drift @ p
        kick = end / n / 2 * mechanics.force(there)
        p = reflected(there, p - kick) - kick
        there = there + drift @ p
        p = reflected(there, p)
    printed, coarse = (through_the_variables(k) - exact for k in (n, n // 4))
    assert np.abs(printed).max() > 0.9 * np.abs(coarse).max()
    compare(printed=printed, mended=there - exact)


def test_the_composition_through_the_printed_variables_falls_freely() -> None:
    """With a constant row and force, mu M^-1 p_{k+1/2} is that of a free fall, not O(h)."""
    mass, force, row = np.diag([1.3, 0.8]), np.array([0.4, 0.7]), np.array([[0.6, 0.9]])
    mechanics = Mechanics(
        "falling", lambda x: mass, lambda x: row, lambda x: force @ x, None, np.zeros(2), [0.9, 0.0]
    )
    h, n = 0.01, 100
    across = mechanics.projectors(mechanics.base)[1]

    def normal(signs: tuple[float, float]) -> Any:
        p = mass @ mechanics.velocity - signs[1] * h / 2 * across @ force
        state = (mechanics.base, p, -mechanics.accelerations(mechanics.base, p)[1])
        for _ in range(n):
            for sign in signs:
                state = one_step(mechanics, sign, h, *state)
        half = leap(mechanics, h, *state)[1]
        return row @ np.linalg.solve(mass, half)

    fallen = -2 * n * h * row @ np.linalg.solve(mass, force)
    assert np.abs(fallen).max() > 1.5
    close(normal((-1.0, 1.0)), fallen, 2 * h)
    close(normal((0.0, 0.0)), 0, 1e-14)


# Section 7.


def spun(omega: Any, h: float) -> Any:
    """``(dcay^-1_{h omega})^* omega = (1 + h^2 |omega|^2 / 4) omega``."""
    return (1 + h * h * (omega @ omega) / 4) * omega


def ball_projectors(m: float, r: float, i: float, i1: float, i2: float) -> tuple[Any, Any]:
    """(43), and (44) with its I_1, I_2."""
    q_map = np.zeros((5, 5))
    q_map[0, [0, 3]], q_map[1, [1, 2]] = [i, -r * i], [i, r * i]
    q_map[2, [1, 2]], q_map[3, [0, 3]] = [m * r, m * r * r], [-m * r, m * r * r]
    p_map = np.zeros((5, 5))
    p_map[0, [0, 3]], p_map[1, [1, 2]] = [m * r * r, r * i2], [m * r * r, -r * i1]
    p_map[2, [1, 2]], p_map[3, [0, 3]] = [-m * r, i1], [m * r, i2]
    p_map[4, 4] = m * r * r + i
    return p_map / (m * r * r + i), q_map / (m * r * r + i)


def ball_end(h: float, n: int, sign: float, d3: float = 1.0) -> Any:
    """Where n steps of (45) lead the ball of figure 1, in plain NumPy.

    sign : of 2 Q* Pi in (45b).  d3 : D_3 l_d is ``d3 I omega``.
    """
    m, r, i, table = 1.0, 1.0, 2 / 3, 1.0
    along, across = (x.T for x in ball_projectors(m, r, i, i, i))
    q, v, omega = np.array([1.0, 1.0]), np.array([1.0, 1.0]), np.array([0.0, 2.0, 0.0])
    for _ in range(n):
        q = q + h * v
        p = np.concatenate([m * v, d3 * i * spun(omega, h)])
        offset = np.array([-m * table * q[1], m * table * q[0], 0.0, 0.0, 0.0])
        p = along @ p - across @ (p + sign * 2 * offset)
        v, size = p[:2] / m, np.linalg.norm(p[2:]) / (d3 * i)
        speed = size
        for _ in range(50):
            speed -= (speed + h * h * speed**3 / 4 - size) / (1 + 0.75 * h * h * speed**2)
        omega = p[2:] / np.linalg.norm(p[2:]) * speed
    return q


def ball_errors(**options: Any) -> Any:
    scene = gni.scenes.rolling_ball()
    assert scene.exact is not None
    return ball_end(H, 100, **options) - scene.exact(np.array([10.0]))[0][0]


def test_38b_and_45b_have_the_wrong_sign(compare: Compare) -> None:
    scene = gni.scenes.rolling_ball()
    g = scene.system.space.retract(scene.start.base, H * scene.start.velocity)
    for _ in range(9):
        g = gni.next_arrow(scene.system, A, g, step=H)
    close(scene.system.space.target(g), ball_end(H, 10, -1.0), 1e-13)
    compare(printed=ball_errors(sign=1.0), mended=ball_errors(sign=-1.0))


def test_45_and_46_take_the_derivative_by_the_arrow(compare: Compare) -> None:
    """D_3 l_d by omega is h I omega, by sigma = h omega it is I omega: only this one is FL."""
    compare(printed=ball_errors(sign=-1.0, d3=H), mended=ball_errors(sign=-1.0))


def test_44_means_one_moment_of_inertia(compare: Compare) -> None:
    m, r, i = 1.7, 0.8, 0.6
    along, across = ball_projectors(m, r, i, 0.9, 0.5)
    right, _ = ball_projectors(m, r, i, i, i)
    compare(printed=along + across - np.eye(5), mended=right + across - np.eye(5))


def test_the_scheme_of_7_4_1_is_of_order_two(compare: Compare) -> None:
    counts = [50, 100, 200, 400]
    scene = gni.scenes.rolling_ball()
    assert scene.exact is not None
    exact = scene.exact(np.array([10.0]))[0][0]
    gaps = [np.abs(ball_end(10.0 / n, n, -1.0) - exact).max() for n in counts]
    found = slope(10.0 / np.array(counts), gaps)
    compare(printed=found - 1.0, mended=found - 2.0)


def free_body(h: float, n: int, inertia: Any, left: bool) -> Any:
    """omega after n steps of (45) without constraints; ``left``: the printed Legendre maps."""
    side = 1.0 if left else -1.0

    def transforms(omega: Any) -> tuple[Any, Any]:
        sigma = h * omega
        inverse = np.eye(3) - hat(sigma) / 2 + np.outer(sigma, sigma) / 4
        minus = inverse if side > 0 else inverse.T
        return minus.T @ inertia @ omega, minus @ inertia @ omega

    omega = np.array([0.9, -0.4, 1.1])
    for _ in range(n):
        p = transforms(omega)[1]
        omega = solve(lambda w, p=p: transforms(w)[0] - p, omega)
    return omega


def test_45_has_the_legendre_maps_of_body_velocities(compare: Compare) -> None:
    inertia, h, n = np.diag([0.8, 1.3, 1.7]), 0.05, 40
    body = gni.MechanicalSystem(gni.SO3(side="right"), metric=inertia)
    start = body.state(velocity=[0.9, -0.4, 1.1])
    truth = gni.integrate(body, start, step=h, n_steps=n, method=gni.ReferenceFlow(rtol=1e-12))
    alike = np.eye(3) * 1.3
    close(free_body(h, 5, alike, left=True), free_body(h, 5, alike, left=False), 1e-14)
    compare(
        printed=free_body(h, n, inertia, left=True) - truth.velocities[-1],
        mended=free_body(h, n, inertia, left=False) - truth.velocities[-1],
    )


def test_37c_inverts_the_base_block_alone(compare: Compare) -> None:
    coupled = np.diag([1.4, 0.9, 0.8, 1.2, 0.7]) + 0.12 * np.outer([1, -1, 2, 1, -2], np.ones(5))
    metric = (coupled + coupled.T) / 2
    system = gni.MechanicalSystem(
        gni.AtiyahGroupoid(2, gni.SO3()), metric=metric,
        constraints=lambda x, p: np.array([[1.0, 0.2, -0.4, np.sin(x[0]), 0.3]]),
        potential=lambda x, p: 0.5 * x[0] ** 2 + 0.3 * np.cos(x[1]),
    )
    start = system.state([0.4, -0.3], [0.7, 0.5, 0.9, -0.6, 0.4], project_start=True)
    run = gni.integrate(system, start, step=H, n_steps=8, method=RATTLE, compile=False)
    velocity = run.rows[1:, run.layout.size : -1]
    half = velocity @ metric[:, :2]
    push = half - velocity[:, 2:] @ metric[2:, :2]
    moved = np.diff(run.base, axis=0)
    compare(
        printed=moved - H * push @ np.linalg.inv(metric)[:2, :2],
        mended=moved - H * push @ np.linalg.inv(metric[:2, :2]),
    )


def test_figure_1_has_a_table_that_turns_at_one(compare: Compare) -> None:
    """Its data satisfy (41) with Theta = 1; Omega = 1 would leave the table at rest."""
    (x, y, vx, vy), omega, r = (1.0, 1.0, 1.0, 1.0), (0.0, 2.0, 0.0), 1.0

    def rolling(table: float) -> Any:
        return np.array([vx - r * omega[1] + table * y, vy + r * omega[0] - table * x])

    compare(printed=rolling(0.0), mended=rolling(1.0))


@pytest.mark.slow
def test_figure_3_needs_the_spin_about_the_vertical(compare: Compare) -> None:
    """The data leave it open: x(100) for a spin of 0.2 against 0, and for 0 with half the step."""

    def far(spin: float, step: float) -> Any:
        scene = gni.scenes.inhomogeneous_ball(vertical_spin=spin)
        run = gni.integrate(scene.system, scene.start, step=step, t_end=100.0, save_every=10_000)
        return run.base[-1, 0]

    there = far(0.0, 1e-3)
    assert abs(far(0.05, 1e-3) - there) > 3.0
    compare(printed=far(0.2, 1e-3) - there, mended=far(0.0, 5e-4) - there)
