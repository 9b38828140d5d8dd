"""The entire functions of theta^2 against exact rational series, with two derivatives."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groupoid_gni import expressions as gni

BELOW = [0.0, 1e-300, 1e-16, 1e-8, 1e-4, 0.03]
AROUND = [
    0.05, math.nextafter(0.1, 0), 0.1, 0.13, 0.5, math.nextafter(1.0, 0), 1.0,
    math.nextafter(1.0, 2), 2.1, math.nextafter(4.0, 0), 4.0, 4.1, 6.5, 9.0,
]  # fmt: skip
POINTS = BELOW + AROUND


def bernoulli(count):
    numbers = []
    for m in range(count):
        total = sum(math.comb(m + 1, k) * numbers[k] for k in range(m))
        numbers.append(Fraction(1) if m == 0 else -Fraction(total) / (m + 1))
    return numbers


BERNOULLI = bernoulli(140)


def factorial_series(shift):
    return lambda k: Fraction((-1) ** k, math.factorial(2 * k + shift))


def cotangent_series(k):
    n = k + 1
    return abs(BERNOULLI[2 * n]) / math.factorial(2 * n)


def shifted(series):
    return lambda k: (k + 1) * series(k + 1)


def derived(series, order, s):
    """Sum the derivative of a power series at s, exactly; 60 terms reach 1e-30 for s <= 9."""
    exact = Fraction(s)
    total, power = Fraction(0), Fraction(1)
    for k in range(60):
        total += math.perm(k + order, order) * series(k + order) * power
        power *= exact
    return float(total)


FUNCTIONS = {
    gni.sinc_of_square: factorial_series(1),
    gni.cos_of_square: factorial_series(0),
    gni.versine_of_square: factorial_series(2),
    gni.versine_derivative: shifted(factorial_series(2)),
    gni.sine_defect_of_square: factorial_series(3),
    gni.sine_defect_derivative: shifted(factorial_series(3)),
    gni.half_cotangent_defect_of_square: cotangent_series,
    gni.half_cotangent_defect_derivative: shifted(cotangent_series),
}
all_functions = pytest.mark.parametrize(
    ("function", "series"), FUNCTIONS.items(), ids=[f.__name__ for f in FUNCTIONS]
)


@all_functions
def test_values(function, series):
    expected = np.array([derived(series, 0, s) for s in POINTS])
    # cos passes through zero at s = 2.47: there only the absolute error is small.
    np.testing.assert_allclose(function(np.array(POINTS)), expected, rtol=4e-15, atol=1e-19)


@all_functions
def test_first_and_second_derivative(function, series):
    recorded = gni.record(function, {"s": ()}, (), name=function.__name__)
    first, second = recorded.derivative(0), recorded.derivative(0).derivative(0)
    points = np.array(POINTS)
    np.testing.assert_allclose(recorded(points), function(points), rtol=1e-15)
    for order, derivative in ((1, first), (2, second)):
        expected = np.array([derived(series, order, s) for s in POINTS])
        np.testing.assert_allclose(derivative(points), expected, rtol=1e-12)


def arctan_ratio_exactly(u):
    """Euler's series: sum 4^n n!^2 / (2n+1)! u^n / (1+u)^(n+1), rational in u."""
    u = Fraction(u).limit_denominator(10**40)
    term = 1 / (1 + u)
    ratio, total, n = u / (1 + u), Fraction(0), 0
    scale = 10**50
    # Rounding down to 50 digits keeps the fractions short.
    while term > Fraction(1, 10**40):
        total += term
        n += 1
        term *= ratio * Fraction(2 * n, 2 * n + 1)
        term = Fraction(int(term * scale), scale)
    return total


def arctan_derivatives_exactly(u):
    """2 u A' + A = 1/(1+u), differentiated once more; the series at small u."""
    if u < 1e-3:
        return tuple(
            derived(lambda k: Fraction((-1) ** k, 2 * k + 1), order, u) for order in (0, 1, 2)
        )
    value, u = arctan_ratio_exactly(u), Fraction(u)
    first = (1 / (1 + u) - value) / (2 * u)
    second = -(1 / (1 + u) ** 2 + 3 * first) / (2 * u)
    return float(value), float(first), float(second)


def test_arctan_ratio():
    recorded = gni.record(gni.arctan_ratio, {"u": ()}, (), name="arctan_ratio")
    first, second = recorded.derivative(0), recorded.derivative(0).derivative(0)
    for u in POINTS:
        expected = arctan_derivatives_exactly(u)
        assert gni.arctan_ratio(u) == pytest.approx(expected[0], rel=2e-15, abs=0)
        assert recorded(u) == pytest.approx(expected[0], rel=2e-15, abs=0)
        assert first(u) == pytest.approx(expected[1], rel=1e-12, abs=0)
        assert second(u) == pytest.approx(expected[2], rel=1e-12, abs=0)


@all_functions
def test_batches_and_python_floats(function, series):
    s = np.array(POINTS).reshape(4, 5)
    result = function(s)
    assert result.shape == (4, 5)
    assert function(s[2, 1]) == pytest.approx(result[2, 1], rel=1e-15)
    vector = gni.record(function, {"s": (4, 5)}, (4, 5), name="vector", check_points=[(s,)])
    np.testing.assert_allclose(vector(s), result, rtol=1e-15)


@all_functions
def test_nan_stays_nan(function, series):
    recorded = gni.record(function, {"s": ()}, (), name=function.__name__)
    assert math.isnan(function(math.nan))
    assert math.isnan(recorded(math.nan))


@settings(max_examples=300, deadline=None, derandomize=True)
@given(theta=st.floats(1e-6, 6.2))
def test_identities(theta):
    s = theta * theta
    sinc, versine = gni.sinc_of_square(s), gni.versine_of_square(s)
    assert gni.cos_of_square(s) == pytest.approx(1.0 - s * versine, abs=1e-14)
    assert s * sinc**2 + (1.0 - s * versine) ** 2 == pytest.approx(1.0, abs=1e-14)
    assert sinc == pytest.approx(1.0 - s * gni.sine_defect_of_square(s), abs=1e-14)
    half = gni.sinc_of_square(0.25 * s)
    # (theta/2) cot(theta/2) = cos(theta/2) / sinc(theta/2)
    expected = 1.0 - gni.cos_of_square(0.25 * s) / half
    assert s * gni.half_cotangent_defect_of_square(s) == pytest.approx(
        expected, rel=1e-12, abs=1e-15
    )
    # tan(arctan) on the ratio
    ratio = gni.arctan_ratio(s)
    assert math.tan(theta * ratio) == pytest.approx(theta, rel=1e-12)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(coefficients=st.lists(st.floats(-2, 2), min_size=1, max_size=6), s=st.floats(0, 5))
def test_series_guarded_is_a_polynomial_below_and_the_closed_form_above(coefficients, s):
    value = gni.series_guarded(s, 2.5, coefficients, np.sqrt)
    if s < 2.5:
        expected = math.fsum(c * s**k for k, c in enumerate(coefficients))
        assert value == pytest.approx(expected, rel=1e-12, abs=1e-12)
    else:
        assert value == math.sqrt(s)
