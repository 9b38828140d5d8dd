"""The parasitic component, the table of a run, and the picture of a verdict."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gearboxes import NOT_REVERSIBLE, gearbox
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.diagnostics import Drift, parasitic_component, records
from groupoid_gni.plotting import plot_drift


def sleigh(method: Any, **options: Any) -> gni.Trajectory:
    scene = gni.scenes.chaplygin_sleigh(mass=1.3, inertia=0.8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            scene.system, scene.start, step=0.02, n_steps=400, method=method, **options
        )


def test_the_parasitic_component_has_the_size_that_the_loop_recorded() -> None:
    run = sleigh(gni.Rattle())
    found = parasitic_component(run)
    assert np.all(np.isnan(found[[0, -1]]))
    inverse = np.linalg.inv(run.system.evaluate("metric", run.base[0]))
    size = np.sqrt(np.einsum("ni,ij,nj->n", found, inverse, found))
    p = run.momenta_before
    relative = size / np.sqrt(np.einsum("ni,ij,nj->n", p, inverse, p))
    # the loop knows a second difference one node later than its middle
    np.testing.assert_allclose(relative[5:-1], run.parasitic_amplitude[6:], rtol=0.02)


def test_its_sign_does_not_alternate() -> None:
    run = sleigh(gni.Rattle())
    mu = run.system.evaluate("constraints", run.base[0])[0]
    along = parasitic_component(run)[5:-5] @ mu
    assert np.all(along > 0.0) or np.all(along < 0.0)
    # it grows smoothly where the motion contracts volume
    assert abs(along[-1]) > abs(along[0])


def test_a_projected_run_has_no_parasitic_component() -> None:
    assert np.all(parasitic_component(sleigh(gni.GNI()))[1:-1] == 0.0)
    with pytest.raises(gni.InputError, match="save_every=1"):
        parasitic_component(sleigh(gni.Rattle(), save_every=2))


def test_the_table_holds_what_applies() -> None:
    scene = gni.scenes.rolling_ball(mass=1.7, radius=0.8, table=0.7)
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=400)
    found = records(
        run,
        generator=lambda x, p: p.Theta * gni.array([-x[1], x[0], 0.0, 0.0, 1.0]),
        momenta={"spin": [0.0, 0.0, 0.0, 0.0, 1.0]},
    )
    assert found.moving is not None
    assert found.moving_drift is not None
    assert found.moving_drift.verdict is Drift.FLAT
    assert found.modified is None
    assert "linear constraints" in found.modified_reason
    assert found.parasitic is None
    assert found.constraint is not None
    assert found.constraint < 1e-13
    text = str(found)
    for word in ("GNI(order=2)", "energy", "moving energy", "spin", "constraints"):
        assert word in text
    assert "parasitic" not in text


def test_the_table_of_a_two_step_run_has_modified_energy_and_parasitic_mode() -> None:
    system, start = gearbox(
        NOT_REVERSIBLE, quartic=0.0, driver=False, stiffness=(1.0, 0.7, 2.0)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        run = gni.integrate(system, start, step=0.1, n_steps=300, method=gni.Rattle())
    found = records(run)
    assert found.modified is not None
    assert found.parasitic == run.parasitic_maximum[-1]
    assert "modified energy" in str(found)
    assert "parasitic" in str(found)


def test_a_run_of_one_node_and_a_free_one_have_a_table_too() -> None:
    free = gni.MechanicalSystem(
        gni.PairGroupoid(1), metric=[[2.3]], potential=lambda x, p: 0.4 * x[0] ** 2
    )
    run = gni.integrate(free, free.state([0.4], [0.7]), step=0.1, n_steps=3)
    found = records(run)
    assert found.constraint is None
    assert found.drift.verdict is Drift.UNDECIDED
    assert "undecided" in str(found)


@pytest.mark.parametrize("kind", ["linear", "walk", "flat", "short"])
def test_the_picture_shows_the_law_of_the_verdict(kind: str, tmp_path: Any) -> None:
    rng = np.random.default_rng(2)
    n = 60 if kind == "short" else 4000
    times = 0.2 * np.arange(n)
    values = 1e-3 * np.sin(times)
    values += {"linear": 1e-5 * times, "walk": np.cumsum(1e-4 * rng.normal(size=n))}.get(kind, 0.0)
    figure = Figure()
    axes = plot_drift(figure.subplots(), times, values)
    word = {"linear": "linear drift", "walk": "random walk", "flat": "flat", "short": "undecided"}
    assert axes.get_title().startswith(word[kind])
    figure.savefig(tmp_path / "figure.png")
    assert len(axes.lines) == 2 + {"linear": 1, "walk": 2, "flat": 1, "short": 0}[kind]
