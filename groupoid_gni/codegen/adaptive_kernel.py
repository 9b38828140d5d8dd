"""The adaptive method DOP853 as one LLVM function that runs the whole loop.

    for step { 11 stages; error; accept or shrink; restore; nodes inside the step }

The method is of order 8 with error estimates of orders 5 and 3 and a dense output of order 7
(``dop853_coefficients``); step control is that of Hairer, Norsett, Wanner's dop853.f with beta = 0.
The last stage of a step is the first of the next. Vectors are held in registers as
``<W x double>``, padded with zeros; the field itself is scalar code. Dense output is computed only
in steps that have a node inside.

Everything the loop needs to go on lies in one array, so a run may be cut into calls anywhere
without changing a bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import casadi as ca

from groupoid_gni.codegen import dop853_coefficients as table
from groupoid_gni.codegen.elementary import sine_cosine_function
from groupoid_gni.codegen.emitter import Emitter, Values
from groupoid_gni.codegen.machine import LARGE_PROGRAM
from groupoid_gni.codegen.tape import Tape

SAFETY = 0.9
SMALLEST_FACTOR, LARGEST_FACTOR = 1.0 / 3.0, 6.0
"""Bounds on the ratio of consecutive step sizes."""
FIRST_STEP = 0.01
"""Size of the first step relative to the motion, in the rule of section II.4."""
SMALLEST_STEP = 10.0 * 2.0**-52
"""Smallest step relative to the time."""
TINY = 1e-290
ROOT_BITS = (1023 << 52) - (3 << 46)
"""Bits of 1, less half of the largest error of reading a logarithm off the bits."""

_CONSTANT, _PARAMETER, _STATE = range(3)
_VECTORS = 24
_BLOCK_LENGTH = 500


class Count(IntEnum):
    """Whole numbers at the head of the memory: the next node and the last, ..., what was done.

    STATUS is 0 while there is more to do, 1 at the end, -1 when the step size has underflowed.
    Node k is at step ``k EVERY``, node NODES at STEPS. REJECTED_LAST tells that the last step was
    rejected.
    """

    STATUS = 0
    NODE = 1
    NODES = 2
    EVERY = 3
    STEPS = 4
    EVALUATIONS = 5
    ACCEPTED = 6
    REJECTED = 7
    REJECTED_LAST = 8


class Number(IntEnum):
    """Doubles after the whole numbers; the vectors come next, then the parameters.

    The time is ``TIME + TIME_LOW``. STEP is the size of the next step, 0 before the first;
    NODE_STEP the signed time of one step of the nodes. SECONDS is the running time, kept by the
    caller. The first step is multiplied with CAUTION.
    """

    TIME = 16
    TIME_LOW = 17
    STEP = 18
    NODE_STEP = 19
    RTOL = 20
    ATOL = 21
    SECONDS = 22
    CAUTION = 23


class Vector(IntEnum):
    """Padded vectors: the state, its rate, the absolute tolerance entry by entry."""

    STATE = 0
    RATE = 1
    TOLERANCE = 2


@dataclass(frozen=True)
class FlowLayout:
    """Where things lie in the memory of the loop, an array of 8-byte numbers.

    size : n, entries of the state.  width : W.  parameters : how many.
    """

    size: int
    width: int
    parameters: int

    @classmethod
    def of(cls, function: ca.Function) -> FlowLayout:
        """Layout for a function (parameters, y) -> ..., with the width that serves it."""
        size = function.numel_in(1)
        width = 2 if size <= 4 else 4 if size <= 16 else 8
        return cls(size, width, function.numel_in(0))

    @property
    def blocks(self) -> int:
        """Vectors of W entries that hold a state."""
        return -(-self.size // self.width)

    @property
    def padded(self) -> int:
        """Entries of a padded state."""
        return self.blocks * self.width

    def vector(self, which: Vector) -> slice:
        """Where the entries of a vector lie, padding left out."""
        begin = _VECTORS + which * self.padded
        return slice(begin, begin + self.size)

    @property
    def parameter_slice(self) -> slice:
        """Where the parameters lie."""
        begin = _VECTORS + len(Vector) * self.padded
        return slice(begin, begin + self.parameters)

    @property
    def total(self) -> int:
        """Length of the memory."""
        return self.parameter_slice.stop


def adaptive_kernel_ir(function: ca.Function, fused: bool, layout: FlowLayout) -> str:
    """IR text of the module with ``@advance``.

    function : (parameters, y) -> (y', y put back on its manifold, units of y), dense columns; the
        absolute tolerance is multiplied with the units at the start, entry by entry.
    """
    return _AdaptiveKernel(function, fused, layout).text()


Blocks = list[str]
"""Names of the vectors that hold a padded state."""


class _VectorEmitter(Emitter):
    """Writes vector instructions into the lines of a scalar emitter."""

    def __init__(self, scalar: Emitter, width: int) -> None:
        super().__init__(width, scalar.fused)
        self._scalar = scalar
        self.lines = scalar.lines
        self.declarations = scalar.declarations

    def fresh(self) -> str:
        return self._scalar.fresh()

    def splat(self, value: str) -> str:
        """A scalar in every lane."""
        if value.startswith("0x"):
            return "<" + ", ".join([f"double {value}"] * self.lanes) + ">"
        one = self.assign(f"insertelement {self.type} undef, double {value}, i32 0")
        kind = f"<{self.lanes} x i32>"
        return self.assign(
            f"shufflevector {self.type} {one}, {self.type} undef, {kind} zeroinitializer"
        )

    def sum_of_lanes(self, value: str) -> str:
        """Sum of the lanes, halves first."""
        lanes = self.lanes
        while lanes > 1:
            half = lanes // 2
            parts = []
            for begin in (0, half):
                picks = ", ".join(f"i32 {begin + i}" for i in range(half))
                kind = f"<{lanes} x double>"
                parts.append(self.assign(
                    f"shufflevector {kind} {value}, {kind} undef, <{half} x i32> <{picks}>"
                ))
            value = self.assign(f"fadd <{half} x double> {parts[0]}, {parts[1]}")
            lanes = half
        return self.assign(f"extractelement <1 x double> {value}, i32 0")


class _Loaded(Values):
    """Values of which some are found in memory."""

    def bind(self, index: int, name: str) -> None:
        """Take a name for the value of an operation."""
        self._names[index] = name


class _Field:
    """Emits the field and the restoration of one tape for padded vectors.

    Operations on parameters alone are emitted once, before the loop. The field is a function of its
    own that finds them in memory: emitting it again at each of its 17 places is no faster.
    """

    def __init__(self, function: ca.Function, fused: bool, layout: FlowLayout) -> None:
        self.tape = Tape.of(function).optimised()
        self.layout = layout
        self.fused = fused
        self.identities = [
            self._is_input(place, entry) for entry, place in enumerate(self.tape.outputs[1])
        ]

    def _is_input(self, place: int, entry: int) -> bool:
        operation = self.tape.operations[place]
        return operation.code == ca.OP_INPUT and operation.arguments == (1, entry)

    def block_length(self) -> int:
        """Lines after which basic blocks are cut."""
        return _BLOCK_LENGTH if len(self.tape.operations) > LARGE_PROGRAM else 0

    def prepare(self, e: Emitter, parameters: list[str]) -> None:
        """Emit what depends on parameters alone."""
        self.hoisted = Values(self.tape, e)
        self.hoisted.bind_input(0, parameters)
        self.hoisted.emit(self.tape.needed([0, 1, 2]), [_CONSTANT, _PARAMETER])
        crossing = self._crossing()
        e.line(f"%hoisted = alloca double, i64 {max(1, len(crossing))}, align 64")
        for place, i in enumerate(crossing):
            store_double(e, self.hoisted.name(i), "%hoisted", place)

    def _crossing(self) -> list[int]:
        """Hoisted operations that others need inside the loop."""
        used = {
            k
            for i in self.tape.needed([0])
            if self.tape.levels[i] == _STATE and self.tape.operations[i].code != ca.OP_INPUT
            for k in self.tape.operations[i].arguments
        }
        used.update(self.tape.outputs[0])
        return sorted(
            k
            for k in used
            if self.tape.levels[k] != _STATE and self.tape.operations[k].code != ca.OP_CONST
        )

    def rate(self, e: Emitter, v: _VectorEmitter, y: Blocks) -> Blocks:
        """y' at y."""
        given = ", ".join(["ptr %hoisted", *[f"{v.type} {block}" for block in y]])
        result = e.assign(f"call fastcc {self._result(v)} @field({given})")
        return [e.assign(f"extractvalue {self._result(v)} {result}, {i}") for i in range(len(y))]

    def restored(self, e: Emitter, v: _VectorEmitter, y: Blocks) -> Blocks:
        """y put back on its manifold."""
        if all(self.identities):
            return y
        return self._emitted(e, v, y, 1, self.hoisted)

    def units(self, e: Emitter, v: _VectorEmitter, y: Blocks) -> Blocks:
        """Units of the entries of y; 1 in the padding."""
        return self._emitted(e, v, y, 2, self.hoisted)

    def _emitted(
        self, e: Emitter, v: _VectorEmitter, y: Blocks, output: int, parent: Values
    ) -> Blocks:
        values = Values(self.tape, e, parent)
        values.bind_input(1, unpacked(v, y, self.layout.size))
        values.emit(self.tape.needed([output]), [_STATE])
        names = values.output(output)
        if output != 1:
            padding = v.constant(0.0 if output == 0 else 1.0)
            return packed(v, names, [padding] * self.layout.blocks)
        kept = [None if same else name for same, name in zip(self.identities, names, strict=True)]
        return packed(v, kept, y)

    def _result(self, v: _VectorEmitter) -> str:
        return "{ " + ", ".join([v.type] * self.layout.blocks) + " }"

    def definition(self) -> tuple[list[str], set[str]]:
        """The field as a function, and the declarations it needs."""
        e = Emitter(1, self.fused, self.block_length())
        v = _VectorEmitter(e, self.layout.width)
        inside = _Loaded(self.tape, e)
        for place, i in enumerate(self._crossing()):
            inside.bind(i, load_double(e, "%hoisted", place))
        y = [f"%y{i}" for i in range(self.layout.blocks)]
        rate = self._emitted(e, v, y, 0, inside)
        result, whole = self._result(v), "undef"
        for i, block in enumerate(rate):
            whole = e.assign(f"insertvalue {result} {whole}, {v.type} {block}, {i}")
        e.line(f"ret {result} {whole}")
        given = ", ".join(["ptr %hoisted", *[f"{v.type} {block}" for block in y]])
        head = f"define internal fastcc {result} @field({given}) {{"
        return [head, "entry:", *e.lines, "}"], e.declarations


def load_double(e: Emitter, pointer: str, index: int) -> str:
    """``pointer[index]``."""
    address = e.assign(f"getelementptr double, ptr {pointer}, i64 {index}")
    return e.assign(f"load double, ptr {address}, align 8")


def store_double(e: Emitter, value: str, pointer: str, index: int) -> None:
    """``pointer[index] = value``."""
    address = e.assign(f"getelementptr double, ptr {pointer}, i64 {index}")
    e.line(f"store double {value}, ptr {address}, align 8")


def unpacked(v: _VectorEmitter, y: Blocks, size: int) -> list[str]:
    """The entries of a padded state."""
    return [
        v.assign(f"extractelement {v.type} {y[i // v.lanes]}, i32 {i % v.lanes}")
        for i in range(size)
    ]


def packed(v: _VectorEmitter, entries: list[str | None] | list[str], onto: Blocks) -> Blocks:
    """Entries put into a padded state; those that are None are left as they are."""
    blocks = list(onto)
    for i, entry in enumerate(entries):
        if entry is not None:
            block, lane = divmod(i, v.lanes)
            blocks[block] = v.assign(
                f"insertelement {v.type} {blocks[block]}, double {entry}, i32 {lane}"
            )
    return blocks


class _AdaptiveKernel:
    """Builds ``i64 @advance(memory, rows, attempts)``.

    memory : see ``Count``, ``Number``, ``FlowLayout``.
    rows : room for all nodes, ``n + 1`` numbers each, the last one left as it is.
    attempts : how many steps, accepted or not, this call may try.  Returns the status.
    """

    def __init__(self, function: ca.Function, fused: bool, layout: FlowLayout) -> None:
        self.layout = layout
        self.field = _Field(function, fused, layout)
        self.e = Emitter(1, fused, self.field.block_length())
        self.v = _VectorEmitter(self.e, layout.width)

    def text(self) -> str:
        """The whole module."""
        e = self.e
        self._entry()
        self._begin()
        self._step()
        self._nodes()
        self._accept()
        self._reject()
        e.label("leave")
        e.line("%status = phi i64 [ 0, %loop ], [ -1, %small ], [ 1, %finished ]")
        self._keep_count("%status", Count.STATUS)
        e.line("ret i64 %status")
        head = "define i64 @advance(ptr %memory, ptr %rows, i64 %attempts) {"
        field, declarations = self.field.definition()
        lines = [*field, head, "entry:", *e.lines, "}"]
        needed = e.declarations | declarations
        if any("@gni_sincos" in line for line in lines):
            elementary, more = sine_cosine_function(1, e.fused)
            lines, needed = [*elementary, *lines], needed | more
        return "\n".join([*lines, *sorted(needed)]) + "\n"

    # ------------------------------------------------------------ memory

    def _number(self, which: int) -> str:
        return load_double(self.e, "%memory", which)

    def _keep(self, value: str, which: int) -> None:
        store_double(self.e, value, "%memory", which)

    def _count(self, which: int) -> str:
        address = self.e.assign(f"getelementptr i64, ptr %memory, i64 {int(which)}")
        return self.e.assign(f"load i64, ptr {address}, align 8")

    def _keep_count(self, value: str, which: int) -> None:
        address = self.e.assign(f"getelementptr i64, ptr %memory, i64 {int(which)}")
        self.e.line(f"store i64 {value}, ptr {address}, align 8")

    def _add_count(self, amount: str, which: int) -> None:
        self._keep_count(self.e.assign(f"add i64 {self._count(which)}, {amount}"), which)

    def _vector(self, which: Vector) -> Blocks:
        v, begin = self.v, self.layout.vector(which).start
        blocks = []
        for i in range(self.layout.blocks):
            place = begin + i * v.lanes
            address = v.assign(f"getelementptr double, ptr %memory, i64 {place}")
            blocks.append(v.assign(f"load {v.type}, ptr {address}, align 8"))
        return blocks

    def _keep_vector(self, value: Blocks, which: Vector) -> None:
        v, begin = self.v, self.layout.vector(which).start
        for i, block in enumerate(value):
            place = begin + i * v.lanes
            address = v.assign(f"getelementptr double, ptr %memory, i64 {place}")
            v.line(f"store {v.type} {block}, ptr {address}, align 8")

    # ------------------------------------------------------------ vector algebra

    def _multiply_add(self, a: Blocks, scalar: str, b: Blocks) -> Blocks:
        """``scalar a + b`` with a splat scalar."""
        return [self.v.multiply_add(x, scalar, y) for x, y in zip(a, b, strict=True)]

    def _each(self, instruction: str, a: Blocks, b: Blocks) -> Blocks:
        return [self.v.binary(instruction, x, y) for x, y in zip(a, b, strict=True)]

    def _combination(self, weights: table.Weights, k: list[Blocks]) -> Blocks:
        """``sum_j weights_j k_j``, the latest stage last: it is the one waited for."""
        result: Blocks = []
        for j in sorted(weights):
            weight = self.v.constant(weights[j])
            if result:
                result = self._multiply_add(k[j], weight, result)
            else:
                result = [self.v.binary("fmul", block, weight) for block in k[j]]
        return result

    def _stage(self, weights: table.Weights, k: list[Blocks], y: Blocks, h: str) -> Blocks:
        """``y + h sum_j weights_j k_j``, so arranged that the latest k passes one operation."""
        e, v = self.e, self.v
        last = max(weights)
        earlier = {j: w for j, w in weights.items() if j != last}
        if earlier:
            y = self._multiply_add(self._combination(earlier, k), v.splat(h), y)
        scaled = e.binary("fmul", h, e.constant(weights[last]))
        return self._multiply_add(k[last], v.splat(scaled), y)

    def _rate(self, y: Blocks) -> Blocks:
        return self.field.rate(self.e, self.v, y)

    def _magnitude(self, *vectors: Blocks) -> Blocks:
        """Largest absolute value of each entry."""
        v = self.v
        result = [v.intrinsic("fabs", block) for block in vectors[0]]
        for other in vectors[1:]:
            sizes = [v.intrinsic("fabs", block) for block in other]
            result = [
                v.select(v.compare("ogt", a, b), a, b) for a, b in zip(result, sizes, strict=True)
            ]
        return result

    def _inverse_scale(self, *vectors: Blocks) -> Blocks:
        """``1 / (atol + rtol max |y|)`` of each entry."""
        v = self.v
        scale = self._multiply_add(self._magnitude(*vectors), v.splat(self.rtol), self.atol)
        return [v.binary("fdiv", v.constant(1.0), block) for block in scale]

    def _norm_squared(self, a: Blocks, scale: Blocks) -> str:
        v = self.v
        total = ""
        for block in self._each("fmul", a, scale):
            total = v.multiply_add(block, block, total) if total else v.binary("fmul", block, block)
        return v.sum_of_lanes(total)

    def _larger(self, a: str, b: str) -> str:
        return self.e.select(self.e.compare("ogt", a, b), a, b)

    def _smaller(self, a: str, b: str) -> str:
        return self.e.select(self.e.compare("olt", a, b), a, b)

    def _root(self, value: str, times: int) -> str:
        """Square root taken several times."""
        for _ in range(times):
            value = self.e.intrinsic("sqrt", value)
        return value

    # ------------------------------------------------------------ the loop

    def _entry(self) -> None:
        e = self.e
        place = self.layout.parameter_slice
        parameters = [self._number(i) for i in range(place.start, place.stop)]
        self.field.prepare(e, parameters)
        self.rtol = self._number(Number.RTOL)
        self.node_step = self._number(Number.NODE_STEP)
        steps = e.assign(f"sitofp i64 {self._count(Count.STEPS)} to double")
        self.end = e.binary("fmul", steps, self.node_step)
        self.sign = e.intrinsic("copysign", e.constant(1.0), self.node_step)
        begun = e.compare("une", self._number(Number.STEP), e.constant(0.0))
        self.entry_end = e.block
        e.line(f"br i1 {begun}, label %loop, label %begin")

    def _begin(self) -> None:
        """The first rate and the first step size (section II.4)."""
        e, v = self.e, self.v
        e.label("begin")
        y = self._vector(Vector.STATE)
        f = self._rate(y)
        atol = v.splat(self._number(Number.ATOL))
        self.atol = [v.binary("fmul", u, atol) for u in self.field.units(e, v, y)]
        self._keep_vector(self.atol, Vector.TOLERANCE)
        scale = self._inverse_scale(y)
        n = e.constant(float(self.layout.size))
        size, speed = (
            self._root(e.binary("fdiv", self._norm_squared(a, scale), n), 1) for a in (y, f)
        )
        ratio = e.binary("fdiv", e.binary("fmul", e.constant(FIRST_STEP), size), speed)
        small = e.assign(
            f"or i1 {e.compare('olt', size, e.constant(1e-5))}, "
            f"{e.compare('olt', speed, e.constant(1e-5))}"
        )
        whole = e.intrinsic("fabs", self.end)
        h0 = self._smaller(e.select(small, e.constant(1e-6), ratio), whole)
        signed = e.binary("fmul", h0, self.sign)
        f1 = self._rate(self._multiply_add(f, v.splat(signed), y))
        change = self._root(
            e.binary("fdiv", self._norm_squared(self._each("fsub", f1, f), scale), n), 1
        )
        fastest = self._larger(speed, e.binary("fdiv", change, h0))
        h1 = self._root(e.binary("fdiv", e.constant(FIRST_STEP), fastest), 3)
        still = e.compare("ole", fastest, e.constant(1e-15))
        slow = self._larger(e.constant(1e-6), e.binary("fmul", h0, e.constant(1e-3)))
        h1 = e.select(still, slow, h1)
        h = self._smaller(self._smaller(e.binary("fmul", h0, e.constant(100.0)), h1), whole)
        self._keep_vector(f, Vector.RATE)
        self._keep(e.binary("fmul", h, self._number(Number.CAUTION)), Number.STEP)
        self._add_count("2", Count.EVALUATIONS)
        e.line("br label %loop")
        self.begin_end = e.block

    def _step(self) -> None:
        """One attempt, up to the decision."""
        e = self.e
        e.label("loop")
        e.line(
            f"%tried = phi i64 [ 0, %{self.entry_end} ], [ 0, %{self.begin_end} ], "
            "[ %tried1, %rejected ], [ %tried1, %accepted ]"
        )
        e.line("%tried1 = add i64 %tried, 1")
        e.line("%some_left = icmp slt i64 %tried, %attempts")
        e.line("br i1 %some_left, label %attempt, label %leave")
        e.label("attempt")
        self.time, self.time_low = self._number(Number.TIME), self._number(Number.TIME_LOW)
        wanted = self._number(Number.STEP)
        smallest = e.multiply_add(
            e.intrinsic("fabs", self.time), e.constant(SMALLEST_STEP), e.constant(TINY)
        )
        large = e.compare("oge", wanted, smallest)
        e.line(f"br i1 {large}, label %try, label %small")
        e.label("small")
        e.line("br label %leave")
        e.label("try")
        left = e.binary("fsub", e.binary("fsub", self.end, self.time), self.time_low)
        size_left = e.intrinsic("fabs", left)
        # a last step a hundredth longer is better than a very short one after it
        beyond = e.binary("fmul", wanted, e.constant(1.01))
        self.ends = e.compare("ole", size_left, beyond)
        size = e.select(self.ends, size_left, wanted)
        self.h = e.binary("fmul", size, self.sign)
        y, f = self._vector(Vector.STATE), self._vector(Vector.RATE)
        self.atol = self._vector(Vector.TOLERANCE)
        k = [f]
        for weights in table.STAGES[1:]:
            k.append(self._rate(self._stage(weights, k, y, self.h)))
        self.y, self.k = y, k
        self._decide(size)

    def _decide(self, size: str) -> None:
        """Error norm, next step size, and the branch."""
        e, v = self.e, self.v
        slope = self._combination(table.STEP, self.k)
        new = self._multiply_add(slope, v.splat(self.h), self.y)
        fifth = self._combination(table.FIFTH, self.k)
        third = self._each("fsub", slope, self._combination(table.THIRD, self.k))
        scale = self._inverse_scale(self.y, new)
        five, three = self._norm_squared(fifth, scale), self._norm_squared(third, scale)
        # err = sqrt(moved^2 / both) with moved = h five and both = n (five + three / 100)
        both = e.multiply_add(three, e.constant(0.01), five)
        both = e.multiply_add(both, e.constant(float(self.layout.size)), e.constant(TINY))
        moved = e.binary("fmul", size, five)
        moved = e.binary("fmul", moved, moved)
        small = e.compare("ole", moved, both)
        finite = self._is_finite(new)
        good = e.assign(f"and i1 {small}, {finite}")
        factor = e.binary("fmul", self._inverse_root(moved, both), e.constant(SAFETY))
        factor = self._larger(factor, e.constant(SMALLEST_FACTOR))
        factor = self._smaller(factor, e.constant(LARGEST_FACTOR))
        shrunk = e.select(finite, factor, e.constant(SMALLEST_FACTOR))
        self.rejections = [(shrunk, len(table.STAGES) - 1, e.block)]
        e.line(f"br i1 {good}, label %good, label %rejected")
        e.label("good")
        self.size, self.factor = size, factor
        self.new = self.field.restored(e, v, new)
        self.k.append(self._rate(self.new))

    def _is_finite(self, y: Blocks) -> str:
        """Flag that no entry is infinite or NaN."""
        e, v = self.e, self.v
        total = ""
        for block in self._each("fsub", y, y):
            total = v.binary("fadd", total, block) if total else block
        return e.compare("oeq", v.sum_of_lanes(total), e.constant(0.0))

    def _inverse_root(self, a: str, b: str) -> str:
        """``(b / a)^(1/16)`` to one percent, which is enough for a step size.

        The bits of a double are linear in its logarithm, to 3 percent of the root; then one step of
        Newton's method for ``x^-16 = a / b``. Four square roots and a division would be the longest
        chain of the step.
        """
        e = self.e
        bits = [e.assign(f"bitcast double {value} to i64") for value in (a, b)]
        difference = e.assign(f"sub i64 {bits[1]}, {bits[0]}")
        sixteenth = e.assign(f"ashr i64 {difference}, 4")
        guess = e.assign(f"bitcast i64 {e.assign(f'add i64 {sixteenth}, {ROOT_BITS}')} to double")
        power = guess
        for _ in range(4):
            power = e.binary("fmul", power, power)
        ratio = e.binary("fdiv", a, b)
        sixteenth = e.binary("fmul", guess, e.constant(0.0625))
        return e.binary(
            "fmul", sixteenth, e.multiply_add(e.negate(ratio), power, e.constant(17.0))
        )

    def _reject(self) -> None:
        """Try again with a smaller step; joined from wherever a step was found wanting."""
        e = self.e
        e.label("rejected")
        factors = ", ".join(f"[ {factor}, %{block} ]" for factor, _, block in self.rejections)
        spent = ", ".join(f"[ {count}, %{block} ]" for _, count, block in self.rejections)
        factor = e.assign(f"phi double {factors}")
        evaluations = e.assign(f"phi i64 {spent}")
        self._keep(e.binary("fmul", self.size, factor), Number.STEP)
        self._add_count("1", Count.REJECTED)
        self._keep_count("1", Count.REJECTED_LAST)
        self._add_count(evaluations, Count.EVALUATIONS)
        e.line("br label %loop")

    def _accept(self) -> None:
        """Take the new state over, and its time in two parts, so that no round-off adds up."""
        e = self.e
        e.label("accepted")
        once_more = e.assign(f"icmp ne i64 {self._count(Count.REJECTED_LAST)}, 0")
        bounded = self._smaller(self.factor, e.constant(1.0))
        factor = e.select(once_more, bounded, self.factor)
        self._keep(e.binary("fmul", self.size, factor), Number.STEP)
        self._keep_count("0", Count.REJECTED_LAST)
        self._add_count("1", Count.ACCEPTED)
        self._add_count(str(len(table.STAGES)), Count.EVALUATIONS)
        self._keep(self.new_time, Number.TIME)
        self._keep(self.new_low, Number.TIME_LOW)
        self._keep_vector(self.new, Vector.STATE)
        self._keep_vector(self.k[12], Vector.RATE)
        e.line(f"br i1 {self.ends}, label %finished, label %loop")
        e.label("finished")
        self._write(self.new, self.nodes)
        self._keep_count(e.assign(f"add i64 {self.nodes}, 1"), Count.NODE)
        e.line("br label %leave")

    def _new_time(self) -> None:
        e = self.e
        step = e.binary("fadd", self.h, self.time_low)
        time = e.binary("fadd", self.time, step)
        low = e.binary("fsub", step, e.binary("fsub", time, self.time))
        self.new_time = e.select(self.ends, self.end, time)
        self.new_low = e.select(self.ends, e.constant(0.0), low)

    def _node_time(self, node: str) -> str:
        e = self.e
        step = e.assign(f"mul i64 {node}, {self.every}")
        number = e.assign(f"sitofp i64 {step} to double")
        return e.binary("fmul", number, self.node_step)

    def _inside(self, node: str) -> str:
        """Whether a node that is not the last lies in the step just made."""
        e = self.e
        ahead = e.binary("fsub", self._node_time(node), self.new_time)
        reached = e.compare("ole", e.binary("fmul", ahead, self.sign), e.constant(0.0))
        not_last = e.assign(f"icmp slt i64 {node}, {self.nodes}")
        return e.assign(f"and i1 {not_last}, {reached}")

    def _nodes(self) -> None:
        """Rows of the nodes inside the step; the last node is the end of the last step."""
        e = self.e
        self._new_time()
        self.every, self.nodes = self._count(Count.EVERY), self._count(Count.NODES)
        first = self._count(Count.NODE)
        some = self._inside(first)
        e.line(f"br i1 {some}, label %dense, label %accepted")
        e.label("dense")
        polynomial = self._dense()
        # its stages look at other points, where the field may not be defined
        finite = self._is_finite([block for part in polynomial for block in part])
        dense_end = e.block
        smallest, spent = e.constant(SMALLEST_FACTOR), len(table.STAGES)
        self.rejections.append((smallest, spent, dense_end))
        e.line(f"br i1 {finite}, label %node, label %rejected")
        e.label("node")
        phi = len(e.lines)
        e.lines.append("")
        since = e.binary("fsub", e.binary("fsub", self._node_time("%j"), self.time), self.time_low)
        x = e.binary("fdiv", since, self.h)
        self._write(self.field.restored(e, self.v, self._interpolated(polynomial, x)), "%j")
        e.line("%j1 = add i64 %j, 1")
        self._keep_count("%j1", Count.NODE)
        more = self._inside("%j1")
        e.line(f"br i1 {more}, label %node, label %accepted")
        e.lines[phi] = f"  %j = phi i64 [ {first}, %{dense_end} ], [ %j1, %{e.block} ]"

    def _dense(self) -> list[Blocks]:
        """Coefficients of the interpolation (section II.6), lowest first."""
        v, h = self.v, self.v.splat(self.h)
        k = list(self.k)
        for weights in table.EXTRA_STAGES:
            k.append(self._rate(self._stage(weights, k, self.y, self.h)))
        self._add_count(str(len(table.EXTRA_STAGES)), Count.EVALUATIONS)
        change = self._each("fsub", self.new, self.y)
        minus = [v.negate(block) for block in change]
        second = self._multiply_add(k[0], h, minus)
        rates = self._each("fadd", k[0], k[12])
        twice = self._each("fadd", change, change)
        third = self._multiply_add([v.negate(block) for block in rates], h, twice)
        higher = [
            [v.binary("fmul", block, h) for block in self._combination(weights, k)]
            for weights in table.DENSE
        ]
        return [change, second, third, *higher]

    def _interpolated(self, polynomial: list[Blocks], x: str) -> Blocks:
        """``y + x (F0 + (1 - x) (F1 + x (F2 + ...)))``."""
        e, v = self.e, self.v
        factors = [v.splat(x), v.splat(e.binary("fsub", e.constant(1.0), x))]
        value = polynomial[-1]
        for i in range(len(polynomial) - 1, 0, -1):
            value = self._multiply_add(value, factors[i % 2], polynomial[i - 1])
        return self._multiply_add(value, factors[0], self.y)

    def _write(self, y: Blocks, node: str) -> None:
        e = self.e
        place = e.assign(f"mul i64 {node}, {self.layout.size + 1}")
        row = e.assign(f"getelementptr double, ptr %rows, i64 {place}")
        for i, entry in enumerate(unpacked(self.v, y, self.layout.size)):
            store_double(e, entry, row, i)
