"""What a hard case is: data that the tests judge and that tests/benchmarks/hard_cases.py prints."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import groupoid_gni as gni

EXACT = gni.EnergyPreserving()


@dataclass(frozen=True)
class Verdict:
    """What happened, in numbers, and whether that is what the expectation says."""

    result: str
    passed: bool


@dataclass(frozen=True)
class HardCase:
    """One problem that is hard for any method, and what is expected of the library.

    hard : why.  source : where the problem and its numbers come from.
    expectation : what is stated before the run; for the whole of it ``run`` is the judge.
    run : () -> Verdict.  slow : takes more than about three seconds.
    """

    name: str
    hard: str
    source: str
    expectation: str
    run: Callable[[], Verdict]
    slow: bool = False


def verdict(result: str, *conditions: bool) -> Verdict:
    """Passed if every condition holds."""
    return Verdict(result, bool(conditions) and all(map(bool, conditions)))


_COMPILED: dict[tuple[str, ...], gni.MechanicalSystem] = {}


def shared(scene: gni.scenes.Scene) -> gni.scenes.Scene:
    """The scene on a system of its kind that may be compiled already: only parameters differ."""
    system, start = scene.system, scene.start
    kind = (scene.description, *system.parameters, *system.plain)
    system = _COMPILED.setdefault(kind, system).with_parameters(**system.parameters)
    base = start.base if system.space.base_size else None
    return replace(scene, system=system, start=system.state(base, start.velocity))


def quietly(system: gni.MechanicalSystem, start: gni.State, **options: Any) -> gni.Trajectory:
    """``integrate`` without the library's warnings, for cases that are about something else."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.GNIWarning)
        return gni.integrate(system, start, **options)


def warned(
    system: gni.MechanicalSystem, start: gni.State, **options: Any
) -> tuple[gni.Trajectory, list[str]]:
    """A run, and the names of the warnings it gave."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = gni.integrate(system, start, **options)
    return run, [type(w.message).__name__ for w in caught]


def refusal(attempt: Callable[[], Any]) -> str:
    """The message of the InputError that an attempt gives; empty if it gives none."""
    try:
        attempt()
    except gni.InputError as error:
        return str(error)
    return ""


def energy_error(run: gni.Trajectory) -> float:
    """Largest change of the energy relative to its size at the start."""
    return change(run.energy())


def change(values: Any) -> float:
    """Largest change since the first value, relative to its size."""
    return float(np.max(np.abs(values - values[0])) / np.abs(values[0]))


def violation(run: gni.Trajectory) -> float:
    """Largest relative constraint residual."""
    return float(np.max(np.abs(run.constraint_residuals(relative=True))))


def distance(run: gni.Trajectory, base: Any, velocities: Any) -> float:
    """Largest difference of base points and velocities from given ones, at all nodes."""
    parts = (run.base - base, run.velocities - velocities)
    return max(float(np.max(np.abs(part), initial=0.0)) for part in parts)


def orders(errors: Iterable[float], ratio: float = 2.0) -> list[float]:
    """Observed orders between consecutive errors, the step divided by ``ratio`` each time."""
    sizes = np.asarray(list(errors))
    return list(np.log(sizes[:-1] / sizes[1:]) / np.log(ratio))


def numbers(values: Iterable[float], form: str = ".1e") -> str:
    """Numbers side by side."""
    return ", ".join(format(float(value), form) for value in values)
