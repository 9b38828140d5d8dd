"""A stiff spring at the stability limit: where each method stops being usable, and what it says."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
from hard_case import EXACT, HardCase, Verdict, quietly, verdict, violation

import groupoid_gni as gni

SOURCE = "FIELD 4 #12; theory.md, theorem 8.1"
BOUNDED, GROWS = "bounded", "grows"


@cache
def springs() -> gni.MechanicalSystem:
    """x' + sin(y) z' = 0 with a stiff spring along y, which the constraint turns with."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=np.eye(3),
        constraints=lambda q, p: np.array([[1.0, 0.0, np.sin(q[1])]]),
        potential=lambda q, p: (q[0] ** 2 + p.w**2 * q[1] ** 2 + p.k * q[2] ** 2) / 2,
        parameters={"w": 1.0, "k": 1.0},
    )


def sprung(omega: float, softer: float) -> tuple[gni.MechanicalSystem, gni.State]:
    """A start whose stiff spring moves."""
    system = springs().with_parameters(w=omega, k=softer)
    return system, system.state([0.4, 0.01, -0.3], [0.0, 0.02 * omega, 0.5], project_start=True)


def growth(method: Any, product: float, softer: float, count: int) -> tuple[float, str]:
    """Largest energy relative to the start, and how the run ended."""
    h = 0.02
    system, start = sprung(product / h, softer)
    run = quietly(system, start, step=h, n_steps=count, method=method, on_failure="return")
    with np.errstate(all="ignore"):
        energy = run.energy()
        largest = float(np.max(np.abs(energy / energy[0])))
    return (largest if np.isfinite(largest) else np.inf), run.outcome.name


def limit(method: Any, table: dict[float, str], softer: float) -> Verdict:
    """Whether the energy stays bounded at each h omega; growth must end in a failure."""
    told, fine = [], []
    for product, expected in table.items():
        largest, outcome = growth(method, product, softer, 20_000)
        told.append(f"{product:g}: {largest:.2g} E, {outcome}")
        if expected == BOUNDED:
            fine.append(largest < 300.0 and outcome == "SUCCESS")
        else:
            fine.append(largest > 1e6 and outcome != "SUCCESS")
    return verdict("; ".join(told), *fine)


def strongly_stiff(product: float, softer: float) -> Verdict:
    """EnergyPreserving far beyond every explicit limit."""
    h = 0.02
    system, start = sprung(product / h, softer)
    run = quietly(system, start, step=h, n_steps=5000, method=gni.GNI(2, EXACT))
    energy = run.energy()
    error = float(np.max(np.abs(energy / energy[0] - 1.0)))
    return verdict(f"energy {error:.0e}, constraint {violation(run):.0e}",
                   error < 1e-10, violation(run) < 1e-13)  # fmt: skip


BELOW_TWO = {0.1: BOUNDED, 1.9: BOUNDED, 1.99: BOUNDED, 2.01: GROWS}
BELOW_FOUR = {0.1: BOUNDED, 1.99: BOUNDED, 2.01: BOUNDED, 3.99: BOUNDED, 4.01: GROWS}
ALWAYS = {0.1: BOUNDED, 1.99: BOUNDED, 2.01: BOUNDED, 4.01: BOUNDED, 20.0: BOUNDED}
LIMITS: dict[str, tuple[Any, dict[float, str]]] = {
    "GNI()": (gni.GNI(), BELOW_TWO),
    "GNI(flow=Variational(Rattle()))": (gni.GNI(flow=gni.Variational(gni.Rattle())), BELOW_FOUR),
    "GNI(flow=Splitting())": (gni.GNI(flow=gni.Splitting()), BELOW_TWO),
    "GNI(flow=EnergyPreserving())": (gni.GNI(flow=EXACT), ALWAYS),
    "Rattle()": (gni.Rattle(), BELOW_TWO),
    "Midpoint()": (gni.Midpoint(), ALWAYS),
    "McLachlanPerlmutter()": (gni.McLachlanPerlmutter(), BELOW_TWO),
}


def said(table: dict[float, str]) -> str:
    """The expectation in words."""
    fine = [f"{k:g}" for k, v in table.items() if v == BOUNDED]
    bad = [f"{k:g}" for k, v in table.items() if v == GROWS]
    text = f"bounded energy at h omega = {', '.join(fine)}"
    return text + (f"; beyond the limit, at {', '.join(bad)}, a failure" if bad else "")


CASES = [
    *(
        HardCase(
            f"stiff spring, {name}, k = {softer:g}",
            "an explicit kick is unstable beyond h omega = 2", SOURCE, said(table),
            partial(limit, method, table, softer),
        )
        for name, (method, table) in LIMITS.items() for softer in (1.7, 0.6)
    ),
    *(
        HardCase(
            f"stiff spring, EnergyPreserving, h omega = {product:g}",
            "two hundred times beyond the explicit limit", SOURCE,
            "energy to 1e-10, constraint at round-off", partial(strongly_stiff, product, softer),
        )
        for product, softer in ((50.0, 1.7), (400.0, 0.6))
    ),
]  # fmt: skip
