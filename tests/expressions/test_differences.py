"""The chain rule of differences: exact, symmetric, a gradient on the diagonal, everywhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from groupoid_gni.expressions import discrete_gradient, has_exact_differences
from groupoid_gni.expressions.differences import _BINARY, _INEXACT, _UNARY

A, B = np.array([0.31, 0.74]), np.array([0.83, 0.22])

# operation -> an expression of it whose domain holds both ends; the weight is another input
UNARY: dict[int, Callable[[Any], Any]] = {
    ca.OP_NEG: lambda x: -x,
    ca.OP_TWICE: lambda x: x + x,
    ca.OP_SQ: lambda x: x * x,
    ca.OP_INV: lambda x: ca.sin(1 / x),  # w (1 / x) would be written w / x
    ca.OP_SQRT: ca.sqrt,
    ca.OP_SIN: ca.sin,
    ca.OP_COS: ca.cos,
    ca.OP_TAN: ca.tan,
    ca.OP_EXP: ca.exp,
    ca.OP_LOG: ca.log,
    ca.OP_SINH: ca.sinh,
    ca.OP_COSH: ca.cosh,
    ca.OP_TANH: ca.tanh,
    ca.OP_ATAN: ca.atan,
    ca.OP_FABS: ca.fabs,
}
BINARY: dict[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: lambda x, y: x + y,
    ca.OP_SUB: lambda x, y: x - y,
    ca.OP_MUL: lambda x, y: x * y,
    ca.OP_DIV: lambda x, y: x / y,
    ca.OP_POW: lambda x, y: x**y,
    ca.OP_CONSTPOW: lambda x, y: x**2.7 + y**3 + x**-5,
    ca.OP_ATAN2: ca.atan2,
    ca.OP_HYPOT: ca.hypot,
    ca.OP_FMAX: ca.fmax,
    ca.OP_FMIN: ca.fmin,
}
# no closed form: a quotient, and a series near the diagonal
BY_QUOTIENT: dict[int, Callable[[Any], Any]] = {
    ca.OP_ASIN: ca.asin, ca.OP_ACOS: ca.acos, ca.OP_ERF: ca.erf, ca.OP_ASINH: ca.asinh,
    ca.OP_ATANH: ca.atanh, ca.OP_LOG1P: ca.log1p, ca.OP_EXPM1: ca.expm1,
}


def function(expression: Callable[..., Any]) -> ca.Function:
    """Two numbers and a weight -> a sum in which the operation meets both."""
    x, w = ca.SX.sym("x", 2), ca.SX.sym("w")
    return ca.Function("f", [x, w], [expression(x[0], x[1], w)])


def of_one(operation: Callable[[Any], Any]) -> ca.Function:
    return function(lambda x, y, w: w * operation(x) + operation(y) * x)


def of_two(operation: Callable[[Any, Any], Any]) -> ca.Function:
    return function(lambda x, y, w: operation(x, y) + w * operation(y, x) * y)


def codes(f: ca.Function) -> set[int]:
    return {f.instruction_id(k) for k in range(f.n_instructions())}


OPERATIONS = {
    **{code: of_one(operation) for code, operation in UNARY.items()},
    **{code: of_two(operation) for code, operation in BINARY.items()},
    **{code: of_one(operation) for code, operation in BY_QUOTIENT.items()},
}
WEIGHT = 1.3


def row(f: ca.Function, a: Any, b: Any) -> Any:
    start, end, w = ca.SX.sym("a", 2), ca.SX.sym("b", 2), ca.SX.sym("w")
    s = discrete_gradient(f, start, end, w)
    return np.array(ca.Function("s", [start, end, w], [s])(a, b, WEIGHT)).ravel()


def gradient(f: ca.Function, x: Any) -> Any:
    point, w = ca.SX.sym("x", 2), ca.SX.sym("w")
    slope = ca.gradient(f(point, w), point)
    return np.array(ca.Function("g", [point, w], [slope])(x, WEIGHT)).ravel()


def difference(f: ca.Function, a: Any, b: Any) -> float:
    return float(f(b, WEIGHT)) - float(f(a, WEIGHT))


def test_every_operation_of_the_table_is_here() -> None:
    # an assignment is never written, and flags have a test of their own
    assert set(_UNARY) - {ca.OP_ASSIGN} == set(UNARY)
    assert set(_BINARY) - {ca.OP_IF_ELSE_ZERO} == set(BINARY)
    for code, f in OPERATIONS.items():
        assert code in codes(f)


@pytest.mark.parametrize("code", OPERATIONS)
def test_the_difference_is_exact_and_the_row_symmetric(code: int) -> None:
    f = OPERATIONS[code]
    for a, b in [(A, B), (A, A + np.array([0.2, 0.0])), (B, B + 1e-3)]:
        s = row(f, a, b)
        size = np.abs(s) @ np.abs(b - a) + abs(float(f(a, WEIGHT))) + abs(float(f(b, WEIGHT)))
        assert abs(s @ (b - a) - difference(f, a, b)) < 4e-16 * size + 1e-16
        np.testing.assert_allclose(row(f, b, a), s, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("code", OPERATIONS)
def test_where_the_ends_meet_it_is_the_gradient(code: int) -> None:
    f = OPERATIONS[code]
    if code in (ca.OP_FMAX, ca.OP_FMIN):
        assert has_exact_differences(f) is False
    for x in (A, B):
        np.testing.assert_allclose(row(f, x, x), gradient(f, x), rtol=1e-14, atol=1e-15)
        for apart in (1e-15, 1e-12, 1e-9):
            end = x + apart * np.array([1.0, -0.6])
            middle = gradient(f, (x + end) / 2)
            np.testing.assert_allclose(row(f, x, end), middle, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("code", OPERATIONS)
def test_it_is_of_second_order_about_the_middle(code: int) -> None:
    f = OPERATIONS[code]
    turn = np.array([0.6, 0.3])

    def off(apart: float) -> float:
        s = row(f, A - apart * turn, A + apart * turn)
        return float(np.max(np.abs(s - gradient(f, A))))

    assert off(1e-3) < 5e-4 * (1 + np.max(np.abs(gradient(f, A))))


@pytest.mark.parametrize("code", BY_QUOTIENT)
def test_the_quotient_and_the_series_meet(code: int) -> None:
    f = OPERATIONS[code]
    ends = [A + (1 + side) * 1e-4 * (1 + A) for side in (-1e-6, 1e-6)]
    inside, outside = (row(f, A, end) for end in ends)
    np.testing.assert_allclose(inside, outside, rtol=1e-9)


def test_roots_and_angles_through_zero_stay_finite() -> None:
    crossing = function(lambda x, y, w: w * ca.fabs(x) + ca.atan2(y, x) + ca.sin(x * y))
    a, b = np.array([-0.4, 0.3]), np.array([0.7, 0.5])
    s = row(crossing, a, b)
    np.testing.assert_allclose(s @ (b - a), difference(crossing, a, b), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(row(function(lambda x, y, w: ca.fabs(x) + y), 0 * a, 0 * a),
                                  [0.0, 1.0])


def test_branches_are_exact_on_one_side_and_say_that_they_may_jump() -> None:
    joined = function(lambda x, y, w: ca.if_else(x < 0.5, x * y + w, y**3 - x))
    assert not has_exact_differences(joined)
    assert has_exact_differences(function(lambda x, y, w: ca.exp(x) * y + w))
    assert ca.OP_LT in codes(joined) & _INEXACT
    for a, b in [(A, A + np.array([0.1, 0.3])), (B, B + np.array([0.1, -0.7]))]:
        s = row(joined, a, b)
        np.testing.assert_allclose(s @ (b - a), difference(joined, a, b), rtol=0, atol=1e-15)
    s = row(joined, A, B)
    assert abs(s @ (B - A) - difference(joined, A, B)) > 0.01


def test_fmax_is_exact_across_its_edge() -> None:
    for f in (of_two(ca.fmax), of_two(ca.fmin)):
        s = row(f, A, B)  # the larger component changes on the way
        np.testing.assert_allclose(s @ (B - A), difference(f, A, B), rtol=0, atol=1e-15)


def test_other_inputs_and_unused_ones_are_held() -> None:
    f = function(lambda x, y, w: ca.cos(w * x))
    s = row(f, A, B)
    assert s[1] == 0.0
    np.testing.assert_allclose(s[0] * (B - A)[0], difference(f, A, B), rtol=1e-14)


def test_a_quadratic_invariant_keeps_its_symmetry() -> None:
    # f(x^2 + y^2): the row is orthogonal to what turns the mean of the ends
    f = function(lambda x, y, w: ca.exp(-w * (x * x + y * y)))
    s, mean = row(f, A, B), (A + B) / 2
    assert abs(s @ np.array([-mean[1], mean[0]])) < 1e-16
