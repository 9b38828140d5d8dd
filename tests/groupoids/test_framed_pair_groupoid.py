"""Pairs of group elements in body and space frames."""

from __future__ import annotations

import numpy as np
import pytest

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, FramedPairGroupoid, PairGroupoid, VectorGroup


@pytest.mark.parametrize("side", ["left", "right"])
def test_frames(side: str) -> None:
    group = SO3(side=side)
    space = FramedPairGroupoid(VectorGroup(2), group)
    rotation = group.exp(np.array([0.3, 1.0, -0.7]))
    x = np.concatenate([[1.5, -0.5], rotation.ravel()])
    xi = np.array([0.1, 0.2, 0.3, -0.4, 0.5])
    place, turned = space.split(space.target(space.retract(x, xi)))
    np.testing.assert_allclose(place, [1.6, -0.3], atol=1e-15)
    step = group.cay(xi[2:])
    expected = rotation @ step if side == "left" else step @ rotation
    np.testing.assert_allclose(turned, expected, atol=1e-15)
    moved = (space.anchor(x) @ xi)[2:].reshape(3, 3)
    velocity = group.hat(xi[2:])
    expected = rotation @ velocity if side == "left" else velocity @ rotation
    np.testing.assert_allclose(moved, expected, atol=1e-15)


def test_refused_groups() -> None:
    with pytest.raises(InputError, match="got PairGroupoid"):
        FramedPairGroupoid(PairGroupoid(2))
    with pytest.raises(InputError, match="at least one"):
        FramedPairGroupoid()
