"""The flight that keeps the energy: exact on every groupoid, self-adjoint, of order 2."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from flown import Flown
from turning_frame import StretchedPlane, stretched

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions, energy_preserving_flight
from groupoid_gni.discretization.energy_preserving_flight import EnergyPreservingStep

ENERGY = gni.EnergyPreserving()
H = 0.31


def energy(a: zoo.Animal, x: Any, p: Any) -> float:
    q = p - a.plain.gyroscopic(x)
    return float(q @ np.linalg.solve(a.plain.metric(x), q) / 2 + a.plain.potential(x))


def flat(name: str, **options: Any) -> zoo.Animal:
    return zoo.animal(name, 0, curved=False, **options)


ANIMALS = {
    "pair": lambda: zoo.animal("pair 3", 0, gyroscopic=True),
    "one dimension": lambda: zoo.animal("pair 1", 0, gyroscopic=True),
    "SO(3)": lambda: zoo.animal("SO3 right cay", 0),
    "SE(2)": lambda: zoo.animal("SE2 left exp", 0),
    "SE(3)": lambda: zoo.animal("SE3 left cay", 0, gyroscopic=True),
    "Atiyah": lambda: flat("atiyah right cay", gyroscopic=True),
    "framed": lambda: flat("framed left cay", gyroscopic=True),
    "action": lambda: zoo.animal("action left cay", 0),
    "action, exp": lambda: flat("action right exp", gyroscopic=True),
    "stretched": lambda: stretched(0, gyroscopic=True),
}


@pytest.mark.parametrize("name", ANIMALS)
def test_energy_is_exact_and_the_flight_is_its_own_adjoint(name: str) -> None:
    a = ANIMALS[name]()
    flight = Flown(a.system, ENERGY)
    x0, p0 = a.start.base, a.start.momentum
    x1, p1 = flight(x0, p0, H)
    assert np.max(np.abs(p1 - p0), initial=0) + np.max(np.abs(x1 - x0), initial=0) > 0.01
    np.testing.assert_allclose(energy(a, x1, p1), energy(a, x0, p0), rtol=0, atol=3e-15)
    x, p = flight(x1, p1, -H)
    np.testing.assert_allclose(x, x0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(p, p0, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", ["pair", "SO(3)", "action", "stretched"])
def test_it_is_of_order_two(name: str) -> None:
    a = ANIMALS[name]()
    flight, time = Flown(a.system, ENERGY), 0.64
    run = gni.integrate(
        a.system, a.start, step=time, n_steps=1, method=gni.ReferenceFlow(rtol=1e-12)
    )
    truth = np.append(run.base[-1], run.momenta[-1])

    def error(steps: int) -> float:
        x, p = a.start.base, a.start.momentum
        for _ in range(steps):
            x, p = flight(x, p, time / steps)
        return float(np.linalg.norm(np.append(x, p) - truth))

    assert 1.9 < np.log2(error(16) / error(32)) < 2.1


def test_only_frames_that_turn_need_the_balance(monkeypatch: pytest.MonkeyPatch) -> None:
    a = stretched(0)
    x0, p0 = a.start.base, a.start.momentum
    for name in ("SO3 left cay", "SE3 right exp", "framed right cay", "action left exp"):
        assert not EnergyPreservingStep(SystemExpressions(flat(name).system, ()))._balanced
    assert EnergyPreservingStep(SystemExpressions(a.system, ()))._balanced
    monkeypatch.setattr(
        energy_preserving_flight, "_arrows_leave_velocities_alone", lambda e: True
    )
    x1, p1 = Flown(stretched(0).system, ENERGY)(x0, p0, H)
    assert abs(energy(a, x1, p1) - energy(a, x0, p0)) > 1e-7


def test_the_frame_that_turns_is_a_groupoid() -> None:
    space, x, xi = StretchedPlane(), np.array([0.4, -0.2]), np.array([0.5, 0.7])
    g = space.retract(x, xi)
    np.testing.assert_allclose(space.lift(g), xi, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        space.retract(space.target(g), -xi), space.inverse(g), rtol=0, atol=1e-15
    )


def test_energy_on_a_gauge_groupoid_of_the_user() -> None:
    path = Path(__file__).parents[2] / "examples" / "hopf_gauge_groupoid.py"
    specification = importlib.util.spec_from_file_location("hopf_gauge_groupoid", path)
    hopf = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(hopf)
    space = hopf.HopfGaugeGroupoid()
    a = zoo.animal("", 0, space=space, curved=False, gyroscopic=True)
    x1, p1 = Flown(a.system, ENERGY)(a.start.base, a.start.momentum, H)
    start = energy(a, a.start.base, a.start.momentum)
    np.testing.assert_allclose(energy(a, x1, p1), start, rtol=0, atol=3e-15)


def test_casimirs_on_a_group_and_on_the_heavy_top() -> None:
    a = zoo.animal("SE3 left cay", 0)
    _, p1 = Flown(a.system, ENERGY)(np.zeros(0), a.start.momentum, H)
    (m, f), (m0, f0) = np.split(p1, 2), np.split(a.start.momentum, 2)
    np.testing.assert_allclose([m @ f, f @ f], [m0 @ f0, f0 @ f0], rtol=1e-14)
    top = flat("action left cay")
    x0, p0 = top.start.base, top.start.momentum
    x1, p1 = Flown(top.system, ENERGY)(x0, p0, H)
    np.testing.assert_allclose([x1 @ x1, p1 @ x1], [x0 @ x0, p0 @ x0], rtol=1e-14)


@pytest.mark.parametrize("apart", [1e-4, 1e-8, 1e-12, 0.0])
def test_it_is_accurate_where_consecutive_points_nearly_coincide(apart: float) -> None:
    a = zoo.animal("pair 3", 0, gyroscopic=True)
    x0 = a.start.base
    p0 = a.plain.gyroscopic(x0) + apart * np.array([0.7, -0.4, 0.9])
    exact = gni.integrate(
        a.system, a.system.state(x0, apart * np.linalg.solve(a.plain.metric(x0), [0.7, -0.4, 0.9])),
        step=1e-3, n_steps=1, method=gni.ReferenceFlow(rtol=1e-13),
    )
    _, p1 = Flown(a.system, ENERGY)(x0, p0, 1e-3)
    # what the forces did, to the truncation error of the flight
    change = exact.momenta[-1] - exact.momenta[0]
    np.testing.assert_allclose(p1 - p0, change, rtol=0, atol=1e-6 * np.max(np.abs(change)))


def test_the_force_does_its_work_in_the_middle() -> None:
    a = zoo.animal("pair 3", 0)
    drag = np.array([[0.4, 0.2, 0.0], [-0.2, 0.3, 0.1], [0.0, 0.0, 0.5]])
    rubbed = gni.MechanicalSystem(
        a.system.space, parameters=dict(a.system.parameters), **dict(a.system.plain),
        force=lambda x, xi, p: -drag @ xi,
    )
    flight = Flown(rubbed, ENERGY)
    x0, p0 = a.start.base, a.start.momentum
    x1, p1 = flight(x0, p0, H)
    work = flight.work(x0, p0, H)
    assert work < -1e-3
    np.testing.assert_allclose(energy(a, x1, p1), energy(a, x0, p0) + work, rtol=0, atol=3e-15)


@pytest.mark.parametrize("name", ["SO(3)", "pair"])
def test_unknowns_answer_to_the_momentum_as_differences_do(name: str) -> None:
    a = ANIMALS[name]()
    flight = Flown(a.system, ENERGY)
    x0, p0 = a.start.base, a.start.momentum
    dp = np.cos(1.0 + np.arange(len(p0)))
    ends = [flight.solved(x0, p0 + sign * 1e-5 * dp, H) for sign in (1, -1)]
    here = flight.solved(x0, p0, H)
    found = np.array(flight.response(x0, p0, H, flight.theta, here, dp)).ravel()
    np.testing.assert_allclose(found, (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-8)
