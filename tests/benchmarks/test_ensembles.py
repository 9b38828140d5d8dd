"""The table of ensembles: what is counted, that bits are compared, and how the rows come about."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import ensembles  # noqa: E402
import report_peers  # noqa: E402

import groupoid_gni as gni  # noqa: E402


@pytest.fixture(scope="module")
def members():
    return ensembles.Members.of_the_ball(5)


def test_members_differ_and_start_on_the_constraint(members):
    for start in members.starts:
        residual = members.system.constraint_residuals(start.base[None], start.velocity[None])
        assert np.max(np.abs(residual)) < 1e-14
    assert len({start.velocity.tobytes() for start in members.starts}) == 5


def test_the_slowest_lane_is_the_largest_of_its_batch():
    counts = np.array([[1.0, 4.0], [3.0, 2.0], [5.0, 5.0]])
    assert ensembles.slowest_of(counts, 1) == pytest.approx(counts.mean())
    # (3 + 4) for two members, (5 + 5) for the third
    assert ensembles.slowest_of(counts, 2) == pytest.approx((2 * 7.0 + 10.0) / 6.0)
    assert ensembles.slowest_of(counts, 4) == pytest.approx(5.0)


def test_one_bit_of_one_member_is_seen(members):
    wanted = members.alone(gni.GNI(), 7)
    found = list(members.together(gni.GNI(), 7, 4, 1))
    assert ensembles.same_bits(found, wanted)
    rows = found[3].rows.copy()
    rows[-1, 2] = np.nextafter(rows[-1, 2], np.inf)
    found[3] = replace(found[3], rows=rows)
    assert not ensembles.same_bits(found, wanted)
    assert not ensembles.same_bits(found[:3], wanted)


@pytest.mark.parametrize("name", ["GNI 2", "Rattle"])
def test_every_configuration_is_timed_and_lanes_wait(members, name):
    cost = ensembles.measured(members, ensembles.METHODS[name], 300, 1)
    assert cost.same_bits
    assert set(cost.wall) == {"loop", *((n, k) for n in (1, 4, 8) for k in (1, 2))}
    for key, wall in cost.wall.items():
        assert cost.inside[key] > 0.0
        assert 0.0 < wall < np.inf
    assert cost.iterations == cost.slowest[1] >= 1.0
    assert cost.slowest[1] < cost.slowest[4] <= cost.slowest[8]


def test_rows_are_ratios_of_the_times_and_shout_at_other_bits():
    wall = {"loop": 6.0, (1, 1): 5.0, (1, 2): 3.0, (4, 1): 2.0, (4, 2): 1.6, (8, 1): 1.5,
            (8, 2): 1.2}  # fmt: skip
    inside = {**dict.fromkeys(wall, 1.0), "loop": 3.5}
    cost = ensembles.EnsembleCost(9, wall, inside, 4.0, {1: 4.0, 4: 4.5, 8: 4.75}, False)
    rows = ensembles.rows_of("GNI 2", cost)
    wanted = ["GNI 2, 9 steps", "4", "2000.0", "2.50", "3.00", "3.50", "1.25", "4.00", "4.50", "NO"]
    assert rows[1] == wanted
    explicit = ensembles.rows_of("GNI 2", replace(cost, iterations=0.0, same_bits=True))
    assert explicit[2][-3:] == ["-", "-", "yes"]


def test_the_report_shows_the_table_and_a_quick_one_the_short_runs_only(monkeypatch):
    asked = []

    def cost(members, method, steps, repeats):
        asked.append(steps)
        wall = {"loop": 1.0, **{(n, k): 1.0 for n in (1, 4, 8) for k in (1, 2)}}
        return ensembles.EnsembleCost(steps, wall, wall, 2.0, {1: 2.0, 4: 2.5, 8: 3.0}, True)

    monkeypatch.setattr(ensembles, "measured", cost)
    text = report_peers.ensemble_table(quick=True)
    assert set(asked) == {ensembles.SHORT}
    for name in ensembles.METHODS:
        assert f"| {name}, {ensembles.SHORT} steps" in text
    assert "of the slowest lane" in text
    report_peers.ensemble_table(quick=False)
    assert set(asked) == {ensembles.SHORT, ensembles.LONG}


def test_the_command_prints_the_table(monkeypatch, capsys):
    monkeypatch.setattr(ensembles, "section", lambda quick: f"quick {quick}")
    ensembles.main(["--quick"])
    assert capsys.readouterr().out == "quick True\n"
