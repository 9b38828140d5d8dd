"""Judging long runs: what counts as kept, and that peers and library are judged alike. No times."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import long_runs  # noqa: E402
import peers  # noqa: E402
import step_cost  # noqa: E402

import groupoid_gni as gni  # noqa: E402

needs_c = pytest.mark.skipif(step_cost.c_compiler() is None, reason="no C compiler (cc)")


def record(setting, kept, per_time=1.0):
    return long_runs.Record("row", "", setting, per_time, kept, {})


def test_kept_needs_energy_and_constraint():
    kept = record(1, {1e4: (1e-7, 1e-12)})
    assert kept.keeps(1e4, 1e-6)
    assert not kept.keeps(1e4, 1e-9)
    assert not kept.keeps(1e5, 1e-6)
    assert not record(1, {1e4: (1e-7, 1e-9)}).keeps(1e4, 1e-6)


def test_a_setting_whose_drift_leads_out_of_the_tolerance_is_not_hopeful():
    drifting = record(1, {1e3: (1e-5, 0.0), 1e4: (1e-4, 0.0)}, 1.0)
    flat = record(2, {1e3: (1e-4, 0.0), 1e4: (1e-4, 0.0)}, 2.0)
    assert long_runs._hopeful([drifting, flat], 1e6, 1e-3) == [flat]
    assert long_runs._hopeful([drifting, flat], 1e5, 1e-3) == [drifting, flat]


@needs_c
def test_peers_and_library_are_judged_alike(tmp_path):
    model = peers.quartic_particle()
    judge = long_runs.Judge(model, tmp_path)
    library = long_runs.by_library(model, "Rattle", gni.Rattle(), 1)
    (form,) = model.c_forms
    runs = [
        judge.record(library, 4096, 1e2),
        judge.record(long_runs.in_c(form, tmp_path, 1), 1e-6, 1e2),
    ]
    for run, low, high in zip(runs, (1e-6, 1e-7), (1e-3, 1e-4), strict=True):
        energy, violation = run.kept[1e2]
        assert low < energy < high
        assert violation < 1e-13
        assert math.isfinite(run.per_time)


@needs_c
def test_positions_are_those_of_the_reference_flow(tmp_path):
    model = peers.quartic_particle()
    judge = long_runs.Judge(model, tmp_path)
    state, uncertainty = judge.positions[long_runs.SHORT]
    assert uncertainty < 1e-7
    code = peers.C(model.c_forms[0], tmp_path)
    end = code.run(long_runs.SHORT, 1e-14).end[: judge.n]
    assert np.max(np.abs(end - state)) < 1e-6


def test_a_run_that_fails_keeps_nothing(tmp_path):
    model = peers.contact_oscillator(2.0)
    judge = long_runs.Judge(model, tmp_path)

    def fail(setting, t_end):
        raise RuntimeError("step too small")

    found = judge.record(long_runs.Contender("row", "", (1,), fail), 1, 1e4)
    assert not found.keeps(1e4, 1.0)


def test_heyoka_is_watched_over_the_whole_run(tmp_path):
    heyoka = pytest.importorskip("heyoka")
    model = peers.contact_oscillator(2.0)
    (form,) = model.forms
    judge = long_runs.Judge(model, tmp_path)
    found = judge.record(long_runs.by_series(form, heyoka, 1), 1e-10, 1e2)
    assert 1e-14 < found.kept[1e2][0] < 1e-8
    assert found.kept[1e2][1] < 1e-14


def test_results_survive_a_file():
    kept = {1e2: (1e-10, 0.0), 1e4: (math.inf, math.inf)}
    result = long_runs.Result("model", [record(3, kept)], {1e4: 1e-9}, ["a note"])
    text = json.dumps(long_runs.as_data(result))
    assert long_runs.from_data(json.loads(text)) == result


def test_the_figure_is_drawn(tmp_path):
    kept = dict.fromkeys(long_runs.HORIZONS, (1e-10, 0.0))
    rows = ("C, DOP853", "heyoka, Taylor", "Rattle", "GNI 4, Splitting")
    records = [long_runs.Record(row, "", 1, 1e-6, kept, {}) for row in rows]
    long_runs.figure([long_runs.Result("model", records, {}, [])], tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
