"""Orders and times to an error, from tables whose answer is known."""

import numpy as np
import pytest

from groupoid_gni.reports.fits import fitted_slope, seconds_text, time_to

STEPS = 0.4 / 2.0 ** np.arange(8)


def slope_of(errors, resolved=None, size=1.7):
    known = np.ones(len(errors), dtype=bool) if resolved is None else resolved
    return fitted_slope(list(STEPS[: len(errors)]), list(errors), list(known), size)


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_a_power_law_has_its_order_and_no_uncertainty(order):
    found = slope_of(0.03 * STEPS**order)
    assert found.order == pytest.approx(order, abs=1e-10)
    assert found.high - found.low < 1e-8
    assert found.points == len(STEPS)


def test_the_interval_of_a_noisy_law_holds_the_truth_nineteen_times_in_twenty():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(400):
        found = slope_of(0.03 * STEPS**3 * np.exp(0.05 * rng.standard_normal(len(STEPS))))
        hits += found.low <= 3.0 <= found.high
    assert 0.91 <= hits / 400 <= 0.98


def test_a_round_off_plateau_takes_no_part():
    rng = np.random.default_rng(3)
    errors = 0.7 * STEPS**6 + 1e-9 * (1.0 + rng.random(len(STEPS)))
    found = slope_of(errors)
    assert found.points < len(STEPS)
    assert found.order == pytest.approx(6.0, abs=0.25)


def test_a_plateau_of_most_points_still_leaves_the_order():
    errors = np.maximum(0.7 * STEPS**8, 1e-8 * (1.0 + 0.3 * np.sin(np.arange(8.0))))
    found = slope_of(errors)
    assert found.points == 3
    assert found.low < 8.0 < found.high
    assert found.order > 7.5


def test_steep_errors_of_coarse_steps_take_no_part():
    errors = 0.03 * STEPS**4 * np.array([300.0, 20.0, 4.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    found = slope_of(errors, size=100.0)
    assert (found.points, round(found.order, 8)) == (5, 4.0)


def test_errors_that_the_reference_cannot_tell_take_no_part():
    errors = 0.03 * STEPS**2
    errors[5:] = 1e-9 * np.array([3.0, 1.0, 0.2])
    resolved = np.arange(8) < 5
    found = slope_of(errors, resolved)
    assert (found.points, round(found.order, 8)) == (5, 2.0)


def test_failed_and_coarse_runs_take_no_part():
    errors = 0.03 * STEPS**2
    errors[:2] = np.inf, 0.9
    found = slope_of(errors)
    assert (found.points, round(found.order, 8)) == (6, 2.0)


def test_two_points_are_no_order():
    assert slope_of(0.03 * STEPS[:2] ** 2) is None
    assert slope_of(np.full(8, np.inf)) is None


def test_the_time_is_interpolated_in_logarithms():
    # seconds = errors^-1/2
    errors = [1e-2, 1e-4, 1e-6]
    seconds = [1e-5, 1e-4, 1e-3]
    found = time_to(1e-5, errors, seconds)
    assert found.seconds == pytest.approx(10**-3.5)
    assert not found.at_most


def test_the_time_is_never_extrapolated():
    errors, seconds = [1e-2, 1e-4, 1e-6], [1e-5, 1e-4, 1e-3]
    assert time_to(1e-7, errors, seconds) is None
    loosest = time_to(0.5, errors, seconds)
    assert (loosest.seconds, loosest.at_most) == (1e-5, True)
    assert str(loosest).startswith("<= ")


def test_one_lucky_zero_of_the_error_is_no_accuracy():
    errors, seconds = [1e-2, 1e-9, 1e-4, 1e-6], [1e-5, 2e-5, 4e-5, 8e-5]
    assert time_to(1e-5, errors, seconds).seconds > 4e-5


def test_a_setting_after_a_failure_gives_a_bound():
    found = time_to(1e-3, [np.inf, 1e-5, 1e-7], [np.inf, 2e-5, 4e-5])
    assert (found.seconds, found.at_most) == (2e-5, True)


def test_seconds_are_told_with_a_unit():
    assert seconds_text(2.5) == "2.5 s"
    assert seconds_text(0.0123) == "12.3 ms"
    assert seconds_text(4.2e-5) == "42 us"
    assert seconds_text(7.1e-8) == "71 ns"
