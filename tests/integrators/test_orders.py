"""Orders of convergence, measured against exact solutions and equations written here by hand."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import groupoid_gni as gni

SECOND_ORDER = [gni.Rattle(), gni.Midpoint(), gni.GNI(order=2)]
SECOND_ORDER.append(gni.GNI(flow=gni.Variational(gni.Rattle())))
FIRST_ORDER = [gni.EulerA(), gni.EulerB()]


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def slope(steps: Any, errors: Any) -> float:
    """The slope of log error over log step by least squares."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def by_hand(rate: Callable[[float, Any], Any], start: Any, end: float) -> Any:
    """The end point of equations written in this file, by DOP853."""
    done = solve_ivp(rate, (0.0, end), start, method="DOP853", rtol=3e-14, atol=1e-14)
    assert done.success
    return done.y[:, -1]


def end_errors(
    system: Any, start: Any, method: Any, end: float, counts: list[int], exact: Any
) -> list[float]:
    errors = []
    for n in counts:
        run = gni.integrate(
            system, start, step=end / n, n_steps=n, method=method, save_every=n
        )
        base, velocity = run.final_state
        errors.append(float(np.max(np.abs(np.concatenate([base, velocity]) - exact))))
    return errors


# The homogeneous ball of section 7.4.1 and figure 1.


def ball_errors(h: float, method: Any) -> tuple[float, float]:
    """Largest errors of position and of angular velocity up to t = 10."""
    scene = gni.scenes.rolling_ball(1.0, 1.0, 2 / 3, 1.0, (1.0, 1.0), (1.0, 1.0), 0.0)
    run = gni.integrate(scene.system, scene.start, step=h, t_end=10.0, method=method)
    # Exact, derived here: (I + m r^2) q'' = I Theta J q'.
    rate, t = 1.0 * (2 / 3) / (2 / 3 + 1.0), run.times
    q_dot = np.stack([np.cos(rate * t) - np.sin(rate * t), np.cos(rate * t) + np.sin(rate * t)], 1)
    q = 1 + np.stack(
        [np.sin(rate * t) + np.cos(rate * t) - 1, np.sin(rate * t) - np.cos(rate * t) + 1], 1
    ) / rate
    omega = np.stack([q[:, 0] - q_dot[:, 1], q[:, 1] + q_dot[:, 0], 0 * t], 1)
    position = np.linalg.norm(run.base - q, axis=1).max()
    return position, np.linalg.norm(run.velocities[:, 2:] - omega, axis=1).max()


def test_homogeneous_ball_of_figure_1_has_the_expected_error_at_a_tenth() -> None:
    position, _ = ball_errors(0.1, gni.Rattle())
    assert 3.4e-3 < position < 4.2e-3


@pytest.mark.parametrize("method", [*FIRST_ORDER, *SECOND_ORDER], ids=str)
def test_homogeneous_ball_of_figure_1_is_second_order_in_position_and_spin(method: Any) -> None:
    steps = [0.2, 0.1, 0.05, 0.025, 0.0125]
    errors = np.array([ball_errors(h, method) for h in steps])
    assert slope(steps, errors[:, 0]) == pytest.approx(2.0, abs=0.03)
    assert slope(steps, errors[:, 1]) == pytest.approx(2.0, abs=0.03)


# The Chaplygin sleigh and the inhomogeneous ball, equations by hand.


def sleigh() -> tuple[gni.scenes.Scene, Callable[[float, Any], Any], Any]:
    m, inertia, a = 1.3, 0.6, 0.4
    scene = gni.scenes.chaplygin_sleigh(m, inertia, a, spin=1.1, speed=-0.7)

    def rate(t: float, y: Any) -> Any:
        return [-m * a * y[0] * y[1] / (inertia + m * a * a), a * y[0] ** 2, 0.0]

    return scene, rate, np.array([1.1, -0.7, 0.0])


def ball() -> tuple[gni.scenes.Scene, Callable[[float, Any], Any], Any]:
    m, r, table, moments = 1.7, 0.8, 0.9, np.array([0.9, 0.5, 0.7])
    scene = gni.scenes.inhomogeneous_ball(
        m, r, moments, table, (0.7, -0.2), (0.3, 0.6), vertical_spin=0.4
    )

    def rate(t: float, y: Any) -> Any:
        rotation, spin = y[2:11].reshape(3, 3), y[13:]
        hat = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
        left, right = np.zeros((7, 7)), np.zeros(7)
        left[:2, :2], left[:2, 5:] = m * np.eye(2), -np.eye(2)
        left[2:5, 2:5] = np.diag(moments)
        left[2:5, 5:] = -rotation.T @ np.array([[0, r], [-r, 0], [0, 0]])
        right[2:5] = np.cross(moments * spin, spin)
        left[5, 0], left[5, 2:5], right[5] = 1, -r * rotation[1], -table * y[12]
        left[6, 1], left[6, 2:5], right[6] = 1, r * rotation[0], table * y[11]
        accelerations = np.linalg.solve(left, right)[:5]
        return np.concatenate([y[11:13], (rotation @ hat).ravel(), accelerations])

    return scene, rate, np.concatenate([scene.start.base, scene.start.velocity])


@cache
def solved(name: str) -> tuple[gni.scenes.Scene, Any]:
    scene, rate, y0 = {"sleigh": sleigh, "ball": ball}[name]()
    return scene, by_hand(rate, y0, 2.0)


@pytest.mark.parametrize("name", ["sleigh", "ball"])
@pytest.mark.parametrize("method", SECOND_ORDER, ids=str)
def test_sleigh_and_inhomogeneous_ball_are_second_order(name: str, method: Any) -> None:
    scene, exact = solved(name)
    counts = [40, 80, 160, 320]
    errors = end_errors(scene.system, scene.start, method, 2.0, counts, exact)
    assert slope(2.0 / np.array(counts), errors) == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize("name", ["sleigh", "ball"])
def test_reference_flow_agrees_with_equations_written_by_hand(name: str) -> None:
    scene, exact = solved(name)
    run = gni.integrate(
        scene.system, scene.start, step=0.25, t_end=2.0, method=gni.ReferenceFlow(rtol=1e-12)
    )
    np.testing.assert_allclose(np.concatenate(run.final_state), exact, atol=1e-10)


# A nonholonomic particle: dz = y dx, quartic potential, and a base-dependent mass.


def bent_particle() -> tuple[gni.MechanicalSystem, Callable[[float, Any], Any], Any]:
    c, k = 0.4, 0.7
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda x, p: np.diag([1.3 + p.c * x[1] ** 2, 0.9, 1.6]),
        constraints=lambda x, p: np.array([[-x[1], 0.0, 1.0]]),
        drift=lambda x, p: np.array([0.0, 0.0, 0.3 * x[0]]),
        potential=lambda x, p: p.k * (x @ x) ** 2 / 4 + 0.5 * x[0] * x[2],
        parameters={"c": c, "k": k},
    )

    def rate(t: float, y: Any) -> Any:
        q, v = y[:3], y[3:]
        mass = np.array([1.3 + c * q[1] ** 2, 0.9, 1.6])
        force = -k * (q @ q) * q - 0.5 * np.array([q[2], 0, q[0]])
        force = force + np.array([-2 * c * q[1] * v[0] * v[1], c * q[1] * v[0] ** 2, 0.0])
        mu = np.array([-q[1], 0.0, 1.0])
        # z' - y x' - 0.3 x = 0, differentiated once more
        wanted = v[1] * v[0] + 0.3 * v[0] - mu @ (force / mass)
        return np.concatenate([v, (force + mu * wanted / (mu @ (mu / mass))) / mass])

    q = np.array([0.6, -0.5, 0.3])
    v = np.array([0.4, 0.9, -0.5 * 0.4 + 0.3 * 0.6])
    return system, rate, np.concatenate([q, v])


@cache
def bent_solution() -> tuple[gni.MechanicalSystem, gni.State, Any]:
    system, rate, y0 = bent_particle()
    return system, system.state(y0[:3], y0[3:]), by_hand(rate, y0, 1.5)


@pytest.mark.parametrize(
    ("method", "order"),
    [(m, 1.0) for m in FIRST_ORDER] + [(m, 2.0) for m in SECOND_ORDER],
    ids=str,
)
def test_orders_with_potential_curved_mass_and_a_turning_affine_constraint(
    method: Any, order: float
) -> None:
    system, start, exact = bent_solution()
    counts = [60, 120, 240, 480]
    errors = end_errors(system, start, method, 1.5, counts, exact)
    assert slope(1.5 / np.array(counts), errors) == pytest.approx(order, abs=0.03)


def test_reference_flow_agrees_on_the_curved_particle_forwards_and_backwards() -> None:
    system, start, exact = bent_solution()
    precise = gni.ReferenceFlow(rtol=1e-12)
    run = gni.integrate(system, start, step=0.1, t_end=1.5, method=precise)
    np.testing.assert_allclose(np.concatenate(run.final_state), exact, atol=1e-10)
    back = gni.integrate(
        system, system.state(*run.final_state), step=-0.1, t_end=-1.5, method=precise
    )
    np.testing.assert_allclose(back.base[-1], start.base, atol=1e-10)


@pytest.mark.parametrize("method", [*FIRST_ORDER, *SECOND_ORDER], ids=str)
def test_multipliers_converge_to_the_force_of_the_true_motion(method: Any) -> None:
    system, start, _ = bent_solution()
    n = 400
    run = gni.integrate(system, start, step=1.5 / n, n_steps=n, method=method)
    truth = gni.integrate(
        system, start, step=1.5 / n, n_steps=n, method=gni.ReferenceFlow(rtol=1e-12)
    )
    gap = np.abs(run.multipliers - truth.multipliers)[5:].max()
    assert gap < 0.02 * np.abs(truth.multipliers).max()
