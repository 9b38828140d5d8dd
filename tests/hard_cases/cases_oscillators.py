"""Oscillators with chaotic or gauge-transformed Lagrangians."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from hard_case import (
    EXACT,
    HardCase,
    Verdict,
    distance,
    energy_error,
    numbers,
    orders,
    quietly,
    verdict,
    violation,
)

import groupoid_gni as gni
from groupoid_gni.diagnostics import energy_drift
from groupoid_gni.diagnostics.energy_drift import Drift


@cache
def oscillators() -> gni.MechanicalSystem:
    """x' + y z' = 0, the potential of McLachlan and Perlmutter, plus d/dt (s cos(k z))."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=np.eye(3),
        constraints=lambda q, p: np.array([[1.0, 0.0, q[1]]]),
        potential=lambda q, p: (q @ q + p.eps * (q[0] * q[2]) ** 2) / 2,
        gyroscopic=lambda q, p: np.array([0.0, 0.0, -p.s * p.k * np.sin(p.k * q[2])]),
        parameters={"eps": 0.3, "s": 0.0, "k": 1.0},
    )


def contact_oscillator(
    eps: float = 0.3, z: float = -0.55, gauge: float = 0.0, pull: float = 1.0
) -> tuple[gni.MechanicalSystem, gni.State]:
    """H = 1.5 with 0.5 of it along y, at rest at the start."""
    system = oscillators().with_parameters(eps=eps, s=gauge, k=pull)
    x = np.sqrt((2.0 - z**2) / (1.0 + eps * z**2))
    return system, system.state([x, 1.0, z], [0.0, 0.0, 0.0])


def long_contact(eps: float, z: float, N: int, steps: int, bound: float) -> Verdict:
    """Energy of GNI and of the energy-preserving flow over many steps."""
    system, start = contact_oscillator(eps, z)
    h = 2.0 * np.sin(np.pi / N)
    every = steps // 20_000
    run = quietly(system, start, step=h, n_steps=steps, save_every=every)
    fewer = steps // 10
    exact = quietly(
        system, start, step=h, n_steps=fewer, method=gni.GNI(2, EXACT), save_every=every
    )
    swing, kept = energy_error(run), energy_error(exact)
    found = energy_drift(run)
    return verdict(
        f"GNI {found.verdict.value}, largest change {swing:.1e} in {steps:.0e} steps; "
        f"EnergyPreserving {kept:.0e} in {fewer:.0e}; constraint {violation(run):.0e}",
        swing < bound, found.verdict is not Drift.LINEAR, kept < 1e-9, violation(run) < 1e-13,
    )  # fmt: skip


def gauged(gauge: float, pull: float, t_end: float = 10.0) -> Verdict:
    """The Lagrangian plus dS/dt: the same motion, and the constraint on the shifted momenta."""
    plain, plain_start = contact_oscillator()
    system, start = contact_oscillator(gauge=gauge, pull=pull)
    options = {"step": 0.05, "t_end": t_end, "method": gni.ReferenceFlow(rtol=1e-12)}
    truth = gni.integrate(plain, plain_start, **options)
    same = distance(gni.integrate(system, start, **options), truth.base, truth.velocities)
    errors, kept = [], []
    for h in (0.05, 0.025, 0.0125):
        run = quietly(system, start, step=h, t_end=t_end, save_every=round(0.05 / h))
        errors.append(distance(run, truth.base, truth.velocities))
        kept.append(violation(run))
    shift = float(np.max(np.abs(run.momenta - run.velocities)))
    return verdict(
        f"equations {same:.0e} apart; GNI to the motion without S {numbers(errors)}, orders "
        f"{numbers(orders(errors), '.2f')}; constraint {max(kept):.0e}, momenta shifted by "
        f"{shift:.1f}",
        same < 1e-10, abs(orders(errors)[-1] - 2.0) < 0.1, max(kept) < 1e-14, shift > gauge / 4,
    )  # fmt: skip


@cache
def chaotic_oscillator(n: int) -> gni.MechanicalSystem:
    """q = (x, y_1 .. y_n, z_1 .. z_n), x' + sum y_i z_i' = 0 (McLachlan and Perlmutter)."""

    def potential(q: Any, p: Any) -> Any:
        y, z = q[1 : n + 1], q[n + 1 :]
        return (q @ q + (y * y) @ (z * z) + (z[0] * z[1]) ** 2) / 2

    return gni.MechanicalSystem(
        gni.PairGroupoid(2 * n + 1),
        metric=np.eye(2 * n + 1),
        constraints=lambda q, p: gni.array([[1.0, *np.zeros(n), *q[1 : n + 1]]]),
        potential=potential,
    )


def ensemble(members: int = 18, t_end: float = 1000.0, h: float = 0.05) -> Verdict:
    """Energy errors of an ensemble of chaotic motions, n = 3."""
    system = chaotic_oscillator(3)
    errors = []
    for j in range(members):
        a = j * np.pi / 18
        q = np.array([np.cos(a), 0.6, 0.4, 0.2, 1.0, 1.0, 1.0])
        # along y_1, which the constraint leaves free
        start = system.state(q, [0.0, np.sin(a), 0.0, 0.0, 0.0, 0.0, 0.0])
        run = quietly(system, start, step=h, t_end=t_end, save_every=200)
        errors.append(run.energy() / run.energy()[0] - 1.0)
    found = np.array(errors)
    # the modified energy, about which the energy swings, is not that of the start: compare windows
    gained = found[:, -20:].mean(axis=1) - found[:, 1:21].mean(axis=1)
    mean, doubt = gained.mean(), gained.std() / np.sqrt(members)
    largest = np.max(np.abs(found))
    return verdict(
        f"gained {mean:.1e} +- {doubt:.1e}, largest error {largest:.1e}",
        abs(mean) < 3.0 * doubt, doubt < h**2 / 4, largest < 2.0 * h**2,
    )  # fmt: skip


def many(n: int, steps: int) -> Verdict:
    """Many degrees of freedom: energy and constraint."""
    system = chaotic_oscillator(n)
    rng = np.random.default_rng(2006)
    q, v = rng.normal(size=(2, 2 * n + 1)) * 0.5
    start = system.state(q, v, project_start=True)
    run = quietly(system, start, step=0.05, n_steps=steps)
    half = quietly(system, start, step=0.025, n_steps=2 * steps, save_every=2)
    errors = [energy_error(run), energy_error(half)]
    return verdict(
        f"energy {numbers(errors)} at h = 0.05, 0.025; constraint {violation(run):.0e}",
        errors[0] < 5e-3, 3.0 < errors[0] / errors[1] < 5.0, violation(run) < 1e-14,
    )  # fmt: skip


def cases(
    name: str, hard: str, source: str, expectation: str,
    runs: dict[str, Callable[[], Verdict]], slow: bool = False,
) -> list[HardCase]:  # fmt: skip
    """Variants that share everything but their numbers."""
    return [
        HardCase(f"{name}, {label}", hard, source, expectation, run, slow)
        for label, run in runs.items()
    ]


MANY = "energy error below 5e-3 at h = 0.05, a quarter at h/2; constraint at round-off"

CASES = [
    *cases(
        "contact oscillator", "chaos: the energy may diffuse", "FIELD 4 #3",
        "GNI: no linear drift, change below its bound; EnergyPreserving below 1e-9", {
            "eps = 0.3, N = 40, 1e5 steps": partial(long_contact, 0.3, -0.55, 40, 100_000, 0.01),
            "eps = 0.3, N = 15, 1e5 steps": partial(long_contact, 0.3, -0.55, 15, 100_000, 0.1),
            "eps = 2, N = 40, 1e5 steps": partial(long_contact, 2.0, 0.8, 40, 100_000, 0.05),
        },
    ),
    *cases(
        "contact oscillator", "the same for 1e7 steps", "FIELD 4 #3",
        "GNI: no linear drift, change below 1e-2; EnergyPreserving below 1e-9 in 1e6 steps", {
            "eps = 0.3, N = 40, 1e7 steps": partial(long_contact, 0.3, -0.55, 40, 10**7, 0.01),
        }, slow=True,
    ),
    *cases(
        "gauged contact oscillator", "(9b) is wrong unless Pi carries the gyroscopic term",
        "FIELD 4 #4",
        "L + dS/dt gives the same equations to 1e-10, GNI tends to the same motion with order 2, "
        "constraint at round-off", {
            "S = cos z": partial(gauged, 1.0, 1.0),
            "S = 3 cos z": partial(gauged, 3.0, 1.0),
            "S = 0.5 cos 4z": partial(gauged, 0.5, 4.0),
        },
    ),
    *cases(
        "chaotic oscillators", "7 coordinates, chaotic: only statistics make sense", "FIELD 4 #5",
        "ensemble of 18: no energy gained on the mean, within three standard errors; error below "
        "2 h^2", {
            "n = 3, t = 1000": ensemble,
            "n = 3, t = 3000, h = 0.1": partial(ensemble, 18, 3000.0, 0.1),
        },
    ),
    *cases(
        "chaotic oscillators", "many degrees of freedom", "FIELD 4 #5", MANY, {
            "n = 3": partial(many, 3, 1000),
            "n = 10": partial(many, 10, 1000),
        },
    ),
    *cases(
        "chaotic oscillators", "101 coordinates", "FIELD 4 #5", MANY, {
            "n = 50": partial(many, 50, 1000),
        }, slow=True,
    ),
]  # fmt: skip
