"""Long straight-line code as many short functions that share a frame in memory.

One function of 50,000 lines costs the code generator seconds, fifty of 1,000 lines a fraction: the
allocation of registers is what grows faster than the code. Values that one part hands to another
live in the frame; within a part they stay in registers.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

import casadi as ca

from groupoid_gni.codegen.emitter import Emitter, Values
from groupoid_gni.codegen.tape import Operation, Tape

# parts of 60 to 200 operations compile and run equally fast, longer ones compile more slowly
_LENGTH = 100
_OUTPUTS = 300


class Frame:
    """The memory that parts share: slots of W doubles, counted here and allocated by the kernel."""

    def __init__(self, lanes: int, fused: bool) -> None:
        self.lanes, self.fused = lanes, fused
        self.size = 0
        self.functions: list[str] = []
        self.declarations: set[str] = set()

    def reserve(self, count: int) -> int:
        """First slot of a new region."""
        first = self.size
        self.size += count
        return first

    def define(self, lines: list[str], declarations: set[str]) -> str:
        """Add a function of the frame; return the call of it."""
        name = f"@part{len(self.functions)}"
        body = "\n".join(lines)
        head = f"define internal void {name}(ptr noalias %frame) {{\nentry:"
        self.functions.append(f"{head}\n{body}\n  ret void\n}}")
        self.declarations |= declarations
        return f"call void {name}(ptr %frame)"


class FramedTape:
    """The operations of a tape, computed part by part in a frame.

    inputs, outputs : number of an input or output -> first slot of its region. A value lies where
        an output wants it, if one does.
    homes : number of an input -> where each of its entries is at home, in (0, 1].
    """

    def __init__(
        self,
        tape: Tape,
        frame: Frame,
        inputs: dict[int, int],
        outputs: dict[int, int],
        homes: dict[int, list[float]],
    ) -> None:
        self.tape, self.frame = tape, frame
        self._inputs, self._outputs = inputs, outputs
        self._slots: dict[int, int] = {}
        self._wanted = {
            i: outputs[number] + k
            for number, entries in reversed(list(enumerate(tape.outputs)))
            for k, i in enumerate(entries)
        }
        self._done: set[int] = set()
        self._last_use = _last_uses(tape)
        self._neighbourhood = _neighbourhoods(tape, homes)

    def compute(self, indices: Iterable[int], levels: Iterable[int]) -> Iterator[str]:
        """Calls that compute those of the operations on the levels that are not there yet."""
        wanted = set(levels)
        todo = [
            i for i in indices
            if self.tape.levels[i] in wanted and i not in self._done
            and self.tape.operations[i].code not in (ca.OP_CONST, ca.OP_INPUT)
        ]
        todo = self._neighbours_first(todo)
        for begin in range(0, len(todo), _LENGTH):
            yield self._part(todo[begin : begin + _LENGTH])

    def _neighbours_first(self, todo: list[int]) -> list[int]:
        """The same operations in an order that keeps those of one place together."""
        inside = set(todo)
        waiting = {
            i: len({k for k in _arguments(self.tape.operations[i]) if k in inside}) for i in todo
        }
        ready = [(self._neighbourhood[i], i) for i in todo if not waiting[i]]
        heapq.heapify(ready)
        order = []
        while ready:
            _, i = heapq.heappop(ready)
            order.append(i)
            for user in set(self._last_use[i]):
                if user in inside:
                    waiting[user] -= 1
                    if not waiting[user]:
                        heapq.heappush(ready, (self._neighbourhood[user], user))
        return order

    def _part(self, chunk: list[int]) -> str:
        e = Emitter(self.frame.lanes, self.frame.fused)
        values = _FramedValues(self, e)
        values.emit(chunk, range(6))
        inside = set(chunk)
        for i in chunk:
            if any(user not in inside for user in self._last_use[i]):
                wanted = self._wanted.get(i)
                self._slots[i] = self.frame.reserve(1) if wanted is None else wanted
                _store(e, values.name(i), self._slots[i])
        self._done |= inside
        return self.frame.define(e.lines, e.declarations)

    def output(self, number: int) -> Iterator[str]:
        """Calls that put those entries of an output into its region that do not lie there yet."""
        region = self._outputs[number]
        entries = [
            (i, region + k) for k, i in enumerate(self.tape.outputs[number])
            if self._slots.get(i) != region + k
        ]
        for begin in range(0, len(entries), _OUTPUTS):
            e = Emitter(self.frame.lanes, self.frame.fused)
            values = _FramedValues(self, e)
            for i, slot in entries[begin : begin + _OUTPUTS]:
                _store(e, values.name(i), slot)
            yield self.frame.define(e.lines, e.declarations)

    def slot(self, index: int) -> int:
        """Where the value of an operation lies."""
        operation = self.tape.operations[index]
        if operation.code == ca.OP_INPUT:
            return self._inputs[operation.arguments[0]] + operation.arguments[1]
        return self._slots[index]


class _FramedValues(Values):
    """Values of one part: those of other parts are loaded from the frame when first named."""

    def __init__(self, tape: FramedTape, emitter: Emitter) -> None:
        super().__init__(tape.tape, emitter)
        self._framed = tape

    def name(self, index: int) -> str:
        """Name (or literal) of an operation's value."""
        known = index in self._names or index in self._flags
        if not known and self.tape.operations[index].code != ca.OP_CONST:
            self._names[index] = _load(self.emitter, self._framed.slot(index))
        return super().name(index)


def _last_uses(tape: Tape) -> list[list[int]]:
    """The operations that use each one; an output counts as a use outside every part."""
    users: list[list[int]] = [[] for _ in tape.operations]
    for i, operation in enumerate(tape.operations):
        for argument in _arguments(operation):
            users[argument].append(i)
    for entries in tape.outputs:
        for i in entries:
            users[i].append(-1)
    return users


def _neighbourhoods(tape: Tape, homes_of: dict[int, list[float]]) -> list[float]:
    """Where in the inputs an operation is at home: the furthest entry it depends on, in (0, 1]."""
    homes: list[float] = []
    for operation in tape.operations:
        if operation.code == ca.OP_INPUT:
            number, entry = operation.arguments
            homes.append(homes_of[number][entry] if number in homes_of else 0.0)
        else:
            homes.append(max((homes[k] for k in _arguments(operation)), default=0.0))
    return homes


def _arguments(operation: Operation) -> tuple[int, ...]:
    return () if operation.code in (ca.OP_INPUT, ca.OP_CONST) else operation.arguments


def _load(e: Emitter, slot: int) -> str:
    address = e.assign(f"getelementptr {e.type}, ptr %frame, i64 {slot}")
    return e.assign(f"load {e.type}, ptr {address}, align 8")


def _store(e: Emitter, value: str, slot: int) -> None:
    address = e.assign(f"getelementptr {e.type}, ptr %frame, i64 {slot}")
    e.line(f"store {e.type} {value}, ptr {address}, align 8")
