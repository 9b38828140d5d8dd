"""SO(3) near half turns, against SciPy's Rotation, and the formulas printed in the appendix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from groupoid_gni.expressions import record
from groupoid_gni.groupoids import SO3

axes = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 1e-3)
angles = st.sampled_from(
    [0.0, 1e-12, 1e-8, 0.3, 1.0, 2.0, 2.9, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12]
)
ROTATIONS = SO3()


@settings(max_examples=200, deadline=None)
@given(axis=axes, angle=angles)
def test_log_near_a_half_turn(axis: Any, angle: float) -> None:
    w = np.array(axis) / np.linalg.norm(axis) * angle
    rotation = Rotation.from_rotvec(w).as_matrix()
    np.testing.assert_allclose(ROTATIONS.exp(w), rotation, atol=2e-15)
    ours = ROTATIONS.log(rotation)
    # Next to pi the vector and its opposite are one rotation up to round-off.
    error = min(np.abs(ours - w).max(), np.abs(ours + w).max() if np.pi - angle < 1e-9 else 9.0)
    assert error < 5e-15
    np.testing.assert_allclose(np.linalg.norm(ours), angle, atol=5e-15)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, -0.8), (0, 0.6, 0.8)])
def test_exact_half_turns(axis: Any) -> None:
    axis = np.array(axis, dtype=float)
    rotation = 2 * np.outer(axis, axis) - np.eye(3)
    ours = ROTATIONS.log(rotation)
    np.testing.assert_allclose(np.linalg.norm(ours), np.pi, atol=1e-14)
    np.testing.assert_allclose(ROTATIONS.exp(ours), rotation, atol=1e-14)


def test_derivative_of_log_is_finite_everywhere() -> None:
    function = record(
        lambda g: ROTATIONS.log(g.reshape(3, 3)), {"g": (9,)}, (3,), name="log"
    ).derivative(0)
    for w in ([0, 0, 0], [0, 1e-9, 0], [0.1, 0.2, 0.3], [3.1415, 0, 0], [0, 0, np.pi - 1e-12]):
        rotation = ROTATIONS.exp(np.array(w, dtype=float))
        slope = function(rotation.ravel())
        assert np.all(np.isfinite(slope))
        moved = (slope @ ROTATIONS.translated_basis(rotation)).round(9)
        np.testing.assert_allclose(moved, ROTATIONS.dexp_inverse(-np.array(w)), atol=1e-8)


def test_printed_formulas() -> None:
    w, y = np.array([0.7, -0.4, 1.1]), np.array([0.2, 0.5, -0.3])
    hat, one = ROTATIONS.hat(w), np.eye(3)
    np.testing.assert_allclose(hat @ y, np.cross(w, y), atol=1e-16)
    cay = one + 4 / (4 + w @ w) * (hat + hat @ hat / 2)
    np.testing.assert_allclose(ROTATIONS.cay(w), cay, atol=1e-15)
    dcay = 2 / (4 + w @ w) * (2 * one + hat)
    np.testing.assert_allclose(ROTATIONS.dcay(w), dcay, atol=1e-15)
    np.testing.assert_allclose(
        ROTATIONS.dcay_inverse(w), one - hat / 2 + np.outer(w, w) / 4, atol=1e-15
    )


def test_reflections_and_stretched_matrices_are_defects() -> None:
    assert ROTATIONS.element_defect(np.diag([1.0, 1.0, -1.0])) == 2.0
    stretched = ROTATIONS.exp(np.array([0.3, 0.1, 0.2])) * (1 + 1e-6)
    assert ROTATIONS.element_defect(stretched) > 1e-6
    assert ROTATIONS.element_defect(ROTATIONS.restore_element(stretched)) < 1e-11
