"""One recorded number.

Takes one CasADi scalar expression, gives an object that NumPy and Python arithmetic accept as a
number; never turns silently into a float.
Why not the CasADi scalar itself: inside NumPy arrays it becomes NaN or a matrix without an error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import casadi as ca
import numpy as np

from groupoid_gni.errors import InputError, RecordingError

__all__ = ["Scalar", "as_scalar", "constant", "select"]

# SX.binary takes 2 us where the operator `a * b` takes 12 to 20 us; both simplify 0*x, 1*x, x+0,
# x-x, and powers with a constant exponent.
_binary: Final = ca.SX.binary
_unary: Final = ca.SX.unary
_ADD: Final = ca.OP_ADD
_SUB: Final = ca.OP_SUB
_MUL: Final = ca.OP_MUL
_DIV: Final = ca.OP_DIV
_POW: Final = ca.OP_POW

_CONSTANTS: Final[dict[float, ca.SX]] = {}
_CONSTANTS_KEPT: Final = 512

_NO_TRUTH: Final = (
    "a recorded value has no truth value: `if`, `while`, `and`, `or`, `not`, `max()`, `min()` and "
    "`sorted()` need a number. Use gni.where(condition, a, b), and & | ~ between conditions."
)
_NO_COMPLEX: Final = "complex numbers cannot be recorded. Keep real and imaginary part apart."


def constant(value: float) -> ca.SX:
    """Give the 1x1 expression of a float; the commonest ones are kept (making one takes 3 us).

    Raises InputError for NaN: here the traceback still leads to the line it came from.
    """
    found = _CONSTANTS.get(value)
    if found is None:
        if math.isnan(value):
            raise InputError("the constant nan: a 0/0, an overflow or a missing number.")
        found = ca.SX(value)
        if len(_CONSTANTS) < _CONSTANTS_KEPT:
            _CONSTANTS[value] = found
    return found


def _number(value: Any) -> float | None:
    """Give a real number as a float, None for anything that is not one."""
    if isinstance(value, (float, int, np.floating, np.integer, np.bool_)):
        return float(value)
    if isinstance(value, (complex, np.complexfloating)):
        raise RecordingError(_NO_COMPLEX)
    return None


def _expression(value: Any) -> ca.SX | None:
    """Give a recorded or plain number as an expression, None for anything else."""
    if type(value) is Scalar:
        return value.sx
    number = _number(value)
    return None if number is None else constant(number)


def as_scalar(value: Any) -> Scalar:
    """Give a recorded or plain real number as a Scalar.

    Raises RecordingError for anything that is not a real number.
    """
    if type(value) is Scalar:
        return value
    expression = _expression(value)
    if expression is None:
        raise RecordingError(f"{value!r} (a {type(value).__name__}) is not a real number.")
    return Scalar(expression)


def select(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Take `if_true` where the condition holds, else `if_false`; numbers or Scalars.

    Both branches are evaluated; the one not taken counts as 0, whatever its value. Its derivative
    is multiplied by 0, so an infinite one there still gives NaN: keep both branches finite.
    """
    if type(condition) is not Scalar:
        return if_true if condition else if_false
    if if_true is if_false:
        return if_true
    chosen = _binary(ca.OP_IF_ELSE_ZERO, condition.sx, as_scalar(if_true).sx)
    other = _binary(ca.OP_IF_ELSE_ZERO, _unary(ca.OP_NOT, condition.sx), as_scalar(if_false).sx)
    return Scalar(_binary(_ADD, chosen, other))


def _unary_method(operation: int, name: str) -> Callable[[Scalar], Scalar]:
    def apply(self: Scalar) -> Scalar:
        return Scalar(_unary(operation, self.sx))

    apply.__doc__ = f"Record {name} of this value."
    return apply


def _binary_method(operation: int, name: str) -> Callable[[Scalar, Any], Any]:
    def apply(self: Scalar, other: Any) -> Any:
        right = _expression(other)
        if right is None:
            return NotImplemented
        return Scalar(_binary(operation, self.sx, right))

    apply.__doc__ = f"Record {name} of this value (first) and another one."
    return apply


def _reflected_method(operation: int, name: str) -> Callable[[Scalar, Any], Any]:
    def apply(self: Scalar, other: Any) -> Any:
        left = _expression(other)
        if left is None:
            return NotImplemented
        return Scalar(_binary(operation, left, self.sx))

    apply.__doc__ = f"Record {name} of another value (first) and this one."
    return apply


def _refusal(what: str) -> Callable[[Scalar], Any]:
    def refuse(self: Scalar) -> Any:
        raise RecordingError(what)

    refuse.__doc__ = "Refuse: a recorded value is not known yet."
    return refuse


class Scalar:
    """A recorded real number: one node of the expression graph. Immutable.

    Conditions (results of < <= > >= == !=) are Scalars too, with the values 0 and 1.
    A product with an exact 0 is the float 0.0, so structural zeros stay visible in arrays.

    Parameters
    ----------
    sx : casadi.SX, 1x1
        The expression.

    Raises RecordingError whenever Python or NumPy asks for the value itself (truth value, float,
    int, index, complex).
    """

    __slots__ = ("sx",)
    sx: ca.SX

    # What array code asks of a 0-d array. No __array__, __len__, __iter__: NumPy must keep this
    # object as an array element; no __array_priority__: `ndarray / scalar` would fail.
    shape: tuple[()] = ()
    ndim = 0
    size = 1
    dtype = np.dtype(object)

    def __init__(self, sx: ca.SX) -> None:
        self.sx = sx

    # --- arithmetic: written out, because recording spends its time here -----------------------

    def __add__(self, other: Any) -> Any:
        if type(other) is Scalar:
            return Scalar(_binary(_ADD, self.sx, other.sx))
        number = _number(other)
        if number is None:
            return NotImplemented
        return Scalar(_binary(_ADD, self.sx, constant(number))) if number else self

    def __radd__(self, other: Any) -> Any:
        number = _number(other)
        if number is None:
            return NotImplemented
        return Scalar(_binary(_ADD, constant(number), self.sx)) if number else self

    def __sub__(self, other: Any) -> Any:
        if type(other) is Scalar:
            return Scalar(_binary(_SUB, self.sx, other.sx))
        number = _number(other)
        if number is None:
            return NotImplemented
        return Scalar(_binary(_SUB, self.sx, constant(number))) if number else self

    def __rsub__(self, other: Any) -> Any:
        number = _number(other)
        if number is None:
            return NotImplemented
        return Scalar(_binary(_SUB, constant(number), self.sx))

    def __mul__(self, other: Any) -> Any:
        if type(other) is Scalar:
            return Scalar(_binary(_MUL, self.sx, other.sx))
        number = _number(other)
        if number is None:
            return NotImplemented
        if number == 0.0:
            return 0.0
        return self if number == 1.0 else Scalar(_binary(_MUL, self.sx, constant(number)))

    def __rmul__(self, other: Any) -> Any:
        number = _number(other)
        if number is None:
            return NotImplemented
        if number == 0.0:
            return 0.0
        return self if number == 1.0 else Scalar(_binary(_MUL, constant(number), self.sx))

    def __truediv__(self, other: Any) -> Any:
        if type(other) is Scalar:
            return Scalar(_binary(_DIV, self.sx, other.sx))
        number = _number(other)
        if number is None:
            return NotImplemented
        return self if number == 1.0 else Scalar(_binary(_DIV, self.sx, constant(number)))

    def __rtruediv__(self, other: Any) -> Any:
        number = _number(other)
        if number is None:
            return NotImplemented
        return Scalar(_binary(_DIV, constant(number), self.sx)) if number else 0.0

    __pow__ = _binary_method(_POW, "the power")
    __rpow__ = _reflected_method(_POW, "the power")

    def __mod__(self, other: Any) -> Any:
        divisor = _expression(other)
        return NotImplemented if divisor is None else self.remainder(Scalar(divisor))

    def __rmod__(self, other: Any) -> Any:
        dividend = _expression(other)
        return NotImplemented if dividend is None else Scalar(dividend).remainder(self)

    def __floordiv__(self, other: Any) -> Any:
        divisor = _expression(other)
        return NotImplemented if divisor is None else self.floor_divide(Scalar(divisor))

    def __rfloordiv__(self, other: Any) -> Any:
        dividend = _expression(other)
        return NotImplemented if dividend is None else Scalar(dividend).floor_divide(self)

    __neg__ = _unary_method(ca.OP_NEG, "the negative")
    __abs__ = _unary_method(ca.OP_FABS, "the absolute value")

    def __pos__(self) -> Scalar:
        return self

    # --- conditions -----------------------------------------------------------------------------

    __lt__ = _binary_method(ca.OP_LT, "<")
    __le__ = _binary_method(ca.OP_LE, "<=")
    __gt__ = _reflected_method(ca.OP_LT, "<")
    __ge__ = _reflected_method(ca.OP_LE, "<=")
    __eq__ = _binary_method(ca.OP_EQ, "==")
    __ne__ = _binary_method(ca.OP_NE, "!=")
    __hash__ = None  # type: ignore[assignment]
    __and__ = _binary_method(ca.OP_AND, "and")
    __rand__ = _reflected_method(ca.OP_AND, "and")
    __or__ = _binary_method(ca.OP_OR, "or")
    __ror__ = _reflected_method(ca.OP_OR, "or")
    __xor__ = _binary_method(ca.OP_NE, "exclusive or")
    __rxor__ = _reflected_method(ca.OP_NE, "exclusive or")
    __invert__ = _unary_method(ca.OP_NOT, "not")

    # --- elementwise functions, under the names of NumPy's ufuncs --------------------------------

    sin = _unary_method(ca.OP_SIN, "the sine")
    cos = _unary_method(ca.OP_COS, "the cosine")
    tan = _unary_method(ca.OP_TAN, "the tangent")
    arcsin = _unary_method(ca.OP_ASIN, "the inverse sine")
    arccos = _unary_method(ca.OP_ACOS, "the inverse cosine")
    arctan = _unary_method(ca.OP_ATAN, "the inverse tangent")
    sinh = _unary_method(ca.OP_SINH, "the hyperbolic sine")
    cosh = _unary_method(ca.OP_COSH, "the hyperbolic cosine")
    tanh = _unary_method(ca.OP_TANH, "the hyperbolic tangent")
    arcsinh = _unary_method(ca.OP_ASINH, "the inverse hyperbolic sine")
    arccosh = _unary_method(ca.OP_ACOSH, "the inverse hyperbolic cosine")
    arctanh = _unary_method(ca.OP_ATANH, "the inverse hyperbolic tangent")
    exp = _unary_method(ca.OP_EXP, "the exponential")
    expm1 = _unary_method(ca.OP_EXPM1, "exp(x) - 1")
    log = _unary_method(ca.OP_LOG, "the logarithm")
    log1p = _unary_method(ca.OP_LOG1P, "log(1 + x)")
    sqrt = _unary_method(ca.OP_SQRT, "the square root")
    square = _unary_method(ca.OP_SQ, "the square")
    absolute = _unary_method(ca.OP_FABS, "the absolute value")
    fabs = absolute
    sign = _unary_method(ca.OP_SIGN, "the sign")
    floor = _unary_method(ca.OP_FLOOR, "the floor")
    ceil = _unary_method(ca.OP_CEIL, "the ceiling")
    logical_not = _unary_method(ca.OP_NOT, "not")
    arctan2 = _binary_method(ca.OP_ATAN2, "the angle")
    hypot = _binary_method(ca.OP_HYPOT, "sqrt(x^2 + y^2)")
    copysign = _binary_method(ca.OP_COPYSIGN, "the magnitude and the sign")
    fmod = _binary_method(ca.OP_FMOD, "the remainder with the sign of the first")
    logical_and = __and__
    logical_or = __or__
    power = __pow__
    float_power = __pow__

    def logical_xor(self, other: Any) -> Scalar:
        """Record that exactly one of the two is nonzero."""
        return (self != 0.0) ^ (as_scalar(other) != 0.0)

    def conjugate(self) -> Scalar:
        """Give the value itself: recorded numbers are real."""
        return self

    @property
    def real(self) -> Scalar:
        """The value itself: recorded numbers are real."""
        return self

    @property
    def imag(self) -> float:
        """Zero: recorded numbers are real."""
        return 0.0

    def reciprocal(self) -> Scalar:
        """Record 1/x."""
        return Scalar(_unary(ca.OP_INV, self.sx))

    def log2(self) -> Any:
        """Record the logarithm to base 2."""
        return self.log() / math.log(2.0)

    def log10(self) -> Any:
        """Record the logarithm to base 10."""
        return self.log() / math.log(10.0)

    def exp2(self) -> Any:
        """Record 2^x."""
        return 2.0**self

    def cbrt(self) -> Any:
        """Record the real cube root, also of negative numbers."""
        return self.sign() * self.absolute() ** (1.0 / 3.0)

    def deg2rad(self) -> Any:
        """Record an angle in degrees as one in radians."""
        return self * (math.pi / 180.0)

    def rad2deg(self) -> Any:
        """Record an angle in radians as one in degrees."""
        return self * (180.0 / math.pi)

    def trunc(self) -> Any:
        """Record the integer part, rounded towards zero."""
        return select(self < 0.0, self.ceil(), self.floor())

    def rint(self) -> Any:
        """Record the nearest integer, halves to even (the IEEE remainder rounds just so)."""
        return self - Scalar(_binary(ca.OP_REMAINDER, self.sx, constant(1.0)))

    def signbit(self) -> Any:
        """Record whether the value is negative (0.0 and -0.0 both count as positive)."""
        return self < 0.0

    def remainder(self, other: Any) -> Any:
        """Record the remainder with the sign of the divisor, as Python's and NumPy's %.

        Built on fmod, which is exact: x - y*floor(x/y) jumps by y when x/y rounds to an integer.
        """
        divisor = as_scalar(other)
        rest = as_scalar(self.fmod(divisor))
        return select(rest * divisor < 0.0, rest + divisor, rest)

    def floor_divide(self, other: Any) -> Any:
        """Record floor(x/y), consistent with the remainder."""
        divisor = as_scalar(other)
        return ((self - self.remainder(divisor)) / divisor + 0.5).floor()

    def maximum(self, other: Any) -> Scalar:
        """Record the greater of the two; -inf as a bound leaves no trace."""
        if _number(other) == -math.inf:
            return self
        return Scalar(_binary(ca.OP_FMAX, self.sx, as_scalar(other).sx))

    def minimum(self, other: Any) -> Scalar:
        """Record the smaller of the two; inf as a bound leaves no trace."""
        if _number(other) == math.inf:
            return self
        return Scalar(_binary(ca.OP_FMIN, self.sx, as_scalar(other).sx))

    def heaviside(self, at_zero: Any) -> Any:
        """Record the step function: 0 below zero, 1 above, `at_zero` at zero."""
        return select(self == 0.0, at_zero, self > 0.0)

    def logaddexp(self, other: Any) -> Any:
        """Record log(exp(x) + exp(y)) without overflow."""
        right = as_scalar(other)
        return self.maximum(right) + (-(self - right).absolute()).exp().log1p()

    # --- what NumPy asks --------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        # The array type is built on this one, so it can only be looked up when it is needed.
        from groupoid_gni.expressions.array import apply_ufunc

        return apply_ufunc(ufunc, method, inputs, kwargs)

    def __array_function__(
        self, func: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Any:
        from groupoid_gni.expressions.array import apply_array_function

        return apply_array_function(func, args, kwargs)

    __bool__ = _refusal(_NO_TRUTH)
    __float__ = _refusal(
        "a recorded value is not a float: float(), the math module and assignment into a float "
        "array need a number. Use NumPy functions, and gni.array([...]) or np.zeros_like(x) for "
        "new arrays."
    )
    __int__ = _refusal("a recorded value is not an integer: int() needs a number. Use np.floor.")
    __index__ = _refusal(
        "a recorded value cannot be an index or a count: the graph would depend on it. "
        "Use gni.where(condition, a, b) to choose between entries."
    )
    __complex__ = _refusal(_NO_COMPLEX)

    def __copy__(self) -> Scalar:
        return self

    def __deepcopy__(self, memo: Any) -> Scalar:
        return self

    def __format__(self, format_spec: str) -> str:
        return str(self)

    def __repr__(self) -> str:
        text = str(self.sx)
        return f"Scalar({text if len(text) <= 60 else text[:57] + '...'})"
