"""Every operation of the emitter, against CasADi's evaluator and NumPy."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from groupoid_gni.codegen import MachineCode, field_ir, machine_has_fused_products
from groupoid_gni.codegen.emitter import double_text
from groupoid_gni.expressions import record

SPECIAL = np.array([0.0, -0.0, 1.0, -2.5, np.inf, -np.inf, np.nan, 5e-324])
ORDINARY = np.random.default_rng(8).uniform(-4, 4, 40)
FIRST = np.concatenate([np.repeat(SPECIAL, len(SPECIAL)), ORDINARY])
SECOND = np.concatenate([np.tile(SPECIAL, len(SPECIAL)), np.roll(ORDINARY, 17)])
SIZE = len(FIRST)

# name -> (expression of two SX, the same in NumPy or math)
OPERATIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "add": (lambda a, b: a + b, np.add),
    "subtract": (lambda a, b: a - b, np.subtract),
    "multiply": (lambda a, b: a * b, np.multiply),
    "divide": (lambda a, b: a / b, np.divide),
    "negative": (lambda a, b: -a, lambda a, b: -a),
    "square": (lambda a, b: a * a, lambda a, b: a * a),
    "twice": (lambda a, b: 2 * a, lambda a, b: 2 * a),
    "reciprocal": (lambda a, b: 1 / a, lambda a, b: 1 / a),
    "sqrt": (lambda a, b: ca.sqrt(a), lambda a, b: np.sqrt(a)),
    "fabs": (lambda a, b: ca.fabs(a), lambda a, b: np.abs(a)),
    "floor": (lambda a, b: ca.floor(a), lambda a, b: np.floor(a)),
    "ceil": (lambda a, b: ca.ceil(a), lambda a, b: np.ceil(a)),
    "copysign": (ca.copysign, np.copysign),
    "fmin": (ca.fmin, np.fmin),
    "fmax": (ca.fmax, np.fmax),
    "sign": (lambda a, b: ca.sign(a), lambda a, b: np.sign(a)),
    "less": (lambda a, b: a < b, lambda a, b: (a < b) * 1.0),
    "less or equal": (lambda a, b: a <= b, lambda a, b: (a <= b) * 1.0),
    "equal": (lambda a, b: a == b, lambda a, b: (a == b) * 1.0),
    "not equal": (lambda a, b: a != b, lambda a, b: (a != b) * 1.0),
    "not": (lambda a, b: ca.logic_not(a), lambda a, b: (a == 0) * 1.0),
    "and": (ca.logic_and, lambda a, b: ((a != 0) & (b != 0)) * 1.0),
    "or": (ca.logic_or, lambda a, b: ((a != 0) | (b != 0)) * 1.0),
    "if_else": (lambda a, b: ca.if_else(a > 0.5, b, 7.5), lambda a, b: np.where(a > 0.5, b, 7.5)),
    "flag as number": (lambda a, b: (a < b) + 1.0, lambda a, b: (a < b) + 1.0),
    "fmod": (ca.fmod, np.fmod),
}
LIBRARY: dict[str, tuple[Callable[..., Any], Callable[..., float]]] = {
    "tan": (lambda a, b: ca.tan(a), lambda a, b: math.tan(a)),
    "asin": (lambda a, b: ca.asin(a), lambda a, b: math.asin(a)),
    "acos": (lambda a, b: ca.acos(a), lambda a, b: math.acos(a)),
    "atan": (lambda a, b: ca.atan(a), lambda a, b: math.atan(a)),
    "exp": (lambda a, b: ca.exp(a), lambda a, b: math.exp(a)),
    "log": (lambda a, b: ca.log(a), lambda a, b: math.log(a)),
    "sinh": (lambda a, b: ca.sinh(a), lambda a, b: math.sinh(a)),
    "cosh": (lambda a, b: ca.cosh(a), lambda a, b: math.cosh(a)),
    "tanh": (lambda a, b: ca.tanh(a), lambda a, b: math.tanh(a)),
    "asinh": (lambda a, b: ca.asinh(a), lambda a, b: math.asinh(a)),
    "acosh": (lambda a, b: ca.acosh(a), lambda a, b: math.acosh(a)),
    "atanh": (lambda a, b: ca.atanh(a), lambda a, b: math.atanh(a)),
    "expm1": (lambda a, b: ca.expm1(a), lambda a, b: math.expm1(a)),
    "log1p": (lambda a, b: ca.log1p(a), lambda a, b: math.log1p(a)),
    "erf": (lambda a, b: ca.erf(a), lambda a, b: math.erf(a)),
    "atan2": (ca.atan2, math.atan2),
    "pow": (lambda a, b: a**b, math.pow),
    "constant power": (lambda a, b: a**2.7, lambda a, b: math.pow(a, 2.7)),
    "remainder": (ca.remainder, math.remainder),
    "hypot": (ca.hypot, math.hypot),
}


def run(expression: Callable[..., Any], lanes: int = 1, fused: bool = True) -> Any:
    """The operation on FIRST, SECOND in machine code, every lane with the same numbers."""
    a, b = ca.SX.sym("a", SIZE), ca.SX.sym("b", SIZE)
    function = ca.Function("f", [a, b], [ca.densify(expression(a, b))])
    fused = fused and machine_has_fused_products()
    code = MachineCode(field_ir(function, lanes, fused))
    given = [np.repeat(v[:, None], lanes, axis=1) for v in (FIRST, SECOND)]
    output = np.empty((SIZE, lanes))
    evaluate = code.function("evaluate", *[ctypes.c_void_p] * 3)
    evaluate(*(v.ctypes.data for v in given), output.ctypes.data)
    for lane in range(1, lanes):
        np.testing.assert_array_equal(output[:, lane], output[:, 0])
    return output[:, 0], np.array(function(FIRST, SECOND)).ravel()


def same_bits(found: Any, expected: Any) -> None:
    """Equal with the sign of zeros; any NaN equals any other."""
    np.testing.assert_array_equal(found, expected)
    numbers = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(found[numbers]), np.signbit(expected[numbers]))


@pytest.mark.parametrize(
    ("name", "lanes"),
    [*((name, 1) for name in OPERATIONS), *((name, 4) for name in OPERATIONS if name != "fmod")],
)
def test_exact_operations_have_the_bits_of_numpy_and_casadi(name: str, lanes: int) -> None:
    expression, plain = OPERATIONS[name]
    found, by_casadi = run(expression, lanes)
    with np.errstate(all="ignore"):
        expected = plain(FIRST, SECOND)
    # Of zeros of both signs, IEEE 754 leaves open which one fmin gives; CasADi's if_else is a sum
    # of two terms, and its sign of -0 is -0.
    if name in ("fmin", "fmax", "if_else", "sign"):
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(found, by_casadi)
        return
    same_bits(found, expected)
    np.testing.assert_array_equal(found, by_casadi)


def _or_nan(function: Callable[..., float], *arguments: float) -> float:
    """The C function, whose errors Python turns into exceptions."""
    try:
        return function(*arguments)
    except (ValueError, OverflowError):
        return math.inf


@pytest.mark.parametrize(
    ("name", "lanes"), [*((name, 1) for name in LIBRARY), ("tan", 4), ("atan2", 8)]
)
def test_library_functions_have_the_bits_of_the_c_library(name: str, lanes: int) -> None:
    expression, plain = LIBRARY[name]
    found, by_casadi = run(expression, lanes)
    same_bits(found, by_casadi)
    python = np.array([_or_nan(plain, *pair) for pair in zip(FIRST, SECOND, strict=True)])
    comparable = np.isfinite(python)
    np.testing.assert_array_equal(found[comparable], python[comparable])


@pytest.mark.parametrize("name", ["fmod", "remainder", "mod", "floor_divide"])
def test_recorded_remainders_have_the_signs_of_numpy(name: str) -> None:
    function = getattr(np, name)
    values = np.array([-7.5, -3.0, -0.5, 0.0, 0.5, 3.0, 7.5])
    x, y = (v.ravel() for v in np.meshgrid(values, values[values != 0]))
    recorded = record(
        lambda a, b: function(a, b), {"a": x.shape, "b": x.shape}, x.shape, name=name
    )
    code = MachineCode(field_ir(recorded.function, 1, machine_has_fused_products()))
    output = np.empty(len(x))
    evaluate = code.function("evaluate", *[ctypes.c_void_p] * 3)
    evaluate(x.ctypes.data, y.ctypes.data, output.ctypes.data)
    np.testing.assert_array_equal(output, function(x, y))


def test_an_unknown_operation_is_refused_with_the_way_out() -> None:
    with pytest.raises(NotImplementedError, match="compile=False"):
        run(lambda a, b: ca.erfinv(a))


def test_nested_logic_keeps_flags_and_numbers_apart() -> None:
    def expression(a: Any, b: Any) -> Any:
        flag = ca.logic_and(a < b, ca.logic_not(ca.logic_or(a > 2, b < -2)))
        return ca.if_else(flag, a, b) + 3 * flag + ca.if_else(a, 0.5, -0.25)

    found, by_casadi = run(expression)
    flag = (FIRST < SECOND) & ~((FIRST > 2) | (SECOND < -2))
    expected = np.where(flag, FIRST, SECOND) + 3 * flag + np.where(FIRST != 0, 0.5, -0.25)
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    np.testing.assert_allclose(found, by_casadi, rtol=1e-15)


def test_a_constant_output_is_a_constant() -> None:
    found, _ = run(lambda a, b: ca.SX(np.full(SIZE, -0.1)))
    np.testing.assert_array_equal(found, -0.1)


@pytest.mark.parametrize("value", [0.1, -0.0, np.inf, np.nan, 5e-324, 1.7976931348623157e308])
def test_literals_hold_every_bit(value: float) -> None:
    bits = int(double_text(value), 16)
    again = np.array([bits], dtype=np.uint64).view(np.float64)[0]
    assert np.array([again]).tobytes() == np.array([value]).tobytes()
