"""Products: block structure, poses, refused factors."""

from __future__ import annotations

import numpy as np
import pytest

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SE2, SO3, FramedPairGroupoid, PairGroupoid, ProductGroupoid


def test_blocks() -> None:
    turning, sliding = SO3(side="right"), SE2()
    space = ProductGroupoid(turning, PairGroupoid(1), sliding)
    assert (space.rank, space.base_size, space.arrow_size) == (7, 1, 9 + 2 + 9)
    xi = np.array([0.1, 0.2, 0.3, 1.0, 0.4, 0.5, 0.6])
    plus = space.trivialised_tangent_plus(np.zeros(1), xi)
    point = np.zeros(0)
    np.testing.assert_array_equal(plus[:3, :3], turning.trivialised_tangent_plus(point, xi[:3]))
    np.testing.assert_array_equal(plus[4:, 4:], sliding.trivialised_tangent_plus(point, xi[4:]))
    assert plus[3, 3] == 1.0
    assert not plus[:3, 3:].any()
    structure = space.bracket(np.zeros(1))
    np.testing.assert_array_equal(structure[:3, :3, :3], turning.bracket(point))
    assert not structure[:, :3, 3:].any()
    arrow = space.retract(np.zeros(1), xi)
    np.testing.assert_array_equal(space.pose(arrow), arrow)  # two groups: no single pose


def test_split_goes_into_the_factors() -> None:
    space = ProductGroupoid(PairGroupoid(2), FramedPairGroupoid(SO3()), SE2())
    first, second = space.split(space.example_base_point)
    assert first.shape == (2,)
    np.testing.assert_array_equal(second, np.eye(3))


def test_refused_factors() -> None:
    with pytest.raises(InputError, match="got int"):
        ProductGroupoid(PairGroupoid(1), 3)
    with pytest.raises(InputError, match="at least one"):
        ProductGroupoid()
