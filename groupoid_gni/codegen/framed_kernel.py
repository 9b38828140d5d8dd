"""The loop over stages for large programs: the same skeleton, with everything in memory.

State, unknowns and what parts hand to one another live in a frame; the skeleton moves them in loops
and block copies, so that its own code does not grow with the system.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby

from groupoid_gni.codegen import newton_rule as rule
from groupoid_gni.codegen.frame_parts import Frame, FramedTape
from groupoid_gni.codegen.step_kernel import (
    ARROWS,
    CARRIED,
    CONSTANT,
    FINITE,
    GUARDS,
    ITERATED,
    MEASURE,
    NEXT,
    PARAMETER,
    STATE,
    UPDATE,
    StepKernel,
    Verdict,
    finish_function,
    module_text,
)
from groupoid_gni.codegen.tape import Tape
from groupoid_gni.codegen.warm_start import extrapolation_weights
from groupoid_gni.discretization.step_program import StepProgram

_COPY = "declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"
_MOVE = "declare void @llvm.memmove.p0.p0.i64(ptr, ptr, i64, i1)"


class FramedKernel(StepKernel):
    """``advance`` as ``StepKernel`` makes it, for programs of many thousand operations."""

    def __init__(self, program: StepProgram, tape: Tape, lanes: int, fused: bool) -> None:
        super().__init__(program, tape, lanes, fused)
        self.frame = Frame(lanes, fused)
        sizes = {
            "parameters": program.parameters.numel(),
            "state": self.state_size + program.given.numel(),
            "unknowns": self.unknown_size,
            "carried": program.carried.numel(),
            "later": 1,
            "update": self.unknown_size,
            "next carried": program.carried.numel(),
            "measure": 3,
            "next": self.state_size,
            "arrows": program.arrow_velocities.numel(),
            "guards": len(program.guards),
            "finite": program.finite.numel(),
            "new": self.unknown_size,
            "finish": self.state_size + program.given.numel(),
        }
        self.sizes = sizes
        self.region = {name: self.frame.reserve(size) for name, size in sizes.items()}
        inputs = ("parameters", "state", "unknowns", "carried", "later")
        places = {number: self.region[name] for number, name in enumerate(inputs)}
        outputs = ("update", "next carried", "measure", "next", "arrows", "guards", "finite")
        wanted = {number: self.region[name] for number, name in enumerate(outputs)}
        self.framed = FramedTape(self.tape, self.frame, places, wanted, self._homes())
        self._loops = 0

    def text(self) -> str:
        """The whole module."""
        e = self.e
        e.declarations |= {_COPY, _MOVE}
        self._entry()
        self._head()
        if self.unknown_size:
            self._newton_in_memory()
        self._advance_in_memory()
        e.label("leave")
        e.line("ret i64 %k")
        head = self._signature()
        room = f"  %frame = alloca [{self.frame.size} x {e.type}], align 64"
        body = [line for entry in e.lines for line in self.phis.get(entry, [entry])]
        e.declarations |= self.frame.declarations
        functions = [line for text in self.frame.functions for line in text.split("\n")]
        rooms = [room, self._errors(), *self._filled_pool()]
        return module_text(e, [*self._tables(), *functions, head, "entry:", *rooms, *body, "}"])

    def _homes(self) -> dict[int, list[float]]:
        """Relative places of the entries of state and unknowns, each part from 0 to 1."""
        state = [0.0] * self.sizes["state"]
        for part in self.program.layout.slices.values():
            for k in range(part.start, part.stop):
                state[k] = (k - part.start + 1) / (part.stop - part.start)
        n, c = self.unknown_size, self.sizes["carried"]
        return {
            1: state,
            2: [(k + 1) / n for k in range(n)],
            3: [(k + 1) / c for k in range(c)],
        }

    # Moving memory.

    def _at(self, base: str, index: int | str) -> str:
        return self.e.assign(f"getelementptr {self.e.type}, ptr {base}, i64 {index}")

    def _place(self, name: str) -> str:
        return self._at("%frame", self.region[name])

    def _copy(self, target: str, source: str, count: int, kind: str = "memcpy") -> None:
        if count:
            size = 8 * self.e.lanes * count
            self.e.line(
                f"call void @llvm.{kind}.p0.p0.i64(ptr {target}, ptr {source}, i64 {size}, "
                "i1 false)"
            )

    def _get(self, base: str, index: int | str) -> str:
        return self.e.assign(f"load {self.e.type}, ptr {self._at(base, index)}, align 8")

    def _put(self, value: str, base: str, index: int | str) -> None:
        self.e.line(f"store {self.e.type} {value}, ptr {self._at(base, index)}, align 8")

    def _loop(self, count: int, body: Callable[[str], None]) -> None:
        """``for index in 0 ... count - 1 { body }``; the body opens no block."""

        def once(index: str, values: list[str]) -> list[str]:
            body(index)
            return values

        if count:
            self._fold(count, "", [], once)

    def _fold(
        self,
        count: int,
        kind: str,
        starts: Sequence[str],
        body: Callable[[str, list[str]], Sequence[str]],
    ) -> list[str]:
        """Values of one kind after ``values = body(index, values)`` for all indices; count > 0."""
        e, self._loops = self.e, self._loops + 1
        k, name, before = self._loops, f"loop{self._loops}", e.block
        e.line(f"br label %{name}")
        e.label(name)
        self._place_phis(name)
        index, following = f"%i{k}", f"%n{k}"
        values = [f"%p{k}_{i}" for i in range(len(starts))]
        after = body(index, values)
        e.line(f"{following} = add i64 {index}, 1")
        self._phi(name, index, "i64", ("0", before), (following, name))
        for value, start, last in zip(values, starts, after, strict=True):
            self._phi(name, value, kind, (start, before), (last, name))
        more = e.assign(f"icmp slt i64 {following}, {count}")
        e.line(f"br i1 {more}, label %{name}, label %{name}end")
        e.label(f"{name}end")
        return list(after)

    def _calls(self, calls: Iterable[str]) -> None:
        for call in calls:
            self.e.line(call)

    def _compute(self, outputs: list[int], levels: Iterable[int]) -> None:
        self._calls(self.framed.compute(self.tape.needed(outputs), levels))

    # The skeleton.

    def _entry(self) -> None:
        self._copy(self._place("parameters"), "%parameters", self.sizes["parameters"])
        self._compute(list(range(7)), [CONSTANT, PARAMETER])
        self._start_counters()

    def _head(self) -> None:
        e = self.e
        e.label("head")
        self._place_phis("head")
        e.line("%more = icmp slt i64 %k, %count")
        e.line("br i1 %more, label %step, label %leave")
        e.label("step")
        self._copy(self._place("state"), "%state", self.state_size)
        self.given = self._given()
        for k, name in enumerate(self.given):
            self._put(name, "%frame", self.region["state"] + self.state_size + k)

    def _newton_in_memory(self) -> None:
        e, n = self.e, self.unknown_size
        self._compute([UPDATE, CARRIED, MEASURE], [STATE])
        self._extrapolate_in_memory()
        kept = self._at("%memory", self.history * n)
        self._copy(self._place("carried"), kept, self.sizes["carried"])
        self._put(e.constant(0.0), "%frame", self.region["later"])
        total = self._get("%memory", self.memory_size - 1)
        step_end = e.block
        e.line("br label %newton")
        e.label("newton")
        self._place_phis("newton")
        self._compute([UPDATE, CARRIED, MEASURE], ITERATED)
        for output in (UPDATE, CARRIED, MEASURE):
            self._calls(self.framed.output(output))
        measure = [self._get("%frame", self.region["measure"] + k) for k in range(3)]
        error, counted, busy = self.measured(*measure)
        self._put(error, "%errors", "%j")
        unknowns, update, new = (self._place(k) for k in ("unknowns", "update", "new"))
        self._loop(n, lambda i: self._put(
            e.binary("fsub", self._get(unknowns, i), self._get(update, i)), new, i
        ))
        self._branch_after_iteration(busy, "again")
        e.label("again")
        self._continue(busy)
        again_end = e.block
        e.line("br label %newton")
        before = e.constant(rule.BEFORE_FIRST)
        self._phi("newton", "%t", e.type, (before, step_end), (error, again_end))
        self._phi("newton", "%total", e.type, (total, step_end), (counted, again_end))
        self._phi("newton", "%j", "i64", ("0", step_end), ("%j1", again_end))
        if e.lanes > 1:
            self._phi("newton", "%busy", e.flag_type, ("%alive", step_end), (busy, again_end))
        e.label("settled")
        self.converged: str | None = self._not(busy)
        self.total = counted
        self.settled_energy = measure[1]

    def _extrapolate_in_memory(self) -> None:
        e, n = self.e, self.unknown_size
        if self.program.stages == 1:
            (row,) = extrapolation_weights(self.program.fractions)
            weights = [e.constant(w) for w in row]
        else:
            weights = [self._by_stage(f"weights{age}") for age in range(self.history)]
        ages = [self._at("%memory", age * n) for age in range(self.history)]
        unknowns = self._place("unknowns")

        def guess(i: str) -> None:
            value = e.binary("fmul", self._get(ages[0], i), weights[0])
            for age, weight in zip(ages[1:], weights[1:], strict=True):
                value = e.multiply_add(self._get(age, i), weight, value)
            self._put(value, unknowns, i)

        self._loop(n, guess)

    def _continue(self, busy: str) -> None:
        """New unknowns and carried values into place; a lane that is done keeps its old ones."""
        e = self.e
        for source, target in (("new", "unknowns"), ("next carried", "carried")):
            count = self.sizes[target]
            if e.lanes == 1:
                self._copy(self._place(target), self._place(source), count)
                continue
            here, there = self._place(source), self._place(target)
            self._keep_where(busy, here, there, there, count)
        later = e.constant(1.0)
        if e.lanes > 1:
            later = e.select(busy, later, self._get("%frame", self.region["later"]))
        self._put(later, "%frame", self.region["later"])

    def _keep_where(self, flag: str, first: str, second: str, target: str, count: int) -> None:
        """``target = flag ? first : second``, entry by entry."""
        e = self.e
        self._loop(count, lambda i: self._put(
            e.select(flag, self._get(first, i), self._get(second, i)), target, i
        ))

    def _advance_in_memory(self) -> None:
        e = self.e
        if not self.unknown_size:
            self.converged, self.total = None, self._get("%memory", self.memory_size - 1)
        self._compute([NEXT, ARROWS, GUARDS, FINITE], [STATE, *ITERATED])
        for output in (NEXT, ARROWS, GUARDS, FINITE):
            self._calls(self.framed.output(output))
        good, code = self._verdict()
        if e.lanes == 1:
            e.line(f"br i1 {good}, label %next, label %failed")
            e.label("failed")
            e.line(f"store i64 {code}, ptr %status")
            e.line("br label %leave")
        else:
            self._bury(good, code)
            e.line("br label %next")
        e.label("next")
        self._accept()
        if self.program.finish is not None:
            self._finish_in_memory()
        self._save_from_memory()
        e.line("br label %head")
        self._close_counters()

    def _verdict(self) -> tuple[str, str]:
        """``_judged`` on the sum of what must be finite and on the guards, read from memory."""
        e = self.e
        total = e.constant(0.0)
        slices = [self.program.layout.slices.get(k) for k in ("base", "after", "reconstructed")]
        stretches = [("next", s.start, s.stop - s.start) for s in slices if s is not None]
        stretches.append(("finite", 0, self.sizes["finite"]))
        for name, begin, count in stretches:
            total = self._summed(total, self._at("%frame", self.region[name] + begin), count)
        return self.judged(total, self._verdicts(), self.converged)

    def _verdicts(self) -> list[Verdict]:
        """Neighbouring guards of one kind are looked at in one loop."""
        found, begin = [], 0
        for (code, decisive), alike in groupby(
            self.program.guards, lambda guard: (guard.code, guard.decisive)
        ):
            count = len(list(alike))
            base = self._at("%frame", self.region["guards"] + begin)
            found.append(self._verdict_of(code, decisive, base, count))
            begin += count
        return found

    def _verdict_of(self, code: int, decisive: bool, base: str, count: int) -> Verdict:
        e, one = self.e, self.e.constant(1.0)

        def look(index: str, flags: list[str]) -> list[str]:
            value = self._get(base, index)
            below, above = e.compare("olt", value, one), e.compare("oge", value, one)
            return [
                e.assign(f"and {e.flag_type} {flags[0]}, {below}"),
                e.assign(f"or {e.flag_type} {flags[1]}, {above}"),
            ]

        starts = [self._flag("true"), self._flag("false")]
        fine, crossed = self._fold(count, e.flag_type, starts, look)
        return Verdict(code, fine, crossed if decisive else None)

    def _summed(self, start: str, base: str, count: int) -> str:
        """start plus all entries of a stretch, in four sums that do not wait for one another."""
        e, quarter = self.e, count // 4
        total = start
        for k in range(4 * quarter, count):
            total = e.binary("fadd", total, self._get(base, k))
        if not quarter:
            return total
        stretches = [self._at(base, part * quarter) for part in range(4)]

        def add(index: str, sums: list[str]) -> list[str]:
            return [
                e.binary("fadd", old, self._get(stretch, index))
                for old, stretch in zip(sums, stretches, strict=True)
            ]

        for part in self._fold(quarter, e.type, [e.constant(0.0)] * 4, add):
            total = e.binary("fadd", total, part)
        return total

    def _accept(self) -> None:
        """The new state and memory become the current ones; dead lanes keep their state."""
        n = self.unknown_size
        if self.e.lanes == 1:
            self._copy("%state", self._place("next"), self.state_size)
        else:
            self._keep_where(
                "%alive1", self._place("next"), "%state", "%state", self.state_size
            )
        if n:
            older = self._at("%memory", n)
            self._copy(older, "%memory", (self.history - 1) * n, "memmove")
            self._copy("%memory", self._place("new"), n)
            kept = self._at("%memory", self.history * n)
            self._copy(kept, self._place("next carried"), self.sizes["carried"])
            self._note()
            self._put(self.total, "%memory", self.memory_size - 1)

    def _finish_in_memory(self) -> None:
        e, program = self.e, self.program
        last = e.assign(f"icmp eq i64 %stage, {program.stages - 1}")
        e.line(f"br i1 {last}, label %finish, label %kept")
        e.label("finish")
        self._copy(self._place("finish"), "%state", self.state_size)
        for k, name in enumerate(self.given):
            self._put(name, "%frame", self.region["finish"] + self.state_size + k)
        tape = Tape.of(finish_function(program, program.finish)).optimised()  # type: ignore[arg-type]
        places = {0: self.region["parameters"], 1: self.region["finish"]}
        wanted = {0: self.region["next"]}
        framed = FramedTape(tape, self.frame, places, wanted, {1: self._homes()[1]})
        self._calls(framed.compute(tape.needed([0]), [CONSTANT, PARAMETER, STATE]))
        self._calls(framed.output(0))
        if e.lanes == 1:
            self._copy("%state", self._place("next"), self.state_size)
        else:
            self._keep_where(
                "%alive1", self._place("next"), "%state", "%state", self.state_size
            )
        e.line("br label %kept")
        e.label("kept")

    def _save_from_memory(self) -> None:
        arrows = self.sizes["arrows"]

        def write() -> None:
            self._copy("%row", "%state", self.state_size)
            self._copy(self._at("%row", self.state_size), self._place("arrows"), arrows)
            self._put(self.total, "%row", self.state_size + arrows)

        self._save_when_due(write, self.state_size + arrows + 1)
