"""``integrate``: check the request, pick the step program, run it in chunks, collect a trajectory."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.codegen import CompiledStep, InterpretedStep, StepRunner
from groupoid_gni.codegen.runners import Progress
from groupoid_gni.discretization import (
    DiscreteLagrangian,
    StepProgram,
    SystemExpressions,
    projected_program,
    two_step_program,
)
from groupoid_gni.errors import InputError, ParasiticModeWarning, StepFailure
from groupoid_gni.integrators.methods import GNI, Method, ReferenceFlow
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory, starting_arrow

_CHUNK = 1000
_PARASITIC_FACTOR = 3.0
_MEMORY_SHARE = 0.5


def integrate(
    system: MechanicalSystem,
    start: State,
    *,
    step: float,
    t_end: float | None = None,
    n_steps: int | None = None,
    method: Method | None = None,
    save_every: int = 1,
    reconstruct: ArrayLike | bool | None = None,
    compile: bool = True,
    progress: bool = False,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory:
    """Integrate a system from a start.

    Parameters
    ----------
    system, start : the system and a ``system.state(base, velocity)``.
    step : step size h; negative runs backwards.
    t_end or n_steps : one of the two; ``t_end`` must be a whole number of steps.
    method : ``GNI()`` (default), a discrete Lagrangian such as ``Rattle()``, ``ReferenceFlow()``.
    save_every : keep every n-th node (and the last).
    reconstruct : a pose W_0 (or True for the identity): accumulate ``W_{k+1} = W_k g_k`` in the
        loop and store it with the nodes.
    compile : False runs the same expressions through CasADi's evaluator.
    progress : show a progress bar.
    on_failure : "raise" raises StepFailure with the part computed so far as ``.result``;
        "return" returns that part with ``success == False``.

    Returns
    -------
    Trajectory. Ctrl-C also returns the part computed so far, with outcome INTERRUPTED.

    Raises
    ------
    InputError : before anything is run.  StepFailure : see ``on_failure``.
    """
    method = _checked_method(method)
    if on_failure not in ("raise", "return"):
        raise InputError(f'on_failure must be "raise" or "return", not {on_failure!r}')
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"system must be a MechanicalSystem, not {type(system).__name__}")
    h = _checked_step(step)
    n = _checked_count(h, t_end, n_steps)
    every = _checked_whole("save_every", save_every, 1)
    state = _checked_start(system, start)
    if isinstance(method, ReferenceFlow):
        from groupoid_gni.integrators.reference_flow import integrate_reference

        if reconstruct is not None:
            raise InputError("ReferenceFlow has no arrows to reconstruct from; use GNI()")
        run = integrate_reference(system, state, h, n, method, every, progress)
    else:
        pose = _checked_pose(system, state, reconstruct)
        run = _run_steps(system, state, h, n, method, every, pose, compile, progress)
    if run.outcome < 0 and on_failure == "raise":
        raise StepFailure(run.message, run)
    return run


def compiled_step(
    system: MechanicalSystem,
    method: DiscreteLagrangian | GNI,
    active_rows: tuple[int, ...],
    reconstruct: bool = False,
    compile: bool = True,
) -> StepRunner:
    """The runner of a method for a system; made once and kept with the system's recordings."""
    key = (method, active_rows, reconstruct, compile)
    if key not in system._compiled:
        program_key = (method, active_rows, reconstruct, "program")
        if program_key not in system._compiled:
            system._compiled[program_key] = _program(system, method, active_rows, reconstruct)
        program: StepProgram = system._compiled[program_key]
        system._compiled[key] = CompiledStep.of(program) if compile else InterpretedStep(program)
    runner: StepRunner = system._compiled[key]
    return runner


def _program(
    system: MechanicalSystem,
    method: DiscreteLagrangian | GNI,
    active_rows: tuple[int, ...],
    reconstruct: bool,
) -> StepProgram:
    expressions = SystemExpressions(system, active_rows)
    if isinstance(method, DiscreteLagrangian):
        return two_step_program(expressions, method, reconstruct)
    first = method.flow.discrete_lagrangian
    return projected_program(expressions, first, first.adjoint(), reconstruct)


def _checked_method(method: Method | None) -> Method:
    if method is None:
        return GNI()
    if isinstance(method, type):
        raise InputError(f"method is the class {method.__name__}; pass an instance of it: "
                         f"{method.__name__}()")
    if not isinstance(method, (DiscreteLagrangian, GNI, ReferenceFlow)):
        raise InputError(
            f"method must be a value such as gni.GNI(), gni.Rattle() or gni.ReferenceFlow(), "
            f"not {method!r}"
        )
    return method


def _checked_step(step: float) -> float:
    try:
        h = float(step)
    except (TypeError, ValueError) as error:
        raise InputError(f"step must be a number, got {step!r}") from error
    if not np.isfinite(h) or h == 0.0:
        raise InputError(f"step must be finite and not zero, got {step!r}")
    return h


def _checked_count(h: float, t_end: float | None, n_steps: int | None) -> int:
    if (t_end is None) == (n_steps is None):
        raise InputError("give exactly one of t_end and n_steps")
    if n_steps is not None:
        return _checked_whole("n_steps", n_steps, 0)
    try:
        end = float(t_end)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InputError(f"t_end must be a number, got {t_end!r}") from error
    if not np.isfinite(end):
        raise InputError(f"t_end must be finite, got {t_end!r}")
    ratio = end / h
    if ratio < 0:
        raise InputError(f"t_end = {end} lies behind the start for step = {h}; change one sign")
    if not ratio < 2.0**53:
        raise InputError(f"step = {h} is too small for t_end = {end}: more than 2^53 steps")
    n = round(ratio)
    if abs(ratio - n) > 1e-6:
        raise InputError(
            f"t_end = {end} is not a whole number of steps of {h}: {ratio:.6g} steps. Use "
            f"step={end / max(n, 1):.17g} or n_steps={int(ratio)}"
        )
    return n


def _checked_whole(name: str, value: Any, smallest: int) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        if not (isinstance(value, (float, np.floating)) and float(value).is_integer()):
            raise InputError(f"{name} must be a whole number, got {value!r}")
    if not smallest <= value < 2**53:
        raise InputError(f"{name} must be at least {smallest} and below 2^53, got {value!r}")
    return int(value)


def _checked_start(system: MechanicalSystem, start: State) -> State:
    if not isinstance(start, State):
        raise InputError(
            f"start must be made with system.state(base, velocity), got {type(start).__name__}"
        )
    if start.base.shape != (system.space.base_size,) or (
        start.velocity.shape != (system.space.rank,)
    ):
        raise InputError(
            f"start belongs to another system: base {start.base.shape} and velocity "
            f"{start.velocity.shape}, this system needs ({system.space.base_size},) and "
            f"({system.space.rank},)"
        )
    # with_parameters may have changed metric and drift since the start was made
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return system.state(start.base if system.space.base_size else None, start.velocity)


def _checked_pose(
    system: MechanicalSystem, state: State, reconstruct: ArrayLike | bool | None
) -> FloatArray | None:
    if reconstruct is None or reconstruct is False:
        return None
    pose = None if reconstruct is True else reconstruct
    return starting_arrow(system.space, state.base, pose)


@dataclass(frozen=True)
class _Request:
    """A checked request, ready to run."""

    system: MechanicalSystem
    start: State
    h: float
    count: int
    every: int
    method: DiscreteLagrangian | GNI
    runner: StepRunner
    parameters: FloatArray
    state: FloatArray


def _run_steps(
    system: MechanicalSystem,
    start: State,
    h: float,
    count: int,
    method: DiscreteLagrangian | GNI,
    every: int,
    pose: FloatArray | None,
    compile: bool,
    progress: bool,
) -> Trajectory:
    runner = compiled_step(system, method, start.active_rows, pose is not None, compile)
    check_memory(count // every + 2, runner.program.row_size)
    expressions = SystemExpressions(system, start.active_rows)
    node = _node_numbers(expressions, start, system.parameter_vector)
    state = _initial_state(runner.program, start, h, node, pose)
    parameters = np.concatenate([system.parameter_vector, [h], node["scales"]])
    request = _Request(system, start, h, count, every, method, runner, parameters, state)
    began = time.perf_counter()
    chunks, outcome, detail, rescued = _march(request, progress)
    seconds = time.perf_counter() - began
    run = _collect(request, chunks, outcome, detail, seconds, rescued)
    _warn_of_parasitic_mode(run)
    return run


def _node_numbers(
    expressions: SystemExpressions, start: State, theta: FloatArray
) -> dict[str, FloatArray]:
    """Scales C_aa of the constraints and the multiplier at the start, in numbers."""
    import casadi as ca

    if not expressions.constraint_count:
        empty = np.zeros(0)
        return {"scales": empty, "impulse": np.zeros(expressions.rank), "normal": empty}
    x, p = ca.SX.sym("x", expressions.base_size), ca.SX.sym("p", expressions.rank)
    parameters = ca.SX.sym("theta", expressions.parameter_size)
    node = expressions.node(x, parameters)
    force = ca.mtimes(node.mu.T, expressions.multipliers(x, p, parameters))
    normal = node.normal_component(p - force) - node.normal_component(p)
    outputs = [ca.diag(node.gram), force, normal]
    values = ca.Function("start", [x, p, parameters], outputs)(start.base, start.momentum, theta)
    return dict(
        zip(("scales", "impulse", "normal"), (np.array(v).ravel() for v in values), strict=True)
    )


def _initial_state(
    program: StepProgram,
    start: State,
    h: float,
    node: dict[str, FloatArray],
    pose: FloatArray | None,
) -> FloatArray:
    """The flat start: base, momenta, and for two-step methods half of the constraint impulse."""
    layout = program.layout
    state = np.zeros(layout.size)
    state[layout.slices["base"]] = start.base
    half = np.zeros_like(start.momentum)
    if layout.slices["before"] != layout.slices["after"]:
        half = 0.5 * h * node["impulse"]
        m = len(node["normal"])
        if m:
            state[layout.slices["normals"]][:m] = 0.5 * h * node["normal"]
            state[layout.slices["parasitic"]][3] = 1.0
    state[layout.slices["before"]] = start.momentum - half
    state[layout.slices["after"]] = start.momentum + half
    if pose is not None:
        state[layout.slices["reconstructed"]] = pose
    return state


def check_memory(rows: int, width: int) -> None:
    """Refuse a request whose result would not fit into memory."""
    needed = 8.0 * rows * width
    try:
        available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        available = 8 * 2**30
    if needed > _MEMORY_SHARE * available:
        suggestion = int(np.ceil(needed / (0.05 * available)))
        raise InputError(
            f"saving {rows} nodes of {width} numbers takes {needed / 2**30:.1f} GiB and "
            f"{available / 2**30:.1f} GiB are free; use save_every={suggestion} or more"
        )


Chunks = list[tuple[Progress, FloatArray]]


def _march(request: _Request, show: bool) -> tuple[Chunks, Outcome, str, int]:
    """Run chunk by chunk until the end, a failure or Ctrl-C; nothing finished is ever lost."""
    chunks: Chunks = [(request.runner.begin(request.parameters, request.state), np.empty((0, 0)))]
    rescued = 0
    try:
        with progress_bar(request.count, show) as advance_bar:
            while (done := chunks[-1][0].step) < request.count:
                size = min(_CHUNK, request.count - done)
                outcome = _append_chunk(request, chunks, chunks[-1][0], size)
                if outcome is Outcome.NEWTON_FAILED and _rescue(request, chunks):
                    outcome, rescued = Outcome.SUCCESS, rescued + 1
                if outcome is Outcome.SUCCESS:
                    outcome = _check_dropped_rows(request, chunks[-1][0])
                if outcome is not Outcome.SUCCESS:
                    return chunks, outcome, _failure_detail(request, chunks[-1][0]), rescued
                advance_bar(chunks[-1][0].step - done)
    except KeyboardInterrupt:
        done = chunks[-1][0].step
        detail = f"Stopped after step {done} of {request.count}."
        return chunks, Outcome.INTERRUPTED, detail, rescued
    return chunks, Outcome.SUCCESS, "", rescued


def _append_chunk(request: _Request, chunks: Chunks, begin: Progress, size: int) -> Outcome:
    after, rows, outcome = request.runner.advance(request.parameters, begin, size, request.every)
    chunks.append((after, rows))
    return outcome


def _rescue(request: _Request, chunks: Chunks) -> bool:
    """Try the failed step again from a fresh guess, then with a damped and pivoted Newton."""
    runner, here = request.runner, chunks[-1][0]
    fresh = runner.with_unknowns(request.parameters, here, None)
    if _append_chunk(request, chunks, fresh, 1) is Outcome.SUCCESS:
        return True
    chunks.pop()
    solved = runner.solve_carefully(request.parameters, here)
    if solved is None:
        return False
    prepared = runner.with_unknowns(request.parameters, here, solved)
    if _append_chunk(request, chunks, prepared, 1) is Outcome.SUCCESS:
        return True
    chunks.pop()
    return False


def _check_dropped_rows(request: _Request, progress: Progress) -> Outcome:
    """Rows left out at the start as dependent must still hold."""
    system = request.system
    dropped = sorted(set(range(system.constraint_count)) - set(request.start.active_rows))
    if not dropped:
        return Outcome.SUCCESS
    layout = request.runner.program.layout
    x = progress.state[layout.slices["base"]]
    p = 0.5 * (progress.state[layout.slices["before"]] + progress.state[layout.slices["after"]])
    metric = system.evaluate("metric", x)
    velocity = np.linalg.solve(metric, p - system.evaluate("gyroscopic", x))
    mu, drift = system.evaluate("constraints", x)[dropped], system.evaluate("drift", x)
    size = np.abs(mu) @ (np.abs(velocity) + np.abs(drift)) + 1e-300
    violated = np.abs(mu @ (velocity - drift)) > 1e-8 * size
    return Outcome.CONSTRAINT_LOST if np.any(violated) else Outcome.SUCCESS


def _failure_detail(request: _Request, progress: Progress) -> str:
    """Where the run stopped, with the numbers that tell why."""
    system, layout = request.system, request.runner.program.layout
    x = progress.state[layout.slices["base"]]
    p = 0.5 * (progress.state[layout.slices["before"]] + progress.state[layout.slices["after"]])
    text = (
        f"Failed in step {progress.step + 1} of {request.count}, after t = "
        f"{progress.step * request.h:.6g}"
    )
    if x.size:
        text += f", at the base point {np.array2string(x, precision=6, threshold=12)}"
    with np.errstate(all="ignore"):
        metric = system.evaluate("metric", x)
        eigenvalues = np.linalg.eigvalsh(metric) if np.all(np.isfinite(metric)) else [np.nan]
        if not eigenvalues[0] > 0:
            return text + f"; the metric is no longer positive definite there: {eigenvalues}."
        velocity = np.linalg.solve(metric, p - system.evaluate("gyroscopic", x))
        text += f", velocity {np.array2string(velocity, precision=6, threshold=12)}"
        rows = list(request.start.active_rows)
        if rows:
            mu = system.evaluate("constraints", x)[rows]
            text += f"; condition number of C there {np.linalg.cond(mu @ np.linalg.solve(metric, mu.T)):.3g}"
        reach = float(np.max(np.asarray(system.space.reach(x, request.h * velocity))))
        if reach > 0.5:
            text += (
                f"; one step covers {reach:.2f} of the retraction's domain: use a step below "
                f"{abs(request.h) * 0.5 / reach:.2g}"
            )
    return text + "."


@contextmanager
def progress_bar(total: int, show: bool) -> Iterator[Any]:
    """A function that moves the bar by a number of steps; a silent one when not shown."""
    if not show:
        yield lambda steps: None
        return
    from tqdm.auto import tqdm

    with tqdm(total=total, unit="step", unit_scale=True) as bar:
        yield bar.update


def _collect(
    request: _Request,
    chunks: Chunks,
    outcome: Outcome,
    detail: str,
    seconds: float,
    rescued: int,
) -> Trajectory:
    program = request.runner.program
    width = program.row_size
    first = np.full((1, width), np.nan)
    first[0, : program.layout.size] = request.state
    first[0, -1] = 0.0
    saved = [rows for _, rows in chunks if rows.size]
    done = chunks[-1][0].step
    steps = np.arange(0, done + 1, request.every)
    rows = np.concatenate([first, *saved])
    if done % request.every:
        last = np.full((1, width), np.nan)
        last[0, : program.layout.size] = chunks[-1][0].state
        last[0, -1] = chunks[-1][0].memory[-1]
        rows, steps = np.concatenate([rows, last]), np.append(steps, done)
    flights = program.arrow_velocities.numel() // request.system.space.rank
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
        seconds=seconds,
        rescued_steps=rescued,
    )


def _warn_of_parasitic_mode(run: Trajectory) -> None:
    if "parasitic" not in run.layout.slices or not run._part("parasitic").shape[1]:
        return
    largest, bound = float(run._part("parasitic")[-1, 1]), run.parasitic_bound
    if largest > _PARASITIC_FACTOR * bound:
        beyond = run.parasitic_amplitude > _PARASITIC_FACTOR * bound
        since = f" since t = {run.times[np.argmax(beyond)]:g}" if np.any(beyond) else ""
        warnings.warn(
            f"the (-1)^k mode of {run.method_name} has reached {largest:.2g} of |p|{since}, beyond "
            f"the O(h^2) level {bound:.2g}: it grows where the true motion contracts volume, "
            "whatever the step, and the run should not be trusted from there on. Use method="
            "gni.GNI(), which has no such mode",
            ParasiticModeWarning,
            stacklevel=4,
        )
