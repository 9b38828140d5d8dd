"""Solves written out as expressions, against numpy.linalg."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groupoid_gni.discretization.elimination import (
    cholesky,
    rows_of,
    solve_linear,
    solve_lower,
    solve_upper,
)


def matrix_near_a_metric(n: int, seed: int, holes: float = 0.0) -> Any:
    """Diagonally dominant, not symmetric, with exact zeros."""
    rng = np.random.default_rng(seed)
    a = rng.uniform(-1, 1, (n, n)) * (rng.random((n, n)) >= holes)
    return a + np.diag(1 + np.abs(a).sum(1))


def symbolic_like(values: Any) -> ca.SX:
    """Symbols where the numbers are not zero, structural zeros elsewhere."""
    return ca.SX.sym("a", ca.Sparsity(ca.sparsify(ca.DM(values)).sparsity()))


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 9),
    k=st.integers(1, 3),
    seed=st.integers(0, 10**6),
    holes=st.sampled_from([0.0, 0.3, 0.8]),
)
def test_solve_linear_is_numpy_solve(n: int, k: int, seed: int, holes: float) -> None:
    a = matrix_near_a_metric(n, seed, holes)
    b = np.random.default_rng(seed + 1).uniform(-2, 2, (n, k))
    symbols, right = symbolic_like(a), ca.SX.sym("b", n, k)
    solve = ca.Function("solve", [symbols, right], [solve_linear(symbols, right)])
    found = np.array(solve(ca.sparsify(ca.DM(a)), b))
    np.testing.assert_allclose(found, np.linalg.solve(a, b), rtol=1e-12, atol=1e-13)


def test_a_missing_pivot_is_refused() -> None:
    hollow = ca.SX.sym("a", 5, 5) * (ca.SX.ones(5, 5) - ca.SX.eye(5))
    with pytest.raises(ZeroDivisionError, match="pivot"):
        solve_linear(ca.sparsify(hollow), ca.SX.ones(5, 1))


@pytest.mark.parametrize("n", [1, 2, 3])
def test_a_structurally_singular_matrix_is_refused(n: int) -> None:
    without_last_row = ca.SX(n, n)
    without_last_row[: n - 1, :] = ca.SX.sym("a", n - 1, n)
    with pytest.raises(ZeroDivisionError, match=r"structural|pivot"):
        solve_linear(without_last_row, ca.SX.ones(n, 1))


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 4), seed=st.integers(0, 10**6), spread=st.integers(0, 8))
def test_badly_scaled_metrics_are_solved_to_their_condition(
    n: int, seed: int, spread: int
) -> None:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.uniform(-spread, spread, n)
    root = rng.uniform(-0.4, 0.4, (n, n))
    well = root @ root.T + np.eye(n)
    a, b = well * np.outer(scale, scale), rng.uniform(-1, 1, n)
    found = np.array(ca.evalf(solve_linear(ca.SX(a), ca.SX(b)))).ravel()
    # row and column scaling are powers; in the scaled unknowns the matrix is well conditioned
    expected = np.linalg.solve(well, b / scale)
    np.testing.assert_allclose(found * scale, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_an_empty_system_has_an_empty_solution() -> None:
    assert solve_linear(ca.SX(0, 0), ca.SX(0, 2)).shape == (0, 2)


def test_a_zero_right_hand_side_costs_nothing() -> None:
    a = ca.SX.sym("a", 4, 4)
    assert solve_linear(a, ca.SX(4, 1)).is_zero()


def test_rows_of_leaves_out_structural_zeros_only() -> None:
    a = ca.SX(2, 2)
    a[0, 1] = ca.SX.sym("s")
    assert [list(row) for row in rows_of(a)] == [[1], []]


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 7), seed=st.integers(0, 10**6))
def test_cholesky_and_its_triangular_solves_are_those_of_numpy(n: int, seed: int) -> None:
    root = np.random.default_rng(seed).uniform(-1, 1, (n, n))
    a, b = root @ root.T + 0.2 * np.eye(n), np.linspace(-1.3, 2.1, n)
    symbols, right = ca.SX.sym("a", n, n), ca.SX.sym("b", n)
    lower, pivots = cholesky(symbols)
    outputs = [lower, ca.vertcat(*pivots), solve_lower(lower, right), solve_upper(lower, right)]
    found = [np.array(v) for v in ca.Function("f", [symbols, right], outputs)(a, b)]
    expected = np.linalg.cholesky(a)
    near = {"rtol": 1e-10, "atol": 1e-11}
    np.testing.assert_allclose(found[0], expected, **near)
    np.testing.assert_allclose(found[1].ravel(), np.diag(expected) ** 2, **near)
    np.testing.assert_allclose(found[2].ravel(), np.linalg.solve(expected, b), **near)
    np.testing.assert_allclose(found[3].ravel(), np.linalg.solve(expected.T, b), **near)
