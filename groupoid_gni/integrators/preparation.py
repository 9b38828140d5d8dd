"""From checked starts to the flat numbers a step program begins with, for one member or many.

Arrays hold one column per member. Column by column the numbers are those of a single run, bit for
bit: CasADi evaluates columns one after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import StepRunner
from groupoid_gni.discretization import StateLayout, SystemExpressions
from groupoid_gni.systems import MechanicalSystem, State


@dataclass(frozen=True)
class Starts:
    """Starts that share their active rows: (base_size, N), (rank, N), (parameters, N), (inputs, N).

    controls : the inputs of the first step.
    """

    active_rows: tuple[int, ...]
    base: FloatArray
    momentum: FloatArray
    theta: FloatArray
    controls: FloatArray

    @classmethod
    def of(
        cls,
        system: MechanicalSystem,
        states: Sequence[State],
        controls: FloatArray | None,
        theta: FloatArray | None = None,
    ) -> Starts:
        """Columns of states.  theta : (parameters, N); those of the system when left out."""
        count = len(states)
        if theta is None:
            theta = np.tile(system.parameter_vector[:, None], count)
        first = np.zeros(system.control_size) if controls is None else controls[0]
        return cls(
            states[0].active_rows,
            np.array([state.base for state in states]).T.reshape(-1, count),
            np.array([state.momentum for state in states]).T,
            theta,
            np.tile(first[:, None], count),
        )


@dataclass(frozen=True)
class Members:
    """What the loop is given: (parameters, N) and (state, N)."""

    parameters: FloatArray
    states: FloatArray


def prepare(
    system: MechanicalSystem,
    runner: StepRunner,
    starts: Starts,
    h: float,
    pose: FloatArray | None,
) -> Members:
    """Parameters and flat states of all members."""
    scales, force, multipliers = _node_numbers(system, starts)
    count = starts.theta.shape[1]
    parameters = np.concatenate([starts.theta, np.full((1, count), h), scales])
    layout = runner.program.layout
    return Members(parameters, _initial_states(layout, starts, h, force, multipliers, pose))


def _node_numbers(
    system: MechanicalSystem, starts: Starts
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """C_aa, the constraint force mu^T lambda and the multipliers lambda at the starts."""
    count = starts.theta.shape[1]
    if not starts.active_rows:
        return np.zeros((0, count)), np.zeros((system.space.rank, count)), np.zeros((0, count))
    key = ("start", starts.active_rows)
    if key not in system._compiled:
        system._compiled[key] = _node_function(SystemExpressions(system, starts.active_rows))
    columns = [starts.base, starts.momentum, starts.theta, starts.controls]
    arguments = [column if len(column) else np.zeros((0, 1)) for column in columns]
    scales, force, multipliers = (v.full() for v in system._compiled[key].call(arguments))
    return scales, force, multipliers


def _node_function(expressions: SystemExpressions) -> ca.Function:
    x, p = ca.SX.sym("x", expressions.base_size), ca.SX.sym("p", expressions.rank)
    parameters = ca.SX.sym("theta", expressions.parameter_size)
    node = expressions.node(x, parameters)
    multipliers = expressions.multipliers(x, p, parameters)
    outputs = [ca.diag(node.gram), ca.mtimes(node.mu.T, multipliers), multipliers]
    inputs = [x, p, parameters, expressions.controls]
    return ca.Function("start", inputs, [ca.densify(output) for output in outputs])


def _initial_states(
    layout: StateLayout,
    starts: Starts,
    h: float,
    force: FloatArray,
    multipliers: FloatArray,
    pose: FloatArray | None,
) -> FloatArray:
    """Base, momenta, and for two-step methods half of the constraint impulse."""
    states = np.zeros((layout.size, starts.theta.shape[1]))
    states[layout.slices["base"]] = starts.base
    half = np.zeros_like(starts.momentum)
    if "momentum" in layout.slices:
        states[layout.slices["momentum"]] = starts.momentum
    elif layout.slices["before"] != layout.slices["after"]:
        half = 0.5 * h * force
        m = len(multipliers)
        if m:
            states[layout.slices["impulses"]][:m] = -0.5 * h * multipliers
            states[layout.slices["parasitic"]][3] = 1.0
    states[layout.slices["before"]] = starts.momentum - half
    states[layout.slices["after"]] = starts.momentum + half
    if pose is not None:
        states[layout.slices["reconstructed"]] = np.reshape(pose, (len(pose), -1))
    return states
