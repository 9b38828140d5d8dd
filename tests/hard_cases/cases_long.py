"""Ten million steps: how round-off grows, and rotations that stay rotations."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from hard_case import (
    EXACT,
    HardCase,
    Verdict,
    change,
    energy_error,
    numbers,
    orders,
    quietly,
    shared,
    verdict,
    violation,
)

import groupoid_gni as gni
from groupoid_gni.diagnostics import roundoff_growth

LONG, VERTICAL = "FIELD 4 #18", "FIELD 4, vertical rolling disc"


def vertical_disc(
    mass: float, radius: float, turning: float, rolling: float, retraction: Any
) -> tuple[gni.MechanicalSystem, gni.State, Any]:
    """Upright disc on R^2 x SO(2) x SO(2), heading phi and roll theta; system, start, exact place.

    ``x' = R theta' cos phi, y' = R theta' sin phi``: rates are constant, the contact point runs
    round a circle of radius ``R theta'/phi'``.
    """
    along, across = mass * radius**2 / 2, mass * radius**2 / 4
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(
            gni.VectorGroup(2), gni.SO2(retraction=retraction), gni.SO2(retraction=retraction)
        ),
        metric=np.diag([mass, mass, across, along]),
        constraints=lambda x, p: np.array([[1.0, 0.0, 0.0, -p.R * x[2]],
                                           [0.0, 1.0, 0.0, -p.R * x[4]]]),
        parameters={"R": radius},
    )  # fmt: skip
    base = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    start = system.state(base, [radius * rolling, 0.0, turning, rolling])
    circle = radius * rolling / turning

    def exact(t: Any) -> Any:
        return circle * np.stack([np.sin(turning * t), 1.0 - np.cos(turning * t)], axis=1)

    return system, start, exact


def rolled(numbers_: tuple[float, ...], runs: tuple[tuple[float, float], ...]) -> Verdict:
    """Rates exactly constant, the circle to order 2, the exact heading with the exponential."""
    system, start, exact = vertical_disc(*numbers_, gni.Exponential())
    told, fine = [], []
    for h, t_end in runs:
        run = quietly(system, start, step=h, t_end=t_end)
        rates = float(np.max(np.abs(run.velocities[:, 2:] - start.velocity[2:])))
        heading = run.base[:, [2, 4]] - np.stack(
            [np.cos(numbers_[2] * run.times), np.sin(numbers_[2] * run.times)], axis=1
        )
        place = float(np.max(np.abs(run.base[:, :2] - exact(run.times))))
        told.append(f"h = {h:g}, T = {t_end:g}: rates {rates:.0e}, heading "
                    f"{np.max(np.abs(heading)):.0e}, place {place:.0e}")  # fmt: skip
        circle = numbers_[1] * abs(numbers_[3] / numbers_[2])
        fine += [rates < 1e-11, np.max(np.abs(heading)) < 1e-11 * max(1.0, t_end),
                 place < circle * (h * numbers_[2]) ** 2, energy_error(run) < 1e-11]  # fmt: skip
    errors = []
    for h in (0.05, 0.025, 0.0125):
        run = quietly(system, start, step=h, t_end=4.0)
        errors.append(float(np.max(np.abs(run.base[:, :2] - exact(run.times)))))
    told.append(f"errors {numbers(errors)}, order {orders(errors)[-1]:.2f}")
    return verdict("; ".join(told), *fine, abs(orders(errors)[-1] - 2.0) < 0.05)


def grown(make: Any, h: float, steps: int, method: Any, bound: float) -> Verdict:
    """Round-off of the energy: how large, and how it grows."""
    scene = shared(make())
    run = quietly(scene.system, scene.start, step=h, n_steps=steps, method=method,
                  save_every=steps // 10_000)  # fmt: skip
    growth = roundoff_growth(run, run.energy() / run.energy()[0])
    low, high = growth.interval
    defect = float(np.max(scene.system.space.base_defect(run.base), initial=0.0))
    return verdict(
        f"energy {energy_error(run):.1e} after {steps:.0e} steps, exponent {growth.exponent:.2f} "
        f"({low:.2f} ... {high:.2f}), rotations off by {defect:.0e}, constraint "
        f"{violation(run):.0e}",
        energy_error(run) < bound, growth.exponent < 0.75, defect < 1e-13,
        violation(run) < 1e-14,
    )  # fmt: skip


def disc_for_long() -> Any:
    """The vertical disc as something with a system and a start."""
    system, start, _ = vertical_disc(1.3, 0.7, 2.0, 1.1, gni.Cayley())
    return gni.scenes.Scene(system, start, "vertical rolling disc on R^2 x SO(2) x SO(2)")


def momenta_of_the_resting_table(steps: int, mass: float, inertia: float) -> Verdict:
    """Ball on a table at rest: velocity, spin and energy are constants of the motion."""
    scene = shared(
        gni.scenes.rolling_ball(mass, 0.8, inertia, 0.0, (0.3, -0.2), (0.7, 0.4), 0.35)
    )
    run = quietly(scene.system, scene.start, step=0.05, n_steps=steps, save_every=steps // 10_000)
    drift = float(np.max(np.abs(run.velocities - run.velocities[0])))
    exact = scene.exact(run.times[-1:])[0]
    gap = float(np.max(np.abs(run.base[-1] - exact)) / np.max(np.abs(exact)))
    return verdict(
        f"velocities {drift:.1e}, energy {change(run.energy()):.1e}, place {gap:.1e} of the way "
        f"after {steps:.0e} steps",
        drift < 1e-16 * steps, gap < 1e-16 * steps, violation(run) < 1e-14,
    )  # fmt: skip


STILL, RESTING = gni.scenes.inhomogeneous_ball, "constants of the motion drift by round-off only"
CASES = [
    *(
        HardCase(
            f"vertical rolling disc, {label}", "exact solution: nothing may be hidden", VERTICAL,
            "rates and energy at round-off, heading exact, place on the circle to order 2",
            partial(rolled, numbers_, runs),
        )
        for label, numbers_, runs in (
            ("m = R = I = 1", (1.0, 1.0, 2.0, 1.0), ((0.1, 1.0), (0.01, 50.0), (0.1, 1000.0))),
            ("m = 1.7, R = 0.6", (1.7, 0.6, 3.1, -2.0), ((0.05, 1.0), (0.02, 200.0))),
        )
    ),
    *(
        HardCase(
            f"ball on a table at rest, {label}", RESTING, LONG,
            "velocities and place to 1e-16 a step, constraint at round-off", run, slow,
        )
        for label, run, slow in (
            ("m = 1.7, 1e5 steps", partial(momenta_of_the_resting_table, 10**5, 1.7, 0.61), False),
            ("m = 0.3, 1e5 steps", partial(momenta_of_the_resting_table, 10**5, 0.3, 0.05), False),
            ("m = 1.7, 1e7 steps", partial(momenta_of_the_resting_table, 10**7, 1.7, 0.61), True),
        )
    ),
    *(
        HardCase(
            f"round-off, {label}", "rotations and momenta lose a bit a step", LONG,
            f"energy below {bound:g} and growing like a random walk, rotations to 1e-13",
            partial(grown, make, h, steps, method, bound), steps > 10**6,
        )
        for label, make, h, steps, method, bound in (
            ("Chaplygin ball, EnergyPreserving, 5e4 steps", lambda: STILL(table=0.0), 0.05,
             50_000, gni.GNI(2, EXACT), 1e-11),
            ("vertical disc, GNI, 4e5 steps", disc_for_long, 0.05, 400_000, gni.GNI(), 1e-11),
            ("Chaplygin ball, EnergyPreserving, 1e7 steps", lambda: STILL(table=0.0), 0.05,
             10**7, gni.GNI(2, EXACT), 1e-10),
            ("vertical disc, GNI, 1e7 steps", disc_for_long, 0.05, 10**7, gni.GNI(), 1e-10),
        )
    ),
]  # fmt: skip
