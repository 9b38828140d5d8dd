"""Large programs in memory: the bits of the plain kernel, whatever the program and the lanes."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.codegen import MachineCode, machine_has_fused_products, step_kernel_ir
from groupoid_gni.codegen.frame_parts import Frame, FramedTape
from groupoid_gni.codegen.framed_kernel import FramedKernel
from groupoid_gni.codegen.step_kernel import FRAMED_PROGRAM, StepKernel, step_function, step_tape
from groupoid_gni.codegen.tape import Tape
from groupoid_gni.integrators import compiled_step
from groupoid_gni.integrators.preparation import Starts, prepare

FUSED = machine_has_fused_products()


def skates() -> tuple[Any, Any]:
    scene = gni.scenes.chain_of_skates(3)
    return scene.system, scene.start


def animal(name: str, m: int, **options: Any) -> tuple[Any, Any]:
    made = zoo.animal(name, m, **options)
    return made.system, made.start


def falling() -> tuple[Any, Any]:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.8]), constraints=[[0.4, -1.0]],
        potential=lambda x, p: -p.k * (x @ x) ** 3, parameters={"k": 0.4},
    )
    return system, system.state([1.1, -0.7], [0.5, 0.2])


def chain(skates: int) -> tuple[Any, Any]:
    scene = gni.scenes.chain_of_skates(skates, mass=1.1, tether=0.3)
    return scene.system, scene.start


def ring_and_row() -> tuple[Any, Any]:
    """Particles on a ring and particles in a row, each with a constraint of its own."""
    n, m = 7, 6

    def potential(x: Any, p: Any) -> Any:
        ring, row = x[:n], x[2 * n : 2 * n + m]
        closed = ring - np.concatenate([ring[1:], ring[:1]])
        return p.k * (closed**2).sum() / 2 + ((row[1:] - row[:-1]) ** 4).sum() / 4 + x @ x / 9

    def constraints(x: Any, p: Any) -> Any:
        rows = [[0.0] * (2 * (n + m)) for _ in range(n + m)]
        for k in range(n):
            rows[k][k], rows[k][n + k] = np.cos(x[k]), np.sin(x[k])
        for k in range(m):
            rows[n + k][2 * n + k], rows[n + k][2 * n + m + k] = 1.0, 0.3 * x[2 * n + k]
        return np.array(rows)

    system = gni.MechanicalSystem(
        gni.PairGroupoid(2 * (n + m)), metric=np.diag(np.tile([1.3, 0.8], n + m)),
        constraints=constraints, potential=potential, parameters={"k": 0.7},
    )
    rng = np.random.default_rng(5)
    base, velocity = rng.uniform(-0.5, 0.5, (2, 2 * (n + m)))
    return system, system.state(base, velocity, project_start=True)


CASES = {
    "skates, explicit": (skates, gni.Rattle()),
    "skates, projected": (skates, gni.GNI()),
    "skates, bare composition": (skates, gni.GNI(4, flow=gni.Splitting(), projection=None)),
    "framed, affine, composed": (lambda: animal("framed left cay", 2, affine=True), gni.GNI(4)),
    "SE(3), sines": (lambda: animal("SE3 left exp", 2), gni.McLachlanPerlmutter()),
    "no constraint": (lambda: animal("pair 3", 0), gni.GNI()),
    "falling": (falling, gni.GNI()),
    "chain, explicit": (lambda: chain(11), gni.Rattle()),
    "chain, projected": (lambda: chain(9), gni.GNI()),
    "chain, exact energy": (lambda: chain(9), gni.GNI(flow=gni.EnergyPreserving())),
    "chain, bare composition": (
        lambda: chain(10), gni.GNI(4, flow=gni.Splitting(), projection=None)
    ),
    "chain, composed": (lambda: chain(8), gni.GNI(4)),
    "chain, Lagrange-d'Alembert": (lambda: chain(8), gni.DiscreteLagrangeDAlembert()),
    "ring and row, projected": (ring_and_row, gni.GNI()),
    "ring and row, explicit": (ring_and_row, gni.McLachlanPerlmutter()),
}


class Loop:
    """``advance`` of one kind of kernel over W lanes."""

    def __init__(self, kernel: Any, program: Any, lanes: int) -> None:
        self.program, self.lanes = program, lanes
        self.code = MachineCode(kernel(program, step_tape(program), lanes, FUSED).text())
        kinds = [ctypes.c_void_p] * 5 + [ctypes.c_int64] * 3
        self._advance = self.code.function("advance", *kinds, returns=ctypes.c_int64)

    def __call__(self, parameters: Any, state: Any, memory: Any, count: int, every: int) -> Any:
        rows = np.zeros((count // every, self.program.row_size, self.lanes))
        status = np.zeros((2, self.lanes), dtype=np.int64)
        arrays = [np.array(a, order="C") for a in (parameters, state, memory)]
        pointers = [a.ctypes.data for a in (*arrays, rows, status)]
        done = self._advance(*pointers, 0, count, every)
        return rows, arrays[1], arrays[2], status, int(done)


@cache
def loops(case: str, lanes: int) -> tuple[Any, Loop, Loop, tuple[Any, Any, Any]]:
    make, method = CASES[case]
    system, start = make()
    runner = compiled_step(system, method, start.active_rows)
    members = prepare(system, runner, Starts.of(system, [start] * lanes, None), 0.05, None)
    parameters = members.parameters * (1 + 0.02 * np.arange(lanes))
    memory = runner.first_memories(parameters, members.states)
    kernels = (Loop(kind, runner.program, lanes) for kind in (StepKernel, FramedKernel))
    return runner.program, *kernels, (parameters, members.states, memory)


@pytest.mark.parametrize("lanes", [1, 4])
@pytest.mark.parametrize("case", [name for name in CASES if name != "falling"])
def test_the_bits_are_those_of_the_plain_kernel(case, lanes):
    program, plain, framed, begin = loops(case, lanes)
    count = 12 * program.stages
    expected = plain(*begin, count, 2 * program.stages)
    got = framed(*begin, count, 2 * program.stages)
    assert got[4] == expected[4] == count
    for left, right in zip(got[:4], expected[:4], strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("lanes", [1, 4])
def test_failures_are_told_with_the_same_code_at_the_same_stage(lanes):
    _, plain, framed, begin = loops("falling", lanes)
    expected, got = plain(*begin, 200, 1), framed(*begin, 200, 1)
    assert expected[3][0].all()
    np.testing.assert_array_equal(got[3], expected[3])
    np.testing.assert_array_equal(got[1], expected[1])
    assert got[4] == expected[4]


@pytest.mark.parametrize("length", [1, 7, 100])
def test_where_parts_are_cut_changes_nothing(length, monkeypatch):
    monkeypatch.setattr("groupoid_gni.codegen.frame_parts._LENGTH", length)
    program, plain, _, begin = loops("skates, projected", 1)
    cut = Loop(FramedKernel, program, 1)
    np.testing.assert_array_equal(cut(*begin, 6, 1)[0], plain(*begin, 6, 1)[0])


def test_large_programs_are_cut_and_small_ones_are_not():
    small, large = gni.scenes.chain_of_skates(2), gni.scenes.chain_of_skates(28)
    rows = tuple(range(28))
    assert "@part0" not in small.system.compiled(gni.GNI()).source
    program = compiled_step(large.system, gni.GNI(), rows).program
    assert len(Tape.of(step_function(program)).operations) > FRAMED_PROGRAM
    text = step_kernel_ir(program, 1, FUSED)
    assert text.count("define internal void @part") > 10
    assert text.count("%place = phi") > 5
    run = gni.integrate(large.system, large.start, step=0.02, n_steps=20)
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-15
    slow = gni.integrate(large.system, large.start, step=0.02, n_steps=3, compile=False)
    np.testing.assert_allclose(run.momenta[:4], slow.momenta, rtol=0, atol=1e-13)


@pytest.mark.parametrize("case", [name for name in CASES if "chain," in name or "ring" in name])
def test_bodies_that_are_alike_are_computed_in_loops(case):
    make, method = CASES[case]
    system, start = make()
    program = compiled_step(system, method, start.active_rows).program
    tape = step_tape(program)
    text = FramedKernel(program, tape, 1, FUSED).text()
    assert text.count("%place = phi") >= 3


def test_the_code_of_a_long_chain_does_not_grow_with_it():
    lines = []
    for skates in (40, 80):
        scene = gni.scenes.chain_of_skates(skates)
        lines.append(scene.system.compiled(gni.Rattle()).source.count("\n"))
    assert lines[1] < 1.4 * lines[0]


def test_control_inputs_and_poses_go_through_memory_too():
    system = gni.MechanicalSystem(
        gni.SE2(), metric=np.diag([0.8, 1.3, 1.3]), constraints=[[0.0, 0.0, 1.0]],
        force=lambda x, xi, p, u: np.array([u[0], u[1], 0.0]) - 0.2 * xi, controls=2,
    )
    inputs = np.random.default_rng(3).uniform(-1, 1, (9, 2))
    options = {
        "step": 0.1, "n_steps": 9, "controls": inputs, "reconstruct": True, "method": gni.GNI(4)
    }
    start = system.state(velocity=[0.4, 0.7, 0.0])
    expected = gni.integrate(system, start, **options)
    key = (gni.GNI(4), (0,), True, True)
    runner = system._compiled[key]
    code = MachineCode(
        FramedKernel(runner.program, step_tape(runner.program), 1, FUSED).text()
    )
    system._compiled[key] = type(runner)(runner.program, code)
    np.testing.assert_array_equal(gni.integrate(system, start, **options).rows, expected.rows)


def test_values_used_in_one_part_only_take_no_room():
    program = loops("skates, projected", 1)[0]
    tape = Tape.of(step_function(program)).optimised()
    frame = Frame(1, FUSED)
    inputs = {k: frame.reserve(400) for k in range(5)}
    outputs = {k: frame.reserve(400) for k in range(7)}
    before = frame.size
    framed = FramedTape(tape, frame, inputs, outputs, {})
    calls = list(framed.compute(tape.needed(range(7)), range(6)))
    assert len(calls) == len(frame.functions) > 3
    assert frame.size - before < 0.5 * len(tape.operations)
