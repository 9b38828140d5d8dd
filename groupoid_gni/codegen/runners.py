"""Two ways to run a step program: machine code, and CasADi's evaluator as a second opinion.

Both keep the same state (flat state, three sets of unknowns, Newton count, absolute step number),
so a run may be cut into chunks anywhere without changing a bit.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import newton_rule as rule
from groupoid_gni.codegen.machine import MachineCode, machine_has_fused_products
from groupoid_gni.codegen.step_kernel import field_ir, step_function, step_kernel_ir
from groupoid_gni.discretization.step_program import StepProgram
from groupoid_gni.outcomes import Outcome


@dataclass(frozen=True)
class Progress:
    """Where a run stands: everything needed to go on, bit for bit. Never changed in place.

    state : (n,).  memory : (3 * unknowns + 1,), the unknowns of the last three steps and the
    running Newton count.  step : number of steps done.
    """

    state: FloatArray
    memory: FloatArray
    step: int = 0


@dataclass(frozen=True)
class StepRunner(ABC):
    """Runs the steps of one program."""

    program: StepProgram

    @abstractmethod
    def advance(
        self, parameters: FloatArray, progress: Progress, count: int, every: int
    ) -> tuple[Progress, FloatArray, Outcome]:
        """Do up to ``count`` steps; return where it stands, the saved rows and how it went.

        Rows hold state, arrow velocities and Newton count of the steps whose absolute number is a
        multiple of ``every``. On failure the new progress is the last good step.
        """

    @cached_property
    def _first_guess(self) -> ca.Function:
        p = self.program
        return ca.Function("first_guess", [p.parameters, p.state], [p.first_guess])

    @cached_property
    def _newton_system(self) -> ca.Function:
        p = self.program
        jacobian = ca.densify(ca.jacobian(p.residual, p.unknowns))
        return ca.Function(
            "newton_system",
            [p.parameters, p.state, p.unknowns],
            ca.cse([p.residual, jacobian, p.scale]),
        )

    def begin(self, parameters: FloatArray, state: FloatArray) -> Progress:
        """Progress at step 0, warm start included."""
        return self.with_guess(
            Progress(np.array(state), np.zeros(1)), self.guess(parameters, state)
        )

    def guess(self, parameters: FloatArray, state: FloatArray) -> FloatArray:
        """Unknowns of the next step estimated from the state alone."""
        return np.array(self._first_guess(parameters, state)).ravel()

    def with_guess(self, progress: Progress, guess: FloatArray) -> Progress:
        """The same progress with the warm start replaced."""
        memory = np.concatenate([np.tile(guess, 3), progress.memory[-1:]])
        return Progress(progress.state, memory, progress.step)

    def solve_carefully(self, parameters: FloatArray, progress: Progress) -> FloatArray | None:
        """Newton with pivoting and damping for the next step, used when the fast one has failed.

        Returns the unknowns, or None.
        """
        u = self.guess(parameters, progress.state)
        with np.errstate(all="ignore"):
            for _ in range(100):
                residual, jacobian, _ = (
                    np.asarray(v) for v in self._newton_system(parameters, progress.state, u)
                )
                if not (np.all(np.isfinite(residual)) and np.all(np.isfinite(jacobian))):
                    return None
                try:
                    update = np.linalg.solve(jacobian, residual.ravel())
                except np.linalg.LinAlgError:
                    return None
                u = u - self._damping(parameters, progress, u, update, residual) * update
                if np.max(np.abs(update)) <= 1e-12 * (np.max(np.abs(u)) + 1e-300):
                    return u
        return None

    def _damping(
        self,
        parameters: FloatArray,
        progress: Progress,
        u: FloatArray,
        update: FloatArray,
        residual: FloatArray,
    ) -> float:
        before = float(np.linalg.norm(residual))
        for factor in (1.0, 0.5, 0.25, 0.125, 0.0625):
            trial = self._newton_system(parameters, progress.state, u - factor * update)[0]
            if float(np.linalg.norm(np.asarray(trial))) < before:
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
        return self.code.function(
            "advance", *[pointer] * 5, integer, integer, integer, returns=integer
        )

    def advance(
        self, parameters: FloatArray, progress: Progress, count: int, every: int
    ) -> tuple[Progress, FloatArray, Outcome]:
        """See the base class."""
        first = progress.step
        rows = np.empty(((first + count) // every - first // every, self.program.row_size))
        status = np.zeros(2, dtype=np.int64)
        state, memory = progress.state.copy(), progress.memory.copy()
        arrays = (parameters, state, memory, rows, status)
        done = self._advance(*[a.ctypes.data for a in arrays], first, count, every)
        kept = rows[: (first + done) // every - first // every]
        return Progress(state, memory, first + done), kept, Outcome(int(status[0]))


@dataclass(frozen=True)
class InterpretedStep(StepRunner):
    """The same expressions through CasADi's evaluator: slow, and independent of our emitter."""

    @cached_property
    def _step(self) -> ca.Function:
        return step_function(self.program)

    def advance(
        self, parameters: FloatArray, progress: Progress, count: int, every: int
    ) -> tuple[Progress, FloatArray, Outcome]:
        """See the base class."""
        rows = []
        outcome = Outcome.SUCCESS
        for _ in range(count):
            outcome, following, arrows = self._one_step(parameters, progress)
            if outcome is not Outcome.SUCCESS:
                break
            progress = following
            if progress.step % every == 0:
                rows.append(np.concatenate([progress.state, arrows, progress.memory[-1:]]))
        return progress, np.array(rows).reshape(-1, self.program.row_size), outcome

    def _one_step(
        self, parameters: FloatArray, progress: Progress
    ) -> tuple[Outcome, Progress, FloatArray]:
        n = self.program.unknowns.numel()
        memory = progress.memory
        u = 3.0 * (memory[:n] - memory[n : 2 * n]) + memory[2 * n : 3 * n]
        u, iterations, converged = self._newton(parameters, progress.state, u)
        outputs = [np.asarray(v).ravel() for v in self._step(parameters, progress.state, u)]
        _, _, following, arrows, guards = outputs
        if not converged:
            return Outcome.NEWTON_FAILED, progress, arrows
        for value, guard in zip(guards, self.program.guards, strict=True):
            if not value < 1.0:
                return Outcome(guard.code), progress, arrows
        if not np.all(np.isfinite(following)):
            return Outcome.NOT_FINITE, progress, arrows
        memory = np.concatenate([u, memory[: 2 * n], memory[-1:] + iterations])
        return Outcome.SUCCESS, Progress(following, memory, progress.step + 1), arrows

    def _newton(
        self, parameters: FloatArray, state: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, int, bool]:
        if u.size == 0:
            return u, 0, True
        last = rule.BEFORE_FIRST
        for iteration in range(1, rule.MAX_ITERATIONS + 1):
            update, measure = (np.asarray(v).ravel() for v in self._step(parameters, state, u)[:2])
            now = float(measure[0] / (measure[1] + rule.TINY))
            u = u - update
            if rule.finished(now, last):
                return u, iteration, True
            last = now
        return u, rule.MAX_ITERATIONS, False


def compile_field(function: ca.Function) -> Any:
    """A CasADi function of two columns as a fast Python callable (a, b) -> output column."""
    code = MachineCode(field_ir(function, lanes=1, fused=machine_has_fused_products()))
    pointer = ctypes.c_void_p
    evaluate = code.function("evaluate", pointer, pointer, pointer)
    size = function.numel_out(0)

    def call(first: FloatArray, second: FloatArray) -> FloatArray:
        a, b, output = np.ascontiguousarray(first), np.ascontiguousarray(second), np.empty(size)
        evaluate(a.ctypes.data, b.ctypes.data, output.ctypes.data)
        return output

    call.code = code  # type: ignore[attr-defined]
    return call
