"""How well stages are foretold: the rule, and its record in every kind of loop."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.codegen import InterpretedStep, MachineCode, machine_has_fused_products, surprise
from groupoid_gni.codegen.emitter import Emitter
from groupoid_gni.codegen.framed_kernel import FramedKernel
from groupoid_gni.codegen.step_kernel import StepKernel, step_tape
from groupoid_gni.codegen.warm_start import watched_stage
from groupoid_gni.integrators import compiled_step
from groupoid_gni.integrators.preparation import Starts, prepare

FUSED = machine_has_fused_products()


def noted(values: Any, energies: Any = None, first: int = 0) -> list[float]:
    """The record of a run whose stages have these e."""
    energies = np.ones(len(values)) if energies is None else energies
    record = [0.0, surprise.FIRST, 0.0, 0.0, float(first + surprise.LEARNING)]
    for stage, (e, energy) in enumerate(zip(values, energies, strict=True), start=first):
        record = surprise.noted(record, e * e, energy, stage, True)
    return record


# ---------------------------------------------------------------- the rule


def test_the_one_stage_that_stands_out_is_recorded_with_its_number() -> None:
    values = np.full(200, 1e-4)
    values[150], values[170] = 0.3, 0.2
    record = noted(values)
    assert record[surprise.LARGEST] == pytest.approx(0.3**2)
    assert record[surprise.WHERE] == 150


def test_a_run_that_is_coarse_throughout_does_not_stand_out() -> None:
    phase = np.arange(3000)
    for level in (0.02, 0.3, 1.4):
        assert noted(level * (1.1 + np.sin(0.21 * phase)))[surprise.LARGEST] == 0.0


def test_stages_that_grow_fast_stand_out_and_slow_growth_does_not() -> None:
    flat = np.full(100, 1e-3)
    fast, slow = (1e-3 * rate ** np.arange(40) for rate in (1.6, 1.08))
    assert noted([*flat, *fast[:15]])[surprise.LARGEST] > 0.1
    assert noted([*flat, *slow])[surprise.LARGEST] == 0.0


def test_nothing_below_a_hundredth_stands_out() -> None:
    values = np.full(600, 1e-9)
    values[590] = 0.0099
    assert noted(values)[surprise.LARGEST] == 0.0
    values[590] = 0.0101
    assert noted(values)[surprise.WHERE] == 590


@pytest.mark.parametrize("first", [0, 1700])
def test_stages_after_a_fresh_guess_are_not_judged(first: int) -> None:
    values = np.full(70, 1e-4)
    values[surprise.LEARNING - 1] = 0.4
    assert noted(values, first=first)[surprise.LARGEST] == 0.0
    values[surprise.LEARNING] = 0.5
    assert noted(values, first=first)[surprise.WHERE] == first + surprise.LEARNING


def test_a_motion_at_its_turning_point_or_at_rest_does_not_surprise() -> None:
    values, energies = np.full(200, 1e-5), np.full(200, 2.5)
    values[150:], energies[150:] = 0.7, 2e-4
    assert noted(values, energies)[surprise.LARGEST] == 0.0
    energies[150:] = 3e-4
    assert noted(values, energies)[surprise.LARGEST] > 0.0


def test_the_watched_stage_is_foretold_better_than_most() -> None:
    for method in (gni.GNI(), gni.GNI(4), gni.GNI(6), gni.GNI(8)):
        scene = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35, 1.1, 0.6)
        runner = compiled_step(scene.system, method, (0,), compile=False)
        fractions = runner.program.fractions
        errors = first_errors(runner, scene, 0.1, 30)
        middle = np.median(errors.reshape(-1, len(fractions))[10:], axis=0)
        # near what hindsight would choose, and far from what chance would
        assert middle[watched_stage(fractions)] <= 10 * np.min(middle)
        if len(fractions) > 5:
            assert middle[watched_stage(fractions)] < np.median(middle)
            assert middle[watched_stage(fractions)] < 0.05 * np.max(middle)


def first_errors(runner: Any, scene: Any, h: float, steps: int) -> Any:
    """e of the first iteration of every stage, by the interpreter."""
    found: list[float] = []
    rule = surprise.noted

    def spy(record: Any, q: float, *rest: Any) -> Any:
        found.append(q)
        return rule(record, q, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(surprise, "noted", spy)
        parameters, begin = begun(runner, scene, h)
        runner.advance(parameters, begin, steps * runner.program.stages, 1)
    return np.sqrt(found)


# ---------------------------------------------------------------- the loops


def begun(runner: Any, scene: Any, h: float) -> Any:
    members = prepare(scene.system, runner, Starts.of(scene.system, [scene.start], None), h, None)
    parameters = members.parameters[:, 0].copy()
    return parameters, runner.begin(parameters, members.states[:, 0])


def jumping() -> gni.scenes.Scene:
    """A ball in a chart that is lost at t = 9, where its rotation vector is nearly 2 pi long."""
    return gni.scenes.inhomogeneous_ball_in_a_chart(
        rotation_vector=(-0.8634263309786897, -4.357468115438112, 0.9074452862968917),
        velocity=(-1.4123812154717754, 0.770322082794496),
    )


@pytest.fixture(scope="module")
def scene() -> gni.scenes.Scene:
    return jumping()


def test_interpreter_and_machine_code_keep_the_same_record(scene: gni.scenes.Scene) -> None:
    records = []
    for compile in (True, False):
        runner = compiled_step(scene.system, gni.GNI(), (0, 1), compile=compile)
        parameters, begin = begun(runner, scene, 0.01)
        end, _, outcome = runner.advance(parameters, begin, 950, 950)
        assert outcome is gni.Outcome.SUCCESS
        records.append(runner.record(end.memory))
        assert runner.surprise(end.memory) == (pytest.approx(0.46, abs=0.01), 897)
    assert isinstance(runner, InterpretedStep)
    np.testing.assert_allclose(*records, rtol=1e-3)


CASES = {
    "chart": (jumping, gni.GNI(), 0.01, 950),
    "chart, order 4": (jumping, gni.GNI(4), 0.04, 210 * 5),
    "SE(3), impulses": (lambda: zoo.animal("SE3 left exp", 2), gni.McLachlanPerlmutter(), 0.05, 90),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("kernel", [StepKernel, FramedKernel])
@pytest.mark.parametrize("lanes", [1, 4])
def test_the_record_has_the_same_bits_in_every_kernel_and_lane(
    case: str, kernel: Any, lanes: int
) -> None:
    make, method, h, stages = CASES[case]
    scene = make()
    rows = scene.start.active_rows
    runner = compiled_step(scene.system, method, rows)
    parameters, begin = begun(runner, scene, h)
    end = runner.advance(parameters, begin, stages, stages)[0]
    program = runner.program
    code = MachineCode(kernel(program, step_tape(program), lanes, FUSED).text())
    kinds = [ctypes.c_void_p] * 5 + [ctypes.c_int64] * 3
    advance = code.function("advance", *kinds, returns=ctypes.c_int64)
    arrays = [np.repeat(a[:, None], lanes, axis=1) for a in (parameters, begin.state, begin.memory)]
    saved, status = np.zeros((1, program.row_size, lanes)), np.zeros((2, lanes), dtype=np.int64)
    if lanes > 1:
        # a lane that has failed keeps what it had, the others never know
        status[0, 2] = gni.Outcome.NEWTON_FAILED
    pointers = [a.ctypes.data for a in (*arrays, saved, status)]
    advance(*pointers, 0, stages, stages)
    expected = runner.record(end.memory)
    for lane in range(lanes):
        found = runner.record(arrays[2][:, lane])
        frozen = status[0, lane] != 0
        np.testing.assert_array_equal(found, runner.record(begin.memory) if frozen else expected)


def test_a_fresh_guess_keeps_the_record_and_begins_to_learn_again(scene: gni.scenes.Scene) -> None:
    runner = compiled_step(scene.system, gni.GNI(), (0, 1))
    parameters, begin = begun(runner, scene, 0.01)
    end = runner.advance(parameters, begin, 950, 950)[0]
    before = runner.record(end.memory)
    after = runner.record(runner.with_unknowns(parameters, end, None).memory)
    assert after[surprise.PRIMED] == 950 + surprise.LEARNING
    assert after[surprise.USUAL] == max(before[surprise.USUAL], surprise.FIRST)
    kept = [surprise.PEAK, surprise.LARGEST, surprise.WHERE]
    np.testing.assert_array_equal(after[kept], before[kept])


def test_a_program_without_unknowns_has_no_record() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), np.diag([1.3, 0.8]), potential=lambda x, p: -((x @ x) ** 2)
    )
    runner = compiled_step(system, gni.Rattle(), ())
    assert runner.program.record_size == 0
    assert runner.surprise(np.zeros(1)) == (0.0, 0)


def test_the_larger_of_two_is_one_comparison_and_one_choice() -> None:
    e = Emitter()
    surprise.larger(e, "%a", "%b")
    assert [line.split()[2] for line in e.lines] == ["fcmp", "select"]
