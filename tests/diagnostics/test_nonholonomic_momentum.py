"""J = <p, X> obeys its equation on every groupoid, and is kept where theory says so."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.diagnostics import nonholonomic_momentum
from groupoid_gni.diagnostics.quadrature import cumulative_integral

NAMES = ["pair 3", "SO3 left cay", "SE2 right exp", "atiyah right cay", "framed left exp",
         "action left cay", "action right exp"]


def wavy_section(rank: int) -> Any:
    """A section that depends on the base point and on a parameter, not in D."""
    first, second = np.random.default_rng(11).normal(size=(2, rank))
    return lambda x, p: first * (1.3 + np.sin(x.sum() + 0.4)) + p.rate * second


@pytest.mark.parametrize("name", NAMES)
def test_the_change_of_momentum_is_the_integral_of_its_equation(name: str) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    run = gni.integrate(
        a.system, a.start, step=0.01, n_steps=150, method=gni.ReferenceFlow(rtol=1e-12)
    )
    J = nonholonomic_momentum(run, wavy_section(a.system.space.rank))
    assert np.ptp(J.values) > 1e-5
    assert np.max(np.abs(J.balance)) < 1e-10 * max(1.0, np.ptp(J.values))


@pytest.mark.parametrize("name", ["pair 3", "atiyah right cay"])
def test_the_values_and_the_part_of_the_force_are_what_plain_numpy_gives(name: str) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    run = gni.integrate(a.system, a.start, step=0.01, n_steps=20, method=gni.ReferenceFlow())
    section = wavy_section(a.system.space.rank)
    J = nonholonomic_momentum(run, section)
    parameters = type("P", (), {"rate": 0.8})
    for k in (0, 7, 20):
        X = section(run.base[k], parameters)
        assert J.values[k] == pytest.approx(run.momenta[k] @ X, rel=1e-13)
        force = run.multipliers[k] @ a.plain.constraints(run.base[k]) @ X
        assert J.force_part[k] == pytest.approx(force, rel=1e-10)
    mu = [a.plain.constraints(x) for x in run.base]
    X = [section(x, parameters) for x in run.base]
    inverse = [np.linalg.inv(a.plain.metric(x)) for x in run.base]
    cosines = [
        abs(row @ x) / np.sqrt((row @ i @ row) * (x @ np.linalg.inv(i) @ x))
        for rows, x, i in zip(mu, X, inverse, strict=True) for row in rows
    ]
    assert J.outside == pytest.approx(max(cosines), rel=1e-9)


def test_a_horizontal_symmetry_is_kept_and_said_to_be_in_the_distribution() -> None:
    scene = gni.scenes.rolling_ball(mass=1.7, radius=0.8, inertia=0.61, table=0.0)
    run = gni.integrate(scene.system, scene.start, step=0.07, n_steps=300)
    J = nonholonomic_momentum(run, [0.0, 0.0, 0.0, 0.0, 1.0])
    assert J.outside == 0.0
    assert np.ptp(J.values) < 1e-13
    # rolling along x: m x' + I omega_2 / r, a section of D with constant components
    rolling = nonholonomic_momentum(run, lambda x, p: gni.array([1.0, 0.0, 0.0, 1.0 / p.r, 0.0]))
    assert rolling.outside < 1e-15
    assert np.max(np.abs(rolling.rate)) < 1e-13
    assert np.ptp(rolling.values) < 1e-12
    assert "in D" in str(rolling)


def test_a_section_out_of_the_distribution_is_said_to_be_out() -> None:
    scene = gni.scenes.rolling_ball(table=0.4)
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=20)
    J = nonholonomic_momentum(run, [1.0, 0.0, 0.0, 0.0, 0.0])
    assert J.outside > 0.3
    np.testing.assert_allclose(J.rate, J.force_part, atol=1e-13)
    assert "out of D" in str(J)


def test_the_balance_of_a_method_of_order_two_falls_like_the_square_of_the_step() -> None:
    a = zoo.animal("pair 3", 1)
    section = wavy_section(3)
    worst = []
    for n in (40, 80, 160):
        run = gni.integrate(a.system, a.start, step=2.0 / n, n_steps=n)
        worst.append(np.max(np.abs(nonholonomic_momentum(run, section).balance)))
    assert np.log2(worst[0] / worst[1]) == pytest.approx(2.0, abs=0.15)
    assert np.log2(worst[1] / worst[2]) == pytest.approx(2.0, abs=0.1)


def test_sections_of_a_wrong_shape_are_refused() -> None:
    scene = gni.scenes.rolling_ball()
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=3)
    with pytest.raises(gni.InputError, match="section must have shape"):
        nonholonomic_momentum(run, [1.0, 0.0])
    with pytest.raises(gni.InputError, match="two arguments"):
        nonholonomic_momentum(run, lambda x: x)


@pytest.mark.parametrize("points", [2, 4, 5, 6])
def test_the_quadrature_is_exact_for_polynomials_also_with_a_short_last_interval(
    points: int,
) -> None:
    for last in (0.7, 0.31, -0.7):
        h = np.sign(last) * 0.7
        times = np.append(1.3 + h * np.arange(9), 1.3 + h * 8 + last)
        exact = (times**points - times[0] ** points) / points
        found = cumulative_integral(times, times ** (points - 1), points)
        np.testing.assert_allclose(found, exact, rtol=1e-11, atol=1e-11)


def test_the_quadrature_takes_as_many_nodes_as_there_are() -> None:
    assert cumulative_integral(np.array([0.4]), np.array([2.0])) == pytest.approx([0.0])
    found = cumulative_integral(np.array([0.4, 0.9, 1.4]), np.array([1.0, 2.0, 3.0]))
    assert found == pytest.approx([0.0, 0.75, 2.0])
