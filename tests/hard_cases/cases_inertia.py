"""Inertia that spans many decades, and directions with hardly any of it."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from hard_case import (
    HardCase,
    Verdict,
    energy_error,
    numbers,
    quietly,
    refusal,
    shared,
    verdict,
    violation,
)

import groupoid_gni as gni

SOURCE = "FIELD 4 #9"
DECADES = (0, 4, 8, 12)


def digits_lost(decades: float) -> float:
    """What round-off leaves of a constraint where the inertia spans so many decades."""
    return 3e-15 * 10.0 ** (decades / 2)


def slender(axis: tuple[float, ...], slant: float) -> Verdict:
    """A body whose moments are 1.3, 1 and 10^-k, not turning about an axis: exact motion.

    slant : how far the principal axes are turned out of the frame.
    """
    told, fine = [], []
    turn = gni.SO3(retraction=gni.Exponential()).exp(slant * np.array([0.2, -0.3, 0.1]))
    across = np.cross(axis, [0.3, 1.0, -0.2])
    for k in DECADES:
        inertia = turn @ np.diag([1.3, 1.0, 10.0**-k]) @ turn.T
        scene = shared(gni.scenes.suslov(inertia, axis, across / np.linalg.norm(across)))
        # the lighter, the faster: the rate of settling goes like the root of the ratio
        h = 0.01 * 10.0 ** (-k / 2)
        run = quietly(scene.system, scene.start, step=h, n_steps=2000, on_failure="return")
        exact = scene.exact(run.times)[1]
        error = float(np.max(np.abs(run.velocities - exact)) / np.max(np.abs(exact)))
        told.append(f"1e{k}: {run.outcome.name}, constraint {violation(run):.0e}, error "
                    f"{error:.0e}")  # fmt: skip
        fine.append(violation(run) < digits_lost(k) and error < 1e-3)
        fine.append(run.success or (slant > 0.0 and k == 12))
    return verdict("; ".join(told), *fine)


@cache
def geared_masses() -> gni.MechanicalSystem:
    """x' + (offset + sin y) z' = 0."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda q, p: np.diag(p.masses),
        constraints=lambda q, p: np.array([[1.0, 0.0, p.offset + np.sin(q[1])]]),
        potential=lambda q, p: (q[0] ** 2 + 2.0 * q[2] ** 2) / 2 - np.cos(q[1]),
        parameters={"masses": np.ones(3), "offset": 0.0},
    )


def unequal_masses(light: float, offset: float) -> Verdict:
    """A heavy and a light particle, x' + (offset + sin y) z' = 0, y swinging through 0."""
    told, fine = [], []
    for k in DECADES:
        system = geared_masses().with_parameters(masses=[10.0**k, 1.0, light], offset=offset)
        start = system.state([0.3, 0.4, -0.2], [0.0, 0.9, 0.5], project_start=True)
        options = {"n_steps": 2000, "on_failure": "return"}
        runs = [quietly(system, start, step=h, **options) for h in (0.01, 0.005)]
        errors = [energy_error(run) for run in runs]
        outcome = runs[0].outcome
        told.append(f"1e{k}: {outcome.name}, constraint {violation(runs[0]):.0e}, energy "
                    f"{numbers(errors)}")  # fmt: skip
        fine.append(all(violation(run) < 1e-13 for run in runs))
        fine.append(errors[1] < max(0.5 * errors[0], 1e-12))
        # where y passes 0 a row of a heavy and a light part turns over within y = 10^(-k/2)
        turns = offset < 1.0 and 10.0**k / light > 1e6
        fine.append(outcome is (gni.Outcome.CONSTRAINTS_SINGULAR if turns else gni.Outcome.SUCCESS))
    return verdict("; ".join(told), *fine)


@cache
def slanted_body() -> gni.MechanicalSystem:
    """A body that does not turn about a slanted axis, with any inertia."""
    return gni.MechanicalSystem(
        gni.SO3(), lambda x, p: p.G, constraints=[[0.4, -0.3, 1.0]], parameters={"G": np.eye(3)}
    )


def nearly_massless(direction: tuple[float, ...]) -> Verdict:
    """A direction of inertia 10^-k: integrated with its digits, or refused by name."""
    n = np.array(direction) / np.linalg.norm(direction)
    told, fine = [], []
    for k in (8, 12, 14, 17):
        metric = np.eye(3) - (1.0 - 10.0**-k) * np.outer(n, n)
        system = slanted_body().with_parameters(G=metric)
        message = refusal(lambda s=system: s.state(velocity=[1.0, 0.5, 0.0], project_start=True))
        if message:
            told.append(f"1e-{k}: refused")
            fine.append(k >= 14 and "not positive definite" in message)
            continue
        start = system.state(velocity=[1.0, 0.5, 0.0], project_start=True)
        run = quietly(system, start, step=0.01, n_steps=500, on_failure="return")
        digits = 1e-15 * 10.0**k
        told.append(f"1e-{k}: {run.outcome.name}, energy {energy_error(run):.0e}, constraint "
                    f"{violation(run):.0e}")  # fmt: skip
        kept = energy_error(run) < max(1e-3, 10 * digits) and violation(run) < digits_lost(k)
        fine.append(not run.success or kept)
    return verdict("; ".join(told), *fine)


def massless() -> Verdict:
    """No inertia at all, and a negative one."""
    messages = []
    for smallest in (0.0, -1e-3):
        system = gni.MechanicalSystem(gni.PairGroupoid(2), np.diag([1.3, smallest]))
        messages.append(refusal(lambda s=system: s.state([0.0, 0.0], [1.0, 1.0])))
    return verdict("; ".join(m.split(";")[0] for m in messages),
                   *("every direction needs inertia" in m for m in messages))  # fmt: skip


CASES = [
    *(
        HardCase(
            f"slender body, axis {axis}, principal axes turned by {slant:g}",
            "C = mu G^-1 mu^T and G are ill conditioned", SOURCE,
            "ratios 1 to 1e12: exact motion to 1e-3, constraint loses half of the decades; where "
            "the frame mixes them, NEWTON_FAILED at 1e12",
            partial(slender, axis, slant),
        )
        for axis, slant in (((0.3, 0.4, 1.0), 0.0), ((0.0, 0.0, 1.0), 1.0), ((1.0, -0.5, 0.7), 1.0))
    ),
    *(
        HardCase(
            f"mass ratios, light mass {light:g}, f = {offset:g} + sin y",
            "the heavy mass hides the light one", SOURCE,
            "ratios 1 to 1e12: constraint below 1e-13, energy error of order 2; a row that turns "
            "over within one step is CONSTRAINTS_SINGULAR",
            partial(unequal_masses, light, offset),
        )
        for light, offset in ((1.0, 1.2), (1e-3, 1.5), (1.0, 0.0))
    ),
    *(
        HardCase(
            f"nearly massless direction {n}", "G^-1 has one entry of 10^k", SOURCE,
            "energy and constraint to the digits the condition leaves, or refused, or a failure",
            partial(nearly_massless, n),
        )
        for n in ((0.0, 0.6, 0.8), (1.0, 1.0, -1.0))
    ),
    HardCase("massless direction", "G is singular", SOURCE,
             "refused at the start: every direction needs inertia", massless),
]  # fmt: skip
