"""SO(2): angles, half turns and the Cayley angle."""

from __future__ import annotations

import numpy as np

from groupoid_gni.groupoids import SO2


def test_angles() -> None:
    group = SO2()
    for angle in (-np.pi + 1e-12, -1.0, 0.0, 1e-9, 3.0, np.pi - 1e-14):
        rotation = group.exp(np.array([angle]))
        expected = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        np.testing.assert_array_equal(rotation, expected)
        np.testing.assert_allclose(group.log(rotation), [angle], rtol=1e-15)
    rotation = group.cay(np.array([0.8]))
    np.testing.assert_allclose(group.log(rotation), [2 * np.arctan(0.4)], rtol=1e-15)
