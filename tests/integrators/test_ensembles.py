"""Ensembles: the bits of single runs in every lane, thread and process; members fail alone."""

from __future__ import annotations

import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni import Outcome

METHODS = [
    gni.Rattle(),
    gni.GNI(),
    gni.GNI(4, flow=gni.EnergyPreserving()),
    gni.GNI(6, flow=gni.Splitting(), projection=None),
    gni.McLachlanPerlmutter(),
]


def ball() -> tuple[gni.MechanicalSystem, list[gni.State]]:
    scene = gni.scenes.inhomogeneous_ball(1.7, 0.9, (0.9, 0.5, 0.7), 0.8, (0.6, -0.2), (0.3, 0.5))
    rng = np.random.default_rng(11)
    starts = [
        scene.system.state(
            scene.start.base, scene.start.velocity * rng.uniform(0.6, 1.4), project_start=True
        )
        for _ in range(11)
    ]
    return scene.system, starts


def alone(system: Any, start: Any, **options: Any) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return gni.integrate(system, start, **options)


def same_bits(first: gni.Trajectory, second: gni.Trajectory) -> None:
    np.testing.assert_array_equal(first.node_steps, second.node_steps)
    np.testing.assert_array_equal(first.rows, second.rows)
    assert first.method_name == second.method_name
    assert first.flights == second.flights
    assert first.outcome is second.outcome


@pytest.mark.parametrize("lanes", [1, 4, 8])
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_every_member_has_the_bits_of_a_run_of_its_own(method, lanes):
    system, starts = ball()
    options = {"step": 0.1, "n_steps": 17, "method": method, "save_every": 5}
    ensemble = gni.integrate_ensemble(system, starts, lanes=lanes, **options)
    assert ensemble.success
    assert len(ensemble) == 11
    for run, start in zip(ensemble, starts, strict=True):
        same_bits(run, alone(system, start, **options))


def test_first_and_last_nodes_are_kept_unless_one_asks_for_more():
    system, starts = ball()
    ensemble = gni.integrate_ensemble(system, starts, step=0.1, n_steps=7)
    assert all(list(run.node_steps) == [0, 7] for run in ensemble)
    final = ensemble.final("base")
    np.testing.assert_array_equal(final[3], ensemble[3].base[-1])
    assert final.shape == (11, 11)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_poses_are_accumulated_in_every_lane(method):
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35, 1.1, 0.6)
    starts = [scene.system.state(velocity=[0.2 * k, 0.5, 0.0]) for k in range(1, 6)]
    options = {"step": 0.1, "n_steps": 9, "method": method, "reconstruct": True, "save_every": 9}
    ensemble = gni.integrate_ensemble(scene.system, starts, **options)
    for run, start in zip(ensemble, starts, strict=True):
        same_bits(run, alone(scene.system, start, **options))
        assert run.reconstruct().shape == (2, 3, 3)


def test_parameters_are_swept_without_compiling_again():
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35, 1.1, 0.6)
    grid = gni.parameter_grid(m=[0.7, 1.3, 2.1], a=[0.1, 0.35])
    assert list(grid["a"]) == [0.1, 0.35] * 3
    assert list(grid["m"]) == [0.7, 0.7, 1.3, 1.3, 2.1, 2.1]
    ensemble = gni.integrate_ensemble(
        scene.system, scene.start, parameters=grid, step=0.1, n_steps=12
    )
    for i, run in enumerate(ensemble):
        own = scene.system.with_parameters(m=grid["m"][i], a=grid["a"][i])
        single = alone(own, scene.start, step=0.1, n_steps=12, save_every=12)
        same_bits(run, single)
        np.testing.assert_array_equal(run.energy(), single.energy())


def test_control_inputs_reach_every_lane():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.7]), constraints=[[0.6, -1.0]],
        force=lambda x, xi, p, u: np.array([u[0], -0.1 * xi[1]]), controls=1,
    )
    starts = [system.state([0.1 * k, 0.2], [0.5, 0.3]) for k in range(6)]
    inputs = np.sin(np.arange(14.0))[:, None]
    options = {"step": 0.1, "n_steps": 14, "controls": inputs, "save_every": 2}
    ensemble = gni.integrate_ensemble(system, starts, method=gni.GNI(4), **options)
    for run, start in zip(ensemble, starts, strict=True):
        same_bits(run, alone(system, start, method=gni.GNI(4), **options))


def falling() -> gni.MechanicalSystem:
    return gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=np.diag([1.3, 0.8, 0.6]),
        constraints=lambda x, p: np.array([[0.3, -0.2 * x[0], 1.0]]),
        potential=lambda x, p: -p.k * (x @ x) ** 3, parameters={"k": 0.4},
    )


def test_a_member_that_fails_fails_alone_and_says_where():
    system = falling()
    places = [0.2, 1.4, 0.3, 0.25, 1.3, 0.1]
    starts = [
        system.state([x, -0.1, 0.2], [0.1, 0.2, 0.3], project_start=True) for x in places
    ]
    options = {"step": 0.02, "n_steps": 120, "save_every": 30}
    ensemble = gni.integrate_ensemble(system, starts, **options)
    assert sorted(ensemble.failures) == [1, 4]
    assert not ensemble.success
    assert "Failed in step" in ensemble.failures[1]
    for run, start in zip(ensemble, starts, strict=True):
        same_bits(run, alone(system, start, on_failure="return", **options))
    assert np.isnan(ensemble.final()[[1, 4]]).all()
    assert np.isfinite(ensemble.final()[[0, 2, 3, 5]]).all()
    assert "member 1" in ensemble.summary()


def test_a_member_whose_start_does_not_fit_its_parameters_is_refused_alone():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.7]),
        constraints=lambda x, p: np.array([[1.0, -p.slope]]), parameters={"slope": 0.5},
    )
    start = system.state([0.1, 0.2], [0.5, 1.0])
    ensemble = gni.integrate_ensemble(
        system, start, parameters={"slope": [0.5, 0.6, 0.5]}, step=0.1, n_steps=4
    )
    assert list(ensemble.failures) == [1]
    assert "violates the constraints" in ensemble.failures[1]
    assert ensemble[1].outcome is Outcome.START_REFUSED
    assert len(ensemble[1]) == 0
    assert ensemble[2].success


def test_members_with_dependent_rows_run_by_themselves():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.7]),
        constraints=lambda x, p: np.array([[1.0, -0.5], [2.0, -1.0]]),
    )
    with pytest.warns(gni.DependentConstraintsWarning):
        starts = [system.state([0.1 * k, 0.2], [0.5, 1.0]) for k in range(3)]
    ensemble = gni.integrate_ensemble(system, starts, step=0.1, n_steps=6)
    assert ensemble.success
    same_bits(ensemble[2], alone(system, starts[2], step=0.1, n_steps=6, save_every=6))


@pytest.mark.parametrize("workers", [1, 2])
def test_threads_and_executors_give_the_same_bits(workers):
    system, starts = ball()
    options = {"step": 0.1, "n_steps": 30, "save_every": 10}
    expected = gni.integrate_ensemble(system, starts, **options)
    threaded = gni.integrate_ensemble(system, starts, threads=workers, lanes=4, **options)
    with ThreadPoolExecutor(workers) as pool:
        pooled = gni.integrate_ensemble(system, starts, executor=pool, **options)
    for members in zip(expected, threaded, pooled, strict=True):
        same_bits(members[0], members[1])
        same_bits(members[0], members[2])


@pytest.mark.slow
def test_a_process_pool_gives_the_same_bits():
    system, starts = ball()
    options = {"step": 0.1, "n_steps": 30, "save_every": 10}
    expected = gni.integrate_ensemble(system, starts, **options)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        sent = gni.integrate_ensemble(system, starts, executor=pool, **options)
    for first, second in zip(expected, sent, strict=True):
        same_bits(first, second)


@pytest.mark.slow
def test_dask_gives_the_same_bits():
    distributed = pytest.importorskip("distributed", reason="the extra [dask] is not installed")
    system, starts = ball()
    options = {"step": 0.1, "n_steps": 30, "save_every": 10}
    expected = gni.integrate_ensemble(system, starts, **options)
    with (
        warnings.catch_warnings(),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        warnings.simplefilter("ignore")
        sent = gni.integrate_ensemble(system, starts, executor=client.get_executor(), **options)
    for first, second in zip(expected, sent, strict=True):
        same_bits(first, second)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lanes": 3}, "lanes must be 1, 2, 4 or 8"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"executor": "processes"}, "concurrent.futures executor"),
        ({"method": gni.ReferenceFlow()}, "loop over integrate"),
        ({"parameters": {"mass": [1.0, 2.0]}}, "unknown parameter 'mass'"),
        ({"parameters": {"m": [[1.0]]}}, "must have shape (members"),
        ({"parameters": {"m": [1.0, 2.0], "r": [1.0]}}, "no single number of members"),
        ({"parameters": {"m": []}}, "at least one member"),
        ({"n_steps": -1}, "n_steps must be at least 0"),
        ({"save_every": 0}, "save_every must be at least 1"),
    ],
)
def test_requests_that_make_no_sense_are_refused(options, words):
    system, starts = ball()
    with pytest.raises(gni.InputError) as caught:
        gni.integrate_ensemble(system, starts[0], **{"step": 0.1, "n_steps": 3, **options})
    assert words in str(caught.value)


def test_starts_of_another_kind_are_refused():
    system, starts = ball()
    with pytest.raises(gni.InputError, match=r"starts\[1\] is a list"):
        gni.integrate_ensemble(system, [starts[0], [1.0]], step=0.1, n_steps=3)


def test_inputs_are_left_alone_and_progress_counts_members(capsys):
    system, starts = ball()
    before = [start.momentum.copy() for start in starts]
    gni.integrate_ensemble(system, starts, step=0.1, n_steps=5, progress=True)
    assert "11.0/11.0" in capsys.readouterr().err
    for start, momentum in zip(starts, before, strict=True):
        np.testing.assert_array_equal(start.momentum, momentum)


def test_a_parasitic_mode_is_told_once_for_all_members():
    scene = gni.scenes.chaplygin_sleigh()
    starts = [
        scene.system.state(scene.start.base, s * scene.start.velocity) for s in (0.01, 1.0, 1.3)
    ]
    options = {"step": 0.05, "n_steps": 500, "method": gni.Rattle(), "save_every": 10}
    with pytest.warns(gni.ParasiticModeWarning, match="2 of 3 members, first member 1") as found:
        ensemble = gni.integrate_ensemble(scene.system, starts, **options)
    assert len(found) == 1
    assert found[0].message.result is ensemble[1]
