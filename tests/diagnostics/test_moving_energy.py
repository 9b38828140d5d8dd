"""Moving energies: known ones are kept, wrong ones are refused, and the search finds them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import zoo

import groupoid_gni as gni
from groupoid_gni.diagnostics import (
    SymmetrySearch,
    find_moving_energy,
    moving_energy,
    symmetry_report,
)


def turning(x: Any, p: Any) -> Any:
    """The table's rotation of ball and plane, in space velocities."""
    return p.Theta * gni.array([-x[1], x[0], 0.0, 0.0, 1.0])


def seen_from_the_ball(x: Any, p: Any) -> Any:
    """The same in body velocities: the vertical is R^T e3, the last row of R."""
    return p.Theta * gni.array([-x[1], x[0], x[8], x[9], x[10]])


def ball() -> gni.scenes.scene.Scene:
    return gni.scenes.rolling_ball(
        mass=1.7, radius=0.8, inertia=0.61, table=0.7, position=(0.4, -0.9), vertical_spin=0.3
    )


def driven_body(**options: Any) -> gni.scenes.scene.Scene:
    gamma = np.array([0.48, 0.6, 0.64])
    spin = np.array([0.5, 0.4, -0.75]) + 0.3 * gamma
    return gni.scenes.veselova((1.1, 1.6, 2.3), rate=0.3, vertical=gamma, spin=spin, **options)


CASES = {
    "homogeneous ball": (ball, turning),
    "inhomogeneous ball": (lambda: gni.scenes.inhomogeneous_ball(table=0.6), seen_from_the_ball),
    "veselova": (driven_body, lambda x, p: p.c * x),
    "heavy veselova": (lambda: driven_body(weight=(0.2, -0.1, 0.3)), lambda x, p: p.c * x),
}


@pytest.mark.parametrize("name", CASES)
def test_the_moving_energy_is_kept_by_the_motion_while_the_energy_is_not(name: str) -> None:
    make, generator = CASES[name]
    scene = make()
    run = gni.integrate(
        scene.system, scene.start, step=0.1, n_steps=200, method=gni.ReferenceFlow(rtol=1e-12)
    )
    moving = moving_energy(run, generator)
    assert moving.symmetry.holds
    assert np.ptp(run.energy()) > 0.1
    assert np.max(np.abs(moving.rate)) < 1e-12
    assert np.ptp(moving.values) < 1e-9


def test_on_the_rotating_table_it_is_energy_minus_the_rate_times_the_moment_of_momentum() -> None:
    scene = ball()
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=50)
    (x, y), (vx, vy, _, _, spin) = run.base.T, run.velocities.T
    moment = 1.7 * (x * vy - y * vx) + 0.61 * spin
    np.testing.assert_allclose(
        moving_energy(run, turning).values, run.energy() - 0.7 * moment, rtol=1e-12
    )


def test_the_rate_is_the_slope_of_the_quantity_for_any_section_at_all() -> None:
    a = zoo.animal("atiyah right cay", 2, affine=True, gyroscopic=True)
    run = gni.integrate(
        a.system, a.start, step=0.01, n_steps=100, method=gni.ReferenceFlow(rtol=1e-12)
    )
    weights = np.array([0.3, -0.7, 0.4, 1.1, -0.2])
    moving = moving_energy(
        run, lambda x, p: weights * (1.0 + x[0] * x[1]), require_symmetry=False
    )
    v = moving.values
    slope = (8 * (v[3:-1] - v[1:-3]) - (v[4:] - v[:-4])) / (12 * 0.01)
    assert np.max(np.abs(slope)) > 0.1
    np.testing.assert_allclose(slope, moving.rate[2:-2], atol=1e-6)


def test_a_section_that_is_no_symmetry_is_refused_with_the_condition_that_fails() -> None:
    scene = ball()
    run = gni.integrate(scene.system, scene.start, step=0.1, n_steps=10)
    with pytest.raises(gni.InputError, match=r"mu \(Y' - Y\) is not zero"):
        moving_energy(run, lambda x, p: 1.01 * turning(x, p))
    stretched = lambda x, p: turning(x, p) + gni.array([x[0], 0.0, 0.0, x[0] / p.r, 0.0])  # noqa: E731
    with pytest.raises(gni.InputError, match="L is not invariant") as caught:
        moving_energy(run, stretched)
    assert "is not zero" not in str(caught.value)
    report = symmetry_report(scene.system, stretched, run.base)
    assert report.outside < 1e-14
    assert report.variance > 0.1


def test_the_report_does_not_take_round_off_for_a_broken_symmetry() -> None:
    isotropic = gni.MechanicalSystem(
        gni.SO3(), metric=1.3 * np.eye(3), constraints=[[0.3, 0.5, 1.1]], drift=[0.2, 0.7, 0.4]
    )
    report = symmetry_report(isotropic, [0.2, 0.7, 0.4])
    assert report.holds, report
    assert report.variance < 1e-14


def test_the_report_does_not_depend_on_units() -> None:
    body = gni.MechanicalSystem(gni.SO3(), metric=np.diag([1.1, 1.6, 2.3]))
    reports = [symmetry_report(body, np.array([0.2, 0.7, 0.4]) * s) for s in (1.0, 1e-12)]
    assert reports[0].variance == pytest.approx(reports[1].variance, rel=1e-9)
    assert reports[0].variance > 0.05
    assert not reports[1].holds


@pytest.mark.parametrize("name", CASES)
def test_the_search_finds_the_moving_energy_of_every_driven_scene(name: str) -> None:
    make, _ = CASES[name]
    scene = make()
    found = find_moving_energy(scene.system, scene.start.base)
    assert found.moving is not None
    assert found.report is not None
    assert found.report.holds
    run = gni.integrate(
        scene.system, scene.start, step=0.1, n_steps=200, method=gni.ReferenceFlow(rtol=1e-12)
    )
    assert np.ptp(moving_energy(run, found.moving).values) < 1e-9


def kept(scene: gni.scenes.scene.Scene, found: SymmetrySearch) -> list[float]:
    run = gni.integrate(
        scene.system, scene.start, step=0.1, n_steps=100, method=gni.ReferenceFlow(rtol=1e-12)
    )
    return [
        float(np.ptp(gni.diagnostics.nonholonomic_momentum(run, X).values))
        for X in found.horizontal
    ]


def test_the_search_finds_the_momenta_that_the_constraint_force_leaves_alone() -> None:
    scene = ball()
    found = find_moving_energy(scene.system)
    # rolling along x, rolling along y, spinning about the vertical
    assert len(found.horizontal) == 3
    assert max(kept(scene, found)) < 1e-10
    scene = gni.scenes.inhomogeneous_ball(table=0.6)
    found = find_moving_energy(scene.system)
    assert len(found.horizontal) == 3
    assert max(kept(scene, found)) < 1e-10


def test_the_search_says_when_there_is_nothing_to_find() -> None:
    a = zoo.animal("pair 3", 1, affine=True)
    found = find_moving_energy(a.system)
    assert found.moving is None
    assert found.report is None
    assert found.horizontal == ()
    assert found.residual > 1e-3


def test_without_drift_the_moving_energy_is_the_energy() -> None:
    scene = gni.scenes.suslov()
    found = find_moving_energy(scene.system)
    assert found.moving is not None
    run = gni.integrate(scene.system, scene.start, step=0.05, n_steps=10)
    np.testing.assert_array_equal(moving_energy(run, found.moving).values, run.energy())


def test_points_outside_the_domain_and_of_a_wrong_shape_are_refused() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.eye(2), potential=lambda x, p: np.log(x[0])
    )
    with pytest.raises(gni.InputError, match="not finite at any"):
        symmetry_report(system, [0.0, 1.0], [[-7.0, 0.2]])
    with pytest.raises(gni.InputError, match="points must have shape"):
        symmetry_report(system, [0.0, 1.0], [[1.0, 0.2, 0.3]])
    assert symmetry_report(system, [0.0, 1.0], [[1.3, 0.2]]).holds
