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
    n, r = system.space.base_size, system.space.rank
    layout = StateLayout.of({"base": n, "after": r}, aliases={"before": "after"})
    check_memory(count // every + 2, layout.size + 1)
    sampling = _Sampling(
        field=_field(system, start.active_rows, compile),
        theta=system.parameter_vector,
        steps=np.unique(np.append(np.arange(0, count + 1, every), count)),
        h=h,
        first=np.concatenate([start.base, start.momentum]),
        units=np.concatenate([np.ones(n), np.diag(system.evaluate("metric", start.base))]),
    )
    began = time.perf_counter()
    outcome, detail = sampling.run(method, progress)
    rows, filled = sampling.rows, sampling.filled
    lost = constraint_rows_lost(system, start.active_rows, rows[:filled, :n], rows[:filled, n:-1])
    if np.any(lost):
        filled = int(np.argmax(lost))
        outcome = Outcome.CONSTRAINT_LOST
        detail = f"Stopped at t = {sampling.steps[filled - 1] * h:.6g}."
    return Trajectory(
        system=system,
        method_name=str(method),
        step_size=h,
        node_steps=sampling.steps[:filled],
        rows=rows[:filled],
        layout=layout,
        active_rows=start.active_rows,
        flights=0,
        outcome=outcome,
        detail=detail,
        seconds=time.perf_counter() - began,
    )


_MOST_EVALUATIONS = 1_000_000
"""Evaluations between two nodes after which the method is taken to be stuck."""


class _Sampling:
    """DOP853 over the interval, its dense output read at the nodes.

    units : what the absolute tolerance is multiplied with, entry by entry; the inertias for the
        momenta, so that it speaks of velocities whatever the masses are.
    """

    def __init__(
        self,
        field: Any,
        theta: FloatArray,
        steps: np.ndarray,
        h: float,
        first: FloatArray,
        units: FloatArray,
    ) -> None:
        self._units = units
        self.steps, self.h = steps, h
        self.rows = np.zeros((len(steps), len(first) + 1))
        self.rows[0, :-1] = first
        self.filled = 1
        self.evaluations = 0
        self._field, self._theta = field, theta

    def _right_hand_side(self, _: float, y: FloatArray) -> FloatArray:
        self.evaluations += 1
        return np.asarray(self._field(self._theta, y))

    def run(self, method: ReferenceFlow, progress: bool) -> tuple[Outcome, str]:
        """Fill the rows; nodes reached before a failure or Ctrl-C stay."""
        count = int(self.steps[-1])
        try:
            with (
                interruptible() as check,
                progress_bar(count, progress) as advance_bar,
                np.errstate(all="ignore"),
            ):
                return self._march(method, check, advance_bar)
        except KeyboardInterrupt:
            done = self.steps[self.filled - 1]
            return Outcome.INTERRUPTED, f"Stopped after step {done} of {count}."

    def _march(self, method: ReferenceFlow, check: Any, advance_bar: Any) -> tuple[Outcome, str]:
        from scipy.integrate import DOP853

        atol = method.atol if method.atol is not None else 1e-2 * method.rtol
        end = self.steps[-1] * self.h
        solver = DOP853(
            self._right_hand_side,
            0.0,
            self.rows[0, :-1],
            end,
            rtol=method.rtol,
            atol=atol * self._units,
        )
        last_node = 0
        while self.filled < len(self.steps):
            check()
            message = solver.step()
            stuck = self.evaluations - last_node > _MOST_EVALUATIONS
            if stuck or solver.status == "failed" or not np.all(np.isfinite(solver.y)):
                detail = f"Stopped at t = {solver.t:.6g}. {message or ''}".strip()
                return Outcome.ADAPTIVE_STEP_FAILED, detail
            reached = _nodes_reached(self.steps, self.h, self.filled, solver.t)
            if reached > self.filled:
                times = self.steps[self.filled : reached] * self.h
                self.rows[self.filled : reached, :-1] = solver.dense_output()(times).T
                advance_bar(int(self.steps[reached - 1] - self.steps[self.filled - 1]))
                self.filled, last_node = reached, self.evaluations
        return Outcome.SUCCESS, f"{self.evaluations} evaluations of the equations of motion."


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
