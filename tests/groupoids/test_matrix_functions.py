"""The stated domains of the fixed-structure matrix functions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from groupoid_gni.groupoids import SO3
from groupoid_gni.groupoids.matrix_functions import (
    dexp_inverse_of_ad,
    exponential,
    half_tangent,
    logarithm,
)

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
AXIS = np.array([0.48, -0.6, 0.64])


@pytest.mark.parametrize("size", [0.0, 1e-8, 1.0, 6.0, 20.0])
def test_exponential(size: float) -> None:
    np.testing.assert_allclose(exponential(size * TURN), expm(size * TURN), atol=2e-13)


@pytest.mark.parametrize(("size", "iterations"), [(1e-8, 6), (2.0, 6), (15.0, 8)])
def test_half_tangent(size: float, iterations: int) -> None:
    half = half_tangent(size * TURN, iterations)
    np.testing.assert_allclose(half, np.tan(np.arctan(size) / 2) * TURN, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1.0, 3.0])
def test_logarithm(angle: float) -> None:
    np.testing.assert_allclose(logarithm(expm(angle * TURN)), angle * TURN, atol=1e-13)


@pytest.mark.parametrize("angle", [1e-8, 1.0, 3.0, 6.0])
def test_dexp_inverse(angle: float) -> None:
    ours = dexp_inverse_of_ad(SO3().hat(angle * AXIS))
    np.testing.assert_allclose(ours, SO3().dexp_inverse(angle * AXIS), rtol=0, atol=1e-12)
