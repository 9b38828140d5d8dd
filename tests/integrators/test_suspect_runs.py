"""Runs that reach their end and are not to be trusted: each says so in a way of its own."""

from __future__ import annotations

import re
import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import StateLayout
from groupoid_gni.integrators import marching


def falling_disc(turning: float = 0.0) -> gni.scenes.Scene:
    """A disc that falls towards the plane, where the contact point jumps to the other side."""
    return gni.scenes.rolling_disc(tilt=30.0, spin=(0.0, turning, 0.0))


# ---------------------------------------------------------------- rescued stages


def ball_at_the_edge_of_the_chart() -> gni.scenes.Scene:
    """A ball whose rotation vector comes near the length 2 pi, where the chart is singular."""
    rng = np.random.default_rng(1)
    for _ in range(7):
        rho = rng.normal(size=3)
        rho *= rng.uniform(4.5, 6.0) / np.linalg.norm(rho)
        velocity = rng.normal(size=2)
    return gni.scenes.inhomogeneous_ball_in_a_chart(rotation_vector=rho, velocity=velocity)


def caught(scene: gni.scenes.Scene, **options: Any) -> tuple[gni.Trajectory, list[Any]]:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        run = gni.integrate(scene.system, scene.start, **options)
    return run, [w for w in found if isinstance(w.message, gni.RescuedStepsWarning)]


def test_a_run_that_was_rescued_near_a_singular_chart_says_how_often_and_where_first() -> None:
    run, found = caught(ball_at_the_edge_of_the_chart(), step=0.02, t_end=10.0)
    assert run.success
    assert run.rescued_steps > 0
    (warning,) = found
    text = str(warning.message)
    stages = re.match(r"(one|\d+) stages? of GNI\(order=2\) needed a second try", text)
    assert stages is not None
    count = 1 if stages.group(1) == "one" else int(stages.group(1))
    assert 0 < count <= run.rescued_steps
    step, begins = re.search(r"first in step (\d+), which begins at t = ([\d.]+):", text).groups()
    assert float(begins) == pytest.approx((int(step) - 1) * 0.02)
    reach = np.linalg.norm(run.base[int(step) - 2 : int(step) + 1, 2:], axis=1)
    assert reach.max() > 5.5
    assert "half the step" in text
    assert warning.message.result is run
    assert f"{run.rescued_steps} stages needed one" in run.summary()
    assert warning.filename == __file__


def test_a_run_that_needed_no_second_try_is_silent() -> None:
    scene = gni.scenes.inhomogeneous_ball()
    run, found = caught(scene, step=0.02, t_end=10.0)
    assert (run.rescued_steps, found) == (0, [])
    assert "second tries" not in run.summary()


def test_a_second_try_that_goes_on_smoothly_is_counted_and_not_warned_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = gni.scenes.veselova()
    runner = marching.compiled_step(scene.system, gni.GNI(), (0,))
    advance, calls = type(runner).advance, []

    def fails_once(self: Any, parameters: Any, progress: Any, count: int, *rest: Any) -> Any:
        calls.append(count)
        after, rows, outcome = advance(self, parameters, progress, min(count, 40), *rest)
        return after, rows, gni.Outcome.NEWTON_FAILED if len(calls) == 1 else outcome

    monkeypatch.setattr(type(runner), "advance", fails_once)
    run, found = caught(scene, step=0.05, n_steps=60)
    assert (run.success, run.rescued_steps, found) == (True, 1, [])
    monkeypatch.undo()
    smooth = gni.integrate(scene.system, scene.start, step=0.05, n_steps=60)
    np.testing.assert_allclose(run.velocities, smooth.velocities, rtol=0, atol=1e-13)


# ---------------------------------------------------------------- steps that surprise


def lost_in_the_chart() -> gni.scenes.Scene:
    """A ball whose steps are all solved at the first try, and whose moving energy ends at -1.6."""
    return gni.scenes.inhomogeneous_ball_in_a_chart(
        rotation_vector=(-0.8634263309786897, -4.357468115438112, 0.9074452862968917),
        velocity=(-1.4123812154717754, 0.770322082794496),
    )


@pytest.mark.parametrize("compile", [True, False])
def test_a_step_that_surprises_is_told_with_its_number_and_size(compile: bool) -> None:
    scene = lost_in_the_chart()
    with pytest.warns(gni.SurprisingStepWarning) as found:
        run = gni.integrate(scene.system, scene.start, step=0.01, t_end=10.0, compile=compile)
    assert (run.success, run.rescued_steps) == (True, 0)
    assert 0.4 < run.surprise < 0.5
    assert run.surprising_step == 898
    assert len(found) == 1
    text = str(found[0].message)
    assert "step 898 of GNI(order=2), which begins at t = 8.97, lies 0.46 of the velocity" in text
    assert "half the step" in text
    assert found[0].message.result is run
    assert found[0].filename == __file__
    assert "the step from t = 8.97 is off its extrapolation by 46%" in run.summary()


def test_the_surprise_survives_chunks_and_sparse_saving_and_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    scene = lost_in_the_chart()
    monkeypatch.setattr(marching, "_FIRST_CHUNK", 7)
    monkeypatch.setattr(marching, "_CHUNK_SECONDS", 0.0)
    with pytest.warns(gni.SurprisingStepWarning):
        run = gni.integrate(scene.system, scene.start, step=0.01, t_end=10.0, save_every=1000)
    assert run.surprising_step == 898
    again = gni.Trajectory.load(run.save(tmp_path / "run"), scene.system)
    assert (again.surprise, again.surprising_step) == (run.surprise, 898)


def test_a_composition_that_does_not_resolve_the_motion_is_told_of() -> None:
    scene = gni.scenes.inhomogeneous_ball_in_a_chart(
        rotation_vector=(-3.675, 2.936, -1.237), velocity=(-0.1057, -0.9719)
    )
    method = gni.GNI(4, flow=gni.EnergyPreserving())
    with pytest.warns(gni.SurprisingStepWarning, match="step 2[0-9]{2} of GNI"):
        run = gni.integrate(scene.system, scene.start, step=0.04, t_end=10.0, method=method)
    assert run.surprise > 0.05


def test_members_that_surprise_are_told_of_once_by_number() -> None:
    scene, other = lost_in_the_chart(), gni.scenes.inhomogeneous_ball_in_a_chart()
    starts = [other.start, scene.start, other.start, scene.start, other.start]
    with pytest.warns(gni.SurprisingStepWarning, match="2 of 5 members, first member 1") as found:
        ensemble = gni.integrate_ensemble(scene.system, starts, step=0.01, t_end=10.0)
    assert len(found) == 1
    assert found[0].message.result is ensemble[1]
    assert [run.surprising_step for run in ensemble] == [0, 898, 0, 898, 0]


@pytest.mark.parametrize("share", [0.3, 1.0, 1.99])
@pytest.mark.parametrize("method", [gni.GNI(), gni.GNI(flow=gni.EnergyPreserving()), gni.GNI(4)])
def test_a_stiff_spring_at_its_limit_is_no_surprise(share: float, method: gni.GNI) -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), np.diag([1.3, 0.7, 0.9]),
        constraints=lambda x, p: np.array([[0.3 * x[1], -1.0, 0.4]]),
        potential=lambda x, p: p.k * x[0] ** 2 / 2 + 0.3 * x[2] ** 4, parameters={"k": 1.3e4},
    )  # fmt: skip
    start = system.state([0.01, 0.2, -0.4], [0.3, 0.2, 0.5], project_start=True)
    run = gni.integrate(system, start, step=share / 100.0, n_steps=2000, method=method)
    assert run.surprise == 0.0


def test_a_run_that_failed_does_not_warn_of_its_steps() -> None:
    scene = lost_in_the_chart()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = gni.integrate(scene.system, scene.start, step=0.005, t_end=10.0,
                            on_failure="return")  # fmt: skip
    assert not run.success


# ---------------------------------------------------------------- constraints that jump


def flipping_row(at: float) -> tuple[gni.MechanicalSystem, gni.State]:
    """A constraint that is another one beyond x = at."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        np.diag([1.3, 0.7, 0.9]),
        constraints=lambda x, p: gni.array([[0.0, 1.0, gni.where(x[0] < p.at, 0.4, -0.8)]]),
        parameters={"at": at},
    )
    return system, system.state([0.0, 0.1, -0.1], [1.0, -0.2, 0.5])


@pytest.mark.parametrize("at", [0.31, 1.97])
@pytest.mark.parametrize("rtol", [1e-6, 1e-11])
def test_the_reference_flow_stops_where_the_constraints_jump(at: float, rtol: float) -> None:
    system, start = flipping_row(at)
    options: dict[str, Any] = {"step": 0.02, "t_end": 3.0, "method": gni.ReferenceFlow(rtol)}
    with pytest.raises(gni.StepFailure, match="constraints are violated after t = ") as failure:
        gni.integrate(system, start, **options)
    run = failure.value.result
    assert run.outcome is gni.Outcome.ADAPTIVE_STEP_FAILED
    assert abs(run.times[-1] - at) <= 0.02
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-8
    assert np.isfinite(run.error_estimate()[0])


def test_the_reference_flow_does_not_step_over_a_disc_that_lies_flat() -> None:
    scene = falling_disc()
    run = gni.integrate(scene.system, scene.start, step=1 / 128, t_end=2.0,
                        method=gni.ReferenceFlow(1e-9), on_failure="return")  # fmt: skip
    assert not run.success
    assert run.times[-1] == pytest.approx(0.66, abs=0.01)
    energy = run.energy()
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-6


def test_a_reference_run_at_a_loose_tolerance_is_no_violation() -> None:
    scene = gni.scenes.veselova()
    run = gni.integrate(scene.system, scene.start, step=0.5, t_end=100.0,
                        method=gni.ReferenceFlow(1e-5))  # fmt: skip
    assert run.success


# ---------------------------------------------------------------- impulses as large as p


def test_impulses_as_large_as_the_momentum_do_not_silence_the_alarm() -> None:
    class Run(SimpleNamespace):
        def __len__(self) -> int:
            return 3

    run: Any = Run(
        layout=StateLayout.of({"parasitic": 5}), method_name="Rattle()", parasitic_bound=1.7,
        parasitic_at_start=0.4, parasitic_maximum=np.array([0.1, 0.2, 0.6]),
        times=np.array([0.0, 0.3, 0.6]),
    )  # fmt: skip
    told = marching.parasitic_complaint(run)
    assert "left its O(h^2) level 0.3 at t = 0.6 and has reached 0.6 of |p|" in told


@pytest.mark.parametrize("per_second", [256, 2048])
@pytest.mark.parametrize("method", [gni.Rattle(), gni.Midpoint()])
def test_two_rows_that_turn_over_at_once_end_the_run(per_second: int, method: Any) -> None:
    scene = falling_disc()
    run = gni.integrate(scene.system, scene.start, step=1 / per_second, t_end=2.0, method=method,
                        on_failure="return")  # fmt: skip
    assert run.outcome is gni.Outcome.CONSTRAINTS_SINGULAR
    assert run.times[-1] == pytest.approx(0.66, abs=0.01)
    energy = run.energy()
    assert np.max(np.abs(energy / energy[0] - 1.0)) < 1e-3


# ---------------------------------------------------------------- motion that is not resolved


def test_the_summary_tells_of_a_velocity_that_changes_much_in_one_step() -> None:
    scene = falling_disc(0.01)
    run = gni.integrate(scene.system, scene.start, step=1 / 2048, t_end=1.0, method=gni.GNI(6))
    changes = run.velocity_changes()
    assert changes.shape == (2048,)
    worst = int(np.argmax(changes))
    assert changes[worst] > 0.5
    assert f"changes by {changes[worst]:.0%} in the step from t = {run.times[worst]:g}" in (
        run.summary()
    )
    upright = gni.scenes.rolling_disc()
    run = gni.integrate(upright.system, upright.start, step=1 / 2048, n_steps=500)
    assert np.max(run.velocity_changes()) < 0.05
    assert "resolution" not in run.summary()


def test_velocity_changes_are_relative_and_in_the_metric() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), np.diag([4.0, 0.25]), potential=lambda x, p: -2.0 * x[0] + x[1]
    )
    run = gni.integrate(system, system.state([0.0, 0.0], [0.3, -0.2]), step=0.1, n_steps=20)
    v = run.velocities * [2.0, 0.5]
    sizes = np.linalg.norm(v, axis=1)
    expected = np.linalg.norm(np.diff(v, axis=0), axis=1) / np.maximum(sizes[1:], sizes[:-1])
    np.testing.assert_allclose(run.velocity_changes(), expected, rtol=1e-12)
