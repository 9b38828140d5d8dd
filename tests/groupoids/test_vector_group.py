"""R^n: addition, vectors as elements, no curvature."""

from __future__ import annotations

import numpy as np

from groupoid_gni.groupoids import VectorGroup


def test_addition() -> None:
    group = VectorGroup(2, side="right")
    a, b = np.array([1.0, -2.0]), np.array([0.5, 4.0])
    np.testing.assert_array_equal(group.multiply(a, b), [1.5, 2.0])
    np.testing.assert_array_equal(group.inverse(a), -a)
    np.testing.assert_array_equal(group.identity(np.zeros((3, 0))), np.zeros((3, 2)))
    np.testing.assert_array_equal(group.dtau_inverse(np.zeros((5, 2)))[4], np.eye(2))
    assert group.element_shape == (2,)
    assert not group.structure_constants.any()
    assert repr(group).startswith("VectorGroup(2, side='right'")
