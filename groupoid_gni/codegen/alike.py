"""Operations that are alike from body to body of a large system.

Found on the graph of operations itself: operations whose surroundings look the same and that touch
entries of an input in arithmetic progression are the first class; from there all members are
followed in step along arguments and users, and what is reached side by side is the next class.
Member k of every class then belongs to the same body, and "the value of the next body" is an
offset. Nothing here decides what is computed: classes that are not alike after all cost a loop.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from groupoid_gni.codegen.tape import Tape

FEWEST = 4
"""Members below which a class is not worth a loop."""
_MARGIN = 4
"""Places kept free before the first and after the last member of a bundle."""
_ROUNDS = 2
_PROBES = 3
_STRIDES = 3
"""Sizes of a body that are tried."""
_TRIMMED = 12
"""Places that may be cut off at each end of a stretch."""

Integers = npt.NDArray[np.int64]
_Hashes = npt.NDArray[np.uint64]


def _mixed(values: npt.NDArray[np.integer]) -> _Hashes:
    """A hash of every entry."""
    x = values.astype(np.uint64)
    for shift in (31, 29):
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(0x9E3779B97F4A7C15)
    return x ^ (x >> np.uint64(32))


class Graph:
    """A tape as arrays.

    codes : operation codes, (n,).  arguments : (n, 3), -1 where there is none (inputs and constants
    have none).  colours : hash of an operation's surroundings to two edges' distance, (n,).
    source, user, position : the edges, argument to operation.
    """

    def __init__(self, tape: Tape) -> None:
        operations = tape.operations
        n = len(operations)
        self.codes: Integers = np.fromiter((o.code for o in operations), np.int64, n)
        self.arguments: Integers = np.full((n, 3), -1, dtype=np.int64)
        self.constants: Integers = np.zeros(n, dtype=np.int64)
        self.entries: Integers = np.zeros((n, 2), dtype=np.int64)
        for i, operation in enumerate(operations):
            if operation.code == ca.OP_INPUT:
                self.entries[i] = operation.arguments
            elif operation.code == ca.OP_CONST:
                self.constants[i] = hash(operation.value)
            else:
                self.arguments[i, : len(operation.arguments)] = operation.arguments
        self.user, self.position = np.nonzero(self.arguments >= 0)
        self.source: Integers = self.arguments[self.user, self.position]
        self.colours = self._coloured()
        keys = self._keys(self.source, self.colours[self.user], self.position)
        order = np.argsort(keys, kind="stable")
        self._edge_keys, self._edge_users = keys[order], self.user[order]

    def _coloured(self) -> _Hashes:
        start = _mixed(self.codes + 1000) + _mixed(self.constants) + _mixed(self.entries[:, 0])
        colours = _mixed(start)
        for _ in range(_ROUNDS):
            around = _mixed(colours)
            place = (self.position + 2).astype(np.uint64)
            np.add.at(around, self.user, _mixed(colours[self.source] * place))
            np.add.at(around, self.source, _mixed(colours[self.user] * (place + np.uint64(9))))
            colours = _mixed(around)
        return colours

    @staticmethod
    def _keys(source: Integers, colours: _Hashes, position: Integers) -> _Hashes:
        return _mixed(_mixed(source) + colours * (position + 3).astype(np.uint64))

    def seeds(self) -> list[tuple[int, Integers]]:
        """Operations of one colour that read an input in arithmetic progression, longest first.

        With the difference of the progression: how many entries a body has.
        """
        reads = self.codes[self.source] == ca.OP_INPUT
        users, sources = self.user[reads], self.source[reads]
        colours = self.colours[users] + _mixed(self.position[reads])
        order = np.lexsort((self.entries[sources, 1], colours))
        users, sources, colours = users[order], sources[order], colours[order]
        cuts = np.flatnonzero(colours[1:] != colours[:-1]) + 1
        found = []
        for mine, read in zip(np.split(users, cuts), np.split(sources, cuts), strict=True):
            entries = self.entries[read, 1]
            begin, end = _longest_progression(entries)
            if end - begin >= FEWEST and len(set(mine[begin:end].tolist())) == end - begin:
                found.append((int(entries[begin + 1] - entries[begin]), mine[begin:end]))
        return sorted(found, key=lambda seed: (-len(seed[1]), int(seed[1][0])))

    def user_kinds(self, index: int) -> list[tuple[int, int]]:
        """(user, position) of every use of an operation."""
        mine = np.flatnonzero(self.source == index)
        return [(int(self.user[k]), int(self.position[k])) for k in mine]

    def users_like(self, sources: Integers, user: int, position: int) -> Integers:
        """For every source its only user of that colour and position, or -1."""
        known = np.maximum(sources, 0)
        colour = np.full(len(sources), self.colours[user])
        keys = self._keys(known, colour, np.full(len(sources), position))
        first = np.searchsorted(self._edge_keys, keys, "left")
        last = np.searchsorted(self._edge_keys, keys, "right")
        found = self._edge_users[np.minimum(first, len(self._edge_users) - 1)]
        return np.where((sources >= 0) & (last - first == 1), found, -1)


@dataclass
class Bundle:
    """Classes that share the numbering of their members.

    size : places.  classes : their numbers.  stretches : (begin, end) of places in which nearly all
    classes are alike.
    """

    size: int
    classes: list[int] = field(default_factory=list)
    stretches: list[tuple[int, int]] = field(default_factory=list)


class Alike:
    """The classes of a tape.

    members : per class its operations by place, -1 where there is none.  bundles : see ``Bundle``.
    class_of, place, bundle_of : per operation, -1 without a class.  regular : per class and place,
    whether the member has the arguments of most members, moved along.
    """

    def __init__(self, graph: Graph, seeds: Iterable[Integers]) -> None:
        """Grow bundles from the seeds, in their order; ``Alike.of`` tries several orders."""
        self.graph = graph
        n = len(self.graph.codes)
        self.class_of: Integers = np.full(n, -1, dtype=np.int64)
        self.place: Integers = np.zeros(n, dtype=np.int64)
        self.bundle_of: Integers = np.full(n, -1, dtype=np.int64)
        self.members: list[Integers] = []
        self.bundles: list[Bundle] = []
        self._constant = self.graph.codes == ca.OP_CONST
        self._input = self.graph.codes == ca.OP_INPUT
        for seed in seeds:
            if (self.class_of[seed] < 0).all():
                self._grow(seed)
        self._keep_progressions()
        self.regular = [self._regular(number) for number in range(len(self.members))]
        for bundle in self.bundles:
            bundle.stretches = self._stretches(bundle)

    @classmethod
    def of(cls, tape: Tape) -> Alike:
        """The classes that leave few operations outside loops.

        A body has one coordinate or several; what belongs to every coordinate and what belongs to
        every body both look alike, and which of the two is followed decides what is found.
        """
        graph = Graph(tape)
        seeds = graph.seeds()
        strides = list(dict.fromkeys(stride for stride, _ in seeds))[:_STRIDES]
        best = cls(graph, [])
        for chosen in strides:
            first = [seed for stride, seed in seeds if stride == chosen]
            tried = cls(graph, first + [seed for stride, seed in seeds if stride != chosen])
            best = max(best, tried, key=cls.covered)
            if best.covered() > len(graph.source) / 4:
                break
        return best

    def covered(self) -> int:
        """Operations that loops can compute."""
        return sum(
            (end - begin) * int(self.regular[number][begin:end].all())
            for bundle in self.bundles for begin, end in bundle.stretches
            for number in bundle.classes
        )

    def _grow(self, seed: Integers) -> None:
        """A new bundle from a seed: follow arguments and users of all members in step."""
        bundle = Bundle(len(seed) + 2 * _MARGIN)
        self.bundles.append(bundle)
        first = np.full(bundle.size, -1, dtype=np.int64)
        first[_MARGIN : _MARGIN + len(seed)] = seed
        self._take(first)
        for number in bundle.classes:
            for reached in self._neighbours(self.members[number]):
                self._take(reached)

    def _neighbours(self, members: Integers) -> list[Integers]:
        graph = self.graph
        there = np.maximum(members, 0)
        found = [np.where(members >= 0, graph.arguments[there, p], -1) for p in range(3)]
        present = members[members >= 0]
        probes = present[np.linspace(0, len(present) - 1, _PROBES + 2).astype(int)[1:-1]]
        seen = set()
        for probe in probes.tolist():
            for user, position in graph.user_kinds(probe):
                kind = (int(graph.colours[user]), position)
                if kind not in seen:
                    seen.add(kind)
                    found.append(graph.users_like(members, user, position))
        return found

    def _take(self, reached: Integers) -> None:
        """Operations reached in step: members of a class that is there, or a new class."""
        bundle = self.bundles[-1]
        there = reached >= 0
        there[there] = ~self._constant[reached[there]]
        free = there.copy()
        free[there] = self.class_of[reached[there]] < 0
        if not free.any():
            return
        if self._extended(reached, there & ~free, free):
            return
        codes = self.graph.codes[reached[free]]
        free[free] = codes == _commonest(codes)
        chosen = reached[free]
        if len(chosen) < FEWEST or len(np.unique(chosen)) != len(chosen):
            return
        number = len(self.members)
        self.members.append(np.where(free, reached, -1))
        bundle.classes.append(number)
        self._assign(number, np.flatnonzero(free), chosen)

    def _extended(self, reached: Integers, known: npt.NDArray[np.bool_],
                  free: npt.NDArray[np.bool_]) -> bool:
        """Whether most of those reached are one class already; the others join it if they fit."""
        mine = known.copy()
        mine[known] = self.bundle_of[reached[known]] == len(self.bundles) - 1
        if mine.sum() < FEWEST or mine.sum() < free.sum():
            return False
        number = int(_commonest(self.class_of[reached[mine]]))
        places = np.flatnonzero(mine)
        places = places[self.class_of[reached[places]] == number]
        offsets = self.place[reached[places]] - places
        offset = int(np.median(offsets))
        members = self.members[number]
        code = self.graph.codes[reached[places[0]]]
        for k in np.flatnonzero(free).tolist():
            target, index = k + offset, int(reached[k])
            if (
                0 <= target < len(members) and members[target] < 0
                and self.class_of[index] < 0 and self.graph.codes[index] == code
            ):
                members[target] = index
                self._assign(number, np.array([target]), np.array([index]))
        return True

    def _assign(self, number: int, places: Integers, operations: Integers) -> None:
        self.class_of[operations] = number
        self.place[operations] = places
        self.bundle_of[operations] = len(self.bundles) - 1

    def _keep_progressions(self) -> None:
        """Entries of an input that do not advance evenly leave their class."""
        for members in self.members:
            places = np.flatnonzero(members >= 0)
            if not self._input[members[places[0]]]:
                continue
            operations = members[places]
            numbers, entries = self.graph.entries[operations].T
            step = _commonest(np.diff(entries) // np.maximum(np.diff(places), 1))
            origins = entries - step * places + numbers * (1 << 40)
            strange = origins != _commonest(origins)
            self.class_of[operations[strange]] = -1
            self.bundle_of[operations[strange]] = -1
            members[places[strange]] = -1

    def _regular(self, number: int) -> npt.NDArray[np.bool_]:
        members = self.members[number]
        there = np.flatnonzero(members >= 0)
        operations = members[there]
        regular = np.zeros(len(members), dtype=bool)
        alike = np.ones(len(there), dtype=bool)
        if not len(there) or self._input[operations[0]]:
            return regular
        for position in range(3):
            patterns = self._patterns(operations, self.graph.arguments[operations, position])
            alike &= patterns == _commonest(patterns)
        regular[there] = alike
        return regular

    def _patterns(self, operations: Integers, arguments: Integers) -> _Hashes:
        """What an argument is, seen from its operation."""
        known = np.maximum(arguments, 0)
        together = (self.bundle_of[known] == self.bundle_of[operations]) & (arguments >= 0)
        offsets = self.place[known] - self.place[operations]
        moved = _mixed(self.class_of[known]) + _mixed(offsets + 1_000_000) * np.uint64(3)
        constant = _mixed(self.graph.constants[known]) * np.uint64(5)
        fixed = _mixed(arguments + 7) * np.uint64(7)
        return np.where(
            together, moved, np.where(self._constant[known] & (arguments >= 0), constant, fixed)
        )

    def _stretches(self, bundle: Bundle) -> list[tuple[int, int]]:
        """Runs of places in which most classes are regular, cut so that loops cover the most."""
        regular = np.array([self.regular[number] for number in bundle.classes])
        counts = regular.sum(axis=0)
        good = np.flatnonzero(counts >= max(1, counts.max() / 2))
        runs = np.split(good, np.flatnonzero(np.diff(good) > 1) + 1)
        found = [_best_cut(regular, int(run[0]), int(run[-1]) + 1) for run in runs if len(run)]
        return [(begin, end) for begin, end in found if end - begin >= FEWEST]


def _best_cut(regular: npt.NDArray[np.bool_], begin: int, end: int) -> tuple[int, int]:
    """The part of a run in which the classes that are regular throughout do the most."""
    bad = np.cumsum(np.pad(~regular, ((0, 0), (1, 0))), axis=1)
    best, most = (begin, begin), 0
    for first in range(begin, min(begin + _TRIMMED, end)):
        for last in range(end, max(end - _TRIMMED, first), -1):
            covered = int((bad[:, last] == bad[:, first]).sum()) * (last - first)
            if covered > most:
                best, most = (first, last), covered
    return best


def _commonest(values: npt.NDArray[Any]) -> Any:
    """The value that occurs most often; of several the smallest."""
    found, counts = np.unique(values, return_counts=True)
    return found[counts.argmax()]


def _longest_progression(entries: Integers) -> tuple[int, int]:
    """Begin and end of the longest stretch of sorted entries with one positive difference."""
    steps = np.diff(entries)
    best, begin = (0, 0), 0
    for k in range(1, len(steps) + 1):
        if k == len(steps) or steps[k] != steps[begin]:
            if steps[begin] > 0 and k + 1 - begin > best[1] - best[0]:
                best = (begin, k + 1)
            begin = k
    return best
