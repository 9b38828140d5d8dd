"""External forces and control inputs: orders, work, energy balance, inputs held over each step."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import groupoid_gni as gni
from groupoid_gni.discretization.discrete_lagrangians import Adjoint

MASS, TURN, OFFSET = 1.3, 0.8, 0.35
METRIC = np.array(
    [
        [TURN + MASS * OFFSET**2, 0.0, MASS * OFFSET],
        [0.0, MASS, 0.0],
        [MASS * OFFSET, 0.0, MASS],
    ]
)
START = np.array([1.4, -0.9, 0.0])
END = 3.0
FORCED = [
    gni.Rattle(),
    gni.Midpoint(),
    gni.GNI(),
    gni.GNI(flow=gni.Variational(gni.Rattle())),
    gni.GNI(flow=gni.EnergyPreserving()),
    gni.GNI(projection=None),
    gni.McLachlanPerlmutter(),
]


def drag(xi: Any) -> Any:
    return np.array([-0.3 * xi[0], -0.2 * xi[1] * (1.0 + xi[1] ** 2), 0.0])


def sleigh(controlled: bool = False) -> gni.MechanicalSystem:
    """A sleigh with friction that is not linear and, on request, two motors."""

    def pushed(x: Any, xi: Any, p: Any, u: Any) -> Any:
        return p.drag * drag(xi) + np.array([u[0] - 0.1 * u[1], 0.7 * u[1], 0.4])

    return gni.MechanicalSystem(
        gni.SE2(),
        metric=METRIC,
        constraints=[[0.0, 0.0, 1.0]],
        parameters={"drag": 1.0},
        force=pushed if controlled else lambda x, xi, p: p.drag * drag(xi),
        controls=2 if controlled else 0,
    )


def rates(y: Any, u: Any = (0.0, 0.0)) -> Any:
    """(omega', v') by hand; the blade takes what pushes across."""
    force = drag(np.array([*y, 0.0])) + np.array([u[0] - 0.1 * u[1], 0.7 * u[1], 0.0])
    turning = -MASS * OFFSET * y[0] * y[1] + force[0]
    return np.array([turning / METRIC[0, 0], OFFSET * y[0] ** 2 + force[1] / MASS])


@cache
def truth() -> Any:
    done = solve_ivp(
        lambda t, y: rates(y), (0.0, END), START[:2], method="DOP853", rtol=1e-13, atol=1e-13
    )
    return done.y[:, -1]


def errors(method: Any, counts: list[int]) -> Any:
    system = sleigh()
    start = system.state(velocity=START)
    runs = [
        gni.integrate(system, start, step=END / n, n_steps=n, method=method) for n in counts
    ]
    return np.array([np.max(np.abs(run.velocities[-1, :2] - truth())) for run in runs])


def slope(counts: list[int], values: Any) -> float:
    return -float(np.polyfit(np.log(counts), np.log(values), 1)[0])


@pytest.mark.parametrize("method", FORCED, ids=str)
def test_forced_methods_keep_their_order(method):
    counts = [24, 48, 96]
    assert slope(counts, errors(method, counts)) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize(
    "options",
    [{}, {"flow": gni.EnergyPreserving()}, {"projection": None}],
    ids=["projected", "energy-preserving", "bare"],
)
def test_forced_compositions_reach_their_order(order, options):
    counts = [12, 24, 48]
    values = errors(gni.GNI(order, **options), counts)
    assert slope(counts, values) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("rule", [gni.EulerA(), gni.EulerB()], ids=str)
def test_forces_at_one_end_are_of_first_order(rule):
    counts = [300, 600, 1200]
    assert slope(counts, errors(rule, counts)) == pytest.approx(1.0, abs=0.1)


def test_the_weights_of_the_force_are_exchanged_by_the_adjoint():
    assert gni.EulerA.force_weights == (1.0, 0.0)
    assert gni.EulerA().adjoint().force_weights == (0.0, 1.0)

    assert Adjoint(gni.EulerA()).force_weights == (0.0, 1.0)
    assert Adjoint(gni.Rattle()).force_weights == (0.5, 0.5)


@pytest.mark.parametrize("order", [2, 4])
def test_energy_changes_by_the_work_of_the_force_exactly(order):
    system = sleigh()
    run = gni.integrate(
        system, system.state(velocity=START), step=0.1, n_steps=200,
        method=gni.GNI(order, flow=gni.EnergyPreserving()),
    )
    assert run.energy()[0] - run.energy()[-1] > 0.5
    assert np.max(np.abs(run.energy_balance())) < 1e-13


def test_work_counts_the_same_in_a_potential_on_a_groupoid_with_base():
    system = gni.MechanicalSystem(
        gni.AtiyahGroupoid(2, gni.SO3(side="right")),
        metric=lambda x, p: np.diag([1.3, 0.9, 0.6, 1.1, 0.8]) + 0.1 * np.cos(x[0]) * np.eye(5),
        constraints=lambda x, p: np.array([[1.0, 0.0, 0.0, -0.7, 0.2 * x[1]]]),
        potential=lambda x, p: 0.4 * x[0] ** 2 + 0.3 * np.sin(x[1]),
        force=lambda x, xi, p: -0.2 * xi + np.array([0.3 * x[1], 0.0, 0.1, 0.0, 0.0]),
    )
    start = system.state([0.4, -0.3], [0.5, 0.8, 0.3, -0.4, 0.6], project_start=True)
    options = {"step": 0.05, "n_steps": 200}
    exact = gni.integrate(
        system, start, method=gni.GNI(flow=gni.EnergyPreserving()), **options
    )
    assert np.max(np.abs(exact.energy_balance())) < 1e-13
    reference = gni.integrate(system, start, method=gni.ReferenceFlow(rtol=1e-12), **options)
    np.testing.assert_allclose(exact.work()[-1], reference.work()[-1], rtol=0, atol=2e-3)
    variational = gni.integrate(system, start, **options)
    assert 1e-9 < np.max(np.abs(variational.energy_balance())) < 1e-3


def test_splitting_balances_a_force_that_does_not_depend_on_the_velocity():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.7]),
        force=lambda x, xi, p: np.array([0.4, -0.2 * x[0]]),
    )
    run = gni.integrate(
        system, system.state([0.2, -0.4], [0.3, 0.5]), step=0.1, n_steps=50,
        method=gni.GNI(flow=gni.Splitting()),
    )
    # the kick is the only thing that changes the energy
    assert np.max(np.abs(run.energy_balance())) < 1e-14


# ---------------------------------------------------------------- control inputs


def driven(method: Any, **options: Any) -> tuple[gni.Trajectory, Any]:
    system = sleigh(controlled=True)
    inputs = np.random.default_rng(41).uniform(-1.0, 1.0, (30, 2))
    run = gni.integrate(
        system, system.state(velocity=START), step=0.1, n_steps=30, method=method,
        controls=inputs, **options,
    )
    return run, inputs


@cache
def driven_truth() -> Any:
    y = START[:2]
    for u in np.random.default_rng(41).uniform(-1.0, 1.0, (30, 2)):
        y = solve_ivp(
            lambda t, y, u=u: rates(y, u), (0.0, 0.1), y, method="DOP853", rtol=1e-13, atol=1e-13
        ).y[:, -1]
    return y


@pytest.mark.parametrize(
    ("method", "bound"),
    [
        (gni.GNI(4), 2e-6),
        (gni.GNI(8), 1e-11),
        (gni.GNI(6, projection=None), 1e-9),
        (gni.ReferenceFlow(rtol=1e-12), 1e-11),
    ],
    ids=str,
)
def test_inputs_are_held_over_each_step(method, bound):
    run, _ = driven(method)
    assert np.max(np.abs(run.velocities[-1, :2] - driven_truth())) < bound


@pytest.mark.parametrize(
    "method", [gni.GNI(), gni.GNI(4), gni.GNI(4, projection=None), gni.Rattle()], ids=str
)
def test_machine_code_reads_the_inputs_that_the_expressions_read(method):
    fast, _ = driven(method)
    slow, _ = driven(method, compile=False)
    np.testing.assert_allclose(fast.momenta, slow.momenta, rtol=0, atol=1e-13)


def test_saving_less_and_one_row_for_all_steps_change_nothing():
    system = sleigh(controlled=True)
    start = system.state(velocity=START)
    options = {"step": 0.1, "n_steps": 30, "method": gni.GNI(4)}
    full = gni.integrate(system, start, controls=np.tile([0.3, -0.2], (30, 1)), **options)
    thin = gni.integrate(system, start, controls=[0.3, -0.2], save_every=7, **options)
    np.testing.assert_array_equal(thin.momenta[:-1], full.momenta[:-1:7])
    np.testing.assert_array_equal(thin.momenta[-1], full.momenta[-1])


def test_multipliers_belong_to_the_input_that_leaves_the_node():
    run, inputs = driven(gni.GNI(8))
    omega, v = run.velocities[:, 0], run.velocities[:, 1]
    forces = np.array([rates([a, b], u)[0] for a, b, u in zip(omega[:-1], v, inputs, strict=False)])
    # across: m (a omega' + u omega) = lambda + 0.4
    expected = MASS * (OFFSET * forces + v[:-1] * omega[:-1]) - 0.4
    np.testing.assert_allclose(run.multipliers[:-1, 0], expected, rtol=0, atol=1e-9)


def test_runs_with_inputs_survive_saving(tmp_path):
    run, inputs = driven(gni.GNI())
    again = gni.Trajectory.load(run.save(tmp_path / "driven"), sleigh(controlled=True))
    np.testing.assert_array_equal(again.controls, inputs)
    np.testing.assert_array_equal(again.multipliers, run.multipliers)


@pytest.mark.parametrize(
    ("controls", "words"),
    [
        (None, "pass controls, shape (4, 2)"),
        (np.zeros((3, 2)), "must have shape (4, 2)"),
        (np.zeros((4, 3)), "must have shape (4, 2)"),
        ([[0.0, np.nan]] * 4, "controls[0, 1] is nan"),
        ("fast", "real numbers"),
    ],
)
def test_inputs_that_do_not_fit_are_refused(controls, words):
    system = sleigh(controlled=True)
    with pytest.raises(gni.InputError) as caught:
        gni.integrate(
            system, system.state(velocity=START), step=0.1, n_steps=4, controls=controls
        )
    assert words in str(caught.value)


def test_systems_without_inputs_refuse_them():
    system = sleigh()
    with pytest.raises(gni.InputError, match="no control inputs"):
        gni.integrate(
            system, system.state(velocity=START), step=0.1, n_steps=4, controls=[0.0]
        )


@pytest.mark.parametrize(
    ("terms", "words"),
    [
        ({"controls": 2}, "controls need a force"),
        ({"force": lambda x, xi, p: xi, "controls": 1}, "control inputs"),
        ({"force": lambda x, xi, p, u: xi}, "controls=their number"),
        ({"force": np.zeros(3)}, "force=lambda x, xi, p"),
        ({"force": lambda x, xi, p: xi, "controls": -1}, "whole number"),
        ({"force": lambda x, xi, p: xi[:2]}, "shape"),
    ],
)
def test_forces_that_cannot_be_meant_are_refused(terms, words):
    with pytest.raises((gni.InputError, gni.RecordingError)) as caught:
        gni.MechanicalSystem(gni.SE2(), metric=METRIC, **terms)
    assert words in str(caught.value)


def test_the_method_of_28_refuses_a_force_and_next_arrow_refuses_inputs():
    system = sleigh()
    start = system.state(velocity=START)
    with pytest.raises(gni.InputError, match="does not take an external force"):
        gni.integrate(
            system, start, step=0.1, n_steps=3, method=gni.DiscreteLagrangeDAlembert()
        )
    controlled = sleigh(controlled=True)
    arrow = controlled.space.retract(np.zeros(0), 0.1 * START)
    with pytest.raises(gni.InputError, match="no control inputs"):
        gni.next_arrow(controlled, gni.Rattle(), arrow, step=0.1)
