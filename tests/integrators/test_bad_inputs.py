"""One table of bad requests: what each is answered with. Nothing is run, nothing is changed."""

from __future__ import annotations

import dataclasses
import signal
import warnings

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni import InputError, StepFailure
from groupoid_gni.integrators.interruption import interruptible
from groupoid_gni.integrators.requests import check_memory

BASE, VELOCITY = (0.3, -0.2), (0.6, 0.0, 0.9)


@pytest.fixture(scope="module")
def skate():
    """A blade on a potential slope: R^2 x SO(2), one constraint, one parameter."""
    return gni.MechanicalSystem(
        gni.AtiyahGroupoid(base_dim=2, group=gni.SO2()),
        np.diag([1.3, 0.7, 2.1]),
        constraints=lambda x, p: np.array([[0.4 * x[1], 1.0, 0.08 * 0.6 / 0.9]]),
        potential=lambda x, p: p.g * x[0],
        parameters={"g": 1.4},
    )


@pytest.fixture(scope="module")
def start(skate):
    return skate.state(BASE, VELOCITY)


@pytest.fixture(scope="module")
def rotor():
    return gni.MechanicalSystem(gni.SO3(), np.diag([1.3, 0.7, 2.1]))


RUNS = {
    # step
    "step is zero": ({"step": 0}, InputError, "step must be finite and not zero, got 0"),
    "step is NaN": ({"step": np.nan}, InputError, "step must be finite and not zero, got nan"),
    "step is infinite": ({"step": -np.inf}, InputError, "step must be finite .*got -inf"),
    "step is text": ({"step": "small"}, InputError, "step must be a number, got 'small'"),
    "step is None": ({"step": None}, InputError, "step must be a number, got None"),
    "step is a vector": ({"step": [0.1, 0.2]}, InputError, "step must be a number"),
    "step is complex": ({"step": 0.1j}, InputError, "step must be a number, got 0.1j"),
    # t_end, n_steps
    "t_end is no multiple": (
        {"n_steps": None, "t_end": 1.03},
        InputError,
        r"t_end = 1.03 is not a whole number of steps of 0.1: 10.3 steps. Use step=0.103",
    ),
    "t_end is shorter than a step": (
        {"n_steps": None, "t_end": 0.04}, InputError, "not a whole number of steps",
    ),
    "t_end lies behind": ({"n_steps": None, "t_end": -1.0}, InputError, "lies behind the start"),
    "t_end is NaN": ({"n_steps": None, "t_end": np.nan}, InputError, "t_end must be finite"),
    "t_end is infinite": ({"n_steps": None, "t_end": np.inf}, InputError, "t_end must be finite"),
    "t_end is text": ({"n_steps": None, "t_end": "1 s"}, InputError, "t_end must be a number"),
    "t_end is an interval": (
        {"n_steps": None, "t_end": (0.0, 1.0)}, InputError, "t_end must be a number",
    ),
    "step is tiny against t_end": (
        {"n_steps": None, "t_end": 1.0, "step": 1e-17}, InputError, r"more than 2\^53 steps",
    ),
    "t_end and n_steps": ({"t_end": 1.0}, InputError, "exactly one of t_end and n_steps"),
    "neither t_end nor n_steps": ({"n_steps": None}, InputError, "exactly one of t_end and n_st"),
    "n_steps is negative": ({"n_steps": -3}, InputError, "n_steps must be at least 0 .*got -3"),
    "n_steps is fractional": ({"n_steps": 10.5}, InputError, "n_steps must be a whole number"),
    "n_steps is NaN": ({"n_steps": np.nan}, InputError, "n_steps must be a whole number, got nan"),
    "n_steps is True": ({"n_steps": True}, InputError, "n_steps must be a whole number, got True"),
    "n_steps is text": ({"n_steps": "10"}, InputError, "n_steps must be a whole number, got '10'"),
    "n_steps is beyond counting": ({"n_steps": 2**64}, InputError, r"below 2\^53"),
    # save_every
    "save_every is zero": ({"save_every": 0}, InputError, "save_every must be at least 1"),
    "save_every is negative": ({"save_every": -1}, InputError, "save_every must be at least 1"),
    "save_every is fractional": ({"save_every": 1.5}, InputError, "save_every must be a whole"),
    # memory
    "result larger than the memory": (
        {"n_steps": 2**46}, InputError, r"takes [\d.]+ GiB and .* are free; use save_every=",
    ),
    "reference result larger than the memory": (
        {"n_steps": 2**46, "method": gni.ReferenceFlow()}, InputError, "use save_every=",
    ),
    # method and other choices
    "method is a class": (
        {"method": gni.Rattle}, InputError, r"method is the class Rattle; pass .* of it: Rattle\(\)"
    ),
    "method is text": ({"method": "rattle"}, InputError, "method must be a value such as gni.GNI"),
    "method is a flow": ({"method": gni.Variational()}, InputError, "method must be a value such"),
    "on_failure is misspelt": (
        {"on_failure": "retrun"}, InputError, 'on_failure must be "raise" or "return"',
    ),
    "unknown keyword": ({"stepp": 0.1}, TypeError, "stepp"),
    # start
    "start is a pair of vectors": (
        {"start": (BASE, VELOCITY)}, InputError, "start must be made with system.state.*got tuple",
    ),
    "start is None": ({"start": None}, InputError, "start must be made with system.state"),
    "system is a function": ({"system": np.sin}, InputError, "system must be a MechanicalSystem"),
    # reconstruct
    "pose of a wrong shape": (
        {"reconstruct": np.eye(4)}, InputError, "pose",
    ),
    "pose is text": ({"reconstruct": "here"}, InputError, "pose"),
}


def request(skate, start, changes):
    arguments = {"system": skate, "start": start, "step": 0.1, "n_steps": 10, **changes}
    return gni.integrate(arguments.pop("system"), arguments.pop("start"), **arguments)


@pytest.mark.parametrize("case", RUNS)
def test_a_bad_request_is_refused_before_anything_runs(skate, start, case):
    changes, kind, message = RUNS[case]
    with pytest.raises(kind, match=f"(?s){message}"):
        request(skate, start, changes)


def test_the_good_request_that_the_table_spoils_is_good(skate, start):
    assert request(skate, start, {}).success


def test_following_the_advice_about_t_end_works(skate, start):
    assert len(request(skate, start, {"n_steps": None, "t_end": 1.03, "step": 0.103})) == 11


def test_following_the_advice_about_memory_works(skate, start):
    with pytest.raises(InputError) as caught:
        request(skate, start, {"n_steps": 2**40})
    every = int(str(caught.value).split("save_every=")[1].split()[0])
    check_memory(2**40 // every + 2, 12)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle(), gni.ReferenceFlow()], ids=str)
def test_a_start_of_another_system_is_refused(skate, start, rotor, method):
    with pytest.raises(InputError, match=r"start belongs to another system: base \(2,\)"):
        gni.integrate(rotor, start, step=0.1, n_steps=3, method=method)
    with pytest.raises(InputError, match=r"start belongs to another system: base \(0,\)"):
        gni.integrate(skate, rotor.state(velocity=[0.3, 0.2, 0.1]), step=0.1, n_steps=3)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle(), gni.ReferenceFlow()], ids=str)
def test_zero_steps_give_the_start_alone(skate, start, method):
    run = request(skate, start, {"n_steps": 0, "method": method})
    assert run.success
    np.testing.assert_array_equal(run.times, [0.0])
    np.testing.assert_array_equal(run.base, [BASE])


@pytest.mark.parametrize("whole", [7, np.int32(7), 7.0, np.float64(7.0)], ids=repr)
def test_whole_numbers_of_every_kind_are_steps(skate, start, whole):
    assert len(request(skate, start, {"n_steps": whole, "save_every": whole})) == 2


def test_a_negative_step_retraces_the_motion(skate, start):
    forth = request(skate, start, {})
    turned = skate.state(*forth.final_state)
    back = request(skate, turned, {"step": -0.1, "t_end": -1.0, "n_steps": None})
    np.testing.assert_allclose(back.base[-1], BASE, atol=1e-13)


TOLERANCES = [
    ({"rtol": 0.0}, "rtol must lie between 0 and 1, got 0.0"),
    ({"rtol": -1e-6}, "rtol must lie between 0 and 1"),
    ({"rtol": np.nan}, "rtol must lie between 0 and 1, got nan"),
    ({"rtol": 2.0}, "rtol must lie between 0 and 1"),
    ({"rtol": 1e-30}, "rtol=1e-30 is below what doubles can give; use 1e-13"),
    ({"atol": -1.0}, "atol must lie between 0 and 1"),
]


@pytest.mark.parametrize(("options", "message"), TOLERANCES)
def test_a_tolerance_that_cannot_be_met_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        gni.ReferenceFlow(**options)


def test_a_tolerance_of_text_is_refused():
    with pytest.raises(InputError, match="rtol"):
        gni.ReferenceFlow(rtol="tight")


@pytest.mark.parametrize("order", [0, 3, "2", None])
def test_an_order_that_does_not_exist_is_refused(order):
    with pytest.raises(InputError, match=f"order={order!r}"):
        gni.GNI(order=order)


def test_a_flow_of_a_wrong_kind_is_refused():
    with pytest.raises(InputError, match="flow must be a free flight"):
        gni.GNI(flow=gni.Rattle())
    with pytest.raises(InputError, match="Variational takes a discrete Lagrangian"):
        gni.Variational("rattle")


# ---------------------------------------------------------------- one arrow


def arrow_of(skate, start, step=0.1):
    return skate.space.retract(start.base, step * start.velocity)


@pytest.mark.parametrize(
    ("arrow", "step", "message"),
    [
        (np.zeros(3), 0.1, "arrow must be .* finite numbers; make one with"),
        (np.full((2, 6), 0.1), 0.1, "arrow must be"),
        (None, 0.0, "step must be finite and not zero"),
        (None, "small", "step must be a number"),
    ],
    ids=["too short", "two of them", "step zero", "step is text"],
)
def test_the_next_arrow_of_a_bad_arrow_or_step_is_refused(skate, start, arrow, step, message):
    g = arrow_of(skate, start) if arrow is None else arrow
    with pytest.raises(InputError, match=message):
        gni.next_arrow(skate, gni.Rattle(), g, step=step)


def test_the_next_arrow_of_an_arrow_with_nan_is_refused(skate, start):
    g = np.array(arrow_of(skate, start))
    g[1] = np.nan
    with pytest.raises(InputError, match="finite numbers"):
        gni.next_arrow(skate, gni.Rattle(), g, step=0.1)


def test_the_next_arrow_wants_a_discrete_lagrangian(skate, start):
    for wrong in (gni.GNI(), gni.Rattle, "rattle"):
        with pytest.raises(InputError, match="expected a discrete Lagrangian"):
            gni.next_arrow(skate, wrong, arrow_of(skate, start), step=0.1)


def test_the_next_arrow_of_text_is_refused_in_the_words_of_the_library(skate):
    try:
        gni.next_arrow(skate, gni.Rattle(), "north", step=0.1)
    except InputError:
        return


def test_the_next_arrow_of_an_arrow_off_the_group_is_refused(rotor):
    with pytest.raises((InputError, StepFailure)):
        gni.next_arrow(rotor, gni.Rattle(), np.ravel(1.5 * np.eye(3)), step=0.1)


# ---------------------------------------------------------------- nothing is changed


def process_state():
    generator = np.random.get_state()  # noqa: NPY002
    return generator[1].tolist(), generator[2:], np.geterr(), list(warnings.filters)


def test_a_run_changes_neither_its_inputs_nor_the_process(skate):
    base, velocity = np.array(BASE), np.array(VELOCITY)
    gravity = np.array(1.4)
    np.random.seed(20240229)  # noqa: NPY002
    before = process_state()
    system = skate.with_parameters(g=gravity)
    start = system.state(base, velocity)
    frozen = [part.tobytes() for part in (start.base, start.velocity, start.momentum)]
    gni.integrate(system, start, step=0.1, n_steps=10)
    gni.integrate(system, start, step=0.1, n_steps=10, method=gni.ReferenceFlow())
    gni.next_arrow(system, gni.Rattle(), arrow_of(system, start), step=0.1)
    assert process_state() == before
    np.testing.assert_array_equal(base, BASE)
    np.testing.assert_array_equal(velocity, VELOCITY)
    assert gravity == 1.4
    assert [part.tobytes() for part in (start.base, start.velocity, start.momentum)] == frozen


def test_a_pose_to_reconstruct_from_is_not_changed(rotor):
    pose = gni.SO3().exp(np.array([0.4, -0.7, 0.2]))
    given = pose.copy()
    start = rotor.state(velocity=[0.3, 0.2, 0.9])
    arguments = {"step": 0.1, "n_steps": 10, "reconstruct": given}
    run = gni.integrate(rotor, start, **arguments)
    np.testing.assert_array_equal(given, pose)
    np.testing.assert_allclose(run.reconstruct()[0], pose, atol=1e-15)


@pytest.mark.parametrize(
    "pose", [2.0 * np.eye(3), np.full((3, 3), np.nan), -np.eye(3)], ids=["scaled", "NaN", "det -1"]
)
def test_a_pose_off_the_group_is_refused(rotor, pose):
    start = rotor.state(velocity=[0.3, 0.2, 0.9])
    with pytest.raises(InputError, match="pose"):
        gni.integrate(rotor, start, step=0.1, n_steps=3, reconstruct=pose)


def test_numpy_set_to_raise_and_denormal_numbers_do_not_disturb_a_run(rotor):
    start = rotor.state(velocity=[0.3, 5e-324, 0.9])
    with np.errstate(all="raise"):
        for compile in (True, False):
            run = gni.integrate(rotor, start, step=0.1, n_steps=5, compile=compile)
            assert run.success


def test_a_pose_on_a_pair_groupoid_that_is_not_the_start_is_refused():
    system = gni.MechanicalSystem(gni.PairGroupoid(2), np.diag([1.3, 0.7]))
    start = system.state([0.1, 0.2], [1.0, -0.3])
    with pytest.raises(InputError, match=r"where the arrow ends.*leave it out"):
        gni.integrate(system, start, step=0.1, n_steps=3, reconstruct=[7.0, 7.5])


def test_a_method_that_cannot_be_hashed_is_refused_with_the_mend():
    @dataclasses.dataclass
    class Mine(gni.DiscreteLagrangian):
        def average(self, lagrangian, space, source, target, velocity, step):
            return lagrangian(source, velocity)

    system = gni.MechanicalSystem(gni.PairGroupoid(1), [[1.3]])
    with pytest.raises(InputError, match=r"Mine cannot be hashed.*dataclass\(frozen=True\)"):
        gni.integrate(system, system.state([0.1], [1.0]), step=0.1, n_steps=3, method=Mine())


def test_next_arrow_that_cannot_be_solved_is_a_step_failure():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), [[1.0]], potential=lambda x, p: -2.0 * x[0] ** 2
    )
    arrow = system.space.retract(np.array([0.3]), np.array([0.7]))
    with pytest.raises(gni.StepFailure, match="did not converge"):
        gni.next_arrow(system, gni.Midpoint(), arrow, step=1.0)


def test_ctrl_c_in_the_only_chunk_is_not_swallowed():
    finished = []

    def one_chunk():
        with interruptible():
            signal.raise_signal(signal.SIGINT)
            finished.append(True)

    with pytest.raises(KeyboardInterrupt):
        one_chunk()
    assert finished == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
