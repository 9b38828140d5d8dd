"""C, heyoka, SciPy and the reference flow end at the same state on every system. No times."""

import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import peers  # noqa: E402
import step_cost  # noqa: E402
import time_to_accuracy  # noqa: E402

import groupoid_gni as gni  # noqa: E402

T = 3.0
MODELS = {
    "sleigh": peers.sleigh,
    "Suslov": peers.suslov,
    "ball": peers.ball,
    "ball on a fixed table": lambda: peers.ball(0.0),
    "quartic particle": peers.quartic_particle,
    "transmission": peers.gearbox,
    "transmission, f = sin y": lambda: peers.gearbox(shifted=False),
    "contact oscillator": peers.contact_oscillator,
    "contact oscillator, chaotic": lambda: peers.contact_oscillator(2.0),
}
needs_c = pytest.mark.skipif(step_cost.c_compiler() is None, reason="no C compiler (cc)")


@pytest.fixture(params=MODELS, scope="module")
def model(request):
    return MODELS[request.param]()


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """(form, extended) -> its C, compiled once."""
    folder, done = tmp_path_factory.mktemp("c"), {}

    def get(form, extended=False):
        key = (form.defines, form.parameters, extended)
        if key not in done:
            (folder / str(len(done))).mkdir()
            done[key] = peers.C(form, folder / str(len(done)), extended)
        return done[key]

    return get


def reference(model, t_end=T):
    scene = model.scene
    run = gni.integrate(
        scene.system, scene.start, step=t_end, n_steps=1, method=gni.ReferenceFlow(rtol=1e-13)
    )
    return np.concatenate(run.final_state)


@needs_c
def test_c_ends_where_the_reference_flow_ends(model, compiled):
    for form in model.c_forms:
        for extended in (False, True):
            end = compiled(form, extended).run(T, 1e-13).end
            assert np.max(np.abs(end - reference(model))) < 1e-9, (form.name, extended)


def test_heyoka_ends_where_the_reference_flow_ends(model):
    heyoka = pytest.importorskip("heyoka")
    for form in model.forms:
        end = peers.Taylor(form, heyoka, compact=True).run(T, 1e-14).end
        assert np.max(np.abs(end - reference(model))) < 1e-9, form.name


@pytest.mark.parametrize("method", ["DOP853", "LSODA"])
def test_scipy_ends_where_the_reference_flow_ends(model, method):
    end = peers.SciPy(model.numpy, method).run(T, 1e-12).end
    assert np.max(np.abs(end - reference(model))) < 1e-9


@needs_c
def test_c_has_the_energy_of_the_library(model, compiled):
    start = model.scene.system.state
    for form in model.c_forms:
        code = compiled(form)
        found = [code.energy_and_violation(form.start)[0]]
        moved = form.start.copy()
        code.advance(moved, T, 1e-12)
        found.append(code.energy_and_violation(moved)[0])
        n = model.scene.system.space.base_size
        expected = []
        for native in (form.start, moved):
            whole = form.library_state(native)
            state = start(whole[:n], whole[n:], project_start=True)
            run = gni.integrate(model.scene.system, state, step=1e-3, n_steps=1)
            expected.append(run.energy()[0])
            np.testing.assert_allclose(model.look(whole)[0], expected[-1], rtol=1e-12)
            assert model.look(whole)[1] < 1e-10
        # the sleigh's mass is 1; no additive constant is left out anywhere
        np.testing.assert_allclose(found, expected, rtol=1e-12, err_msg=form.name)


@needs_c
def test_c_converges_with_order_eight(compiled):
    """The steps grow as error^(-1/8) or a little slower; a wrong digit costs orders."""
    (form,) = peers.contact_oscillator().forms
    code = compiled(form)
    truth = compiled(form, extended=True).run(40.0, 1e-17).end
    runs = [code.run(40.0, rtol) for rtol in 10.0 ** -np.arange(5.0, 11.5, 0.5)]
    errors = [np.max(np.abs(run.end - truth)) for run in runs]
    slope = np.polyfit(np.log([run.steps for run in runs]), np.log(errors), 1)[0]
    assert -10.0 < slope < -7.5


@needs_c
def test_c_watches_what_the_flow_keeps(compiled):
    form = peers.ball(0.0).c_forms[0]
    code = compiled(form)
    watched = np.array([0.0, 0.0, code.energy_and_violation(form.start)[0]])
    code.advance(form.start.copy(), 50.0, 1e-6, watched)
    assert 1e-9 < watched[0] < 1e-4
    assert watched[1] < 1e-9


def test_every_form_of_the_ball_starts_at_the_scene():
    for table in (None, 0.0):
        model = peers.ball(table)
        start = model.scene.start
        for form in model.forms:
            state = form.library_state(form.start)
            expected = np.concatenate([start.base, start.velocity])
            np.testing.assert_allclose(state, expected, atol=1e-15)


def test_a_lucky_zero_of_the_error_is_not_chosen():
    point = time_to_accuracy.Point
    errors = [1e-2, 1e-9, 1e-3, 1e-5, 1e-6, 1e-7, 1e-8]
    points = [point(k, error, float(k)) for k, error in enumerate(errors)]
    assert time_to_accuracy.fastest(points, 1e-4).setting == 3
    assert time_to_accuracy.fastest(points, 1e-7) is None


@pytest.mark.slow
def test_a_measurement_of_the_sleigh_gives_every_peer_a_time(tmp_path, monkeypatch):
    monkeypatch.setattr(time_to_accuracy, "TARGETS", (1e-3,))
    monkeypatch.setattr(time_to_accuracy, "ORDERS", (2,))
    result = time_to_accuracy.measure(peers.sleigh(), tmp_path, quick=True)
    rows = {cell.row for cell in result.cells}
    assert {"SciPy, DOP853", "ReferenceFlow", "Rattle", "GNI 2, Variational"} <= rows
    assert all(cell.error <= cell.target and cell.seconds > 0.0 for cell in result.cells)
    time_to_accuracy.figure([result], tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
