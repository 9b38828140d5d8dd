"""A CasADi function as a list of scalar operations, sorted by what they depend on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

_INPUT, _OUTPUT, _CONST, _ASSIGN = ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN

MULTIPLY_ADD = -1
"""a b + c in one rounding."""
MULTIPLY_SUBTRACT = -2
"""a b - c in one rounding."""
SUBTRACT_PRODUCT = -3
"""c - a b in one rounding."""
SELECT = -4
"""``flag ? a : b``."""


class Operation(NamedTuple):
    """One scalar operation; ``arguments`` are indices of earlier operations.

    For an input, ``arguments`` is (input number, entry); for a constant, ``value`` holds it.
    """

    code: int
    arguments: tuple[int, ...]
    value: float = 0.0


@dataclass(frozen=True)
class Tape:
    """Operations in order, the level of each, and the operations that hold the outputs.

    levels[i] is 1 + the largest input number operation i depends on, 0 for constants. With inputs
    ordered (parameters, state, unknowns, carried, later) that is the place in the loop nest: 1 once
    per call, 2 once per step, 3 to 5 in every iteration.
    """

    operations: tuple[Operation, ...]
    levels: tuple[int, ...]
    outputs: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, function: ca.Function) -> Tape:
        """Walk a CasADi SX function whose inputs and outputs are dense columns."""
        operations: list[Operation] = []
        levels: list[int] = []
        outputs = [[-1] * function.numel_out(i) for i in range(function.n_out())]
        slots: dict[int, int] = {}
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            if code == _OUTPUT:
                (source,) = function.instruction_input(k)
                number, entry = function.instruction_output(k)
                outputs[number][entry] = slots[source]
                continue
            (slot,) = function.instruction_output(k)
            if code == _CONST:
                operation = Operation(code, (), function.instruction_constant(k))
                level = 0
            elif code == _INPUT:
                number, entry = function.instruction_input(k)
                operation, level = Operation(code, (number, entry)), number + 1
            else:
                arguments = tuple(slots[i] for i in function.instruction_input(k))
                if code == _ASSIGN:
                    slots[slot] = arguments[0]
                    continue
                operation = Operation(code, arguments)
                level = max(levels[i] for i in arguments)
            slots[slot] = len(operations)
            operations.append(operation)
            levels.append(level)
        return cls(tuple(operations), tuple(levels), tuple(tuple(o) for o in outputs))

    def needed(self, outputs: Iterable[int]) -> list[int]:
        """Indices, in order, of the operations that the given outputs depend on."""
        marked = bytearray(len(self.operations))
        stack = [i for number in outputs for i in self.outputs[number]]
        while stack:
            i = stack.pop()
            if marked[i]:
                continue
            marked[i] = 1
            operation = self.operations[i]
            if operation.code != _INPUT:
                stack.extend(operation.arguments)
        return [i for i, mark in enumerate(marked) if mark]

    def optimised(self) -> Tape:
        """Choices in one operation, fewer divisions, fused products: what the emitter is given."""
        return self._selected()._with_reciprocals()._fused()

    def _selected(self) -> Tape:
        """``if_else`` is recorded as ``(c ? a : 0) + (!c ? b : 0)``; here it is one operation."""
        operations, uses = list(self.operations), self._uses()
        for i, operation in enumerate(operations):
            if operation.code != ca.OP_ADD:
                continue
            first, second = (operations[k] for k in operation.arguments)
            if first.code != ca.OP_IF_ELSE_ZERO or second.code != ca.OP_IF_ELSE_ZERO:
                continue
            if any(uses[k] != 1 for k in operation.arguments):
                continue
            for yes, no in ((first, second), (second, first)):
                opposite = operations[no.arguments[0]]
                if opposite.code == ca.OP_NOT and opposite.arguments[0] == yes.arguments[0]:
                    operations[i] = Operation(SELECT, (*yes.arguments, no.arguments[1]))
                    break
        return Tape(tuple(operations), self.levels, self.outputs)

    def _uses(self) -> list[int]:
        """How often an operation is used, by others and by outputs."""
        uses = [0] * len(self.operations)
        for operation in self.operations:
            if operation.code != _INPUT:
                for a in operation.arguments:
                    uses[a] += 1
        for output in self.outputs:
            for i in output:
                uses[i] += 1
        return uses

    def _with_reciprocals(self) -> Tape:
        """Divide once and multiply where a denominator serves several quotients or is hoisted.

        A denominator on a lower level than its quotient gets its reciprocal there, outside the
        loop. A division costs as much as four to eight multiplications.
        """
        quotients: dict[int, list[int]] = {}
        for i, operation in enumerate(self.operations):
            if operation.code == ca.OP_DIV:
                quotients.setdefault(operation.arguments[1], []).append(i)
        operations: list[Operation] = []
        levels: list[int] = []
        place: list[int] = []
        reciprocal: dict[int, int] = {}

        def append(operation: Operation, level: int) -> int:
            operations.append(operation)
            levels.append(level)
            return len(operations) - 1

        for operation, level in zip(self.operations, self.levels, strict=True):
            if operation.code == _INPUT:
                place.append(append(operation, level))
                continue
            arguments = tuple(place[k] for k in operation.arguments)
            if operation.code == ca.OP_DIV:
                below = operation.arguments[1]
                if len(quotients[below]) > 1 or self.levels[below] < level:
                    if below not in reciprocal:
                        inverse = self._inverse_of(below, place[below])
                        reciprocal[below] = append(inverse, self.levels[below])
                    operation = Operation(ca.OP_MUL, (arguments[0], reciprocal[below]))
                    place.append(append(operation, level))
                    continue
            place.append(append(Operation(operation.code, arguments, operation.value), level))
        outputs = tuple(tuple(place[k] for k in output) for output in self.outputs)
        return Tape(tuple(operations), tuple(levels), outputs)

    def _inverse_of(self, index: int, place: int) -> Operation:
        operation = self.operations[index]
        if operation.code == _CONST and operation.value != 0.0:
            return Operation(_CONST, (), 1.0 / operation.value)
        return Operation(ca.OP_INV, (place,))

    def _fused(self) -> Tape:
        """The same computation with every product that feeds a single sum fused into it.

        Only products on the level of their sum are taken: a product that is hoisted out of a loop
        must stay there.
        """
        uses = self._uses()
        operations = list(self.operations)
        for i, operation in enumerate(self.operations):
            if operation.code not in (ca.OP_ADD, ca.OP_SUB):
                continue
            first, second = operation.arguments
            for product, other in ((second, first), (first, second)):
                factor = self.operations[product]
                if (
                    factor.code not in (ca.OP_MUL, ca.OP_SQ)
                    or uses[product] != 1
                    or self.levels[product] != self.levels[i]
                ):
                    continue
                a, b = (factor.arguments * 2)[:2]
                if operation.code == ca.OP_ADD:
                    code = MULTIPLY_ADD
                else:
                    code = MULTIPLY_SUBTRACT if product == first else SUBTRACT_PRODUCT
                operations[i] = Operation(code, (a, b, other))
                break
        return Tape(tuple(operations), self.levels, self.outputs)
