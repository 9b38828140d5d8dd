"""Long straight-line code as short functions and loops that share a frame in memory.

One function of 50,000 lines costs the code generator seconds, fifty of 1,000 lines a fraction: the
allocation of registers is what grows faster than the code. What is alike from body to body is one
loop, whatever their number. Values that one part hands to another live in the frame; within a part,
or a round of a loop, they stay in registers.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from functools import cached_property

import casadi as ca
import numpy as np

from groupoid_gni.codegen.alike import Alike, Integers
from groupoid_gni.codegen.emitter import Emitter, Values
from groupoid_gni.codegen.sweeps import Loop, Straight, schedule
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

    What is alike from body to body is computed in loops (``sweeps``); the values of a class lie at
    equal distances.
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
        self._lines: dict[int, tuple[int, int]] = {}
        self._wanted = {
            i: outputs[number] + k
            for number, entries in reversed(list(enumerate(tape.outputs)))
            for k, i in enumerate(entries)
        }
        self._done = np.zeros(len(tape.operations), dtype=bool)
        self._part_of: Integers = np.full(len(tape.operations), -1, dtype=np.int64)
        self._parts = 0
        self._homes = homes
        self._alike = Alike.of(tape)

    @cached_property
    def _users(self) -> list[list[int]]:
        return _users(self.tape)

    @cached_property
    def _neighbourhood(self) -> list[float]:
        return _neighbourhoods(self.tape, self._homes)

    def compute(self, indices: Iterable[int], levels: Iterable[int]) -> Iterator[str]:
        """Calls that compute those of the operations on the levels that are not there yet."""
        wanted = set(levels)
        todo = [
            i for i in indices
            if self.tape.levels[i] in wanted and not self._done[i]
            and self.tape.operations[i].code not in (ca.OP_CONST, ca.OP_INPUT)
        ]
        if not todo:
            return
        scheduled = schedule(self._alike, todo)
        parts = [
            piece for part in scheduled
            for piece in ([part] if isinstance(part, Loop) else self._pieces(part, scheduled))
        ]
        for part in parts:
            self._number(part)
        self._reserve(todo)
        self._done[todo] = True
        for part in parts:
            yield self._loop(part) if isinstance(part, Loop) else self._straight(part.operations)

    def _pieces(self, part: Straight, scheduled: list[Straight | Loop]) -> list[Straight]:
        """Cut to length; what is left beside loops is little, and stays in its order."""
        order = part.operations
        if len(scheduled) == 1:
            order = self._neighbours_first(order)
        return [Straight(order[k : k + _LENGTH]) for k in range(0, len(order), _LENGTH)]

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
            for user in set(self._users[i]):
                if user in inside:
                    waiting[user] -= 1
                    if not waiting[user]:
                        heapq.heappush(ready, (self._neighbourhood[user], user))
        return order

    # Where values lie.

    def _number(self, part: Straight | Loop) -> None:
        """Give every part, and every round of a loop, a number of its own."""
        if isinstance(part, Straight):
            self._part_of[part.operations] = self._parts
            self._parts += 1
            return
        for i in part.operations:
            members = self._alike.members[self._alike.class_of[i]][part.begin : part.end]
            self._part_of[members] = self._parts + np.arange(len(members))
        self._parts += part.end - part.begin

    def _reserve(self, todo: list[int]) -> None:
        """Slots for those of the operations that another part or an output uses."""
        graph, inside = self._alike.graph, np.zeros(len(self._done), dtype=bool)
        inside[todo] = True
        leaves = inside[graph.source]
        leaves &= self._part_of[graph.source] != self._part_of[graph.user]
        handed = np.zeros(len(inside), dtype=bool)
        handed[graph.source[leaves]] = True
        handed[[i for i in self._wanted if inside[i]]] = True
        for i in np.flatnonzero(handed).tolist():
            number = int(self._alike.class_of[i])
            if number < 0:
                wanted = self._wanted.get(i)
                self._slots[i] = self.frame.reserve(1) if wanted is None else wanted
                continue
            if number not in self._lines:
                self._lines[number] = self._line(self._alike.members[number])
            first, distance = self._lines[number]
            self._slots[i] = first + distance * int(self._alike.place[i])

    def _line(self, members: Integers) -> tuple[int, int]:
        """Slot of place 0 and distance of the slots of a class: where an output wants them all."""
        places = np.flatnonzero(members >= 0)
        slots = np.array([self._wanted.get(i, -1) for i in members[places].tolist()])
        distance = int((slots[1] - slots[0]) // (places[1] - places[0]))
        if (slots >= 0).all() and (slots - slots[0] == distance * (places - places[0])).all():
            return int(slots[0] - distance * places[0]), distance
        return self.frame.reserve(len(members)), 1

    def slot(self, index: int) -> int:
        """Where the value of an operation lies."""
        operation = self.tape.operations[index]
        if operation.code == ca.OP_INPUT:
            return self._inputs[operation.arguments[0]] + operation.arguments[1]
        return self._slots[index]

    def distance(self, index: int, bundle: int) -> int:
        """How far the slots of an operation's class are apart, from one place to the next."""
        number = int(self._alike.class_of[index])
        if number < 0 or self._alike.bundle_of[index] != bundle:
            return 0
        if number in self._lines:
            return self._lines[number][1]
        places = np.flatnonzero(self._alike.members[number] >= 0)
        first, second = (self.slot(int(i)) for i in self._alike.members[number][places[:2]])
        return int((second - first) // (places[1] - places[0]))

    # Emitting.

    def _straight(self, chunk: list[int]) -> str:
        e = Emitter(self.frame.lanes, self.frame.fused)
        values = _FramedValues(self, e)
        values.emit(chunk, range(6))
        for i in chunk:
            if i in self._slots:
                _store(e, values.name(i), self._slots[i])
        return self.frame.define(e.lines, e.declarations)

    def _loop(self, loop: Loop) -> str:
        e = Emitter(self.frame.lanes, self.frame.fused)
        first, last = loop.begin, loop.end - 1
        if not loop.upwards:
            first, last = last, first
        e.line("br label %loop")
        e.label("loop")
        e.line(f"%place = phi i64 [ {first - loop.begin}, %entry ], [ %following, %loop ]")
        e.line(f"%following = add i64 %place, {1 if loop.upwards else -1}")
        values = _FramedValues(self, e, loop)
        for i in loop.operations:
            values.emit([i], range(6))
            if i in self._slots:
                _store(e, values.name(i), self._slots[i], values.base(i))
        e.line(f"%done = icmp eq i64 %place, {last - loop.begin}")
        e.line("br i1 %done, label %end, label %loop")
        e.label("end")
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


class _FramedValues(Values):
    """Values of one part: those of other parts are loaded from the frame when first named.

    In a loop operations stand for those of their class; the frame begins at ``base`` for them.
    """

    def __init__(self, tape: FramedTape, emitter: Emitter, loop: Loop | None = None) -> None:
        super().__init__(tape.tape, emitter)
        self._framed, self._in_loop = tape, loop
        self._bases: dict[int, str] = {0: "%frame"}

    def name(self, index: int) -> str:
        """Name (or literal) of an operation's value."""
        known = index in self._names or index in self._flags
        if not known and self.tape.operations[index].code != ca.OP_CONST:
            self._names[index] = _load(self.emitter, self._framed.slot(index), self.base(index))
        return super().name(index)

    def base(self, index: int) -> str:
        """Where the frame begins for an operation in the current round of the loop."""
        if self._in_loop is None:
            return "%frame"
        distance = self._framed.distance(index, self._in_loop.bundle)
        if distance not in self._bases:
            e = self.emitter
            moved = e.assign(f"mul i64 %place, {distance}")
            self._bases[distance] = e.assign(f"getelementptr {e.type}, ptr %frame, i64 {moved}")
        return self._bases[distance]


def _users(tape: Tape) -> list[list[int]]:
    """The operations that use each one."""
    users: list[list[int]] = [[] for _ in tape.operations]
    for i, operation in enumerate(tape.operations):
        for argument in _arguments(operation):
            users[argument].append(i)
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


def _load(e: Emitter, slot: int, base: str) -> str:
    address = e.assign(f"getelementptr {e.type}, ptr {base}, i64 {slot}")
    return e.assign(f"load {e.type}, ptr {address}, align 8")


def _store(e: Emitter, value: str, slot: int, base: str = "%frame") -> None:
    address = e.assign(f"getelementptr {e.type}, ptr {base}, i64 {slot}")
    e.line(f"store {e.type} {value}, ptr {address}, align 8")
