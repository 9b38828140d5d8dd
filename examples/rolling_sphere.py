"""A ball on a rotating table (section 7.4): homogeneous against its exact motion, inhomogeneous.

Run: python examples/rolling_sphere.py [figure.png]

The homogeneous ball moves on a circle, its velocity turning at Theta I / (I + m r^2). The
inhomogeneous ball runs on R^2 x SO(3) without a chart and is compared with the equations of motion
integrated to 1e-12. Energy is not conserved on a rotating table; for the homogeneous ball
E - Theta M_z (the moving energy) is, and the figure shows it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import plot_constraints, plot_path, style

STEPS = (0.2, 0.1, 0.05, 0.025, 0.0125)


def errors_over_steps(scene: gni.scenes.Scene) -> np.ndarray:
    """Largest error in position and in angular velocity over T = 10 for every step size."""
    errors = []
    for h in STEPS:
        run = gni.integrate(scene.system, scene.start, step=h, t_end=10.0, method=gni.Rattle())
        base, velocity = scene.exact(run.times)
        errors.append(
            [np.max(np.abs(run.base - base)), np.max(np.abs((run.velocities - velocity)[:, 2:]))]
        )
    return np.array(errors)


def moving_energy(run: gni.Trajectory) -> np.ndarray:
    """E - Theta M_z of the homogeneous ball, M_z = m (x y' - y x') + I omega_3."""
    p = {name: float(value) for name, value in run.system.parameters.items()}
    (x, y), v = run.base.T, run.velocities.T
    momentum = p["m"] * (x * v[1] - y * v[0]) + p["I"] * v[4]
    return run.energy() - p["Theta"] * momentum


def draw(
    homogeneous: gni.Trajectory,
    inhomogeneous: gni.Trajectory,
    errors: np.ndarray,
) -> Figure:
    """Paths of the contact point, errors against the step, moving energy, constraint."""
    with style():
        figure = Figure(figsize=(10, 7), layout="constrained")
        FigureCanvasAgg(figure)
        path, slope, energy, constraint = figure.subplots(2, 2).ravel()
        plot_path(path, homogeneous.base, label="homogeneous (exact: a circle)")
        plot_path(path, inhomogeneous.base[:, :2], label="inhomogeneous", linewidth=0.9)
        path.plot(0, 0, "k+", markersize=10)
        path.set_title("contact point (cross: centre of the table)")
        path.legend(loc="lower left", fontsize=8)
        slope.loglog(STEPS, errors[:, 0], "o-", label="position")
        slope.loglog(STEPS, errors[:, 1], "s-", label="angular velocity")
        reference = np.array(STEPS) ** 2
        slope.loglog(STEPS, 0.2 * reference, "k:", label="slope 2")
        slope.set_title("homogeneous ball: error against the step, T = 10")
        slope.set_xlabel("h")
        slope.set_xticks(STEPS, [f"{h:g}" for h in STEPS])
        slope.minorticks_off()
        slope.legend()
        kept = moving_energy(homogeneous)
        energy.plot(homogeneous.times, homogeneous.energy(), label="energy")
        energy.plot(homogeneous.times, kept, label="moving energy")
        energy.set_title("homogeneous ball on the rotating table")
        energy.set_xlabel("t")
        energy.legend(loc="upper right", facecolor="white", frameon=True, framealpha=0.9)
        plot_constraints(constraint, homogeneous, label="homogeneous")
        plot_constraints(constraint, inhomogeneous, label="inhomogeneous")
        constraint.legend()
    return figure


def main(target: str | Path = "output/rolling_sphere.png") -> dict[str, float]:
    """Run, print, compare with known answers, draw; returns the numbers printed."""
    ball = gni.scenes.rolling_ball()
    errors = errors_over_steps(ball)
    slopes = [np.polyfit(np.log(STEPS), np.log(errors[:, i]), 1)[0] for i in (0, 1)]
    run = gni.integrate(ball.system, ball.start, step=0.05, t_end=100.0)
    print(run.summary())
    drift = np.max(np.abs(moving_energy(run) - moving_energy(run)[0]))
    print(f"  moving energy: largest change {drift:.2e}")
    print("Homogeneous ball, Rattle, T = 10, against the exact solution:")
    for h, (position, omega) in zip(STEPS, errors, strict=True):
        print(f"  h = {h:<7g} position {position:.3e}   omega {omega:.3e}")
    print(f"  slopes {slopes[0]:.3f} and {slopes[1]:.3f}")

    chaplygin = gni.scenes.inhomogeneous_ball()
    settings = {"step": 0.0025, "t_end": 40.0}
    free = gni.integrate(chaplygin.system, chaplygin.start, **settings)
    reference = gni.integrate(
        chaplygin.system, chaplygin.start, method=gni.ReferenceFlow(rtol=1e-12), **settings
    )
    difference = float(np.max(np.abs(free.base - reference.base)))
    print(free.summary())
    print(f"  largest difference from the reference solution {difference:.2e}")
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draw(run, free, errors).savefig(target)
    print(f"Figure written to {target}")
    return {"slope": float(slopes[0]), "error": float(errors[1, 0]), "difference": difference}


if __name__ == "__main__":
    main(*sys.argv[1:2])
