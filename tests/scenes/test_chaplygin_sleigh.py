"""The Chaplygin sleigh against Newton and Euler for its centre of mass, written here."""

from __future__ import annotations

from functools import cache
from typing import Any

import full_models
import numpy as np
import pytest
from measures import (
    PRECISE,
    by_hand,
    change,
    end_errors,
    gap_to_full,
    quarter_turn,
    quietly,
    slope,
)

import groupoid_gni as gni

MASS, INERTIA, OFFSET, SPIN, SPEED = 1.3, 0.6, 0.4, 1.1, -0.7
TIMES = np.linspace(0.0, 4.0, 9)


@cache
def scene() -> gni.scenes.Scene:
    return gni.scenes.chaplygin_sleigh(MASS, INERTIA, OFFSET, SPIN, SPEED)


@cache
def newton() -> Any:
    """omega, speed along and across the blade, and the blade's force at TIMES.

    Unknowns: centre of mass X, heading; the force N acts across the blade at X - a e1.
    """

    def accelerations(y: Any) -> Any:
        forward = np.array([np.cos(y[2]), np.sin(y[2])])
        across, omega = quarter_turn(forward), y[5]
        left, right = np.zeros((4, 4)), np.zeros(4)
        left[:2, :2], left[:2, 3] = MASS * np.eye(2), -across
        left[2, 2:] = INERTIA, OFFSET
        # across . (X' - a omega across) = 0, once more
        left[3, :3] = *across, -OFFSET
        right[3] = omega * forward @ y[3:5]
        return np.linalg.solve(left, right)

    heading = 0.7
    forward = np.array([np.cos(heading), np.sin(heading)])
    velocity = SPEED * forward + OFFSET * SPIN * quarter_turn(forward)
    start = [0.3, -0.2, heading, *velocity, SPIN]
    y = by_hand(lambda t, y: [*y[3:], *accelerations(y)[:3]], start, TIMES)
    found = []
    for row in y:
        forward = np.array([np.cos(row[2]), np.sin(row[2])])
        contact = row[3:5] - OFFSET * row[5] * quarter_turn(forward)
        speeds = contact @ forward, contact @ quarter_turn(forward)
        found.append([row[5], *speeds, accelerations(row)[3]])
    return np.array(found)


def test_reference_flow_and_blade_force_agree_with_newton() -> None:
    run = gni.integrate(
        scene().system, scene().start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE
    )
    np.testing.assert_allclose(run.velocities, newton()[:, :3], atol=1e-9)
    np.testing.assert_allclose(run.multipliers, newton()[:, 3:], atol=1e-9)


def test_the_exact_motion_is_that_of_newton_and_lasts() -> None:
    np.testing.assert_allclose(scene().exact(TIMES)[1], newton()[:, :3], atol=1e-11)
    top = np.sqrt(SPEED**2 + (INERTIA / MASS + OFFSET**2) * SPIN**2)
    ends = scene().exact(np.array([-1e4, 1e4]))[1]
    np.testing.assert_allclose(ends, [[0, -top, 0], [0, top, 0]], atol=1e-14)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_order_two(method: Any) -> None:
    counts = [40, 80, 160, 320]
    errors = end_errors(scene(), method, TIMES[-1], counts, (np.zeros(0), newton()[-1, :3]))
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


def test_the_projected_step_keeps_constraint_and_energy_to_round_off() -> None:
    run = gni.integrate(scene().system, scene().start, step=0.05, n_steps=2000)
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
    assert change(run.energy()) < 1e-13


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_the_sleigh_with_its_pose_gives_the_same_motion_to_round_off(method: Any) -> None:
    full = full_models.sleigh(scene())
    assert gap_to_full(scene(), full, step=0.05, n_steps=200, method=method) < 1e-13


def test_the_sleigh_in_coordinates_gives_the_same_motion_to_order_two() -> None:
    full = full_models.sleigh_in_coordinates(scene())
    counts = np.array([40, 80, 160])
    gaps = [gap_to_full(scene(), full, step=4.0 / n, n_steps=n) for n in counts]
    assert slope(counts, gaps) == pytest.approx(2.0, abs=0.05)


@pytest.mark.slow
def test_energy_does_not_drift_over_a_hundred_thousand_steps() -> None:
    run = gni.integrate(scene().system, scene().start, step=0.05, n_steps=100_000)
    assert change(run.energy()) < 1e-12
    two_step = quietly(
        scene().system, scene().start, step=0.05, n_steps=100_000, method=gni.Rattle()
    )
    assert change(two_step.energy()) > 0.5  # the parasitic mode; the run warns of it
