"""The result object: what it tells, what it refuses, how it is stored."""

import json

import numpy as np
import pytest

import groupoid_gni as gni


@pytest.fixture(scope="module")
def scene():
    return gni.scenes.rolling_ball(mass=1.4, radius=0.9, inertia=0.5, table=0.7)


@pytest.fixture(scope="module")
def run(scene):
    return gni.integrate(scene.system, scene.start, step=0.04, n_steps=200)


def test_times_are_step_numbers_times_the_step(run):
    assert np.array_equal(run.times, np.arange(201) * 0.04)
    assert len(run) == 201
    assert "201 nodes" in repr(run)


def test_arrays_have_the_documented_shapes(run):
    assert run.base.shape == (201, 2)
    for momenta in (run.momenta, run.momenta_before, run.momenta_after, run.velocities):
        assert momenta.shape == (201, 5)
    assert run.multipliers.shape == run.constraint_residuals().shape == (201, 2)
    assert run.arrows.shape == (200, 13)
    assert run.energy().shape == run.times.shape
    assert run.newton_iterations.shape == (200,)


def test_arrows_join_the_nodes(run, scene):
    space = scene.system.space
    assert np.allclose(space.source(run.arrows), run.base[:-1], rtol=0, atol=1e-14)
    assert np.allclose(space.target(run.arrows), run.base[1:], rtol=0, atol=1e-13)


def test_summary_tells_outcome_energy_constraint_and_effort(run):
    text = run.summary()
    words = ("GNI(order=2)", "200 steps", "success", "energy", "constraints", "Newton", "ns per")
    for word in words:
        assert word in text


def test_the_summary_tells_the_moving_energy_where_a_drift_does_work():
    scene = gni.scenes.rolling_ball()
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=200)
    (line,) = [line for line in run.summary().split("\n") if line.startswith("  moving")]
    assert float(line.split()[-1]) < 1e-12
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.eye(2), constraints=[[1.0, 0.3]],
        drift=lambda x, p: np.array([np.sin(x[0]), 0.2]), potential=lambda x, p: x[1] ** 4,
    )
    start = system.state([0.3, 0.4], [0.1, 0.2], project_start=True)
    run = gni.integrate(system, start, step=0.05, n_steps=20)
    assert "no moving energy found with linear sections" in run.summary()
    still = gni.scenes.suslov()
    run = gni.integrate(still.system, still.start, step=0.05, n_steps=5)
    assert "moving" not in run.summary()


def test_multipliers_are_the_physical_force_of_the_exact_motion(run, scene):
    # the ball's contact force is m v', and v turns at the rate Theta I / (I + m r^2)
    p = scene.system.parameters
    rate = p["Theta"] * p["I"] / (p["I"] + p["m"] * p["r"] ** 2)
    v = run.velocities[:, :2]
    force = p["m"] * rate * np.stack([-v[:, 1], v[:, 0]], axis=1)
    assert np.allclose(run.multipliers, force, atol=1e-12)


def test_two_step_multipliers_agree_with_the_physical_force_to_second_order(scene):
    run = gni.integrate(scene.system, scene.start, step=0.01, n_steps=400, method=gni.Rattle())
    exact = gni.integrate(scene.system, scene.start, step=0.01, n_steps=400)
    assert np.max(np.abs(run.multipliers - exact.multipliers)) < 3e-4


def test_arrows_are_refused_when_nodes_were_skipped(scene):
    run = gni.integrate(scene.system, scene.start, step=0.04, n_steps=30, save_every=7)
    assert list(run.node_steps) == [0, 7, 14, 21, 28, 30]
    with pytest.raises(gni.InputError, match=r"save_every > 1.*reconstruct=W0"):
        _ = run.arrows


def test_a_saved_run_comes_back_whole(run, scene, tmp_path):
    path = run.save(tmp_path / "ball run")
    assert path.name == "ball run.npz"
    other = scene.system.with_parameters(m=9.0)
    back = gni.Trajectory.load(path, other)
    assert np.array_equal(back.rows, run.rows, equal_nan=True)
    assert np.array_equal(back.energy(), run.energy())
    assert back.summary() == run.summary()
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_of_another_system_is_refused(run, tmp_path):
    path = run.save(tmp_path / "ball.npz")
    sleigh = gni.scenes.chaplygin_sleigh().system
    with pytest.raises(gni.TrajectoryFileError, match="belongs to another system"):
        gni.Trajectory.load(path, sleigh)


@pytest.mark.parametrize("keep", [0, 10, 200])
def test_a_truncated_file_is_refused_with_advice(run, scene, tmp_path, keep):
    path = run.save(tmp_path / "ball.npz")
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(gni.TrajectoryFileError, match=r"not a complete trajectory.*save"):
        gni.Trajectory.load(path, scene.system)


def test_a_file_of_another_format_is_refused(scene, tmp_path):
    np.savez(
        tmp_path / "x.npz",
        header=np.array(json.dumps({"format": "something", "parameters": []})),
        node_steps=np.arange(3),
        rows=np.zeros((3, 4)),
    )
    with pytest.raises(gni.TrajectoryFileError, match="unknown format 'something'"):
        gni.Trajectory.load(tmp_path / "x.npz", scene.system)


def test_a_missing_file_is_the_usual_error(scene, tmp_path):
    with pytest.raises(FileNotFoundError):
        gni.Trajectory.load(tmp_path / "nowhere.npz", scene.system)


def test_the_final_state_starts_a_second_run_where_the_first_ended(run, scene):
    more = gni.integrate(
        scene.system, scene.system.state(*run.final_state), step=0.04, n_steps=100
    )
    whole = gni.integrate(scene.system, scene.start, step=0.04, n_steps=300)
    assert np.allclose(more.base[-1], whole.base[-1], rtol=0, atol=1e-12)


def test_arrows_of_a_run_shorter_than_its_saving_are_refused_and_not_nan(scene):
    run = gni.integrate(scene.system, scene.start, step=0.04, n_steps=1, save_every=5)
    with pytest.raises(gni.InputError, match="save_every > 1"):
        _ = run.arrows


def test_poses_accumulated_afterwards_stay_rotations_as_in_the_loop(scene):
    n = 20000
    after = gni.integrate(scene.system, scene.start, step=0.05, n_steps=n).reconstruct()
    defect = np.abs(np.einsum("nij,nik->njk", after, after) - np.eye(3))
    assert np.max(defect) < 2e-15


def test_a_trajectory_is_read_only_and_compares_by_identity(run):
    with pytest.raises(ValueError, match="read-only"):
        run.rows[0, 0] = 1.0
    assert run == run
    assert len({run, run}) == 1


def test_a_file_with_a_parameter_of_another_shape_is_refused(run, tmp_path):
    path = run.save(tmp_path / "ball.npz")
    other = gni.MechanicalSystem(
        gni.AtiyahGroupoid(base_dim=2, group=gni.SO3(side="right")),
        np.diag([1.0, 1.1, 1.2, 1.3, 1.4]),
        parameters={"m": 1.4, "r": [0.9, 0.8], "I": 0.5, "Theta": 0.7},
    )
    with pytest.raises(gni.TrajectoryFileError, match="belongs to another system"):
        gni.Trajectory.load(path, other)


def test_a_two_step_run_without_constraints_says_that_it_has_no_parasitic_record():
    system = gni.MechanicalSystem(gni.SO3(), np.diag([1.1, 0.7, 1.9]))
    start = system.state(velocity=[0.3, 1.2, -0.4])
    run = gni.integrate(system, start, step=0.1, n_steps=9, method=gni.Rattle())
    with pytest.raises(gni.InputError, match="no parasitic"):
        _ = run.parasitic_amplitude


def test_a_file_of_a_system_with_other_terms_is_refused(tmp_path):
    def made(row):
        return gni.MechanicalSystem(
            gni.PairGroupoid(2), np.diag([1.3, 0.7]), constraints=[[1.0, row]]
        )

    system = made(2.0)
    start = system.state([0.1, 0.2], [-0.6, 0.3])
    path = gni.integrate(system, start, step=0.1, n_steps=5).save(tmp_path / "run")
    assert gni.Trajectory.load(path, made(2.0)).success
    with pytest.raises(gni.TrajectoryFileError, match=r"another system.*constraints"):
        gni.Trajectory.load(path, made(3.0))
