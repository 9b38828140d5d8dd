"""Runs that reach their end and are not to be trusted: each says so in a way of its own."""

from __future__ import annotations

import re
import warnings
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
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


@pytest.mark.parametrize("per_second", [256, 2048])
def test_impulses_as_large_as_the_momentum_do_not_silence_the_alarm(per_second: int) -> None:
    scene = falling_disc()
    with pytest.warns(gni.ParasiticModeWarning) as found:
        run = gni.integrate(scene.system, scene.start, step=1 / per_second, t_end=2.0,
                            method=gni.Rattle())  # fmt: skip
    assert run.parasitic_bound > 1.0
    assert "left its O(h^2) level 0.3 at t = 0.6" in str(found[0].message)


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
