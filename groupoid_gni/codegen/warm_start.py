"""First values of a stage's unknowns, extrapolated from those of the stages before it.

Unknowns are smooth functions of the time t of the middle of their stage and, where stages differ in
size, of that size: a stage is self-adjoint and asks for even powers alone, but its unknowns belong
to its flights, which are halves of it and have other middles. The weights of the remembered values
depend on the composition alone, so they are numbers known before anything is run.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from math import comb

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.discretization.step_program import HISTORY, STAGE_HISTORY

EXTRAPOLATION = tuple((-1.0) ** k * comb(HISTORY, k + 1) for k in range(HISTORY))
"""Steps of one stage: weights of the last, the last but one, ...; the polynomial through all."""

_LARGEST_SUM = 20.0
_DEGREES = (5, 4, 3, 2, 1, 0)
_TRIAL = 0.1
"""The step, in units of the time in which a motion changes, for which stages are compared."""


@cache
def extrapolation_weights(fractions: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Weights (stage, age) for every stage of a composition; one row of ``EXTRAPOLATION`` for one.

    Of all weights that reproduce ``t^a g^b``, a + b <= d, those of least squares, g the fraction
    and t the middle of a stage; and the same for even b alone, which goes to a higher d. Of both,
    and of all d with sum |w| <= 20, those that leave the least of the monomials up to one degree
    beyond. Even powers alone cost orders 6 and 8 a quarter to a third of their iterations more.
    """
    if len(fractions) == 1:
        return (EXTRAPOLATION,)
    return tuple(tuple(_stage_weights(fractions, i)) for i in range(len(fractions)))


@cache
def watched_stage(fractions: tuple[float, ...]) -> int:
    """The stage of a step whose value is foretold best.

    The errors of the others may be a thousand times as large, and jump from stage to stage.
    """
    if len(fractions) == 1:
        return 0
    return int(np.argmin([_defect(fractions, stage) for stage in range(len(fractions))]))


def _defect(fractions: tuple[float, ...], stage: int) -> float:
    """What the weights of a stage leave."""
    times, sizes = _times_and_sizes(fractions, stage)
    return _left(times, sizes, np.array(extrapolation_weights(fractions)[stage]))


def _left(times: FloatArray, sizes: FloatArray, weights: FloatArray) -> float:
    """What weights leave of the monomials ``t^a g^b`` up to one degree beyond."""
    beyond = max(_DEGREES) + 1
    defects = [
        _TRIAL ** (a + b)
        * (times[1:] ** a * sizes[1:] ** b @ weights - times[0] ** a * sizes[0] ** b)
        for b in range(beyond + 1)
        for a in range(beyond + 1 - b)
    ]
    return float(np.linalg.norm(defects))


def _stage_weights(fractions: Sequence[float], stage: int) -> list[float]:
    times, sizes = _times_and_sizes(fractions, stage)
    tried = [np.eye(1, STAGE_HISTORY)[0]]
    for every in (1, 2):
        for degree in _DEGREES:
            weights = _least_weights(times, sizes, degree, every)
            if weights is not None and np.sum(np.abs(weights)) <= _LARGEST_SUM:
                tried.append(weights)
    best = min(tried, key=lambda weights: _left(times, sizes, weights))
    return [float(w) for w in best]


def _times_and_sizes(fractions: Sequence[float], stage: int) -> tuple[FloatArray, FloatArray]:
    """Middles and sizes of a stage and of those before it, the stage itself first."""
    count = len(fractions)
    sizes = np.array([fractions[(stage - age) % count] for age in range(STAGE_HISTORY + 1)])
    # time runs backwards from the middle of the stage asked for
    apart = (sizes[:-1] + sizes[1:]) / 2
    return -np.concatenate([[0.0], np.cumsum(apart)]), sizes


def _least_weights(
    times: FloatArray, sizes: FloatArray, degree: int, every: int
) -> FloatArray | None:
    """Least-squares weights of entries 1, 2, ... that give entry 0 of every monomial, or None.

    every : 1 for all powers of the size, 2 for even ones.
    """
    powers = [(a, b) for b in range(0, degree + 1, every) for a in range(degree - b + 1)]
    scale = np.max(np.abs(times))
    values = np.array([(times / scale) ** a * sizes**b for a, b in powers])
    weights = np.linalg.lstsq(values[:, 1:], values[:, 0], rcond=1e-13)[0]
    defect = np.max(np.abs(values[:, 1:] @ weights - values[:, 0]))
    return weights if defect <= 1e-9 * (1.0 + np.max(np.abs(values[:, 0]))) else None
