"""SE(2): screw motion on a circle, products of motions, large angles."""

from __future__ import annotations

import numpy as np
import pytest

from groupoid_gni.groupoids import SE2, Exponential


def test_a_quarter_circle() -> None:
    group = SE2(retraction=Exponential())
    element = group.exp(np.array([np.pi / 2, np.pi / 2, 0.0]))  # unit speed on the unit circle
    np.testing.assert_allclose(element[:2, 2], [1.0, 1.0], atol=1e-15)
    np.testing.assert_array_equal(element[2], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, -2.0, 3.1, np.pi - 1e-10])
def test_log_up_to_a_half_turn(angle: float) -> None:
    group, xi = SE2(), np.array([angle, 0.4, -1.3])
    np.testing.assert_allclose(group.log(group.exp(xi)), xi, atol=1e-14)


def test_bracket_formula() -> None:
    group, (w, x, y), (a, u, v) = SE2(), (0.3, -0.5, 0.7), (1.1, 0.2, -0.4)
    bracket = group.ad(np.array([w, x, y])) @ np.array([a, u, v])
    np.testing.assert_allclose(bracket, [0.0, -w * v + a * y, w * u - a * x], atol=1e-16)
