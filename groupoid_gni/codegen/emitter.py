"""Operations of a tape as LLVM IR, over W lanes.

Every value is a ``double`` (one lane) or a ``<W x double>``. No fast-math and no contraction by the
compiler: fused products are written out (``Tape.optimised``), so the bits are the same for every W.
Sine and cosine are our own polynomials for the same reason; other transcendental functions go to
the C library one lane at a time.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable

import casadi as ca

from groupoid_gni.codegen.tape import (
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SELECT,
    SUBTRACT_PRODUCT,
    Operation,
    Tape,
)

_COMPARISONS = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}
_BINARY = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_INTRINSICS = {
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_FMIN: "minnum",
    ca.OP_FMAX: "maxnum",
}
_LIBRARY = {
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG1P: "log1p",
    ca.OP_ERF: "erf",
    ca.OP_ATAN2: "atan2",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_HYPOT: "hypot",
}


def double_text(value: float) -> str:
    """A double as the exact hexadecimal literal of LLVM IR."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


class Emitter:
    """Writes lines of IR; hands out fresh value names.

    lanes : W.  fused : whether the processor multiplies and adds in one rounding.
    longest_block : lines after which a basic block is cut; 0 never cuts. Very large straight-line
        blocks make the code generator superlinear.
    block : name of the block being written; phi nodes need the name a branch really leaves from.
    pool : places of constants in the memory at ``%pool``, filled by whoever opens the function;
        None where constants are literals. A literal takes a register or two instructions, and small
        loops are short of registers.
    """

    def __init__(self, lanes: int = 1, fused: bool = True, longest_block: int = 0) -> None:
        self.lanes = lanes
        self.longest_block = longest_block
        self.block = "entry"
        self._block_start = 0
        self.fused = fused
        self.type = "double" if lanes == 1 else f"<{lanes} x double>"
        self.flag_type = "i1" if lanes == 1 else f"<{lanes} x i1>"
        self.suffix = "f64" if lanes == 1 else f"v{lanes}f64"
        self.lines: list[str] = []
        self.declarations: set[str] = set()
        self._count = 0
        self.pool: dict[float, int] | None = None

    def constant(self, value: float) -> str:
        """The literal of a constant in every lane."""
        text = double_text(value)
        if self.lanes == 1:
            return text
        return "<" + ", ".join(f"double {text}" for _ in range(self.lanes)) + ">"

    def pooled(self, value: float) -> str:
        """A constant from the pool, if there is one, which the processor reads in passing."""
        if self.pool is None:
            return self.constant(value)
        place = self.pool.setdefault(value, len(self.pool))
        address = self.assign(f"getelementptr {self.type}, ptr %pool, i64 {place}")
        return self.assign(f"load {self.type}, ptr {address}, align 8")

    def splat(self, name: str) -> str:
        """A scalar double in every lane."""
        if self.lanes == 1:
            return name
        single = self.assign(f"insertelement {self.type} undef, double {name}, i32 0")
        order = f"<{self.lanes} x i32> zeroinitializer"
        return self.assign(f"shufflevector {self.type} {single}, {self.type} undef, {order}")

    def fresh(self) -> str:
        """A new value name."""
        self._count += 1
        return f"%v{self._count}"

    def line(self, text: str) -> None:
        """Append one line of IR."""
        self.lines.append("  " + text)

    def label(self, name: str) -> None:
        """Open a basic block."""
        self.lines.append(f"{name}:")
        self.block = name
        self._block_start = len(self.lines)

    def cut_if_long(self) -> None:
        """Go on in a new basic block when the current one has grown long."""
        if self.longest_block and len(self.lines) - self._block_start > self.longest_block:
            name = f"cut{len(self.lines)}"
            self.line(f"br label %{name}")
            self.label(name)

    def assign(self, text: str) -> str:
        """Append ``%new = text`` and return the new name."""
        name = self.fresh()
        self.lines.append(f"  {name} = {text}")
        return name

    def binary(self, instruction: str, a: str, b: str) -> str:
        """``fadd``, ``fsub``, ``fmul`` or ``fdiv`` of two values."""
        return self.assign(f"{instruction} {self.type} {a}, {b}")

    def compare(self, condition: str, a: str, b: str) -> str:
        """Floating-point comparison, giving a flag per lane."""
        return self.assign(f"fcmp {condition} {self.type} {a}, {b}")

    def select(self, flag: str, a: str, b: str) -> str:
        """``flag ? a : b`` per lane."""
        return self.assign(f"select {self.flag_type} {flag}, {self.type} {a}, {self.type} {b}")

    def intrinsic(self, name: str, *arguments: str) -> str:
        """A call of ``llvm.name``."""
        types = ", ".join([self.type] * len(arguments))
        self.declarations.add(f"declare {self.type} @llvm.{name}.{self.suffix}({types})")
        given = ", ".join(f"{self.type} {a}" for a in arguments)
        return self.assign(f"call {self.type} @llvm.{name}.{self.suffix}({given})")

    def library(self, name: str, *arguments: str) -> str:
        """A call into the C mathematics library, one lane at a time."""
        scalars = ", ".join(["double"] * len(arguments))
        self.declarations.add(f"declare double @{name}({scalars})")
        if self.lanes == 1:
            given = ", ".join(f"double {a}" for a in arguments)
            return self.assign(f"call double @{name}({given})")
        result = "undef"
        for lane in range(self.lanes):
            parts = [
                self.assign(f"extractelement {self.type} {a}, i32 {lane}") for a in arguments
            ]
            given = ", ".join(f"double {a}" for a in parts)
            value = self.assign(f"call double @{name}({given})")
            result = self.assign(
                f"insertelement {self.type} {result}, double {value}, i32 {lane}"
            )
        return result

    def multiply_add(self, a: str, b: str, c: str) -> str:
        """``a b + c`` in one rounding where the processor can, in two elsewhere."""
        if self.fused:
            return self.intrinsic("fma", a, b, c)
        return self.binary("fadd", self.binary("fmul", a, b), c)

    def negate(self, a: str) -> str:
        """``-a``."""
        return self.assign(f"fneg {self.type} {a}")

    def sine_cosine(self, a: str) -> tuple[str, str]:
        """Sine and cosine by our own polynomials (see ``elementary``)."""
        pair = f"{{ {self.type}, {self.type} }}"
        both = self.assign(f"call fastcc {pair} @gni_sincos({self.type} {a})")
        return (
            self.assign(f"extractvalue {pair} {both}, 0"),
            self.assign(f"extractvalue {pair} {both}, 1"),
        )


class Values:
    """Names of the values of a tape's operations that have been emitted so far.

    A child sees its parent's values; what it adds stays its own. That is how the same operations
    are emitted once inside the Newton loop and once after it.
    """

    def __init__(self, tape: Tape, emitter: Emitter, parent: Values | None = None) -> None:
        self.tape = tape
        self.emitter = emitter
        self._names: dict[int, str] = dict(parent._names) if parent else {}
        self._flags: dict[int, str] = dict(parent._flags) if parent else {}
        self._angles: dict[int, tuple[str, str]] = dict(parent._angles) if parent else {}

    def bind_input(self, number: int, names: list[str]) -> None:
        """Give names to the entries of an input."""
        for i, operation in enumerate(self.tape.operations):
            if operation.code == ca.OP_INPUT and operation.arguments[0] == number:
                self._names[i] = names[operation.arguments[1]]

    def output(self, number: int) -> list[str]:
        """Names of an output's entries."""
        return [self.name(i) for i in self.tape.outputs[number]]

    def name(self, index: int) -> str:
        """Name (or literal) of an operation's value."""
        operation = self.tape.operations[index]
        if operation.code == ca.OP_CONST:
            return self.emitter.pooled(operation.value)
        if index not in self._names and index in self._flags:
            one, zero = self.emitter.constant(1.0), self.emitter.constant(0.0)
            self._names[index] = self.emitter.select(self._flags[index], one, zero)
        return self._names[index]

    def emit(self, indices: Iterable[int], levels: Iterable[int]) -> None:
        """Emit those of the operations that lie on the given levels and are not there yet."""
        wanted = set(levels)
        for i in indices:
            if self.tape.levels[i] not in wanted or i in self._names or i in self._flags:
                continue
            operation = self.tape.operations[i]
            if operation.code not in (ca.OP_CONST, ca.OP_INPUT):
                self.emitter.cut_if_long()
                self._emit_one(i, operation)

    def _emit_one(self, i: int, operation: Operation) -> None:
        code = operation.code
        if code in _COMPARISONS:
            a, b = (self.name(k) for k in operation.arguments)
            self._flags[i] = self.emitter.compare(_COMPARISONS[code], a, b)
        elif code in (ca.OP_NOT, ca.OP_AND, ca.OP_OR):
            self._flags[i] = self._logic(code, operation)
        elif code == ca.OP_IF_ELSE_ZERO:
            flag, value = self._flag(operation.arguments[0]), self.name(operation.arguments[1])
            self._names[i] = self.emitter.select(flag, value, self.emitter.constant(0.0))
        elif code == SELECT:
            which, *both = operation.arguments
            self._names[i] = self.emitter.select(self._flag(which), *(self.name(k) for k in both))
        elif code in (ca.OP_SIN, ca.OP_COS):
            angle = operation.arguments[0]
            if angle not in self._angles:
                self._angles[angle] = self.emitter.sine_cosine(self.name(angle))
            self._names[i] = self._angles[angle][0 if code == ca.OP_SIN else 1]
        else:
            self._names[i] = self._arithmetic(code, [self.name(k) for k in operation.arguments])

    def _flag(self, index: int) -> str:
        if index in self._flags:
            return self._flags[index]
        return self.emitter.compare("une", self.name(index), self.emitter.constant(0.0))

    def _logic(self, code: int, operation: Operation) -> str:
        e = self.emitter
        flags = [self._flag(k) for k in operation.arguments]
        if code == ca.OP_NOT:
            true = "true" if e.lanes == 1 else "<" + ", ".join(["i1 true"] * e.lanes) + ">"
            return e.assign(f"xor {e.flag_type} {flags[0]}, {true}")
        name = "and" if code == ca.OP_AND else "or"
        return e.assign(f"{name} {e.flag_type} {flags[0]}, {flags[1]}")

    def _arithmetic(self, code: int, given: list[str]) -> str:
        e = self.emitter
        if code in _BINARY:
            return e.binary(_BINARY[code], *given)
        if code == MULTIPLY_ADD:
            return e.multiply_add(*given)
        if code == MULTIPLY_SUBTRACT:
            return e.multiply_add(given[0], given[1], e.negate(given[2]))
        if code == SUBTRACT_PRODUCT:
            return e.multiply_add(e.negate(given[0]), given[1], given[2])
        if code == ca.OP_NEG:
            return e.negate(given[0])
        if code == ca.OP_SQ:
            return e.binary("fmul", given[0], given[0])
        if code == ca.OP_TWICE:
            return e.binary("fadd", given[0], given[0])
        if code == ca.OP_INV:
            return e.binary("fdiv", e.constant(1.0), given[0])
        if code in _INTRINSICS:
            return e.intrinsic(_INTRINSICS[code], *given)
        if code in _LIBRARY:
            return e.library(_LIBRARY[code], *given)
        if code == ca.OP_SIGN:
            zero = e.constant(0.0)
            positive = e.select(e.compare("ogt", given[0], zero), e.constant(1.0), given[0])
            return e.select(e.compare("olt", given[0], zero), e.constant(-1.0), positive)
        raise NotImplementedError(
            f"operation {code} of CasADi has no machine code; integrate(..., compile=False) runs it"
        )
