"""Rotations of every size in one step: zero, denormal, near half a turn, and beyond it."""

from __future__ import annotations

import re
from functools import cache, partial
from typing import Any

import numpy as np
from hard_case import EXACT, HardCase, Verdict, numbers, quietly, verdict

import groupoid_gni as gni

STEP, COUNT = 0.1, 20
SOURCE = "FIELD 4 #7, #8"


@cache
def body(retraction: Any, axis: int = 2) -> gni.MechanicalSystem:
    """A body that may turn about two of its principal axes."""
    row = np.zeros(3)
    row[(axis + 1) % 3] = 1.0
    return gni.MechanicalSystem(
        gni.SO3(retraction=retraction), np.diag([1.3, 0.7, 0.9]), constraints=[row]
    )


def steady(retraction: Any, angle: float, method: Any, axis: int) -> tuple[gni.Trajectory, Any]:
    """A steady turn by an angle per step, and the exact attitude at the end."""
    system = body(retraction, axis)
    spin = np.zeros(3)
    spin[axis] = angle / STEP
    start = system.state(velocity=spin)
    options: dict[str, Any] = {"step": STEP, "n_steps": COUNT, "method": method}
    run = quietly(system, start, reconstruct=True, on_failure="return", **options)
    return run, gni.SO3(retraction=gni.Exponential()).exp(COUNT * STEP * spin)


def small(retraction: Any, angles: tuple[float, ...], axis: int) -> Verdict:
    """Angles where closed forms divide zero by zero; a cubic error is allowed to Cayley."""
    errors, allowed = [], []
    for angle in angles:
        run, attitude = steady(retraction, angle, gni.GNI(), axis)
        finite = bool(np.all(np.isfinite(run.rows[:, : run.layout.size])))
        gap = float(np.max(np.abs(run.reconstruct()[-1] - attitude)))
        errors.append(gap if run.success and finite else np.inf)
        cubic = COUNT * angle**3 / 12 if isinstance(retraction, gni.Cayley) else 0.0
        allowed.append(1e-15 * COUNT * min(1.0, 1e3 * angle) + cubic)
    return verdict(f"attitude errors {numbers(errors)} at {numbers(angles, 'g')}",
                   *(e <= a for e, a in zip(errors, allowed, strict=True)))  # fmt: skip


def advice(message: str) -> float:
    """The step that a refusal recommends."""
    found = re.search(r"use a step below (\d[\d.e-]*\d)", message)
    return float(found.group(1)) if found else np.nan


def large(retraction: Any, angles: tuple[float, ...], method: Any, axis: int) -> Verdict:
    """Right (exponential: exact; Cayley: its own angle), or refused with advice that works."""
    told, fine = [], []
    for angle in angles:
        run, attitude = steady(retraction, angle, method, axis)
        if run.success:
            speeds = run.velocities[:, axis] * STEP / angle - 1.0
            gap = float(np.max(np.abs(run.reconstruct()[-1] - attitude)))
            exact = gap if isinstance(retraction, gni.Exponential) else 0.0
            told.append(f"{angle:.6g} done, attitude {gap:.0e}")
            fine.append(exact < 1e-12 and np.max(np.abs(speeds)) < 1e-13)
            continue
        told.append(f"{angle:.6g} {run.outcome.name}, advised {advice(run.message):g}")
        advised = advice(run.message)
        again = gni.integrate(
            run.system, run.system.state(velocity=run.velocities[0]), step=advised,
            n_steps=COUNT, method=method, on_failure="return",
        )  # fmt: skip
        fine.append(run.outcome is gni.Outcome.LEFT_DOMAIN and again.success)
    return verdict("; ".join(told), *fine)


def tumbling(retraction: Any, spin: tuple[float, float]) -> Verdict:
    """A free body that tumbles by up to two radians a step, energy-preserving, or refused."""
    system = gni.MechanicalSystem(
        gni.SO3(retraction=retraction), np.diag([1.3, 0.7, 0.9]), constraints=[[0.3, -0.5, 1.0]]
    )
    start = system.state(velocity=[*spin, 0.0], project_start=True)
    told, fine = [], []
    for h in (0.05, 0.3, 1.0):
        run = quietly(system, start, step=h, n_steps=100, method=gni.GNI(2, EXACT),
                      on_failure="return")  # fmt: skip
        energy = run.energy()
        error = float(np.max(np.abs(energy / energy[0] - 1.0)))
        told.append(f"h = {h:g}: {run.outcome.name}, energy {error:.0e}")
        fine.append(error < 1e-12 and (run.success or run.outcome is gni.Outcome.LEFT_DOMAIN))
    return verdict("; ".join(told), *fine)


RETRACTIONS = {"exp": gni.Exponential(), "Cayley": gni.Cayley()}
NEAR_HALF = (0.5, 1.5, np.pi - 1e-6)
BEYOND = (np.pi + 1e-6, 4.0, 2 * np.pi, 20.0)

CASES = [
    *(
        HardCase(
            f"tiny rotations, {name}, axis {axis}", "0/0 in the closed forms", SOURCE,
            "attitude exact (Cayley: up to angle^3/12 a step), nothing infinite or NaN",
            partial(small, tau, (0.0, 1e-300, 1e-160, 1e-8, 1e-4), axis),
        )
        for name, tau in RETRACTIONS.items() for axis in (0, 2)
    ),
    *(
        HardCase(
            f"large rotations, {name}, {method}", "the branch of log, and cay^-1 at half a turn",
            SOURCE, "velocity to 1e-13 (with exp the exact attitude; Cayley turns by an angle of "
            "its own), or LEFT_DOMAIN and a step that works",
            partial(large, tau, (*NEAR_HALF, *BEYOND), method, 2),
            slow=name == "Cayley" and method in (gni.GNI(6), gni.GNI(2, gni.Splitting())),
        )
        for name, tau in RETRACTIONS.items()
        for method in (gni.GNI(), gni.GNI(6), gni.GNI(2, EXACT), gni.GNI(2, gni.Splitting()),
                       gni.Rattle())
    ),
    *(
        HardCase(
            f"tumbling by large angles, {name}, spin {spin}", "several roots for one step", SOURCE,
            "energy to 1e-12 at every step size, or LEFT_DOMAIN", partial(tumbling, tau, spin),
        )
        for name, tau in RETRACTIONS.items() for spin in ((2.0, 1.1), (-1.0, 3.0))
    ),
]  # fmt: skip
