"""Transmissions that are not reversible: what keeps its energy for 1e6 steps, and what does not."""

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
    quietly,
    shared,
    verdict,
)

import groupoid_gni as gni
from groupoid_gni.diagnostics import energy_drift
from groupoid_gni.diagnostics.energy_drift import Drift

SINE = (0.0, 1.0, 0.0, 0.0)
CROOKED = (0.3, 1.0, 0.4, 0.5)
LEANING = (-0.2, 0.7, -0.6, 0.3)
MEANS = gni.GNI(flow=gni.Variational(gni.Rattle()))
SOURCE = "FIELD 2.9, 4 #1, #2; after Modin and Verdier 2020"


def kept_part(run: gni.Trajectory) -> Any:
    """``E - h^2/32 |dV|^2`` of the two oscillators; the driver takes no constraint force."""
    k, h = float(run.system.parameters["k"]), run.step_size
    x, z = run.base[:, 0], run.base[:, 1]
    kinetic = np.sum(run.velocities[:, :2] ** 2, axis=1)
    return (kinetic + x**2 + k * z**2) / 2 - h**2 / 32 * (x**2 + (k * z) ** 2)


def quadratic(gearing: Any, stiffness: float, h: float, steps: int = 1_000_000) -> Verdict:
    """The positive control."""
    scene = shared(gni.scenes.variable_transmission(gearing, stiffness, quartic=0.0))
    run = quietly(scene.system, scene.start, step=h, n_steps=steps, method=MEANS, save_every=500)
    kept = change(kept_part(run))
    swing = energy_error(run)
    return verdict(
        f"the expression changes by {kept:.1e} in {steps:.0e} steps, the energy swings by "
        f"{swing:.1e}",
        kept < 1e-9, swing > 1e3 * kept,
    )  # fmt: skip


def quartic(gearing: Any, asymmetry: float, stiffness: float = 1.7, t_end: float = 2e4) -> Verdict:
    """Rates at two steps, and the energy-preserving flow at h = 0.1."""
    scene = shared(gni.scenes.variable_transmission(gearing, stiffness, asymmetry=asymmetry))
    rates = []
    for h in (0.05, 0.025):
        run = quietly(scene.system, scene.start, step=h, t_end=t_end, save_every=round(0.4 / h))
        found = energy_drift(run)
        rates.append(found.rate if found.verdict is Drift.LINEAR else 0.0)
    method = gni.GNI(2, EXACT)
    run = quietly(scene.system, scene.start, step=0.1, t_end=t_end, method=method, save_every=8)
    exact = energy_error(run)
    ratio = rates[0] / rates[1] if rates[1] else np.nan
    return verdict(
        f"rates {numbers(rates)} at h = 0.05, 0.025: ratio {ratio:.2f}; EnergyPreserving "
        f"{exact:.0e}",
        abs(ratio - 4.0) < 0.3, exact < 1e-11,
    )  # fmt: skip


def reversible(position: Any, driver_speed: float, t_end: float = 2e4) -> Verdict:
    """The same potential with a reversible gearing."""
    scene = shared(
        gni.scenes.variable_transmission(
            SINE, asymmetry=0.0, position=position, driver_speed=driver_speed
        )
    )
    run = quietly(scene.system, scene.start, step=0.1, t_end=t_end, save_every=4)
    found = energy_drift(run)
    return verdict(f"{found.verdict.value}, largest change {energy_error(run):.1e}",
                   found.verdict is Drift.FLAT, energy_error(run) < 2e-2)  # fmt: skip


HARD_QUADRATIC = "hardly any method keeps the energy where the gearing is not reversible"
FLAT_QUADRATIC = "E - h^2/32 |dV|^2 of the oscillators flat to 1e-9 in 1e6 steps, GNI of means"
HARD_QUARTIC = "the energy of a method of order 2 drifts like h^2 t"
DRIFTS = "GNI drifts linearly, rate ratio 4 for h and h/2; EnergyPreserving within 1e-11"

CASES = [
    *(
        HardCase(f"transmission, quadratic, {label}", HARD_QUADRATIC, SOURCE, FLAT_QUADRATIC, run)
        for label, run in {
            "f = sin y, k = 1, h = 0.1": partial(quadratic, SINE, 1.0, 0.1),
            "crooked f, k = 1.7, h = 0.05": partial(quadratic, CROOKED, 1.7, 0.05),
            "crooked f, k = 5.3, h = 0.4": partial(quadratic, CROOKED, 5.3, 0.4),
            "leaning f, k = 2, h = 0.2": partial(quadratic, LEANING, 2.0, 0.2),
        }.items()
    ),
    *(
        HardCase(f"transmission, quartic, {label}", HARD_QUARTIC, SOURCE, DRIFTS, run,
                 slow="k = 2.3" in label)
        for label, run in {
            "crooked f, e = 0.5, k = 2.3": partial(quartic, CROOKED, 0.5, 2.3),
            "crooked f, e = 0.5": partial(quartic, CROOKED, 0.5),
            "crooked f, e = -0.3": partial(quartic, CROOKED, -0.3),
        }.items()
    ),
    *(
        HardCase(f"transmission, reversible, {label}", "the negative control of the one above",
                 SOURCE, "GNI at h = 0.1 is flat up to t = 2e4", run)
        for label, run in {
            "as in FIELD": partial(reversible, (1.0, 0.5), 2.5),
            "faster driver": partial(reversible, (0.7, -0.4), 3.2),
        }.items()
    ),
]
