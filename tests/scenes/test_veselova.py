"""The Veselova problem against the balance of momentum in space, written here."""

from __future__ import annotations

from functools import cache
from typing import Any

import full_models
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measures import PRECISE, by_hand, change, end_errors, gap_to_full, hat, quietly, slope

import groupoid_gni as gni

INERTIA = np.array([1.1, 0.7, 1.6])
VERTICAL = np.array([0.48, -0.6, 0.64])
WEIGHT = np.array([0.5, -0.3, 0.8])
CASES = {"free": (0.0, None), "driven": (0.45, None), "heavy": (0.0, WEIGHT)}
CASES["driven and heavy"] = (0.45, WEIGHT)
TIMES = np.linspace(0.0, 3.0, 13)


def spin_with(rate: float) -> Any:
    return np.cross(VERTICAL, [0.9, 0.4, -1.1]) + rate * VERTICAL


@cache
def scene_with(case: str) -> gni.scenes.Scene:
    rate, weight = CASES[case]
    return gni.scenes.veselova(INERTIA, rate, weight, VERTICAL, spin_with(rate))


@cache
def newton(case: str) -> Any:
    """gamma, Omega and the torque about the vertical at TIMES, from attitude and space velocity.

    ``(R I R^T omega)' = torque of the weight + lambda e3``, ``omega_3 = c``.
    """
    rate, weight = CASES[case]
    arm = np.zeros(3) if weight is None else weight
    up = np.array([0.0, 0.0, 1.0])

    def accelerations(attitude: Any, omega: Any) -> Any:
        inertia = attitude @ np.diag(INERTIA) @ attitude.T
        # the weight pulls down at the centre of mass
        torque = np.cross(attitude @ arm, -up) - np.cross(omega, inertia @ omega)
        left = np.block([[inertia, -up[:, None]], [up[None, :], np.zeros((1, 1))]])
        return np.linalg.solve(left, [*torque, 0.0])

    def rates(t: float, y: Any) -> Any:
        attitude, omega = y[:9].reshape(3, 3), y[9:]
        return [*(hat(omega) @ attitude).ravel(), *accelerations(attitude, omega)[:3]]

    level = np.cross(VERTICAL, [0.2, 0.7, 0.1])
    level /= np.linalg.norm(level)
    attitude = np.stack([level, np.cross(VERTICAL, level), VERTICAL])
    y = by_hand(rates, [*attitude.ravel(), *(attitude @ spin_with(rate))], TIMES)
    found = []
    for row in y:
        attitude, omega = row[:9].reshape(3, 3), row[9:]
        found.append([*attitude[2], *(attitude.T @ omega), accelerations(attitude, omega)[3]])
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
def test_reference_flow_and_torque_agree_with_newton(case: str) -> None:
    scene = scene_with(case)
    run = gni.integrate(scene.system, scene.start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE)
    found = np.concatenate([run.base, run.velocities, run.multipliers], axis=1)
    np.testing.assert_allclose(found, newton(case), atol=1e-9)


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), rate=st.floats(-2.0, 2.0), heavy=st.booleans())
def test_starts_satisfy_the_constraint_on_the_sphere(seed: int, rate: float, heavy: bool) -> None:
    rng = np.random.default_rng(seed)
    gamma = rng.normal(size=3)
    gamma /= np.linalg.norm(gamma)
    spin = np.cross(gamma, rng.normal(size=3)) + rate * gamma
    inertia, weight = rng.uniform(0.3, 2.0, 3), rng.normal(size=3) if heavy else None
    scene = gni.scenes.veselova(inertia, rate, weight, gamma, spin)
    np.testing.assert_array_equal(scene.start.base, gamma)
    assert gamma @ scene.start.velocity == pytest.approx(rate, abs=1e-13)
    np.testing.assert_allclose(scene.start.momentum, inertia * spin, rtol=0, atol=1e-12)
    assert scene.system.has("potential") == heavy


def moving_energy(run: gni.Trajectory) -> Any:
    """E - c <I Omega, gamma>."""
    return run.energy() - run.system.parameters["c"] * np.sum(run.momenta * run.base, axis=1)


def horizontal(run: gni.Trajectory) -> Any:
    """|K|, the size of the momentum across the vertical."""
    about = np.sum(run.momenta * run.base, axis=1)
    return np.linalg.norm(run.momenta - about[:, None] * run.base, axis=1)


@pytest.mark.parametrize("case", CASES)
def test_first_integrals(case: str) -> None:
    scene = scene_with(case)
    run = gni.integrate(scene.system, scene.start, step=0.5, t_end=20.0, method=PRECISE)
    rate, weight = CASES[case]
    assert change(moving_energy(run)) < 1e-9
    assert (change(run.energy()) < 1e-9) == (rate == 0.0)
    assert (change(horizontal(run)) < 1e-9) == (weight is None)
    np.testing.assert_allclose(np.linalg.norm(run.base, axis=1), 1.0, atol=1e-10)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("case", ["free", "driven and heavy"])
def test_order_two(case: str, method: Any) -> None:
    counts = [60, 120, 240, 480]
    truth = newton(case)[-1, :3], newton(case)[-1, 3:6]
    errors = end_errors(scene_with(case), method, TIMES[-1], counts, truth)
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("case", ["free", "driven and heavy"])
def test_constraint_and_sphere_at_round_off_and_energy_near_its_start(
    case: str, method: Any
) -> None:
    scene, records = scene_with(case), []
    for h in (0.05, 0.025):
        run = quietly(scene.system, scene.start, step=h, t_end=30.0, method=method)
        assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
        assert np.max(np.abs(np.linalg.norm(run.base, axis=1) - 1.0)) < 1e-14
        records.append(change(moving_energy(run)))
    assert records[1] < 2e-3
    assert np.log2(records[0] / records[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("case", ["free", "driven and heavy"])
def test_the_body_with_its_heading_gives_the_same_motion_to_round_off(
    case: str, method: Any
) -> None:
    scene = scene_with(case)
    full = full_models.veselova(scene)
    assert gap_to_full(scene, full, step=0.05, n_steps=200, method=method) < 1e-12


def test_reconstruction_gives_back_the_heading() -> None:
    scene, full = scene_with("heavy"), full_models.veselova(scene_with("heavy"))
    options = {"step": 0.05, "n_steps": 100}
    attitudes = gni.integrate(full.system, full.start, **options).base.reshape(-1, 3, 3)
    run = gni.integrate(scene.system, scene.start, **options)
    np.testing.assert_allclose(run.reconstruct(attitudes[0]), attitudes, atol=1e-12)


def test_bad_input_is_refused_by_name() -> None:
    with pytest.raises(gni.InputError, match="base lies off the base manifold"):
        gni.scenes.veselova(vertical=(0.0, 0.0, 2.0), spin=(0.0, 0.0, 0.0))
    with pytest.raises(gni.InputError, match="violates the constraints"):
        gni.scenes.veselova(vertical=(0.0, 0.0, 1.0), spin=(0.3, 0.2, 0.1))
    with pytest.raises(gni.InputError, match="weight must be finite"):
        gni.scenes.veselova(weight=(0.0, np.inf, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("case", ["free", "driven"])
def test_moving_energy_does_not_drift_over_a_hundred_thousand_steps(case: str) -> None:
    scene = scene_with(case)
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=100_000)
    energy = moving_energy(run)
    assert change(energy) < 1e-3
    tenths = energy[:-1].reshape(10, -1).mean(axis=1)
    assert change(tenths) < 1e-5
