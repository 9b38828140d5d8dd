"""The continuously variable transmission: a model on R^3, its reversor, bad inputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from measures import PRECISE, by_hand

import groupoid_gni as gni

NUMBERS: dict[str, Any] = {
    "gearing": (0.3, 1.1, 0.4, -0.5),
    "stiffness": 1.6,
    "quartic": 0.35,
    "asymmetry": 0.7,
    "position": (0.9, -0.6),
    "velocity": 0.4,
    "driver": 0.8,
    "driver_speed": -2.3,
}


def ratio(y: Any) -> Any:
    """f(y) of NUMBERS."""
    a, b, c, d = NUMBERS["gearing"]
    return a + b * np.sin(y) + c * np.cos(y) + d * np.sin(2 * y)


def potential(x: Any, z: Any, y: Any) -> Any:
    """V of NUMBERS."""
    k, q, e = (NUMBERS[name] for name in ("stiffness", "quartic", "asymmetry"))
    springs = x**2 / 2 + k * z**2 / 2 + q * (x**4 / 4 + x**2 * z**2 / 2)
    return springs + np.cos(y) + e / 2 * np.sin(2 * y)


def on_the_line() -> tuple[gni.MechanicalSystem, gni.State]:
    """The same on R^3 x R^3, order (x, z, y), the driver's angle in R."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=np.eye(3),
        constraints=lambda q, p: gni.array([[1.0, ratio(q[2]), 0.0]]),
        potential=lambda q, p: potential(q[0], q[1], q[2]),
    )
    (x, z), y, w = (NUMBERS[name] for name in ("position", "driver", "velocity"))
    return system, system.state([x, z, y], [-ratio(y) * w, w, NUMBERS["driver_speed"]])


def rate(t: float, state: Any) -> Any:
    """Newton's equations with the multiplier from the constraint, differentiated once."""
    x, z, y, u, w, v = state
    k, q, e = (NUMBERS[name] for name in ("stiffness", "quartic", "asymmetry"))
    _, b, c, d = NUMBERS["gearing"]
    f = ratio(y)
    slope = b * np.cos(y) - c * np.sin(y) + 2 * d * np.cos(2 * y)
    along_x, along_z = -x - q * x**3 - q * x * z**2, -k * z - q * x**2 * z
    multiplier = -(along_x + f * along_z + slope * v * w) / (1 + f**2)
    turn = np.sin(y) - e * np.cos(2 * y)
    return [u, w, v, along_x + multiplier, along_z + f * multiplier, turn]


def as_on_the_line(run: gni.Trajectory) -> Any:
    """(x, z, cos y, sin y, x', z', y') at every node."""
    return np.hstack([run.base[:, [0, 1, 2, 4]], run.velocities])


def test_the_scene_is_the_model_on_r3_and_newtons_equations() -> None:
    scene = gni.scenes.variable_transmission(**NUMBERS)
    line, start = on_the_line()
    options: dict[str, Any] = {"step": 0.5, "t_end": 6.0, "method": PRECISE}
    ours = as_on_the_line(gni.integrate(scene.system, scene.start, **options))
    run = gni.integrate(line, start, **options)
    other = np.column_stack(
        [run.base[:, :2], np.cos(run.base[:, 2]), np.sin(run.base[:, 2]), run.velocities]
    )
    np.testing.assert_allclose(ours, other, atol=1e-10)
    x, z, y, *velocity = by_hand(rate, np.concatenate([start.base, start.velocity]), run.times).T
    newton = np.column_stack([x, z, np.cos(y), np.sin(y), *velocity])
    np.testing.assert_allclose(ours, newton, atol=1e-10)


def test_with_the_exponential_every_step_is_that_of_r3() -> None:
    scene = gni.scenes.variable_transmission(**NUMBERS)
    turning = gni.SO2(retraction=gni.Exponential())
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(gni.VectorGroup(2), turning),
        parameters=scene.system.parameters, **scene.system.plain,
    )  # fmt: skip
    line, start = on_the_line()
    state = system.state(scene.start.base, scene.start.velocity)
    ours = gni.integrate(system, state, step=0.1, n_steps=200)
    other = gni.integrate(line, start, step=0.1, n_steps=200)
    np.testing.assert_allclose(ours.velocities, other.velocities, atol=1e-11)
    np.testing.assert_allclose(ours.base[:, :2], other.base[:, :2], atol=1e-11)


def mirrored(scene: gni.scenes.Scene, state: tuple[Any, Any]) -> tuple[Any, Any]:
    """(x, z, y; x', z', y') -> (-x, z, -y; x', -z', y'): reversed in time, with x and y mirrored.

    A driver that turns goes on turning the same way. The turn by y is given row by row.
    """
    base, velocity = state
    return base * [-1, 1, 1, -1, -1, 1], velocity * [1, -1, 1]


def distance_after_mirrors(**options: Any) -> float:
    """How far from the start two runs end, each followed by the mirror."""
    scene = gni.scenes.variable_transmission(**{**NUMBERS, **options})
    system, state = scene.system, (scene.start.base, scene.start.velocity)
    for _ in range(2):
        run = gni.integrate(system, system.state(*state), step=4.0, n_steps=1, method=PRECISE)
        state = mirrored(scene, run.final_state)
    return float(np.max(np.abs(np.concatenate(state) - np.concatenate(
        [scene.start.base, scene.start.velocity]
    ))))  # fmt: skip


def test_the_motion_with_an_odd_gearing_and_an_even_driver_is_reversible() -> None:
    assert distance_after_mirrors(gearing=(0.0, 1.1, 0.0, -0.5), asymmetry=0.0) < 1e-10


def test_with_an_uneven_driver_that_mirror_does_not_reverse_it() -> None:
    assert distance_after_mirrors(gearing=(0.0, 1.1, 0.0, -0.5)) > 1e-2


@pytest.mark.parametrize("gearing", [(0.3, 1.1, 0.0, 0.0), (0.0, 1.1, 0.4, 0.0)])
def test_with_an_uneven_gearing_the_mirror_leaves_the_constraint(gearing: Any) -> None:
    with pytest.raises(gni.InputError, match="violates the constraints"):
        distance_after_mirrors(gearing=gearing, asymmetry=0.0)


def test_the_driver_stays_a_rotation_however_often_it_turns() -> None:
    scene = gni.scenes.variable_transmission(**NUMBERS)
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=5000, save_every=500)
    turns = run.base[:, 2:].reshape(-1, 2, 2)
    np.testing.assert_allclose(turns @ turns.swapaxes(1, 2), [np.eye(2)] * len(run), atol=1e-14)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gearing": (1.0, 0.5)}, r"gearing must have shape \(4,\)"),
        ({"gearing": (0.0, np.nan, 0.0, 0.0)}, "gearing must be finite"),
        ({"position": (1.0, 0.5, 0.2)}, r"position must have shape \(2,\)"),
        ({"position": (1.0, np.inf)}, "position must be finite"),
        ({"velocity": np.nan}, "velocity"),
        ({"stiffness": np.inf}, "k"),
    ],
)
def test_bad_numbers_are_refused_by_name(options: dict[str, Any], words: str) -> None:
    with pytest.raises(gni.InputError, match=words):
        gni.scenes.variable_transmission(**options)
