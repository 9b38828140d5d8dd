"""The entire functions of s = theta^2 that exponentials, logarithms and retractions are made of.

Takes s >= 0 (floats of any shape, or recorded), gives values that are smooth through s = 0, to
round-off, with exact derivatives when recorded. theta means sqrt(s) in every formula.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from groupoid_gni.expressions.functions import series_guarded

__all__ = [
    "arctan_ratio",
    "cos_of_square",
    "half_cotangent_defect_derivative",
    "half_cotangent_defect_of_square",
    "sinc_of_square",
    "sine_defect_derivative",
    "sine_defect_of_square",
    "versine_derivative",
    "versine_of_square",
]  # fmt: skip

# Closed forms that lose no digits take over early; those that subtract nearly equal numbers only
# where the loss is below one digit. The series need 11 to 25 terms.
_NEAR: Final = 1.0
_FAR: Final = 4.0
_ARCTAN_NEAR: Final = 0.1

Ratio = tuple[int, int]


def _coefficients(term: Callable[[int], Ratio], threshold: float, orders: int = 0) -> list[float]:
    """Give the series coefficients, correctly rounded, of the derivative of the given order.

    term : k -> (numerator, denominator) of the coefficient of s^k of the function itself.
    As many as keep value, first and second derivative below the threshold exact to 2^-56: in the
    second derivative term k weighs k^2 times more.
    """
    kept: list[float] = []
    while True:
        k = len(kept) + orders
        top, bottom = term(k)
        # int / int rounds correctly, however large the integers are.
        kept.append(top * math.perm(k, orders) / bottom)
        index = len(kept) - 1
        weight = abs(kept[-1]) * threshold**index * max(index, 1) ** 2
        if index > 2 and weight < 2.0**-60 * abs(kept[0]):
            return kept


def _sinc_term(k: int) -> Ratio:
    return (-1) ** k, math.factorial(2 * k + 1)


def _cos_term(k: int) -> Ratio:
    return (-1) ** k, math.factorial(2 * k)


def _versine_term(k: int) -> Ratio:
    return (-1) ** k, math.factorial(2 * k + 2)


def _sine_defect_term(k: int) -> Ratio:
    return (-1) ** k, math.factorial(2 * k + 3)


def _tangent_numbers(count: int) -> list[int]:
    """Give T_1, T_2, ... with tan x = sum T_k x^(2k-1) / (2k-1)!, by integer arithmetic."""
    numbers = [math.factorial(k) for k in range(count)]
    for k in range(1, count):
        for j in range(k, count):
            numbers[j] = (j - k) * numbers[j - 1] + (j - k + 2) * numbers[j]
    return numbers


_TANGENT_NUMBERS: Final = _tangent_numbers(48)


def _half_cotangent_defect_term(k: int) -> Ratio:
    # |B_2n| / (2n)!  with n = k + 1 and |B_2n| = 2n T_n / (4^n (4^n - 1)).
    n = k + 1
    return 2 * n * _TANGENT_NUMBERS[k], 4**n * (4**n - 1) * math.factorial(2 * n)


def _arctan_term(k: int) -> Ratio:
    return (-1) ** k, 2 * k + 1


_SINC: Final = _coefficients(_sinc_term, _NEAR)
_COS: Final = _coefficients(_cos_term, _NEAR)
_VERSINE: Final = _coefficients(_versine_term, _NEAR)
_VERSINE_1: Final = _coefficients(_versine_term, _FAR, orders=1)
_SINE_DEFECT: Final = _coefficients(_sine_defect_term, _FAR)
_SINE_DEFECT_1: Final = _coefficients(_sine_defect_term, _FAR, orders=1)
_HALF_COTANGENT: Final = _coefficients(_half_cotangent_defect_term, _FAR)
_HALF_COTANGENT_1: Final = _coefficients(_half_cotangent_defect_term, _FAR, orders=1)
_ARCTAN: Final = _coefficients(_arctan_term, _ARCTAN_NEAR)


def _sinc_closed(s: Any) -> Any:
    theta = np.sqrt(s)
    return np.sin(theta) / theta


def _versine_closed(s: Any) -> Any:
    # 1 - cos(theta) would lose digits near theta = 2 pi k; the half angle does not.
    return 2.0 * np.sin(0.5 * np.sqrt(s)) ** 2 / s


def _versine_derivative_closed(s: Any) -> Any:
    return (0.5 * _sinc_closed(s) - _versine_closed(s)) / s


def _sine_defect_closed(s: Any) -> Any:
    theta = np.sqrt(s)
    return (theta - np.sin(theta)) / (s * theta)


def _sine_defect_derivative_closed(s: Any) -> Any:
    return (_versine_closed(s) - 3.0 * _sine_defect_closed(s)) / (2.0 * s)


def _half_cotangent_defect_closed(s: Any) -> Any:
    half = 0.5 * np.sqrt(s)
    return (1.0 - half * np.cos(half) / np.sin(half)) / s


def _half_cotangent_defect_derivative_closed(s: Any) -> Any:
    half = 0.5 * np.sqrt(s)
    sine, cosine = np.sin(half), np.cos(half)
    # (theta/2) cot(theta/2) = c;  dc/ds = (cot - half/sin^2) / (8 half), and H = (1 - c)/s.
    change = (cosine / sine - half / (sine * sine)) / (8.0 * half)
    return -(change + _half_cotangent_defect_closed(s)) / s


def sinc_of_square(s: Any) -> Any:
    """Give sin(theta) / theta of s = theta^2."""
    return series_guarded(s, _NEAR, _SINC, _sinc_closed)


def cos_of_square(s: Any) -> Any:
    """Give cos(theta) of s = theta^2; unlike cos(sqrt(s)) it is smooth at 0."""
    return series_guarded(s, _NEAR, _COS, lambda far: np.cos(np.sqrt(far)))


def versine_of_square(s: Any) -> Any:
    """Give (1 - cos(theta)) / theta^2 of s = theta^2."""
    return series_guarded(s, _NEAR, _VERSINE, _versine_closed)


def versine_derivative(s: Any) -> Any:
    """Give d/ds of `versine_of_square`: (theta sin(theta)/2 - 1 + cos(theta)) / theta^4."""
    return series_guarded(s, _FAR, _VERSINE_1, _versine_derivative_closed)


def sine_defect_of_square(s: Any) -> Any:
    """Give (theta - sin(theta)) / theta^3 of s = theta^2."""
    return series_guarded(s, _FAR, _SINE_DEFECT, _sine_defect_closed)


def sine_defect_derivative(s: Any) -> Any:
    """Give d/ds of `sine_defect_of_square`: (3 sin - 2 theta - theta cos) / (2 theta^5)."""
    return series_guarded(s, _FAR, _SINE_DEFECT_1, _sine_defect_derivative_closed)


def half_cotangent_defect_of_square(s: Any) -> Any:
    """Give (1 - (theta/2) cot(theta/2)) / theta^2 of s = theta^2, for theta < 2 pi."""
    return series_guarded(s, _FAR, _HALF_COTANGENT, _half_cotangent_defect_closed)


def half_cotangent_defect_derivative(s: Any) -> Any:
    """Give d/ds of `half_cotangent_defect_of_square`, for theta < 2 pi."""
    return series_guarded(s, _FAR, _HALF_COTANGENT_1, _half_cotangent_defect_derivative_closed)


def arctan_ratio(u: Any) -> Any:
    """Give arctan(sqrt(u)) / sqrt(u) of u >= 0."""

    def closed(far: Any) -> Any:
        root = np.sqrt(far)
        return np.arctan(root) / root

    return series_guarded(u, _ARCTAN_NEAR, _ARCTAN, closed)
