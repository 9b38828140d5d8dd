"""Exponential, logarithm and their tangents for matrices of any size, with fixed structure.

Takes matrices (..., n, n), gives matrices; no data-dependent loop, so everything can be recorded.
Appendix of the paper, choice (a), for groups without a closed form.
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array

_SQUARINGS = 6
_TAYLOR_DEGREE = 12
_LOG_HALVINGS = (8, 5, 4)
_LOG_TERMS = 12
_DEXP_DOUBLINGS = 3

LARGEST_ANGLE = 3.0
"""Rotation angle up to which ``logarithm`` holds; at pi its matrix 1 + g is singular."""

# B_2k / (2k)! * 4^k, the series of w coth(w) in powers of w^2.
_COTH_SERIES = (
    1.0, 1 / 3, -1 / 45, 2 / 945, -1 / 4725, 2 / 93555, -1382 / 638512875, 4 / 18243225,
    -3617 / 162820783125, 87734 / 38979295480125,
)


def exponential(matrix: Array) -> Array:
    """Give exp(matrix) by scaling, Taylor and squaring.

    Truncation below 1e-16 for |matrix| <= 20; round-off grows with the 6 squarings.
    """
    scaled = matrix / 2**_SQUARINGS
    one = np.eye(np.shape(matrix)[-1])
    result: Array = one + scaled / _TAYLOR_DEGREE
    for degree in range(_TAYLOR_DEGREE - 1, 0, -1):
        result = one + scaled @ result / degree
    for _ in range(_SQUARINGS):
        result = result @ result
    return result


def half_tangent(tangent: Array, iterations: int) -> Array:
    """Solve z = 2 y / (1 + y^2) for the branch y = z/2 + ..., by Newton's method.

    With z = tanh(A) (for rotations i tan(angle)) it gives y = tanh(A/2). All iterates commute with
    z, so that the scalar Newton step holds for matrices. From y = z/2 six iterations suffice for
    |z| <= 2, eight for |z| <= 15.
    """
    one = np.eye(np.shape(tangent)[-1])
    result: Array = tangent / 2
    for _ in range(iterations):
        numerator = tangent @ (one - result @ result) / 2
        result = np.linalg.solve(one - tangent @ result, numerator)
    return result


def logarithm(matrix: Array) -> Array:
    """Give the principal logarithm, 2 artanh((g + 1)^{-1} (g - 1)).

    The argument of artanh is halved three times, then the series is summed. To round-off for
    rotation angles up to 3 (eigenvalues away from -1) and boosts up to rapidity 4.
    """
    one = np.eye(np.shape(matrix)[-1])
    tangent = np.linalg.solve(matrix + one, matrix - one)
    for iterations in _LOG_HALVINGS:
        tangent = half_tangent(tangent, iterations)
    square = tangent @ tangent
    series = one / (2 * _LOG_TERMS + 1)
    for term in range(_LOG_TERMS - 1, -1, -1):
        series = one / (2 * term + 1) + square @ series
    return 2 ** (len(_LOG_HALVINGS) + 1) * tangent @ series


def dexp_inverse_of_ad(ad: Array) -> Array:
    """Give sum of B_j ad^j / j! = w coth(w) - w, w = ad/2.

    f(w) = w coth(w) is summed at w/8 and doubled three times by f(2w) = f(w) + w^2 f(w)^{-1}; the
    plain Bernoulli series has radius 2 pi and would need 26 terms at |ad| = pi.
    """
    one = np.eye(np.shape(ad)[-1])
    half = ad / 2
    square = half @ half / 4**_DEXP_DOUBLINGS
    result = _COTH_SERIES[-1] * one
    for coefficient in _COTH_SERIES[-2::-1]:
        result = coefficient * one + square @ result
    for _ in range(_DEXP_DOUBLINGS):
        result = result + np.linalg.solve(result, square)
        square = 4 * square
    return result - half
