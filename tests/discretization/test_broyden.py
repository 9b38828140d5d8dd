"""Broyden's search: superlinear, kept from stage to stage, forgotten when it points backwards."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest

from groupoid_gni.discretization.broyden import Broyden
from groupoid_gni.outcomes import Outcome

BEND = np.array([[0.5, -0.3], [0.2, 0.4]])
WANTED = np.array([0.3, -0.7])


class Search:
    """``closing(v) = slope (v - wanted) + bend g (v - wanted) + small square``, run by hand."""

    def __init__(self, slope: float, power: int, bend: Any = BEND, scale: Any = None) -> None:
        self.fraction, self.drive = ca.SX.sym("g"), ca.SX.sym("drive", 2)
        search = self.search = Broyden([[0, 1]], self.fraction, slope, power)
        off = search.value - self.drive
        closing = slope * off + self.fraction * ca.mtimes(ca.SX(bend), off) + 0.1 * off * off
        search.close(closing, ca.SX(1.0), scale)
        self.step = ca.Function(
            "step", [search.unknown, search.carried, search.later, self.fraction, self.drive],
            [search.update, search.next_carried, closing, search.work, search.guards[0].value],
        )
        self.carried = np.array(ca.DM(search.first_carried)).ravel()

    def run(self, fraction: float, drive: Any, unknown: Any, count: int) -> tuple[Any, list[float]]:
        """Unknown after ``count`` iterations, and the sizes of ``closing``."""
        sizes = []
        for k in range(count):
            update, carried, closing, *_ = self.step(
                unknown, self.carried, float(k > 0), fraction, drive
            )
            self.carried = np.array(carried).ravel()
            unknown = unknown - np.array(update).ravel()
            sizes.append(float(np.max(np.abs(np.array(closing)))))
        return unknown, sizes


@pytest.mark.parametrize(("slope", "power"), [(-2.0, 2), (1.0, 1)])
@pytest.mark.parametrize("fraction", [0.4, -0.7])
def test_the_value_is_found_and_the_unknown_is_scaled(
    slope: float, power: int, fraction: float
) -> None:
    search = Search(slope, power)
    unknown, sizes = search.run(fraction, WANTED, np.zeros(2), 12)
    np.testing.assert_allclose(fraction**power * unknown, WANTED, rtol=0, atol=1e-14)
    assert sizes[-1] < 1e-14
    # faster than any geometric sequence
    ratios = [b / a for a, b in pairwise(sizes) if b > 1e-13]
    assert ratios[-1] < 0.1 * ratios[0]


def test_what_is_learnt_helps_the_next_stage_and_changes_sign_with_it() -> None:
    learnt = Search(-2.0, 2)
    learnt.run(0.6, WANTED, np.zeros(2), 10)
    unlearnt = Search(-2.0, 2)
    for search in (learnt, unlearnt):  # close to the solution, where the square is small
        start = (WANTED + 1e-4) / (-0.5) ** 2
        search.sizes = search.run(-0.5, WANTED, start, 2)[1]
    assert learnt.sizes[0] == pytest.approx(unlearnt.sizes[0], rel=1e-10)
    # the bend was learnt in the directions tried, not in all
    assert learnt.sizes[1] < 0.5 * unlearnt.sizes[1]


def test_an_exactly_linear_equation_is_learnt() -> None:
    search = Search(-2.0, 1, bend=np.zeros((2, 2)))
    _, sizes = search.run(0.8, 1e-6 * WANTED, np.zeros(2), 3)
    assert sizes[1] < 1e-11


def test_a_move_of_round_off_teaches_nothing() -> None:
    search = Search(-2.0, 2)
    bend = search.carried.copy()
    bend[4:6] = 1e-12  # the last move; closing jumped by round-off of another size
    bend[6:8] = 3e-9
    _, carried, *_ = search.step(WANTED / 0.25, bend, 1.0, 0.5, WANTED)
    np.testing.assert_array_equal(np.array(carried).ravel()[:4], bend[:4])


def test_an_inverse_that_points_backwards_is_given_up() -> None:
    search = Search(-2.0, 2)
    carried = search.carried.copy()
    carried[:4] = np.eye(2).ravel() * 4.0  # 1/slope + g D > 0: the wrong sign
    carried[4:6], carried[6:8] = [0.1, 0.2], [0.5, 0.6]
    update, after, closing, *_ = search.step(WANTED, carried, 1.0, 0.5, WANTED)
    np.testing.assert_allclose(np.array(after).ravel()[:4], 0.0, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        np.array(update).ravel(), np.array(closing).ravel() / -2.0 / 0.25, rtol=1e-14
    )


def test_a_large_inverse_trips_the_guard() -> None:
    search = Search(-2.0, 2)
    (guard,) = search.search.guards
    assert guard.code == Outcome.PROJECTION_SINGULAR
    assert guard.decisive
    carried = search.carried.copy()
    assert float(search.step(np.zeros(2), carried, 0.0, 0.5, WANTED)[4]) < 0.1
    carried[:4] = 1e3 * np.eye(2).ravel()
    assert float(search.step(np.zeros(2), carried, 0.0, 0.5, WANTED)[4]) > 1.0


def test_work_is_an_energy_and_nothing_is_searched_for_without_constraints() -> None:
    plain, scaled = Search(1.0, 1), Search(1.0, 1, scale=ca.SX(np.diag([2.0, 3.0])))
    works = [float(s.step(np.zeros(2), s.carried, 0.0, 0.5, WANTED)[3]) for s in (plain, scaled)]
    closing = np.array(plain.step(np.zeros(2), plain.carried, 0.0, 0.5, WANTED)[2]).ravel()
    np.testing.assert_allclose(works, [closing @ closing, closing @ (np.array([2, 3]) * closing)])
    nothing = Broyden([], ca.SX(1), -2.0, 2)
    nothing.close(ca.SX(0, 1), ca.SX(1))
    assert nothing.carried.numel() == nothing.update.numel() == len(nothing.guards) == 0
