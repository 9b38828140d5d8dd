"""Work-precision tables on small scenes: what they say, and what they refuse to say."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.reports import MeasuredError, Peer, PeerRun, Quantity
from groupoid_gni.reports.state_parts import StateParts, StateShape, angle_between
from groupoid_gni.reports.timing import interleaved

T = 2.0
STEPS = [T / n for n in (20, 40, 80, 160)]


@pytest.fixture(scope="module")
def sleigh():
    return gni.scenes.chaplygin_sleigh(mass=1.3, inertia=0.8, offset=0.4)


@pytest.fixture(scope="module")
def sleigh_table(sleigh):
    methods = [gni.Rattle(), gni.GNI(order=4), gni.ReferenceFlow(rtol=1e-4),
               gni.ReferenceFlow(rtol=1e-8)]  # fmt: skip
    return gni.work_precision(sleigh, methods, STEPS, t_end=T, repeats=2)


@pytest.fixture(scope="module")
def ball_table():
    scene = gni.scenes.rolling_ball(1.7, 0.8, 0.6, 0.9, (0.7, -0.2), (0.3, 0.6))
    return gni.work_precision(scene, {"two-step": gni.Rattle()}, STEPS, t_end=T, repeats=2)


def test_there_is_a_row_for_every_method_and_setting(sleigh_table):
    counts = {name: len(rows) for name, rows in sleigh_table.lines.items()}
    assert counts == {"Rattle()": 4, "GNI(order=4)": 4, "ReferenceFlow": 2}
    steps = [row.steps for row in sleigh_table.lines["GNI(order=4)"]]
    assert steps == [20, 40, 80, 160]
    tolerances = [row.tolerance for row in sleigh_table.lines["ReferenceFlow"]]
    assert tolerances == [1e-4, 1e-8]


def test_errors_are_those_of_a_run_against_the_exact_motion(sleigh, sleigh_table):
    run = gni.integrate(sleigh.system, sleigh.start, step=STEPS[1], t_end=T, method=gni.Rattle())
    truth = sleigh.exact(run.times)[1]
    gaps = np.max(np.abs(run.velocities - truth), axis=1)
    found = sleigh_table.lines["Rattle()"][1].accuracy[Quantity.VELOCITY]
    assert found.final.value == pytest.approx(gaps[-1], rel=1e-9)
    assert found.largest.value == pytest.approx(np.max(gaps), rel=1e-9)
    assert sleigh_table.reference == "the exact motion"
    assert sleigh_table.estimate < 1e-13


def test_energy_constraint_and_counts_are_those_of_the_run(sleigh, sleigh_table):
    run = gni.integrate(
        sleigh.system, sleigh.start, step=STEPS[2], t_end=T, method=gni.GNI(order=4)
    )
    row = sleigh_table.lines["GNI(order=4)"][2]
    energy = run.energy()
    assert row.energy == pytest.approx(np.max(np.abs(energy / energy[0] - 1.0)), abs=1e-14)
    assert row.constraint < 1e-14
    assert row.newton == int(run.rows[-1, -1])
    assert row.stages == 5
    assert row.evaluations is None
    flow = sleigh_table.lines["ReferenceFlow"][1]
    assert flow.evaluations > 10 * flow.steps > 0
    assert flow.newton is None


def test_times_are_warm_and_compiling_is_apart(sleigh_table):
    for row in sleigh_table.rows:
        assert 0.0 < row.times.smallest <= row.times.median < 0.05
        assert len(row.times.seconds) >= 2
        assert row.times.spread >= 0.0
        assert row.compile_seconds > 10.0 * row.times.smallest


def test_slopes_are_the_orders_with_intervals(sleigh_table):
    slopes = sleigh_table.slopes()
    assert set(slopes) == {"Rattle()", "GNI(order=4)"}
    for name, order in (("Rattle()", 2), ("GNI(order=4)", 4)):
        assert slopes[name].order == pytest.approx(order, abs=0.2)
        assert slopes[name].low < slopes[name].order < slopes[name].high
    assert sleigh_table.slopes(Quantity.ATTITUDE)["GNI(order=4)"].order == pytest.approx(4, abs=0.2)


def test_the_attitude_comes_from_the_reconstruction_where_the_base_does_not_turn(
    sleigh, sleigh_table
):
    # theta' = omega = W sech(k t + c), so theta is a difference of Gudermann functions
    times = np.linspace(0.0, T, 20_001)
    omega = sleigh.exact(times)[1][:, 0]
    weights = np.ones(len(times))
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    angle = float(weights @ omega) * (times[1] - times[0]) / 3.0
    run = gni.integrate(
        sleigh.system, sleigh.start, step=STEPS[0], t_end=T, method=gni.Rattle(), reconstruct=True
    )
    pose = run.reconstruct()[-1]
    gap = np.arctan2(pose[1, 0], pose[0, 0]) - angle
    gap = abs((gap + np.pi) % (2.0 * np.pi) - np.pi)
    found = sleigh_table.lines["Rattle()"][0].accuracy[Quantity.ATTITUDE].final
    assert found.value == pytest.approx(gap, rel=1e-6)
    assert Quantity.POSITION not in sleigh_table.rows[0].accuracy


def test_affine_constraints_have_a_moving_energy_and_an_energy_reference(ball_table):
    rows = ball_table.lines["two-step"]
    assert all(row.moving_energy < 0.1 * row.energy for row in rows)
    falls = [a.energy / b.energy for a, b in pairwise(rows)]
    assert min(falls) > 3.0  # order two: against the reference, not against the start
    assert {Quantity.POSITION, Quantity.ATTITUDE, Quantity.VELOCITY} < set(rows[0].accuracy)


def test_an_error_below_ten_estimates_is_a_bound_and_not_a_number(sleigh):
    loose = gni.ReferenceFlow(rtol=1e-5)
    made = gni.work_precision(
        sleigh, [gni.GNI(order=8)], [0.1, 0.05], t_end=T, repeats=1, reference=loose
    )
    assert made.reference == str(loose)
    for row in made.rows:
        error = row.accuracy[Quantity.STATE].final
        assert error.estimate > 1e-9
        assert not error.resolved
        assert str(error).startswith("< ")
        assert float(str(error)[2:]) >= error.bound == error.value + error.estimate
        assert row.to_dict()["errors"]["state"]["final"]["error"] is None
    assert made.slopes() == {}
    assert made.time_to([1e-12])["GNI(order=8)"] == (None,)


def test_ten_estimates_are_the_border_of_a_number():
    assert str(MeasuredError(1.01e-9, 1e-10)) == "1.01e-09"
    assert str(MeasuredError(0.99e-9, 1e-10)) == "< 2e-09"
    assert str(MeasuredError(0.0, 1e-15)) == "< 1e-15"
    assert str(MeasuredError(np.inf, 1e-15)) == "-"


def test_time_to_an_error_lies_between_the_settings(sleigh_table):
    rows = sleigh_table.lines["GNI(order=4)"]
    errors = [row.bound(Quantity.STATE) for row in rows]
    target = float(np.sqrt(errors[1] * errors[2]))
    (found,) = sleigh_table.time_to([target])["GNI(order=4)"]
    times = sorted(row.times.smallest for row in rows[1:3])
    assert times[0] <= found.seconds <= times[1]
    assert sleigh_table.time_to([1e-300])["GNI(order=4)"] == (None,)
    with pytest.raises(gni.InputError, match="positive"):
        sleigh_table.time_to([0.0])


def test_the_table_is_markdown_and_the_dict_is_json(sleigh_table):
    text = sleigh_table.table()
    lines = text.splitlines()[2:]
    assert len(lines) == 2 + len(sleigh_table.rows)
    assert len({line.count("|") for line in lines}) == 1
    for name in ("velocity", "attitude", "energy", "constraint", "Newton", "median", "compile"):
        assert name in lines[0]
    assert "moving energy" not in lines[0]
    assert str(sleigh_table) == text
    read = json.loads(json.dumps(sleigh_table.to_dict()))
    assert len(read["rows"]) == len(sleigh_table.rows)
    assert read["slopes"]["Rattle()"]["points"] == 4
    assert str(sleigh_table.slopes()["Rattle()"]) in sleigh_table.time_table()


def test_the_figure_has_both_panels_with_orders_in_the_legend(sleigh_table, tmp_path):
    figure = sleigh_table.plot()
    by_time, by_step = figure.axes
    assert (by_time.get_xscale(), by_step.get_yscale()) == ("log", "log")
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[0] == f"Rattle(): {sleigh_table.slopes()['Rattle()']}"
    assert labels[2] == "ReferenceFlow"
    figure.savefig(tmp_path / "figure.png")
    mine = Figure()
    assert sleigh_table.plot(axes=mine.subplots(2)) is mine
    with pytest.raises(gni.InputError, match="two axes"):
        sleigh_table.plot(axes=Figure().subplots(3))


def test_a_run_that_fails_is_a_row_that_says_how():
    scene = gni.scenes.rolling_ball(velocity=(4.0, 3.0))
    made = gni.work_precision(scene, [gni.GNI()], [0.5, 0.1], t_end=T, repeats=1, attitude=False)
    failed, good = made.rows
    assert failed.note == "left_domain"
    assert failed.times is None
    assert failed.accuracy == {}
    assert good.note == ""
    assert "left_domain" in made.table()


def test_a_parasitic_mode_is_noted():
    scene = gni.scenes.chaplygin_sleigh()
    made = gni.work_precision(
        scene, [gni.Rattle()], [0.05], t_end=40.0, repeats=1, attitude=False
    )
    assert made.rows[0].note == "parasitic mode"


def test_a_system_with_its_start_will_do():
    scene = gni.scenes.suslov()
    made = gni.work_precision(
        (scene.system, scene.start), [gni.GNI()], [0.1], t_end=T, repeats=1, attitude=False
    )
    assert made.reference == "ReferenceFlow(rtol=1e-13)"
    assert 0.0 < made.estimate < 1e-11


def test_peers_take_part_at_their_tolerances():
    scene = gni.scenes.suslov()
    exact = scene.exact(np.array([T]))[1][0]
    calls = []

    def run(tolerance):
        calls.append(tolerance)
        if tolerance < 1e-6:
            raise RuntimeError("gave up")
        return PeerRun(1e-3, np.zeros(0), exact + np.array([tolerance, 0.0, 0.0]), steps=7)

    peer = Peer("other", (1e-2, 1e-4, 1e-8), run, "as it comes")
    made = gni.work_precision(scene, [], [], t_end=T, repeats=2, peers=[peer])
    assert [row.note for row in made.rows] == ["", "", "gave up"]
    for row in made.rows[:2]:
        assert row.is_peer
        assert row.accuracy[Quantity.VELOCITY].final.value == pytest.approx(row.tolerance)
        assert row.accuracy[Quantity.VELOCITY].largest is None
    assert made.peer_settings == {"other": "as it comes"}
    assert calls.count(1e-8) == 1
    assert len(made.plot().axes) == 2


def test_flows_of_one_curve_may_be_named_together():
    scene = gni.scenes.suslov()
    flows = [gni.ReferenceFlow(rtol=1e-6), gni.ReferenceFlow(rtol=1e-3)]
    made = gni.work_precision(scene, {"flow": flows}, [], t_end=T, repeats=1, attitude=False)
    assert [row.tolerance for row in made.lines["flow"]] == [1e-3, 1e-6]
    with pytest.raises(gni.InputError, match="share a name"):
        gni.work_precision(scene, {"two": [gni.GNI(), gni.Rattle()]}, [0.1], t_end=T)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"scene": 3}, "scene must be"),
        ({"methods": gni.GNI()}, "list of methods"),
        ({"methods": [gni.GNI]}, "pass an instance"),
        ({"steps": []}, "no step sizes"),
        ({"steps": [0.3]}, "whole number of steps"),
        ({"steps": [-0.1]}, "steps must be positive"),
        ({"steps": [np.nan]}, "steps must be positive"),
        ({"steps": [1e9]}, "at most t_end"),
        ({"t_end": -1.0}, "t_end must be positive"),
        ({"t_end": np.inf}, "finite"),
        ({"repeats": 0}, "repeats must be at least 1"),
        ({"reference": gni.GNI()}, "reference must be"),
    ],
)
def test_bad_requests_are_refused_with_a_reason(change, said):
    given = {"scene": gni.scenes.suslov(), "methods": [gni.GNI()], "steps": [0.1], "t_end": 1.0}
    given.update(change)
    with pytest.raises(gni.InputError, match=said):
        gni.work_precision(**given)


def test_rotations_are_told_apart_by_an_example_and_compared_by_angle():
    space = gni.FramedPairGroupoid(gni.VectorGroup(2), gni.SE2())
    angle = 0.3
    c, s = np.cos(angle), np.sin(angle)
    pose = np.array([[c, -s, 1.5], [s, c, -0.4], [0.0, 0.0, 1.0]])
    base = np.array([0.7, -0.2, *pose.ravel()])
    off = base.copy()
    off[2] += 1e-3  # no longer a rotation, but meant as one
    shape = StateShape.of(space, np.array([0.7, -0.2, *np.eye(3).ravel()]))
    assert not shape.turns_only_when_reconstructed
    parts = StateParts.of(shape, np.stack([base, off]), np.zeros((2, 5)))
    assert np.allclose(parts.position, [[0.7, -0.2, 1.5, -0.4]] * 2)
    (rotation,) = parts.rotations
    assert rotation.shape == (2, 2, 2)
    turned = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    assert angle_between(rotation[:1], turned[None])[0] == pytest.approx(2.0 - angle)


def test_slow_runs_take_part_in_fewer_turns():
    seconds = {"quick": 1e-2, "slow": 0.1, "very slow": 0.7, "short": 1e-5}
    counts = dict.fromkeys(seconds, 0)

    def run(name):
        counts[name] += 1
        return seconds[name]

    found = interleaved([lambda name=name: run(name) for name in seconds], 5)
    assert counts == {"quick": 5, "slow": 3, "very slow": 1, "short": 20}
    assert [len(times.seconds) for times in found] == [5, 3, 1, 20]


def test_the_exact_motion_of_a_scene_is_believed_if_it_begins_at_the_start(sleigh):
    def lying(offset, bend):
        def exact(times):
            base, velocity = sleigh.exact(times)
            return base, velocity + (offset + bend * times**2)[:, None]

        return replace(sleigh, exact=exact)

    options = {"t_end": T, "repeats": 1, "attitude": False}
    bent = gni.work_precision(lying(0.0, 1e-3), [gni.GNI(order=8)], [0.1], **options)
    found = bent.rows[0].accuracy[Quantity.STATE].final
    assert found.resolved
    assert found.value == pytest.approx(1e-3 * T**2, rel=1e-6)
    moved = gni.work_precision(lying(1e-3, 0.0), [gni.GNI(order=8)], [0.1], **options)
    assert not moved.rows[0].accuracy[Quantity.STATE].final.resolved
    asked = gni.work_precision(
        lying(0.0, 1e-3), [gni.GNI(order=8)], [0.1], reference=gni.ReferenceFlow(rtol=1e-13),
        **options,
    )
    assert asked.rows[0].accuracy[Quantity.STATE].final.value < 1e-9
