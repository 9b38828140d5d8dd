"""Reference runs: accuracy, error estimates, reconstruction, control inputs, interruptions."""

from __future__ import annotations

import signal
import sys
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni import Outcome
from groupoid_gni.codegen import CompiledFlow
from groupoid_gni.discretization import SystemExpressions, reference_field
from groupoid_gni.errors import InputError
from groupoid_gni.integrators import reference_flow as module

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

SOLVED = {
    "sleigh": lambda: gni.scenes.chaplygin_sleigh(1.4, 0.7, 0.35),
    "sleigh, backwards in time": lambda: gni.scenes.chaplygin_sleigh(1.4, 0.7, 0.2, speed=0.3),
    "Suslov": gni.scenes.suslov,
    "particle": gni.scenes.constrained_particle,
    "ball on a table": gni.scenes.rolling_ball,
    "robot": gni.scenes.two_wheeled_robot,
}
solved_scenes = pytest.mark.parametrize("name", SOLVED)


@cache
def scene(name: str) -> Any:
    return SOLVED[name]()


def run_of(name: str, rtol: float, **options: Any) -> gni.Trajectory:
    s = scene(name)
    step = -0.11 if "backwards" in name else 0.2
    arguments = {"step": step, "n_steps": 50, "method": gni.ReferenceFlow(rtol=rtol), **options}
    return gni.integrate(s.system, s.start, **arguments)


def true_errors(name: str, run: gni.Trajectory) -> Any:
    base, velocities = scene(name).exact(run.times)
    off = np.hstack([run.base - base, run.velocities - velocities])
    return np.max(np.abs(off), axis=1)


# ---------------------------------------------------------------- the field


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize(
    "name",
    ["pair 3", "SO3 left cay", "SE2 right exp", "SE3 left exp", "atiyah right cay",
     "framed left cay", "action right exp"],
)
def test_the_field_is_the_free_one_plus_the_force_of_the_multipliers(name: str, m: int) -> None:
    a = zoo.animal(name, m, affine=True, gyroscopic=True)
    e = SystemExpressions(a.system, a.start.active_rows)
    x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    along, push = e.unconstrained_field(x, p, theta)
    push = push + e.constraints(x, theta).T @ e.multipliers(x, p, theta)
    plain = ca.Function("plain", [theta, ca.vertcat(x, p)], [ca.densify(ca.vertcat(along, push))])
    field = reference_field(e)
    rng = np.random.default_rng(5)
    for _ in range(3):
        space = a.system.space
        base = space.target(space.retract(a.start.base, rng.uniform(-1, 1, e.rank)))
        point = np.concatenate([base, rng.uniform(-2, 2, e.rank)])
        numbers = a.system.parameter_vector
        np.testing.assert_allclose(field(numbers, point), plain(numbers, point), rtol=0, atol=1e-12)


def test_the_field_over_a_point_is_written_out_and_cheaper() -> None:
    sleigh = scene("sleigh")
    field = reference_field(SystemExpressions(sleigh.system, (0,)))
    theta, y = ca.SX.sym("theta", 3), ca.SX.sym("y", 3)
    curvature = ca.jacobian(ca.jacobian(field(theta, y), y), y)
    assert not ca.depends_on(curvature, y)
    assert ca.depends_on(curvature, theta)


# ---------------------------------------------------------------- accuracy


@solved_scenes
def test_the_error_at_the_end_follows_the_tolerance(name: str) -> None:
    tolerances = 10.0 ** -np.arange(6, 13)
    errors = np.array([true_errors(name, run_of(name, r, save_every=50))[-1] for r in tolerances])
    assert np.all(errors < 100 * tolerances)
    above = errors > 1e-13
    assert np.count_nonzero(above) >= 5
    slope = np.polyfit(np.log(tolerances[above]), np.log(errors[above]), 1)[0]
    assert 0.7 < slope < 1.3


@solved_scenes
def test_the_tightest_tolerance_gives_thirteen_digits(name: str) -> None:
    run = run_of(name, 1e-13)
    size = np.max(np.abs(np.hstack([run.base, run.velocities])))
    assert np.max(true_errors(name, run)) < 3e-13 * max(size, 1.0)


@solved_scenes
@pytest.mark.parametrize("rtol", [1e-4, 1e-7, 1e-10, 1e-13])
def test_the_true_error_is_below_three_estimates(name: str, rtol: float) -> None:
    run = run_of(name, rtol)
    estimate, error = run.error_estimate(), true_errors(name, run)
    assert estimate.shape == (len(run),)
    assert np.all(np.maximum.accumulate(error) <= 3 * estimate)
    assert np.all(np.diff(estimate) >= 0)
    assert estimate[-1] < 3 * np.max(error) + 1e-13 * np.max(np.abs(run.velocities))


def test_the_estimate_is_made_when_first_asked_and_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    original = CompiledFlow.begin

    def counted(self: Any, *given: Any) -> Any:
        made.append(given[2])
        return original(self, *given)

    monkeypatch.setattr(CompiledFlow, "begin", counted)
    run = run_of("Suslov", 1e-6)
    assert made == [(1e-6, 1e-8)]
    first = run.error_estimate()
    np.testing.assert_allclose(made[1:], [(1e-8, 1e-10)])
    first[:] = np.nan  # a copy: what the user does to it stays with him
    assert np.all(np.isfinite(run.error_estimate()))
    assert len(made) == 2


def test_other_methods_have_no_error_estimate(tmp_path: Any) -> None:
    run = run_of("Suslov", 1e-6, method=gni.GNI())
    with pytest.raises(InputError, match=r"no error estimate.*only ReferenceFlow.*method=gni"):
        run.error_estimate()
    reference = run_of("Suslov", 1e-6)
    back = gni.Trajectory.load(reference.save(tmp_path / "run"), reference.system)
    with pytest.raises(InputError, match="not after they were read from a file"):
        back.error_estimate()


def test_the_estimate_of_a_failed_run_covers_its_nodes() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), [[1.3]], potential=lambda x, p: -(x[0] ** 4)
    )
    run = gni.integrate(
        system, system.state([1.0], [1.0]), step=0.05, n_steps=60, on_failure="return",
        method=gni.ReferenceFlow(rtol=1e-8),
    )
    assert run.outcome is Outcome.ADAPTIVE_STEP_FAILED
    assert "round-off of the time" in run.message
    estimate = run.error_estimate()
    assert len(estimate) == len(run) > 5
    assert np.all(np.isfinite(estimate))


# ---------------------------------------------------------------- the base manifold


def test_base_points_stay_on_the_manifold_even_at_loose_tolerances() -> None:
    ball = gni.scenes.inhomogeneous_ball()
    run = gni.integrate(
        ball.system, ball.start, step=0.25, t_end=50.0, method=gni.ReferenceFlow(rtol=1e-4)
    )
    turns = run.base[:, 2:].reshape(-1, 3, 3)
    off = turns @ np.swapaxes(turns, 1, 2) - np.eye(3)
    assert np.max(np.abs(off)) < 1e-7
    precise = gni.integrate(
        ball.system, ball.start, step=0.25, t_end=50.0, method=gni.ReferenceFlow(rtol=1e-10)
    )
    turns = precise.base[:, 2:].reshape(-1, 3, 3)
    assert np.max(np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3))) < 3e-15


def test_there_and_back_again() -> None:
    ball = gni.scenes.inhomogeneous_ball()
    method = gni.ReferenceFlow(rtol=1e-12)
    forth = gni.integrate(ball.system, ball.start, step=0.3, n_steps=20, method=method)
    turned = ball.system.state(*forth.final_state, project_start=True)
    back = gni.integrate(ball.system, turned, step=-0.3, n_steps=20, method=method)
    np.testing.assert_allclose(back.base[::-1], forth.base, rtol=0, atol=1e-10)
    np.testing.assert_allclose(back.velocities[::-1], forth.velocities, rtol=0, atol=1e-10)


# ---------------------------------------------------------------- reconstruction

RECONSTRUCTED = [
    "pair 3", "SO3 left cay", "SO3 right exp", "SE2 right cay", "SE3 left exp", "atiyah left cay",
    "framed left exp", "action right cay",
]


@pytest.mark.parametrize("name", RECONSTRUCTED)
def test_reconstructed_poses_are_the_limit_of_those_of_gni(name: str) -> None:
    a = zoo.animal(name, 1, affine=True, gyroscopic=True)
    options = {"reconstruct": True}
    exact = gni.integrate(
        a.system, a.start, step=0.2, n_steps=5, method=gni.ReferenceFlow(rtol=1e-12), **options
    ).reconstruct()
    errors = []
    for n in (8, 16):
        run = gni.integrate(
            a.system, a.start, step=0.2 / n, n_steps=5 * n, save_every=n, **options
        )
        errors.append(np.max(np.abs(run.reconstruct() - exact)))
    assert errors[1] < 1e-2
    assert 3.6 < errors[0] / errors[1] < 4.4


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("retraction", [gni.Cayley(), gni.Exponential()], ids=str)
def test_a_steady_turn_is_an_exponential(side: str, retraction: Any) -> None:
    group = gni.SO3(side=side, retraction=retraction)
    system = gni.MechanicalSystem(group, 1.3 * np.eye(3))
    spin, first = np.array([0.7, -1.1, 0.4]), group.exp(np.array([0.3, 0.9, -0.2]))
    run = gni.integrate(
        system, system.state(velocity=spin), step=0.4, n_steps=12, save_every=5, reconstruct=first,
        method=gni.ReferenceFlow(rtol=1e-11),
    )
    for t, pose in zip(run.times, run.reconstruct(), strict=True):
        turn = group.exp(t * spin)
        expected = first @ turn if side == "left" else turn @ first
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-11)
        np.testing.assert_allclose(pose.T @ pose, np.eye(3), rtol=0, atol=2e-15)


def test_heading_and_path_of_the_sleigh() -> None:
    run = run_of("sleigh", 1e-12, reconstruct=True)
    poses = run.reconstruct()
    fine = np.linspace(0.0, 10.0, 4001)
    omega, along, _ = scene("sleigh").exact(fine)[1].T
    heading = np.concatenate([[0.0], np.cumsum(_simpson(omega, fine))])[:: 40]
    np.testing.assert_allclose(poses[:, 0, 0], np.cos(heading), rtol=0, atol=1e-10)
    np.testing.assert_allclose(poses[:, 1, 0], np.sin(heading), rtol=0, atol=1e-10)
    speed = np.gradient(poses[:, 0, 2], run.times, edge_order=2)
    np.testing.assert_allclose(speed, along[::80] * np.cos(heading), rtol=0, atol=0.05)


def _simpson(values: Any, times: Any) -> Any:
    """Integrals over pairs of intervals."""
    return (values[:-2:2] + 4 * values[1:-1:2] + values[2::2]) * (times[2] - times[0]) / 6


def test_reconstruction_hardly_changes_the_motion() -> None:
    bare, with_arrow = run_of("robot", 1e-9), run_of("robot", 1e-9, reconstruct=True)
    np.testing.assert_allclose(with_arrow.velocities, bare.velocities, rtol=0, atol=1e-7)
    np.testing.assert_array_less(
        true_errors("robot", with_arrow), 3 * with_arrow.error_estimate() + 1e-8
    )


# ---------------------------------------------------------------- the two evaluators


@pytest.mark.parametrize("name", ["sleigh", "robot", "ball on a table"])
def test_casadi_and_the_machine_code_agree(name: str) -> None:
    options = {"reconstruct": True, "n_steps": 20, "save_every": 3}
    one, other = (run_of(name, 1e-7, compile=compile, **options) for compile in (True, False))
    np.testing.assert_allclose(one.rows, other.rows, rtol=0, atol=1e-11)
    assert one.detail == other.detail


def test_code_is_made_once_for_all_parameters() -> None:
    sleigh = gni.scenes.chaplygin_sleigh()
    method, options = gni.ReferenceFlow(rtol=1e-9), {"step": 0.5, "n_steps": 4}
    gni.integrate(sleigh.system, sleigh.start, method=method, **options)
    runners = [v for v in sleigh.system._compiled.values() if isinstance(v, CompiledFlow)]
    other = sleigh.system.with_parameters(m=2.3)
    start = other.state(velocity=[1.5, -1.0, 0.0])
    run = gni.integrate(other, start, method=gni.ReferenceFlow(rtol=1e-5), **options)
    assert [v for v in other._compiled.values() if isinstance(v, CompiledFlow)] == runners
    exact = gni.scenes.chaplygin_sleigh(mass=2.3).exact(run.times)[1]
    np.testing.assert_allclose(run.velocities, exact, rtol=0, atol=1e-3)


# ---------------------------------------------------------------- calls, interruptions, limits


def test_progress_and_many_calls_change_no_bit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    at_once = run_of("robot", 1e-9)
    monkeypatch.setattr(module, "_FIRST_CHUNK", 3)
    monkeypatch.setattr(module, "_CHUNK_SECONDS", 0.0)
    in_calls = run_of("robot", 1e-9)
    shown = run_of("robot", 1e-9, progress=True)
    assert "50.0/50.0" in capsys.readouterr().err
    assert in_calls.rows.tobytes() == shown.rows.tobytes() == at_once.rows.tobytes()
    assert in_calls.detail == at_once.detail


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_keeps_the_nodes_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    original = CompiledFlow.advance

    def pressed(self: Any, progress: Any, attempts: int) -> int:
        calls.append(attempts)
        if len(calls) == 5:
            signal.raise_signal(signal.SIGINT)
        return original(self, progress, attempts)

    whole = run_of("robot", 1e-9)
    monkeypatch.setattr(module, "_FIRST_CHUNK", 3)
    monkeypatch.setattr(module, "_CHUNK_SECONDS", 0.0)
    monkeypatch.setattr(CompiledFlow, "advance", pressed)
    run = run_of("robot", 1e-9)
    assert run.outcome is Outcome.INTERRUPTED
    assert 1 < len(run) < 51
    assert run.rows.tobytes() == whole.rows[: len(run)].tobytes()
    assert f"after step {len(run) - 1} of 50" in run.message


def test_a_method_that_is_stuck_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MOST_ATTEMPTS", 500)
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), [[1.3]], potential=lambda x, p: 1e8 * x[0] ** 2
    )
    run = gni.integrate(
        system, system.state([0.3], [0.0]), step=5.0, n_steps=2, on_failure="return",
        method=gni.ReferenceFlow(rtol=1e-10),
    )
    assert run.outcome is Outcome.ADAPTIVE_STEP_FAILED
    assert "More than 500 steps were tried for one step of the nodes" in run.message
    assert len(run) == 1


def test_equations_that_are_not_numbers_at_the_start_are_named() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), np.diag([1.3, 0.6]), constraints=[[0.0, 1.0]],
        drift=lambda x, p: np.array([0.0, np.sqrt(x[0])]),
    )
    run = gni.integrate(
        system, system.state([0.0, 0.1], [0.4, 0.0]), step=0.1, n_steps=5, on_failure="return",
        method=gni.ReferenceFlow(),
    )
    assert run.outcome is Outcome.ADAPTIVE_STEP_FAILED
    assert "Stopped at t = 0. The equations of motion give infinity or NaN" in run.message
    assert len(run) == 1


def test_the_time_reported_is_that_of_the_loop() -> None:
    import time

    run_of("Suslov", 1e-9)
    began = time.perf_counter()
    run = run_of("Suslov", 1e-9)
    assert 0.0 < run.seconds < 0.5 * (time.perf_counter() - began)


# ---------------------------------------------------------------- forces and control inputs


def pushed_particle() -> gni.MechanicalSystem:
    return gni.MechanicalSystem(
        gni.PairGroupoid(2), np.diag([1.3, 0.6]), parameters={"drag": 0.0},
        force=lambda x, xi, p, u: np.array([u[0], 0.5 * u[0]]) - p.drag * xi, controls=1,
    )


@pytest.mark.parametrize("compile", [True, False])
@pytest.mark.parametrize("every", [1, 3])
def test_control_inputs_are_constant_over_each_step(compile: bool, every: int) -> None:
    system = pushed_particle()
    h, pushes = 0.3, np.array([0.7, -1.9, 0.0, 2.2, -0.4, 1.3, 0.9])
    run = gni.integrate(
        system, system.state([0.2, -0.1], [0.5, 0.3]), step=h, n_steps=7, save_every=every,
        method=gni.ReferenceFlow(rtol=1e-11), controls=pushes[:, None], compile=compile,
    )
    x, v = np.array([0.2, -0.1]), np.array([0.5, 0.3])
    expected = [(x, v)]
    for push in pushes:
        rate = push * np.array([1 / 1.3, 0.5 / 0.6])
        x, v = x + h * v + h**2 / 2 * rate, v + h * rate
        expected.append((x, v))
    np.testing.assert_array_equal(run.node_steps, [*range(0, 7, every), 7])
    for x, v, (x0, v0) in zip(
        run.base, run.velocities, [expected[k] for k in run.node_steps], strict=True
    ):
        np.testing.assert_allclose(np.concatenate([x, v]), np.concatenate([x0, v0]), atol=1e-12)
    assert np.all(run.error_estimate() < 1e-10)
    np.testing.assert_array_equal(run.controls, pushes[:, None])


def test_the_work_of_the_force_is_what_the_energy_gains() -> None:
    system = gni.MechanicalSystem(
        gni.SO3(), np.diag([1.1, 0.7, 1.6]), constraints=[[0.3, -0.5, 1.0]],
        force=lambda x, xi, p: np.array([0.2, 0.0, -0.1]) - 0.3 * xi * np.abs(xi),
    )
    start = system.state(velocity=[0.9, 0.4, 0.2], project_start=True)
    run = gni.integrate(system, start, step=0.2, n_steps=25, method=gni.ReferenceFlow(rtol=1e-11))
    assert abs(run.work()[-1]) > 0.1
    np.testing.assert_allclose(run.energy_balance(), 0.0, rtol=0, atol=1e-9)
    assert np.max(np.abs(run.constraint_residuals())) < 1e-9
