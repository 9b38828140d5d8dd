"""The native forms of the report's scenes are the scenes; whoever is installed ends where we do."""

import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import native_scenes  # noqa: E402
import reductions  # noqa: E402
import report_peers  # noqa: E402
import simulators  # noqa: E402

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports.report_scenes import SCENES  # noqa: E402

T = 1.5


def end_of(scene, t_end=T):
    run = gni.integrate(
        scene.system, scene.start, step=t_end, n_steps=1, method=gni.ReferenceFlow(rtol=1e-12)
    )
    return run.final_state


def gap(found, wanted):
    return max(np.max(np.abs(a - b), initial=0.0) for a, b in zip(found, wanted, strict=True))


@pytest.fixture(params=SCENES, ids=lambda entry: entry.name)
def entry(request):
    return request.param


def test_every_scene_of_the_report_has_a_native_form():
    assert set(native_scenes.MAKERS) == {entry.name for entry in SCENES}


def test_both_forms_start_and_end_where_the_scene_does(entry):
    from scipy.integrate import solve_ivp

    scene = entry.make()
    native = native_scenes.MAKERS[entry.name](scene)
    derived = native.derived
    fields = {
        "stated": (native.stated.field, native.stated),
        "derived": (lambda t, y: np.array(derived.rates(np, y)), derived),
    }
    wanted = end_of(scene)
    for field, form in fields.values():
        assert gap(form.node(form.start), (scene.start.base, scene.start.velocity)) < 1e-14
        done = solve_ivp(field, (0.0, T), form.start, method="DOP853", rtol=1e-10, atol=1e-12)
        assert gap(form.node(done.y[:, -1]), wanted) < 1e-8


def test_straight_line_code_is_the_derived_field(entry):
    derived = native_scenes.MAKERS[entry.name](entry.make()).derived
    source = report_peers.straight_line_source(derived, "def rates(t, y, dy):", "dy[{i}] = {value}")
    y = derived.start + 0.1 * np.arange(1.0, len(derived.start) + 1.0)
    dy = np.zeros(len(y))
    report_peers._function(source, "rates")(0.0, y, dy)
    assert np.allclose(dy, derived.rates(np, y), rtol=1e-14, atol=1e-14)


def test_absent_packages_are_named(monkeypatch):
    monkeypatch.setattr(report_peers, "module", lambda package: None)
    (note,) = report_peers.notes()
    for package in report_peers.MODULES:
        assert package in note
    scene = SCENES[3].make()
    names = [peer.name for peer in report_peers.peers_of("suslov", scene, T, True)]
    assert names == ["SciPy DOP853", "SciPy RK45", "SciPy Radau", "SciPy LSODA"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # other people's packages
def test_whoever_is_installed_ends_where_the_scene_does(entry):
    scene = entry.make()
    wanted = end_of(scene)
    for peer in report_peers.peers_of(entry.name, scene, T, True):
        tolerance = peer.tolerances[-1]
        run = peer.run(tolerance)
        assert gap((run.base, run.velocity), wanted) < max(1e-9, 1e3 * tolerance), peer.name
        assert peer.run(tolerance).seconds > 0.0


def test_framed_models_move_as_their_reductions_do():
    for reduction in reductions.reductions():
        framed = reduction.fulls["framed"](reduction.scene)
        assert reductions.difference(reduction, framed, gni.GNI()) < 1e-12


def test_the_simulator_rolls_towards_our_motion():
    mujoco = simulators.mujoco_module()
    if mujoco is None:
        pytest.skip("MuJoCo is not installed")
    scene = gni.scenes.inhomogeneous_ball(table=0.0)
    base, velocity = end_of(scene, simulators.T)
    errors = []
    for h in (5e-3, 2.5e-3):
        place, rotation, v, _ = simulators.mujoco_run(mujoco, scene, h)
        errors.append(gap((np.concatenate([place, rotation]), v), (base, velocity)))
    assert errors[0] < 2e-3
    assert errors[1] < 0.7 * errors[0]


@pytest.fixture(scope="module")
def disc():
    scene = gni.scenes.rolling_disc(tilt=20.0, spin=(0.3, 4.0, 1.5))
    flow = gni.ReferenceFlow(rtol=1e-12)
    return scene, simulators.our_disc(scene, simulators.DISC_T, flow, steps=1)


def test_the_pose_of_a_disc_sees_its_vertical_and_touches_the_plane(disc):
    scene, end = disc
    gamma = np.array([-0.48, 0.6, 0.64])
    pose = simulators.upright_pose(gamma, 0.7)
    assert np.allclose(pose[:3, :3].T @ [0.0, 0.0, 1.0], gamma, atol=1e-15)
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-15)
    assert np.linalg.det(pose) == pytest.approx(1.0)
    lowest = -0.7 * gamma * [1.0, 1.0, 0.0] / np.hypot(gamma[0], gamma[1])
    assert (pose[:3, :3] @ lowest + pose[:3, 3])[2] == pytest.approx(0.0, abs=1e-15)
    errors = simulators.disc_errors(scene, end, end.pose)
    assert errors.pose == 0.0
    assert max(errors.energy, errors.slip, errors.lift) < 1e-10


@pytest.mark.filterwarnings("ignore")  # other people's packages
@pytest.mark.parametrize("formulation", simulators.FORMULATIONS)
def test_the_disc_of_exudyn_rolls_towards_ours_at_order_two(disc, formulation):
    exudyn = simulators.exudyn_module()
    if exudyn is None:
        pytest.skip("Exudyn is not installed")
    scene, wanted = disc
    found = []
    for h in (0.02, 0.01):
        end = simulators.exudyn_disc(exudyn, scene, h, formulation)
        found.append(simulators.disc_errors(scene, end, wanted.pose))
    assert found[1].slip < 1e-6
    assert found[0].pose < 0.1
    for kind in ("place", "attitude", "energy"):
        assert 3.3 < getattr(found[0], kind) / getattr(found[1], kind) < 4.8, kind


def test_our_disc_is_as_exact_as_asked_and_says_when_it_cannot_be(disc):
    scene, wanted = disc
    h, seconds = simulators.as_exact(scene, gni.GNI(order=4), 1e-6, wanted.pose, 1)
    end = simulators.our_disc(scene, h, gni.GNI(order=4))
    assert simulators.disc_errors(scene, end, wanted.pose).pose <= 1e-6
    assert seconds > 0.0
    coarser = simulators.our_disc(scene, 1.3 * h, gni.GNI(order=4), round(2.0 / (1.3 * h)))
    assert simulators.disc_errors(scene, coarser, wanted.pose).pose > 1e-6
    assert simulators.as_exact(scene, gni.GNI(), 0.0, wanted.pose, 1) is None
    failed = simulators.our_disc(scene, 1.0, gni.GNI())
    assert np.isnan(simulators.disc_errors(scene, failed, wanted.pose).pose)


@pytest.mark.slow
def test_the_table_of_discs_says_that_exudyn_is_absent(monkeypatch):
    monkeypatch.setattr(simulators, "exudyn_module", lambda: None)
    text = simulators.disc_section(quick=True)
    assert "Exudyn is not installed" in text
    assert "GNI 4, h = 0.0025" in text
    assert "times faster" not in text
