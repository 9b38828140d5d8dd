"""Figures 1 to 4: what examples/figures_of_the_paper.py computes, by roads of its own.

The page docs/figures_of_the_paper.md is compared with a whole run, number by number.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_mechanics import slope

import groupoid_gni as gni

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "figures_of_the_paper.md"
CHART, FREE, PROJECTED = (
    "chart, Euler A (the paper)", "Euler A, without chart", "GNI(), without chart",
)  # fmt: skip
DISTANCE = "largest distance from the true motion"
KEPT = "moving energy, largest relative change"
RESIDUAL = "constraint, largest relative residual"
AWKWARD = {"mass": 1.7, "inertia": (0.9, 0.5, 0.7), "table": 0.6}
AWKWARD_START = (0.7, -0.2), (0.3, 0.6)


def _example() -> Any:
    path = ROOT / "examples" / "figures_of_the_paper.py"
    specification = importlib.util.spec_from_file_location(path.stem, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


paper = _example()


# Figures 1 and 2.


def test_figure_1_has_slope_two_in_every_quantity_and_both_methods() -> None:
    numbers = paper.figure_1(quick=False).numbers
    slopes = {name: number for name, number in numbers.items() if "slope" in name}
    assert len(slopes) == 9
    for name, number in slopes.items():
        assert number == pytest.approx(2.0, abs=0.05), name
    end = "error of (x, y) over that of GNI at the smallest h"
    assert numbers[f"[28], exponential: {end}"] == pytest.approx(0.5, abs=1e-3)
    assert numbers[f"[28], Cayley: {end}"] == pytest.approx(284, rel=0.01)


@pytest.mark.parametrize(
    ("method", "tau", "angle"),
    [
        # v_{k+1} - v_{k-1} = 2 a h J v_k, a leapfrog; its second root is the parasitic mode
        (paper.PAPER, gni.Cayley(), lambda a, h: np.arcsin(a * h)),
        # v_{k+1} - v_k = a h J (v_{k+1} + v_k) / 2, the trapezoidal rule
        (paper.OTHER, gni.Exponential(), lambda a, h: 2.0 * np.arctan(0.5 * a * h)),
    ],
    ids=["GNI", "[28]"],
)
def test_both_methods_turn_the_velocity_by_the_angle_of_their_recursion(
    method: Any, tau: gni.Retraction, angle: Any
) -> None:
    """The errors of Figure 1 in closed form: a^3 h^2/6 and -a^3 h^2/12 in the rate of turning."""
    h = 0.17
    scene = gni.scenes.rolling_ball(
        1.3, 0.8, 0.5, 0.7, (0.6, -0.9), (0.5, 0.3), 0.4, retraction=tau
    )
    rate = 0.7 * 0.5 / (0.5 + 1.3 * 0.8**2)
    run = gni.integrate(scene.system, scene.start, step=h, n_steps=400, method=method)
    chords = np.diff(run.base, axis=0)
    turned = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    # what is left of the parasitic mode at both ends counts a 399th
    assert (turned[-1] - turned[0]) / 399 == pytest.approx(angle(rate, h), abs=1e-7)
    assert abs(angle(rate, h) - rate * h) > 5e-6


def test_figure_2_is_a_circle_run_ahead_of_time() -> None:
    result = paper.figure_2(quick=False)
    numbers, a = result.numbers, result.arrays
    assert numbers["steps"] == 10_000
    assert a["times"][-1] == pytest.approx(1000.0)
    assert numbers["largest distance from the circle"] < 2e-6
    assert numbers[RESIDUAL] < 1e-15
    assert numbers[KEPT] < 2e-6
    scene = gni.scenes.rolling_ball()
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=10_000)
    off = np.linalg.norm(run.base - [-1.5, 3.5], axis=1) - numbers["radius of the exact circle"]
    assert np.abs(off).max() < 1e-10
    # the angle by which the leapfrog is ahead, seen as a chord of the circle
    ahead = (np.arcsin(0.04) / 0.1 - 0.4) * 1000.0
    chord = 2.0 * np.sqrt(2.0) / 0.4 * np.sin(ahead / 2.0)
    assert numbers["largest distance from the exact motion"] == pytest.approx(chord, rel=1e-3)


# Records and starts.


def balls() -> dict[str, gni.scenes.Scene]:
    chart, free = paper.two_balls(**AWKWARD, start=AWKWARD_START, spin=0.4)
    reduced = gni.scenes.rolling_ball(1.3, 0.8, 0.5, 0.7, *AWKWARD_START, vertical_spin=0.4)
    return {"reduced": reduced, "chart": chart, "free": free}


@pytest.mark.parametrize("name", ["reduced", "chart", "free"])
def test_the_true_motion_keeps_the_moving_energy_and_not_the_energy(name: str) -> None:
    scene = balls()[name]
    run = gni.integrate(
        scene.system, scene.start, step=0.1, n_steps=40, method=gni.ReferenceFlow(rtol=1e-12)
    )
    kept, energy = paper.moving_energy(run), run.energy()
    assert np.ptp(energy) > 0.1
    np.testing.assert_allclose(kept, kept[0], rtol=0, atol=1e-10)


def test_the_pair_the_paper_starts_from_is_off_by_first_order() -> None:
    """(q_0, q_0 + h v_0) of 7.4.2 against the half impulse that integrate starts with."""
    steps = np.array([0.02, 0.01, 0.005])
    for scene in paper.two_balls(paper.LEFT.mass, paper.LEFT.inertia, 1.0, paper.START):
        system, start, gaps = scene.system, scene.start, []
        for h in steps:
            n = round(0.4 / h)
            run = gni.integrate(system, start, step=h, n_steps=n, method=paper.PAPER)
            arrow = system.space.retract(start.base, h * start.velocity)
            for _ in range(n - 1):
                arrow = gni.next_arrow(system, paper.PAPER, arrow, step=h)
            gaps.append(np.linalg.norm((system.space.target(arrow) - run.base[-1])[:2]))
        assert slope(steps, gaps) == pytest.approx(1.0, abs=0.15)
        assert gaps[-1] < 1e-3 * steps[-1]


# Figures 3 and 4.


def assert_records(numbers: dict[str, float], chart: float, free: float, projected: float) -> None:
    """Constraints at round-off, the moving energy kept as well as each road can."""
    for road, bound in ((CHART, chart), (FREE, free), (PROJECTED, projected)):
        assert numbers[f"{road}: {KEPT}"] < bound
        assert numbers[f"{road}: {RESIDUAL}"] < (5e-12 if road == CHART else 1e-15)


def test_figure_3_on_a_shortened_run() -> None:
    left = paper.figure_3_left(quick=True)
    assert left.numbers["steps"] == 80_000
    assert_records(left.numbers, 2e-3, 2e-7, 5e-8)
    assert left.numbers[f"{CHART}: {DISTANCE}"] < 0.02
    assert left.numbers[f"{FREE}: {DISTANCE}"] < 3e-6
    right = paper.figure_3_right(quick=True)
    assert_records(right.numbers, 2e-4, 2e-9, 5e-13)
    assert right.numbers[f"{CHART}: {DISTANCE}"] < 4e-4
    assert right.numbers[f"{FREE}: {DISTANCE}"] < 2e-7
    for array in (*left.arrays.values(), *right.arrays.values()):
        assert np.all(np.isfinite(array))


def test_the_scheme_of_figure_3_is_of_order_one_in_the_chart_and_two_without() -> None:
    scenes = paper.two_balls(paper.RIGHT.mass, paper.RIGHT.inertia, 1.0, paper.START)
    truth = gni.integrate(
        scenes[1].system, scenes[1].start, step=3.0, n_steps=1,
        method=gni.ReferenceFlow(rtol=1e-13),
    ).base[-1, :2]  # fmt: skip
    counts = np.array([1500, 3000, 6000])
    for scene, order in zip(scenes, (1.0, 2.0), strict=True):
        errors = []
        for n in counts:
            run = gni.integrate(
                scene.system, scene.start, step=3.0 / n, n_steps=int(n), method=paper.PAPER,
                save_every=int(n),
            )  # fmt: skip
            errors.append(np.linalg.norm(run.base[-1, :2] - truth))
        assert slope(3.0 / counts, errors) == pytest.approx(order, abs=0.05)


def test_figure_4_has_slope_one_in_the_chart_and_two_without() -> None:
    numbers = paper.figure_4(quick=True).numbers
    for name, order in ((CHART, 1), ("chart, mean (16)", 2), (FREE, 2), (PROJECTED, 2)):
        assert numbers[f"{name}: slope"] == pytest.approx(order, abs=0.05)
    assert numbers["distance rolled"] == pytest.approx(16.0, abs=0.05)
    assert numbers[f"{FREE}: error at h = 0.002"] < 1e-5 * numbers[f"{CHART}: error at h = 0.002"]


# The whole thing.


def tables() -> dict[str, dict[str, float]]:
    """Numbers of the page by figure, named as the example names them."""
    found: dict[str, dict[str, float]] = {}
    header: list[str] = []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        picture = re.search(r"figures/(paper_figure_\w+)\.png", line)
        if picture:
            numbers = found.setdefault(picture.group(1), {})
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            header = []
        elif not header:
            header = cells
        elif not set(line) <= set("|-: "):
            for column, cell in zip(header[1:], cells[1:], strict=True):
                if cell:
                    name = f"{column}: {cells[0]}" if column != "value" else cells[0]
                    numbers[name] = float(cell.replace(",", ""))
    return found


@pytest.mark.slow
def test_the_page_says_what_the_whole_run_gives(tmp_path: Path) -> None:
    numbers, said = paper.main(tmp_path), tables()
    assert said.keys() == numbers.keys()
    for figure, entries in said.items():
        assert len(entries) >= 5, figure
        for name, value in entries.items():
            found = numbers[figure][name]
            if "seconds" in name:
                assert found < 30.0, (figure, name)
            elif abs(value) < 1e-11:
                assert value / 5.0 < found < 5.0 * value, (figure, name)
            else:
                assert found == pytest.approx(value, rel=0.01), (figure, name)
        assert (tmp_path / f"{figure}.png").stat().st_size > 50_000
        assert (ROOT / "docs" / "figures" / f"{figure}.png").exists()
        with np.load(tmp_path / f"{figure}.npz") as arrays:
            assert all(np.all(np.isfinite(arrays[name])) for name in arrays)
    with np.load(tmp_path / "paper_figure_3_right.npz") as arrays:
        x, y = arrays["gni_path"].T
        turns = np.abs(np.unwrap(np.arctan2(y, x))) / (2.0 * np.pi)
        again = np.searchsorted(turns, 5.0)
        gap = np.hypot(x[again:] - x[:-again], y[again:] - y[:-again])
        assert np.max(gap) < 0.1


@pytest.mark.slow
def test_the_whole_figure_3_with_smaller_steps() -> None:
    """What the page says of convergence: orders one and two, and where the chart has none."""
    for data, late in ((paper.LEFT, 1.0), (paper.RIGHT, 0.0)):
        chart, ball = paper.two_balls(data.mass, data.inertia, 1.0, paper.START)
        n = data.n_steps // 100
        truth = gni.integrate(
            ball.system, ball.start, step=100 * data.step, n_steps=n,
            method=gni.ReferenceFlow(rtol=1e-13),
        ).base[:, :2]  # fmt: skip
        for scene, order in ((chart, 1), (ball, 2)):
            gaps = []
            for finer in (1, 2, 4, 8):
                run = gni.integrate(
                    scene.system, scene.start, step=data.step / finer, n_steps=100 * n * finer,
                    method=paper.PAPER, save_every=100 * finer,
                )  # fmt: skip
                gaps.append(np.linalg.norm(run.base[:, :2] - truth, axis=1))
            halves = [np.max(gap[: n // 2]) for gap in gaps]
            assert slope(0.5 ** np.arange(3), halves[1:]) == pytest.approx(order, abs=0.2)
            if scene is chart:
                assert min(np.max(gap) for gap in gaps) >= late


@pytest.mark.slow
def test_figure_4_in_other_directions() -> None:
    """Everywhere about 16 units, order one in the chart, and the bounds that the page gives."""
    found = []
    for angle in np.radians(np.arange(0, 360, 30)):
        start = (1.0, 0.0), (1.6 * np.cos(angle), 1.6 * np.sin(angle))
        scenes = paper.two_balls(paper.LEFT.mass, paper.LEFT.inertia, 0.0, start)
        errors = []
        for scene, n in zip((scenes[0], *scenes), (20_000, 40_000, 40_000), strict=True):
            run = gni.integrate(
                scene.system, scene.start, step=10.0 / n, n_steps=n, method=paper.PAPER
            )
            errors.append(np.abs(run.energy() - run.energy()[0]).max())
        rolled = np.linalg.norm(np.diff(run.base[:, :2], axis=0), axis=1).sum()
        assert rolled == pytest.approx(16.0, abs=0.2)
        found.append([np.log2(errors[0] / errors[1]), *errors[1:]])
    smallest, largest = np.min(found, axis=0), np.max(found, axis=0)
    np.testing.assert_allclose(smallest, [0.99, 2.27e-4, 1.72e-9], rtol=0.01)
    np.testing.assert_allclose(largest, [1.0148, 1.44e-2, 5.69e-9], rtol=0.01)
