"""Many members of one system: lanes of a vector register, threads, or any executor.

Members differ in their starts and parameters and share method, step and nodes. Each has the bits of
a run of its own; one that fails fails alone, and is run again by itself for its verdict.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cached_property
from types import TracebackType
from typing import cast, overload

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.codegen import (
    LaneJob,
    LaneResult,
    StepRunner,
    machine_has_fused_products,
    run_lane_job,
    step_kernel_ir,
    widest_lanes,
)
from groupoid_gni.codegen.runners import Progress
from groupoid_gni.errors import (
    GNIWarning,
    InputError,
    ParasiticModeWarning,
    SurprisingStepWarning,
)
from groupoid_gni.integrators.ensemble_inputs import Member, checked_members
from groupoid_gni.integrators.interruption import interruptible
from groupoid_gni.integrators.marching import (
    compiled_step,
    is_off_base,
    parasitic_complaint,
    progress_bar,
    row_without_arrow,
    run_steps,
    surprise_complaint,
    surprise_of,
)
from groupoid_gni.integrators.methods import Method, ReferenceFlow, SteppingMethod
from groupoid_gni.integrators.preparation import Starts, prepare
from groupoid_gni.integrators.requests import (
    check_memory,
    checked_controls,
    checked_count,
    checked_method,
    checked_pose,
    checked_step,
    checked_whole,
)
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Ensemble(Sequence[Trajectory]):
    """The runs of an ensemble, in the order of their members; ``ensemble[i]`` is a Trajectory.

    failures : member number -> what happened, for members that failed or were refused; a refused
        member has a trajectory of no node.
    seconds : time in compiled loops, summed over threads or processes.
    lanes, jobs : members side by side in one loop, and loops.
    """

    members: tuple[Trajectory, ...]
    failures: Mapping[int, str]
    seconds: float
    lanes: int
    jobs: int

    def __len__(self) -> int:
        return len(self.members)

    @overload
    def __getitem__(self, number: int) -> Trajectory: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[Trajectory]: ...

    def __getitem__(self, number: int | slice) -> Trajectory | Sequence[Trajectory]:
        return self.members[number]

    @property
    def success(self) -> bool:
        """Whether every member reached the end."""
        return not self.failures

    def final(self, quantity: str = "velocities") -> FloatArray:
        """(N, ...) last values of ``base``, ``velocities``, ``momenta`` ...; NaN for failures."""
        if not self.members or len(self.failures) == len(self.members):
            raise InputError("no member of this ensemble reached the end")
        good = [i for i in range(len(self)) if i not in self.failures]
        first = np.asarray(getattr(self[good[0]], quantity))[-1]
        values = np.full((len(self), *first.shape), np.nan)
        for i in good:
            values[i] = np.asarray(getattr(self[i], quantity))[-1]
        return values

    def summary(self) -> str:
        """Members, failures and cost in a few lines."""
        steps = sum(int(run.node_steps[-1]) for run in self.members if len(run))
        lines = [
            f"ensemble of {len(self)} members, {len(self) - len(self.failures)} reached the end, "
            f"{steps} steps in {self.jobs} jobs of {self.lanes} lanes"
        ]
        if steps and self.seconds:
            lines.append(f"  time         {self.seconds:.3g} s of loops, "
                         f"{self.seconds / steps * 1e9:.1f} ns per step and member")
        lines += [f"  member {i:<6d} {text}" for i, text in list(self.failures.items())[:5]]
        if len(self.failures) > 5:
            lines.append(f"  and {len(self.failures) - 5} more failures")
        return "\n".join(lines)


def integrate_ensemble(
    system: MechanicalSystem,
    starts: State | Sequence[State],
    *,
    parameters: Mapping[str, ArrayLike] | None = None,
    step: float,
    t_end: float | None = None,
    n_steps: int | None = None,
    method: Method | None = None,
    save_every: int | None = None,
    reconstruct: ArrayLike | bool | None = None,
    controls: ArrayLike | None = None,
    lanes: int | None = None,
    threads: int = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> Ensemble:
    """Integrate many starts, many parameter values, or both.

    Parameters
    ----------
    system : the system of all members.
    starts : one ``system.state(...)`` for all members, or one for each.
    parameters : name -> array with the member as its first axis; others keep the system's values.
    step, t_end, n_steps, method, reconstruct, controls : as for ``integrate``, for all members.
    save_every : keep every n-th node; only the first and the last when left out.
    lanes : members side by side in one loop: 1, 2, 4 or 8; chosen for this processor if left out.
    threads : loops at the same time in this process (the interpreter lock is released).
    executor : any ``concurrent.futures`` executor instead, for example a ProcessPoolExecutor or
        Dask's ``Client.get_executor()``; jobs hold machine code as text and arrays, nothing else.
    progress : show a progress bar, in members.

    Returns
    -------
    Ensemble. Members that fail or are refused are in ``failures``; nothing is raised for them, and
    the others are complete. Ctrl-C is passed on once running jobs have ended. Members that needed
    second tries warn as runs of ``integrate`` do; a parasitic mode and steps that surprise are told
    once for all.

    Raises
    ------
    InputError : for a request that no member could be run with.
    """
    method = checked_method(method)
    if isinstance(method, ReferenceFlow):
        raise InputError("ensembles take stepping methods; loop over integrate for ReferenceFlow()")
    h = checked_step(step)
    count = checked_count(h, t_end, n_steps)
    every = max(count, 1) if save_every is None else checked_whole("save_every", save_every, 1)
    members, refused = checked_members(system, starts, parameters)
    request = _EnsembleRequest(
        system, members, h, count, every, method, reconstruct,
        checked_controls(system, controls, count), _checked_lanes(lanes),
    )
    threads = checked_whole("threads", threads, 1)
    with _Pool(executor, threads) as submit:
        return request.run(refused, submit, progress)


def _checked_lanes(lanes: int | None) -> int:
    if lanes is None:
        return widest_lanes()
    if isinstance(lanes, bool) or lanes not in (1, 2, 4, 8):
        raise InputError(f"lanes must be 1, 2, 4 or 8, got {lanes!r}")
    return int(lanes)


Submit = Callable[[LaneJob], "Future[LaneResult]"]


class _Pool:
    """``submit`` of the executor given, or of threads of our own."""

    def __init__(self, executor: Executor | None, threads: int) -> None:
        if executor is not None and not hasattr(executor, "submit"):
            raise InputError(
                f"executor must be a concurrent.futures executor, not {type(executor).__name__}"
            )
        self._own = ThreadPoolExecutor(threads) if executor is None else None
        self._executor = executor or self._own

    def __enter__(self) -> Submit:
        return lambda job: self._executor.submit(run_lane_job, job)  # type: ignore[union-attr]

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._own is not None:
            self._own.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True)
class _EnsembleRequest:
    """A checked request."""

    system: MechanicalSystem
    members: list[Member]
    h: float
    count: int
    every: int
    method: SteppingMethod
    reconstruct: ArrayLike | bool | None
    controls: FloatArray | None
    lanes: int

    def run(self, refused: dict[int, str], submit: Submit, show: bool) -> Ensemble:
        """All members; those in ``refused`` have no start."""
        done: dict[int, Trajectory] = {}
        batches = list(self._batches())
        seconds = 0.0
        with interruptible() as check, progress_bar(len(self.members), show, "run") as advance_bar:
            waiting = {submit(batch.job): batch for batch in batches if batch.job is not None}
            for batch in batches:
                if batch.job is None:
                    done.update({i: self._alone(i) for i in batch.numbers})
                    advance_bar(len(batch.numbers))
            try:
                for future in as_completed(waiting):
                    result, batch = future.result(), waiting[future]
                    seconds += result.seconds
                    done.update(self._collected(batch, result))
                    advance_bar(len(batch.numbers))
                    check()
            except BaseException:
                for future in waiting:
                    future.cancel()
                raise
        _warn_of_suspects({i: done[i] for b in batches if b.job for i in b.numbers})
        failures = {**refused, **{i: run.message for i, run in done.items() if not run.success}}
        whole = len(done) + len(refused)
        runs = [done[i] if i in done else self._nothing(refused[i]) for i in range(whole)]
        return Ensemble(
            tuple(runs), dict(sorted(failures.items())), seconds, self.lanes, len(batches)
        )

    def _batches(self) -> Iterator[_Batch]:
        """Members of equal active rows, lane by lane."""
        groups: dict[tuple[int, ...], list[Member]] = {}
        for member in self.members:
            groups.setdefault(member.start.active_rows, []).append(member)
        nodes = self.count // self.every + 2
        for rows, group in groups.items():
            runner = compiled_step(
                self.system, self.method, rows, self.reconstruct not in (None, False)
            )
            check_memory(nodes * len(self.members), runner.program.row_size)
            alone = len(rows) < self.system.constraint_count or runner.starting is not None
            if alone or self.count == 0:
                yield _Batch(runner, [member.number for member in group])
                continue
            yield from self._lane_batches(runner, group)

    def _lane_batches(self, runner: StepRunner, group: list[Member]) -> Iterator[_Batch]:
        theta = np.stack([member.theta for member in group], axis=1)
        states = [member.start for member in group]
        starts = Starts.of(self.system, states, self.controls, theta)
        prepared = prepare(self.system, runner, starts, self.h, self._poses(states))
        memories = runner.first_memories(prepared.parameters, prepared.states)
        source = self._lane_source(runner, group[0].start.active_rows)
        stages = runner.program.stages
        controls = self.controls
        if controls is not None:
            controls = np.repeat(controls[:, :, None], self.lanes, axis=2)
        for begin in range(0, len(group), self.lanes):
            numbers = [member.number for member in group[begin : begin + self.lanes]]
            # the last batch is filled with copies, which are never run
            columns = [min(begin + k, len(group) - 1) for k in range(self.lanes)]
            job = LaneJob(
                source, runner.program.row_size, prepared.parameters[:, columns],
                prepared.states[:, columns], memories[:, columns], 0, stages * self.count,
                stages * self.every, len(numbers), controls,
            )
            yield _Batch(runner, numbers, job)

    def _poses(self, states: list[State]) -> FloatArray | None:
        poses = [checked_pose(self.system, state, self.reconstruct) for state in states]
        arrows = [pose for pose in poses if pose is not None]
        return np.stack(arrows, axis=1) if arrows else None

    def _lane_source(self, runner: StepRunner, rows: tuple[int, ...]) -> str:
        """LLVM IR over the lanes; made once and kept with the system's recordings."""
        posed = self.reconstruct not in (None, False)
        key, kept = (self.method, rows, posed, "lanes", self.lanes), self.system._compiled
        if key not in kept:
            fused = machine_has_fused_products()
            kept[key] = step_kernel_ir(runner.program, self.lanes, fused)
        source: str = kept[key]
        return source

    @cached_property
    def _by_number(self) -> dict[int, Member]:
        return {member.number: member for member in self.members}

    def _alone(self, number: int) -> Trajectory:
        """The member as a run of its own."""
        member = self._by_number[number]
        system = member.system(self.system)
        return run_steps(
            system, member.start, self.h, self.count, self.method, self.every,
            checked_pose(system, member.start, self.reconstruct), self.controls, True, False,
        )

    def _collected(self, batch: _Batch, result: LaneResult) -> dict[int, Trajectory]:
        runs = {}
        for lane, number in enumerate(batch.numbers):
            program, state = batch.runner.program, result.state[:, lane]
            good = result.codes[lane] == Outcome.SUCCESS
            good = good and not is_off_base(self.system, program, state)
            runs[number] = self._from_lane(batch, result, lane) if good else self._alone(number)
        return runs

    def _from_lane(self, batch: _Batch, result: LaneResult, lane: int) -> Trajectory:
        """The trajectory that ``integrate`` would have returned."""
        member = self._by_number[batch.numbers[lane]]
        program, job = batch.runner.program, cast(LaneJob, batch.job)
        first = Progress(job.state[:, lane], job.memory[:, lane])
        end = Progress(result.state[:, lane], result.memory[:, lane], job.count)
        rows = [row_without_arrow(program, first), result.rows[:, :, lane]]
        steps = np.arange(0, self.count + 1, self.every)
        if self.count % self.every:
            rows.append(row_without_arrow(program, end))
            steps = np.append(steps, self.count)
        system, parameters = member.system(self.system), job.parameters[:, lane].copy()
        surprise, surprising_step = surprise_of(
            system, batch.runner, parameters, [first, end], self.controls
        )
        return Trajectory(
            system=system,
            method_name=str(self.method),
            step_size=self.h,
            node_steps=steps,
            rows=np.concatenate(rows),
            layout=program.layout,
            active_rows=member.start.active_rows,
            flights=program.arrow_velocities.numel() // self.system.space.rank,
            seconds=result.seconds / len(batch.numbers),
            surprise=surprise,
            surprising_step=surprising_step,
            controls=self.controls,
        )

    def _nothing(self, why: str) -> Trajectory:
        rows = tuple(range(self.system.constraint_count))
        program = compiled_step(self.system, self.method, rows).program
        return Trajectory(
            system=self.system,
            method_name=str(self.method),
            step_size=self.h,
            node_steps=np.zeros(0, dtype=int),
            rows=np.zeros((0, program.row_size)),
            layout=program.layout,
            active_rows=rows,
            flights=0,
            outcome=Outcome.START_REFUSED,
            detail=why,
        )


@dataclass(frozen=True)
class _Batch:
    """Members that one job runs; without a job each is run by itself."""

    runner: StepRunner
    numbers: list[int]
    job: LaneJob | None = None


def _warn_of_suspects(runs: Mapping[int, Trajectory]) -> None:
    """One warning of each kind for all members that came out of a loop over lanes."""
    modes = {i: text for i, run in runs.items() if (text := parasitic_complaint(run))}
    steps = {
        i: text for i, run in runs.items()
        if i not in modes and (text := surprise_complaint(run))
    }
    kinds: tuple[tuple[Callable[[str, Trajectory], GNIWarning], dict[int, str]], ...] = (
        (ParasiticModeWarning, modes), (SurprisingStepWarning, steps)
    )
    for kind, complaints in kinds:
        if complaints:
            first = min(complaints)
            text = f"{len(complaints)} of {len(runs)} members, first member {first}: "
            warnings.warn(kind(text + complaints[first], runs[first]), stacklevel=4)
