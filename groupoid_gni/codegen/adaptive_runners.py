"""Two ways to run the adaptive loop: machine code, and the same algorithm in NumPy.

Both work on the same arrays (see ``adaptive_kernel``), so one may go on where the other stopped.
"""

from __future__ import annotations

import ctypes
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import adaptive_kernel as rule
from groupoid_gni.codegen import dop853_coefficients as table
from groupoid_gni.codegen.adaptive_kernel import Count, FlowLayout, Number, Vector
from groupoid_gni.codegen.machine import MachineCode, machine_has_fused_products


@dataclass(frozen=True)
class FlowProgress:
    """Where an adaptive run stands; the arrays are changed in place.

    memory : see ``adaptive_kernel``.  rows : (nodes + 1, n + 1), row 0 the start; the last column
    is left as it is.
    """

    layout: FlowLayout
    memory: FloatArray
    rows: FloatArray

    @cached_property
    def counts(self) -> np.ndarray:
        """The whole numbers of the memory; a view."""
        return self.memory[: Number.TIME].view(np.int64)

    @property
    def filled(self) -> int:
        """How many rows hold a node."""
        return int(self.counts[Count.NODE])

    @property
    def time(self) -> float:
        """Time of the last accepted step."""
        return float(self.memory[Number.TIME])

    @property
    def state(self) -> FloatArray:
        """State after the last accepted step, (n,); a view."""
        return self.memory[self.layout.vector(Vector.STATE)]

    @property
    def rate(self) -> FloatArray:
        """Rate of change of the state, (n,); a view."""
        return self.memory[self.layout.vector(Vector.RATE)]

    @property
    def seconds(self) -> float:
        """Time spent in the loop."""
        return float(self.memory[Number.SECONDS])

    @property
    def evaluations(self) -> int:
        """How often the rate was evaluated."""
        return int(self.counts[Count.EVALUATIONS])

    @property
    def accepted(self) -> int:
        """Steps made."""
        return int(self.counts[Count.ACCEPTED])

    @property
    def rejected(self) -> int:
        """Steps tried in vain."""
        return int(self.counts[Count.REJECTED])

    def aim(self, parameters: FloatArray, step: int) -> None:
        """Go on to another last step number, with other parameters, from where it stands."""
        counts = self.counts
        every, done = counts[Count.EVERY], 0 if self.time == 0.0 else counts[Count.STEPS]
        counts[Count.NODE] = done // every + 1
        counts[Count.STEPS], counts[Count.NODES] = step, -(-step // every)
        self.memory[self.layout.parameter_slice] = parameters
        self.memory[Number.STEP] = 0.0

    def copy(self) -> FlowProgress:
        """An independent copy."""
        return FlowProgress(self.layout, self.memory.copy(), self.rows.copy())


@dataclass(frozen=True)
class FlowRunner(ABC):
    """Runs DOP853 on one function (parameters, y) -> (y', y put back on its manifold)."""

    function: ca.Function

    @cached_property
    def layout(self) -> FlowLayout:
        """Where things lie in the memory of a progress."""
        return FlowLayout.of(self.function)

    def begin(
        self,
        parameters: FloatArray,
        start: FloatArray,
        tolerances: tuple[float, float],
        h: float,
        count: int,
        every: int,
        caution: float = 1.0,
    ) -> FlowProgress:
        """Progress at time 0, for nodes at ``k every h`` and at ``count h``.

        start : (n,).  tolerances : rtol, and atol in the units of the function.
        caution : what the first step is multiplied with.
        """
        layout = self.layout
        nodes = -(-count // every)
        memory = np.zeros(layout.total)
        memory[Number.NODE_STEP], memory[Number.CAUTION] = h, caution
        memory[Number.RTOL], memory[Number.ATOL] = tolerances
        memory[layout.vector(Vector.STATE)] = start
        memory[layout.parameter_slice] = parameters
        rows = np.zeros((nodes + 1, layout.size + 1))
        rows[0, :-1] = start
        progress = FlowProgress(layout, memory, rows)
        progress.counts[Count.NODE : Count.STEPS + 1] = 1, nodes, every, count
        return progress

    def advance(self, progress: FlowProgress, attempts: int) -> int:
        """Try up to ``attempts`` steps, in place; the time it takes is added to ``seconds``.

        Returns 0 while there is more to do, 1 at the end, -1 when the step size has underflowed.
        """
        loop, place = self._bound(progress)
        began = time.perf_counter()
        status = loop(*place, attempts)
        progress.memory[Number.SECONDS] += time.perf_counter() - began
        return int(status)

    @abstractmethod
    def _bound(self, progress: FlowProgress) -> tuple[Callable[..., int], tuple[Any, ...]]:
        """The loop, and what it is called with before the number of attempts."""


@dataclass(frozen=True)
class CompiledFlow(FlowRunner):
    """The loop as machine code."""

    code: MachineCode = field(default=None)  # type: ignore[assignment]

    @classmethod
    def of(cls, function: ca.Function) -> CompiledFlow:
        """Emit and compile."""
        layout = FlowLayout.of(function)
        ir = rule.adaptive_kernel_ir(function, machine_has_fused_products(), layout)
        return cls(function, MachineCode(ir))

    @cached_property
    def _loop(self) -> Any:
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        return self.code.function("advance", pointer, pointer, integer, returns=integer)

    def _bound(self, progress: FlowProgress) -> tuple[Callable[..., int], tuple[Any, ...]]:
        return self._loop, (progress.memory.ctypes.data, progress.rows.ctypes.data)


@dataclass(frozen=True)
class InterpretedFlow(FlowRunner):
    """The same algorithm in NumPy, the field through CasADi's evaluator."""

    def _rate(self, p: FlowProgress, y: FloatArray) -> FloatArray:
        return self._evaluate(p, y)[0]

    def _restored(self, p: FlowProgress, y: FloatArray) -> FloatArray:
        return self._evaluate(p, y)[1]

    def _evaluate(self, p: FlowProgress, y: FloatArray) -> list[FloatArray]:
        outputs = self.function(p.memory[p.layout.parameter_slice], y)
        return [np.array(output).ravel() for output in outputs]

    def _bound(self, progress: FlowProgress) -> tuple[Callable[..., int], tuple[Any, ...]]:
        return self._loop, (progress,)

    def _loop(self, progress: FlowProgress, attempts: int) -> int:
        status = 0
        with np.errstate(all="ignore"):
            if progress.memory[Number.STEP] == 0.0:
                self._first_step(progress)
            while attempts > 0 and status == 0:
                attempts -= 1
                status = self._attempt(progress)
        progress.counts[Count.STATUS] = status
        return status

    def _first_step(self, p: FlowProgress) -> None:
        """The first rate and the first step size (section II.4 of the reference)."""
        y, end = p.state, p.counts[Count.STEPS] * p.memory[Number.NODE_STEP]
        tolerance = p.memory[Number.ATOL] * self._evaluate(p, y)[2]
        p.memory[p.layout.vector(Vector.TOLERANCE)] = tolerance
        scale = self._scale(p, y)
        f = self._rate(p, y)
        size, speed = (np.sqrt(np.mean((a / scale) ** 2)) for a in (y, f))
        small = size < 1e-5 or speed < 1e-5
        h0 = min(1e-6 if small else rule.FIRST_STEP * size / speed, abs(end))
        change = self._rate(p, y + np.copysign(h0, end) * f) - f
        fastest = max(speed, float(np.sqrt(np.mean((change / scale) ** 2))) / h0)
        slow = max(1e-6, 1e-3 * h0)
        h1 = slow if fastest <= 1e-15 else (rule.FIRST_STEP / fastest) ** 0.125
        p.memory[Number.STEP] = min(100 * h0, h1, abs(end)) * p.memory[Number.CAUTION]
        p.rate[:] = f
        p.counts[Count.EVALUATIONS] += 2

    def _scale(self, p: FlowProgress, *states: FloatArray) -> FloatArray:
        largest = np.max(np.abs(states), axis=0)
        tolerance = p.memory[p.layout.vector(Vector.TOLERANCE)]
        return np.asarray(tolerance + p.memory[Number.RTOL] * largest)

    def _attempt(self, p: FlowProgress) -> int:
        """One step, accepted or not; the status after it."""
        memory, counts = p.memory, p.counts
        now, low, wanted, node_step = memory[Number.TIME : Number.NODE_STEP + 1]
        if not wanted >= rule.SMALLEST_STEP * abs(now) + rule.TINY:
            return -1
        end = counts[Count.STEPS] * node_step
        left = abs(end - now - low)
        ends = left <= 1.01 * wanted
        size = left if ends else wanted
        h = np.copysign(size, node_step)
        y = p.state.copy()
        k = [p.rate.copy()]
        for weights in table.STAGES[1:]:
            k.append(self._rate(p, y + h * _combination(weights, k)))
        new = y + h * _combination(table.STEP, k)
        factor, good = self._error_control(p, k, y, new, size)
        counts[Count.EVALUATIONS] += len(table.STAGES) - 1
        following = now + (h + low)
        ahead = (end, 0.0) if ends else (following, (h + low) - (following - now))
        if good:
            new = self._restored(p, new)
            k.append(self._rate(p, new))
            counts[Count.EVALUATIONS] += 1
            good = self._nodes(p, k, (y, new), (now + low, ahead[0], h))
            factor = factor if good else rule.SMALLEST_FACTOR
        counts[Count.ACCEPTED if good else Count.REJECTED] += 1
        if good and counts[Count.REJECTED_LAST]:
            factor = min(factor, 1.0)
        counts[Count.REJECTED_LAST] = not good
        memory[Number.STEP] = size * factor
        if not good:
            return 0
        p.state[:], p.rate[:] = new, k[12]
        memory[Number.TIME], memory[Number.TIME_LOW] = ahead
        if ends:
            p.rows[counts[Count.NODES], :-1] = new
            counts[Count.NODE] = counts[Count.NODES] + 1
        return int(ends)

    def _error_control(
        self, p: FlowProgress, k: list[FloatArray], y: FloatArray, new: FloatArray, size: float
    ) -> tuple[float, bool]:
        """Factor of the next step size, and whether the step is good."""
        scale = self._scale(p, y, new)
        slope = _combination(table.STEP, k)
        fifth = _combination(table.FIFTH, k)
        third = slope - _combination(table.THIRD, k)
        five, three = (np.sum((a / scale) ** 2) for a in (fifth, third))
        both = (five + 0.01 * three) * len(y) + rule.TINY
        moved = (size * five) ** 2
        finite = bool(np.all(np.isfinite(new)))
        factor = rule.SAFETY * _inverse_root(moved, both) if finite else 0.0
        # a comparison with NaN is false: the smallest factor
        factor = factor if factor > rule.SMALLEST_FACTOR else rule.SMALLEST_FACTOR
        return min(factor, rule.LARGEST_FACTOR), bool(moved <= both) and finite

    def _nodes(
        self,
        p: FlowProgress,
        k: list[FloatArray],
        ends: tuple[FloatArray, FloatArray],
        step: tuple[float, float, float],
    ) -> bool:
        """Rows of the nodes inside the step, the last one left out; false if they are not finite.

        ends : states before and after the step.  step : times of both, and the size.
        """
        counts, (begin, end, h) = p.counts, step
        node_step = p.memory[Number.NODE_STEP]
        polynomial: list[FloatArray] = []
        while (j := counts[Count.NODE]) < counts[Count.NODES]:
            t = (j * counts[Count.EVERY]) * node_step
            if (t - end) * np.sign(h) > 0.0:
                break
            polynomial = polynomial or self._dense(p, k, ends, h)
            if not np.all(np.isfinite(polynomial)):
                return False
            x = (t - begin) / h
            value = polynomial[-1]
            for i in range(len(polynomial) - 1, 0, -1):
                value = value * (x, 1.0 - x)[i % 2] + polynomial[i - 1]
            p.rows[j, :-1] = self._restored(p, ends[0] + x * value)
            counts[Count.NODE] += 1
        return True

    def _dense(
        self, p: FlowProgress, k: list[FloatArray], ends: tuple[FloatArray, FloatArray], h: float
    ) -> list[FloatArray]:
        """Coefficients of the interpolation (section II.6), lowest first."""
        k = list(k)
        for weights in table.EXTRA_STAGES:
            k.append(self._rate(p, ends[0] + h * _combination(weights, k)))
        p.counts[Count.EVALUATIONS] += len(table.EXTRA_STAGES)
        change = ends[1] - ends[0]
        lowest = [change, h * k[0] - change, 2.0 * change - h * (k[0] + k[12])]
        return lowest + [h * _combination(weights, k) for weights in table.DENSE]


def _inverse_root(a: np.float64, b: np.float64) -> float:
    """``(b / a)^(1/16)`` to one percent, as the machine code computes it."""
    bits = (b.view(np.int64) - a.view(np.int64) >> 4) + rule.ROOT_BITS
    guess = np.int64(bits).view(np.float64)
    return float(guess / 16.0 * (17.0 - a / b * guess**16))


def _combination(weights: table.Weights, k: list[FloatArray]) -> FloatArray:
    return np.sum([w * k[j] for j, w in weights.items()], axis=0)
