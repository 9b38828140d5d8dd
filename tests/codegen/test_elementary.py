"""Our own sine and cosine: accuracy, far arguments, and one lane beside another."""

from __future__ import annotations

import ctypes
import math
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groupoid_gni.codegen import MachineCode, field_ir, machine_has_fused_products

SIZE = 64
FUSED = [False, True] if machine_has_fused_products() else [False]


@cache
def sine_cosine_code(lanes: int, fused: bool) -> Any:
    x, none = ca.SX.sym("x", SIZE), ca.SX.sym("none", 1)
    function = ca.Function("f", [x, none], [ca.vertcat(ca.sin(x), ca.cos(x))])
    code = MachineCode(field_ir(function, lanes, fused))
    evaluate = code.function("evaluate", *[ctypes.c_void_p] * 3)
    return code, evaluate


def sine_cosine(values: Any, lanes: int = 1, fused: bool = FUSED[-1]) -> tuple[Any, Any]:
    """values : (SIZE, lanes) -> sine and cosine, (SIZE, lanes)."""
    _, evaluate = sine_cosine_code(lanes, fused)
    given_values = np.ascontiguousarray(values, dtype=float).reshape(SIZE, lanes)
    nothing, output = np.zeros((1, lanes)), np.empty((2 * SIZE, lanes))
    evaluate(given_values.ctypes.data, nothing.ctypes.data, output.ctypes.data)
    return output[:SIZE], output[SIZE:]


def arguments() -> Any:
    """All sizes up to 1e6, and the neighbours of multiples of pi/2, where the error is largest."""
    rng = np.random.default_rng(12)
    k = rng.integers(-636_000, 636_000, 20_000)
    near = k * (np.pi / 2) * (1 + 1e-16 * rng.integers(-3, 4, 20_000))
    quarter = (k + 0.5) * (np.pi / 2)
    spread = 10.0 ** rng.uniform(-300, 6, 20_000) * rng.choice([-1, 1], 20_000)
    every = np.concatenate([near, quarter, rng.uniform(-1e6, 1e6, 20_000), spread,
                            rng.uniform(-7, 7, 20_000), [1e6, -1e6, 0.0]])
    every = every[np.abs(every) <= 1e6]
    return np.concatenate([every, np.zeros(-len(every) % SIZE)])


@pytest.mark.skipif(np.finfo(np.longdouble).eps > 1e-18, reason="no extended precision here")
@pytest.mark.parametrize("fused", FUSED)
def test_error_is_below_one_and_a_half_ulp(fused: bool) -> None:
    x = arguments()
    found = [sine_cosine(part, fused=fused) for part in x.reshape(-1, SIZE)]
    for number, exact_function in enumerate((np.sin, np.cos)):
        ours = np.concatenate([pair[number].ravel() for pair in found])
        exact = exact_function(x.astype(np.longdouble))
        ulps = np.abs(ours - exact) / np.spacing(np.abs(exact.astype(float)))
        # the library may do better; ours rounds the reduced argument once
        assert ulps.max() < (1.5 if fused else 0.52)


def test_extended_precision_agrees_with_exact_fractions() -> None:
    """The oracle of the test above, against Taylor series in decimals with 60 digits."""
    from decimal import Decimal, localcontext

    with localcontext() as context:
        context.prec = 80
        for value in (0.3, 3.14159, 710.0, 355.0, 999999.25):
            x = Decimal(value)
            pi = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781")
            x -= 2 * pi * (x / (2 * pi)).to_integral_value()
            term, total, n = x, x, 1
            while abs(term) > Decimal(10) ** -60:
                term *= -x * x / ((n + 1) * (n + 2))
                total, n = total + term, n + 2
            ours = sine_cosine(np.full(SIZE, value))[0][0, 0]
            assert abs(Decimal(float(ours)) - total) <= Decimal(1.5 * np.spacing(abs(float(ours))))


def test_zeros_infinities_and_nan() -> None:
    x = np.resize([0.0, -0.0, np.inf, -np.inf, np.nan], SIZE)
    sine, cosine = (part[:5, 0] for part in sine_cosine(x))
    np.testing.assert_array_equal(sine[:2], 0.0)  # the sign of zero is given up: fma(-0, c, -0)
    np.testing.assert_array_equal(cosine[:2], 1.0)
    assert np.all(np.isnan(sine[2:]))
    assert np.all(np.isnan(cosine[2:]))


def test_far_arguments_go_to_the_c_library() -> None:
    x = np.geomspace(1.0000001e6, 1e300, SIZE) * np.resize([1, -1], SIZE)
    sine, cosine = sine_cosine(x)
    np.testing.assert_array_equal(sine[:, 0], [math.sin(v) for v in x])
    np.testing.assert_array_equal(cosine[:, 0], [math.cos(v) for v in x])


@settings(max_examples=100, deadline=None)
@given(st.floats(-1e6, 1e6))
def test_sine_is_odd_and_cosine_even_to_the_bit(value: float) -> None:
    sine, cosine = sine_cosine(np.resize([value, -value], SIZE))
    assert sine[0, 0] == -sine[1, 0]
    assert cosine[0, 0] == cosine[1, 0]
    assert sine[0, 0] ** 2 + cosine[0, 0] ** 2 == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("fused", FUSED)
@pytest.mark.parametrize("lanes", [4, 8])
def test_lanes_have_the_bits_of_one_lane(lanes: int, fused: bool) -> None:
    x = np.random.default_rng(3).uniform(-50, 50, (SIZE, lanes))
    together = sine_cosine(x, lanes, fused)
    for lane in range(lanes):
        alone = sine_cosine(x[:, lane], 1, fused)
        for many, one in zip(together, alone, strict=True):
            np.testing.assert_array_equal(many[:, lane], one[:, 0])


@pytest.mark.parametrize("stranger", [3e7, np.inf, np.nan])
def test_a_far_lane_does_not_change_the_bits_of_its_neighbours(stranger: float) -> None:
    # arguments where polynomial and C library differ in the last bit
    candidates = np.random.default_rng(4).uniform(-5e5, 5e5, 200 * SIZE).reshape(-1, SIZE)
    x = np.concatenate(
        [row[sine_cosine(row)[0][:, 0] != [math.sin(v) for v in row]] for row in candidates]
    )
    x = np.resize(x if len(x) else candidates, SIZE)
    near = sine_cosine(x)
    for place in range(4):
        mixed = np.repeat(x[:, None], 4, axis=1)
        mixed[:, place] = stranger
        together = sine_cosine(mixed, 4)
        for lane in set(range(4)) - {place}:
            for many, one in zip(together, near, strict=True):
                np.testing.assert_array_equal(many[:, lane], one[:, 0])
