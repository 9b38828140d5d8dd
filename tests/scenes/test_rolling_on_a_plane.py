"""Rattleback and disc against Newton and Euler in plain floats (tests/hard_cases)."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from measures import change, hat, quietly, slope

import groupoid_gni as gni

sys.path.append(str(Path(__file__).parents[1] / "hard_cases"))

import rolling_by_hand as by_hand

SIXTH = gni.GNI(6, gni.EnergyPreserving())
STONE = {
    "semiaxes": (2.1, 0.4, 0.25), "depth": 0.1, "inertia": (0.03, 0.24, 0.26), "product": -0.013,
    "mass": 1.7, "gravity": 9.6, "roll": 2.0, "pitch": -3.0, "spin": (0.3, -0.2, 4.0),
}  # fmt: skip
PLATE = {
    "mass": 1.7, "radius": 0.6, "inertia": (0.17, 0.31), "gravity": 9.6, "tilt": 25.0,
    "spin": (0.4, 3.0, -2.0),
}  # fmt: skip
BODIES: dict[str, tuple[Any, by_hand.Arm, float]] = {
    "stone": (
        lambda **more: gni.scenes.rattleback(**STONE, **more),
        by_hand.ellipsoid(2.1, 0.4, 0.25, 0.1), 1.0,
    ),
    "plate": (lambda **more: gni.scenes.rolling_disc(**PLATE, **more), by_hand.rim(0.6), 1.0),
}  # fmt: skip
every_body = pytest.mark.parametrize("name", BODIES)


@cache
def scene_of(name: str) -> gni.scenes.Scene:
    return BODIES[name][0]()


@cache
def truth(name: str) -> tuple[Any, Any]:
    """Instants and (gamma, Omega) by hand."""
    scene, (_, arm, t_end) = scene_of(name), BODIES[name]
    p, instants = scene.system.parameters, np.linspace(0.0, t_end, 21)
    start = np.concatenate([scene.start.base, scene.start.velocity[:3]])
    return instants, by_hand.motion(1.7, 9.6, p["I"], arm, start, instants, 1e-12)


def arms(name: str, states: Any) -> Any:
    arm = BODIES[name][1]
    return np.array([arm(tuple(s[:3]), (0.0, 0.0, 0.0))[0] for s in states])


@every_body
def test_reference_flow_and_force_of_the_plane_are_those_of_newton_and_euler(name: str) -> None:
    scene, (instants, states) = scene_of(name), truth(name)
    run = gni.integrate(scene.system, scene.start, step=instants[1], t_end=instants[-1],
                        method=gni.ReferenceFlow(1e-12))  # fmt: skip
    found = np.hstack([run.base, run.velocities[:, :3]])
    np.testing.assert_allclose(found, states, atol=1e-8 * np.abs(states).max())
    inertia = tuple(map(tuple, scene.system.parameters["I"].tolist()))
    forces = [
        by_hand.acceleration(1.7, 9.6, inertia, BODIES[name][1], tuple(s[:3]), tuple(s[3:]))[2]
        for s in states
    ]
    np.testing.assert_allclose(run.multipliers + 1.7 * 9.6 * run.base, forces, atol=1e-5)


@every_body
def test_the_contact_point_rests(name: str) -> None:
    scene = scene_of(name)
    run = gni.integrate(scene.system, scene.start, step=0.005, n_steps=200)
    spin, velocity = run.velocities[:, :3], run.velocities[:, 3:]
    contact = velocity + np.cross(spin, arms(name, run.base))
    assert np.max(np.abs(contact)) < 1e-12 * np.max(np.abs(velocity))
    assert np.max(np.abs(np.linalg.norm(run.base, axis=1) - 1.0)) < 1e-14


@every_body
@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_order_two(name: str, method: Any) -> None:
    scene, (instants, states) = scene_of(name), truth(name)
    counts, errors = [1280, 2560, 5120], []
    for n in counts:
        run = quietly(scene.system, scene.start, step=instants[-1] / n, n_steps=n, method=method,
                      save_every=n)  # fmt: skip
        end = np.concatenate([run.base[-1], run.velocities[-1, :3]])
        errors.append(np.max(np.abs(end - states[-1])))
    assert slope(counts, errors) == pytest.approx(2.0, abs=0.1)


@every_body
def test_the_sixth_order_keeps_the_energy_and_finds_the_end(name: str) -> None:
    scene, (instants, states) = scene_of(name), truth(name)
    run = gni.integrate(scene.system, scene.start, step=instants[-1] / 500, n_steps=500,
                        method=SIXTH)  # fmt: skip
    assert change(run.energy()) < 1e-12
    end = np.concatenate([run.base[-1], run.velocities[-1, :3]])
    np.testing.assert_allclose(end, states[-1], atol=1e-7 * np.abs(states).max())


@every_body
def test_the_potential_is_the_weight_at_the_height_of_the_centre_of_mass(name: str) -> None:
    scene = scene_of(name)
    run = gni.integrate(scene.system, scene.start, step=0.002, n_steps=300, method=SIXTH)
    heights = -np.sum(run.base * arms(name, run.base), axis=1)
    kinetic = 0.5 * np.einsum(
        "ni,ij,nj->n", run.velocities, scene.system.evaluate("metric", scene.start.base),
        run.velocities,
    )  # fmt: skip
    np.testing.assert_allclose(run.energy() - kinetic, 1.7 * 9.6 * heights, atol=1e-12)
    # the reconstructed pose knows its height, too, by another way
    up = scene.start.base
    level = np.cross(up, [0.3, 0.9, -0.2])
    level /= np.linalg.norm(level)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([level, np.cross(up, level), up])
    pose[2, 3] = heights[0]
    again = gni.integrate(scene.system, scene.start, step=0.002, n_steps=300, method=SIXTH,
                          reconstruct=pose)  # fmt: skip
    poses = again.reconstruct()
    np.testing.assert_allclose(poses[:, 2, :3], run.base, atol=1e-12)
    np.testing.assert_allclose(poses[:, 2, 3], heights, atol=1e-7)


@every_body
def test_both_retractions_give_the_same_motion_to_order_two(name: str) -> None:
    ends = []
    for tau in (gni.Cayley(), gni.Exponential()):
        scene = BODIES[name][0](retraction=tau)
        ends.append([
            gni.integrate(scene.system, scene.start, step=0.5 / n, n_steps=n).velocities[-1]
            for n in (500, 1000)
        ])
    gaps = np.max(np.abs(np.array(ends[0]) - ends[1]), axis=1)
    assert 0.0 < gaps[0] < 1e-2
    assert gaps[0] / gaps[1] == pytest.approx(4.0, abs=0.3)


def test_the_defaults_are_those_of_kane_and_levinson() -> None:
    scene = gni.scenes.rattleback()
    p = scene.system.parameters
    np.testing.assert_array_equal(p["I"], [[2.0, -0.2, 0.0], [-0.2, 16.0, 0.0], [0.0, 0.0, 17.0]])
    np.testing.assert_array_equal(p["axes"], [20.0, 3.0, 2.0])
    np.testing.assert_allclose(scene.start.velocity[:3], [0.0, 0.0, -5.0], atol=1e-12)
    # the third axis leans by half a degree about each of the first two
    gamma = scene.start.base
    assert np.degrees(np.arcsin(gamma[1])) == pytest.approx(0.5)
    assert np.degrees(np.arctan2(-gamma[0], gamma[2])) == pytest.approx(0.5)


def test_an_upright_disc_rolls_straight_on() -> None:
    scene = gni.scenes.rolling_disc(**{**PLATE, "tilt": 0.0, "spin": (0.0, 0.0, 2.5)})
    run = gni.integrate(scene.system, scene.start, step=0.01, n_steps=100,
                        reconstruct=np.eye(4))  # fmt: skip
    np.testing.assert_allclose(run.velocities[:, :3], [[0.0, 0.0, 2.5]] * 101, atol=1e-11)
    place = run.reconstruct()[-1, :3, 3]
    assert np.linalg.norm(place) == pytest.approx(0.6 * 2.5, rel=1e-4)


def test_a_disc_may_not_lie_flat_at_the_start() -> None:
    for tilt in (90.0, -120.0, np.nan):
        with pytest.raises(gni.InputError, match="tilt must lie between -90 and 90"):
            gni.scenes.rolling_disc(tilt=tilt)


def test_bad_numbers_are_refused_by_name() -> None:
    with pytest.raises(gni.InputError, match=r"semiaxes must have shape \(3,\)"):
        gni.scenes.rattleback(semiaxes=(1.0, 2.0))
    with pytest.raises(gni.InputError, match="inertia must be finite"):
        gni.scenes.rolling_disc(inertia=(1.0, np.inf))
    with pytest.raises(gni.InputError, match="positive definite"):
        gni.scenes.rattleback(product=6.0)


def test_mirror_images_move_as_mirror_images() -> None:
    """Turning round the product of inertia is a reflection: roll, pitch and spin with it."""
    one = gni.scenes.rattleback(**STONE)
    other = gni.scenes.rattleback(
        **{**STONE, "product": 0.013, "roll": 2.0, "pitch": 3.0, "spin": (0.3, 0.2, -4.0)}
    )
    runs = [gni.integrate(s.system, s.start, step=0.002, n_steps=300) for s in (one, other)]
    # x -> -x: gamma is a vector, Omega an axial one
    np.testing.assert_allclose(runs[1].base, runs[0].base * [-1, 1, 1], atol=1e-11)
    np.testing.assert_allclose(
        runs[1].velocities[:, :3], runs[0].velocities[:, :3] * [1, -1, -1], atol=1e-9
    )


def test_the_arms_written_here_have_the_rates_written_here() -> None:
    rng = np.random.default_rng(7)
    for _, arm, _ in BODIES.values():
        gamma = rng.normal(size=3)
        gamma /= np.linalg.norm(gamma)
        turned = np.cross(gamma, rng.normal(size=3))
        ends = [np.array(arm(tuple(gamma + e * turned), tuple(turned))[0]) for e in (-1e-6, 1e-6)]
        rate = arm(tuple(gamma), tuple(turned))[1]
        np.testing.assert_allclose((ends[1] - ends[0]) / 2e-6, rate, atol=1e-8)
    matrix = hat([0.3, -0.2, 0.7]) @ hat([0.3, -0.2, 0.7]).T + np.eye(3)
    b = (0.4, -1.0, 0.2)
    np.testing.assert_allclose(
        by_hand.solved(tuple(map(tuple, matrix)), b), np.linalg.solve(matrix, b), atol=1e-14
    )
