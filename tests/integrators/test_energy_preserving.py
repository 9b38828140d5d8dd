"""What the energy-preserving flow keeps over long runs: energy, constraint, the way back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.diagnostics import moving_energy, roundoff_growth

EXACT = gni.EnergyPreserving()
GEARINGS = {"sin y": (0.0, 1.0, 0.0, 0.0), "no symmetry": (0.3, 1.0, 0.4, 0.5)}
# a driver that librates a little: of all starts one of the least shear
LIBRATING: dict[str, Any] = {
    "driver": np.pi, "driver_speed": 0.05, "quartic": 0.0, "asymmetry": 0.0,
}  # fmt: skip


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def transmission(gearing: str) -> gni.scenes.Scene:
    return gni.scenes.variable_transmission(GEARINGS[gearing], quartic=0.3, asymmetry=0.5)


def run_of(scene: gni.scenes.Scene, method: Any, h: float, steps: int) -> gni.Trajectory:
    return gni.integrate(
        scene.system, scene.start, step=h, n_steps=steps, method=method,
        save_every=max(1, steps // 4000),
    )  # fmt: skip


def assert_keeps_energy_and_constraint(run: gni.Trajectory, size: float) -> None:
    energy = run.energy()
    assert np.max(np.abs(energy / energy[0] - 1)) < size
    assert np.max(np.abs(run.constraint_residuals())) < 1e-13


def there_and_back(scene: gni.scenes.Scene, method: Any, h: float, steps: int) -> float:
    """Largest difference of base and velocity from the start."""
    system, start = scene.system, scene.start
    state = start
    for signed in (h, -h):
        run = gni.integrate(
            system, state, step=signed, n_steps=steps, method=method, save_every=steps
        )
        state = system.state(*run.final_state)
    gaps = [state.base - start.base, state.velocity - start.velocity]
    return float(np.max(np.abs(np.concatenate(gaps))))


@pytest.mark.parametrize("gearing", GEARINGS)
@pytest.mark.parametrize("order", [2, 4])
def test_energy_and_constraint_stay_at_round_off_where_nothing_is_reversible(
    order: int, gearing: str
) -> None:
    run = run_of(transmission(gearing), gni.GNI(order, EXACT), 0.1, 2000)
    assert_keeps_energy_and_constraint(run, 1e-12)


@pytest.mark.parametrize("order", [2, 4])
def test_the_way_back_is_the_way_there(order: int) -> None:
    # the turning driver amplifies each rounding about 100 times in 2000 steps
    assert there_and_back(transmission("no symmetry"), gni.GNI(order, EXACT), 0.1, 2000) < 1e-11
    librating = gni.scenes.variable_transmission(**LIBRATING)
    assert there_and_back(librating, gni.GNI(order, EXACT), 0.1, 2000) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("gearing", GEARINGS)
@pytest.mark.parametrize("order", [2, 4, 6])
def test_the_energy_error_grows_like_a_random_walk_of_roundings(order: int, gearing: str) -> None:
    run = run_of(transmission(gearing), gni.GNI(order, EXACT), 0.1, 100_000)
    assert_keeps_energy_and_constraint(run, 1e-11)
    assert roundoff_growth(run).exponent < 0.75


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4])
def test_a_hundred_thousand_steps_lead_back_where_the_motion_has_little_shear(order: int) -> None:
    librating = gni.scenes.variable_transmission(**LIBRATING)
    assert there_and_back(librating, gni.GNI(order, EXACT), 0.01, 100_000) < 1e-12


@pytest.mark.parametrize("order", [2, 4])
def test_the_variational_flow_keeps_the_energy_to_its_order_only(order: int) -> None:
    run = run_of(transmission("no symmetry"), gni.GNI(order), 0.1, 2000)
    energy = run.energy()
    assert np.max(np.abs(energy / energy[0] - 1)) > 1e-8


@pytest.mark.parametrize("order", [2, 4])
def test_without_projection_the_energy_is_kept_and_the_constraint_is_not(order: int) -> None:
    scene = transmission("no symmetry")
    run = run_of(scene, gni.GNI(order, EXACT, projection=None), 0.1, 2000)
    energy = run.energy()
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-12
    assert np.max(np.abs(run.constraint_residuals())) > 1e-9


# Affine constraints: the ball on a rotating table keeps the moving energy.


def turning_with_the_table(x: Any, p: Any) -> Any:
    """Plane and ball turn with the table: (Theta J q, Theta R^T e_3), in the body frame."""
    turn = x[2:].reshape(3, 3)
    return p.Theta * np.concatenate([gni.array([-x[1], x[0]]), turn[2]])


def moving_energies(order: int, steps: int, flow: Any) -> Any:
    """Relative change of E - <p, Y'> node by node, and the largest change of E."""
    scene = gni.scenes.inhomogeneous_ball(1.8, 0.9, (0.9, 0.5, 0.7), 0.8, (0.7, -0.2), (0.3, 0.6))
    run = run_of(scene, gni.GNI(order, flow), 0.1, steps)
    assert np.max(np.abs(run.constraint_residuals())) < 1e-13
    kept = moving_energy(run, turning_with_the_table)
    assert kept.symmetry.holds
    energy = run.energy()
    return np.abs(kept.values / kept.values[0] - 1), float(np.ptp(energy) / energy[0])


@pytest.mark.parametrize("order", [2, 4])
def test_the_moving_energy_of_the_inhomogeneous_ball_stays_at_round_off(order: int) -> None:
    changes, energy = moving_energies(order, 2000, EXACT)
    assert np.max(changes) < 1e-12
    assert energy > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 4])
def test_the_moving_energy_stays_at_round_off_over_twenty_thousand_steps(order: int) -> None:
    changes, energy = moving_energies(order, 20_000, EXACT)
    assert np.max(changes) < 1e-11
    assert energy > 0.1


def test_the_variational_flow_keeps_the_moving_energy_to_order_two_only() -> None:
    changes, _ = moving_energies(2, 2000, gni.Variational())
    assert np.max(changes) > 1e-6
