"""The guard against constraint rows that turn over from one node to the next."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.discretization.step_inputs import StepInputs

METRIC = np.diag([1.3, 0.7, 0.9, 1.6, 1.1])


def turning_rows(count: int) -> gni.MechanicalSystem:
    """``count`` of two rows that turn by ``angle`` as x0 passes 0; the motion along x0 is free."""

    def constraints(x: Any, p: Any) -> Any:
        turned = p.angle * (1.0 + np.tanh(p.steepness * x[0])) / 2
        c, s = np.cos(turned), np.sin(turned)
        return gni.array([[0.2 * c, c, 0.0, s, 0.0], [0.0, 0.4 * c, c, 0.3 * s, s]][:count])

    return gni.MechanicalSystem(
        gni.PairGroupoid(5), METRIC, constraints=constraints,
        parameters={"angle": np.pi, "steepness": 400.0},
    )  # fmt: skip


@pytest.fixture(scope="module")
def both() -> gni.MechanicalSystem:
    return turning_rows(2)


def crossing(system: gni.MechanicalSystem, method: Any, **parameters: float) -> gni.Trajectory:
    own = system.with_parameters(**parameters)
    start = own.state([-0.53, 0.2, -0.1, 0.3, 0.1], [0.9, 0.2, -0.3, 0.1, 0.4], project_start=True)
    return gni.integrate(own, start, step=0.1, n_steps=20, method=method, on_failure="return")


METHODS = [gni.Rattle(), gni.GNI(), gni.McLachlanPerlmutter(), gni.DiscreteLagrangeDAlembert()]


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_two_rows_that_turn_over_in_one_step_end_the_run(
    both: gni.MechanicalSystem, method: Any
) -> None:
    run = crossing(both, method, angle=2.6)
    assert not run.success
    assert run.outcome in (gni.Outcome.CONSTRAINTS_SINGULAR, gni.Outcome.NEWTON_FAILED)
    assert run.base[-1, 0] < 0.05


def test_the_guard_itself_sees_two_rows_turn_over(both: gni.MechanicalSystem) -> None:
    worst = guards(both)
    here = np.array([-0.1, 0.2, -0.1, 0.3, 0.1])
    assert worst(here, [0.1, *here[1:]], np.pi, 400.0) >= 1.0
    assert worst(here, [-0.09, *here[1:]], np.pi, 400.0) < 1.0


@pytest.mark.parametrize("degrees", [10.0, 50.0, 85.0, 95.0, 140.0])
def test_rows_may_turn_by_less_than_a_right_angle(
    both: gni.MechanicalSystem, degrees: float
) -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(5), np.eye(5),
        constraints=lambda x, p: gni.array([
            [0.0, np.cos(p.angle * x[0]), 0.0, np.sin(p.angle * x[0]), 0.0],
            [0.0, 0.0, np.cos(p.angle * x[0]), 0.0, np.sin(p.angle * x[0])],
        ]),
        parameters={"angle": 1.0, "steepness": 1.0},
    )  # fmt: skip
    found = guards(system)(np.zeros(5), [1.0, 0.0, 0.0, 0.0, 0.0], np.radians(degrees), 1.0)
    assert (found < 1.0) == (degrees < 90.0)


def test_other_rows_for_the_same_distribution_are_not_a_turn() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(4), np.diag([1.3, 0.7, 0.9, 1.6]),
        constraints=lambda x, p: gni.array([
            [p.angle * np.exp(4 * x[0]), 0.3 * np.exp(4 * x[0]), 0.0, np.exp(4 * x[0])],
            [0.9 + 3 * x[0], 0.3 + x[0], 0.2, 1.0 + 3 * x[0]],
        ]),
        parameters={"angle": 1.0, "steepness": 1.0},
    )  # fmt: skip
    worst = guards(system)
    for ahead in (-0.9, 0.4, 0.9):
        assert worst(np.zeros(4), [ahead, 0.0, 0.0, 0.0], 1.0, 1.0) < 1.0


def test_rows_that_do_not_depend_on_the_point_cost_nothing() -> None:
    for make in (gni.scenes.rolling_ball, gni.scenes.two_wheeled_robot):
        system = make().system
        e = SystemExpressions(system, tuple(range(system.constraint_count)))
        inputs = StepInputs(e)
        x, y = ca.SX.sym("x", e.base_size), ca.SX.sym("y", e.base_size)
        last, node = e.node(x, inputs.theta), e.node(y, inputs.theta)
        values = ca.vertcat(*[guard.value for guard in inputs.conditioning(last, node)])
        assert not ca.depends_on(values, ca.vertcat(x, y))


def guards(system: gni.MechanicalSystem) -> Any:
    """(last point, point, angle, steepness) -> largest guard; 1 and above fires."""
    e = SystemExpressions(system, tuple(range(system.constraint_count)))
    inputs = StepInputs(e)
    x, y = ca.SX.sym("x", e.base_size), ca.SX.sym("y", e.base_size)
    last, node = e.node(x, inputs.theta), e.node(y, inputs.theta)
    values = ca.vertcat(*[guard.value for guard in inputs.conditioning(last, node)])
    function = ca.Function("guards", [x, y, inputs.theta, inputs.scales], [ca.mmax(values)])

    def worst(first: Any, second: Any, angle: float, steepness: float) -> float:
        own = system.with_parameters(angle=angle, steepness=steepness)
        mu = own.evaluate("constraints", np.asarray(first))
        metric = own.evaluate("metric", np.asarray(first))
        scales = np.diag(mu @ np.linalg.solve(metric, mu.T))
        return float(function(first, second, own.parameter_vector, scales))

    return worst
