"""The ball on a rotating table against Newton and Euler at the contact point, written here."""

from __future__ import annotations

from functools import cache
from typing import Any

import full_models
import numpy as np
import pytest
from measures import PRECISE, by_hand, change, end_errors, gap_to_full, slope

import groupoid_gni as gni

MASS, RADIUS, INERTIA, TABLE = 1.7, 0.8, 0.6, 1.3
PLACE, SPEED, SPIN = (0.4, -0.9), (0.3, 0.7), 0.35
TIMES = np.linspace(0.0, 5.0, 11)


@cache
def scene() -> gni.scenes.Scene:
    return gni.scenes.rolling_ball(MASS, RADIUS, INERTIA, TABLE, PLACE, SPEED, SPIN)


@cache
def newton() -> Any:
    """x, y, x', y', omega and the friction force at TIMES.

    The force f acts at -r e3: m q'' = f, I omega' = -r e3 x f; the contact point of the ball moves
    with the table, q' + omega x (-r e3) = Theta e3 x q.
    """
    down = np.array([0.0, 0.0, -RADIUS])

    def accelerations(y: Any) -> Any:
        left, right = np.zeros((7, 7)), np.zeros(7)
        left[:2, :2], left[:2, 5:] = MASS * np.eye(2), -np.eye(2)
        left[2:5, 2:5] = INERTIA * np.eye(3)
        for i, force in enumerate(np.eye(3)[:2]):
            left[2:5, 5 + i] = -np.cross(down, force)
        left[5:, :2] = np.eye(2)
        for i, spin in enumerate(np.eye(3)):
            left[5:, 2 + i] = np.cross(spin, down)[:2]
        right[5:] = TABLE * np.array([-y[3], y[2]])
        return np.linalg.solve(left, right)

    omega = np.array(scene().start.velocity[2:])
    start = [*PLACE, *SPEED, *omega]
    y = by_hand(lambda t, y: [*y[2:4], *accelerations(y)[:5]], start, TIMES)
    return np.column_stack([y, [accelerations(row)[5:] for row in y]])


def test_the_start_rolls_with_the_table() -> None:
    (x, y), omega = PLACE, scene().start.velocity[2:]
    contact = np.array([*SPEED, 0.0]) + np.cross(omega, [0.0, 0.0, -RADIUS])
    np.testing.assert_allclose(contact, [-TABLE * y, TABLE * x, 0.0], atol=1e-14)


def test_reference_flow_exact_motion_and_friction_agree_with_newton() -> None:
    run = gni.integrate(
        scene().system, scene().start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE
    )
    found = np.concatenate([run.base, run.velocities, run.multipliers], axis=1)
    np.testing.assert_allclose(found, newton(), atol=1e-9)
    exact = np.concatenate(scene().exact(TIMES), axis=1)
    np.testing.assert_allclose(exact, newton()[:, :7], atol=1e-11)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_order_two(method: Any) -> None:
    counts = [40, 80, 160, 320]
    truth = newton()[-1, :2], newton()[-1, 2:7]
    errors = end_errors(scene(), method, TIMES[-1], counts, truth)
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


def moving_energy(run: gni.Trajectory) -> Any:
    """E - Theta M_z, the moment of momentum about the centre of the table."""
    (x, y), v = run.base.T, run.velocities.T
    return run.energy() - TABLE * (MASS * (x * v[1] - y * v[0]) + INERTIA * v[4])


def test_moving_energy_and_vertical_spin_are_first_integrals() -> None:
    run = gni.integrate(scene().system, scene().start, step=0.5, t_end=20.0, method=PRECISE)
    assert change(moving_energy(run)) < 1e-9
    assert change(run.velocities[:, 4]) < 1e-10
    assert change(run.energy()) > 0.1


def test_the_projected_step_keeps_constraint_and_moving_energy() -> None:
    run = gni.integrate(scene().system, scene().start, step=0.05, n_steps=2000)
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
    assert change(moving_energy(run)) < 1e-11


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_the_ball_with_its_attitude_gives_the_same_motion_to_round_off(method: Any) -> None:
    full = full_models.ball(scene())
    assert gap_to_full(scene(), full, step=0.05, n_steps=200, method=method) < 1e-12


@pytest.mark.slow
def test_moving_energy_does_not_drift_over_a_hundred_thousand_steps() -> None:
    run = gni.integrate(scene().system, scene().start, step=0.05, n_steps=100_000)
    assert change(moving_energy(run)) < 1e-10
