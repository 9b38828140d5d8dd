"""Weights of the warm start: what is linear in time and in the size is reproduced."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.codegen.warm_start import EXTRAPOLATION, extrapolation_weights
from groupoid_gni.discretization.step_program import HISTORY, STAGE_HISTORY

TABLES = {
    f"order {order}, {'bare' if projection is None else 'projected'}":
        gni.GNI(order, projection=projection).fractions
    for order in (2, 4, 6, 8)
    for projection in (gni.SymmetricProjection(), None)
    if (order, projection) != (2, gni.SymmetricProjection())
}


def guessed(
    fractions: tuple[float, ...], stage: int, u: Callable[[float, float], float]
) -> tuple[float, float]:
    """u(time of the middle, size) of a stage, extrapolated from those before it; and the truth."""
    count = len(fractions)
    sizes = np.array([fractions[k % count] for k in range(4 * count + STAGE_HISTORY)])
    middles = np.cumsum(sizes) - sizes / 2
    now = stage + count * (STAGE_HISTORY // count + 1)
    weights = extrapolation_weights(fractions)[stage]
    values = [u(middles[now - 1 - age], sizes[now - 1 - age]) for age in range(STAGE_HISTORY)]
    return float(np.dot(weights, values)), u(middles[now], sizes[now])


def test_a_step_of_one_stage_extrapolates_by_the_binomials() -> None:
    assert extrapolation_weights((1.0,)) == (EXTRAPOLATION,)
    assert EXTRAPOLATION == (5.0, -10.0, 10.0, -5.0, 1.0)
    assert len(EXTRAPOLATION) == HISTORY
    ages = -np.arange(1.0, HISTORY + 1)
    for degree in range(HISTORY):
        shifted = (ages + 3.7) ** degree
        np.testing.assert_allclose(np.dot(EXTRAPOLATION, shifted), 3.7**degree, rtol=1e-11)
    assert abs(np.dot(EXTRAPOLATION, (ages + 3.7) ** HISTORY) - 3.7**HISTORY) > 1.0


@pytest.mark.parametrize("name", TABLES)
def test_weights_reproduce_polynomials(name: str) -> None:
    fractions = TABLES[name]
    weights = extrapolation_weights(fractions)
    assert np.shape(weights) == (len(fractions), STAGE_HISTORY)
    for stage in range(len(fractions)):
        for u in (lambda t, g: 1.7, lambda t, g: 0.3 - 0.8 * t, lambda t, g: 0.6 - 0.9 * g):
            found, truth = guessed(fractions, stage, u)
            np.testing.assert_allclose(found, truth, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", TABLES)
def test_what_belongs_to_another_moment_of_the_stage_is_guessed_to_second_order(name: str) -> None:
    fractions, errors = TABLES[name], []
    for h in (0.02, 0.01):
        def u(t: float, g: float, h: float = h) -> float:
            return float(np.sin(h * (t - g / 4) + 0.4))  # a flight, not its stage

        guesses = [guessed(fractions, stage, u) for stage in range(len(fractions))]
        errors.append(max(abs(found - truth) for found, truth in guesses))
    assert errors[1] < 0.27 * errors[0] or errors[1] < 1e-12


@pytest.mark.parametrize("name", TABLES)
def test_round_off_of_guesses_stays_small(name: str) -> None:
    for weights in extrapolation_weights(TABLES[name]):
        assert np.sum(np.abs(weights)) <= 20.0


def test_a_smooth_motion_is_guessed_better_than_by_the_last_value() -> None:
    fractions, h = gni.GNI(4).fractions, 0.1
    for stage in range(len(fractions)):
        found, truth = guessed(fractions, stage, lambda t, g: np.sin(1.3 * h * t + 0.4))
        assert abs(found - truth) < 1e-5  # the last value is off by 0.05
