"""The cost model counts what the emitted code does."""

import re

import casadi as ca
import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.codegen import machine_has_fused_products, operations_by_place, step_kernel_ir
from groupoid_gni.codegen.tape import Tape
from groupoid_gni.integrators import step_program
from groupoid_gni.reports import KINDS, cost
from groupoid_gni.reports.cost_model import counted


def test_kinds_of_a_small_function():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    function = ca.Function("f", [a, b], [ca.sin(a) * b + ca.sqrt(b), a / b - ca.exp(a)])
    tape = Tape.of(function).optimised()
    found = counted(tape.operations[i] for i in tape.needed([0, 1]))
    assert found == {"multiply-add": 1, "add": 1, "multiply": 0, "divide": 1, "square root": 1,
                     "sine": 1, "other": 1}  # fmt: skip
    assert tuple(found) == KINDS


@pytest.mark.parametrize("method", [gni.Rattle(), gni.GNI(), gni.GNI(order=4)], ids=str)
def test_divisions_and_roots_are_those_of_the_emitted_lines(method):
    scene = gni.scenes.veselova()
    program = step_program(scene.system, method, scene.start.active_rows)
    ir = step_kernel_ir(program, 1, machine_has_fused_products())
    places = {k: counted(v) for k, v in operations_by_place(program).items()}
    total = {kind: sum(place[kind] for place in places.values()) for kind in KINDS}
    # one division more: the stopping rule of Newton's iteration
    assert len(re.findall(r"= fdiv ", ir)) == total["divide"] + 1
    loop = ir.split("\nnewton:")[1].split("\nsettled:")[0]
    assert len(re.findall(r"= fdiv ", loop)) == places["iteration"]["divide"] + 1
    roots = len(re.findall(r"call double @llvm\.sqrt", ir))
    assert roots == total["square root"]


def test_an_explicit_step_has_no_iteration():
    scene = gni.scenes.constrained_particle(1.3, 0.9, 0.7)
    found = cost(scene, gni.Rattle(), n_steps=50, repeats=2)
    assert (found.unknowns, found.iterations) == (0, 0.0)
    assert sum(found.operations["iteration"].values()) == 0
    assert found.per_step() == sum(found.operations["stage"].values())


def test_the_cost_of_a_composition_is_that_of_its_stages():
    scene = gni.scenes.suslov()
    found = cost(scene, gni.GNI(order=4), step=0.05, n_steps=100, repeats=2)
    run = gni.integrate(
        scene.system, scene.start, step=0.05, n_steps=100, method=gni.GNI(order=4)
    )
    assert found.iterations == run.rows[-1, -1] / 100
    inside = sum(found.operations["iteration"].values())
    outside = sum(found.operations["stage"].values())
    assert found.stages == 5
    assert found.per_step() == pytest.approx(5 * outside + found.iterations * inside)
    kinds = sum(found.per_step(kind) for kind in KINDS)
    assert found.per_step() == pytest.approx(kinds)
    assert found.nanoseconds > 0.0
    assert found.state_size == 3
    assert 0.0 < found.build.emit < found.build.total
    for text in ("multiply-add", "iteration", "stages per step 5", "ns and"):
        assert text in str(found)
    assert found.to_dict()["operations"]["stage"] == dict(found.operations["stage"])


def test_parameters_cost_once_a_run():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), metric=lambda x, p: np.array([[p.m]]),
        potential=lambda x, p: np.sin(p.k) * x[0] ** 2, parameters={"m": 1.7, "k": 0.6},
    )  # fmt: skip
    found = cost(system, gni.Rattle())
    assert found.operations["run"]["sine"] == 1
    assert found.operations["stage"]["sine"] == 0
    assert found.nanoseconds is None
    assert found.per_step() is None


def test_bad_requests_are_refused():
    scene = gni.scenes.suslov()
    with pytest.raises(gni.InputError, match="chooses its own steps"):
        cost(scene, gni.ReferenceFlow())
    with pytest.raises(gni.InputError, match="scene must be"):
        cost(None)
    with pytest.raises(gni.InputError, match="kind must be"):
        cost(scene.system).per_step("tangent")
