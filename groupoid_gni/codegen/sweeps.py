"""The order in which the operations of a large system are computed: sweeps over its bodies.

A sweep computes what is alike in neighbouring bodies in one loop, upwards or downwards, and what is
left in straight code between the sweeps. Elimination runs up the bodies and back substitution down,
so a loop has a direction as soon as it uses what it computed one place before.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from groupoid_gni.codegen.alike import Alike, Integers


@dataclass(frozen=True)
class Straight:
    """Operations that are computed one by one."""

    operations: list[int]


@dataclass(frozen=True)
class Loop:
    """``for place in begin ... end - 1`` (or back): the operations, given as those at ``begin``.

    bundle : whose places they are.
    """

    operations: list[int]
    bundle: int
    begin: int
    end: int
    upwards: bool


@dataclass(eq=False)
class _Sweep:
    """A loop while it is filled. direction: 1 upwards, -1 downwards, 0 either way."""

    stretch: tuple[int, int, int]
    direction: int = 0
    nodes: list[int] = field(default_factory=list)


_Phases = dict[int, tuple[list[int], list[_Sweep]]]


@dataclass(frozen=True)
class _Nodes:
    """What is scheduled as one: a class over a stretch, or a single operation.

    of : node of every operation, -1 outside.  stretches : (bundle, begin, end) of the nodes that
    are loops.  operations : at its first place, per node.
    """

    of: Integers
    stretches: list[tuple[int, int, int] | None]
    operations: list[int]


def schedule(alike: Alike, todo: Sequence[int]) -> list[Straight | Loop]:
    """Parts that compute the operations, each after what it depends on."""
    barred: set[tuple[int, int]] = set()
    while True:
        nodes = _nodes(alike, todo, barred)
        if not any(nodes.stretches):
            return [Straight(list(todo))]
        edges = _edges(alike, nodes)
        component, size = _components(edges, len(nodes.operations))
        bad = _not_a_sweep(nodes, edges, component)
        if not bad:
            return _parts(nodes, _phases(nodes, edges, component, size))
        barred |= {
            (int(alike.class_of[nodes.operations[k]]), int(alike.place[nodes.operations[k]]))
            for k in bad
        }


def _nodes(alike: Alike, todo: Sequence[int], barred: set[tuple[int, int]]) -> _Nodes:
    of: Integers = np.full(len(alike.class_of), -1, dtype=np.int64)
    inside = np.zeros(len(of), dtype=bool)
    inside[np.asarray(todo, dtype=np.int64)] = True
    stretches: list[tuple[int, int, int] | None] = []
    operations: list[int] = []
    for number, bundle in enumerate(alike.bundles):
        for begin, end in bundle.stretches:
            for c in bundle.classes:
                members = alike.members[c][begin:end]
                if (
                    alike.regular[c][begin:end].all() and inside[members].all()
                    and (c, begin) not in barred
                ):
                    of[members] = len(operations)
                    operations.append(int(members[0]))
                    stretches.append((number, begin, end))
    for i in todo:
        if of[i] < 0:
            of[i] = len(operations)
            operations.append(i)
            stretches.append(None)
    return _Nodes(of, stretches, operations)


def _edges(alike: Alike, nodes: _Nodes) -> Integers:
    """(from, to, place of the argument less place of the user), each once, (n, 3)."""
    graph = alike.graph
    source, user = nodes.of[graph.source], nodes.of[graph.user]
    inside = (source >= 0) & (user >= 0)
    offset = alike.place[graph.source[inside]] - alike.place[graph.user[inside]]
    return np.unique(np.stack([source[inside], user[inside], offset], axis=1), axis=0)


def _components(edges: Integers, count: int) -> tuple[Integers, Integers]:
    """Strongly connected component of every node, and the components' sizes."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ones = np.ones(len(edges), dtype=np.int8)
    graph = coo_array((ones, (edges[:, 0], edges[:, 1])), shape=(count, count))
    number, component = connected_components(graph, directed=True, connection="strong")
    return component.astype(np.int64), np.bincount(component, minlength=number)


def _not_a_sweep(nodes: _Nodes, edges: Integers, component: Integers) -> set[int]:
    """Loop nodes that wait for one another in a way that no loop in one direction serves."""
    within = edges[component[edges[:, 0]] == component[edges[:, 1]]]
    bad_components = set()
    found: dict[int, tuple[set[int], set[object]]] = {}
    for source, user, offset in within.tolist():
        signs, stretches = found.setdefault(int(component[user]), (set(), set()))
        signs.add((offset > 0) - (offset < 0))
        stretches |= {nodes.stretches[source], nodes.stretches[user]}
    for number, (signs, stretches) in found.items():
        if {1, -1} <= signs or len(stretches) > 1:
            bad_components.add(number)
    return {
        k for k, stretch in enumerate(nodes.stretches)
        if stretch is not None and int(component[k]) in bad_components
    }


def _phases(
    nodes: _Nodes, edges: Integers, component: Integers, size: Integers
) -> _Phases:
    """Per phase the single nodes and the sweeps, as early as possible.

    In a phase single nodes come first; a sweep may be joined by what depends on it place by place.
    """
    incoming: list[list[tuple[int, int]]] = [[] for _ in nodes.operations]
    outgoing: list[set[int]] = [set() for _ in size]
    for source, user, offset in edges.tolist():
        incoming[user].append((source, offset))
        if component[source] != component[user]:
            outgoing[component[source]].add(int(component[user]))
    parts: list[list[int]] = [[] for _ in size]
    for node, number in enumerate(component.tolist()):
        parts[number].append(node)
    phases: _Phases = {}
    placed: dict[int, tuple[int, _Sweep | None]] = {}
    for number in _in_order(outgoing):
        mine = parts[number]
        given = [
            (*placed[source], offset)
            for node in mine for source, offset in incoming[node] if component[source] != number
        ]
        stretch = nodes.stretches[mine[0]]
        if stretch is None:
            phase = max((p + (sweep is not None) for p, sweep, _ in given), default=0)
            phases.setdefault(phase, ([], []))[0].append(mine[0])
            placed[mine[0]] = phase, None
            continue
        own = [o for node in mine for s, o in incoming[node] if component[s] == number and o]
        phase, sweep = _joined(phases, given, stretch, 1 if min(own, default=0) < 0 else -bool(own))
        sweep.nodes += mine
        for node in mine:
            placed[node] = phase, sweep
    return phases


def _joined(
    phases: _Phases,
    given: list[tuple[int, _Sweep | None, int]],
    stretch: tuple[int, int, int],
    direction: int,
) -> tuple[int, _Sweep]:
    """The first sweep that can compute something of this stretch and direction."""
    phase = max((p for p, _, _ in given), default=0)
    while True:
        waits = {id(s) for p, s, _ in given if p == phase and s is not None}
        sweeps = phases.setdefault(phase, ([], []))[1]
        for sweep in [*sweeps, _Sweep(stretch)]:
            signs = {(o < 0) - (o > 0) for p, s, o in given if s is sweep and p == phase}
            signs |= {direction, sweep.direction}
            if waits <= {id(sweep)} and sweep.stretch == stretch and not {1, -1} <= signs:
                sweep.direction = 1 if 1 in signs else min(signs)
                if sweep not in sweeps:
                    sweeps.append(sweep)
                return phase, sweep
        phase += 1


def _in_order(outgoing: list[set[int]]) -> Iterable[int]:
    """Numbers of components, each after all that lead to it."""
    waiting = [0] * len(outgoing)
    for following in outgoing:
        for k in following:
            waiting[k] += 1
    ready = [k for k, left in enumerate(waiting) if not left]
    for number in ready:
        for k in outgoing[number]:
            waiting[k] -= 1
            if not waiting[k]:
                ready.append(k)
    return ready


def _parts(nodes: _Nodes, phases: _Phases) -> list[Straight | Loop]:
    found: list[Straight | Loop] = []
    for _, (single, sweeps) in sorted(phases.items()):
        if single:
            found.append(Straight(sorted(nodes.operations[k] for k in single)))
        for sweep in sweeps:
            operations = sorted(nodes.operations[k] for k in sweep.nodes)
            found.append(Loop(operations, *sweep.stretch, sweep.direction >= 0))
    return found
