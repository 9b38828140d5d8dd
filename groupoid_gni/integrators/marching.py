"""Running a step program in chunks, from a checked request to a trajectory."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import CompiledStep, InterpretedStep, MachineCode, StepRunner
from groupoid_gni.codegen.runners import Progress
from groupoid_gni.discretization import (
    DiscreteLagrangian,
    StepProgram,
    SystemExpressions,
    bare_program,
    impulse_program,
    lagrange_dalembert_program,
    projected_program,
    two_step_program,
)
from groupoid_gni.errors import (
    InputError,
    ParasiticModeWarning,
    RescuedStepsWarning,
    SurprisingStepWarning,
)
from groupoid_gni.integrators.failure_report import constraint_rows_lost, failure_detail
from groupoid_gni.integrators.interruption import interruptible
from groupoid_gni.integrators.methods import (
    GNI,
    DiscreteLagrangeDAlembert,
    McLachlanPerlmutter,
    SteppingMethod,
    SymmetricProjection,
)
from groupoid_gni.integrators.preparation import Starts, prepare
from groupoid_gni.integrators.requests import check_memory
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import UNRESOLVED, Trajectory

_FIRST_CHUNK = 1000
_CHUNK_SECONDS = 0.01
_PARASITIC_FACTOR = 2.0
_PARASITIC_GROWTH = 10.0
_PARASITIC_FLOOR = 1e-10
_PARASITIC_CEILING = 0.3
"""Part of |p| that is too much even where single impulses are as large as p."""
_BASE_TOLERANCE = 1e-6
_JUMP = 0.1
"""Relative change of the velocity in a rescued stage from which on it is suspect."""
_SURPRISE = 0.01
"""Relative error of an extrapolation from which on a step that stands out may be suspect."""
_SURPRISE_PER_STAGE = 0.02
"""The same for a composition, times its stages: compositions take larger steps."""
_BEFORE, _AFTER = 6, 2
"""Steps looked at, before and from the one that stands out."""


def compiled_step(
    system: MechanicalSystem,
    method: SteppingMethod,
    active_rows: tuple[int, ...],
    reconstruct: bool = False,
    compile: bool = True,
) -> StepRunner:
    """The runner of a method for a system; made once and kept with the system's recordings."""
    key = (method, active_rows, reconstruct, compile)
    if key not in system._compiled:
        program_key = (method, active_rows, reconstruct, "program")
        if program_key not in system._compiled:
            system._compiled[program_key] = step_program(system, method, active_rows, reconstruct)
        program: StepProgram = system._compiled[program_key]
        system._compiled[key] = CompiledStep.of(program) if compile else InterpretedStep(program)
    runner: StepRunner = system._compiled[key]
    return runner


def machine_code(
    system: MechanicalSystem,
    method: SteppingMethod | None,
    active_rows: tuple[int, ...] | None,
) -> MachineCode:
    """The compiled module of a method; ``GNI()`` and all constraint rows when left out."""
    method = GNI() if method is None else method
    if not isinstance(method, SteppingMethod):
        raise InputError(
            "method must be gni.GNI() or a discrete Lagrangian or "
            f"gni.DiscreteLagrangeDAlembert(), not {method!r}"
        )
    count = system.constraint_count
    rows = tuple(range(count)) if active_rows is None else tuple(active_rows)
    if not all(isinstance(row, int) and 0 <= row < count for row in rows):
        raise InputError(f"active_rows must be numbers from 0 to {count - 1}, got {rows}")
    return cast(CompiledStep, compiled_step(system, method, rows)).code


def step_program(
    system: MechanicalSystem,
    method: SteppingMethod,
    active_rows: tuple[int, ...],
    reconstruct: bool = False,
) -> StepProgram:
    """The expressions of one stage, derived anew."""
    expressions = SystemExpressions(system, active_rows)
    if isinstance(method, DiscreteLagrangian):
        return two_step_program(expressions, method, reconstruct)
    if isinstance(method, DiscreteLagrangeDAlembert):
        if system.has("force"):
            raise InputError(
                "DiscreteLagrangeDAlembert() does not take an external force; use gni.GNI() or a "
                "discrete Lagrangian such as gni.Rattle()"
            )
        rule = method.discrete_lagrangian
        if not active_rows:
            return two_step_program(expressions, rule, reconstruct)
        return lagrange_dalembert_program(expressions, rule, method.constraint, reconstruct)
    outward, homeward = method.flow.flights(expressions)
    if isinstance(method, McLachlanPerlmutter):
        return impulse_program(expressions, outward, homeward, method.fractions, reconstruct)
    if method.projection is None and active_rows:
        fractions = method.fractions
        return bare_program(expressions, outward, homeward, fractions, reconstruct)
    # without constraints a bare step is a projected one, and needs fewer stages
    fractions = method.fractions if active_rows else replace(
        method, projection=SymmetricProjection(), table=None
    ).fractions
    return projected_program(expressions, outward, homeward, fractions, reconstruct)


@dataclass(frozen=True)
class _Request:
    """A checked request, ready to run; ``count`` and ``every`` in stages, ``stages`` to a step."""

    system: MechanicalSystem
    start: State
    h: float
    count: int
    every: int
    method: SteppingMethod
    runner: StepRunner
    parameters: FloatArray
    state: FloatArray
    controls: FloatArray | None

    @property
    def stages(self) -> int:
        return self.runner.program.stages


def run_steps(
    system: MechanicalSystem,
    start: State,
    h: float,
    count: int,
    method: SteppingMethod,
    every: int,
    pose: FloatArray | None,
    controls: FloatArray | None,
    compile: bool,
    progress: bool,
) -> Trajectory:
    """Run a fixed-step method and collect its nodes."""
    runner = compiled_step(system, method, start.active_rows, pose is not None, compile)
    check_memory(count // every + 2, runner.program.row_size)
    members = prepare(system, runner, Starts.of(system, [start], controls), h, pose)
    parameters, state = members.parameters[:, 0], members.states[:, 0]
    stages = runner.program.stages
    sizes = (h, stages * count, stages * every)
    request = _Request(system, start, *sizes, method, runner, parameters, state, controls)
    chunks, outcome, detail, rescued = _march(request, progress)
    run = _collect(request, chunks, outcome, detail, len(rescued))
    rescue, mode = _rescue_complaint(run, rescued, request), parasitic_complaint(run)
    surprise = surprise_complaint(run)
    if rescue:
        warnings.warn(RescuedStepsWarning(rescue, run), stacklevel=3)
    if mode:
        warnings.warn(ParasiticModeWarning(mode, run), stacklevel=3)
    if surprise and not (rescue or mode):
        warnings.warn(SurprisingStepWarning(surprise, run), stacklevel=3)
    return run


Chunks = list[tuple[Progress, FloatArray]]
Rescued = list[tuple[int, float]]


def _march(request: _Request, show: bool) -> tuple[Chunks, Outcome, str, Rescued]:
    """Run chunk by chunk until the end, a failure or Ctrl-C; nothing finished is ever lost.

    The last of what is returned: stages that needed a second try, and how the velocity changed.
    """
    begin, outcome = _begin(request)
    chunks: Chunks = [(begin, np.empty((0, 0)))]
    rescued: Rescued = []
    if outcome is not Outcome.SUCCESS:
        return chunks, outcome, _detail(request, begin), rescued
    size = _FIRST_CHUNK
    try:
        steps = request.count // request.stages
        with interruptible() as check, progress_bar(steps, show) as advance_bar:
            while (done := chunks[-1][0].stage) < request.count:
                check()
                began = time.perf_counter()
                outcome = _append_chunk(
                    request, chunks, chunks[-1][0], min(size, request.count - done)
                )
                if time.perf_counter() - began < _CHUNK_SECONDS / 2:
                    size *= 2
                if outcome is not Outcome.SUCCESS:
                    outcome = _try_again(request, chunks)
                    if outcome is Outcome.SUCCESS:
                        rescued.append((chunks[-2][0].stage, _change_of_velocity(request, chunks)))
                if _cut_where_rows_are_lost(request, chunks):
                    outcome = Outcome.CONSTRAINT_LOST
                if _is_off_base(request, chunks[-1][0]):
                    outcome = Outcome.LEFT_BASE
                if outcome is not Outcome.SUCCESS:
                    return chunks, outcome, _detail(request, chunks[-1][0]), rescued
                whole = request.stages
                advance_bar(chunks[-1][0].stage // whole - done // whole)
    except KeyboardInterrupt:
        done, count = (n // request.stages for n in (chunks[-1][0].stage, request.count))
        detail = f"Stopped after step {done} of {count}."
        return chunks, Outcome.INTERRUPTED, detail, rescued
    return chunks, Outcome.SUCCESS, "", rescued


def _begin(request: _Request) -> tuple[Progress, Outcome]:
    """Progress at step 0; a start that is not complete is completed by its own program."""
    runner, outcome = request.runner, Outcome.SUCCESS
    state = request.state
    if runner.starting is not None:
        first = replace(request, runner=runner.starting, count=1, every=1)
        chunks: Chunks = [(first.runner.begin(request.parameters, state), np.empty((0, 0)))]
        outcome = _append_chunk(first, chunks, chunks[-1][0], 1)
        if outcome is not Outcome.SUCCESS:
            outcome = _try_again(first, chunks)
        state = chunks[-1][0].state
    return runner.begin(request.parameters, state), outcome


def _append_chunk(request: _Request, chunks: Chunks, begin: Progress, size: int) -> Outcome:
    after, rows, outcome = request.runner.advance(
        request.parameters, begin, size, request.every, request.controls
    )
    chunks.append((after, rows))
    return outcome


def _try_again(request: _Request, chunks: Chunks) -> Outcome:
    """Do the failed stage from a fresh guess, then with a damped and pivoted Newton iteration.

    An extrapolated guess may lead astray and trip any guard, so every failure gets its second
    try; the verdict of the fresh guess is the one reported.
    """
    runner, here = request.runner, chunks[-1][0]
    fresh = runner.with_unknowns(request.parameters, here, None)
    outcome = _append_chunk(request, chunks, fresh, 1)
    if outcome is Outcome.SUCCESS:
        return outcome
    chunks.pop()
    solved = None
    if outcome is Outcome.NEWTON_FAILED:
        solved = runner.solve_carefully(request.parameters, here, request.controls)
    if solved is not None:
        prepared = runner.with_unknowns(request.parameters, here, solved)
        if _append_chunk(request, chunks, prepared, 1) is Outcome.SUCCESS:
            return Outcome.SUCCESS
        chunks.pop()
    return outcome


def _cut_where_rows_are_lost(request: _Request, chunks: Chunks) -> bool:
    """Drop the nodes of the last chunk from where a left-out row is violated; tell whether any."""
    if len(request.start.active_rows) == request.system.constraint_count or len(chunks) < 2:
        return False
    (begin, _), (end, rows) = chunks[-2:]
    layout = request.runner.program.layout
    states = np.vstack([rows[:, : layout.size].reshape(-1, layout.size), end.state])
    lost = constraint_rows_lost(request.system, request.start.active_rows, *layout.node(states))
    if not np.any(lost):
        return False
    kept = int(np.argmax(lost))
    if not kept:
        chunks[-1] = (begin, rows[:0])
        return True
    row = rows[kept - 1]
    memory = np.append(end.memory[:-1], row[-1])  # nobody goes on from here: its guesses are unused
    stage = (begin.stage // request.every + kept) * request.every
    state = row[: layout.size].copy()
    chunks[-1] = (Progress(state, memory, stage, end.seconds), rows[:kept])
    return True


def _is_off_base(request: _Request, progress: Progress) -> bool:
    return is_off_base(request.system, request.runner.program, progress.state)


def is_off_base(system: MechanicalSystem, program: StepProgram, state: FloatArray) -> bool:
    """Whether the base point of a state has left its manifold."""
    x, _ = program.layout.node(state)
    return not bool(np.all(system.space.base_defect(x) <= _BASE_TOLERANCE))


def _detail(request: _Request, progress: Progress) -> str:
    rows = request.start.active_rows
    scales = request.parameters[len(request.parameters) - len(rows) :]
    where = (progress.stage // request.stages, request.count // request.stages)
    node = request.runner.program.layout.node(progress.state)
    return failure_detail(request.system, rows, scales, request.h, where, node)


def _collect(
    request: _Request,
    chunks: Chunks,
    outcome: Outcome,
    detail: str,
    rescued: int,
) -> Trajectory:
    program = request.runner.program
    saved = [rows for _, rows in chunks if rows.size]
    end = _last_whole_step(request, chunks)
    done, every = end.stage // request.stages, request.every // request.stages
    steps = np.arange(0, done + 1, every)
    rows = np.concatenate([row_without_arrow(program, chunks[0][0]), *saved])
    if done % every:
        rows = np.concatenate([rows, row_without_arrow(program, end)])
        steps = np.append(steps, done)
    flights = program.arrow_velocities.numel() // request.system.space.rank
    surprise, surprising_step = surprise_of(
        request.system, request.runner, request.parameters, [p for p, _ in chunks],
        request.controls,
    )  # fmt: skip
    return Trajectory(
        system=request.system,
        method_name=str(request.method),
        step_size=request.h,
        node_steps=steps,
        rows=rows,
        layout=program.layout,
        active_rows=request.start.active_rows,
        flights=flights,
        outcome=outcome,
        detail=detail,
        seconds=chunks[-1][0].seconds,
        rescued_steps=rescued,
        surprise=surprise,
        surprising_step=surprising_step,
        controls=request.controls,
    )


def _last_whole_step(request: _Request, chunks: Chunks) -> Progress:
    """Where the run stands; if inside a step, the end of the step before, found by running again.

    A step that was rescued since then stops the second run earlier: the saved node before it is
    then the last.
    """
    end = chunks[-1][0]
    if end.stage % request.stages == 0:
        return end
    begin = next(p for p, _ in reversed(chunks) if p.stage % request.stages == 0)
    wanted = end.stage // request.stages * request.stages
    last = request.runner.advance(
        request.parameters, begin, wanted - begin.stage, request.every, request.controls
    )[0]
    if last.stage == wanted:
        return last
    return replace(begin, stage=end.stage // request.every * request.every)


def row_without_arrow(program: StepProgram, progress: Progress) -> FloatArray:
    """A row as the loop writes it, the arrow that led there left NaN."""
    row = np.full((1, program.row_size), np.nan)
    row[0, : program.layout.size] = progress.state
    row[0, -1] = progress.memory[-1]
    return row


def _change_of_velocity(request: _Request, chunks: Chunks) -> float:
    """Over the last chunk, relative to the larger of both, in the metric."""
    states = np.stack([progress.state for progress, _ in chunks[-2:]])
    return float(_changes_of_velocity(request.system, request.runner.program, states)[0])


def _changes_of_velocity(
    system: MechanicalSystem, program: StepProgram, states: FloatArray
) -> FloatArray:
    """From state to state, relative to the larger of both, in the metric."""
    bases, momenta = program.layout.node(states)
    return system.velocity_changes(bases, system.velocities(bases, momenta))


def _rescue_complaint(run: Trajectory, rescued: Rescued, request: _Request) -> str:
    """Only where a velocity changed much: a poor guess for a good step is nothing to speak of."""
    jumps = [stage for stage, change in rescued if change > _JUMP]
    if not jumps or run.outcome < 0:
        return ""
    step = jumps[0] // request.stages
    many = f"{len(jumps)} stages" if len(jumps) > 1 else "one stage"
    return (
        f"{many} of {run.method_name} needed a second try and changed the velocity by more than "
        f"{_JUMP:.0%}, first in step {step + 1}, which begins at t = {step * request.h:g}: the "
        "equations of a step that is too large, or near a singularity, have several solutions, and "
        "the one found need not continue the motion. Compare with a run of half the step; near a "
        "singularity of a chart, use a groupoid that has no chart"
    )


def surprise_of(
    system: MechanicalSystem,
    runner: StepRunner,
    parameters: FloatArray,
    passed: Sequence[Progress],
    controls: FloatArray | None,
) -> tuple[float, int]:
    """How far the step that stood out most lay from its extrapolation, and its number from 1.

    passed : where the run stood, the last at its end. (0, 0) where there is nothing to speak of: a
    coarse step that the extrapolation missed is suspect only if the velocity changed much there,
    which is found by running the steps about it again.
    """
    stages = runner.program.stages
    error, stage = runner.surprise(passed[-1].memory)
    if error <= (_SURPRISE if stages == 1 else _SURPRISE_PER_STAGE * stages):
        return 0.0, 0
    step = stage // stages
    first = max(step - _BEFORE, 0) * stages
    begin = next((p for p in reversed(passed) if p.stage <= first), passed[0])
    begin, _, _ = runner.advance(parameters, begin, first - begin.stage, stages, controls)
    count = min((step + _AFTER) * stages, passed[-1].stage) - begin.stage
    _, rows, _ = runner.advance(parameters, begin, count, stages, controls)
    states = np.vstack([begin.state, rows[:, : runner.program.layout.size]])
    changes = _changes_of_velocity(system, runner.program, states)
    return (error, step + 1) if np.max(changes, initial=0.0) > UNRESOLVED else (0.0, 0)


def surprise_complaint(run: Trajectory) -> str:
    """What there is to say of a step that stood out; nothing of a run that failed."""
    if not run.surprise or run.outcome < 0:
        return ""
    begins = (run.surprising_step - 1) * run.step_size
    return (
        f"step {run.surprising_step} of {run.method_name}, which begins at t = {begins:g}, lies "
        f"{run.surprise:.2g} of the velocity away from what the steps before it led to expect, "
        "more than ten times as far as is usual in this run, and the velocity changes by more than "
        f"{UNRESOLVED:.0%} in a step there: the motion is faster than the steps resolve, or the "
        "solution found belongs to another motion, and the run should not be trusted from there "
        "on. Compare with a run of half the step; near a singularity of a chart, use a groupoid "
        "that has no chart"
    )


def parasitic_complaint(run: Trajectory) -> str:
    """What there is to say of a two-step run whose alternating mode grew; nothing otherwise."""
    if "parasitic" not in run.layout.slices or not len(run):
        return ""
    growing = run.parasitic_maximum
    usual = max(
        _PARASITIC_FACTOR * run.parasitic_bound,
        _PARASITIC_GROWTH * run.parasitic_at_start,
        _PARASITIC_FLOOR,
    )
    bound = min(usual, _PARASITIC_CEILING)
    if not growing[-1] > bound:
        return ""
    since = run.times[np.argmax(growing > bound)]
    return (
        f"the (-1)^k mode of {run.method_name} left its O(h^2) level {bound:.2g} at t = "
        f"{since:g} and has reached {growing[-1]:.2g} of |p|: it grows where the true motion "
        "contracts volume, whatever the step, and the run should not be trusted from there on. "
        "Use method=gni.GNI(), which has no such mode"
    )


@contextmanager
def progress_bar(total: int, show: bool, unit: str = "step") -> Iterator[Any]:
    """A function that moves the bar by a number of units; a silent one when not shown."""
    if not show:
        yield lambda steps: None
        return
    from tqdm.auto import tqdm

    with tqdm(total=total, unit=unit, unit_scale=True) as bar:
        yield bar.update
