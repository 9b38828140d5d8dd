"""The equations of motion by DOP853, sampled at the nodes of a step size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import CompiledFlow, FlowRunner, InterpretedFlow
from groupoid_gni.discretization import StateLayout, SystemExpressions, reference_flow
from groupoid_gni.integrators.failure_report import constraint_rows_lost
from groupoid_gni.integrators.interruption import interruptible
from groupoid_gni.integrators.marching import progress_bar
from groupoid_gni.integrators.methods import ReferenceFlow
from groupoid_gni.integrators.requests import check_memory
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

_FIRST_CHUNK = 200
_CHUNK_SECONDS = 0.02
_MOST_ATTEMPTS = 1_000_000
"""Steps tried per node asked for after which the method is taken to be stuck."""
_VIOLATED = 1e-3
"""Relative constraint residual that no tolerance explains."""
_LOOKED_AT = 64
_TIGHTER = 0.01
_TIGHTEST = 1e-14


@dataclass(frozen=True)
class _Request:
    """A checked request, ready to run.

    tolerances : (rtol, atol).  pose : the arrow to accumulate from, or None.
    inputs : (steps, inputs) control inputs, or None.
    caution : what the first step is multiplied with.
    """

    system: MechanicalSystem
    start: State
    h: float
    count: int
    every: int
    name: str
    tolerances: tuple[float, float]
    pose: FloatArray | None
    inputs: FloatArray | None
    compile: bool
    caution: float = 1.0


def integrate_reference(
    system: MechanicalSystem,
    start: State,
    h: float,
    count: int,
    method: ReferenceFlow,
    every: int,
    pose: FloatArray | None,
    inputs: FloatArray | None,
    compile: bool,
    progress: bool,
) -> Trajectory:
    """Nodes ``k h`` of the solution of the equations of motion; a failure keeps the good nodes."""
    atol = method.atol if method.atol is not None else 1e-2 * method.rtol
    name, tolerances = str(method), (method.rtol, atol)
    request = _Request(
        system, start, h, count, every, name, tolerances, pose, inputs, compile
    )
    return _run(request, progress)[0]


def _run(request: _Request, show: bool) -> tuple[Trajectory, int]:
    """The trajectory, and the steps it took."""
    system, start, pose = request.system, request.start, request.pose
    n, r = system.space.base_size, system.space.rank
    parts = {"base": n, "after": r}
    if system.has("force"):
        parts["work"] = 1
    if pose is not None:
        parts["reconstructed"] = len(pose)
    layout = StateLayout.of(parts, aliases={"before": "after"})
    check_memory(request.count // request.every + 2, layout.size + 1)
    march = _March(request, _flow(system, start.active_rows, pose is not None, request.compile))
    outcome, detail = march.run(show)
    steps = march.steps
    filled, rows = march.progress.filled, march.progress.rows
    lost = constraint_rows_lost(
        system, start.active_rows, rows[:filled, :n], rows[:filled, n : n + r]
    )
    if np.any(lost):
        filled = int(np.argmax(lost))
        outcome = Outcome.CONSTRAINT_LOST
        detail = f"Stopped at t = {steps[filled - 1] * request.h:.6g}."
    kept = _nodes_on_constraints(request, rows[:filled, :n], rows[:filled, n : n + r])
    if kept < filled:
        filled, outcome = kept, Outcome.ADAPTIVE_STEP_FAILED
        detail = (
            f"The constraints are violated after t = {steps[filled - 1] * request.h:.6g}: the "
            "equations of motion jump there. (With a large rtol: use a smaller one.)"
        )
    run = Trajectory(
        system=system,
        method_name=request.name,
        step_size=request.h,
        node_steps=steps[:filled],
        rows=rows[:filled],
        layout=layout,
        active_rows=start.active_rows,
        flights=0,
        outcome=outcome,
        detail=detail,
        seconds=march.progress.seconds,
        controls=request.inputs,
        evaluations=march.progress.evaluations,
        own_steps=march.progress.accepted,
        again=lambda: _more_precisely(request, int(steps[filled - 1])),
    )
    return run, march.progress.accepted


def _nodes_on_constraints(request: _Request, base: FloatArray, momenta: FloatArray) -> int:
    """Nodes up to the first that violates the constraints in kind.

    The equations keep ``mu (xi - Y)`` as it is, so a jump of mu that the method steps over shows
    in the nodes from there on; a few of them tell whether to look for it.
    """
    rows = list(request.start.active_rows)
    if not rows:
        return len(base)
    few = np.unique(np.linspace(0, len(base) - 1, _LOOKED_AT).astype(int))
    for looked_at in (few, np.arange(len(base))):
        x = base[looked_at]
        velocities = request.system.velocities(x, momenta[looked_at])
        residuals = request.system.constraint_residuals(x, velocities, relative=True)[:, rows]
        violated = ~np.all(np.abs(residuals) < _VIOLATED, axis=1)
        if not np.any(violated):
            return len(base)
    return int(np.argmax(violated))


def _more_precisely(request: _Request, count: int) -> tuple[Trajectory, int]:
    """The same motion up to a step number, at a hundredth of the tolerances."""
    rtol, atol = request.tolerances
    factor = max(_TIGHTER * rtol, _TIGHTEST) / rtol
    finer = replace(
        request,
        count=count,
        pose=None,
        tolerances=(factor * rtol, factor * atol),
        # the rule for the first step may not depend on the tolerance: two equal steps would agree
        caution=factor**0.125,
    )
    return _run(finer, False)


class _March:
    """The adaptive loop, call by call, until the end, a failure or Ctrl-C.

    steps : step numbers of all nodes asked for.  progress : the nodes so far, and what was spent.
    """

    def __init__(self, request: _Request, runner: FlowRunner) -> None:
        r = self.request = request
        self.runner = runner
        steps = np.arange(0, r.count + 1, r.every)
        self.steps = np.append(steps, r.count) if r.count % r.every else steps
        start = np.zeros(runner.layout.size)
        known = np.concatenate([r.start.base, r.start.momentum])
        start[: len(known)] = known
        if r.pose is not None:
            start[len(start) - len(r.pose) :] = r.pose
        self.progress = runner.begin(
            self._parameters(0), start, r.tolerances, r.h, r.count, r.every, r.caution
        )

    def _parameters(self, step: int) -> FloatArray:
        """Parameters of the field during a step: the physical ones, then the control inputs."""
        inputs, theta = self.request.inputs, self.request.system.parameter_vector
        return theta if inputs is None else np.concatenate([theta, inputs[step]])

    def run(self, show: bool) -> tuple[Outcome, str]:
        """How it ended."""
        r, p = self.request, self.progress
        try:
            status = self._legs(show)
        except KeyboardInterrupt:
            done = self.steps[p.filled - 1]
            return Outcome.INTERRUPTED, f"Stopped after step {done} of {r.count}."
        if status != 1:
            return self._failure(status)
        return Outcome.SUCCESS, (
            f"{p.evaluations} evaluations of the equations of motion; {p.accepted} steps, "
            f"{p.rejected} rejected."
        )

    def _legs(self, show: bool) -> int:
        """The status at the end. Control inputs jump: with them every step is a leg of its own."""
        r, p = self.request, self.progress
        if r.count == 0:
            return 1
        # a run that is over in one call is spared the changing of signal handlers
        if r.inputs is None and not show:
            status = self.runner.advance(p, _FIRST_CHUNK)
            if status != 0:
                return status
        with interruptible() as check, progress_bar(r.count, show) as advance_bar:
            if r.inputs is None:
                return self._finish(check, advance_bar)
            for step in range(r.count):
                p.aim(self._parameters(step), step + 1)
                status = self._finish(check, lambda steps: None)
                if status != 1:
                    return status
                advance_bar(1)
        return 1

    def _finish(self, check: Callable[[], None], advance_bar: Callable[[int], Any]) -> int:
        """Call after call, each as long as a chunk; 0 means that it is stuck."""
        p, size, since_node = self.progress, _FIRST_CHUNK, 0
        while since_node < _MOST_ATTEMPTS * self.request.every:
            check()
            before, done = p.seconds, p.filled
            status = self.runner.advance(p, size)
            advance_bar(int(self.steps[p.filled - 1] - self.steps[done - 1]))
            if status != 0:
                return status
            since_node = 0 if p.filled > done else since_node + size
            if p.seconds - before < _CHUNK_SECONDS / 2:
                size *= 2
        return 0

    def _failure(self, status: int) -> tuple[Outcome, str]:
        p = self.progress
        reason = "The step size fell below the round-off of the time."
        if status == 0:
            reason = f"More than {_MOST_ATTEMPTS} steps were tried for one step of the nodes."
        elif not np.all(np.isfinite(p.rate)):
            reason = "The equations of motion give infinity or NaN there."
        return Outcome.ADAPTIVE_STEP_FAILED, f"Stopped at t = {p.time:.6g}. {reason}"


def _flow(
    system: MechanicalSystem, active_rows: tuple[int, ...], reconstruct: bool, compile: bool
) -> FlowRunner:
    """The runner of the equations of motion; made once and kept with the system's recordings."""
    key = ("flow", active_rows, reconstruct, compile)
    if key not in system._compiled:
        function = reference_flow(SystemExpressions(system, active_rows), reconstruct)
        system._compiled[key] = CompiledFlow.of(function) if compile else InterpretedFlow(function)
    runner: FlowRunner = system._compiled[key]
    return runner
