"""The two-wheeled robot against Newton and Euler for its body and wheels, written here."""

from __future__ import annotations

from functools import cache
from typing import Any

import full_models
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measures import (
    PRECISE,
    by_hand,
    change,
    end_errors,
    gap_to_full,
    quarter_turn,
    slope,
)

import groupoid_gni as gni

BODY, INERTIA, OFFSET, WHEEL, AXLE, RADIUS, TRACK = 1.9, 0.45, 0.35, 0.3, 0.08, 0.4, 0.55
SPIN, SPEED, ANGLE = 1.1, -0.7, -0.4
DETENTS = {"free": 0.0, "detent": 0.6}
TIMES = np.linspace(0.0, 3.0, 13)


@cache
def scene_with(case: str) -> gni.scenes.Scene:
    return gni.scenes.two_wheeled_robot(
        BODY, INERTIA, OFFSET, WHEEL, AXLE, RADIUS, TRACK,
        detent=DETENTS[case], wheel_angle=ANGLE, spin=SPIN, speed=SPEED,
    )  # fmt: skip


def accelerations(y: Any, detent: float) -> Any:
    """X'', theta'', psi_1'', psi_2'' and the contact forces N across, F_1, F_2 along.

    y : middle of the axle X, heading, wheel angles, and their rates.
    """
    forward = np.array([np.cos(y[2]), np.sin(y[2])])
    across, omega, velocity = quarter_turn(forward), y[7], y[5:7]
    left, right = np.zeros((8, 8)), np.zeros(8)
    masses, arms = (BODY, WHEEL, WHEEL), (OFFSET * forward, TRACK * across, -TRACK * across)
    for mass, arm in zip(masses, arms, strict=True):
        # a = X'' + theta'' J arm - omega^2 arm; its momentum, and its moment about X
        turned = quarter_turn(arm)
        left[:2, :2] += mass * np.eye(2)
        left[:2, 2] += mass * turned
        right[:2] += mass * omega**2 * arm
        left[2, :2] += mass * turned
        left[2, 2] += mass * turned @ turned
        right[2] += mass * omega**2 * turned @ arm
    # body and disks about their own vertical axes
    left[2, 2] += INERTIA + 2 * AXLE / 2
    left[:2, 5], left[:2, 6], left[:2, 7] = -across, -forward, -forward
    left[2, 6:] = TRACK, -TRACK
    left[3, 3], left[3, 6], right[3] = AXLE, RADIUS, -detent * np.cos(y[3])
    left[4, 4], left[4, 7] = AXLE, RADIUS
    # the constraints, once more
    left[5, :2], right[5] = across, omega * forward @ velocity
    for row, side in ((6, 1.0), (7, -1.0)):
        left[row, :2], left[row, 2], left[row, row - 3] = forward, -side * TRACK, -RADIUS
        right[row] = -omega * across @ velocity
    return np.linalg.solve(left, right)


@cache
def newton(case: str) -> Any:
    """psi_1, wheel rates, omega, u, v and the contact forces at TIMES."""
    detent, heading = DETENTS[case], 0.7
    forward = np.array([np.cos(heading), np.sin(heading)])
    rates = (SPEED - TRACK * SPIN) / RADIUS, (SPEED + TRACK * SPIN) / RADIUS
    start = [0.3, -0.2, heading, ANGLE, 0.9, *(SPEED * forward), SPIN, *rates]
    y = by_hand(lambda t, y: [*y[5:], *accelerations(y, detent)[:5]], start, TIMES)
    found = []
    for row in y:
        forward = np.array([np.cos(row[2]), np.sin(row[2])])
        body = row[7], row[5:7] @ forward, row[5:7] @ quarter_turn(forward)
        found.append([row[3], *row[8:], *body, *accelerations(row, detent)[5:]])
    return np.array(found)


def as_scene(case: str) -> tuple[Any, Any]:
    y = newton(case)
    return y[:, : 1 if DETENTS[case] else 0], y[:, 1:6]


@pytest.mark.parametrize("case", DETENTS)
def test_reference_flow_and_contact_forces_agree_with_newton(case: str) -> None:
    scene = scene_with(case)
    run = gni.integrate(scene.system, scene.start, step=TIMES[1], t_end=TIMES[-1], method=PRECISE)
    base, velocity = as_scene(case)
    np.testing.assert_allclose(run.base, base, atol=1e-9)
    np.testing.assert_allclose(run.velocities, velocity, atol=1e-9)
    np.testing.assert_allclose(run.multipliers, newton(case)[:, 6:], atol=1e-8)


def test_the_exact_motion_without_detent_is_that_of_newton() -> None:
    np.testing.assert_allclose(scene_with("free").exact(TIMES)[1], as_scene("free")[1], atol=1e-11)


def test_without_detent_the_robot_moves_as_a_heavier_sleigh() -> None:
    mass = BODY + 2 * WHEEL + 2 * AXLE / RADIUS**2
    inertia = INERTIA + BODY * OFFSET**2 + 2 * WHEEL * TRACK**2 + AXLE
    inertia += 2 * AXLE * (TRACK / RADIUS) ** 2
    offset = BODY * OFFSET / mass
    sleigh = gni.scenes.chaplygin_sleigh(mass, inertia - mass * offset**2, offset, SPIN, SPEED)
    ours, theirs = (scene.exact(TIMES)[1] for scene in (scene_with("free"), sleigh))
    np.testing.assert_allclose(ours[:, 2:], theirs, atol=1e-13)
    # not with the same side force: the wheels' spin is no mass that is carried round
    heavier = gni.integrate(sleigh.system, sleigh.start, step=TIMES[1], t_end=3.0, method=PRECISE)
    surplus = 2 * AXLE / RADIUS**2 * theirs[:, 0] * theirs[:, 1]
    forces = newton("free")[:, 6] + surplus
    np.testing.assert_allclose(heavier.multipliers[:, 0], forces, atol=1e-8)


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), detent=st.sampled_from([0.0, 0.7]),
       spin=st.sampled_from([0.0, 0.9]))
def test_starts_roll_without_slipping(seed: int, detent: float, spin: float) -> None:
    numbers = np.random.default_rng(seed).uniform(0.2, 2.0, 7)
    scene = gni.scenes.two_wheeled_robot(*numbers, detent, 0.3, spin, -1.3)
    left, right, omega, along, across = scene.start.velocity
    radius, track = numbers[5:]
    assert (omega, along, across) == pytest.approx((spin, -1.3, 0.0), abs=1e-13)
    assert along - track * omega == pytest.approx(radius * left, abs=1e-12)
    assert along + track * omega == pytest.approx(radius * right, abs=1e-12)
    assert list(scene.start.base) == ([0.3] if detent else [])
    assert (scene.exact is None) == (detent != 0.0 or spin == 0.0)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("case", DETENTS)
def test_order_two(case: str, method: Any) -> None:
    counts = [120, 240, 480, 960]
    truth = [part[-1] for part in as_scene(case)]
    errors = end_errors(scene_with(case), method, TIMES[-1], counts, truth)
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.04)


def test_constraint_at_round_off_and_energy_kept_or_near_its_start() -> None:
    scene = scene_with("free")
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=2000)
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
    assert change(run.energy()) < 1e-12
    scene, records = scene_with("detent"), []
    for h in (0.02, 0.01):
        run = gni.integrate(scene.system, scene.start, step=h, t_end=20.0)
        assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
        records.append(change(run.energy()))
    assert records[1] < 2e-3
    assert np.log2(records[0] / records[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
@pytest.mark.parametrize("case", DETENTS)
def test_the_robot_with_its_pose_gives_the_same_motion_to_round_off(
    case: str, method: Any
) -> None:
    scene = scene_with(case)
    full = full_models.robot(scene)
    assert gap_to_full(scene, full, step=0.02, n_steps=150, method=method) < 1e-12


def test_the_robot_in_coordinates_gives_the_same_motion_to_order_two() -> None:
    scene = scene_with("detent")
    full = full_models.robot_in_coordinates(scene)
    counts = np.array([120, 240, 480])
    gaps = [gap_to_full(scene, full, step=2.0 / n, n_steps=n) for n in counts]
    assert slope(counts, gaps) == pytest.approx(2.0, abs=0.1)


def test_bad_input_is_refused_by_name() -> None:
    with pytest.raises(gni.InputError, match="radius must be a positive number, got 0"):
        gni.scenes.two_wheeled_robot(radius=0.0)
    with pytest.raises(gni.InputError, match="metric is not positive definite"):
        gni.scenes.two_wheeled_robot(wheel_inertia=0.0)
    with pytest.raises(gni.InputError, match="unknown parameter 'k'"):
        gni.scenes.two_wheeled_robot().system.with_parameters(k=0.5)


@pytest.mark.slow
def test_without_detent_energy_does_not_drift_over_a_hundred_thousand_steps() -> None:
    scene = scene_with("free")
    run = gni.integrate(scene.system, scene.start, step=0.02, n_steps=100_000)
    assert change(run.energy()) < 1e-11


@pytest.mark.slow
def test_a_slow_robot_is_caught_by_the_detent_and_circles_about_its_first_wheel() -> None:
    scene = scene_with("detent")
    run = gni.integrate(scene.system, scene.start, step=0.02, n_steps=100_000)
    np.testing.assert_allclose(np.ptp(run.base[50_000:], axis=0), 0.0, atol=1e-12)
    left, _, omega, along, _ = run.velocities[50_000:].T
    # momenta at the nodes are those of the motion to order two
    np.testing.assert_allclose(left, 0.0, atol=2e-4)
    np.testing.assert_allclose(along, TRACK * omega, atol=2e-4)
    # the contact force at the wheel that stands balances the detent: R F_1 = -k cos psi_1
    torque = -DETENTS["detent"] * np.cos(run.base[-1, 0])
    assert RADIUS * run.multipliers[-1, 1] == pytest.approx(torque, rel=1e-3)
    assert change(run.energy()) < 2e-4


@pytest.mark.slow
def test_a_fast_robot_rolls_over_the_detent_and_its_energy_drifts_at_a_rate_of_order_two() -> None:
    scene, rates = gni.scenes.two_wheeled_robot(detent=0.6), []
    for h in (0.04, 0.02, 0.01):
        run = gni.integrate(scene.system, scene.start, step=h, t_end=2000.0)
        quarters = run.energy()[:-1].reshape(4, -1).mean(axis=1)
        rates.append((quarters[3] - quarters[1]) / run.energy()[0] / 1000.0)
    assert abs(rates[-1]) < 3e-6
    ratios = np.abs(np.array(rates[:-1]) / rates[1:])
    np.testing.assert_allclose(np.log2(ratios), 2.0, atol=0.1)
