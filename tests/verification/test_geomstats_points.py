"""Random points of geomstats as samples, and as a test of our groups made from its spaces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni.geomstats_bridge import geomstats_module
from groupoid_gni.verification import check_groupoid, check_retraction, geomstats_points


def spaces() -> dict[str, Any]:
    rotations = geomstats_module("geomstats.geometry.special_orthogonal").SpecialOrthogonal
    motions = geomstats_module("geomstats.geometry.special_euclidean").SpecialEuclidean
    return {"SO4": rotations(n=4), "SE3": motions(n=3)}


@pytest.fixture(scope="module", params=["SO4", "SE3"])
def space(request: pytest.FixtureRequest) -> Any:
    return spaces()[request.param]


def test_points_belong_and_compose_as_geomstats_says(space: Any) -> None:
    group = gni.LieGroup.from_geomstats(space)

    @settings(suppress_health_check=list(HealthCheck))
    @given(geomstats_points(space), geomstats_points(space))
    def agree(a: Any, b: Any) -> None:
        assert space.belongs(a)
        first, second = group.flatten(a), group.flatten(b)
        ours = group.unflatten(group.multiply(first, second))
        np.testing.assert_allclose(ours, space.compose(a, b), atol=1e-13)
        inverse = group.unflatten(group.inverse(first))
        np.testing.assert_allclose(inverse, space.inverse(a), atol=1e-12)
        np.testing.assert_allclose(group.Ad(a) @ group.Ad(b), group.Ad(a @ b), atol=1e-11)

    agree()


def test_the_global_random_state_is_put_back(space: Any) -> None:
    @given(st.data())
    def draw(data: Any) -> None:
        before = np.random.get_state()[1].tolist()  # noqa: NPY002
        data.draw(geomstats_points(space))
        assert np.random.get_state()[1].tolist() == before  # noqa: NPY002

    draw()


@pytest.mark.parametrize("side", ["left", "right"])
def test_groups_from_geomstats_obey_all_laws(
    space: Any, side: Any, search_seed: int | None
) -> None:
    group = gni.LieGroup.from_geomstats(space, side=side)
    for check in (check_groupoid, check_retraction):
        report = check(group, seed=search_seed)
        assert report.evaluations > 100
