"""Our groups against geomstats: product, inverse, exponential, logarithm, adjoint, structure."""

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.geomstats_bridge import geomstats_module


@pytest.fixture(scope="module")
def spaces():
    orthogonal = geomstats_module("geomstats.geometry.special_orthogonal").SpecialOrthogonal
    euclidean = geomstats_module("geomstats.geometry.special_euclidean").SpecialEuclidean
    return {
        "SO2": orthogonal(n=2),
        "SO3": orthogonal(n=3),
        "SE2": euclidean(n=2),
        "SE3": euclidean(n=3),
    }


GROUPS = {"SO2": gni.SO2, "SO3": gni.SO3, "SE2": gni.SE2, "SE3": gni.SE3}


@pytest.fixture(params=sorted(GROUPS))
def pair(request, spaces):
    return GROUPS[request.param](retraction=gni.Exponential()), spaces[request.param]


def vectors(group, count=20, size=0.9):
    rng = np.random.default_rng(7 * group.dimension)
    return size * rng.uniform(-1.0, 1.0, (count, group.dimension))


def test_the_product_and_the_inverse_are_those_of_geomstats(pair):
    group, space = pair
    a, b = group.exp(vectors(group)), group.exp(vectors(group)[::-1] * 1.7)
    assert np.allclose(group.compose(a, b), space.compose(a, b), rtol=0, atol=1e-14)
    assert np.allclose(group.inverse_element(a), space.inverse(a), rtol=0, atol=1e-14)


def test_the_exponential_is_that_of_geomstats(pair):
    group, space = pair
    xi = vectors(group)
    assert np.allclose(group.exp(xi), space.exp(group.hat(xi)), rtol=0, atol=1e-13)


def test_the_logarithm_is_that_of_geomstats(pair):
    group, space = pair
    elements = group.exp(vectors(group, count=3))
    theirs = np.array([space.log(element) for element in elements])
    assert np.allclose(group.hat(group.log(elements)), theirs, rtol=0, atol=1e-9)


def test_the_bracket_is_the_commutator_of_geomstats(pair):
    group, space = pair
    xi, eta = vectors(group), vectors(group)[::-1]
    theirs = space.lie_algebra.bracket(group.hat(xi), group.hat(eta))
    ours = group.hat(np.einsum("cab,na,nb->nc", group.bracket(np.zeros(0)), xi, eta))
    assert np.allclose(ours, theirs, rtol=0, atol=1e-14)


def test_our_elements_belong_to_their_groups_with_both_retractions(pair):
    group, space = pair
    for elements in (group.exp(vectors(group)), group.cay(vectors(group))):
        assert np.all(space.belongs(elements, atol=1e-12))
