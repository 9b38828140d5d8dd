"""Discrete gradients from the expression itself: the chain rule of differences.

Every scalar operation satisfies an exact identity between its finite differences, such as
``D(a b) = mean(a) D(b) + mean(b) D(a)`` or ``D(sin a) = cos(mean a) sinc(Da / 2) Da``. Multiplied
out backwards through the graph they give a row s with

    s (b - a) = f(b) - f(a),      s the same for (b, a),      s = grad f where a = b,

without a difference of nearly equal numbers: a symmetric discrete gradient, as accurate as a
gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca

from groupoid_gni.expressions.conversion import from_sx, to_sx
from groupoid_gni.expressions.entire_functions import sinc_of_square

_INEXACT = {
    ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_SIGN,
    ca.OP_FLOOR, ca.OP_CEIL, ca.OP_COPYSIGN, ca.OP_FMOD, ca.OP_REMAINDER,
}  # fmt: skip
_LONGEST_POWER = 12
_NEAR = 1e-4

Slopes = tuple[ca.SX, ...]
Ends = tuple[ca.SX, ca.SX]


def has_exact_differences(function: ca.Function) -> bool:
    """Whether the graph has no operation that may jump or change its branch between two points."""
    codes = {function.instruction_id(k) for k in range(function.n_instructions())}
    return not codes & (_INEXACT | {ca.OP_FMIN, ca.OP_FMAX})


def discrete_gradient(function: ca.Function, start: ca.SX, end: ca.SX, *others: ca.SX) -> ca.SX:
    """The column s with ``s^T (end - start) = f(end, *others) - f(start, *others)``.

    function : scalar SX function whose first input is a dense column.  start, end : columns.
    Where a branch (``where``, ``maximum``) differs between the two points the identity fails by the
    jump of the branches there; see ``has_exact_differences``.
    """
    graph = _Graph(function)
    values = graph.evaluate(start, others), graph.evaluate(end, others)
    return graph.backward(values, start.numel())


class _Graph:
    """The scalar operations of a function in single-assignment form."""

    def __init__(self, function: ca.Function) -> None:
        self.operations: list[tuple[int, tuple[int, ...], float]] = []
        self.result = -1
        slots: dict[int, int] = {}
        for k in range(function.n_instructions()):
            code = function.instruction_id(k)
            if code == ca.OP_OUTPUT:
                self.result = slots[function.instruction_input(k)[0]]
                continue
            (slot,) = function.instruction_output(k)
            constant = 0.0
            if code == ca.OP_CONST:
                arguments: tuple[int, ...] = ()
                constant = function.instruction_constant(k)
            elif code == ca.OP_INPUT:
                arguments = tuple(function.instruction_input(k))
            else:
                arguments = tuple(slots[i] for i in function.instruction_input(k))
            slots[slot] = len(self.operations)
            self.operations.append((code, arguments, constant))

    def evaluate(self, first: ca.SX, others: tuple[ca.SX, ...]) -> list[ca.SX]:
        """The value of every operation."""
        inputs = (first, *others)
        values: list[ca.SX] = []
        for code, arguments, constant in self.operations:
            if code == ca.OP_CONST:
                values.append(ca.SX(constant))
            elif code == ca.OP_INPUT:
                values.append(inputs[arguments[0]][arguments[1]])
            elif code == ca.OP_ASSIGN:
                values.append(values[arguments[0]])
            elif len(arguments) == 1:
                values.append(ca.SX.unary(code, values[arguments[0]]))
            else:
                values.append(ca.SX.binary(code, *[values[i] for i in arguments]))
        return values

    def backward(self, values: tuple[list[ca.SX], list[ca.SX]], size: int) -> ca.SX:
        """Slopes of the result with respect to the first input."""
        weights: dict[int, ca.SX] = {self.result: ca.SX(1)}
        gradient = [ca.SX(0)] * size
        moving = self._moving()
        for i in range(self.result, -1, -1):
            weight = weights.pop(i, None)
            code, arguments, _ = self.operations[i]
            if weight is None or not moving[i]:
                continue
            if code == ca.OP_INPUT:
                gradient[arguments[1]] += weight
                continue
            ends = [(values[0][k], values[1][k]) for k in arguments]
            result = values[0][i], values[1][i]
            for k, slope in zip(arguments, _slopes(code, ends, result), strict=True):
                if moving[k] and not slope.is_zero():
                    weights[k] = weights.get(k, ca.SX(0)) + weight * slope
        return ca.vertcat(*gradient)

    def _moving(self) -> list[bool]:
        """Which operations depend on the first input."""
        moving: list[bool] = []
        for code, arguments, _ in self.operations:
            if code == ca.OP_INPUT:
                moving.append(arguments[0] == 0)
            else:
                moving.append(any(moving[k] for k in arguments))
        return moving


def _mean(ends: Ends) -> ca.SX:
    return (ends[0] + ends[1]) / 2


def _ratio(top: ca.SX, bottom: ca.SX, limit: Any = 1) -> ca.SX:
    """top / bottom, both tending to zero together; the limit where bottom is zero."""
    still = bottom == 0
    return ca.if_else(still, limit, top / ca.if_else(still, 1, bottom))


def _sinc_half(a: Ends) -> ca.SX:
    """``sin(D/2) / (D/2)`` of D = Da, smooth through zero."""
    half = (a[1] - a[0]) / 2
    return to_sx(sinc_of_square(from_sx(half * half, (1,))), (1,))


def _sinhc_half(a: Ends) -> ca.SX:
    half = (a[1] - a[0]) / 2
    return _ratio(ca.sinh(half), half)


def _slopes(code: int, a: list[Ends], result: Ends) -> Slopes:
    """Divided differences of one operation with respect to its arguments."""
    if code in _UNARY:
        return (_UNARY[code](a[0], result),)
    if code in _BINARY:
        return _BINARY[code](a[0], a[1], result)
    if code in _INEXACT:
        return tuple(ca.SX(0) for _ in a)
    if len(a) == 1:
        return (_by_quotient(code, a[0], result),)
    raise NotImplementedError(f"operation {code} of CasADi has no divided difference")


def _by_quotient(code: int, a: Ends, result: Ends) -> ca.SX:
    """The plain quotient; near the diagonal ``f'(m) + f'''(m) D^2 / 24``, equally symmetric."""
    x = ca.SX.sym("x")
    first = ca.jacobian(ca.SX.unary(code, x), x)
    third = ca.jacobian(ca.jacobian(first, x), x)
    middle, apart = _mean(a), a[1] - a[0]
    slope, bend = ca.Function("derivatives", [x], [first, third])(middle)
    near = ca.fabs(apart) <= _NEAR * (1 + ca.fabs(middle))
    quotient = (result[1] - result[0]) / ca.if_else(near, 1, apart)
    return ca.if_else(near, slope + bend * apart**2 / 24, quotient)


def _power(a: Ends, b: Ends, result: Ends) -> Slopes:
    """``a^n`` for a whole constant n by the sum of mixed powers, otherwise ``exp(b log a)``."""
    if b[0].is_constant() and b[1].is_constant():
        exponent = float(b[0])
        if exponent.is_integer() and 0 < abs(exponent) <= _LONGEST_POWER:
            n = int(abs(exponent))
            mixed = sum((a[0] ** k * a[1] ** (n - 1 - k) for k in range(n)), ca.SX(0))
            return (mixed if exponent > 0 else -mixed / (a[0] * a[1]) ** n, ca.SX(0))
    logarithms = ca.log(a[0]), ca.log(a[1])
    exponents = b[0] * logarithms[0], b[1] * logarithms[1]
    rise = _exponential(exponents, result)
    return rise * _mean(b) * _logarithm(a, logarithms), rise * _mean(logarithms)


def _exponential(a: Ends, _: Ends) -> ca.SX:
    return ca.exp(_mean(a)) * _sinhc_half(a)


def _logarithm(a: Ends, _: Ends) -> ca.SX:
    ratio = (a[1] - a[0]) / (a[0] + a[1])
    return 2 * _ratio(ca.atanh(ratio), ratio) / (a[0] + a[1])


def _quotient(a: Ends, b: Ends, result: Ends) -> Slopes:
    return 1 / _mean(b), -_mean(result) / _mean(b)


def _angle(y: Ends, x: Ends, _: Ends) -> Slopes:
    """atan2: the turn from one point of the plane to the other, ``atan2(cross, dot)``."""
    cross = y[1] * x[0] - y[0] * x[1]
    inner = x[0] * x[1] + y[0] * y[1]
    factor = _ratio(ca.atan2(cross, inner), cross, 1 / inner)
    return factor * _mean(x), -factor * _mean(y)


def _hypotenuse(a: Ends, b: Ends, result: Ends) -> Slopes:
    total = result[0] + result[1]
    return (a[0] + a[1]) / total, (b[0] + b[1]) / total


def _extreme(sign: int) -> Callable[[Ends, Ends, Ends], Slopes]:
    """``max(a, b) = (a + b + |a - b|) / 2`` and ``min`` with the other sign."""

    def slopes(a: Ends, b: Ends, _: Ends) -> Slopes:
        apart = a[0] - b[0], a[1] - b[1]
        tilt = sign * _size(apart, apart) / 2
        return 0.5 + tilt, 0.5 - tilt

    return slopes


def _size(a: Ends, _: Ends) -> ca.SX:
    total = ca.fabs(a[0]) + ca.fabs(a[1])
    return _ratio(a[0] + a[1], total, 0)


def _tangent(a: Ends, _: Ends) -> ca.SX:
    apart = a[1] - a[0]
    return _ratio(ca.sin(apart), apart) / (ca.cos(a[0]) * ca.cos(a[1]))


def _hyperbolic_tangent(a: Ends, _: Ends) -> ca.SX:
    apart = a[1] - a[0]
    return _ratio(ca.sinh(apart), apart) / (ca.cosh(a[0]) * ca.cosh(a[1]))


def _arctangent(a: Ends, _: Ends) -> ca.SX:
    apart, inner = a[1] - a[0], 1 + a[0] * a[1]
    return _ratio(ca.atan2(apart, inner), apart, 1 / inner)


_UNARY: dict[int, Callable[[Ends, Ends], ca.SX]] = {
    ca.OP_ASSIGN: lambda a, r: ca.SX(1),
    ca.OP_NEG: lambda a, r: ca.SX(-1),
    ca.OP_TWICE: lambda a, r: ca.SX(2),
    ca.OP_SQ: lambda a, r: a[0] + a[1],
    ca.OP_INV: lambda a, r: -1 / (a[0] * a[1]),
    ca.OP_SQRT: lambda a, r: 1 / (r[0] + r[1]),
    ca.OP_SIN: lambda a, r: ca.cos(_mean(a)) * _sinc_half(a),
    ca.OP_COS: lambda a, r: -ca.sin(_mean(a)) * _sinc_half(a),
    ca.OP_TAN: _tangent,
    ca.OP_EXP: _exponential,
    ca.OP_LOG: _logarithm,
    ca.OP_SINH: lambda a, r: ca.cosh(_mean(a)) * _sinhc_half(a),
    ca.OP_COSH: lambda a, r: ca.sinh(_mean(a)) * _sinhc_half(a),
    ca.OP_TANH: _hyperbolic_tangent,
    ca.OP_ATAN: _arctangent,
    ca.OP_FABS: _size,
}

_BINARY: dict[int, Callable[[Ends, Ends, Ends], Slopes]] = {
    ca.OP_ADD: lambda a, b, r: (ca.SX(1), ca.SX(1)),
    ca.OP_SUB: lambda a, b, r: (ca.SX(1), ca.SX(-1)),
    ca.OP_MUL: lambda a, b, r: (_mean(b), _mean(a)),
    ca.OP_DIV: _quotient,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_ATAN2: _angle,
    ca.OP_HYPOT: _hypotenuse,
    ca.OP_FMAX: _extreme(1),
    ca.OP_FMIN: _extreme(-1),
    # the second argument is passed on where the first, a flag, is one
    ca.OP_IF_ELSE_ZERO: lambda a, b, r: (ca.SX(0), _mean(a)),
}
