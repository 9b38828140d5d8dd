"""Two ways to run a step program: machine code, and CasADi's evaluator as a second opinion.

Both keep the same ``Progress`` (state; unknowns of the last stages, carried values, record of the
warm start and Newton count; absolute stage number), so a run may be cut into chunks anywhere
without changing a bit. A step is one stage or, in a composition, several; everything here counts
stages.
"""

from __future__ import annotations

import ctypes
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import newton_rule as rule
from groupoid_gni.codegen import surprise
from groupoid_gni.codegen.machine import MachineCode, machine_has_fused_products
from groupoid_gni.codegen.step_kernel import (
    MEASURE,
    finish_function,
    step_function,
    step_kernel_ir,
)
from groupoid_gni.codegen.warm_start import extrapolation_weights, watched_stage
from groupoid_gni.discretization.step_program import StepProgram
from groupoid_gni.outcomes import Outcome


@dataclass(frozen=True)
class Progress:
    """Where a run stands: everything needed to go on, bit for bit. Never changed in place.

    state : (n,).  memory : unknowns of the last stages, carried values, record of ``surprise``,
    Newton count.  stage : number of stages done.  seconds : wall time of the loop that did them.
    """

    state: FloatArray
    memory: FloatArray
    stage: int = 0
    seconds: float = 0.0


@dataclass(frozen=True)
class StepRunner(ABC):
    """Runs the steps of one program."""

    program: StepProgram

    @abstractmethod
    def advance(
        self,
        parameters: FloatArray,
        progress: Progress,
        count: int,
        every: int,
        controls: FloatArray | None = None,
    ) -> tuple[Progress, FloatArray, Outcome]:
        """Do up to ``count`` stages; return where it stands, the saved rows and how it went.

        Rows hold state, arrow velocities and Newton count of the stages whose absolute number is a
        multiple of ``every``. On failure the new progress is the last good stage.
        controls : (steps, inputs), the control inputs of all steps from the very first.
        """

    def given(self, stage: int, controls: FloatArray | None) -> FloatArray:
        """What the stage with this number is told: its fraction and the inputs of its step."""
        step, place = divmod(stage, self.program.stages)
        fraction = self.program.fractions[place : place + 1] if self.program.stages > 1 else ()
        inputs = np.zeros(0)
        if self.program.control_size and controls is not None:
            inputs = controls[step]
        return np.concatenate([fraction, inputs])

    @cached_property
    def starting(self) -> StepRunner | None:
        """Runs the program that completes a start; None where a start is complete."""
        start = self.program.start
        return None if start is None else InterpretedStep(start)

    @cached_property
    def _first_memory(self) -> ca.Function:
        p = self.program
        return ca.Function("first", [p.parameters, p.state], [p.first_guess, p.first_carried])

    @cached_property
    def _update_and_slope(self) -> ca.Function:
        """The iteration's update and its Jacobian, with carried values held."""
        p = self.program
        jacobian = ca.densify(ca.jacobian(p.update, p.unknowns))
        state = ca.vertcat(p.state, p.given)
        inputs = [p.parameters, state, p.unknowns, p.carried, p.later]
        return ca.Function("update", inputs, ca.cse([ca.densify(p.update), jacobian]))

    def begin(self, parameters: FloatArray, state: FloatArray) -> Progress:
        """Progress at step 0, warm start included."""
        nothing = Progress(np.array(state), np.zeros(self.program.memory_size))
        return self.with_unknowns(parameters, nothing, None)

    def first_memories(self, parameters: FloatArray, states: FloatArray) -> FloatArray:
        """Memories of many members at step 0: (parameters, N), (state, N) -> (memory, N)."""
        arguments = [a if len(a) else np.zeros((0, 1)) for a in (parameters, states)]
        guess, carried = (v.full() for v in self._first_memory.call(arguments))
        count = states.shape[1]
        recent = np.tile(np.broadcast_to(guess, (len(guess), count)), (self.program.history, 1))
        carried = np.broadcast_to(carried, (len(carried), count))
        rest = np.zeros((self.program.record_size + 1, count))
        if self.program.record_size:
            rest[surprise.USUAL], rest[surprise.PRIMED] = surprise.FIRST, surprise.LEARNING
        return np.concatenate([recent, carried, rest])

    def with_unknowns(
        self, parameters: FloatArray, progress: Progress, unknowns: FloatArray | None
    ) -> Progress:
        """The same progress with a warm start from given unknowns, or from the state alone."""
        guess, carried = (
            np.array(v).ravel() for v in self._first_memory(parameters, progress.state)
        )
        recent = np.tile(guess if unknowns is None else unknowns, self.program.history)
        record = self.record(progress.memory).copy()
        if len(record):
            record[surprise.USUAL] = max(record[surprise.USUAL], surprise.FIRST)
            record[surprise.PRIMED] = progress.stage + surprise.LEARNING
        memory = np.concatenate([recent, carried, record, progress.memory[-1:]])
        return replace(progress, memory=memory)

    def surprise(self, memory: FloatArray) -> tuple[float, int]:
        """The largest e that stood out and the number of its stage; (0, 0) where none did."""
        record = self.record(memory)
        if not len(record):
            return 0.0, 0
        return float(np.sqrt(record[surprise.LARGEST])), int(record[surprise.WHERE])

    def record(self, memory: FloatArray) -> FloatArray:
        """The record of ``surprise`` in a memory; empty without unknowns."""
        return memory[len(memory) - 1 - self.program.record_size : -1]

    def solve_carefully(
        self, parameters: FloatArray, progress: Progress, controls: FloatArray | None = None
    ) -> FloatArray | None:
        """Newton with pivoting and damping for the next stage, used when the fast one has failed.

        Solves "the update is zero" with its exact Jacobian. Returns the unknowns, or None.
        """
        first = self._first_memory(parameters, progress.state)
        u, carried = (np.array(v, dtype=float).ravel() for v in first)

        state = np.concatenate([progress.state, self.given(progress.stage, controls)])

        def system(values: FloatArray) -> list[FloatArray]:
            outputs = self._update_and_slope(parameters, state, values, carried, 0.0)
            return [np.asarray(v) for v in outputs]

        with np.errstate(all="ignore"):
            for _ in range(100):
                residual, jacobian = system(u)
                if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
                    return None
                try:
                    change = np.linalg.solve(jacobian, residual).ravel()
                except np.linalg.LinAlgError:
                    return None
                u = u - _damping(system, u, change, residual) * change
                if np.max(np.abs(change), initial=0.0) <= 1e-12 * np.max(np.abs(u), initial=1e-300):
                    return u
        return None


def _damping(system: Any, u: Any, change: Any, residual: Any) -> float:
    """Largest of 1, 1/2, ... 1/16 that makes the residual smaller; 1/32 if none does."""
    before = float(np.linalg.norm(residual))
    for factor in (1.0, 0.5, 0.25, 0.125, 0.0625):
        if float(np.linalg.norm(system(u - factor * change)[0])) < before:
            return factor
    return 0.03125


@dataclass(frozen=True)
class CompiledStep(StepRunner):
    """The loop over steps as machine code.

    code : the compiled module; ``code.source`` is its LLVM IR.
    """

    code: MachineCode = field(default=None)  # type: ignore[assignment]

    @classmethod
    def of(cls, program: StepProgram) -> CompiledStep:
        """Emit and compile a program for one lane."""
        ir = step_kernel_ir(program, lanes=1, fused=machine_has_fused_products())
        return cls(program, MachineCode(ir))

    @cached_property
    def _advance(self) -> Any:
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        kinds = [*[pointer] * 5, integer, integer, integer]
        if self.program.control_size:
            kinds.append(pointer)
        return self.code.function("advance", *kinds, returns=integer)

    def advance(
        self,
        parameters: FloatArray,
        progress: Progress,
        count: int,
        every: int,
        controls: FloatArray | None = None,
    ) -> tuple[Progress, FloatArray, Outcome]:
        """See the base class."""
        first = progress.stage
        more = () if controls is None else (np.ascontiguousarray(controls).ctypes.data,)
        rows = np.empty(((first + count) // every - first // every, self.program.row_size))
        status = np.zeros(2, dtype=np.int64)
        state, memory = progress.state.copy(), progress.memory.copy()
        arrays = (parameters, state, memory, rows, status)
        given = [a.ctypes.data for a in arrays]
        began = time.perf_counter()
        done = self._advance(*given, first, count, every, *more)
        seconds = progress.seconds + time.perf_counter() - began
        kept = rows[: (first + done) // every - first // every]
        return Progress(state, memory, first + done, seconds), kept, Outcome(int(status[0]))


@dataclass(frozen=True)
class InterpretedStep(StepRunner):
    """The same expressions through CasADi's evaluator: slow, and independent of our emitter."""

    @cached_property
    def _step(self) -> ca.Function:
        return step_function(self.program)

    @cached_property
    def _finish(self) -> ca.Function:
        finish = self.program.state if self.program.finish is None else self.program.finish
        return finish_function(self.program, finish)

    def advance(
        self,
        parameters: FloatArray,
        progress: Progress,
        count: int,
        every: int,
        controls: FloatArray | None = None,
    ) -> tuple[Progress, FloatArray, Outcome]:
        """See the base class."""
        rows = []
        outcome, began = Outcome.SUCCESS, time.perf_counter() - progress.seconds
        for _ in range(count):
            outcome, following, arrows = self._one_stage(parameters, progress, controls)
            if outcome is not Outcome.SUCCESS:
                break
            progress = following
            if progress.stage % every == 0:
                rows.append(np.concatenate([progress.state, arrows, progress.memory[-1:]]))
        progress = replace(progress, seconds=time.perf_counter() - began)
        return progress, np.array(rows).reshape(-1, self.program.row_size), outcome

    def _one_stage(
        self, parameters: FloatArray, progress: Progress, controls: FloatArray | None
    ) -> tuple[Outcome, Progress, FloatArray]:
        n, history = self.program.unknowns.numel(), self.program.history
        memory = progress.memory
        recent = memory[: history * n].reshape(history, n)
        weights = extrapolation_weights(self.program.fractions)
        guess = np.asarray(weights[progress.stage % self.program.stages]) @ recent
        state = np.concatenate([progress.state, self.given(progress.stage, controls)])
        record = self.record(memory)
        kept = memory[history * n : len(memory) - 1 - len(record)]
        last, u, carried, (iterations, surprised) = self._iterate(parameters, state, guess, kept)
        _, _, _, following, arrows, guards, finite = last
        parts = self.program.layout.positions("base", "after", "reconstructed")
        numbers = [*following[parts], *finite]
        verdict = self._verdict(guards, iterations > 0 or n == 0, numbers)
        if verdict is not Outcome.SUCCESS:
            return verdict, progress, arrows
        if n:
            fractions, stage = self.program.fractions, progress.stage
            watched = stage % len(fractions) == watched_stage(fractions)
            energy = float(last[MEASURE][1])
            record = np.array(surprise.noted([*record], surprised, energy, stage, watched))
        memory = np.concatenate([u, recent[:-1].ravel(), carried, record, memory[-1:] + iterations])
        if self.program.finish is not None and (progress.stage + 1) % self.program.stages == 0:
            given = state[len(progress.state) :]
            end = self._finish(parameters, np.concatenate([following, given]))
            following = np.array(end).ravel()
        return Outcome.SUCCESS, Progress(following, memory, progress.stage + 1), arrows

    def _verdict(self, guards: FloatArray, converged: bool, numbers: list[float]) -> Outcome:
        """As in the machine code: decisive guards, Newton, other guards, finite numbers."""
        pairs = list(zip(guards, self.program.guards, strict=True))
        for value, guard in pairs:
            if guard.decisive and value >= 1.0:
                return Outcome(guard.code)
        if not converged:
            return Outcome.NEWTON_FAILED
        for value, guard in pairs:
            if not value < 1.0:
                return Outcome(guard.code)
        return Outcome.SUCCESS if np.all(np.isfinite(numbers)) else Outcome.NOT_FINITE

    def _iterate(
        self, parameters: FloatArray, state: FloatArray, u: FloatArray, carried: FloatArray
    ) -> tuple[list[FloatArray], FloatArray, FloatArray, tuple[int, float]]:
        """Outputs of the last iteration, unknowns, carried values; iterations, first e^2.

        No iterations: failed.
        """
        last, surprised = rule.BEFORE_FIRST, 0.0
        for iteration in range(rule.MAX_ITERATIONS):
            later = float(iteration > 0)
            outputs = [
                np.array(v).ravel() for v in self._step(parameters, state, u, carried, later)
            ]
            if u.size == 0:
                return outputs, u, carried, (0, surprised)
            with np.errstate(all="ignore"):
                scale = outputs[2][1] + rule.TINY
                now, left = (float(outputs[2][k] / scale) for k in (0, 2))
            surprised = now if iteration == 0 else surprised
            u, carried = u - outputs[0], outputs[1]
            if rule.finished(now, last, left, self.program.quadratic, iteration):
                return outputs, u, carried, (iteration + 1, surprised)
            last = now
        return outputs, u, carried, (0, surprised)
