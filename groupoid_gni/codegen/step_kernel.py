"""The loop over stages as one LLVM function with a fixed skeleton.

    for stage { guess; while not converged { newton }; advance; check; store every n-th }

A step is one stage or, in a composition, one after the other. Operations that depend only on
parameters are computed before the loop, those that depend only on the state before the Newton
iteration. Written for any number of lanes W; lanes that have converged or failed are frozen, so
every lane computes what it would compute alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from groupoid_gni.codegen import newton_rule as rule
from groupoid_gni.codegen import surprise
from groupoid_gni.codegen.elementary import sine_cosine_function
from groupoid_gni.codegen.emitter import Emitter, Values, double_text
from groupoid_gni.codegen.machine import LARGE_PROGRAM
from groupoid_gni.codegen.tape import Operation, Tape
from groupoid_gni.codegen.warm_start import extrapolation_weights, watched_stage
from groupoid_gni.discretization.step_program import StepProgram
from groupoid_gni.outcomes import Outcome

UPDATE, CARRIED, MEASURE, NEXT, ARROWS, GUARDS, FINITE = range(7)
"""Outputs of ``step_function``, by number."""
CONSTANT, PARAMETER, STATE = range(3)
ITERATED = (3, 4, 5)
"""Levels of a tape (see ``Tape``): before the loop, once a stage, in every iteration."""
FRAMED_PROGRAM = 3000
"""Operations of a stage above which it is cut into functions that share a frame."""
_BLOCK_LENGTH = 500


def step_function(program: StepProgram) -> ca.Function:
    """The program as one function, outputs dense.

    (parameters, (state, given), unknowns, carried, later) ->
    (update, next carried, (work, energy, left), next state, arrow velocities, guards, finite).
    """
    outputs = [
        program.update,
        program.next_carried,
        ca.vertcat(program.work, program.energy, program.left),
        program.next_state,
        program.arrow_velocities,
        ca.vertcat(*[guard.value for guard in program.guards]),
        program.finite,
    ]
    state = ca.vertcat(program.state, program.given)
    inputs = [program.parameters, state, program.unknowns, program.carried, program.later]
    return ca.Function("step", inputs, ca.cse([ca.densify(o) for o in outputs]))


def step_tape(program: StepProgram) -> Tape:
    """The operations of a stage, as the kernels take them."""
    return Tape.of(step_function(program)).optimised()


def finish_function(program: StepProgram, finish: ca.SX) -> ca.Function:
    """(parameters, (state after the last stage, given)) -> state at the end of a composed step."""
    inputs = [program.parameters, ca.vertcat(program.state, program.given)]
    return ca.Function("finish", inputs, [ca.cse(ca.densify(finish))])


def step_kernel_ir(program: StepProgram, lanes: int, fused: bool) -> str:
    """IR text of the module with ``@advance`` for this program."""
    tape = step_tape(program)
    if len(tape.operations) <= FRAMED_PROGRAM:
        return StepKernel(program, tape, lanes, fused).text()
    from groupoid_gni.codegen.framed_kernel import FramedKernel

    return FramedKernel(program, tape, lanes, fused).text()


def operations_by_place(program: StepProgram) -> dict[str, list[Operation]]:
    """The operations that the loop does, by how often: run, stage, iteration, step.

    run : before the loop.  stage : once in a stage, before or after the iteration.  iteration : in
    every iteration.  step : at the end of a composed step.
    """
    tape = step_tape(program)
    iterated = tape.needed([UPDATE, CARRIED, MEASURE])
    inside = {i for i in iterated if tape.levels[i] in ITERATED and program.unknowns.numel()}
    found: dict[str, list[Operation]] = {"run": [], "stage": [], "iteration": [], "step": []}
    for i in tape.needed(range(7)):
        place = "run" if tape.levels[i] <= PARAMETER else "stage"
        found["iteration" if i in inside else place].append(tape.operations[i])
    if program.finish is not None:
        end = Tape.of(finish_function(program, program.finish)).optimised()
        found["step"] = [end.operations[i] for i in end.needed([0])]
    return found


def field_ir(function: ca.Function, lanes: int, fused: bool) -> str:
    """IR text of a module with ``@evaluate(first input, second input, output)``."""
    tape = Tape.of(function).optimised()
    e = Emitter(lanes, fused, _block_length(tape))
    values = Values(tape, e)
    for number, pointer in enumerate(("%first", "%second")):
        size = function.numel_in(number)
        values.bind_input(number, [_load(e, pointer, i) for i in range(size)])
    values.emit(tape.needed([0]), range(6))
    for i, name in enumerate(values.output(0)):
        _store(e, name, "%output", str(i))
    e.line("ret void")
    head = "define void @evaluate(ptr %first, ptr %second, ptr %output) {"
    return module_text(e, [head, "entry:", *e.lines, "}"])


def module_text(e: Emitter, lines: list[str]) -> str:
    """A module with the elementary functions and declarations that its lines need."""
    elementary, declarations = sine_cosine_function(e.lanes, e.fused)
    used = "@gni_sincos" in "\n".join(lines)
    parts = [*(elementary if used else []), *lines]
    needed = e.declarations | (declarations if used else set())
    return "\n".join([*parts, *sorted(needed)]) + "\n"


def _block_length(tape: Tape) -> int:
    return _BLOCK_LENGTH if len(tape.operations) > LARGE_PROGRAM else 0


def _load(e: Emitter, pointer: str, index: int) -> str:
    address = e.assign(f"getelementptr {e.type}, ptr {pointer}, i64 {index}")
    return e.assign(f"load {e.type}, ptr {address}, align 8")


def _store(e: Emitter, value: str, pointer: str, index: str) -> None:
    address = e.assign(f"getelementptr {e.type}, ptr {pointer}, i64 {index}")
    e.line(f"store {e.type} {value}, ptr {address}, align 8")


@dataclass(frozen=True)
class Verdict:
    """Flags of one guard or several: all are below one; one is not (only of decisive guards)."""

    code: int
    fine: str
    crossed: str | None


class StepKernel:
    """Builds ``i64 @advance(parameters, state, memory, rows, status, first, count, every)``.

    ``first``, ``count`` and ``every`` count stages.
    parameters, state : W values per entry.  memory : the unknowns of the last stages, the carried
    values, the record of ``surprise``, the running count of Newton iterations.  rows : room for
    the saved nodes.
    status : one i64 per lane, the outcome code, then one per lane, the stage at which it failed.
    A program with control inputs takes one argument more, the inputs of all steps from the very
    first, W values per entry.
    Returns the stages done: one lane stops at its failure, several lanes always do ``count``
    stages, those that fail frozen.
    """

    def __init__(self, program: StepProgram, tape: Tape, lanes: int, fused: bool) -> None:
        self.program = program
        self.tape = tape
        self.e = Emitter(lanes, fused, _block_length(self.tape))
        self.e.pool = {}
        self.state_size = program.layout.size
        self.unknown_size = program.unknowns.numel()
        self.memory_size = program.memory_size
        self.history = program.history
        # the record stays in memory: it is read and written once a stage
        self.noted = range(self.memory_size - 1 - program.record_size, self.memory_size - 1)
        self.values = Values(self.tape, self.e)
        self.phis: dict[str, list[str]] = {}
        self.settled_energy = ""

    def text(self) -> str:
        """The whole module."""
        e = self.e
        self._entry()
        self._head()
        self._advance(*(self._newton() if self.unknown_size else self._no_newton()))
        self._leave()
        body = [line for entry in e.lines for line in self.phis.get(entry, [entry])]
        head = [*self._tables(), self._signature(), "entry:", self._errors()]
        return module_text(e, [*head, *self._filled_pool(), *body, "}"])

    def _filled_pool(self) -> list[str]:
        """The constants that operations read, stored once."""
        e, pool = self.e, self.e.pool or {}
        lines = [f"  %pool = alloca [{max(1, len(pool))} x {e.type}], align 64"]
        for value, place in pool.items():
            lines += [
                f"  %pool{place} = getelementptr {e.type}, ptr %pool, i64 {place}",
                f"  store {e.type} {e.constant(value)}, ptr %pool{place}, align 8",
            ]
        return lines

    def _errors(self) -> str:
        """Room for e^2 of every iteration of a stage."""
        return f"  %errors = alloca [{rule.MAX_ITERATIONS} x {self.e.type}]"

    @property
    def _in_registers(self) -> list[int]:
        """Places of the memory that are not in the record."""
        return [i for i in range(self.memory_size) if i not in self.noted]

    def _signature(self) -> str:
        controls = ", ptr %controls" if self.program.control_size else ""
        return (
            "define i64 @advance(ptr %parameters, ptr %state, ptr %memory, ptr %rows, "
            f"ptr %status, i64 %first, i64 %count, i64 %every{controls}) {{"
        )

    def _tables(self) -> list[str]:
        """Fractions and weights of the warm start by stage, for a composition."""
        if self.program.stages == 1:
            return []
        rows = {"fractions": self.program.fractions}
        weights = extrapolation_weights(self.program.fractions)
        for age in range(self.history if self.unknown_size else 0):
            rows[f"weights{age}"] = tuple(row[age] for row in weights)
        return [
            f"@{name} = internal constant [{len(values)} x double] ["
            + ", ".join(f"double {double_text(v)}" for v in values) + "]"
            for name, values in rows.items()
        ]

    def _by_stage(self, table: str) -> str:
        """The entry of a table that belongs to the current stage, in every lane."""
        e = self.e
        address = e.assign(f"getelementptr double, ptr @{table}, i64 %stage")
        return e.splat(e.assign(f"load double, ptr {address}, align 8"))

    def _place_phis(self, block: str) -> None:
        """Mark where the phi nodes of a block go; their incoming names are known only later."""
        self.e.lines.append(block)
        self.phis[block] = []

    def _phi(self, block: str, name: str, kind: str, *incoming: tuple[str, str]) -> None:
        sources = ", ".join(f"[ {value}, %{label} ]" for value, label in incoming)
        self.phis[block].append(f"  {name} = phi {kind} {sources}")

    def _entry(self) -> None:
        e = self.e
        sizes = self.program.parameters.numel()
        self.parameters = [_load(e, "%parameters", i) for i in range(sizes)]
        self.values.bind_input(0, self.parameters)
        everything = self.tape.needed(range(7))
        self.values.emit(everything, [CONSTANT, PARAMETER])
        self.start_state = [_load(e, "%state", i) for i in range(self.state_size)]
        self.start_memory = [_load(e, "%memory", i) for i in self._in_registers]
        self._start_counters()

    def _start_counters(self) -> None:
        """Where in a step and before a saved node the first stage is; then on to the loop."""
        e = self.e
        if e.lanes > 1:
            self.start_alive = self._alive_from_status()
        if self.program.stages > 1:
            self.first_stage = e.assign(f"srem i64 %first, {self.program.stages}")
        done_before = e.assign("srem i64 %first, %every")
        self.first_due = e.assign(f"sub i64 %every, {done_before}")
        self.entry_end = e.block
        e.line("br label %head")

    def _alive_from_status(self) -> str:
        e = self.e
        kind = f"<{e.lanes} x i64>"
        codes = e.assign(f"load {kind}, ptr %status, align 8")
        return e.assign(f"icmp eq {kind} {codes}, zeroinitializer")

    def _head(self) -> None:
        e = self.e
        e.label("head")
        self._place_phis("head")
        self.state = [f"%s{i}" for i in range(self.state_size)]
        self.memory = [f"%m{i}" for i in self._in_registers]
        e.line("%more = icmp slt i64 %k, %count")
        e.line("br i1 %more, label %step, label %leave")
        e.label("step")
        self.given = self._given()
        self.values.bind_input(1, [*self.state, *self.given])

    def _given(self) -> list[str]:
        """The fraction of the stage and the control inputs of the step."""
        e, program = self.e, self.program
        names = [self._by_stage("fractions")] if program.stages > 1 else []
        if program.control_size:
            stage = e.assign("add i64 %first, %k")
            step = e.assign(f"sdiv i64 {stage}, {program.stages}")
            entry = e.assign(f"mul i64 {step}, {program.control_size}")
            inputs = e.assign(f"getelementptr {e.type}, ptr %controls, i64 {entry}")
            names += [_load(e, inputs, i) for i in range(program.control_size)]
        return names

    def _no_newton(self) -> tuple[Values, list[str], str | None]:
        return self.values, self.memory, None

    def _newton(self) -> tuple[Values, list[str], str | None]:
        """Emit guess and iteration; return the last values, the new memory, the converged flag.

        The values of the last iteration are used after the loop as they are: the next state is an
        expression of the updated unknowns.
        """
        e, n = self.e, self.unknown_size
        needed = self.tape.needed([UPDATE, CARRIED, MEASURE])
        self.values.emit(needed, [STATE])
        kept = self.history * n
        starts = [*self._extrapolated(), *self.memory[kept:-1]]
        step_end = e.block
        e.line("br label %newton")
        e.label("newton")
        self._place_phis("newton")
        names = [f"%u{i}" for i in range(len(starts))]
        inner = Values(self.tape, e, self.values)
        inner.bind_input(2, names[:n])
        inner.bind_input(3, names[n:])
        inner.bind_input(4, ["%later"])
        inner.emit(needed, ITERATED)
        new, error, total, busy = self._iterate(inner, names)
        _store(e, error, "%errors", "%j")
        one, zero = e.constant(1.0), e.constant(0.0)
        carried_on = [
            *zip(names, starts, self._unless_finished(busy, new, names), strict=True),
            ("%later", zero, *self._unless_finished(busy, [one], ["%later"])),
            ("%t", e.constant(rule.BEFORE_FIRST), error),
            ("%total", self.memory[-1], total),
        ]
        newton_end = e.block
        self._branch_after_iteration(busy)
        for name, start, following in carried_on:
            self._phi("newton", name, e.type, (start, step_end), (following, newton_end))
        self._phi("newton", "%j", "i64", ("0", step_end), ("%j1", newton_end))
        if e.lanes > 1:
            self._phi("newton", "%busy", e.flag_type, ("%alive", step_end), (busy, newton_end))
        e.label("settled")
        converged = self._not(busy)
        self.settled_energy = inner.output(MEASURE)[1]
        return inner, [*new[:n], *self.memory[: kept - n], *new[n:], total], converged

    def _unless_finished(self, busy: str, new: list[str], old: list[str]) -> list[str]:
        """Inputs of the next iteration; a lane that is done repeats its last one, bit for bit."""
        if self.e.lanes == 1:
            return new
        return [self.e.select(busy, a, b) for a, b in zip(new, old, strict=True)]

    def _not(self, flag: str) -> str:
        return self.e.assign(f"xor {self.e.flag_type} {flag}, {self._flag('true')}")

    def _flag(self, word: str) -> str:
        """``true`` or ``false`` in every lane."""
        lanes = self.e.lanes
        return word if lanes == 1 else "<" + ", ".join([f"i1 {word}"] * lanes) + ">"

    def _extrapolated(self) -> list[str]:
        """Extrapolation of the unknowns from their values in the last stages."""
        e, n = self.e, self.unknown_size
        if self.program.stages == 1:
            (row,) = extrapolation_weights(self.program.fractions)
            weights = [e.constant(w) for w in row]
        else:
            weights = [self._by_stage(f"weights{age}") for age in range(self.history)]
        guesses = []
        for i in range(n):
            guess = e.binary("fmul", self.memory[i], weights[0])
            for k, weight in enumerate(weights[1:], start=1):
                guess = e.multiply_add(self.memory[k * n + i], weight, guess)
            guesses.append(guess)
        return guesses

    def _iterate(self, inner: Values, unknowns: list[str]) -> tuple[list[str], str, str, str]:
        """One update: new unknowns and carried values, e^2, running count, and a flag per lane.

        The flag tells whether the lane is still busy.
        """
        e = self.e
        n = self.unknown_size
        new = [
            e.binary("fsub", u, d)
            for u, d in zip(unknowns[:n], inner.output(UPDATE), strict=True)
        ]
        new += inner.output(CARRIED)
        return new, *self.measured(*inner.output(MEASURE))

    def measured(self, work: str, energy: str, left: str) -> tuple[str, str, str]:
        """e^2, the running count of iterations, and a flag per lane: it is still busy."""
        e = self.e
        scale = e.binary("fadd", energy, e.pooled(rule.TINY))
        error = e.binary("fdiv", work, scale)
        settled = None
        if not self.program.left.is_zero():
            settled = e.compare("ole", left, e.binary("fmul", scale, e.pooled(rule.LEFT)))
        busy = self._not(self._finished(error, settled))
        one = e.constant(1.0)
        if e.lanes == 1:
            return error, e.binary("fadd", "%total", one), busy
        error = e.select("%busy", error, "%t")
        total = e.binary("fadd", "%total", e.select("%busy", one, e.constant(0.0)))
        return error, total, e.assign(f"and {e.flag_type} %busy, {busy}")

    def _note(self) -> None:
        """Bring the record of the warm start up to date (see ``surprise``); opens a block."""
        e, fractions = self.e, self.program.fractions
        record = [_load(e, "%memory", i) for i in self.noted]
        q, energy = _load(e, "%errors", 0), self.settled_energy
        usual = record[surprise.USUAL]
        flags, following = surprise.stands_out(e, usual, q), surprise.next_usual(e, usual, q)
        peak = surprise.larger(e, energy, record[surprise.PEAK])
        if e.lanes > 1:
            flags = e.assign(f"and {e.flag_type} {flags}, %alive1")
            following = e.select("%alive1", following, usual)
            peak = e.select("%alive1", peak, record[surprise.PEAK])
        anyone = self._any(flags)
        if len(fractions) > 1:
            watched = e.assign(f"icmp eq i64 %stage, {watched_stage(fractions)}")
            following = e.assign(f"select i1 {watched}, {e.type} {following}, {e.type} {usual}")
            anyone = e.assign(f"and i1 {anyone}, {watched}")
        record[surprise.PEAK] = peak
        for entry, name in ((surprise.PEAK, peak), (surprise.USUAL, following)):
            _store(e, name, "%memory", str(self.noted[entry]))
        e.line(f"br i1 {anyone}, label %surprise, label %noted")
        e.label("surprise")
        done = e.assign("add i64 %first, %k")
        stage = e.splat(e.assign(f"sitofp i64 {done} to double"))
        entries = surprise.next_largest(e, record, q, energy, stage, flags)
        for entry, name in zip((surprise.LARGEST, surprise.WHERE), entries, strict=True):
            _store(e, name, "%memory", str(self.noted[entry]))
        e.line("br label %noted")
        e.label("noted")

    def _any(self, flags: str) -> str:
        """Whether a flag is set in any lane."""
        e = self.e
        if e.lanes == 1:
            return flags
        bits = e.assign(f"bitcast {e.flag_type} {flags} to i{e.lanes}")
        return e.assign(f"icmp ne i{e.lanes} {bits}, 0")

    def _branch_after_iteration(self, busy: str, again_at: str = "newton") -> None:
        """Go round again while any lane is unfinished and iterations are left."""
        e = self.e
        keep_going = self._any(busy)
        e.line("%j1 = add i64 %j, 1")
        left = e.assign(f"icmp slt i64 %j1, {rule.MAX_ITERATIONS}")
        again = e.assign(f"and i1 {keep_going}, {left}")
        e.line(f"br i1 {again}, label %{again_at}, label %settled")

    def _finished(self, error: str, settled: str | None) -> str:
        """``newton_rule.finished`` as flags; ``settled``: nothing is left in the next state."""
        e = self.e
        at_floor = e.compare("ole", error, e.pooled(rule.AT_ROUND_OFF))
        power, last = e.binary("fmul", error, error), "%t"
        if self.program.quadratic:
            power, last = e.binary("fmul", power, error), e.binary("fmul", "%t", "%t")
        bound = e.binary("fmul", last, e.pooled(rule.PREDICTED))
        predicted = e.compare("ole", power, bound)
        if settled is not None:
            predicted = e.assign(f"and {e.flag_type} {predicted}, {settled}")
        either = e.assign(f"or {e.flag_type} {at_floor}, {predicted}")
        late = e.assign(f"icmp sge i64 %j, {rule.NO_GAIN_AFTER}")
        accepted = double_text(rule.NO_GAIN_LEVEL), double_text(0.0)
        no_gain = e.assign("select i1 {}, double {}, double {}".format(late, *accepted))
        for factor, level in (
            (rule.STAGNATION, e.pooled(rule.STAGNATION_LEVEL)), (rule.NO_GAIN, e.splat(no_gain))
        ):
            slow = e.compare("oge", error, e.binary("fmul", "%t", e.pooled(factor)))
            low = e.compare("ole", error, level)
            stagnated = e.assign(f"and {e.flag_type} {slow}, {low}")
            either = e.assign(f"or {e.flag_type} {either}, {stagnated}")
        return either

    def _advance(self, values: Values, memory: list[str], converged: str | None) -> None:
        e = self.e
        values.emit(self.tape.needed([NEXT, ARROWS, GUARDS, FINITE]), [STATE, *ITERATED])
        new = values.output(NEXT)
        good, code = self._checks(values, new, converged)
        if e.lanes == 1:
            e.line(f"br i1 {good}, label %next, label %failed")
            e.label("failed")
            e.line(f"store i64 {code}, ptr %status")
            e.line("br label %leave")
        else:
            self._bury(good, code)
            new = [e.select("%alive1", a, b) for a, b in zip(new, self.state, strict=True)]
            memory = [e.select("%alive1", a, b) for a, b in zip(memory, self.memory, strict=True)]
            e.line("br label %next")
        e.label("next")
        if self.unknown_size:
            self._note()
        if self.program.finish is not None:
            new = self._finished_step(new, self.program.finish)
        self._save([*new, *values.output(ARROWS), memory[-1]])
        e.line("br label %head")
        self._close_head(new, memory)

    def _finished_step(self, new: list[str], finish: ca.SX) -> list[str]:
        """The state after ``finish`` where the stage is the last of its step; opens a block."""
        e = self.e
        last, begin = e.assign(f"icmp eq i64 %stage, {self.program.stages - 1}"), e.block
        e.line(f"br i1 {last}, label %finish, label %kept")
        e.label("finish")
        tape = Tape.of(finish_function(self.program, finish)).optimised()
        values = Values(tape, e)
        values.bind_input(0, self.parameters)
        values.bind_input(1, [*new, *self.given])
        values.emit(tape.needed([0]), [CONSTANT, PARAMETER, STATE])
        end = values.output(0)
        if e.lanes > 1:
            end = [e.select("%alive1", a, b) for a, b in zip(end, new, strict=True)]
        finish_end = e.block
        e.line("br label %kept")
        e.label("kept")
        return [
            e.assign(f"phi {e.type} [ {a}, %{begin} ], [ {b}, %{finish_end} ]")
            for a, b in zip(new, end, strict=True)
        ]

    def _close_head(self, new: list[str], memory: list[str]) -> None:
        self._close_counters()
        carried = zip(
            [*self.state, *self.memory],
            [*self.start_state, *self.start_memory],
            [*new, *memory],
            strict=True,
        )
        for name, start, following in carried:
            self._phi("head", name, self.e.type, (start, self.entry_end), (following, "saved"))

    def _close_counters(self) -> None:
        """Stage numbers, room for the next row and living lanes, from round to round."""
        entry = self.entry_end
        self._phi("head", "%k", "i64", ("0", entry), ("%k1", "saved"))
        self._phi("head", "%due", "i64", (self.first_due, entry), ("%due1", "saved"))
        self._phi("head", "%row", "ptr", ("%rows", entry), ("%row1", "saved"))
        if self.program.stages > 1:
            self._phi("head", "%stage", "i64", (self.first_stage, entry), ("%stage1", "saved"))
        if self.e.lanes > 1:
            alive = ((self.start_alive, entry), ("%alive1", "saved"))
            self._phi("head", "%alive", self.e.flag_type, *alive)

    def _checks(self, values: Values, new: list[str], converged: str | None) -> tuple[str, str]:
        """Flag that the step is good, and the outcome code in case it is not.

        In order: a decisive guard, Newton's verdict, the other guards, numbers that are not finite.
        """
        e = self.e
        # everything else in the state is made of these parts; a tree, so nothing waits in a chain
        sums = [new[i] for i in self.program.layout.positions("base", "after", "reconstructed")]
        sums += values.output(FINITE)
        while len(sums) > 1:
            couples = zip(sums[::2], sums[1::2], strict=False)
            sums = [*(e.binary("fadd", a, b) for a, b in couples), *sums[len(sums) & ~1 :]]
        one, guards = e.constant(1.0), self.program.guards
        judged = [
            Verdict(guard.code, e.compare("olt", name, one),
                    e.compare("oge", name, one) if guard.decisive else None)
            for name, guard in zip(values.output(GUARDS), guards, strict=True)
        ]  # fmt: skip
        return self.judged(sums[0], judged, converged)

    def judged(
        self, total: str, verdicts: list[Verdict], converged: str | None
    ) -> tuple[str, str]:
        """Flag and outcome code from a sum that must be finite, the guards, Newton's verdict."""
        e = self.e
        good = e.compare("oeq", e.binary("fsub", total, total), e.constant(0.0))
        code = self._code(Outcome.NOT_FINITE)
        for verdict in reversed(verdicts):
            code = self._choose(verdict.fine, code, self._code(verdict.code))
            good = e.assign(f"and {e.flag_type} {good}, {verdict.fine}")
        if converged is not None:
            code = self._choose(converged, code, self._code(Outcome.NEWTON_FAILED))
            good = e.assign(f"and {e.flag_type} {good}, {converged}")
        for verdict in reversed(verdicts):
            if verdict.crossed is not None:
                code = self._choose(verdict.crossed, self._code(verdict.code), code)
        return good, code

    @property
    def _integer(self) -> str:
        return "i64" if self.e.lanes == 1 else f"<{self.e.lanes} x i64>"

    def _code(self, value: int) -> str:
        if self.e.lanes == 1:
            return str(int(value))
        return "<" + ", ".join([f"i64 {int(value)}"] * self.e.lanes) + ">"

    def _choose(self, flag: str, a: str, b: str) -> str:
        kind = self._integer
        return self.e.assign(f"select {self.e.flag_type} {flag}, {kind} {a}, {kind} {b}")

    def _bury(self, good: str, code: str) -> None:
        """Mark lanes that failed in this step with their code and the step number."""
        e, kind = self.e, self._integer
        bad = self._not(good)
        dying = e.assign(f"and {e.flag_type} %alive, {bad}")
        e.line(f"%alive1 = and {e.flag_type} %alive, {good}")
        old = e.assign(f"load {kind}, ptr %status, align 8")
        new = self._choose(dying, code, old)
        e.line(f"store {kind} {new}, ptr %status, align 8")
        where = e.assign(f"getelementptr i64, ptr %status, i64 {e.lanes}")
        old_step = e.assign(f"load {kind}, ptr {where}, align 8")
        now = e.assign("add i64 %first, %k")
        single = e.assign(f"insertelement {kind} undef, i64 {now}, i32 0")
        splat = e.assign(
            f"shufflevector {kind} {single}, {kind} undef, <{e.lanes} x i32> zeroinitializer"
        )
        new_step = self._choose(dying, splat, old_step)
        e.line(f"store {kind} {new_step}, ptr {where}, align 8")

    def _save(self, row: list[str]) -> None:
        """Write a row when the absolute stage number is a multiple of ``every``."""

        def write() -> None:
            for i, name in enumerate(row):
                _store(self.e, name, "%row", str(i))

        self._save_when_due(write, len(row))

    def _save_when_due(self, write: Callable[[], None], size: int) -> None:
        """Let a row of that size be written where one is due, and go on to the next stage."""
        e = self.e
        before = e.block
        e.line("%k1 = add i64 %k, 1")
        e.line("%now = icmp eq i64 %k1, %due")
        e.line("br i1 %now, label %save, label %saved")
        e.label("save")
        write()
        after = e.assign(f"getelementptr {e.type}, ptr %row, i64 {size}")
        later = e.assign("add i64 %due, %every")
        e.line("br label %saved")
        e.label("saved")
        e.line(f"%row1 = phi ptr [ %row, %{before} ], [ {after}, %save ]")
        e.line(f"%due1 = phi i64 [ %due, %{before} ], [ {later}, %save ]")
        if self.program.stages > 1:
            following = e.assign("add i64 %stage, 1")
            full = e.assign(f"icmp eq i64 {following}, {self.program.stages}")
            e.line(f"%stage1 = select i1 {full}, i64 0, i64 {following}")

    def _leave(self) -> None:
        e = self.e
        e.label("leave")
        for i, name in enumerate(self.state):
            _store(e, name, "%state", str(i))
        for i, name in zip(self._in_registers, self.memory, strict=True):
            _store(e, name, "%memory", str(i))
        e.line("ret i64 %k")
