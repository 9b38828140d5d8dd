"""One program over 1, 4 and 8 lanes: the same bits in every lane, whatever the others do."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.codegen import MachineCode, machine_has_fused_products, step_kernel_ir
from groupoid_gni.discretization import StepProgram
from groupoid_gni.integrators import compiled_step


@dataclass
class Result:
    """What ``advance`` leaves behind, lanes last."""

    state: Any
    memory: Any
    rows: Any
    status: Any
    done: int


class Lanes:
    """``advance`` of a program over W lanes, called through ctypes with arrays (entry, lane)."""

    def __init__(self, program: StepProgram, lanes: int, fused: bool) -> None:
        self.program, self.lanes = program, lanes
        self.code = MachineCode(step_kernel_ir(program, lanes, fused))
        kinds = [ctypes.c_void_p] * 5 + [ctypes.c_int64] * 3
        kinds += [ctypes.c_void_p] * bool(program.control_size)
        self._advance = self.code.function("advance", *kinds, returns=ctypes.c_int64)

    def __call__(
        self, parameters: Any, state: Any, memory: Any, count: int,
        first: int = 0, every: int = 1, status: Any = None, controls: Any = None,
    ) -> Result:
        """controls : (step, input, lane), of all steps from the very first."""
        saved = (first + count) // every - first // every
        rows = np.full((saved, self.program.row_size, self.lanes), np.nan)
        status = np.zeros((2, self.lanes), dtype=np.int64) if status is None else status.copy()
        arrays = [np.array(a, order="C") for a in (parameters, state, memory)]
        pointers = [a.ctypes.data for a in (*arrays, rows, status)]
        inputs = [] if controls is None else [np.array(controls, order="C")]
        done = self._advance(*pointers, first, count, every, *[u.ctypes.data for u in inputs])
        return Result(arrays[1], arrays[2], rows, status, int(done))


@cache
def kernel(case: str, lanes: int, fused: bool) -> Lanes:
    return Lanes(cases()[case][0], lanes, fused)


@cache
def cases() -> dict[str, tuple[StepProgram, Any, Any, Any]]:
    """Program, and parameters, states, memories of eight lanes."""
    made = {}
    ball = gni.scenes.inhomogeneous_ball(1.7, 0.9, (0.9, 0.5, 0.7), 0.8, (0.6, -0.2), (0.3, 0.5))
    made["ball, projected"] = _starts(ball.system, gni.GNI(), ball.start, 0.05)
    made["ball, two-step"] = _starts(ball.system, gni.Rattle(), ball.start, 0.05)
    sleigh = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35)
    made["ball, arrow to arrow"] = _starts(
        ball.system, gni.DiscreteLagrangeDAlembert(), ball.start, 0.05
    )
    made["sleigh, two-step"] = _starts(sleigh.system, gni.Midpoint(), sleigh.start, 0.1)
    a = zoo.animal("SE3 left exp", 2, affine=True)
    made["ball, composed"] = _starts(ball.system, gni.GNI(4), ball.start, 0.2)
    made["driven, composed"] = _starts(DRIVEN, gni.GNI(4), DRIVEN_START, 0.1)
    made["SE(3) with sines"] = _starts(a.system, gni.GNI(), a.start, 0.05)
    falling = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.8]),
        potential=lambda x, p: -p.k * (x @ x) ** 3, parameters={"k": 0.4},
    )
    start = falling.state([1.1, -0.7], [0.0, 0.0])
    made["falling, explicit"] = _starts(falling, gni.Rattle(), start, 0.05, True)
    made["falling, implicit"] = _starts(falling, gni.Midpoint(), start, 0.05, True)
    return made


DRIVEN = gni.MechanicalSystem(
    gni.PairGroupoid(3), metric=np.diag([1.3, 0.8, 1.7]),
    potential=lambda x, p: p.k * np.sin(x[0]) * x[1],
    constraints=lambda x, p: np.array([[-x[1], 0.3 * x[2], 1.0]]), parameters={"k": 0.4},
    force=lambda x, xi, p, u: np.array([u[0], u[1] - 0.3 * xi[1], u[0] * u[1]]), controls=2,
)
DRIVEN_START = DRIVEN.state([0.3, -0.4, 0.6], [0.7, 0.5, 0.2], project_start=True)


def steering(lanes: int, steps: int = 60) -> Any:
    """Inputs that differ from step to step, from input to input, from lane to lane."""
    step, entry, lane = np.meshgrid(*map(np.arange, (steps, 2, lanes)), indexing="ij")
    return 0.6 * np.sin(0.3 * step + 1.1 * entry + 0.2 * lane)


def _starts(
    system: Any, method: Any, start: gni.State, h: float, still: bool = False
) -> tuple[Any, Any, Any, Any]:
    """still : no momentum, base points nearer and nearer to 0 (they fall later and later)."""
    runner = compiled_step(system, method, start.active_rows)
    program, layout = runner.program, runner.program.layout
    m = len(start.active_rows)
    parameters, states, memories = [], [], []
    for lane in range(8):
        theta = system.parameter_vector * (1 + 0.03 * np.sin(lane))
        one = np.concatenate([theta, [h * (1 + 0.1 * lane)], np.ones(m)])
        state = np.zeros(layout.size)
        state[layout.slices["base"]] = start.base * (0.6**lane if still else 1.0)
        for part in {"before", "after", "momentum"} & set(layout.slices):
            state[layout.slices[part]] = start.momentum * (0.0 if still else 1 - 0.11 * lane)
        if runner.starting is not None:
            state = runner.starting.advance(one, runner.starting.begin(one, state), 1, 1)[0].state
        parameters.append(one)
        states.append(state)
        memories.append(runner.begin(one, state).memory)
    return program, *(np.array(v).T.copy() for v in (parameters, states, memories))


FUSED = [False, True] if machine_has_fused_products() else [False]


@pytest.mark.parametrize("fused", FUSED)
@pytest.mark.parametrize("lanes", [4, 8])
@pytest.mark.parametrize("case", ["ball, projected", "ball, two-step", "ball, arrow to arrow",
                                  "sleigh, two-step", "SE(3) with sines", "ball, composed",
                                  "driven, composed"])
def test_every_lane_computes_the_bits_it_computes_alone(case: str, lanes: int, fused: bool) -> None:
    program, *starts = cases()[case]
    inputs = steering(lanes) if program.control_size else None
    together = kernel(case, lanes, fused)(*(v[:, :lanes] for v in starts), 300, controls=inputs)
    assert together.done == 300
    assert not together.status[0].any()
    for lane in range(lanes):
        one = None if inputs is None else inputs[:, :, lane : lane + 1]
        alone = kernel(case, 1, fused)(
            *(v[:, lane : lane + 1] for v in starts), 300, controls=one
        )
        assert alone.done == 300
        np.testing.assert_array_equal(together.rows[:, :, lane], alone.rows[:, :, 0])
        np.testing.assert_array_equal(together.state[:, lane], alone.state[:, 0])
        np.testing.assert_array_equal(together.memory[:, lane], alone.memory[:, 0])
    spread = together.rows[-1, 0] if case[:4] == "ball" else together.rows[-1, -2]
    assert len(set(spread)) == lanes


@pytest.mark.parametrize("case", ["falling, explicit", "falling, implicit"])
@pytest.mark.parametrize("lanes", [4, 8])
def test_a_failing_lane_keeps_its_last_good_state_and_the_others_go_on(
    case: str, lanes: int
) -> None:
    _, *starts = cases()[case]
    fused = machine_has_fused_products()
    count = 90
    together = kernel(case, lanes, fused)(*(v[:, :lanes] for v in starts), count)
    alone = [
        kernel(case, 1, fused)(*(v[:, k : k + 1] for v in starts), count) for k in range(lanes)
    ]
    ends = [one.done for one in alone]
    assert min(ends) < count
    assert max(ends) == count
    for lane, one in enumerate(alone):
        assert together.status[0, lane] == one.status[0, 0]
        if one.done < count:
            assert together.status[1, lane] == one.done
            assert one.status[0, 0] < 0
        good = slice(0, one.done)
        np.testing.assert_array_equal(together.rows[good, :, lane], one.rows[good, :, 0])
        np.testing.assert_array_equal(together.state[:, lane], one.state[:, 0])
        assert np.all(np.isfinite(together.state[:, lane]))
        last = together.rows[one.done - 1, : together.state.shape[0], lane]
        np.testing.assert_array_equal(together.state[:, lane], last)


@pytest.mark.parametrize(
    "case", ["ball, projected", "falling, implicit", "ball, composed", "driven, composed"]
)
def test_chunks_of_lanes_are_cut_anywhere_without_changing_a_bit(case: str) -> None:
    program, *starts = cases()[case]
    inputs = steering(4) if program.control_size else None
    run = kernel(case, 4, machine_has_fused_products())
    whole = run(*(v[:, :4] for v in starts), 90, every=3, controls=inputs)
    parameters, state, memory = (v[:, :4] for v in starts)
    rows, status, first = [], None, 0
    for count in (1, 40, 7, 42):  # in the middle of steps of five stages
        part = run(parameters, state, memory, count, first, 3, status, inputs)
        state, memory, status = part.state, part.memory, part.status
        rows.append(part.rows)
        first += count
    np.testing.assert_array_equal(np.concatenate(rows), whole.rows)
    np.testing.assert_array_equal(state, whole.state)
    np.testing.assert_array_equal(status, whole.status)
    np.testing.assert_array_equal(memory, whole.memory)


def test_lanes_of_a_composition_are_the_run_of_the_method() -> None:
    program, parameters, state, memory = cases()["driven, composed"]
    assert program.stages == 5
    inputs = steering(4)
    fused = machine_has_fused_products()
    together = kernel("driven, composed", 4, fused)(
        *(v[:, :4] for v in (parameters, state, memory)), 60, every=5, controls=inputs
    )
    lane = 2
    system = DRIVEN.with_parameters(k=parameters[0, lane])
    start = system.state(DRIVEN_START.base, DRIVEN_START.velocity * (1 - 0.11 * lane))
    run = gni.integrate(system, start, step=parameters[1, lane], n_steps=12, method=gni.GNI(4),
                        controls=inputs[:, :, lane])
    size = program.layout.size
    np.testing.assert_allclose(together.rows[:, :size, lane], run.rows[1:, :size],
                               rtol=0, atol=1e-13)
