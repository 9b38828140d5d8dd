"""Pairs of points of R^n."""

from __future__ import annotations

import numpy as np

from groupoid_gni.groupoids import PairGroupoid


def test_pairs() -> None:
    space = PairGroupoid(2)
    g = space.retract(np.array([1.0, 2.0]), np.array([0.5, -1.0]))
    np.testing.assert_array_equal(g, [1.0, 2.0, 1.5, 1.0])
    np.testing.assert_array_equal(space.inverse(g), [1.5, 1.0, 1.0, 2.0])
    np.testing.assert_array_equal(space.pose(g), [1.5, 1.0])
    np.testing.assert_array_equal(space.arrow_to(np.array([3.0, 4.0]), [3.0, 4.0]), [3, 4, 3, 4])
    assert repr(space) == "PairGroupoid(2)"
