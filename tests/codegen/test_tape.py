"""Rewriting a tape keeps what it computes."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni.codegen.step_kernel import step_function
from groupoid_gni.codegen.tape import (
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SELECT,
    SUBTRACT_PRODUCT,
    Tape,
)
from groupoid_gni.integrators import compiled_step

_PLAIN: dict[int, Any] = {
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_INV: lambda a: 1 / a,
    ca.OP_SQRT: np.sqrt,
    ca.OP_FABS: abs,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_FMAX: np.fmax,
    ca.OP_FMIN: np.fmin,
    ca.OP_LT: lambda a, b: a < b,
    ca.OP_LE: lambda a, b: a <= b,
    ca.OP_EQ: lambda a, b: a == b,
    ca.OP_NE: lambda a, b: a != b,
    ca.OP_NOT: lambda a: not a,
    ca.OP_AND: lambda a, b: bool(a) and bool(b),
    ca.OP_OR: lambda a, b: bool(a) or bool(b),
    ca.OP_IF_ELSE_ZERO: lambda a, b: b if a else 0.0,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_POW: lambda a, b: a**b,
    ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_LOG: np.log,
    ca.OP_EXP: np.exp,
    ca.OP_SIGN: np.sign,
    SELECT: lambda flag, a, b: a if flag else b,
    MULTIPLY_ADD: lambda a, b, c: a * b + c,
    MULTIPLY_SUBTRACT: lambda a, b, c: a * b - c,
    SUBTRACT_PRODUCT: lambda a, b, c: c - a * b,
}


def evaluate(tape: Tape, *inputs: Any) -> list[Any]:
    """A tape, operation by operation, in Python."""
    values: list[Any] = []
    for operation in tape.operations:
        if operation.code == ca.OP_CONST:
            values.append(operation.value)
        elif operation.code == ca.OP_INPUT:
            number, entry = operation.arguments
            values.append(np.float64(inputs[number][entry]))
        else:
            values.append(_PLAIN[operation.code](*(values[k] for k in operation.arguments)))
    return [np.array([float(values[k]) for k in output]) for output in tape.outputs]


CASES = [("pair 3", gni.GNI()), ("SO3 left cay", gni.Rattle()), ("SE3 right exp", gni.GNI()),
         ("framed right cay", gni.Midpoint()), ("action left exp", gni.GNI())]


@pytest.mark.parametrize(("name", "method"), CASES, ids=str)
def test_step_programs_keep_their_values_when_rewritten(name: str, method: Any) -> None:
    a = zoo.animal(name, 2, affine=True)
    program = compiled_step(a.system, method, a.start.active_rows, compile=False).program
    function = step_function(program)
    rng = np.random.default_rng(2)
    inputs = [rng.uniform(0.3, 0.9, function.numel_in(i)) for i in range(function.n_in())]
    expected = [np.array(v).ravel() for v in function(*inputs)]
    tape = Tape.of(function)
    for one, other in zip(evaluate(tape, *inputs), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-12)
    rewritten = tape.optimised()
    for one, other in zip(evaluate(rewritten, *inputs), expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-10)
    codes = {operation.code for operation in rewritten.operations}
    assert codes & {MULTIPLY_ADD, MULTIPLY_SUBTRACT, SUBTRACT_PRODUCT}


@pytest.mark.parametrize(("name", "method"), CASES[:3], ids=str)
def test_levels_of_a_rewritten_tape_are_those_of_its_arguments(name: str, method: Any) -> None:
    a = zoo.animal(name, 2)
    program = compiled_step(a.system, method, a.start.active_rows, compile=False).program
    tape = Tape.of(step_function(program)).optimised()
    for i, operation in enumerate(tape.operations):
        if operation.code in (ca.OP_CONST, ca.OP_INPUT):
            continue
        assert all(k < i for k in operation.arguments)
        assert tape.levels[i] >= max(tape.levels[k] for k in operation.arguments)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_random_expressions_keep_their_values_when_rewritten(data: st.DataObject) -> None:
    a, b = ca.SX.sym("a", 3), ca.SX.sym("b", 3)
    pool = [*ca.vertsplit(a), *ca.vertsplit(b), ca.SX(0.7)]
    for _ in range(data.draw(st.integers(3, 25))):
        one, two = (pool[data.draw(st.integers(0, len(pool) - 1))] for _ in range(2))
        kind = data.draw(st.sampled_from("+-*/s?"))
        fresh = {"+": one + two, "-": one - two, "*": one * two, "/": one / (2 + two * two),
                 "s": one * one - two,
                 "?": ca.if_else(one < two, two * two, one)}[kind]
        pool.append(fresh)
    function = ca.Function("f", [a, b], [ca.densify(ca.vertcat(*pool[-4:]))])
    numbers = [0.31, -0.77, 0.52], [0.9, 0.45, -0.23]
    expected = np.array(function(*numbers)).ravel()
    for tape in (Tape.of(function), Tape.of(function).optimised()):
        (found,) = evaluate(tape, *numbers)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())


def test_a_product_used_twice_is_not_fused() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    product = a * b
    function = ca.Function("f", [a, b], [ca.vertcat(product + a, product - b)])
    codes = [operation.code for operation in Tape.of(function).optimised().operations]
    assert codes.count(ca.OP_MUL) == 1
    assert MULTIPLY_ADD not in codes


def test_a_product_of_an_outer_level_is_not_drawn_into_the_loop() -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b")
    function = ca.Function("f", [a, b], [a[0] * a[1] + b])
    codes = [operation.code for operation in Tape.of(function).optimised().operations]
    assert ca.OP_MUL in codes


def test_a_choice_is_one_operation() -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b")
    chosen = ca.if_else(a[0] < b, a[1], b * b)
    function = ca.Function("f", [a, b], [ca.vertcat(chosen, 1 + chosen)])
    tape = Tape.of(function).optimised()
    codes = [tape.operations[i].code for i in tape.needed([0])]
    assert codes.count(SELECT) == 1
    assert ca.OP_IF_ELSE_ZERO not in codes
    assert ca.OP_NOT not in codes
    for numbers in (([0.3, -0.7], [0.9]), ([1.3, -0.7], [0.9])):
        expected = np.array(function(*numbers)).ravel()
        np.testing.assert_array_equal(evaluate(tape, *numbers)[0], expected)


def test_halves_of_a_choice_that_are_used_apart_stay_apart() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    flag = a < b
    one, other = (
        ca.SX.binary(ca.OP_IF_ELSE_ZERO, condition, value)
        for condition, value in ((flag, a), (ca.logic_not(flag), b))
    )
    function = ca.Function("f", [a, b], [ca.vertcat(one + other, one)])
    tape = Tape.of(function).optimised()
    assert SELECT not in [operation.code for operation in tape.operations]
    np.testing.assert_array_equal(evaluate(tape, [0.4], [0.9])[0], [0.4, 0.4])
