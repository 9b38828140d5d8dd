"""Scenes: starts on the constraints, exact motions that solve equations written here."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import groupoid_gni as gni

_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
positive, signed = st.floats(0.2, 3.0), st.floats(-2.0, 2.0)


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def values_and_rates(scene: gni.scenes.Scene, t: float, delta: float = 5e-3) -> tuple[Any, Any]:
    """Base and velocity side by side at t, and their time derivative by differences."""
    assert scene.exact is not None
    both = np.concatenate(scene.exact(t + delta * np.arange(-4, 5)), axis=1)
    return both[4], _WEIGHTS @ both / delta


@settings(max_examples=40, deadline=None)
@given(m=positive, r=positive, inertia=positive, table=signed,
       q=st.tuples(signed, signed), v=st.tuples(signed, signed), spin=signed)
def test_exact_motion_of_the_rolling_ball_solves_newton_and_euler(
    m: float, r: float, inertia: float, table: float, q: Any, v: Any, spin: float
) -> None:
    scene = gni.scenes.rolling_ball(m, r, inertia, table, q, v, spin)
    start_base, start_velocity = (part[0] for part in scene.exact(np.zeros(1)))
    np.testing.assert_allclose(start_base, q, atol=1e-15)
    np.testing.assert_allclose(start_velocity, scene.start.velocity, atol=1e-14)
    now, rate = values_and_rates(scene, 1.7)
    x, y, vx, vy, *omega = now
    scale = 1 + np.abs(now).max()
    near = {"rtol": 0, "atol": 1e-9 * scale * (1 + m) * (1 + inertia / r)}
    np.testing.assert_allclose(rate[:2], [vx, vy], **near)
    # (41), and the contact force f = m q'' at -r e3 turning the ball: I omega' = -r e3 x f
    np.testing.assert_allclose([vx - r * omega[1] + table * y], 0, **near)
    np.testing.assert_allclose([vy + r * omega[0] - table * x], 0, **near)
    force = m * np.array([rate[2], rate[3], 0.0])
    torque = np.cross([0.0, 0.0, -r], force)
    np.testing.assert_allclose(inertia * rate[4:], torque, **near)
    assert omega[2] == pytest.approx(spin)


@settings(max_examples=40, deadline=None)
@given(m=positive, inertia=positive, offset=st.floats(0.05, 1.5), spin=st.floats(0.1, 2.0),
       turned=st.booleans(), speed=signed)
def test_exact_motion_of_the_sleigh_solves_its_equations(
    m: float, inertia: float, offset: float, spin: float, turned: bool, speed: float
) -> None:
    spin = -spin if turned else spin
    scene = gni.scenes.chaplygin_sleigh(m, inertia, offset, spin, speed)
    base, velocity = scene.exact(np.zeros(1))
    assert base.shape == (1, 0)
    np.testing.assert_allclose(velocity[0], [spin, speed, 0.0], atol=1e-13)
    (omega, along, across), rate = values_and_rates(scene, 0.6, 2e-3)
    about_blade = inertia + m * offset**2
    near = {"rtol": 1e-7, "atol": 1e-7}
    np.testing.assert_allclose(rate[0], -m * offset * along * omega / about_blade, **near)
    np.testing.assert_allclose(rate[1], offset * omega**2, **near)
    assert across == rate[2] == 0.0


def test_a_table_at_rest_lets_the_ball_roll_straight() -> None:
    scene = gni.scenes.rolling_ball(1.3, 0.7, 0.4, 0.0, (0.2, -0.5), (0.8, 0.3), 1.1)
    base, velocity = scene.exact(np.array([0.0, 2.5]))
    np.testing.assert_allclose(base[1], [0.2 + 2.0, -0.5 + 0.75], rtol=1e-14)
    np.testing.assert_allclose(velocity[1], velocity[0], rtol=1e-14)
    run = gni.integrate(scene.system, scene.start, step=0.25, t_end=2.5)
    np.testing.assert_allclose(run.base[-1], base[1], atol=1e-12)


@pytest.mark.parametrize(("spin", "offset"), [(0.0, 0.4), (1.2, 0.0)])
def test_a_sleigh_without_coupling_has_no_closed_form_but_runs(spin: float, offset: float) -> None:
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.7, offset, spin, 0.6)
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=50)
    np.testing.assert_allclose(run.velocities, [[spin, 0.6, 0.0]] * 51, atol=1e-14)


def test_a_sleigh_pulled_backwards_turns_round() -> None:
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.7, 0.4, 1e-3, -1.5)
    early, late = scene.exact(np.array([0.0, 60.0]))[1]
    assert early[1] < 0 < late[1]
    assert abs(late[1]) == pytest.approx(1.5, rel=1e-5)


@settings(max_examples=25, deadline=None)
@given(
    m=positive, r=positive, moments=st.tuples(*[positive] * 3), table=signed,
    q=st.tuples(signed, signed), v=st.tuples(signed, signed), spin=signed,
    turn=st.tuples(*[signed] * 3),
)
def test_starts_of_the_inhomogeneous_ball_roll_without_slipping(
    m: float, r: float, moments: Any, table: float, q: Any, v: Any, spin: float, turn: Any
) -> None:
    attitude = gni.SO3().exp(np.array(turn))
    scene = gni.scenes.inhomogeneous_ball(m, r, moments, table, q, v, attitude, spin)
    base, velocity = scene.start.base, scene.start.velocity
    np.testing.assert_array_equal(base, np.concatenate([q, attitude.ravel()]))
    omega = attitude @ velocity[2:]
    scale = 1e-12 * (1 + r) * (1 + np.abs(velocity).max())
    assert abs(velocity[0] - r * omega[1] + table * q[1]) < scale
    assert abs(velocity[1] + r * omega[0] - table * q[0]) < scale
    assert omega[2] == pytest.approx(spin, abs=1e-12 * (1 + np.abs(velocity).max()))
    np.testing.assert_allclose(velocity[:2], v, atol=scale)
    momentum = np.concatenate([m * velocity[:2], np.array(moments) * velocity[2:]])
    np.testing.assert_allclose(scene.start.momentum, momentum, rtol=1e-12)


def test_the_default_inhomogeneous_ball_is_figure_3_left() -> None:
    scene = gni.scenes.inhomogeneous_ball()
    parameters = scene.system.parameters
    assert (parameters["m"], parameters["r"], parameters["Theta"]) == (2.0, 1.0, 1.0)
    np.testing.assert_array_equal(parameters["I"], [1.0, 0.5, 0.7])
    np.testing.assert_array_equal(scene.start.base[:2], [1.0, 0.0])
    np.testing.assert_allclose(scene.start.velocity[:2], [0.0, 0.75], atol=1e-15)
    from scipy.spatial.transform import Rotation

    expected = Rotation.from_rotvec([0.5, 0.5, 0.5]).as_matrix()
    np.testing.assert_allclose(scene.start.base[2:].reshape(3, 3), expected, atol=1e-15)


def test_equal_moments_make_the_inhomogeneous_ball_the_homogeneous_one() -> None:
    place, speed = (0.4, -0.9), (0.3, 0.7)
    full = gni.scenes.inhomogeneous_ball(1.7, 0.8, (0.6,) * 3, 1.3, place, speed, None, 0.35)
    reduced = gni.scenes.rolling_ball(1.7, 0.8, 0.6, 1.3, place, speed, 0.35)
    options: dict[str, Any] = {"step": 0.5, "t_end": 4.0}
    options["method"] = gni.ReferenceFlow(rtol=1e-12)
    one = gni.integrate(full.system, full.start, **options)
    exact = reduced.exact(one.times)
    np.testing.assert_allclose(one.base[:, :2], exact[0], atol=1e-10)
    rotations = one.base[:, 2:].reshape(-1, 3, 3)
    omega = np.einsum("nij,nj->ni", rotations, one.velocities[:, 2:])
    np.testing.assert_allclose(omega, exact[1][:, 2:], atol=1e-10)


@pytest.mark.parametrize("tau", [gni.Cayley(), gni.Exponential()])
@pytest.mark.parametrize(
    "make",
    [
        "rolling_ball", "inhomogeneous_ball", "chaplygin_sleigh",
        "suslov", "veselova", "two_wheeled_robot",
    ],
)  # fmt: skip
def test_every_scene_takes_every_retraction_and_says_what_it_leaves_out(
    make: str, tau: gni.Retraction
) -> None:
    scene = getattr(gni.scenes, make)(retraction=tau)
    run = gni.integrate(scene.system, scene.start, step=0.02, n_steps=100)
    assert run.success
    truth = gni.integrate(
        scene.system, scene.start, step=0.02, n_steps=100, method=gni.ReferenceFlow(rtol=1e-11)
    )
    np.testing.assert_allclose(run.base, truth.base, atol=2e-3)
    np.testing.assert_allclose(run.velocities, truth.velocities, atol=2e-3)
    assert len(scene.description) > 20
