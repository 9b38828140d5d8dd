"""Figures 1 to 4 of the paper with its parameters: a picture, an npz file and a sentence for each.

Run: python examples/figures_of_the_paper.py [folder]

Every figure is run as the paper does it: ``hL(x_k, velocity)``, the discrete Lagrangian of (46) and
of section 7.4.2, is Euler A; the inhomogeneous ball lives in the chart (x, y, rho), R = exp(rho).
Beside it runs what the figure is compared with: the method of [28] in Figure 1, the ball without a
chart and the equations of motion in Figures 3 and 4. docs/figures_of_the_paper.md has the results.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_path, style

PAPER = gni.EulerA()
OTHER = gni.DiscreteLagrangeDAlembert()
BLUE, RED, GOLD, PALE, DARK = "#2f6fab", "#c8553d", "#d9a441", "#9aa8b2", "#22303c"
QUICK = 5


class Reproduction(NamedTuple):
    """One figure: what is stored, what is told, how it is drawn."""

    name: str
    arrays: dict[str, np.ndarray]
    numbers: dict[str, float]
    sentence: str
    draw: Callable[[Figure, dict[str, np.ndarray]], None]


class Timed(NamedTuple):
    """A run, and the seconds it took with everything around it (recording, machine code)."""

    run: gni.Trajectory
    seconds: float


def timed(scene: gni.scenes.Scene, method: Any, step: float, n_steps: int, every: int) -> Timed:
    begin = perf_counter()
    run = gni.integrate(
        scene.system, scene.start, step=step, n_steps=n_steps, method=method, save_every=every
    )
    return Timed(run, perf_counter() - begin)


def slope(steps: np.ndarray, errors: np.ndarray) -> float:
    """The slope of log error over log step by least squares."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


# The ball in the paper's chart and without it.


@cache
def program(make: Callable[..., gni.scenes.Scene]) -> gni.MechanicalSystem:
    """Parameters are inputs of the machine code: one program of a ball serves all figures."""
    return make().system


def two_balls(
    mass: float, inertia: Any, table: float, start: Any, spin: float = 0.0
) -> tuple[gni.scenes.Scene, gni.scenes.Scene]:
    """The ball in the chart and without it, from the same start at rho_0 = (0.5, 0.5, 0.5).

    start : (x, y) and (x', y').  spin : about the vertical.
    """

    def ball(make: Callable[..., gni.scenes.Scene]) -> gni.scenes.Scene:
        scene = make(mass, 1.0, inertia, table, *start, vertical_spin=spin)
        return replace(scene, system=program(make).with_parameters(**scene.system.parameters))

    return ball(gni.scenes.inhomogeneous_ball_in_a_chart), ball(gni.scenes.inhomogeneous_ball)


def turning(x: np.ndarray) -> np.ndarray:
    """The velocity of turning with the table at rate 1, in the frames of the three balls."""
    spin = {
        2: lambda: np.tile([0.0, 0.0, 1.0], (len(x), 1)),
        5: lambda: gni.SO3(retraction=gni.Exponential()).dexp_inverse(x[:, 2:])[..., 2],
        11: lambda: x[:, 8:],
    }[x.shape[1]]()
    return np.concatenate([-x[:, 1:2], x[:, :1], spin], axis=1)


def moving_energy(run: gni.Trajectory) -> np.ndarray:
    """E - Theta M_z: the true motion keeps it, since turning with the table is rolling, too."""
    vertical = np.sum(run.momenta * turning(run.base), axis=1)
    return run.energy() - run.system.parameters["Theta"] * vertical


def records(run: gni.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Relative change of the moving energy and largest relative constraint residual at nodes."""
    kept = moving_energy(run)
    residual = np.max(np.abs(run.constraint_residuals(relative=True)), axis=1)
    return np.abs(kept / kept[0] - 1.0), residual


def draw_records(axes: Any, a: dict[str, np.ndarray], kind: str, labels: dict[str, Any]) -> None:
    """One record of every run over time."""
    for name, (label, colour) in labels.items():
        # zero has no place on a logarithmic axis
        shown = np.maximum(a[f"{name}_{kind}"], 1e-17)
        axes.semilogy(a["times"], shown, color=colour, linewidth=0.7, label=label)
    axes.set_xlabel("t")
    axes.legend(loc="upper left", ncols=2, fontsize=7.5)


# Figure 1.

QUANTITIES = ("(x, y)", "omega", "energy")


def ball_errors(tau: gni.Retraction, method: Any, steps: np.ndarray) -> np.ndarray:
    """Largest errors of (x, y), omega and energy up to t = 10, (steps, 3)."""
    scene = gni.scenes.rolling_ball(retraction=tau)
    errors = []
    for h in steps:
        run = gni.integrate(scene.system, scene.start, step=h, t_end=10.0, method=method)
        base, velocities = scene.exact(run.times)
        inertia = np.diag(scene.system.evaluate("metric", scene.start.base))
        energy = 0.5 * velocities**2 @ inertia
        gaps = run.base - base, (run.velocities - velocities)[:, 2:]
        errors.append(
            [np.max(np.linalg.norm(gap, axis=1)) for gap in gaps]
            + [np.max(np.abs(run.energy() - energy))]
        )
    return np.array(errors)


def figure_1(quick: bool) -> Reproduction:
    """Errors of the homogeneous ball over decreasing steps, with both methods."""
    steps = 0.2 * 0.5 ** np.arange(5 if quick else 8)
    cases = {
        "GNI": (gni.Cayley(), PAPER),
        "[28], exponential": (gni.Exponential(), OTHER),
        "[28], Cayley": (gni.Cayley(), OTHER),
    }
    errors = {name: ball_errors(tau, method, steps) for name, (tau, method) in cases.items()}
    numbers = {}
    for name, found in errors.items():
        # with Cayley [28] reaches its slope below h = 0.05 only
        part = slice(3 if name == "[28], Cayley" else 0, None)
        for i, quantity in enumerate(QUANTITIES):
            numbers[f"{name}: slope of {quantity}"] = slope(steps[part], found[part, i])
            numbers[f"{name}: error of {quantity} at h = 0.1"] = found[1, i]
    for name in ("[28], exponential", "[28], Cayley"):
        numbers[f"{name}: error of (x, y) over that of GNI at the smallest h"] = (
            errors[name][-1, 0] / errors["GNI"][-1, 0]
        )
    first, second = (numbers[f"{name}: slope of (x, y)"] for name in list(cases)[:2])
    sentence = (
        f"Errors fall like h^2 with GNI and with [28] (slopes {first:.2f} and {second:.2f}), where "
        'the text calls the scheme "order-one consistent"; the dashed line lies at half the full '
        "one if [28] is written with the exponential, far above it if with Cayley."
    )
    names = dict(zip(cases, ("gni", "dla_exponential", "dla_cayley"), strict=True))
    arrays = {"steps": steps, **{names[name]: found for name, found in errors.items()}}
    return Reproduction("paper_figure_1", arrays, numbers, sentence, draw_1)


def draw_1(figure: Figure, a: dict[str, np.ndarray]) -> None:
    """Three panels: (x, y), omega, energy."""
    figure.set_size_inches(11.0, 4.0)
    steps = a["steps"]
    lines = {
        "gni": ("GNI, (46)", {"color": BLUE, "marker": "o"}),
        "dla_exponential": (
            "[28], exponential",
            {"color": RED, "marker": "s", "linestyle": "--", "markerfacecolor": "white"},
        ),
        "dla_cayley": ("[28], Cayley", {"color": PALE, "marker": "^", "linestyle": "--"}),
    }
    for i, (axes, quantity) in enumerate(zip(figure.subplots(1, 3), QUANTITIES, strict=True)):
        for name, (label, look) in lines.items():
            axes.loglog(steps, a[name][:, i], markersize=4, label=label, **look)
        axes.loglog(steps, 0.12 * a["gni"][0, i] * (steps / steps[0]) ** 2, "k:", label="slope 2")
        axes.set_title(f"largest error of {quantity.replace('omega', 'ω')}, T = 10")
        axes.set_xlabel("h")
        if i == 0:
            axes.legend(fontsize=8)


# Figure 2.


def figure_2(quick: bool) -> Reproduction:
    """The homogeneous ball for 10,000 steps of 0.1."""
    scene = gni.scenes.rolling_ball()
    found = timed(scene, PAPER, 0.1, 10_000 // (QUICK if quick else 1), 1)
    run = found.run
    exact, _ = scene.exact(run.times)
    rate, centre = 0.4, np.array([-1.5, 3.5])
    radius = np.sqrt(2.0) / rate
    off = np.linalg.norm(run.base - centre, axis=1) - radius
    gap = np.linalg.norm(run.base - exact, axis=1)
    kept, residual = records(run)
    numbers = {
        "steps": len(run) - 1.0,
        "seconds": found.seconds,
        "radius of the exact circle": radius,
        "turns about its centre": rate * run.times[-1] / (2.0 * np.pi),
        "largest distance from the circle": np.max(np.abs(off)),
        "largest distance from the exact motion": np.max(gap),
        "moving energy, largest relative change": np.max(kept),
        "constraint, largest relative residual": np.max(residual),
    }
    sentence = (
        f"The contact point stays on one circle of radius {radius:.3f} beside the cross, off it by "
        f"at most {np.max(np.abs(off)):.0e} in {len(run) - 1} steps, which is what the text says "
        f"(h = 0.1 to T = 1000); along the circle it runs ahead, by {gap[-1]:.2f} at the end."
    )
    arrays = {
        "times": run.times, "gni_path": run.base, "exact_path": exact, "off_circle": off,
        "gap": gap, "gni_moving_energy": kept, "gni_residual": residual,
    }  # fmt: skip
    return Reproduction("paper_figure_2", arrays, numbers, sentence, draw_2)


def draw_2(figure: Figure, a: dict[str, np.ndarray]) -> None:
    """The path, and how far it is from the circle and from the exact motion."""
    figure.set_size_inches(10.0, 5.2)
    panels = figure.subplot_mosaic([["path", "gap"], ["path", "records"]])
    path, gap, record = panels["path"], panels["gap"], panels["records"]
    path.plot(*a["gni_path"].T, ".", color=BLUE, markersize=1.0)
    path.plot(0, 0, "+", color=DARK, markersize=9)
    path.set_aspect("equal")
    path.set(title="contact point; cross: centre of the table", xlabel="x", ylabel="y")
    gap.semilogy(a["times"], np.maximum(a["gap"], 1e-17), color=RED, label="the exact motion")
    gap.semilogy(
        a["times"], np.maximum(np.abs(a["off_circle"]), 1e-17), color=BLUE, linewidth=0.3,
        label="the circle",
    )  # fmt: skip
    gap.set(title="distance of the contact point from", xlabel="t", ylim=(1e-14, 1e3))
    labels = {"gni": ("moving energy, relative change", BLUE)}
    draw_records(record, a, "moving_energy", labels)
    draw_records(record, a, "residual", {"gni": ("constraint, relative residual", GOLD)})
    record.set(title="records", ylim=(1e-18, 1e-2))
    gap.legend(loc="upper left", ncols=2, fontsize=7.5)


# Figure 3.

ROADS = {
    "chart": ("chart, Euler A (the paper)", RED),
    "two_step": ("Euler A, without chart", BLUE),
    "gni": ("GNI(), without chart", GOLD),
}


class Rolling(NamedTuple):
    """The data of one half of Figure 3."""

    side: str
    mass: float
    inertia: tuple[float, float, float]
    step: float
    n_steps: int


LEFT = Rolling("left", 2.0, (1.0, 0.5, 0.7), 2.5e-4, 400_000)
# 160 is no whole number of steps of 10^-3.75 = 1.7783e-4
RIGHT = Rolling("right", 1.0, (10.0, 10.0, 1.0), 10.0**-3.75, 899_746)
START = (1.0, 0.0), (0.0, 0.75)
EVERY = 100
THIN: dict[str, Any] = {"linewidth": 0.7}
# of the spins from -1.5 to 1.5, in steps of 0.004, one that fits the caption of Figure 3
FITTING_SPIN = 0.676


def figure_3(data: Rolling, quick: bool) -> tuple[dict[str, Any], dict[str, float]]:
    """Arrays and numbers of one half: three roads and the equations of motion."""
    n_steps = data.n_steps // (QUICK if quick else 1)
    chart, ball = two_balls(data.mass, data.inertia, 1.0, START)
    runs = {
        "chart": timed(chart, PAPER, data.step, n_steps, EVERY),
        "two_step": timed(ball, PAPER, data.step, n_steps, EVERY),
        "gni": timed(ball, gni.GNI(), data.step, n_steps, EVERY),
        "equations": timed(ball, gni.ReferenceFlow(rtol=1e-13), data.step, n_steps, EVERY),
    }
    truth = runs.pop("equations").run
    arrays: dict[str, Any] = {"times": truth.times, "equations_path": truth.base[:, :2]}
    arrays["chart_rho"] = rho = np.linalg.norm(runs["chart"].run.base[:, 2:], axis=1)
    energy = truth.energy()
    numbers = {
        "steps": float(n_steps),
        "energy, smallest": np.min(energy),
        "energy, largest": np.max(energy),
        "largest size of rho in the chart": np.max(rho),
        "time of the largest rho": truth.times[np.argmax(rho)],
    }
    for name, found in runs.items():
        run, label = found.run, ROADS[name][0]
        kept, residual = records(run)
        path = run.base[:, :2]
        gap = np.linalg.norm(path - truth.base[:, :2], axis=1)
        numbers |= {
            f"{label}: seconds": found.seconds,
            f"{label}: x at the end": path[-1, 0],
            f"{label}: y at the end": path[-1, 1],
            f"{label}: largest distance from the true motion": np.max(gap),
            f"{label}: the same in the first half": np.max(gap[: len(gap) // 2]),
            f"{label}: moving energy, largest relative change": np.max(kept),
            f"{label}: constraint, largest relative residual": np.max(residual),
        }
        arrays |= {
            f"{name}_path": path, f"{name}_energy": run.energy(), f"{name}_gap": gap,
            f"{name}_moving_energy": kept, f"{name}_residual": residual,
        }  # fmt: skip
    return arrays, numbers


def figure_3_left(quick: bool) -> Reproduction:
    """I = (1, 0.5, 0.7), m = 2, h = 2.5e-4, T = 100."""
    arrays, numbers = figure_3(LEFT, quick)
    gap, size = arrays["chart_gap"], np.max(arrays["chart_rho"])
    half, far, free = np.max(gap[: len(gap) // 2]), np.max(gap), np.max(arrays["two_step_gap"])
    sentence = (
        "Wavy circles through the neighbourhood of the start, reproducible in kind only since the "
        "text leaves the spin about the vertical open (0 here); in the paper's chart, where |rho| "
        f"reaches {size:.2f} of 2 pi, its scheme is {half:.2g} off the true motion in the first "
        f"half and {far:.2g} in the second, without a chart {free:.2g}."
    )
    return Reproduction("paper_figure_3_left", arrays, numbers, sentence, draw_3)


def loops(path: np.ndarray) -> np.ndarray:
    """Nodes where the distance from the centre is largest, loop by loop."""
    r = np.hypot(*path.T)
    return np.flatnonzero((r[1:-1] > r[:-2]) & (r[1:-1] >= r[2:])) + 1


def figure_3_right(quick: bool) -> Reproduction:
    """I = (10, 10, 1), m = 1, h = 10^-3.75, T = 160; and with a spin that fits the caption."""
    arrays, numbers = figure_3(RIGHT, quick)
    _, spinning = two_balls(RIGHT.mass, RIGHT.inertia, 1.0, START, FITTING_SPIN)
    n_steps = RIGHT.n_steps // (QUICK if quick else 1)
    path = timed(spinning, PAPER, RIGHT.step, n_steps, EVERY).run.base[:, :2]
    nodes = loops(path)
    sizes = np.hypot(*path[nodes].T)
    order = np.argsort(sizes)[::-1]
    numbers["spin 0: largest distance from the centre"] = np.max(np.hypot(*arrays["gni_path"].T))
    for rank, name in enumerate(("largest", "second", "third")):
        numbers[f"spin {FITTING_SPIN}: {name} loop"] = sizes[order[rank]]
    numbers[f"spin {FITTING_SPIN}: loops between the two largest"] = abs(order[0] - order[1]) - 1.0
    arrays |= {"spinning_path": path, "loop_times": arrays["times"][nodes], "loop_sizes": sizes}
    widest = numbers["spin 0: largest distance from the centre"]
    sentence = (
        f"With the open spin at 0 the path nearly repeats itself every five turns, never farther "
        f"than {widest:.2f} from the centre, and has no two larger loops as the caption says; with "
        f"a spin of {FITTING_SPIN}, found by a scan, it has ({sizes[order[0]]:.2f} and "
        f"{sizes[order[1]]:.2f}, the next {sizes[order[2]]:.2f}), and not consecutive in time."
    )
    return Reproduction("paper_figure_3_right", arrays, numbers, sentence, draw_3)


def draw_3(figure: Figure, a: dict[str, np.ndarray]) -> None:
    """The path (with a second one where there is another spin) and both records."""
    two = "spinning_path" in a
    figure.set_size_inches(14.0 if two else 10.5, 5.4)
    paths = ["path", "spinning"] if two else ["path"]
    panels = figure.subplot_mosaic([[*paths, "moving"], [*paths, "residual"]])
    for name, look in (("chart", {"linewidth": 2.2, "alpha": 0.5}), ("two_step", THIN)):
        label, colour = ROADS[name]
        plot_path(panels["path"], a[f"{name}_path"], color=colour, label=label, **look)
    panels["path"].legend(loc="center", bbox_to_anchor=(0.5, 0.62), fontsize=8)
    panels["path"].set_title("contact point, spin about the vertical 0")
    if two:
        draw_loops(panels["spinning"], a)
    for name in paths:
        panels[name].plot(0, 0, "+", color=DARK, markersize=9)
    draw_records(panels["moving"], a, "moving_energy", ROADS)
    panels["moving"].set(title="moving energy, relative change", ylim=(1e-17, 1e5))
    draw_records(panels["residual"], a, "residual", ROADS)
    panels["residual"].set(title="constraint, relative residual", ylim=(1e-18, 1e-8))


def draw_loops(axes: Any, a: dict[str, np.ndarray]) -> None:
    """The path with the other spin, the times of its two largest loops beside them."""
    path = a["spinning_path"]
    plot_path(axes, path, color=BLUE, **THIN)
    axes.set_title(f"spin {FITTING_SPIN}: two larger loops, not consecutive")
    for loop in np.argsort(a["loop_sizes"])[-2:]:
        node = np.argmin(np.abs(a["times"] - a["loop_times"][loop]))
        axes.plot(*path[node], "D", color=RED, markersize=4)
        axes.annotate(
            f"t = {a['loop_times'][loop]:.0f}", path[node], xytext=(-6, 3), color=RED,
            textcoords="offset points", fontsize=8, horizontalalignment="right",
        )  # fmt: skip


# Figure 4.

FIXED = {
    "chart": ("chart, Euler A (the paper)", RED, "o"),
    "chart_mean": ("chart, mean (16)", PALE, "s"),
    "two_step": ("Euler A, without chart", BLUE, "^"),
    "gni": ("GNI(), without chart", GOLD, "v"),
}
ROLLING = (1.0, 0.0), (0.0, 1.6)


def figure_4(quick: bool) -> Reproduction:
    """Energy error of the inhomogeneous ball on a table at rest, T = 10, rolling about 16."""
    chart, ball = two_balls(LEFT.mass, LEFT.inertia, 0.0, ROLLING)
    cases = {
        "chart": (chart, PAPER), "chart_mean": (chart, gni.Rattle()),
        "two_step": (ball, PAPER), "gni": (ball, gni.GNI()),
    }  # fmt: skip
    # from h = 0.008, beyond which the chart fails near |rho| = 2 pi, to the step of Figure 3
    counts = 1250 * 2 ** np.arange(3 if quick else 6)
    arrays: dict[str, np.ndarray] = {"steps": 10.0 / counts}
    numbers: dict[str, float] = {}
    for name, (scene, method) in cases.items():
        errors = []
        for n in counts:
            run = timed(scene, method, 10.0 / n, int(n), int(n) // 1250).run
            error = np.abs(run.energy() - scene.start.velocity @ scene.start.momentum / 2.0)
            errors.append(np.max(error))
        arrays |= {f"{name}_errors": np.array(errors), f"{name}_error": error}
        label = FIXED[name][0]
        numbers[f"{label}: slope"] = slope(arrays["steps"], arrays[f"{name}_errors"])
        numbers[f"{label}: error at h = {10.0 / n:g}"] = errors[-1]
        numbers[f"{label}: constraint, largest relative residual"] = np.max(
            np.abs(run.constraint_residuals(relative=True))
        )
    arrays["times"] = run.times
    length = np.sum(np.linalg.norm(np.diff(run.base[:, :2], axis=0), axis=1))
    numbers |= {"energy": scene.start.velocity @ scene.start.momentum / 2.0,
                "distance rolled": length}  # fmt: skip
    printed, free = (numbers[f"{FIXED[name][0]}: slope"] for name in ("chart", "two_step"))
    ratio = arrays["chart_errors"][-1] / arrays["two_step_errors"][-1]
    sentence = (
        f"The energy error of the paper's scheme falls like h^{printed:.2f} in its chart and like "
        f"h^{free:.2f} without one, where it is {ratio:.0e} times smaller at the smallest step; "
        f"the text gives the distance rolled, about 16 ({length:.2f} here), but no start."
    )
    return Reproduction("paper_figure_4", arrays, numbers, sentence, draw_4)


def draw_4(figure: Figure, a: dict[str, np.ndarray]) -> None:
    """The largest error against h, and the error against t at the smallest h."""
    figure.set_size_inches(10.5, 4.6)
    over_step, over_time = figure.subplots(1, 2)
    steps = a["steps"]
    for name, (label, colour, marker) in FIXED.items():
        over_step.loglog(
            steps, a[f"{name}_errors"], marker, linestyle="-", color=colour, markersize=4,
            label=label,
        )  # fmt: skip
        shown = np.maximum(a[f"{name}_error"], 1e-17)
        over_time.semilogy(a["times"], shown, color=colour, linewidth=0.9, label=label)
    for order, name in ((1, "chart"), (2, "gni")):
        guide = 0.4 * a[f"{name}_errors"][0] * (steps / steps[0]) ** order
        over_step.loglog(steps, guide, "k:", linewidth=0.9)
        over_step.annotate(f"slope {order}", (steps[-2], guide[-2]), xytext=(4, -11),
                           textcoords="offset points", fontsize=8)  # fmt: skip
    over_step.set(title="largest energy error up to T = 10", xlabel="h", ylim=(1e-10, 1e2))
    over_step.set_xticks(steps, [f"{h:g}" for h in steps])
    over_step.minorticks_off()
    over_step.legend(loc="upper left", ncols=2, fontsize=8)
    over_time.set(title=f"energy error at h = {steps[-1]:.3g}", xlabel="t", ylim=(1e-16, 1.0))


def main(folder: str | Path = "output", quick: bool = False) -> dict[str, dict[str, float]]:
    """Run, write and print every figure; returns the printed numbers by name of the figure.

    quick : fewer step sizes, a fifth of the long runs, coarse pictures; the sentences are about
        the whole runs.
    """
    begin = perf_counter()
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    numbers = {}
    for make in (figure_1, figure_2, figure_3_left, figure_3_right, figure_4):
        result = make(quick)
        numbers[result.name] = result.numbers
        np.savez(target / f"{result.name}.npz", **result.arrays)
        with style():
            # laying out takes as long as drawing
            figure = Figure(layout=None if quick else "constrained")
            FigureCanvasAgg(figure)
            result.draw(figure, result.arrays)
            figure.savefig(target / f"{result.name}.png", dpi=60 if quick else 150)
        print(f"{result.name}\n  {result.sentence}")
        for label, value in result.numbers.items():
            print(f"  {label:<70} {value:.6g}")
    print(f"Figures written to {target} in {perf_counter() - begin:.1f} s")
    return numbers


if __name__ == "__main__":
    main(*sys.argv[1:2])
