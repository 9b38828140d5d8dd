"""Rattleback and heavy disc, against equations derived by hand."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import rolling_by_hand as by_hand
from hard_case import EXACT, HardCase, Verdict, energy_error, shared, verdict, violation, warned

import groupoid_gni as gni

SIXTH = gni.GNI(6, EXACT)
RATTLEBACK, DISC = "FIELD 4 #13; Kane and Levinson 1982", "FIELD 4 #19"


def about_vertical(states: Any) -> Any:
    """<Omega, gamma> of (gamma, Omega)."""
    return np.sum(states[:, :3] * states[:, 3:6], axis=1)


def states_of(run: gni.Trajectory) -> Any:
    """(gamma, Omega), (n, 6)."""
    return np.hstack([run.base, run.velocities[:, :3]])


def stone(
    spin: float, product: float, expected: int, t_end: float, h: float = 2e-3, rtol: float = 1e-9
) -> Verdict:
    """Times of the spin reversals, energy, and the force that keeps the stone on the table."""
    scene = shared(gni.scenes.rattleback(product=product, spin=(0.0, 0.0, spin)))
    run = gni.integrate(scene.system, scene.start, step=h, t_end=t_end, method=SIXTH)
    p = scene.system.parameters
    start = np.concatenate([scene.start.base, scene.start.velocity[:3]])
    arm = by_hand.ellipsoid(20.0, 3.0, 2.0, 1.0)
    every = round(0.01 / h)
    instants = run.times[::every]
    truth = by_hand.motion(1.0, 980.665, p["I"], arm, start, instants, rtol)
    theirs = by_hand.reversals(instants, about_vertical(truth))
    ours = by_hand.reversals(instants, about_vertical(states_of(run)[::every]))
    late = max((abs(a - b) for a, b in zip(ours, theirs, strict=False)), default=0.0)
    weight = 980.665
    force = np.sum((run.multipliers + weight * run.base) * run.base, axis=1)
    return verdict(
        f"reversals at {', '.join(f'{t:.4f}' for t in ours) or 'none'}, by hand "
        f"{', '.join(f'{t:.4f}' for t in theirs) or 'none'}; energy {energy_error(run):.0e}, "
        f"constraint {violation(run):.0e}, pressed on by {force.min() / weight:.2f} weights at "
        f"the least",
        len(ours) == len(theirs) == expected, late < 5e-4, energy_error(run) < 1e-11,
        violation(run) < 1e-14, force.min() > 0.0,
    )  # fmt: skip


def disc(per_second: int, t_end: float = 2.0, **options: Any) -> Verdict:
    """Errors against the equations by hand, order 2 and order 6."""
    scene = shared(gni.scenes.rolling_disc(**options))
    p = scene.system.parameters
    start = np.concatenate([scene.start.base, scene.start.velocity[:3]])
    instants = np.linspace(0.0, t_end, 129)
    truth = by_hand.motion(float(p["m"]), float(p["g"]), p["I"], by_hand.rim(float(p["r"])), start,
                           instants, 1e-11)  # fmt: skip
    errors = []
    for n, method in ((per_second, gni.GNI()), (2 * per_second, gni.GNI()), (per_second, SIXTH)):
        run, names = warned(scene.system, scene.start, step=1.0 / n, t_end=t_end, method=method,
                            save_every=round(t_end * n) // 128)  # fmt: skip
        errors.append(float(np.max(np.abs(states_of(run) - truth))))
    flat = float(np.max(np.abs(truth[:, 2])))
    return verdict(
        f"errors {errors[0]:.0e}, {errors[1]:.0e}; order 6: {errors[2]:.0e}, energy "
        f"{energy_error(run):.0e}; flattest {np.degrees(np.arccos(flat)):.2f} degrees; "
        f"{', '.join(names) or 'no warning'}",
        3.4 < errors[0] / errors[1] < 4.6, errors[2] < 1e-3 * errors[1],
        energy_error(run) < 1e-11, names == [],
    )  # fmt: skip


def falling_flat(tilt: float, per_second: int, method: Any) -> Verdict:
    """A disc that falls without turning: it must not go on as if nothing had happened."""
    scene = shared(gni.scenes.rolling_disc(tilt=tilt, spin=(0.0, 0.0, 0.0)))
    run, names = warned(scene.system, scene.start, step=1.0 / per_second, t_end=2.0, method=method,
                        on_failure="return")  # fmt: skip
    degrees = float(np.degrees(np.arccos(min(1.0, np.max(np.abs(run.base[:, 2]))))))
    return verdict(
        f"{run.outcome.name} at t = {run.times[-1]:.4f}, {degrees:.3f} degrees above the plane; "
        f"energy until there {energy_error(run):.0e}, constraint {violation(run):.0e}; "
        f"{', '.join(names) or 'no warning'}",
        not run.success, energy_error(run) < 1e-2, degrees < 2.0, violation(run) < 1e-8,
    )  # fmt: skip


def grazing(turning: float, per_second: int, method: Any) -> Verdict:
    """A disc that nearly lies down: right to a percent and no warning, a failure, or a warning."""
    scene = shared(gni.scenes.rolling_disc(tilt=30.0, spin=(0.0, turning, 0.0)))
    p = scene.system.parameters
    run, names = warned(scene.system, scene.start, step=1.0 / per_second, t_end=1.0, method=method,
                        on_failure="return")  # fmt: skip
    start = np.concatenate([scene.start.base, scene.start.velocity[:3]])
    truth = by_hand.motion(float(p["m"]), float(p["g"]), p["I"], by_hand.rim(1.0), start,
                           np.linspace(0.0, 1.0, 257), 1e-12)  # fmt: skip
    outcome, error = run.outcome.name, np.nan
    if run.success:
        nodes = states_of(run)[:: per_second // 256]
        error = float(np.max(np.abs(nodes[-1] - truth[-1])) / np.max(np.abs(truth[-1])))
    flattest = np.degrees(np.arccos(np.max(np.abs(truth[:, 2]))))
    largest = float(np.max(run.velocity_changes()))
    return verdict(
        f"{outcome}, error {error:.0e}, {', '.join(names) or 'no warning'}; the velocity changes "
        f"by up to {largest:.0%} in a step; flattest {flattest:.2f} degrees",
        not run.success or (names == [] if error < 0.01 else names != []),
    )  # fmt: skip


TURNING = "spin reversals without dissipation, no invariant volume"
REVERSALS = "reversal times of the equations by hand to 5e-4 s, energy to 1e-11, no lift-off"
CASES = [
    *(
        HardCase(f"rattleback, {label}", TURNING, RATTLEBACK, REVERSALS, run, slow)
        for label, run, slow in (
            ("spun the wrong way", partial(stone, -5.0, -0.2, 1, 4.0), False),
            ("spun the right way", partial(stone, 5.0, -0.2, 0, 2.0), False),
            ("mirror image", partial(stone, 5.0, 0.2, 1, 4.0), True),
            ("stronger product of inertia", partial(stone, -4.0, -0.5, 1, 1.5), True),
            ("both reversals, t = 20", partial(stone, -5.0, -0.2, 2, 20.0, 2e-3, 1e-10), True),
        )
    ),
    *(
        HardCase(
            f"rolling disc, {label}", "holonomic and nonholonomic rows; the contact point runs "
            "round the rim", DISC,
            "order 2 against the equations by hand; order 6 a thousand times nearer, energy 1e-11",
            run, slow=label == "FIELD, tilt 0",
        )
        for label, run in {
            "FIELD, tilt 15": partial(disc, 1024),
            "FIELD, tilt 0": partial(disc, 1024, tilt=0.0),
            "wobbling slowly": partial(disc, 256, tilt=0.0, spin=(0.0, 0.3, 2.0)),
            "a light hoop": partial(disc, 1024, mass=0.4, radius=0.3, inertia=(0.018, 0.036),
                                    tilt=20.0, spin=(0.5, 4.0, 9.0)),
        }.items()
    ),
    *(
        HardCase(
            f"disc that falls flat, tilt {tilt:g}, {method}", "no contact point where it lies flat",
            DISC,
            "a failure within two degrees of the plane and nothing wrong before",
            partial(falling_flat, tilt, 512, method), slow=tilt == 10.0 and method == SIXTH,
        )
        for tilt in (30.0, 10.0)
        for method in (gni.GNI(), SIXTH, gni.Rattle(), gni.ReferenceFlow(1e-9))
    ),
    *(
        HardCase(
            f"disc that grazes the plane, turning {turning:g}, {n} steps, {method}",
            "the contact point runs round the rim within a few steps", DISC,
            "right to a percent and no warning, or a failure, or a warning",
            partial(grazing, turning, n, method),
        )
        for turning in (0.01, 0.03) for n in (512, 2048) for method in (gni.GNI(6), SIXTH)
    ),
]  # fmt: skip
