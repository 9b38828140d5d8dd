"""The discrete Lagrange-d'Alembert method of [28]: equations, orders, symmetry, known facts."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import test_orders as known
import zoo

BOTH_ENDS, MIDPOINT = gni.ConstraintAtBothEnds(), gni.ConstraintAtMidpoint()
SOURCE, TARGET = gni.ConstraintAtSource(), gni.ConstraintAtTarget()
PLACES = [BOTH_ENDS, MIDPOINT, SOURCE, TARGET]
DLA = gni.DiscreteLagrangeDAlembert
SELF_ADJOINT = [
    DLA(),
    DLA(gni.Midpoint(), MIDPOINT),
    DLA(gni.Rattle(), MIDPOINT),
    DLA(gni.Midpoint(), BOTH_ENDS),
]
LOPSIDED = [DLA(gni.Rattle(), SOURCE), DLA(gni.Midpoint(), TARGET), DLA(gni.EulerA(), BOTH_ENDS)]
GROUPOIDS = [
    "pair 3", "SO3 right exp", "SE3 left cay", "atiyah left exp", "framed right cay",
    "action right cay", "product cay",
]  # fmt: skip
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def restart(a: Any, run: gni.Trajectory) -> gni.State:
    base, velocity = run.final_state
    return a.system.state(base if base.size else None, velocity)


# The equations, in plain NumPy.


def legendre(a: zoo.Animal, rule: Any, g: Any, h: float) -> tuple[Any, Any]:
    """FL-(g) and FL+(g) by differences of the discrete action."""
    space, delta = a.system.space, 4e-3

    def action(arrow: Any) -> float:
        xi = space.lift(arrow) / h
        ends = space.source(arrow), space.target(arrow)
        return h * rule.average(a.plain.lagrangian, space, *ends, xi, h)

    steps = delta * np.arange(-4, 5)
    minus, plus = [], []
    for e in np.eye(space.rank):
        shifts = [space.retract(space.source(g), s * e) for s in steps]
        values = [action(space.multiply(space.inverse(k), g)) for k in shifts]
        minus.append(-_WEIGHTS @ values / delta)
        shifts = [space.retract(space.target(g), s * e) for s in steps]
        plus.append(_WEIGHTS @ [action(space.multiply(g, k)) for k in shifts] / delta)
    return np.array(minus), np.array(plus)


def violation_on_arrow(a: zoo.Animal, place: Any, g: Any, h: float) -> Any:
    """What M_c says must vanish."""
    space = a.system.space
    xi = space.lift(g) / h
    x0, x1 = space.source(g), space.target(g)

    def at(x: Any) -> Any:
        return a.plain.constraints(x) @ (xi - a.plain.drift(x))

    if place == BOTH_ENDS:
        return (at(x0) + at(x1)) / 2
    if place == MIDPOINT:
        return at(space.target(space.retract(x0, space.half(x0, h * xi))))
    return at(x0) if place == SOURCE else at(x1)


def spanning_distribution(a: zoo.Animal, q: Any) -> Any:
    mu = a.plain.constraints(q)
    return np.linalg.svd(mu)[2][len(mu) :]


@pytest.mark.parametrize("name", GROUPOIDS)
def test_arrows_solve_the_equations_of_28_literally(name: str) -> None:
    number = GROUPOIDS.index(name)
    rule, place = [gni.Rattle(), gni.Midpoint()][number % 2], PLACES[number % 4]
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    h = 0.09
    method = DLA(rule, place)
    run = gni.integrate(a.system, a.start, step=h, n_steps=3, method=method, compile=False)
    arrived = a.start.momentum
    for k, g in enumerate(run.arrows):
        left, arriving = legendre(a, rule, g, h)
        q = run.base[k]
        allowed = spanning_distribution(a, q)
        assert len(allowed) == a.system.space.rank - 2
        np.testing.assert_allclose(allowed @ (left - arrived), 0, atol=1e-11)
        np.testing.assert_allclose(violation_on_arrow(a, place, g, h), 0, atol=1e-14)
        np.testing.assert_allclose(run.arrow_residuals()[k], 0, atol=1e-14)
        np.testing.assert_allclose(left, run.momenta_after[k], atol=1e-11)
        np.testing.assert_allclose(allowed @ (run.momenta[k] - left), 0, atol=1e-11)
        pushed = run.momenta_before[k] + h * a.plain.constraints(q).T @ run.multipliers[k]
        np.testing.assert_allclose(run.momenta_after[k], pushed, atol=1e-13)
        if k:
            np.testing.assert_allclose(run.momenta_before[k], arrived, atol=1e-11)
        arrived = arriving


@pytest.mark.parametrize(
    ("name", "place"), [("framed left cay", MIDPOINT), *(("pair 3", place) for place in PLACES)],
    ids=str,
)
def test_next_arrow_by_the_bordered_system_agrees_with_integrate(name: str, place: Any) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    method, h = DLA(gni.Rattle(), place), 0.07
    run = gni.integrate(a.system, a.start, step=h, n_steps=6, method=method, compile=False)
    for g, following in zip(run.arrows, run.arrows[1:], strict=False):
        found = gni.next_arrow(a.system, method, g, step=h)
        np.testing.assert_allclose(found, following, atol=2e-14)


@pytest.mark.slow
@pytest.mark.parametrize("place", PLACES, ids=str)
@pytest.mark.parametrize("name", zoo.SPACES)
def test_nodes_and_arrows_are_on_their_constraints_on_every_groupoid(
    name: str, place: Any
) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True, seed=11)
    if not a.system.constraint_count or name.startswith("SO4"):
        return
    run = gni.integrate(
        a.system, a.start, step=0.05, n_steps=100, method=DLA(gni.Rattle(), place)
    )
    assert np.abs(run.constraint_residuals(relative=True)).max() < 1e-13
    assert np.abs(run.arrow_residuals(relative=True)).max() < 1e-13
    for k in (0, 50, 99):
        np.testing.assert_allclose(
            violation_on_arrow(a, place, run.arrows[k], 0.05), 0, atol=1e-12
        )


# Formulas written by hand.


@pytest.mark.parametrize("place", [BOTH_ENDS, MIDPOINT], ids=str)
def test_constrained_particle_is_the_leapfrog_with_a_constrained_second_point(place: Any) -> None:
    """``m (q2 - 2 q1 + q0) = -h^2 V'(q1) + h^2 mu(q1)^T l``, z2 - z1 = (y1 + y2)/2 (x2 - x1)."""
    mass = np.array([1.3, 0.8, 1.7])
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=np.diag(mass),
        constraints=lambda x, p: np.array([[-x[1], 0.0, 1.0]]),
        potential=lambda x, p: 0.4 * (x @ x) ** 2 + 0.3 * x[0] * x[2],
    )  # fmt: skip

    def slope(q: Any) -> Any:
        return 1.6 * (q @ q) * q + 0.3 * np.array([q[2], 0.0, q[0]])

    def reached(q: Any, freely: Any) -> Any:
        # (dz + l/m_z) = (y1 + y2)/2 (dx - y1 l/m_x), which is linear in l: row y has no force
        y = (q[1] + freely[1]) / 2
        gap = y * (freely[0] - q[0]) - (freely[2] - q[2])
        force = np.array([-q[1], 0.0, 1.0]) / mass
        return freely + force * gap / (1 / mass[2] + y * q[1] / mass[0])

    h, q, v = 0.05, np.array([0.6, -0.5, 0.3]), np.array([0.4, 0.9, -0.2])
    points = [q, reached(q, q + h * v - h * h / 2 * slope(q) / mass)]
    for _ in range(40):
        last, here = points[-2:]
        points.append(reached(here, 2 * here - last - h * h * slope(here) / mass))
    start = system.state(q, v)
    run = gni.integrate(system, start, step=h, n_steps=41, method=DLA(gni.Rattle(), place))
    np.testing.assert_allclose(run.base, points, atol=1e-13)


def ball(tau: Any, inertia: float = 2 / 3, table: float = 1.0) -> gni.MechanicalSystem:
    """The homogeneous ball of 7.4.1; the radius is 0.7 where the inertia is not that of Figure 1.

    x' - r w_2 + Theta y = 0 and y' + r w_1 - Theta x = 0, equations (41).
    """
    r = 1.0 if inertia == 2 / 3 else 0.7
    return gni.MechanicalSystem(
        gni.AtiyahGroupoid(base_dim=2, group=gni.SO3(side="right", retraction=tau)),
        metric=np.diag([1.0, 1.0, inertia, inertia, inertia]),
        constraints=[[1.0, 0.0, 0.0, -r, 0.0], [0.0, 1.0, r, 0.0, 0.0]],
        drift=lambda x, p: table * np.array([-x[1], x[0], 0.0, 0.0, 0.0]),
    )


@pytest.mark.parametrize("place", [BOTH_ENDS, MIDPOINT], ids=str)
def test_ball_with_the_exponential_obeys_the_linear_recursion(place: Any) -> None:
    """``(q2 - 2 q1 + q0)/h^2 = a J (q2 - q0)/(2 h)``, ``a = I Theta / (I + m r^2)``; derived here.

    The section X = (r, 0; 0, 1, 0) of D gives m r d(x'') + I d(w_2) = 0 with the arrow's constraint
    r w_2 = x' + Theta (y1 + y2)/2; for the exponential FL+- = I w.
    """
    inertia, table, r, h = 0.37, 0.8, 0.7, 0.1
    system = ball(gni.Exponential(), inertia, table)
    start = system.state([0.6, -0.9], [0.5, 0.3, 0.2, 0.4, 0.6], project_start=True)
    method = DLA(gni.Rattle(), place)
    q = gni.integrate(system, start, step=h, n_steps=200, method=method).base
    rate = inertia * table / (inertia + r * r)
    turned = np.stack([-(q[2:, 1] - q[:-2, 1]), q[2:, 0] - q[:-2, 0]], axis=1)
    second = (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2
    np.testing.assert_allclose(second, rate * turned / (2 * h), atol=2e-12)
    assert np.abs(second).max() > 0.05


# Orders and the comparison of Figure 1.


@pytest.mark.parametrize("name", ["sleigh", "ball"])
@pytest.mark.parametrize("method", SELF_ADJOINT[:2], ids=str)
def test_sleigh_and_inhomogeneous_ball_are_second_order(name: str, method: Any) -> None:
    scene, exact = known.solved(name)
    counts = [40, 80, 160, 320]
    errors = known.end_errors(scene.system, scene.start, method, 2.0, counts, exact)
    assert known.slope(2.0 / np.array(counts), errors) == pytest.approx(2.0, abs=0.03)


@pytest.mark.parametrize(
    ("method", "order"), [(m, 2.0) for m in SELF_ADJOINT] + [(m, 1.0) for m in LOPSIDED], ids=str
)
def test_order_two_exactly_where_both_choices_are_self_adjoint(method: Any, order: float) -> None:
    system, start, exact = known.bent_solution()
    counts = [80, 160, 320, 640]
    errors = known.end_errors(system, start, method, 1.5, counts, exact)
    assert known.slope(1.5 / np.array(counts), errors) == pytest.approx(order, abs=0.06)


@pytest.mark.parametrize("method", [*SELF_ADJOINT, *LOPSIDED], ids=str)
def test_multipliers_converge_to_the_force_of_the_true_motion(method: Any) -> None:
    system, start, _ = known.bent_solution()
    n = 400
    run = gni.integrate(system, start, step=1.5 / n, n_steps=n, method=method)
    truth = gni.integrate(
        system, start, step=1.5 / n, n_steps=n, method=gni.ReferenceFlow(rtol=1e-12)
    )
    gap = np.abs(run.multipliers - truth.multipliers).max()
    assert gap < 0.02 * np.abs(truth.multipliers).max()


def position_errors(tau: Any, method: Any, steps: list[float]) -> Any:
    """Largest errors of (x, y) up to t = 10 with the numbers of Figure 1."""
    system = ball(tau)
    start = system.state([1.0, 1.0], [1.0, 1.0, 0.0, 2.0, 0.0])
    errors = []
    for h in steps:
        run = gni.integrate(system, start, step=h, t_end=10.0, method=method)
        angle = 0.4 * run.times
        turned = np.stack([np.sin(angle) + np.cos(angle), np.sin(angle) - np.cos(angle)], axis=1)
        exact = 1 + (turned - [1.0, -1.0]) / 0.4
        errors.append(np.linalg.norm(run.base - exact, axis=1).max())
    return np.array(errors)


def test_figure_1_both_methods_are_second_order_and_the_retraction_decides_who_wins() -> None:
    steps = [0.05, 0.025, 0.0125, 0.00625]
    with_exp, with_cay = (
        [position_errors(tau, method, steps) for method in (gni.Rattle(), DLA())]
        for tau in (gni.Exponential(), gni.Cayley())
    )
    for errors in (*with_exp, *with_cay):
        assert known.slope(steps, errors) == pytest.approx(2.0, abs=0.03)
    np.testing.assert_allclose(with_exp[1] / with_exp[0], 0.5, atol=0.002)
    ratio = with_cay[1] / with_cay[0]
    assert np.all((ratio > 250) & (ratio < 300))


# Without constraints; symmetry under time reversal.


@pytest.mark.parametrize("rule", [gni.Rattle(), gni.Midpoint(), gni.EulerB()], ids=str)
def test_without_constraints_it_is_the_variational_integrator_bit_for_bit(rule: Any) -> None:
    a = zoo.animal("framed left cay", 0, gyroscopic=True)
    options = {"step": 0.07, "n_steps": 30, "compile": False}
    free = gni.integrate(a.system, a.start, method=rule, **options)
    run = gni.integrate(a.system, a.start, method=DLA(rule, MIDPOINT), **options)
    np.testing.assert_array_equal(run.rows, free.rows)
    g = free.arrows[4]
    np.testing.assert_array_equal(
        gni.next_arrow(a.system, DLA(rule), g, step=0.07),
        gni.next_arrow(a.system, rule, g, step=0.07),
    )


def there_and_back(a: zoo.Animal, method: Any, adjoint: Any) -> float:
    there = gni.integrate(a.system, a.start, step=0.06, n_steps=20, method=method, compile=False)
    back = gni.integrate(
        a.system, restart(a, there), step=-0.06, n_steps=20, method=adjoint, compile=False
    )
    assert np.abs(there.velocities[-1] - a.start.velocity).max() > 0.02
    gaps = [back.base[-1] - a.start.base, back.velocities[-1] - a.start.velocity]
    return float(np.abs(np.concatenate(gaps)).max())


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("pair 3", SELF_ADJOINT[0]),
        ("framed left cay", SELF_ADJOINT[1]),
        ("SE3 right cay", SELF_ADJOINT[2]),
        ("atiyah right cay", SELF_ADJOINT[3]),
    ],
    ids=str,
)
def test_self_adjoint_choices_return_when_run_backwards(name: str, method: Any) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    assert there_and_back(a, method, method) < 2e-13


@pytest.mark.parametrize("rule", [gni.EulerA(), gni.Rattle()], ids=str)
def test_the_adjoint_has_the_adjoint_of_both_choices(rule: Any) -> None:
    a = zoo.animal("action right cay", 2, affine=True, gyroscopic=True)
    assert there_and_back(a, DLA(rule, SOURCE), DLA(rule.adjoint(), TARGET)) < 2e-13
    assert there_and_back(a, DLA(rule, SOURCE), DLA(rule, SOURCE)) > 1e-4


# What is known of the method.


@pytest.mark.parametrize("tau", [gni.Cayley(), gni.Exponential()])
def test_suslov_body_turns_steadily_about_axes_normal_to_a_principal_axis(tau: Any) -> None:
    """For a constraint along a principal axis omega is constant, and for a ball always."""
    for inertia, row in (([0.8, 1.3, 1.9], [0.0, 0.0, 1.0]), ([1.3] * 3, [0.4, -0.3, 1.0])):
        body = gni.MechanicalSystem(
            gni.SO3(retraction=tau), metric=np.diag(inertia), constraints=[row]
        )
        start = body.state(velocity=[0.9, -0.5, 0.4], project_start=True)
        run = gni.integrate(body, start, step=0.2, n_steps=300, method=DLA())
        arrows = run.rows[1:, run.layout.size : -1]
        np.testing.assert_allclose(arrows - arrows[0], 0.0, atol=2e-13)
        np.testing.assert_allclose(run.velocities - start.velocity, 0.0, atol=2e-13)


def test_momentum_of_a_horizontal_symmetry_is_kept() -> None:
    """A symmetry of L_d with values in D, whatever M_c does (Cortes and Martinez; [28], 3.7)."""
    particle = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=[[1.3, 0.2, 0.1], [0.2, 0.8, -0.3], [0.1, -0.3, 1.7]],
        constraints=lambda x, p: np.array([[-np.sin(x[1]), 0.0, 1.0]]),
        drift=lambda x, p: np.array([0.0, 0.0, 0.3 * x[0]]),
        potential=lambda x, p: 0.7 * x[0] ** 4 + 0.4 * x[0] * x[2] + 0.5 * x[2] ** 2,
    )  # fmt: skip
    start = particle.state([0.6, -0.5, 0.3], [0.4, 0.9, 0.2], project_start=True)
    for method in (SELF_ADJOINT[0], SELF_ADJOINT[1], LOPSIDED[0]):
        run = gni.integrate(particle, start, step=0.1, n_steps=200, method=method)
        for p in (run.momenta_before, run.momenta_after):
            np.testing.assert_allclose(p[:, 1], start.momentum[1], atol=1e-13)
        # nonlinear in the impulse, the only unknown here: it was iterated to the end
        assert np.abs(run.arrow_residuals()).max() < 1e-14
    rolling = ball(gni.Cayley(), 0.37, 0.8)
    start = rolling.state([0.6, -0.9], [0.5, 0.3, 0.2, 0.4, 0.6], project_start=True)
    run = gni.integrate(rolling, start, step=0.05, n_steps=200, method=DLA())
    np.testing.assert_allclose(run.momenta[:, 4], 0.37 * 0.6, atol=1e-13)


def test_sleigh_settles_on_the_straight_line_where_the_two_step_scheme_is_reversed() -> None:
    scene = gni.scenes.chaplygin_sleigh(1.0, 1.0, 0.3, spin=1.5, speed=-1.0)
    steps, losses = [0.1, 0.05, 0.025], []
    for h in steps:
        run = gni.integrate(scene.system, scene.start, step=h, t_end=60.0, method=DLA())
        assert run.velocities[-1] == pytest.approx([0.0, 1.858, 0.0], abs=0.01)
        losses.append(abs(run.energy()[-1] / run.energy()[0] - 1))
    assert known.slope(steps, losses) == pytest.approx(2.0, abs=0.03)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        run = gni.integrate(scene.system, scene.start, step=0.1, t_end=60.0, method=gni.Rattle())
    assert run.velocities[-1][1] < -1.0


# The driver.


@pytest.mark.parametrize(
    ("name", "place"),
    [("pair 3", SOURCE), ("SE2 right exp", TARGET), ("atiyah right cay", BOTH_ENDS)],
    ids=str,
)
def test_casadi_evaluator_agrees_with_machine_code(name: str, place: Any) -> None:
    a = zoo.animal(name, 2, affine=True, gyroscopic=True)
    options = {"step": 0.02, "n_steps": 100, "method": DLA(gni.Rattle(), place)}
    machine = gni.integrate(a.system, a.start, **options)
    evaluator = gni.integrate(a.system, a.start, **options, compile=False)
    width = machine.rows.shape[1] - 1
    np.testing.assert_allclose(machine.rows[1:, :width], evaluator.rows[1:, :width], atol=1e-12)


def test_saving_less_and_cutting_into_chunks_do_not_change_a_bit() -> None:
    scene, _ = known.solved("ball")
    options = {"step": 0.01, "n_steps": 2500, "method": DLA()}
    every = gni.integrate(scene.system, scene.start, **options)
    some = gni.integrate(scene.system, scene.start, **options, save_every=7)
    state = slice(0, every.layout.size)
    np.testing.assert_array_equal(some.rows[:, state], every.rows[some.node_steps, state])


def test_a_run_goes_on_from_its_final_state() -> None:
    a = zoo.animal("atiyah right cay", 2, affine=True, gyroscopic=True)
    options: dict[str, Any] = {"step": 0.06, "method": DLA(), "compile": False}
    whole = gni.integrate(a.system, a.start, n_steps=24, **options)
    half = gni.integrate(a.system, a.start, n_steps=12, **options)
    rest = gni.integrate(a.system, restart(a, half), n_steps=12, **options)
    np.testing.assert_allclose(rest.base, whole.base[12:], atol=1e-13)
    np.testing.assert_allclose(rest.momenta_after, whole.momenta_after[12:], atol=1e-13)


def test_reconstruction_in_the_loop_is_reconstruction_afterwards(tmp_path: Path) -> None:
    a = zoo.animal("SE3 right cay", 2, affine=True)
    options: dict[str, Any] = {"step": 0.05, "n_steps": 60, "method": DLA(), "compile": False}
    run = gni.integrate(a.system, a.start, **options)
    inside = gni.integrate(a.system, a.start, **options, reconstruct=True)
    np.testing.assert_allclose(run.reconstruct(), inside.reconstruct(), atol=1e-13)
    again = gni.Trajectory.load(run.save(tmp_path / "run"), a.system)
    np.testing.assert_array_equal(again.arrow_residuals(), run.arrow_residuals())
    np.testing.assert_array_equal(again.momenta, run.momenta)
    assert " at nodes, " in run.summary()
    assert "DiscreteLagrangeDAlembert(Rattle(), ConstraintAtBothEnds())" in run.summary()


def test_a_dependent_row_is_left_out_and_checked_without_false_alarm() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), metric=np.diag([1.3, 0.7, 0.9]),
        constraints=lambda x, p: np.array([[-x[1], 0.2, 1.0], [2 * x[1], -0.4, -2.0]]),
        potential=lambda x, p: np.cos(x[0]) + x[1] ** 4,
    )  # fmt: skip
    with pytest.warns(gni.DependentConstraintsWarning):
        start = system.state([0.1, 0.2, 0.3], [1.0, -0.4, 0.5], project_start=True)
    run = gni.integrate(system, start, step=0.05, n_steps=200, method=DLA())
    assert run.success
    assert np.abs(run.constraint_residuals(relative=True)).max() < 1e-13
    assert run.multipliers.shape == (201, 2)
    assert run.arrow_residuals(relative=True).shape == (201, 1)


def test_a_fully_constrained_system_follows_its_drift() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(1), metric=[[1.3]], constraints=[[0.7]],
        drift=lambda x, p: np.array([0.4 * x[0]]), potential=lambda x, p: x[0] ** 2,
    )  # fmt: skip
    h = 0.05
    run = gni.integrate(system, system.state([0.2], [0.08]), step=h, n_steps=50, method=DLA())
    growth = (1 + 0.2 * h) / (1 - 0.2 * h)  # the trapezoidal rule
    np.testing.assert_allclose(run.base[:, 0], 0.2 * growth ** np.arange(51), rtol=1e-12)


def test_a_first_arrow_beyond_the_retraction_fails_in_step_one_with_the_start_kept() -> None:
    body = gni.MechanicalSystem(
        gni.SO3(), np.diag([1.3, 0.7, 0.9]), constraints=[[0.3, -0.2, 1.0]]
    )
    start = body.state(velocity=[3.0, 20.0, 3.1])
    options: dict[str, Any] = {"step": 0.3, "n_steps": 5, "method": DLA()}
    with pytest.raises(gni.StepFailure, match=r"half a turn .*Failed in step 1 of 5"):
        gni.integrate(body, start, **options)
    run = gni.integrate(body, start, **options, on_failure="return")
    assert run.outcome is gni.Outcome.LEFT_DOMAIN
    assert len(run) == 1
    np.testing.assert_array_equal(run.momenta, [start.momentum])


def test_a_rank_drop_on_the_way_is_told_as_such() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), np.diag([1.3, 0.7, 0.9]),
        constraints=lambda x, p: np.array([[0.0, 1.0, 0.2], [0.0, 1.0, 1.2 - x[0]]]),
    )  # fmt: skip
    start = system.state([0.0, 0.1, -0.1], [1.0, 0.0, 0.0])
    for compile in (True, False):
        run = gni.integrate(
            system, start, step=0.05, n_steps=60, method=DLA(), compile=compile,
            on_failure="return",
        )  # fmt: skip
        assert run.outcome is gni.Outcome.CONSTRAINTS_SINGULAR
        assert run.node_steps[-1] == 19


# Bad requests.


def test_choices_of_a_wrong_kind_are_refused() -> None:
    with pytest.raises(gni.InputError, match=r"takes a discrete Lagrangian such as gni.Rattle\(\)"):
        DLA("rattle")  # type: ignore[arg-type]
    with pytest.raises(gni.InputError, match=r"takes a discrete Lagrangian"):
        DLA(gni.Rattle)  # type: ignore[arg-type]
    for wrong in ("midpoint", gni.Midpoint(), gni.ConstraintAtMidpoint, None):
        with pytest.raises(gni.InputError, match=r"such as gni.ConstraintAtBothEnds\(\), not"):
            DLA(constraint=wrong)  # type: ignore[arg-type]


def test_misplaced_requests_are_refused() -> None:
    a = zoo.animal("pair 3", 1)
    with pytest.raises(gni.InputError, match="is the class DiscreteLagrangeDAlembert; pass an ins"):
        gni.integrate(a.system, a.start, step=0.1, n_steps=2, method=DLA)  # type: ignore[arg-type]
    with pytest.raises(gni.InputError, match=r"or gni.DiscreteLagrangeDAlembert\(...\), got GNI"):
        gni.next_arrow(a.system, gni.GNI(), np.zeros(6), step=0.1)  # type: ignore[arg-type]
    run = gni.integrate(a.system, a.start, step=0.1, n_steps=2, compile=False)
    with pytest.raises(gni.InputError, match=r"has no on_arrow: GNI\(order=2\) does not store it"):
        run.arrow_residuals()
