"""What the integrators keep: constraints, symplectic form, symmetry, reversibility, energy."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni.integrators import compiled_step

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

RULES = [gni.EulerA(), gni.EulerB(), gni.Rattle(), gni.Midpoint()]
METHODS = [*RULES, gni.GNI(), gni.GNI(flow=gni.Variational(gni.Midpoint()))]
EXPENSIVE = ("SO4 left exp", "SO4 right exp")
NAMES = [name for name in zoo.SPACES if name not in EXPENSIVE]
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def run_quietly(*args: Any, **options: Any) -> gni.Trajectory:
    """``integrate`` without the warning of the parasitic mode, which has tests of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(*args, **options)


def worst_residual(a: zoo.Animal, run: gni.Trajectory) -> float:
    """Largest |mu (xi - Y)| over nodes and rows, in plain NumPy.

    Relative to |mu| times the sizes of what cancels: the velocities before and after the impact,
    Y and G^-1 A (the mean velocity itself may pass through zero).
    """
    worst = 0.0
    for x, *momenta in zip(run.base, run.momenta_before, run.momenta_after, strict=True):
        form = a.plain.gyroscopic(x)
        inverse = np.linalg.inv(a.plain.metric(x))
        before, after = (inverse @ (p - form) for p in momenta)
        mu, drift = a.plain.constraints(x), a.plain.drift(x)
        size = sum(np.linalg.norm(v) for v in (before, after, drift, inverse @ form))
        for row in mu:
            residual = abs(row @ ((before + after) / 2 - drift))
            worst = max(worst, residual / (np.linalg.norm(row) * size))
    return worst


# Constraints.


@pytest.mark.parametrize("name", NAMES)
def test_mean_momentum_satisfies_the_constraint_at_every_node(name: str) -> None:
    number = NAMES.index(name)
    a = zoo.animal(name, 1 + number % 3, affine=number % 2 == 0, gyroscopic=number % 5 == 0)
    methods = [gni.GNI(), RULES[number % 4]]
    for method in methods if a.system.constraint_count else []:
        run = run_quietly(a.system, a.start, step=0.06, n_steps=40, method=method, compile=False)
        assert worst_residual(a, run) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("affine", [False, True], ids=["linear", "affine"])
@pytest.mark.parametrize("name", zoo.SPACES)
def test_mean_momentum_satisfies_the_constraint_for_all_methods(
    name: str, affine: bool, m: int
) -> None:
    a = zoo.animal(name, m, affine=affine, gyroscopic=True, seed=11)
    if a.system.constraint_count:
        for method in METHODS if name not in EXPENSIVE else METHODS[2:3]:
            run = run_quietly(a.system, a.start, step=0.05, n_steps=100, method=method)
            assert worst_residual(a, run) < 1e-13


@pytest.mark.parametrize("name", ["pair 3", "SO3 right cay", "framed left cay"])
def test_reported_residuals_are_the_plain_ones(name: str) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    run = run_quietly(a.system, a.start, step=0.05, n_steps=20, method=gni.Rattle())
    expected = [
        a.plain.constraints(x)
        @ (np.linalg.solve(a.plain.metric(x), p - a.plain.gyroscopic(x)) - a.plain.drift(x))
        for x, p in zip(run.base, run.momenta, strict=True)
    ]
    np.testing.assert_allclose(run.constraint_residuals(), expected, atol=1e-14)
    energies = [
        0.5 * v @ a.plain.metric(x) @ v + a.plain.potential(x)
        for x, v in zip(run.base, run.velocities, strict=True)
    ]
    np.testing.assert_allclose(run.energy(), energies, rtol=1e-13)


def test_relative_residual_of_a_one_term_constraint_is_round_off_too() -> None:
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35)
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=50)
    assert np.abs(run.constraint_residuals(relative=True)).max() < 1e-12


# No constraints: the free variational integrator.


def phase_map(a: zoo.Animal, method: Any, h: float) -> Any:
    """(x, p) -> (x', p') of one step, through ``integrate``."""
    n = a.system.space.base_size

    def step(y: Any) -> Any:
        x, p = y[:n], y[n:]
        velocity = np.linalg.solve(a.plain.metric(x), p - a.plain.gyroscopic(x))
        run = gni.integrate(a.system, a.system.state(x, velocity), step=h, n_steps=1, method=method)
        return np.concatenate([run.base[-1], run.momenta_after[-1]])

    return step


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_without_constraints_the_step_is_symplectic(method: Any) -> None:
    a = zoo.animal("pair 2", 0, gyroscopic=True, space=gni.PairGroupoid(2))
    step, delta = phase_map(a, method, 0.13), 0.02
    y = np.concatenate([a.start.base, a.start.momentum])
    columns = [
        _WEIGHTS @ [step(y + s * delta * e) for s in np.arange(-4, 5)] / delta for e in np.eye(4)
    ]
    slope = np.array(columns).T
    form = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
    np.testing.assert_allclose(slope.T @ form @ slope, form, atol=1e-11)
    assert np.abs(slope - np.eye(4)).max() > 0.05


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_without_constraints_the_discrete_euler_lagrange_equations_6_hold(rule: Any) -> None:
    a = zoo.animal("pair 3", 0, gyroscopic=True)
    h, space, delta = 0.1, a.system.space, 4e-3

    def action(x0: Any, x1: Any) -> float:
        return h * rule.average(a.plain.lagrangian, space, x0, x1, (x1 - x0) / h, h)

    q = gni.integrate(a.system, a.start, step=h, n_steps=6, method=rule).base
    for before, here, after in zip(q, q[1:], q[2:], strict=False):
        residual = [
            _WEIGHTS
            @ [
                action(here + s * delta * e, after) + action(before, here + s * delta * e)
                for s in np.arange(-4, 5)
            ]
            / delta
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(residual, 0.0, atol=2e-12)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_noether_momentum_of_a_symmetric_potential_is_kept(method: Any) -> None:
    # Rotations commute with the kinetic energy and with the even quartic well.
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=1.7 * np.eye(2),
        potential=lambda x, p: p.k * (x @ x) ** 2 - 0.9 * (x @ x), parameters={"k": 0.6},
    )
    start = system.state([0.8, -0.3], [0.5, 0.9])
    run = gni.integrate(system, start, step=0.1, n_steps=400, method=method)
    moment = run.base[:, 0] * run.momenta[:, 1] - run.base[:, 1] * run.momenta[:, 0]
    np.testing.assert_allclose(moment, moment[0], rtol=1e-12)


@pytest.mark.parametrize("tau", [gni.Cayley(), gni.Exponential()])
@pytest.mark.parametrize("side", ["left", "right"])
def test_noether_momentum_of_a_free_body_is_kept(side: Any, tau: Any) -> None:
    body = gni.MechanicalSystem(gni.SO3(side=side, retraction=tau), metric=np.diag([0.8, 1.3, 1.7]))
    start = body.state(velocity=[0.9, -0.4, 1.1])
    first = gni.SO3().exp(np.array([0.3, -0.8, 0.5]))
    for method in METHODS:
        run = gni.integrate(body, start, step=0.1, n_steps=300, method=method)
        w, p = run.reconstruct(first), run.momenta
        moment = np.einsum("nij,nj->ni" if side == "left" else "nji,nj->ni", w, p)
        np.testing.assert_allclose(moment, np.broadcast_to(moment[0], moment.shape), atol=2e-13)


# Time symmetry.


@pytest.mark.parametrize("name", NAMES)
def test_gni_run_backwards_returns(name: str) -> None:
    number = NAMES.index(name)
    a = zoo.animal(name, 1 + number % 3, affine=number % 2 == 1, gyroscopic=number % 5 == 0)
    options = {"n_steps": 50, "compile": number % 7 == 0}
    there = gni.integrate(a.system, a.start, step=0.06, **options)
    turned = a.system.state(*there.final_state) if there.base.shape[1] else a.system.state(
        velocity=there.velocities[-1]
    )
    back = gni.integrate(a.system, turned, step=-0.06, **options)
    np.testing.assert_allclose(back.base, there.base[::-1], atol=1e-12)
    np.testing.assert_allclose(back.momenta, there.momenta[::-1], atol=1e-12)


@pytest.mark.parametrize("rule", [gni.Rattle(), gni.Midpoint()], ids=str)
def test_symmetric_two_step_rules_run_backwards_along_the_same_arrows(rule: Any) -> None:
    a = zoo.animal("atiyah right cay", 2, affine=True)
    space, h = a.system.space, 0.08
    g = space.retract(a.start.base, h * a.start.velocity)
    arrows = [g]
    for _ in range(20):
        arrows.append(gni.next_arrow(a.system, rule, arrows[-1], step=h))
    g = space.inverse(arrows[-1])
    for expected in arrows[-2::-1]:
        g = gni.next_arrow(a.system, rule, g, step=-h)
        np.testing.assert_allclose(g, space.inverse(expected), atol=1e-12)


# The parasitic mode and energy.


def test_a_projected_start_is_taken_again_by_integrate() -> None:
    # The projection leaves a round-off in the only velocity component its row sees.
    system = gni.MechanicalSystem(gni.SO3(), metric=1.37 * np.eye(3), constraints=[[2.5, 0, 0]])
    start = system.state(velocity=[0.9, -0.7, 0.8], project_start=True)
    run = gni.integrate(system, start, step=0.1, n_steps=3)
    again = system.state(velocity=run.velocities[-1])
    np.testing.assert_allclose(again.velocity, run.velocities[-1], atol=1e-15)


def test_gni_has_no_parasitic_growth_on_the_sleigh_and_keeps_its_energy() -> None:
    scene = gni.scenes.chaplygin_sleigh()  # the case of DESIGN 2.1
    for h, allowed in ((0.1, 8e-3), (0.05, 2e-3)):
        run = gni.integrate(scene.system, scene.start, step=h, t_end=100.0)
        exact = scene.exact(run.times)[1]
        assert np.abs(run.velocities - exact).max() < allowed
        np.testing.assert_allclose(run.velocities[-1], exact[-1], atol=1e-12)
        np.testing.assert_allclose(run.energy(), run.energy()[0], rtol=1e-13)


def test_rattle_warns_on_the_sleigh_before_its_error_is_large() -> None:
    scene = gni.scenes.chaplygin_sleigh()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = gni.integrate(scene.system, scene.start, step=0.05, t_end=10.0, method=gni.Rattle())
    assert np.abs(run.velocities - scene.exact(run.times)[1]).max() < 0.01
    with pytest.warns(gni.ParasiticModeWarning, match=r"Rattle\(\).* t = 1[12]\."):
        run = gni.integrate(scene.system, scene.start, step=0.05, t_end=14.0, method=gni.Rattle())
    assert np.abs(run.velocities - scene.exact(run.times)[1]).max() < 0.01
    with pytest.warns(gni.ParasiticModeWarning):
        run = gni.integrate(scene.system, scene.start, step=0.05, t_end=40.0, method=gni.Rattle())
    assert np.abs(run.velocities - scene.exact(run.times)[1]).max() > 1.0


@pytest.mark.parametrize("name", ["R3 left cay", "SO2 left cay", "pair 3", "SO3 left cay"])
def test_parasitic_monitor_is_silent_about_round_off(name: str) -> None:
    a = zoo.animal(name, 2, affine=True, curved=False, potential=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gni.integrate(a.system, a.start, step=0.05, n_steps=200, method=gni.Rattle())


@settings(max_examples=12, deadline=None)
@given(
    rows=st.lists(st.lists(st.floats(0.1, 1), min_size=3, max_size=3), min_size=1, max_size=2),
    side=st.sampled_from(["left", "right"]),
    tau=st.sampled_from([gni.Cayley(), gni.Exponential()]),
)
def test_biinvariant_metric_keeps_the_energy_for_any_distribution(
    rows: Any, side: Any, tau: Any
) -> None:
    mu = np.array(rows) + np.eye(3)[: len(rows)] * 2.5
    system = gni.MechanicalSystem(
        gni.SO3(side=side, retraction=tau), metric=1.37 * np.eye(3), constraints=mu
    )
    start = system.state(velocity=[0.9, -0.7, 0.8], project_start=True)
    for rule in RULES:
        run = run_quietly(system, start, step=0.15, n_steps=300, method=rule)
        # exactly kept from arrow to arrow: p- and p+ have one length
        for p in (run.momenta_before[1:], run.momenta_after):
            size = (p * p).sum(1)
            np.testing.assert_allclose(size, size[-1], rtol=1e-12)
        velocities = run.rows[1:, run.layout.size : -1]
        np.testing.assert_allclose((velocities**2).sum(1), (velocities[0] ** 2).sum(), rtol=1e-12)


def test_modified_energy_of_a_quadratic_well_is_kept_for_any_distribution() -> None:
    mass = np.array([[1.3, 0.2, 0.0], [0.2, 0.9, 0.1], [0.0, 0.1, 1.6]])
    well = np.array([[1.1, 0.3, -0.2], [0.3, 1.7, 0.4], [-0.2, 0.4, 0.8]])
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=mass, potential=lambda x, p: 0.5 * x @ well @ x,
        constraints=lambda x, p: np.array([[-x[1], 0.3 * x[2], 1.0]]),
    )
    start = system.state([0.7, -0.4, 0.5], [0.8, 0.6, -0.9], project_start=True)
    h = 0.2
    shifted = well - h * h / 4 * well @ np.linalg.inv(mass) @ well

    def energy(q: Any, p: Any, matrix: Any) -> Any:
        kinetic = 0.5 * np.einsum("ni,ni->n", p, np.linalg.solve(mass, p.T).T)
        return kinetic + 0.5 * np.einsum("ni,ij,nj->n", q, matrix, q)

    run = run_quietly(system, start, step=h, n_steps=2000, method=gni.Rattle())
    for p in (run.momenta_before, run.momenta_after):
        kept = energy(run.base, p, shifted)
        np.testing.assert_allclose(kept, kept[0], rtol=3e-13)
    assert np.ptp(energy(run.base, run.momenta_after, well)) > 1e-3
    run = run_quietly(system, start, step=h, n_steps=2000, method=gni.Midpoint())
    for p in (run.momenta_before, run.momenta_after):
        kept = energy(run.base, p, well)
        np.testing.assert_allclose(kept, kept[0], rtol=3e-13)
    run = gni.integrate(system, start, step=h, n_steps=2000)
    kept = energy(run.base, run.momenta, well - h * h / 16 * well @ np.linalg.solve(mass, well))
    assert np.ptp(kept) < 0.02 * abs(kept[0])


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_a_constant_one_form_changes_nothing(method: Any) -> None:
    shared: dict[str, Any] = {
        "space": gni.PairGroupoid(3),
        "metric": lambda x, p: np.diag([1.3 + x[1] ** 2, 0.9, 1.6]),
        "constraints": lambda x, p: np.array([[-x[1], 0.0, 1.0]]),
        "drift": lambda x, p: np.array([0.0, 0.2, 0.3 * x[0]]),
        "potential": lambda x, p: 0.4 * (x @ x) ** 2,
    }
    plain = gni.MechanicalSystem(**shared)
    gauged = gni.MechanicalSystem(**shared, gyroscopic=[0.7, -0.3, 1.1])
    x, v = [0.3, -0.5, 0.2], [0.8, 0.6, 0.1]
    runs = [
        run_quietly(
            system, system.state(x, v, project_start=True), step=0.05, n_steps=200, method=method
        )
        for system in (plain, gauged)
    ]
    np.testing.assert_allclose(runs[0].base, runs[1].base, atol=3e-13)
    np.testing.assert_allclose(runs[0].velocities, runs[1].velocities, atol=3e-13)


# Equation (49) for one arrow.


@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("name", zoo.SMALL)
def test_next_arrow_agrees_with_integrate(name: str, rule: Any) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    h = 0.07
    run = run_quietly(a.system, a.start, step=h, n_steps=12, method=rule, compile=False)
    for g, following in zip(run.arrows, run.arrows[1:], strict=False):
        found = gni.next_arrow(a.system, rule, g, step=h)
        np.testing.assert_allclose(found, following, atol=1e-13)


@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize("name", ["pair 3", "SE3 left cay", "atiyah left exp", "action right cay"])
def test_next_arrow_solves_the_projector_equations_49_and_38_literally(
    name: str, rule: Any
) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    space, h, delta = a.system.space, 0.09, 4e-3
    g = space.retract(a.start.base, h * a.start.velocity)
    follower = gni.next_arrow(a.system, rule, g, step=h)
    q = space.target(g)

    def action(arrow: Any) -> float:
        xi = space.lift(arrow) / h
        ends = space.source(arrow), space.target(arrow)
        return h * rule.average(a.plain.lagrangian, space, *ends, xi, h)

    steps = delta * np.arange(-4, 5)
    plus = [
        _WEIGHTS @ [action(space.multiply(g, space.retract(q, s * e))) for s in steps] / delta
        for e in np.eye(space.rank)
    ]
    minus = [
        -_WEIGHTS
        @ [action(space.multiply(space.inverse(space.retract(q, s * e)), follower)) for s in steps]
        / delta
        for e in np.eye(space.rank)
    ]
    plus, minus = np.array(plus), np.array(minus)
    along, across = a.plain.projectors(q)
    np.testing.assert_allclose(along @ (minus - plus), 0, atol=5e-12)
    mended = across @ (minus + plus) - 2 * across @ a.plain.offset(q)
    np.testing.assert_allclose(mended, 0, atol=5e-12)


def test_the_printed_sign_of_38b_would_be_wrong() -> None:
    """With + 2 Q* Pi the ball of section 7.4.1 leaves the true motion by O(10) (DESIGN 1.4)."""
    scene = gni.scenes.rolling_ball()
    system, h = scene.system, 0.1
    mirrored = gni.MechanicalSystem(
        system.space,
        metric=lambda x, p: np.diag([p.m, p.m, p.I, p.I, p.I]),
        constraints=[[1.0, 0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 1.0, 0.0, 0.0]],
        drift=lambda x, p: -p.Theta * np.array([-x[1], x[0], 0.0, 0.0, 0.0]),
        parameters={"m": 1.0, "I": 2 / 3, "Theta": 1.0},
    )
    gaps = []
    for body in (system, mirrored):
        g = system.space.retract(scene.start.base, h * scene.start.velocity)
        for _ in range(99):
            g = gni.next_arrow(body, gni.EulerA(), g, step=h)
        exact = scene.exact(np.array([10.0]))[0][0]
        gaps.append(np.linalg.norm(system.space.target(g) - exact))
    assert gaps[0] < 0.3
    assert gaps[1] > 3.0


# Arrows and reconstruction.


@pytest.mark.parametrize("method", [gni.Rattle(), gni.GNI()], ids=str)
@pytest.mark.parametrize(
    "name",
    ["SO3 left cay", "SO3 right exp", "SE3 right cay", "atiyah right cay", "action left cay"],
)
def test_reconstruction_afterwards_is_reconstruction_in_the_loop(name: str, method: Any) -> None:
    a = zoo.animal(name, 1)
    group = getattr(a.system.space, "group", a.system.space)
    first = group.tau(np.linspace(-0.5, 0.4, group.dimension))
    options = {"step": 0.05, "n_steps": 120, "method": method}
    after = run_quietly(a.system, a.start, **options)
    inside = run_quietly(a.system, a.start, **options, reconstruct=first)
    poses = after.reconstruct(first)
    np.testing.assert_allclose(poses, inside.reconstruct(), atol=2e-13)
    np.testing.assert_array_equal(after.base, inside.base)
    space = a.system.space
    w = first
    for k, g in enumerate(after.arrows):
        element = space.pose(g)
        w = w @ element if group.side == "left" else element @ w
        np.testing.assert_allclose(poses[k + 1], w, atol=2e-13)


@pytest.mark.parametrize("name", ["pair 3", "framed right cay", "product cay"])
@pytest.mark.parametrize("method", [gni.Midpoint(), gni.GNI()], ids=str)
def test_arrows_run_from_node_to_node_and_reconstruct_the_base(name: str, method: Any) -> None:
    a = zoo.animal(name, 2)
    run = run_quietly(a.system, a.start, step=0.05, n_steps=50, method=method, compile=False)
    space = a.system.space
    np.testing.assert_allclose(space.source(run.arrows), run.base[:-1], atol=1e-13)
    np.testing.assert_allclose(space.target(run.arrows), run.base[1:], atol=1e-13)
    if name != "product cay":
        np.testing.assert_allclose(run.reconstruct(), run.base, atol=2e-13)


# The driver: saving, chunks, evaluators, files.


@pytest.mark.parametrize("method", [gni.Rattle(), gni.GNI()], ids=str)
def test_save_every_and_chunks_do_not_change_a_bit(method: Any) -> None:
    scene = gni.scenes.inhomogeneous_ball(1.7, 0.9, (0.9, 0.5, 0.7), 0.8, (0.6, -0.2), (0.3, 0.5))
    options = {"step": 0.01, "n_steps": 2500, "method": method}
    every = gni.integrate(scene.system, scene.start, **options)
    assert len(every) == 2501
    for k in (2, 7, 500, 999, 1000, 2500, 10**6):
        thinned = gni.integrate(scene.system, scene.start, **options, save_every=k)
        expected = [*range(0, 2501, k), *([2500] if 2500 % k else [])]
        np.testing.assert_array_equal(thinned.node_steps, expected)
        state = slice(0, thinned.layout.size)
        np.testing.assert_array_equal(thinned.rows[:, state], every.rows[expected, state])
        np.testing.assert_array_equal(thinned.rows[1:, -1], every.rows[expected[1:], -1])
    runner = compiled_step(scene.system, method, scene.start.active_rows)
    scales = np.ones(2)
    parameters = np.concatenate([scene.system.parameter_vector, [0.01], scales])
    begin = runner.begin(parameters, every.rows[0, state])
    at_once, rows, outcome = runner.advance(parameters, begin, 2500, 1)
    assert outcome is gni.Outcome.SUCCESS
    np.testing.assert_array_equal(rows, every.rows[1:])
    np.testing.assert_array_equal(at_once.state, every.rows[-1, state])


@pytest.mark.parametrize("method", [gni.Midpoint(), gni.GNI()], ids=str)
@pytest.mark.parametrize("name", [*zoo.SMALL, "action left exp"])
def test_casadi_evaluator_agrees_with_machine_code(name: str, method: Any) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    options = {"step": 0.02, "n_steps": 200, "method": method}
    machine = run_quietly(a.system, a.start, **options)
    evaluator = run_quietly(a.system, a.start, **options, compile=False)
    np.testing.assert_allclose(machine.base, evaluator.base, atol=1e-12)
    np.testing.assert_allclose(machine.momenta_before, evaluator.momenta_before, atol=1e-12)
    np.testing.assert_allclose(machine.momenta_after, evaluator.momenta_after, atol=1e-12)


def test_a_saved_run_is_loaded_as_it_was(tmp_path: Path) -> None:
    a = zoo.animal("atiyah right cay", 2, affine=True)
    run = gni.integrate(a.system, a.start, step=0.05, n_steps=37, save_every=5)
    path = run.save(tmp_path / "run")
    again = gni.Trajectory.load(path, a.system.with_parameters(rate=0.1))
    np.testing.assert_array_equal(again.rows, run.rows)
    np.testing.assert_array_equal(again.node_steps, run.node_steps)
    np.testing.assert_array_equal(again.velocities, run.velocities)
    np.testing.assert_array_equal(again.energy(), run.energy())
    assert (again.status, again.message, again.method_name) == (0, run.message, run.method_name)
    np.testing.assert_array_equal(again.system.parameter_vector, run.system.parameter_vector)
    with pytest.raises(gni.TrajectoryFileError, match="another system"):
        gni.Trajectory.load(path, gni.scenes.chaplygin_sleigh().system)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(gni.TrajectoryFileError, match="not a complete trajectory"):
        gni.Trajectory.load(path, a.system)


# Sizes.


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_one_degree_of_freedom_runs_through_the_same_code(method: Any) -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), metric=[[1.7]], potential=lambda x, p: p.k * x[0] ** 2 / 2,
        parameters={"k": 0.6},
    )
    h, start = 0.02, system.state([0.7], [-0.4])
    run = gni.integrate(system, start, step=h, n_steps=500, method=method)
    w, t = np.sqrt(0.6 / 1.7), run.times
    exact = 0.7 * np.cos(w * t) - 0.4 / w * np.sin(w * t)
    first_order = isinstance(method, (gni.EulerA, gni.EulerB))
    assert np.abs(run.base[:, 0] - exact).max() < (0.02 if first_order else 2e-4)
    free = gni.MechanicalSystem(gni.SO2(retraction=gni.Exponential()), metric=[[0.8]])
    turned = gni.integrate(free, free.state(velocity=[1.1]), step=h, n_steps=50, method=method)
    angle = np.arctan2(*turned.reconstruct()[-1][1::-1, 0])
    assert angle == pytest.approx(1.1, rel=1e-12)


def test_a_fully_constrained_system_stands_still_or_drifts() -> None:
    space = gni.PairGroupoid(1)
    drifting = gni.MechanicalSystem(
        space, metric=[[1.3]], constraints=[[0.7]], drift=[0.4], potential=lambda x, p: x[0] ** 2
    )
    start = drifting.state([0.2], [0.4])
    for method in (gni.Rattle(), gni.GNI()):
        run = run_quietly(drifting, start, step=0.05, n_steps=100, method=method)
        np.testing.assert_allclose(run.velocities, 0.4, atol=1e-13)
        np.testing.assert_allclose(run.base[-1], 0.2 + 0.4 * 5.0, atol=3e-3)


@pytest.mark.parametrize("method", [gni.Rattle(), gni.GNI()], ids=str)
def test_twelve_degrees_of_freedom_run_through_the_same_code(method: Any) -> None:
    a = zoo.animal("twelve", 3, affine=True, gyroscopic=True)
    assert a.system.space.rank == 12
    run = run_quietly(a.system, a.start, step=0.02, n_steps=50, method=method)
    truth = gni.integrate(
        a.system, a.start, step=0.02, n_steps=50, method=gni.ReferenceFlow(rtol=1e-10)
    )
    assert np.abs(run.base - truth.base).max() < 2e-3
    assert worst_residual(a, run) < 1e-13
