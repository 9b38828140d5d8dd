"""A user's own retraction: only tau and its inverse are written, the rest is derived."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from groupoid_gni.groupoids import SE3, SO3, DerivedGroupoid, LieGroup, Retraction
from groupoid_gni.groupoids.retractions import CAYLEY_REACH


@dataclass(frozen=True)
class ThirdOrder(Retraction):
    """cay of a vector stretched by 1 + |xi|^2/10, an odd reparametrisation."""

    def tau(self, group: LieGroup, xi: Any) -> Any:
        return group.cay(xi * (1 + (xi * xi).sum(axis=-1, keepdims=True) / 10))

    def inverse(self, group: LieGroup, element: Any) -> Any:
        y = group.cay_inverse(element)
        size = (y * y).sum(axis=-1, keepdims=True)
        stretch = 1 + 0 * size
        for _ in range(8):  # Newton for u + |y|^2 u^3 / 10 = 1, xi = u y
            cube = size * stretch**3 / 10
            slope = 1 + 3 * size * stretch**2 / 10
            stretch = stretch - (stretch + cube - 1) / slope
        return y * stretch


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("make", [SO3, SE3])
def test_a_third_retraction(make: Any, side: str) -> None:
    group = make(side=side, retraction=ThirdOrder())
    xi = 0.25 * np.random.default_rng(6).normal(size=group.dimension)
    x = group.example_base_point
    np.testing.assert_allclose(group.tau_inverse(group.tau(xi)), xi, atol=1e-15)
    one = group.dtau(xi) @ group.dtau_inverse(xi)
    np.testing.assert_allclose(one, np.eye(group.dimension), atol=1e-14)
    half = group.tau(group.half_vector(xi))
    np.testing.assert_allclose(half @ half, group.tau(xi), atol=1e-14)
    assert group.reach(x, xi) == 0.0
    derived = DerivedGroupoid(group)
    for name in ("trivialised_tangent_plus", "trivialised_tangent_minus", "half"):
        ours, theirs = getattr(group, name)(x, xi), getattr(derived, name)(x, xi)
        np.testing.assert_allclose(ours, theirs, atol=1e-14)


def test_cayley_reach_is_the_root() -> None:
    assert abs(CAYLEY_REACH * (1 + CAYLEY_REACH**2 / 4) - np.pi) < 1e-14
    assert f"{CAYLEY_REACH:.4f}" == "1.7656"
