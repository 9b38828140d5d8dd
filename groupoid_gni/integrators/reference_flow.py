"""The reference equations driven by SciPy's DOP853, sampled at the nodes of a step size."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import compile_field
from groupoid_gni.discretization import StateLayout, SystemExpressions, reference_field
from groupoid_gni.integrators.failure_report import constraint_rows_lost
from groupoid_gni.integrators.interruption import interruptible
from groupoid_gni.integrators.marching import progress_bar
from groupoid_gni.integrators.methods import ReferenceFlow
from groupoid_gni.integrators.requests import check_memory
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory


def integrate_reference(
    system: MechanicalSystem,
    start: State,
    h: float,
    count: int,
    method: ReferenceFlow,
    every: int,
    progress: bool,
    compile: bool,
) -> Trajectory:
    """Nodes ``k h`` of the solution of the equations of motion; a failure keeps the good nodes."""
    from scipy.integrate import DOP853

    n, r = system.space.base_size, system.space.rank
    layout = StateLayout.of({"base": n, "after": r}, aliases={"before": "after"})
    check_memory(count // every + 2, layout.size + 1)
    field = _field(system, start.active_rows, compile)
    theta = system.parameter_vector
    steps = np.unique(np.append(np.arange(0, count + 1, every), count))
    rows = np.zeros((len(steps), n + r + 1))
    rows[0, :-1] = np.concatenate([start.base, start.momentum])
    began, filled, evaluations = time.perf_counter(), 1, [0]

    def right_hand_side(_: float, y: FloatArray) -> FloatArray:
        evaluations[0] += 1
        return np.asarray(field(theta, y))

    outcome, detail = Outcome.SUCCESS, ""
    atol = method.atol if method.atol is not None else 1e-2 * method.rtol
    try:
        with (
            interruptible() as check,
            progress_bar(count, progress) as advance_bar,
            np.errstate(all="ignore"),
        ):
            solver = DOP853(
                right_hand_side, 0.0, rows[0, :-1], count * h, rtol=method.rtol, atol=atol
            )
            while filled < len(steps):
                check()
                message = solver.step()
                if solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                    outcome = Outcome.ADAPTIVE_STEP_FAILED
                    detail = f"Stopped at t = {solver.t:.6g}. {message or ''}".strip()
                    break
                reached = _nodes_reached(steps, h, filled, solver.t)
                if reached > filled:
                    times = steps[filled:reached] * h
                    rows[filled:reached, :-1] = solver.dense_output()(times).T
                    advance_bar(int(steps[reached - 1] - steps[filled - 1]))
                    filled = reached
    except KeyboardInterrupt:
        outcome, detail = Outcome.INTERRUPTED, f"Stopped after node {filled} of {len(steps)}."
    lost = constraint_rows_lost(system, start.active_rows, rows[:filled, :n], rows[:filled, n:-1])
    if np.any(lost):
        filled = int(np.argmax(lost))
        outcome = Outcome.CONSTRAINT_LOST
        detail = f"Stopped at t = {steps[filled - 1] * h:.6g}."
    return Trajectory(
        system=system,
        method_name=str(method),
        step_size=h,
        node_steps=steps[:filled],
        rows=rows[:filled],
        layout=layout,
        active_rows=start.active_rows,
        flights=0,
        outcome=outcome,
        detail=detail or f"{evaluations[0]} evaluations of the equations of motion.",
        seconds=time.perf_counter() - began,
    )


def _nodes_reached(steps: np.ndarray, h: float, filled: int, t: float) -> int:
    """How many nodes lie at or before t, in the direction of h."""
    beyond = np.searchsorted(steps[filled:], t / h * (1.0 + 1e-14), side="right")
    return filled + int(beyond)


def _field(system: MechanicalSystem, active_rows: tuple[int, ...], compile: bool) -> Any:
    """The equations of motion (theta, y) -> y', as machine code or through CasADi."""
    key = ("field", active_rows, compile)
    if key not in system._compiled:
        function = reference_field(SystemExpressions(system, active_rows))
        if compile:
            system._compiled[key] = compile_field(function)
        else:
            system._compiled[key] = lambda theta, y: np.array(function(theta, y)).ravel()
    return system._compiled[key]
