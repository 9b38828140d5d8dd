"""The adaptive loop: its coefficients, its twin in NumPy, its bookkeeping, its ends."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

from groupoid_gni.codegen import CompiledFlow, FlowRunner, InterpretedFlow, adaptive_kernel
from groupoid_gni.codegen import dop853_coefficients as table
from groupoid_gni.codegen.adaptive_kernel import Number
from groupoid_gni.codegen.adaptive_runners import FlowProgress, _inverse_root

EVERYTHING = 1_000_000
NO_PARAMETERS = np.zeros(0)


def flow(theta: Any, y: Any, rate: Any, restored: Any = None, units: Any = None) -> ca.Function:
    outputs = [rate, y if restored is None else restored, ca.SX.ones(y.numel()) if units is None
               else units]
    return ca.Function("flow", [theta, y], [ca.densify(o) for o in outputs])


@cache
def wheels(n: int) -> ca.Function:
    """n coupled pendulums and cubes with a parameter; nothing symmetric, nothing linear."""
    theta, y = ca.SX.sym("theta", 2), ca.SX.sym("y", n)
    rate = [
        theta[0] * ca.sin(y[(i + 1) % n]) - (0.3 + 0.1 * (i % 3)) * y[i]
        + theta[1] / (1 + y[i - 1] ** 2)
        for i in range(n)
    ]
    return flow(theta, y, ca.vertcat(*rate))


@cache
def code(n: int) -> CompiledFlow:
    return CompiledFlow.of(wheels(n))


def oscillator() -> ca.Function:
    theta, y = ca.SX.sym("theta", 1), ca.SX.sym("y", 2)
    return flow(theta, y, ca.vertcat(y[1], -theta[0] ** 2 * y[0]))


def growth(rate: Any) -> ca.Function:
    """y' = rate(y) of one variable without parameters."""
    theta, y = ca.SX.sym("theta", 0), ca.SX.sym("y", 1)
    return flow(theta, y, rate(y))


THETA = np.array([1.3, 0.7])


def start(n: int) -> Any:
    return 0.4 + 0.9 * np.sin(1.7 * np.arange(n))


def begin(runner: FlowRunner, h: float = 0.13, count: int = 50, every: int = 7) -> FlowProgress:
    n = runner.layout.size
    return runner.begin(THETA, start(n), (1e-8, 1e-10), h, count, every)


def whole(runner: FlowRunner, **options: Any) -> FlowProgress:
    progress = begin(runner, **options)
    assert runner.advance(progress, EVERYTHING) == 1
    return progress


# ---------------------------------------------------------------- coefficients


def test_the_coefficients_are_those_that_scipy_has() -> None:
    from scipy.integrate._ivp import dop853_coefficients as scipys

    def row(weights: table.Weights, length: int) -> Any:
        result = np.zeros(length)
        for j, weight in weights.items():
            result[j] = weight
        return result

    stages = [row(w, 16) for w in (*table.STAGES, table.STEP, *table.EXTRA_STAGES)]
    np.testing.assert_array_equal(stages, scipys.A)
    np.testing.assert_array_equal(row(table.STEP, 12), scipys.B)
    np.testing.assert_array_equal(row(table.FIFTH, 13), scipys.E5)
    np.testing.assert_array_equal(row(table.STEP, 13) - row(table.THIRD, 13), scipys.E3)
    np.testing.assert_array_equal([row(w, 16) for w in table.DENSE], scipys.D)
    np.testing.assert_allclose(np.sum(stages, axis=1), scipys.C, rtol=0, atol=4e-14)


# ---------------------------------------------------------------- the twin in NumPy


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 16, 17])
@pytest.mark.parametrize("h", [0.13, -0.08])
def test_machine_code_and_numpy_do_the_same(n: int, h: float) -> None:
    compiled, interpreted = code(n), InterpretedFlow(wheels(n))
    one, other = whole(compiled, h=h), whole(interpreted, h=h)
    np.testing.assert_allclose(one.rows, other.rows, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(one.counts, other.counts)
    assert one.filled == 9


def test_scipy_arrives_at_the_same_place() -> None:
    from scipy.integrate import solve_ivp

    run = whole(code(5), h=0.2, count=30, every=1)
    field = wheels(5)
    answer = solve_ivp(
        lambda t, y: np.array(field(THETA, y)[0]).ravel(), (0.0, 6.0), start(5), method="DOP853",
        rtol=1e-11, atol=1e-13, t_eval=0.2 * np.arange(31),
    )
    np.testing.assert_allclose(run.rows[:, :-1], answer.y.T, rtol=0, atol=3e-7)
    np.testing.assert_allclose(run.rows[-1, :-1], answer.y[:, -1], rtol=0, atol=3e-8)


# ---------------------------------------------------------------- calls


@pytest.mark.parametrize("attempts", [1, 3, 11])
@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
def test_cutting_a_run_into_calls_changes_no_bit(made: Any, attempts: int) -> None:
    runner = made(wheels(5))
    at_once, in_calls = whole(runner), begin(runner)
    assert at_once.rejected > 0
    while (status := runner.advance(in_calls, attempts)) == 0:
        pass
    assert status == 1
    assert in_calls.rows.tobytes() == at_once.rows.tobytes()
    assert in_calls.counts.tobytes() == at_once.counts.tobytes()


def test_the_two_ways_can_take_turns() -> None:
    runners = [code(3), InterpretedFlow(wheels(3))]
    mixed, turn = begin(runners[0]), 0
    while runners[turn % 2].advance(mixed, 2) == 0:
        turn += 1
    assert turn > 3
    np.testing.assert_allclose(mixed.rows, whole(runners[0]).rows, rtol=0, atol=1e-12)


def test_a_call_tries_no_more_steps_than_it_may() -> None:
    runner = code(5)
    progress = begin(runner)
    for calls in range(1, 4):
        assert runner.advance(progress, 2) == 0
        assert progress.accepted + progress.rejected == 2 * calls


def test_the_time_of_the_loop_is_added_up() -> None:
    runner = code(5)
    progress = begin(runner)
    runner.advance(progress, 2)
    first = progress.seconds
    runner.advance(progress, 2)
    assert 0.0 < first < progress.seconds


# ---------------------------------------------------------------- nodes


@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
@pytest.mark.parametrize(("h", "count", "every"), [(0.1, 97, 3), (-0.37, 20, 1), (2.9, 7, 4)])
def test_nodes_lie_at_products_of_the_step(made: Any, h: float, count: int, every: int) -> None:
    runner = made(oscillator())
    progress = runner.begin(np.array([1.7]), np.array([0.3, -0.8]), (1e-12, 1e-13), h, count, every)
    assert runner.advance(progress, EVERYTHING) == 1
    t = np.append(np.arange(0, count, every), count) * h
    exact = 0.3 * np.cos(1.7 * t) - 0.8 / 1.7 * np.sin(1.7 * t)
    assert progress.filled == len(t) == len(progress.rows)
    np.testing.assert_allclose(progress.rows[:, 0], exact, rtol=0, atol=2e-11)
    assert progress.time == count * h


def test_dense_output_is_computed_in_steps_with_a_node_inside_only() -> None:
    runner = code(5)
    end_only, everywhere = whole(runner, every=50), whole(runner, every=1)
    assert end_only.evaluations == 2 + 12 * end_only.accepted + 11 * end_only.rejected
    extra = everywhere.evaluations - end_only.evaluations
    assert extra % 3 == 0
    assert 10 * 3 <= extra <= 3 * everywhere.accepted
    one_inside = whole(runner, every=49)
    assert one_inside.evaluations == end_only.evaluations + 3
    assert one_inside.rows[-1].tobytes() == end_only.rows[-1].tobytes()


def test_time_gathers_no_round_off() -> None:
    runner = CompiledFlow.of(oscillator())
    progress = runner.begin(np.array([40.0]), np.array([1.0, 0.0]), (1e-12, 1e-12), 1.0, 20, 20)
    assert runner.advance(progress, 1) == 0
    steps = [progress.time]
    while True:
        size, accepted = progress.memory[Number.STEP], progress.accepted
        if runner.advance(progress, 1) == 1:
            break
        if progress.accepted > accepted:
            steps.append(size)
            now, low = progress.memory[[Number.TIME, Number.TIME_LOW]]
            assert abs(math.fsum([now, low, *(-s for s in steps)])) < 1e-18
    assert len(steps) > 500
    assert progress.time == 20.0


# ---------------------------------------------------------------- accuracy


def test_the_error_follows_the_tolerance() -> None:
    runner = code(5)
    tolerances = 10.0 ** -np.arange(4, 13)
    ends = []
    for rtol in (*tolerances, 1e-14):
        progress = runner.begin(THETA, start(5), (rtol, 0.01 * rtol), 3.0, 1, 1)
        assert runner.advance(progress, EVERYTHING) == 1
        ends.append(progress.state.copy())
    errors = np.max(np.abs(np.array(ends[:-1]) - ends[-1]), axis=1)
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.85 < slope < 1.15
    assert np.all(errors < 10 * tolerances)


def test_units_stretch_the_absolute_tolerance() -> None:
    theta, y = ca.SX.sym("theta", 0), ca.SX.sym("y", 2)
    decay = ca.vertcat(-y[0], ca.cos(3 * y[0]))

    def steps(units: Any, atol: float) -> int:
        runner = CompiledFlow.of(flow(theta, y, decay, units=units))
        progress = runner.begin(NO_PARAMETERS, np.array([2.0, 0.0]), (1e-13, atol), 5.0, 1, 1)
        assert runner.advance(progress, EVERYTHING) == 1
        return progress.evaluations

    assert steps(ca.DM([100.0, 100.0]), 1e-6) == steps(ca.DM([1.0, 1.0]), 1e-4)
    assert steps(ca.DM([1.0, 1.0]), 1e-6) > steps(ca.DM([1.0, 1.0]), 1e-4)
    assert steps(ca.vertcat(50.0 * y[0], 100.0), 1e-6) == steps(ca.DM([100.0, 100.0]), 1e-6)


def test_the_root_in_the_step_control_is_good_to_one_percent() -> None:
    rng = np.random.default_rng(3)
    for a, b in np.exp(rng.uniform(-60, 60, (2000, 2))):
        root = _inverse_root(np.float64(a), np.float64(b))
        assert abs(root / (b / a) ** 0.0625 - 1.0) < 0.01


# ---------------------------------------------------------------- restoration


def turning() -> ca.Function:
    """A point on the circle; one Newton step towards it, as groupoids do."""
    theta, y = ca.SX.sym("theta", 1), ca.SX.sym("y", 3)
    rate = ca.vertcat(-theta[0] * y[1] * y[2], theta[0] * y[0] * y[2], 0.1 * y[0] * y[2])
    factor = 1.5 - 0.5 * (y[0] ** 2 + y[1] ** 2)
    return flow(theta, y, rate, ca.vertcat(factor * y[0], factor * y[1], y[2]))


@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
def test_states_are_put_back_after_every_step_and_at_every_node(made: Any) -> None:
    runner = made(turning())
    progress = runner.begin(np.array([1.9]), np.array([0.6, 0.8, 1.1]), (1e-5, 1e-7), 0.3, 40, 1)
    while (status := runner.advance(progress, 1)) == 0:
        x, y, _ = progress.state
        assert abs(np.hypot(x, y) - 1.0) < 1e-9
        # the rate that the next step begins with is the one at the restored state
        rate = np.array(runner.function(np.array([1.9]), progress.state)[0]).ravel()
        np.testing.assert_allclose(progress.rate, rate, rtol=0, atol=1e-15)
    assert status == 1
    np.testing.assert_allclose(np.hypot(*progress.rows[:, :2].T), 1.0, rtol=0, atol=1e-8)


def test_without_restoration_the_same_run_leaves_the_circle() -> None:
    function = turning()
    theta, y = ca.SX.sym("theta", 1), ca.SX.sym("y", 3)
    runner = CompiledFlow.of(flow(theta, y, function(theta, y)[0]))
    progress = runner.begin(np.array([1.9]), np.array([0.6, 0.8, 1.1]), (1e-5, 1e-7), 0.3, 40, 1)
    assert runner.advance(progress, EVERYTHING) == 1
    assert np.max(np.abs(np.hypot(*progress.rows[:, :2].T) - 1.0)) > 1e-6


# ---------------------------------------------------------------- ends


ENDS = {
    "blow-up": (growth(lambda y: y**2), 1.0, 1.0),
    "a root of a negative number": (growth(lambda y: -ca.sqrt(1.0 - y) - 0.5), 0.6, None),
    "a pole": (growth(lambda y: 1.0 / (1.5 - y)), 1.0, 0.125),
    "infinity at once": (growth(lambda y: 1.0 / (y - 1.0)), 1.0, 0.0),
    "not a number at once": (growth(lambda y: ca.log(y - 2.0)), 1.0, 0.0),
}


BY_NUMPY = [case for case in ENDS if "once" in case or "up" in case]


@pytest.mark.parametrize(
    ("case", "made"),
    [(case, CompiledFlow.of) for case in ENDS if "root" not in case]
    + [(case, InterpretedFlow) for case in BY_NUMPY],
)
def test_what_cannot_go_on_ends_with_the_nodes_before_it(case: str, made: Any) -> None:
    function, first, end = ENDS[case]
    runner = made(function)
    progress = runner.begin(NO_PARAMETERS, np.array([first]), (1e-7, 1e-9), 0.01, 300, 1)
    assert runner.advance(progress, EVERYTHING) == -1
    assert progress.time == pytest.approx(end, abs=1e-6)
    assert np.all(np.isfinite(progress.rows[: progress.filled]))
    assert progress.filled == int(end / 0.01 + 1e-9) + 1
    assert np.isfinite(progress.state).all()


@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
def test_nothing_goes_beyond_the_largest_number(made: Any) -> None:
    runner = made(growth(lambda y: 1e304 + 0.0 * y))
    progress = runner.begin(NO_PARAMETERS, np.array([1.7976e308]), (1e-7, 1e-9), 0.01, 300, 1)
    assert runner.advance(progress, 500) == 0
    assert progress.filled == 94
    assert np.all(np.isfinite(progress.rows[:94]))
    assert np.all(np.isfinite(progress.state))


@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
def test_a_node_that_cannot_be_interpolated_is_not_handed_over(made: Any) -> None:
    """The dense output evaluates the field where the step itself does not, here in a gap."""

    def with_gap(centre: float, half_width: float) -> FlowRunner:
        return made(growth(
            lambda y: 1.0 + 1e-300 * ca.sqrt((y - centre) ** 2 - half_width**2)
        ))

    def run(runner: FlowRunner, every: int) -> tuple[int, FlowProgress]:
        progress = runner.begin(NO_PARAMETERS, np.array([0.3]), (1e-6, 1e-8), 0.01, 100, every)
        return runner.advance(progress, 5000), progress

    without = with_gap(-9.0, 1.0)
    progress = without.begin(NO_PARAMETERS, np.array([0.3]), (1e-6, 1e-8), 0.01, 100, 100)
    assert without.advance(progress, 1) == 0
    step = progress.time
    # stages lie at 0.118 and 0.25 of a step, one of the dense output at 0.2
    gap = with_gap(0.3 + 0.2 * step, 0.02 * step)
    status, progress = run(gap, 100)
    assert status == 1
    assert progress.rejected == 0
    status, progress = run(gap, 1)
    assert progress.rejected > 0
    assert np.all(np.isfinite(progress.rows[: progress.filled]))


def test_a_step_that_looks_into_the_forbidden_is_tried_again_smaller() -> None:
    function, first, _ = ENDS["a root of a negative number"]
    runner = CompiledFlow.of(function)
    progress = runner.begin(NO_PARAMETERS, np.array([first]), (1e-4, 1e-6), -0.01, 40, 40)
    assert runner.advance(progress, EVERYTHING) in (1, -1)
    assert np.all(np.isfinite(progress.rows[: progress.filled]))


@pytest.mark.parametrize("made", [CompiledFlow.of, InterpretedFlow], ids=["code", "numpy"])
def test_what_stands_still_arrives_in_a_few_steps(made: Any) -> None:
    runner = made(growth(lambda y: 0.0 * y))
    for first in (0.0, 1.7):
        progress = runner.begin(NO_PARAMETERS, np.array([first]), (1e-9, 1e-11), 100.0, 10, 1)
        assert runner.advance(progress, EVERYTHING) == 1
        assert progress.accepted < 20
        np.testing.assert_array_equal(progress.rows[:, 0], first)


def test_other_parameters_take_over_where_a_run_is_told_to_go_on() -> None:
    theta, y = ca.SX.sym("theta", 1), ca.SX.sym("y", 2)
    runner = CompiledFlow.of(flow(theta, y, ca.vertcat(y[1], theta[0])))
    pushes = np.array([0.7, -1.9, 0.4, 0.0, 1.1])
    progress = runner.begin(pushes[:1], np.array([0.2, -0.3]), (1e-10, 1e-12), 0.5, 5, 2)
    for step, push in enumerate(pushes):
        progress.aim(np.array([push]), step + 1)
        assert progress.filled == step // 2 + 1
        assert runner.advance(progress, EVERYTHING) == 1
    x, v, expected = 0.2, -0.3, [(0.2, -0.3)]
    for push in pushes:
        x, v = x + 0.5 * v + 0.125 * push, v + 0.5 * push
        expected.append((x, v))
    assert progress.filled == 4
    np.testing.assert_allclose(progress.rows[:, :2], np.array(expected)[[0, 2, 4, 5]], atol=1e-13)


def test_without_fused_products_the_result_is_the_same_to_round_off() -> None:
    from groupoid_gni.codegen import MachineCode
    from groupoid_gni.codegen.adaptive_kernel import FlowLayout, adaptive_kernel_ir

    function = wheels(9)
    ir = adaptive_kernel_ir(function, False, FlowLayout.of(function))
    assert "llvm.fma" not in ir
    plain, fused = CompiledFlow(function, MachineCode(ir)), CompiledFlow.of(function)
    np.testing.assert_allclose(whole(plain).rows, whole(fused).rows, rtol=0, atol=1e-12)


def test_cutting_basic_blocks_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    function = turning()

    def run() -> tuple[str, FlowProgress]:
        runner = CompiledFlow.of(function)
        numbers, first = np.array([1.9]), np.array([0.6, 0.8, 1.1])
        progress = runner.begin(numbers, first, (1e-5, 1e-7), 0.3, 40, 1)
        assert runner.advance(progress, EVERYTHING) == 1
        return runner.code.source, progress

    source, uncut = run()
    monkeypatch.setattr(adaptive_kernel, "LARGE_PROGRAM", 0)
    monkeypatch.setattr(adaptive_kernel, "_BLOCK_LENGTH", 4)
    cut_source, cut = run()
    assert "label %cut" not in source
    assert cut_source.count("label %cut") >= 4
    assert cut.rows.tobytes() == uncut.rows.tobytes()
