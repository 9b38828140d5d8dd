"""bundle_metric: what geomstats states, what it computes with, and on which side."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import groupoid_gni as gni
from groupoid_gni.geomstats_bridge import bundle_metric, geomstats_module

SPACES = {
    "SO": "special_orthogonal.SpecialOrthogonal",
    "SE": "special_euclidean.SpecialEuclidean",
    "GL": "general_linear.GeneralLinear",
    "PLT": "positive_lower_triangular_matrices.PositiveLowerTriangularMatrices",
}


def space_of(name: str, n: int, **options: Any) -> Any:
    module, kind = SPACES[name].split(".")
    return getattr(geomstats_module(f"geomstats.geometry.{module}"), kind)(n, **options)


def invariant(space: Any, matrix: Any = None, left: bool = True) -> Any:
    module = geomstats_module("geomstats.geometry.invariant_metric")
    return module.InvariantMetric(space, metric_mat_at_identity=matrix, left=left)


def spd(dimension: int) -> Any:
    root = np.random.default_rng(dimension).normal(size=(dimension, dimension))
    return root @ root.T + np.diag(np.linspace(0.7, 2.3, dimension))


def sizes(dimension: int) -> Any:
    return np.diag(np.linspace(0.6, 2.9, dimension))


# What geomstats 2.8 does. If one of these turns red after an upgrade, the message of
# MetricMismatchError, the docstring of bundle_metric and docs/decisions/0010 are out of date.


@pytest.mark.parametrize(
    ("name", "n", "doubled"),
    [("SO", 3, 3), ("SO", 4, 6), ("SE", 2, 1), ("SE", 3, 3), ("SE", 4, 6), ("GL", 2, 0),
     ("PLT", 3, 0)],
)
def test_what_geomstats_computes_with(name: str, n: int, doubled: int) -> None:
    """Rotations count twice; a matrix that is not diagonal counts as the identity."""
    space = space_of(name, n)
    group = gni.LieGroup.from_geomstats(space)
    turns = np.array([np.abs(matrix + matrix.T).max() == 0.0 for matrix in group.basis])
    assert turns.sum() == doubled
    factors = np.where(turns, 2.0, 1.0)
    given = sizes(group.dimension)
    computed = bundle_metric(invariant(space, given), group, on_mismatch="computed")
    np.testing.assert_allclose(computed, given * factors, rtol=1e-14)
    full = bundle_metric(invariant(space, spd(group.dimension)), group, on_mismatch="computed")
    np.testing.assert_allclose(full, np.diag(factors), rtol=1e-14)


def test_two_metrics_of_geomstats_that_both_mean_one() -> None:
    space = space_of("SO", 3)
    bi_invariant = bundle_metric(space.metric, gni.SO3())
    np.testing.assert_allclose(bi_invariant, np.eye(3), rtol=0, atol=1e-15)
    default = bundle_metric(invariant(space), gni.SO3(), on_mismatch="computed")
    np.testing.assert_allclose(default, 2.0 * np.eye(3), rtol=0, atol=1e-15)


def test_vector_points_forget_the_matrix() -> None:
    metric = invariant(space_of("SO", 3, point_type="vector"), sizes(3))
    assert np.array_equal(metric.metric_mat_at_identity, np.eye(3))
    with pytest.raises(gni.InputError, match=r"shape \(3,\).*point_type='matrix'"):
        bundle_metric(metric, gni.SO3())


# What is accepted.


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_metric_that_keeps_its_word(side: Any) -> None:
    space, given = space_of("GL", 2), sizes(4)
    metric = invariant(space, given, left=side == "left")
    group = gni.LieGroup.from_geomstats(space, side=side)
    np.testing.assert_allclose(bundle_metric(metric, group), given, rtol=0, atol=1e-15)
    change = np.random.default_rng(6).normal(size=(4, 4))
    other = gni.MatrixGroup(np.einsum("ab,bij->aij", change, group.basis), side=side)
    expected = change @ given @ change.T
    np.testing.assert_allclose(bundle_metric(metric, other), expected, rtol=1e-13)


def test_a_subgroup_takes_its_part() -> None:
    """SO(2) in GL(2): the generator is E_10 - E_01."""
    metric = invariant(space_of("GL", 2), np.diag([0.3, 1.7, 2.9, 5.0]))
    np.testing.assert_allclose(bundle_metric(metric, gni.SO2()), [[4.6]], rtol=1e-15)
    with pytest.raises(gni.InputError, match="not a subgroup of the space"):
        bundle_metric(invariant(space_of("SO", 2)), gni.MatrixGroup([np.eye(2)]))


@pytest.mark.parametrize("side", ["left", "right"])
def test_geodesics_of_an_invariant_metric(side: Any) -> None:
    """Through 1: exp(t A^T) exp(t (A - A^T)) on the left, in the other order on the right."""
    space = space_of("GL", 2)
    group = gni.LieGroup.from_geomstats(space, side=side)
    system = gni.MechanicalSystem(
        group, metric=bundle_metric(invariant(space, left=side == "left"), group)
    )
    velocity, t_end = np.array([[0.3, -0.5], [0.7, 0.2]]), 2.0
    factors = expm(t_end * velocity.T), expm(t_end * (velocity - velocity.T))
    exact = factors[0] @ factors[1] if side == "left" else factors[1] @ factors[0]
    start = system.state(velocity=group.vee(velocity))
    errors = [
        np.abs(gni.integrate(system, start, step=h, t_end=t_end).reconstruct()[-1] - exact).max()
        for h in (0.04, 0.02)
    ]
    assert errors[0] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_a_metric_in_coordinates_is_recorded_as_it_is() -> None:
    """No bridge is needed for charts: metric_matrix is a function of the point."""
    ball = geomstats_module("geomstats.geometry.poincare_ball").PoincareBall(2)
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=lambda x, p: p.m * ball.metric.metric_matrix(x),
        parameters={"m": 1.7},
    )
    point, velocity = np.array([0.13, -0.21]), np.array([0.4, 0.3])
    exact = ball.metric.exp(velocity, point)
    start = system.state(base=point, velocity=velocity)
    errors = [
        np.abs(gni.integrate(system, start, step=h, t_end=1.0).base[-1] - exact).max()
        for h in (0.02, 0.01)
    ]
    assert errors[0] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


# What is refused.


@pytest.mark.parametrize("given", [np.diag([1.5, 2.5, 0.7]), spd(3)], ids=["diagonal", "full"])
def test_a_metric_that_breaks_its_word(given: Any) -> None:
    """In the basis of the group: 2 e_1 of geomstats is its second vector."""
    change = np.diag([0.5, 2.0, 3.0])[[1, 0, 2]]
    group = gni.MatrixGroup(np.einsum("ab,bij->aij", change, gni.SO3().basis))
    metric = invariant(space_of("SO", 3), given)
    with pytest.raises(gni.MetricMismatchError) as caught:
        bundle_metric(metric, group)
    used = np.diag(np.diag(given)) if given[0, 1] == 0.0 else np.eye(3)
    stated, computed = change @ given @ change.T, 2.0 * change @ used @ change.T
    np.testing.assert_allclose(caught.value.stated, stated, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(caught.value.computed, computed, rtol=1e-13, atol=1e-14)
    message = str(caught.value)
    shown = message.split("states\n")[1].split("geomstats 2.8")[0].split("but its")
    for block, matrix in zip(shown, (stated, computed), strict=True):
        numbers = np.array(re.findall(r"-?\d+\.\d*", block), dtype=float)
        np.testing.assert_allclose(numbers, matrix.ravel(), rtol=0, atol=1e-6)
    for part in ("not diagonal", "twice", "1884", "on_mismatch='computed'", "metric=np.array(...)"):
        assert part in message
    assert isinstance(caught.value, gni.InputError)


def test_a_small_inertia_beside_a_large_mass_is_looked_at() -> None:
    metric = invariant(space_of("SE", 2), np.diag([3e-7, 4e5, 4e5]))
    with pytest.raises(gni.MetricMismatchError):
        bundle_metric(metric, gni.SE2())


def test_the_side_is_that_of_the_group() -> None:
    space = space_of("SE", 3)
    for left, side in ((True, "right"), (False, "left")):
        group = gni.SE3(side=side)
        other = "left" if left else "right"
        with pytest.raises(gni.InputError, match=f"not {side} invariant.*with side='{other}'"):
            bundle_metric(invariant(space, sizes(6), left), group, on_mismatch="computed")


@pytest.mark.parametrize(("name", "n"), [("GL", 2), ("PLT", 3)])
def test_metrics_that_are_not_invariant(name: str, n: int) -> None:
    """The flat metric of matrices, and that of Cholesky factors."""
    space = space_of(name, n)
    with pytest.raises(gni.InputError, match=r"not right or left.*function of the point"):
        bundle_metric(space.metric, gni.LieGroup.from_geomstats(space))


def product_of(function: Any) -> Any:
    return SimpleNamespace(inner_product=function)


@pytest.mark.parametrize(
    ("metric", "group", "message"),
    [
        (product_of(lambda a, b, x: np.sum(a * b)), gni.VectorGroup(3), "Lie group of matrices"),
        (product_of(lambda a, b, x: np.sum(a * b)), gni.PairGroupoid(3), "Lie group of matrices"),
        (np.eye(3), gni.SO3(), "with inner_product"),
        (SimpleNamespace, gni.SO3(), "with inner_product"),
        (product_of(lambda a, b, x: a[0] @ b[0]), gni.SO3(), "invariant"),
        (product_of(lambda a, b, x: a[0, 1] * b[0, 2]), gni.SO3(), "not symmetric"),
        (product_of(lambda a, b, x: np.nan), gni.SO3(), "finite number"),
        (product_of(lambda a, b, x: a @ b), gni.SO3(), "finite number"),
        (product_of(lambda a, b: 1.0), gni.SO3(), r"inner_product failed on .*\(3, 3\)"),
    ],
)
def test_refused_arguments(metric: Any, group: Any, message: str) -> None:
    with pytest.raises(gni.InputError, match=message):
        bundle_metric(metric, group)


def test_other_refusals() -> None:
    with pytest.raises(gni.InputError, match=r"\(4, 4\), the elements of SO3.*\(3, 3\)"):
        bundle_metric(space_of("SO", 4).metric, gni.SO3())
    with pytest.raises(gni.InputError, match="'raise' or 'computed'"):
        bundle_metric(space_of("SO", 3).metric, gni.SO3(), on_mismatch="stated")
    wrong_size = product_of(lambda a, b, x: np.sum(a * b))
    wrong_size.metric_mat_at_identity = np.eye(4)
    with pytest.raises(gni.InputError, match=r"metric_mat_at_identity has shape \(4, 4\)"):
        bundle_metric(wrong_size, gni.SO3())
