"""Constraint rows that are written twice, become dependent on the way, or come apart."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from hard_case import HardCase, Verdict, quietly, refusal, verdict, violation

import groupoid_gni as gni

SOURCE = "FIELD 4 #10, #11"


def with_rows(system: gni.MechanicalSystem, mix: Any) -> gni.MechanicalSystem:
    """The same system with the rows ``mix @ mu``."""
    plain = system.plain["constraints"]
    drift = system.plain.get("drift")
    return gni.MechanicalSystem(
        system.space,
        metric=system.plain["metric"],
        constraints=lambda x, p: mix @ plain(x, p),
        drift=drift,
        potential=system.plain.get("potential"),
        parameters=dict(system.parameters),
    )


def redundant(scene: gni.scenes.Scene, mix: Any, method: Any, h: float = 0.02) -> Verdict:
    """Rows written twice, scaled, added: the motion of the independent rows."""
    mix = np.array(mix, dtype=float)
    system = with_rows(scene.system, mix)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        start = system.state(scene.start.base, scene.start.velocity)
    options = {"step": h, "n_steps": 500, "method": method}
    run = quietly(system, start, **options)
    plain = quietly(scene.system, scene.start, **options)
    gap = max(np.max(np.abs(run.base - plain.base), initial=0.0),
              np.max(np.abs(run.velocities - plain.velocities)))  # fmt: skip
    named = [w for w in caught if isinstance(w.message, gni.DependentConstraintsWarning)]
    bound = 1e-10 if isinstance(method, gni.Rattle) else 1e-12
    return verdict(
        f"motion {gap:.0e} apart, all rows at {violation(run):.0e}; "
        f"{len(named)} warning, kept rows {start.active_rows}",
        gap < bound, violation(run) < 1e-13, len(named) == 1,
        len(start.active_rows) == scene.system.constraint_count,
    )  # fmt: skip


def steered(limit: float) -> gni.MechanicalSystem:
    """A wheel that is steered about y: the row vanishes where the steering says so.

    q = (x, y, z): ``(limit - y) (x' - sin(y) z') = 0``.
    """
    return gni.MechanicalSystem(
        gni.PairGroupoid(3),
        np.diag([1.3, 0.7, 0.9]),
        constraints=lambda q, p: (p.limit - q[1]) * np.array([[1.0, 0.0, -np.sin(q[1])]]),
        parameters={"limit": limit},
    )


def snakeboard_like(limit: float) -> gni.MechanicalSystem:
    """Two axles that become parallel at y = limit."""
    return gni.MechanicalSystem(
        gni.PairGroupoid(4),
        np.diag([1.3, 0.7, 0.9, 1.1]),
        constraints=lambda q, p: np.array(
            [[np.sin(q[1]), 0.0, np.cos(q[1]), 0.3], [np.sin(p.limit), 0.0, np.cos(p.limit), 0.3]]
        ),
        parameters={"limit": limit},
    )


def dropping(make: Callable[[float], gni.MechanicalSystem], limit: float, method: Any) -> Verdict:
    """Rank drop at y = limit, reached at t = limit: named with step, point and condition number."""
    system, h = make(limit), 0.05
    size = system.space.rank
    base, velocity = np.zeros(size), np.full(size, 0.2)
    velocity[1] = 1.0
    start = system.state(base, velocity, project_start=True)
    run = quietly(system, start, step=h, n_steps=200, method=method, on_failure="return")
    step = re.search(r"Failed in step (\d+) of 200", run.message)
    condition = re.search(r"condition number of C there ([\d.e+]+), one step ahead ([\d.e+]+)",
                          run.message)  # fmt: skip
    where = int(step.group(1)) if step else -1
    told = condition.groups() if condition else ("?", "?")
    return verdict(
        f"{run.outcome.name} in step {where} (drop in step {np.ceil(limit / h):.0f}), condition "
        f"{told[0]}, one step ahead {told[1]}; constraint until there {violation(run):.0e}",
        run.outcome is gni.Outcome.CONSTRAINTS_SINGULAR, abs(where - limit / h) <= 1.0,
        condition is not None, "at the base point [" in run.message, violation(run) < 1e-9,
    )  # fmt: skip


def coming_apart(rate: float) -> Verdict:
    """Two equal rows at the start, left out with a warning; the second turns away."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        np.diag([1.3, 0.7, 0.9]),
        constraints=lambda x, p: np.array([[0.0, 1.0, 0.2], [0.0, 1.0 + p.a * x[0], 0.2]]),
        parameters={"a": rate},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.DependentConstraintsWarning)
        start = system.state([0.0, 0.1, -0.1], [1.0, 0.06, -0.3])
    run = quietly(system, start, step=0.05, n_steps=60, on_failure="return")
    return verdict(f"{run.outcome.name} after t = {run.times[-1]:g}; rows kept so far to "
                   f"{violation(run):.0e}",
                   run.outcome is gni.Outcome.CONSTRAINT_LOST, violation(run) < 1e-6)  # fmt: skip


def started_at_the_drop(limit: float) -> Verdict:
    """A start where the row vanishes: not a free motion without a word."""
    system = steered(limit)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        message = refusal(lambda: system.state([0.0, limit, 0.0], [0.3, 1.0, 0.2]))
        said = [str(w.message) for w in caught]
        outcome = "refused"
        if not message:
            start = system.state([0.0, limit, 0.0], [0.3, 1.0, 0.2])
            outcome = quietly(
                system, start, step=0.05, n_steps=60, on_failure="return"
            ).outcome.name
    zero = any("are zero" in text for text in said)
    return verdict(f"warned that the row is zero: {zero}; run: {outcome}",
                   zero, outcome in ("CONSTRAINT_LOST", "refused"))  # fmt: skip


BALL = gni.scenes.inhomogeneous_ball
ROBOT = gni.scenes.two_wheeled_robot
TWICE = ((1.0, 0.0), (0.0, 1.0), (1.0, 0.0))
MIXED = ((2.0, -1.0), (-4.0, 2.0), (0.3, 0.7), (1e-3, 5.0))
THREE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.2, -3.0, 1.0))

CASES = [
    *(
        HardCase(
            f"redundant rows, {label}", "C is singular", SOURCE,
            "one warning, and the motion of the independent rows to round-off", run,
        )
        for label, run in {
            "ball, a row twice": lambda: redundant(BALL(), TWICE, gni.GNI()),
            "ball, rows mixed": lambda: redundant(BALL(), MIXED, gni.GNI()),
            "ball, rows mixed, Rattle": lambda: redundant(BALL(), MIXED, gni.Rattle()),
            "robot, a sum of rows": lambda: redundant(ROBOT(), THREE, gni.GNI()),
            "robot, a sum of rows, order 6": lambda: redundant(ROBOT(), THREE, gni.GNI(6)),
        }.items()
    ),
    *(
        HardCase(
            f"rank drop, {make.__name__.replace('_', ' ')}, at y = {limit:g}, {method}",
            "C becomes singular on the way", SOURCE,
            "CONSTRAINTS_SINGULAR in the step of the drop, with point and condition number",
            partial(dropping, make, limit, method),
        )
        for make in (steered, snakeboard_like)
        for limit, method in ((1.5, gni.GNI()), (0.985, gni.GNI(4)), (1.23, gni.Rattle()))
    ),
    *(
        HardCase(
            f"rows that come apart, rate {rate:g}", "a row left out as dependent matters later",
            SOURCE, "CONSTRAINT_LOST, before the row is violated by 1e-6",
            partial(coming_apart, rate),
        )
        for rate in (0.5, -0.07)
    ),
    *(
        HardCase(
            f"start where a row vanishes, y = {limit:g}", "the rank is smaller at the start only",
            SOURCE, "a warning at the start, CONSTRAINT_LOST in the run",
            partial(started_at_the_drop, limit),
        )
        for limit in (0.4, -1.1)
    ),
]  # fmt: skip
