"""The constrained particle against Newton's equations in (x, y, z), written here."""

from __future__ import annotations

from functools import cache
from typing import Any

import full_models
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measures import PRECISE, by_hand, change, end_errors, gap_to_full, quietly, slope

import groupoid_gni as gni

positive, signed = st.floats(0.2, 3.0), st.floats(-2.0, 2.0)
MASS, SPRING_X, SPRING_Y = 1.3, 0.9, 0.7
SPRINGS = {"free": (0.0, 0.0), "along y": (0.0, SPRING_Y), "both": (SPRING_X, SPRING_Y)}
TIMES = np.linspace(0.0, 3.0, 13)


@cache
def scene_with(springs: str) -> gni.scenes.Scene:
    return gni.scenes.constrained_particle(MASS, *SPRINGS[springs], (0.4, -0.6), (0.9, 1.1))


@cache
def newton(springs: str) -> Any:
    """x, y, z, x', y', z' and the multiplier of z' - y x' = 0 at TIMES."""
    k = np.array([*SPRINGS[springs], 0.0])

    def acceleration(y: Any) -> tuple[Any, float]:
        mu = np.array([-y[1], 0.0, 1.0])
        force = -k * y[:3]
        # z'' - y x'' = x' y'
        multiplier = (y[3] * y[4] - mu @ force / MASS) / (mu @ mu / MASS)
        return (force + multiplier * mu) / MASS, multiplier

    start = [0.4, -0.6, 0.2, 0.9, 1.1, -0.6 * 0.9]
    y = by_hand(lambda t, y: np.concatenate([y[3:], acceleration(y)[0]]), start, TIMES)
    return np.column_stack([y, [acceleration(row)[1] for row in y]])


def as_scene(springs: str) -> tuple[Any, Any]:
    y = newton(springs)
    return y[:, [1, 0][: 2 if springs == "both" else 1]], y[:, [4, 3, 5]]


@pytest.mark.parametrize("springs", SPRINGS)
def test_reference_flow_and_multipliers_agree_with_newton(springs: str) -> None:
    scene = scene_with(springs)
    run = gni.integrate(
        scene.system, scene.start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE
    )
    base, velocity = as_scene(springs)
    np.testing.assert_allclose(run.base, base, atol=1e-9)
    np.testing.assert_allclose(run.velocities, velocity, atol=1e-9)
    np.testing.assert_allclose(run.multipliers[:, 0], newton(springs)[:, 6], atol=1e-9)


@pytest.mark.parametrize("springs", ["free", "along y"])
def test_the_exact_motion_is_that_of_newton(springs: str) -> None:
    found = scene_with(springs).exact(TIMES)
    for ours, theirs in zip(found, as_scene(springs), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-11)


@settings(max_examples=10)
@given(m=positive, k=st.tuples(st.sampled_from([0.0, 0.8]), signed),
       q=st.tuples(signed, signed), v=st.tuples(signed, signed))
def test_starts_satisfy_the_constraint(m: float, k: Any, q: Any, v: Any) -> None:
    scene = gni.scenes.constrained_particle(m, *k, q, v)
    np.testing.assert_array_equal(scene.start.base, [q[1], q[0]][: 2 if k[0] else 1])
    np.testing.assert_allclose(scene.start.velocity, [v[1], v[0], q[1] * v[0]], atol=1e-14)
    np.testing.assert_allclose(scene.start.momentum, m * scene.start.velocity, rtol=1e-14)
    assert (scene.exact is None) == (k[0] != 0 or k[1] < 0)
    assert scene.system.has("potential") == any(k)


@pytest.mark.parametrize(
    ("springs", "method"),
    [("free", gni.Rattle()), ("both", gni.Rattle()), ("both", gni.GNI())],
    ids=str,
)
def test_order_two(springs: str, method: Any) -> None:
    truth = [part[-1] for part in as_scene(springs)]
    counts = [40, 80, 160, 320]
    errors = end_errors(scene_with(springs), method, TIMES[-1], counts, truth)
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


def test_the_projected_step_is_exact_on_the_free_particle() -> None:
    # y' is constant, and with the energy kept so is what is left for x'^2 (1 + y^2)
    truth = [part[-1] for part in as_scene("free")]
    errors = end_errors(scene_with("free"), gni.GNI(), TIMES[-1], [20], truth)
    assert errors[0] < 1e-11


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_constraint_at_round_off_and_energy_near_its_start(method: Any) -> None:
    scene = scene_with("both")
    records = []
    for h in (0.1, 0.05):
        run = quietly(scene.system, scene.start, step=h, t_end=100.0, method=method)
        assert np.max(np.abs(run.constraint_residuals(relative=True))) < 2e-15
        records.append(change(run.energy()))
    assert records[1] < 1e-3
    assert np.log2(records[0] / records[1]) == pytest.approx(2.0, abs=0.2)


def test_without_a_spring_along_x_the_momentum_along_the_slope_is_constant() -> None:
    scene = scene_with("along y")
    run = gni.integrate(scene.system, scene.start, step=0.1, t_end=30.0, method=PRECISE)
    assert change(run.velocities[:, 1] * np.sqrt(1 + run.base[:, 0] ** 2)) < 1e-10
    assert change(run.energy()) < 1e-10


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("springs", SPRINGS)
def test_the_pair_groupoid_of_space_gives_the_same_motion_to_round_off(
    springs: str, method: Any
) -> None:
    scene = scene_with(springs)
    full = full_models.particle(scene)
    assert gap_to_full(scene, full, step=0.05, n_steps=200, method=method) < 1e-13


def test_reconstruction_gives_back_what_was_left_out() -> None:
    scene, y = scene_with("along y"), newton("along y")
    run = gni.integrate(scene.system, scene.start, step=TIMES[1] / 200, t_end=TIMES[-1])
    np.testing.assert_allclose(run.reconstruct([0.4, 0.2])[::200], y[:, [0, 2]], atol=1e-5)


def test_bad_positions_are_refused_by_name() -> None:
    with pytest.raises(gni.InputError, match=r"position must have shape \(2,\), got \(3,\)"):
        gni.scenes.constrained_particle(position=(1.0, 2.0, 3.0))
    with pytest.raises(gni.InputError, match="velocity must be finite"):
        gni.scenes.constrained_particle(velocity=(1.0, np.nan))


@pytest.mark.slow
def test_energy_does_not_drift_over_a_hundred_thousand_steps() -> None:
    scene = scene_with("both")
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=100_000)
    energy = run.energy()
    assert change(energy) < 1e-3
    tenths = energy[:-1].reshape(10, -1).mean(axis=1)
    assert change(tenths) < 1e-5
