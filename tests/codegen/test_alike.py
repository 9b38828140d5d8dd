"""Classes of alike operations and the sweeps over them, on random tapes with and without bodies."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni.codegen.alike import FEWEST, Alike
from groupoid_gni.codegen.step_kernel import step_tape
from groupoid_gni.codegen.sweeps import Loop, Straight, schedule
from groupoid_gni.codegen.tape import Tape
from groupoid_gni.integrators import compiled_step

LEAVES = (ca.OP_CONST, ca.OP_INPUT)


def chain_tape(bodies: int, seed: int, spoilt: int = -1) -> Tape:
    """Random recurrences up and down a row of bodies of three coordinates.

    spoilt : a body that is given another formula, or none.
    """
    rng = np.random.default_rng(seed)
    common, q = ca.SX.sym("common", 2), ca.SX.sym("q", 3 * bodies)
    body = [q[3 * k : 3 * k + 3] for k in range(bodies)]
    kinds = rng.integers(0, 4, 5)

    def mix(k: int, a: ca.SX, b: ca.SX, kind: int) -> ca.SX:
        x = body[k]
        if k == spoilt:
            return a * ca.exp(b) - x[1]
        choices = (
            lambda: a * ca.sin(x[0]) + b * common[0],
            lambda: (a - b) / (2.5 + x[1] * x[1]),
            lambda: a * b + x[2] * 0.7,
            lambda: ca.sqrt(1.3 + a * a) - b * x[0],
        )
        return choices[kind]()

    values = [body[k][0] * common[1] + body[k][2] for k in range(bodies)]
    for kind in kinds:
        direction = int(rng.integers(0, 3))
        new = list(values)
        order = range(bodies) if direction == 0 else reversed(range(bodies))
        for k in order:
            other = k - 1 if direction == 0 else k + 1
            source = values if direction == 2 else new
            inside = 0 <= other < bodies
            new[k] = mix(k, values[k], source[other] if inside else common[0], int(kind))
        values = new
    return Tape.of(ca.Function("f", [common, q], [ca.vertcat(*values)])).optimised()


def replayed(alike: Alike, tape: Tape, parts: list[Straight | Loop]) -> list[int]:
    """Operations in the order in which the parts compute them; loops are held to what they say."""
    order = []
    for part in parts:
        if isinstance(part, Straight):
            order += part.operations
            continue
        places = range(part.begin, part.end)
        for k in places if part.upwards else reversed(places):
            for first in part.operations:
                i = int(alike.members[alike.class_of[first]][k])
                assert alike.bundle_of[first] == part.bundle
                assert_moved(alike, tape, first, i, k - part.begin)
                order.append(i)
    return order


def assert_moved(alike: Alike, tape: Tape, first: int, other: int, places: int) -> None:
    """``other`` is ``first`` a number of places further, arguments and all."""
    a, b = tape.operations[first], tape.operations[other]
    assert a.code == b.code
    for x, y in zip(a.arguments, b.arguments, strict=True):
        if tape.operations[x].code == ca.OP_CONST:
            assert tape.operations[x] == tape.operations[y]
        elif alike.bundle_of[x] == alike.bundle_of[first]:
            assert alike.class_of[x] == alike.class_of[y]
            assert alike.place[y] - alike.place[x] == places
        else:
            assert x == y


def assert_complete_and_in_order(tape: Tape, todo: list[int], order: list[int]) -> None:
    assert sorted(order) == sorted(todo)
    when = {i: n for n, i in enumerate(order)}
    for i in order:
        for argument in tape.operations[i].arguments:
            if argument in when:
                assert when[argument] < when[i]


def computed(tape: Tape) -> list[int]:
    return [i for i in tape.needed([0]) if tape.operations[i].code not in LEAVES]


@settings(max_examples=60, deadline=None)
@given(bodies=st.integers(1, 17), seed=st.integers(0, 10_000), spoilt=st.integers(-1, 16))
def test_sweeps_compute_everything_once_and_after_its_arguments(bodies, seed, spoilt):
    tape = chain_tape(bodies, seed, spoilt)
    alike, todo = Alike.of(tape), computed(tape)
    assert_complete_and_in_order(tape, todo, replayed(alike, tape, schedule(alike, todo)))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), kept=st.floats(0.2, 0.9))
def test_any_part_of_the_operations_can_be_scheduled(seed, kept):
    tape = chain_tape(14, seed)
    rng = np.random.default_rng(seed)
    alike, todo = Alike.of(tape), [i for i in computed(tape) if rng.uniform() < kept]
    order = replayed(alike, tape, schedule(alike, todo))
    assert sorted(order) == todo


@pytest.mark.parametrize("seed", range(6))
def test_a_long_row_leaves_few_operations_outside_loops(seed):
    tape = chain_tape(60, seed)
    alike, todo = Alike.of(tape), computed(tape)
    parts = schedule(alike, todo)
    single = sum(len(p.operations) for p in parts if isinstance(p, Straight))
    assert single < 0.25 * len(todo)
    assert sum(isinstance(p, Loop) for p in parts) <= 6


def test_a_spoilt_body_stays_outside_the_loops():
    tape = chain_tape(40, 3, spoilt=20)
    alike = Alike.of(tape)
    exponential = next(i for i, o in enumerate(tape.operations) if o.code == ca.OP_EXP)
    parts = schedule(alike, computed(tape))
    assert any(isinstance(p, Straight) and exponential in p.operations for p in parts)
    assert sum(p.end - p.begin for p in parts if isinstance(p, Loop)) > 20


def test_what_runs_up_and_down_at_once_is_not_a_loop():
    q = ca.SX.sym("q", 24)
    values = [ca.sin(q[k]) for k in range(24)]
    for k in (*range(1, 24, 2), *range(2, 24, 2)):
        values[k] = values[k] * values[k - 1]
    tape = Tape.of(ca.Function("f", [ca.SX.sym("p"), q], [ca.vertcat(*values)])).optimised()
    alike, todo = Alike.of(tape), computed(tape)
    assert_complete_and_in_order(tape, todo, replayed(alike, tape, schedule(alike, todo)))


def test_dense_programs_without_bodies_are_left_alone():
    q = ca.SX.sym("q", 3)
    value = ca.sin(q[0]) * q[1] + ca.exp(q[2]) / q[0]
    tape = Tape.of(ca.Function("f", [ca.SX.sym("p"), q], [value])).optimised()
    alike = Alike.of(tape)
    assert not any(bundle.stretches for bundle in alike.bundles)
    assert schedule(alike, computed(tape)) == [Straight(computed(tape))]


def test_members_are_one_stride_apart_in_their_input():
    scene = gni.scenes.chain_of_skates(12)
    rows = scene.start.active_rows
    tape = step_tape(compiled_step(scene.system, gni.GNI(), rows).program)
    alike = Alike.of(tape)
    inputs = [
        m[m >= 0] for m in alike.members
        if (m >= 0).any() and tape.operations[int(m.max())].code == ca.OP_INPUT
    ]
    assert len(inputs) > 5
    for members in inputs:
        entries = np.array([tape.operations[int(i)].arguments for i in members])
        assert len(np.unique(entries[:, 0])) == 1
        assert len(members) < FEWEST or len(np.unique(np.diff(entries[:, 1]))) == 1
