"""The Suslov problem against Euler's equations with a constraint torque, written here."""

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

INERTIA = np.array([[1.7, 0.2, -0.4], [0.2, 1.1, 0.3], [-0.4, 0.3, 1.4]])
AXIS = np.array([0.6, -0.5, 1.3])
TIMES = np.linspace(0.0, 6.0, 13)
SPIN = np.cross(AXIS, [0.3, 0.8, 0.5])


@cache
def scene() -> gni.scenes.Scene:
    return gni.scenes.suslov(INERTIA, AXIS, SPIN)


def euler(inertia: Any, axis: Any, spin: Any, times: Any) -> Any:
    """Omega and the torque along the axis at ``times``, (n, 4)."""

    def accelerations(omega: Any) -> Any:
        left = np.block([[inertia, -axis[:, None]], [axis[None, :], np.zeros((1, 1))]])
        return np.linalg.solve(left, [*np.cross(inertia @ omega, omega), 0.0])

    omega = by_hand(lambda t, y: accelerations(y)[:3], spin, times)
    return np.column_stack([omega, [accelerations(row)[3] for row in omega]])


@cache
def solved() -> Any:
    return euler(INERTIA, AXIS, SPIN, TIMES)


def test_reference_flow_and_torque_agree_with_euler() -> None:
    run = gni.integrate(
        scene().system, scene().start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE
    )
    np.testing.assert_allclose(run.velocities, solved()[:, :3], atol=1e-9)
    np.testing.assert_allclose(run.multipliers, solved()[:, 3:], atol=1e-9)


@settings(max_examples=12)
@given(seed=st.integers(0, 10**6), size=st.floats(0.2, 3.0))
def test_the_exact_motion_solves_eulers_equations_for_any_body_axis_and_start(
    seed: int, size: float
) -> None:
    rng = np.random.default_rng(seed)
    root = rng.uniform(-1, 1, (3, 3))
    inertia, axis = root @ root.T + 0.3 * np.eye(3), size * rng.uniform(-1, 1, 3)
    spin = np.cross(axis, rng.uniform(-1, 1, 3)) / size**2
    exact = gni.scenes.suslov(inertia, axis, spin).exact
    times = np.array([0.0, 0.7, 3.0])
    base, omega = exact(times)
    assert base.shape == (3, 0)
    expected = euler(inertia, axis, spin, times)[:, :3]
    np.testing.assert_allclose(omega, expected, atol=1e-10 * (1 + np.abs(expected).max()))


def test_the_exact_motion_settles_where_the_products_of_inertia_vanish() -> None:
    early, late = scene().exact(np.array([-800.0, 800.0]))[1]
    for omega in (early, late):
        assert abs(AXIS @ INERTIA @ omega) < 1e-14
        assert omega @ INERTIA @ omega == pytest.approx(SPIN @ INERTIA @ SPIN, rel=1e-14)
    np.testing.assert_allclose(early, -late, atol=1e-14)


def test_a_start_on_a_steady_turn_stays_there_in_closed_form() -> None:
    inertia = np.array([[1.4, 0.0, 0.3], [0.0, 1.1, 0.0], [0.3, 0.0, 0.9]])
    steady = gni.scenes.suslov(inertia, (0, 0, 2.0), (0.0, -0.7, 0.0))
    np.testing.assert_allclose(steady.exact(TIMES)[1], [[0.0, -0.7, 0.0]] * 13, atol=1e-15)
    principal = gni.scenes.suslov(np.diag([1.4, 1.1, 0.9]), (0, 0, 2.0), (0.4, -0.7, 0.0))
    np.testing.assert_allclose(principal.exact(TIMES)[1], [[0.4, -0.7, 0.0]] * 13, atol=1e-15)
    run = gni.integrate(principal.system, principal.start, step=0.1, t_end=2.0, method=PRECISE)
    np.testing.assert_allclose(run.velocities[-1], [0.4, -0.7, 0.0], atol=1e-12)


def test_the_default_has_no_principal_axis_along_the_constraint() -> None:
    default = gni.scenes.suslov()
    inertia, axis = default.system.parameters["I"], default.system.parameters["a"]
    assert np.linalg.norm(np.cross(inertia @ axis, axis)) > 0.3
    assert axis @ default.start.velocity == 0.0


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_order_two(method: Any) -> None:
    counts = [120, 240, 480, 960]
    truth = np.zeros(0), solved()[-1, :3]
    errors = end_errors(scene(), method, TIMES[-1], counts, truth)
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_constraint_at_round_off_and_energy_of_order_two_while_settling(method: Any) -> None:
    records = []
    for h in (0.05, 0.025):
        run = quietly(scene().system, scene().start, step=h, t_end=6.0, method=method)
        assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
        records.append(change(run.energy()))
    assert records[1] < 2e-3
    assert np.log2(records[0] / records[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_the_body_with_its_attitude_gives_the_same_motion_to_round_off(method: Any) -> None:
    full = full_models.suslov(scene())
    assert gap_to_full(scene(), full, step=0.05, n_steps=200, method=method) < 1e-13


def test_bad_input_is_refused_by_name() -> None:
    with pytest.raises(gni.InputError, match="axis must not be zero"):
        gni.scenes.suslov(axis=(0, 0, 0))
    with pytest.raises(gni.InputError, match=r"inertia must have shape \(3, 3\)"):
        gni.scenes.suslov(inertia=(1.0, 2.0, 3.0))
    with pytest.raises(gni.InputError, match="violates the constraints"):
        gni.scenes.suslov(spin=(1.0, 0.0, 0.5))


@pytest.mark.slow
def test_the_settled_body_creeps_along_its_steady_turns_at_a_rate_of_order_two() -> None:
    # the true body keeps its energy; the step's energy error has a sign there
    rates = []
    for h in (0.05, 0.025, 0.0125):
        run = gni.integrate(scene().system, scene().start, step=h, t_end=1250.0, save_every=100)
        energy = run.energy()
        half = len(energy) // 2
        rates.append((energy[-1] - energy[half]) / energy[0] / 625.0)
        settled = run.velocities[half:]
        assert np.max(np.abs(settled @ INERTIA @ AXIS)) < 0.02 * np.abs(settled).max()
    assert abs(rates[2]) < 1e-5
    assert np.log2(np.abs(np.array(rates[:-1]) / rates[1:])) == pytest.approx(2.0, abs=0.1)
