"""The modified energy is kept to round-off where its hypotheses hold, and refused elsewhere."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gearboxes import NOT_REVERSIBLE, gearbox

import groupoid_gni as gni
from groupoid_gni.diagnostics import modified_energy

METRIC = np.diag([1.3, 0.8, 1.1]) + 0.1
FLOW = {rule: gni.GNI(flow=gni.Variational(rule)) for rule in (gni.Rattle(), gni.Midpoint())}


def quadratic(**options: Any) -> tuple[gni.MechanicalSystem, gni.State]:
    chosen = {"stiffness": (1.0, 0.7, 2.0), "quartic": 0.0, "driver": False, **options}
    return gearbox(NOT_REVERSIBLE, **chosen)


def run_of(pair: tuple[gni.MechanicalSystem, gni.State], method: Any, h: float, n: int) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(*pair, step=h, n_steps=n, method=method, save_every=max(1, n // 2000))


@pytest.mark.parametrize("h", [0.05, 0.13, 0.25])
@pytest.mark.parametrize("method", [gni.Rattle(), FLOW[gni.Rattle()], FLOW[gni.Midpoint()]])
def test_it_is_flat_over_a_hundred_thousand_steps_without_reversibility(
    method: Any, h: float
) -> None:
    run = run_of(quadratic(metric=METRIC), method, h, 100_000)
    values = modified_energy(run).values
    assert np.ptp(values) < 3e-9 * values[0]
    if "Midpoint" not in str(method):
        assert np.ptp(run.energy()) > 1e-4 * h * values[0]


def test_round_off_grows_like_the_square_root_of_the_steps_for_a_unit_mass() -> None:
    run = run_of(quadratic(), gni.Rattle(), 0.1, 400_000)
    growth = gni.diagnostics.roundoff_growth(run, modified_energy(run).values)
    assert growth.exponent == pytest.approx(0.5, abs=0.2)


def test_it_is_the_formula_of_the_theorem_at_both_momenta() -> None:
    h = 0.17
    run = run_of(quadratic(metric=METRIC), gni.Rattle(), h, 300)
    K = np.diag([1.0, 0.7, 2.0])
    inverse = np.linalg.inv(METRIC)
    force = run.base @ K + np.array([0.0, 0.27 * 0.7, 0.0])
    potential = np.einsum("ni,ij,nj->n", run.base, K, run.base) / 2 + 0.27 * 0.7 * run.base[:, 1]
    correction = h**2 / 8 * np.einsum("ni,ij,nj->n", force, inverse, force)
    for p in (run.momenta_before, run.momenta_after):
        kinetic = np.einsum("ni,ij,nj->n", p, inverse, p) / 2
        np.testing.assert_allclose(
            modified_energy(run).values, kinetic + potential - correction, rtol=1e-12
        )


@pytest.mark.parametrize("rule", [gni.EulerA(), gni.EulerB()])
def test_the_other_flows_keep_one_when_all_directions_have_one_frequency(rule: Any) -> None:
    method = gni.GNI(flow=gni.Variational(rule))
    # driver=False leaves a uniform force along y as well
    run = run_of(quadratic(stiffness=(1.3, 1.3, 1.3)), method, 0.2, 20_000)
    values = modified_energy(run).values
    assert np.ptp(values) < 1e-10 * values[0]
    assert np.ptp(run.energy()) > 1e-3
    with pytest.raises(gni.InputError, match=r"K = w\^2 M, which fails by"):
        modified_energy(run_of(quadratic(), method, 0.2, 10))


def test_it_holds_on_a_product_with_a_group_of_bi_invariant_metric() -> None:
    space = gni.AtiyahGroupoid(base_dim=2, group=gni.SO3(side="right"))

    def system(moments: list[float], h: float = 0.2) -> Any:
        made = gni.MechanicalSystem(
            space,
            metric=np.diag([1.7, 1.7, *moments]),
            constraints=lambda x, p: gni.array(
                [[1.0, 0.0, 0.0, -0.8 - 0.3 * x[1], 0.0], [0.0, 1.0, 0.8, 0.2 * x[0], 0.0]]
            ),
            potential=lambda x, p: 0.6 * x[0] ** 2 + 0.4 * x[0] * x[1] + 0.9 * x[1] ** 2,
        )
        start = made.state([0.7, -0.4], [0.3, 0.2, 0.5, 0.4, 0.6], project_start=True)
        return run_of((made, start), gni.Rattle(), h, 4000)

    run = system([0.6, 0.6, 0.6])
    values = modified_energy(run).values
    assert np.ptp(values) < 1e-11 * values[0]
    assert np.ptp(run.energy()) > 1e-3
    with pytest.raises(gni.InputError, match="ad-invariant"):
        modified_energy(system([0.6, 0.9, 0.7]))


def simple(space: gni.LieGroupoid, potential: Any, metric: Any = None, **terms: Any) -> Any:
    r = space.rank
    system = gni.MechanicalSystem(
        space, metric=np.eye(r) if metric is None else metric,
        constraints=np.eye(1, r) + 0.3, potential=potential, **terms,
    )
    x = np.array(space.example_base_point)
    start = system.state(x, 0.4 * np.ones(r), project_start=True)
    return gni.integrate(system, start, step=0.05, n_steps=8, method=gni.Rattle())


def test_every_hypothesis_that_fails_is_named() -> None:
    plane, spring = gni.PairGroupoid(2), lambda x, p: 0.7 * x[0] ** 2 + 0.4 * x[1] ** 2
    cases = [
        ("a quadratic potential", simple(plane, lambda x, p: x[0] ** 4 + 0.1 * x[1])),
        ("a constant metric", simple(
            plane, spring, lambda x, p: np.diag(gni.array([1.0 + x[1] ** 2, 1.0])))),
        ("linear constraints", simple(plane, spring, drift=[0.3, 0.1])),
        ("no gyroscopic term", simple(plane, spring, gyroscopic=lambda x, p: gni.array(
            [0.2 * x[1], 0.0]))),
    ]
    body = gni.scenes.veselova((1.3, 1.3, 1.3), weight=(0.2, 0.1, 0.3))
    tilted = gni.integrate(body.system, body.start, step=0.05, n_steps=8, method=gni.Rattle())
    cases.append(("straight targets", tilted))
    for statement, run in cases:
        with pytest.raises(gni.InputError, match=statement):
            modified_energy(run)


def test_a_method_without_one_is_refused() -> None:
    run = run_of(quadratic(), gni.EulerB(), 0.1, 10)
    with pytest.raises(gni.InputError, match=r"no exact modified energy is known for EulerB\(\)"):
        modified_energy(run)
