"""R^n x R^n x G: order of the components, reconstruction on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, AtiyahGroupoid, PairGroupoid


@pytest.mark.parametrize("side", ["left", "right"])
def test_reconstruction(side: str) -> None:
    group = SO3(side=side)
    space = AtiyahGroupoid(base_dim=2, group=group)
    x, xi = np.array([0.1, -0.2]), np.array([0.5, 0.6, 0.1, 0.2, -0.4])
    g = space.retract(x, xi)
    np.testing.assert_allclose(space.target(g), [0.6, 0.4], atol=1e-16)
    step = group.cay(xi[2:])
    np.testing.assert_array_equal(space.pose(g), step)
    before = group.exp(np.array([1.0, 0.3, -0.6]))
    after = space.pose(space.multiply(space.arrow_to(x, before), g))
    expected = before @ step if side == "left" else step @ before
    np.testing.assert_allclose(after, expected, atol=1e-15)


def test_refused_group() -> None:
    with pytest.raises(InputError, match="must be a LieGroup"):
        AtiyahGroupoid(2, PairGroupoid(1))
