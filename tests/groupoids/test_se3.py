"""SE(3): the dual-number closed forms at 0 and near pi, and the printed Cayley formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from groupoid_gni.expressions import (
    half_cotangent_defect_derivative,
    half_cotangent_defect_of_square,
)
from groupoid_gni.groupoids import SE3

MOTIONS = SE3()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.9, 3.0, np.pi - 1e-9])
def test_exponential_and_its_tangent(angle: float) -> None:
    axis = np.array([0.48, -0.6, 0.64])
    xi = np.concatenate([angle * axis, [0.3, 1.2, -0.7]])
    np.testing.assert_allclose(MOTIONS.exp(xi), expm(MOTIONS.hat(xi)), atol=5e-15)
    np.testing.assert_allclose(MOTIONS.log(MOTIONS.exp(xi)), xi, atol=2e-14)
    ad, s = MOTIONS.ad(xi), angle * angle
    slope = half_cotangent_defect_derivative(s)
    square = ad @ ad
    by_powers = (
        np.eye(6) - ad / 2 + (half_cotangent_defect_of_square(s) - s * slope) * square
        - slope * square @ square
    )
    np.testing.assert_allclose(MOTIONS.dexp_inverse(xi), by_powers, atol=1e-13)


def test_cayley_formulas() -> None:
    w, v = np.array([0.4, -0.7, 0.5]), np.array([1.1, 0.3, -0.2])
    a, u = np.array([0.2, 0.6, -0.9]), np.array([-0.3, 0.8, 0.1])
    ours = MOTIONS.dcay_inverse(np.concatenate([w, v])) @ np.concatenate([a, u])
    turn = a - np.cross(w, a) / 2 + (w @ a) * w / 4
    shift = u - (np.cross(w, u) + np.cross(v, a)) / 2 - np.cross(w, np.cross(a, v)) / 4
    np.testing.assert_allclose(ours, np.concatenate([turn, shift]), atol=1e-15)
    element = MOTIONS.cay(np.concatenate([w, v]))
    np.testing.assert_allclose(element[:3, 3], (v + element[:3, :3] @ v) / 2, atol=1e-16)
    np.testing.assert_array_equal(element[3], [0.0, 0.0, 0.0, 1.0])
