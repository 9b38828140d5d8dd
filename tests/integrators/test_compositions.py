"""Steps made of several stages: what is saved, where they stop, and the bare stages."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import default_table
from groupoid_gni.integrators import compiled_step
from groupoid_gni.integrators.preparation import Starts, prepare

METHODS = [
    gni.GNI(4),
    gni.GNI(6, flow=gni.EnergyPreserving()),
    gni.GNI(4, projection=None),
    gni.GNI(8, flow=gni.Splitting(), projection=None),
    gni.McLachlanPerlmutter(4),
]


def ball() -> gni.scenes.Scene:
    return gni.scenes.inhomogeneous_ball(1.7, 0.9, (0.9, 0.5, 0.7), 0.8, (0.6, -0.2), (0.3, 0.5))


def run(scene: Any, method: Any, **options: Any) -> gni.Trajectory:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(
            scene.system, scene.start, method=method, **{"step": 0.1, "n_steps": 20, **options}
        )


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_machine_code_and_expressions_agree(method):
    fast, slow = run(ball(), method), run(ball(), method, compile=False)
    np.testing.assert_allclose(fast.base, slow.base, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fast.momenta, slow.momenta, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_saving_less_changes_nothing(method):
    full, thin = run(ball(), method), run(ball(), method, save_every=6)
    np.testing.assert_array_equal(thin.node_steps, [0, 6, 12, 18, 20])
    np.testing.assert_array_equal(thin.momenta, full.momenta[[0, 6, 12, 18, 20]])


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_a_run_cut_inside_a_step_goes_on_with_the_same_bits(method):
    scene = ball()
    runner = compiled_step(scene.system, method, scene.start.active_rows)
    starts = Starts.of(scene.system, [scene.start], None)
    members = prepare(scene.system, runner, starts, 0.1, None)
    parameters, state = members.parameters[:, 0], members.states[:, 0]
    stages = runner.program.stages
    begin = runner.begin(parameters, state)
    whole, rows, _ = runner.advance(parameters, begin, 4 * stages, stages)
    here, pieces = begin, []
    for count in (stages + 1, 1, stages - 1, 2 * stages - 1):
        here, piece, _ = runner.advance(parameters, here, count, stages)
        pieces.append(piece)
    np.testing.assert_array_equal(np.concatenate(pieces), rows)
    np.testing.assert_array_equal(here.memory, whole.memory)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_poses_are_accumulated_over_all_stages(method):
    scene = gni.scenes.chaplygin_sleigh(1.3, 0.8, 0.35, 1.1, -0.6)
    fine = run(scene, gni.GNI(8), step=0.025, n_steps=80, reconstruct=True)
    coarse = run(scene, method, step=0.05, n_steps=40, reconstruct=True)
    np.testing.assert_allclose(
        coarse.reconstruct()[-1], fine.reconstruct()[-1], rtol=0, atol=1e-6
    )
    with pytest.raises(gni.InputError, match="reconstruct=W0"):
        _ = coarse.arrows


@pytest.mark.parametrize(
    ("scene", "pieces"),
    [(ball(), 2), (gni.scenes.veselova(weight=(0.3, 0.2, -0.4)), 4)],
    ids=["nothing acts", "a weight acts"],
)
def test_equal_pieces_of_the_energy_preserving_flight_are_stored_as_arrows(scene, pieces):
    method = gni.GNI(flow=gni.EnergyPreserving())
    bare, carried = run(scene, method), run(scene, method, reconstruct=True)
    assert bare.flights == pieces
    np.testing.assert_allclose(bare.reconstruct(), carried.reconstruct(), rtol=0, atol=1e-13)


def falling(strength: float = 0.4) -> gni.scenes.Scene:
    """Accelerates without bound: every step size becomes too large after a while."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=np.diag([1.3, 0.8, 0.6]),
        constraints=lambda x, p: np.array([[0.3, -0.2 * x[0], 1.0]]),
        potential=lambda x, p: -p.k * (x @ x) ** 3, parameters={"k": strength},
    )
    start = system.state([1.1, -0.7, 0.2], [0.1, 0.2, 0.3], project_start=True)
    return gni.scenes.Scene(system, start, "falling outwards")


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("method", [gni.GNI(4), gni.GNI(6, projection=None)], ids=str)
def test_a_failure_inside_a_step_keeps_the_whole_steps_before_it(method, every):
    broken = run(falling(), method, step=0.02, n_steps=400, save_every=every, on_failure="return")
    assert not broken.success
    last = int(broken.node_steps[-1])
    assert 0 < last < 400
    assert f"Failed in step {last + 1} of 400" in broken.message
    again = run(falling(), method, step=0.02, n_steps=last, save_every=every)
    np.testing.assert_array_equal(again.momenta, broken.momenta)
    np.testing.assert_array_equal(again.node_steps, broken.node_steps)


def test_without_constraints_no_stages_are_paired():
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2), metric=np.diag([1.3, 0.7]),
        potential=lambda x, p: 0.25 * (x @ x) ** 2 + 0.1 * x[0],
    )
    free = compiled_step(system, gni.GNI(6, projection=None), ())
    assert free.program.fractions == default_table(6, projected=True).stages


def test_a_table_of_ones_own_is_used_and_checked():
    third = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    jump = gni.CompositionTable(
        "triple jump", 4, (third, 1.0 - 2.0 * third, third), "Yoshida 1990", projected=True
    )
    method = gni.GNI(4, table=jump)
    assert method.fractions == jump.stages
    assert str(method) == "GNI(order=4, table='triple jump')"
    errors = []
    truth = run(ball(), gni.GNI(8), n_steps=40, step=0.05).velocities[-1]
    for n in (20, 40):
        errors.append(np.max(np.abs(
            run(ball(), method, n_steps=n, step=2.0 / n).velocities[-1] - truth
        )))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)
    with pytest.raises(gni.InputError, match="of order 4, not order=6"):
        gni.GNI(6, table=jump)
    with pytest.raises(gni.InputError, match="projection=SymmetricProjection"):
        gni.GNI(4, projection=None, table=jump)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"order": 5}, "orders are 2, 4, 6, 8"),
        ({"flow": "splitting"}, "flow must be a free flight"),
        ({"projection": True}, "projection must be SymmetricProjection() or None"),
        ({"table": (0.5, 0.5)}, "table must be a CompositionTable"),
    ],
)
def test_options_that_do_not_exist_are_refused(options, words):
    with pytest.raises(gni.InputError) as caught:
        gni.GNI(**options)
    assert words in str(caught.value)


# ---------------------------------------------------------------- bare stages


@pytest.mark.parametrize("order", [2, 4, 6])
def test_bare_steps_leave_the_constraint_at_their_order_only(order):
    scene, sizes = ball(), []
    counts = [8, 16, 32] if order > 2 else [32, 64, 128]
    for n in counts:
        result = run(scene, gni.GNI(order, projection=None), step=2.0 / n, n_steps=n)
        sizes.append(np.max(np.abs(result.constraint_residuals())))
    slope = -np.polyfit(np.log(counts), np.log(sizes), 1)[0]
    assert slope > order - 0.4
    projected = run(scene, gni.GNI(order), step=0.1)
    assert np.max(np.abs(projected.constraint_residuals(relative=True))) < 1e-15


@pytest.mark.parametrize("order", [2, 4])
def test_bare_steps_warn_of_the_parasitic_mode_where_the_motion_contracts(order):
    scene = gni.scenes.chaplygin_sleigh()
    with pytest.warns(gni.ParasiticModeWarning, match="should not be trusted"):
        gni.integrate(
            scene.system, scene.start, step=0.1, t_end=60.0,
            method=gni.GNI(order, projection=None),
        )
    safe = gni.integrate(scene.system, scene.start, step=0.1, t_end=60.0, method=gni.GNI(order))
    assert safe.velocities[-1, 1] > 0.0


def test_the_record_of_a_bare_run_is_the_normal_part_of_its_nodes():
    scene = ball()
    result = run(scene, gni.GNI(4, projection=None), step=0.2)
    node = normal_projector(scene, result.base[-1])
    rest = node @ (result.momenta[-1] - pi(scene, result.base[-1]))
    metric = scene.system.evaluate("metric", result.base[-1])
    size = np.sqrt(rest @ np.linalg.solve(metric, rest))
    speed = result.velocities[-1] @ metric @ result.velocities[-1]
    assert result.parasitic_amplitude[-1] == pytest.approx(size / np.sqrt(speed), rel=1e-6)
    assert result.parasitic_maximum[-1] >= result.parasitic_amplitude[-1] > 0.0


def pi(scene: Any, x: Any) -> Any:
    return scene.system.evaluate("metric", x) @ scene.system.evaluate("drift", x)


def normal_projector(scene: Any, x: Any) -> Any:
    """Q* by explicit inverses."""
    inverse = np.linalg.inv(scene.system.evaluate("metric", x))
    mu = scene.system.evaluate("constraints", x)
    return mu.T @ np.linalg.inv(mu @ inverse @ mu.T) @ mu @ inverse


# ---------------------------------------------------------------- McLachlan and Perlmutter


def test_on_r_n_the_method_of_mclachlan_and_perlmutter_is_their_equation():
    """Equation (4.18): drift, kick with the constraint force of the middle, drift."""
    turning = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=np.diag([1.3, 0.8, 1.1]),
        constraints=lambda x, p: np.array([[1.0, 0.3 * x[2], -np.sin(x[1])]]),
        potential=lambda x, p: 0.3 * (x @ x) ** 2 + 0.2 * x[0] * x[2],
    )
    start = turning.state([0.5, -0.4, 0.3], [0.2, 0.6, -0.3], project_start=True)
    h = 0.1
    step = gni.integrate(
        turning, start, step=h, n_steps=1, method=gni.McLachlanPerlmutter()
    )
    mass = np.array([1.3, 0.8, 1.1])
    x, v = step.base, step.velocities
    middle = x[0] + h / 2 * v[0]
    force = -1.2 * (middle @ middle) * middle - 0.2 * np.array([middle[2], 0.0, middle[0]])
    row = np.array([1.0, 0.3 * middle[2], -np.sin(middle[1])])
    push = mass * (v[1] - v[0]) - h * force
    np.testing.assert_allclose(push, row * push[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(x[1], middle + h / 2 * v[1], rtol=0, atol=1e-15)
    end = np.array([1.0, 0.3 * x[1, 2], -np.sin(x[1, 1])])
    assert abs(end @ v[1]) < 1e-15
