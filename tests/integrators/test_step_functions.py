"""One step as a CasADi function: the step of ``integrate``, with exact derivatives."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

STEP = 0.13
SPLITTING = gni.Splitting()
KEEPING = gni.EnergyPreserving()
CASES = {
    "pair 3, linear, order 2": ("pair 3", gni.GNI(), {}),
    "pair 3, affine, order 4": ("pair 3", gni.GNI(order=4), {"affine": True}),
    "pair 3, gyroscopic": ("pair 3", gni.GNI(), {"affine": True, "gyroscopic": True}),
    "pair 3, bare": ("pair 3", gni.GNI(order=4, projection=None), {"affine": True}),
    "pair 3, explicit kicks": ("pair 3", gni.GNI(flow=SPLITTING), {"curved": False}),
    "pair 3, Rattle": ("pair 3", gni.Rattle(), {"affine": True}),
    "pair 3, one row": ("pair 3", gni.GNI(flow=gni.Variational(gni.Midpoint())), {"m": 1}),
    "SO3, order 2": ("SO3 left cay", gni.GNI(), {}),
    "SO3, order 6": ("SO3 left cay", gni.GNI(order=6, flow=SPLITTING), {"affine": True}),
    "SO3, energy kept, order 4": ("SO3 right exp", gni.GNI(order=4, flow=KEEPING), {}),
    "SE2, order 4": ("SE2 right exp", gni.GNI(order=4), {"affine": True}),
    "SE2, energy kept": ("SE2 right exp", gni.GNI(flow=KEEPING), {"affine": True}),
    "SE2, McLachlan": ("SE2 left cay", gni.McLachlanPerlmutter(order=4), {"affine": True}),
    "SE3, McLachlan": ("SE3 left cay", gni.McLachlanPerlmutter(), {"affine": True}),
    "atiyah, order 2": ("atiyah right cay", gni.GNI(), {"affine": True, "curved": False}),
    "atiyah, free": ("atiyah left exp", gni.GNI(order=4), {"m": 0, "curved": False}),
    "action, order 2": ("action left cay", gni.GNI(), {"curved": False}),
    "framed, bare": ("framed left exp", gni.GNI(projection=None), {"curved": False}),
}
WEIGHTS = dict(
    zip((-4, -3, -2, -1, 1, 2, 3, 4),
        (1 / 280, -4 / 105, 1 / 5, -4 / 5, 4 / 5, -1 / 5, 4 / 105, -1 / 280), strict=True)
)  # fmt: skip


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def case(name: str) -> tuple[gni.MechanicalSystem, gni.State, Any]:
    space, method, options = CASES[name]
    animal = zoo.animal(space, **{"m": 2, **options})
    return animal.system, animal.start, method


def skate() -> tuple[gni.MechanicalSystem, gni.State]:
    """A blade with a motor, a rudder and friction, on a slope: R^2 x SO(2) in coordinates."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        lambda x, p: np.array(
            [
                [p.m, 0.0, -0.3 * np.sin(x[2])],
                [0.0, p.m, 0.3 * np.cos(x[2])],
                [-0.3 * np.sin(x[2]), 0.3 * np.cos(x[2]), 0.8],
            ]
        ),
        constraints=lambda x, p: np.array([[-np.sin(x[2]), np.cos(x[2]), 0.0]]),
        potential=lambda x, p: p.slope * np.sin(x[0]),
        force=lambda x, xi, p, u: np.array(
            [u[0] * np.cos(x[2]), u[0] * np.sin(x[2]), u[1] - p.friction * xi[2]]
        ),
        controls=2,
        parameters={"m": 1.7, "slope": 0.6, "friction": 0.35},
    )
    return system, system.state([0.3, -0.2, 0.7], [0.9 * np.cos(0.7), 0.9 * np.sin(0.7), -0.6])


def columns(values: Any) -> np.ndarray:
    """DM outputs as one flat array."""
    return np.concatenate([np.array(value).ravel() for value in values])


def difference(function: Any, at: np.ndarray, size: float = 2e-3) -> np.ndarray:
    """Jacobian by central differences of order 8."""
    rows = []
    for k in range(len(at)):
        moved = [(w, at + j * size * np.eye(len(at))[k]) for j, w in WEIGHTS.items()]
        rows.append(sum(w * function(place) for w, place in moved) / size)
    return np.array(rows).T


def jacobian(function: ca.Function, arguments: dict[str, Any]) -> np.ndarray:
    """d(outputs)/d(all inputs)."""
    blocks = function.jacobian()(**arguments)
    rows = [
        np.hstack([np.array(blocks[f"jac_{o}_{i}"]) for i in function.name_in()])
        for o in function.name_out()
    ]
    return np.vstack(rows)


@pytest.mark.parametrize("name", CASES)
def test_a_step_function_does_the_steps_of_integrate(name: str) -> None:
    system, start, method = case(name)
    step = gni.step_function(system, method, active_rows=start.active_rows)
    run = gni.integrate(system, start, step=STEP, n_steps=4, method=method, compile=False)
    x, p = run.base[0], run.momenta_after[0]
    for k in range(4):
        x, p = step(x, p, [], system.parameter_vector, STEP)
        np.testing.assert_allclose(columns([x]), run.base[k + 1], rtol=0, atol=2e-14)
        np.testing.assert_allclose(columns([p]), run.momenta_after[k + 1], rtol=0, atol=2e-14)


@pytest.mark.parametrize("name", ["pair 3, affine, order 4", "SE2, McLachlan", "SO3, order 6"])
def test_jacobians_are_those_of_central_differences(name: str) -> None:
    system, start, method = case(name)
    step = gni.step_function(system, method)
    theta = system.parameter_vector
    at = np.concatenate([start.base, start.momentum, theta, [STEP]])
    cuts = np.cumsum([len(start.base), len(start.momentum), 0, len(theta)])

    def taken(flat: np.ndarray) -> np.ndarray:
        return columns(step(*np.split(flat, cuts)))

    exact = jacobian(step, dict(zip(step.name_in(), np.split(at, cuts), strict=True)))
    np.testing.assert_allclose(exact, difference(taken, at), rtol=0, atol=2e-11)
    assert np.max(np.abs(exact[:, -1])) > 1e-3, "the step size matters"


def momentum_of_velocity(system: gni.MechanicalSystem) -> ca.Function:
    """(x, xi, parameters) -> p."""
    sizes = (system.space.base_size, system.space.rank, system.parameter_vector.size)
    x, xi, theta = (ca.SX.sym("s", size) for size in sizes)
    expressions = SystemExpressions(system, tuple(range(system.constraint_count)))
    return ca.Function("momentum", [x, xi, theta], [expressions.momentum(x, xi, theta)])


@pytest.mark.parametrize(
    "method", [gni.GNI(), gni.GNI(order=4), gni.McLachlanPerlmutter()], ids=str
)
def test_derivatives_by_controls_parameters_and_step_are_those_of_integrate(method: Any) -> None:
    system, start = skate()
    at = np.array([0.7, -0.4, 1.7, 0.6, 0.35, STEP])

    def run(flat: np.ndarray) -> np.ndarray:
        changed = system.with_parameters(m=flat[2], slope=flat[3], friction=flat[4])
        options = {"step": flat[5], "n_steps": 1, "controls": flat[:2], "method": method}
        moved = gni.integrate(changed, start, **options)
        return np.concatenate([moved.base[1], moved.momenta[1]])

    symbols = ca.MX.sym("at", 6)
    u, theta, h = symbols[:2], symbols[2:5], symbols[5]
    # the velocity of the start is kept when the mass changes
    p = momentum_of_velocity(system)(start.base, start.velocity, theta)
    ends = ca.vertcat(*gni.step_function(system, method)(start.base, p, u, theta, h))
    slope = ca.Function("slope", [symbols], [ca.jacobian(ends, symbols)])(at)
    np.testing.assert_allclose(np.array(slope), difference(run, at), rtol=0, atol=2e-11)


def test_derivatives_of_a_two_step_method_by_later_controls_are_those_of_integrate() -> None:
    system, start = skate()
    first, then = np.array([0.7, -0.4]), np.array([-0.2, 0.9])

    def run(second: np.ndarray) -> gni.Trajectory:
        controls = [first, second]
        return gni.integrate(
            system, start, step=STEP, n_steps=2, controls=controls, method=gni.Rattle()
        )

    step = gni.step_function(system, gni.Rattle())
    inputs = dict(zip(step.name_in(), (
        run(then).base[1], run(then).momenta_after[1], then, system.parameter_vector, STEP
    ), strict=True))  # fmt: skip
    slope = jacobian(step, inputs)[:, 6:8]
    expected = difference(
        lambda u: np.concatenate([run(u).base[2], run(u).momenta_after[2]]), then
    )
    np.testing.assert_allclose(slope, expected, rtol=0, atol=2e-11)


def test_second_derivatives_are_those_of_differences_of_gradients() -> None:
    system, start = skate()
    step = gni.step_function(system)
    at = np.concatenate([start.base, start.momentum, [0.7, -0.4], [1.7, 0.6, 0.35], [STEP]])
    y = ca.MX.sym("y", len(at))
    ends = ca.vertcat(*step(y[:3], y[3:6], y[6:8], y[8:11], y[11]))
    weighed = ca.dot(np.linspace(0.3, 1.2, 6), ends)
    hessian = ca.Function("hessian", [y], [ca.hessian(weighed, y)[0]])
    gradient = ca.Function("gradient", [y], [ca.gradient(weighed, y)])
    expected = difference(lambda flat: columns([gradient(flat)]), at)
    np.testing.assert_allclose(np.array(hessian(at)), expected, rtol=0, atol=1e-10)


def test_forward_and_reverse_derivatives_are_each_others_transpose() -> None:
    system, start, method = case("SE2, order 4")
    step = gni.step_function(system, method)
    p, seed, weight = ca.MX.sym("p", 3), ca.MX.sym("seed", 3), ca.MX.sym("weight", 3)
    end = step(start.base, p, [], system.parameter_vector, STEP)[1]
    pairing = [
        ca.dot(weight, ca.jtimes(end, p, seed)),
        ca.dot(seed, ca.jtimes(end, p, weight, True)),
    ]
    both = ca.Function("both", [p, seed, weight], pairing)
    forward, reverse = both(start.momentum, [0.3, -0.8, 0.5], [-0.6, 0.2, 0.9])
    assert float(forward) == pytest.approx(float(reverse), rel=1e-13)
    assert abs(float(forward)) > 0.01


def test_steps_accumulate_inside_a_larger_graph() -> None:
    system, start = skate()
    method, count = gni.GNI(), 25
    inputs = np.stack([np.sin(0.4 * np.arange(count)), np.cos(0.7 * np.arange(count))])
    walk = gni.step_function(system, method).mapaccum("walk", count, 2)
    u = ca.MX.sym("u", 2, count)
    theta = ca.repmat(ca.DM(system.parameter_vector), 1, count)
    base, momenta = walk(start.base, start.momentum, u, theta, ca.repmat(STEP, 1, count))
    whole = ca.Function("whole", [u], [base, momenta, ca.gradient(base[0, -1], u)])
    found, found_momenta, slope = (np.array(value) for value in whole(inputs))
    options = {"step": STEP, "n_steps": count, "method": method}
    run = gni.integrate(system, start, controls=inputs.T, **options)
    np.testing.assert_allclose(found.T, run.base[1:], rtol=0, atol=1e-13)
    np.testing.assert_allclose(found_momenta.T, run.momenta[1:], rtol=0, atol=1e-13)

    def last(amount: np.ndarray) -> np.ndarray:
        moved = inputs.T.copy()
        moved[3, 1] += amount[0]
        return gni.integrate(system, start, controls=moved, **options).base[-1, :1]

    assert slope[1, 3] == pytest.approx(difference(last, np.zeros(1), 1e-2)[0, 0], abs=1e-9)


def test_velocities_go_in_and_out_on_request() -> None:
    system, start, method = case("pair 3, gyroscopic")
    step = gni.step_function(system, method, velocities=True)
    assert step.name_in() == ["base", "velocity", "controls", "parameters", "step"]
    assert step.name_out() == ["next_base", "next_velocity"]
    ends = step(
        base=start.base, velocity=start.velocity, parameters=system.parameter_vector, step=STEP
    )
    run = gni.integrate(system, start, step=STEP, n_steps=1, method=method)
    np.testing.assert_allclose(columns([ends["next_velocity"]]), run.velocities[1], atol=1e-13)
    np.testing.assert_allclose(columns([ends["next_base"]]), run.base[1], atol=1e-13)


def test_a_step_without_unknowns_takes_sx() -> None:
    animal = zoo.animal("atiyah left exp", 1, curved=False)
    explicit = gni.GNI(order=4, flow=SPLITTING, projection=None)
    step = gni.step_function(animal.system, explicit)
    assert step.is_a("SXFunction")
    p = ca.SX.sym("p", animal.system.space.rank)
    ends = step(animal.start.base, p, [], animal.system.parameter_vector, STEP)
    assert isinstance(ends[1], ca.SX)
    assert gni.step_function(animal.system, gni.GNI(flow=SPLITTING)).is_a("MXFunction")


def test_parameters_are_an_input_and_the_function_is_kept() -> None:
    system, start = skate()
    changed = system.with_parameters(m=2.3, slope=0.2)
    step = gni.step_function(system)
    assert gni.step_function(changed) is step
    moved = changed.state(start.base, start.velocity)
    ends = step(moved.base, moved.momentum, [0.7, -0.4], changed.parameter_vector, STEP)
    run = gni.integrate(changed, moved, step=STEP, n_steps=1, controls=[0.7, -0.4])
    np.testing.assert_allclose(columns(ends), [*run.base[1], *run.momenta[1]], atol=1e-14)


def test_a_momentum_off_the_constraint_set_is_returned_to_it() -> None:
    system, start, method = case("pair 3, affine, order 4")
    step = gni.step_function(system, method)
    off = start.momentum + np.array([0.2, -0.1, 0.3])
    x, p = (columns([v]) for v in step(start.base, off, [], system.parameter_vector, STEP))
    velocity = system.velocities(x[None], p[None])
    assert np.max(np.abs(system.constraint_residuals(x[None], velocity))) < 1e-14


@pytest.mark.parametrize("speed", [0.0, 1e-7, 1e6])
@pytest.mark.parametrize("name", ["SE3, McLachlan", "SO3, order 2", "pair 3, explicit kicks"])
def test_the_solver_knows_the_size_of_the_motion(name: str, speed: float) -> None:
    space, method, options = CASES[name]
    animal = zoo.animal(space, 2, **{**options, "affine": False, "potential": False})
    system, start = animal.system, animal.start
    h = STEP / max(1.0, speed)
    base = start.base if len(start.base) else None
    start = system.state(base, speed * start.velocity, project_start=True)
    run = gni.integrate(system, start, step=h, n_steps=1, method=method)
    ends = gni.step_function(system, method)(
        start.base, start.momentum, [], system.parameter_vector, h
    )
    scale = max(speed, 1e-12)
    np.testing.assert_allclose(columns([ends[0]]), run.base[1], rtol=0, atol=1e-13)
    np.testing.assert_allclose(columns([ends[1]]) / scale, run.momenta[1] / scale, atol=1e-12)


def test_rest_in_an_equilibrium_of_forces_that_cancel_to_round_off() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(2),
        lambda x, p: np.diag([1.3, 0.7 + x[0] ** 2]),
        constraints=lambda x, p: np.array([[1.0, 0.4 * x[1]]]),
        potential=lambda x, p: 900.0 * (x[0] - 0.1) ** 2 + 1700.0 * (x[1] - 0.3) ** 2,
    )
    base = np.array([0.1, 0.3]) * (1 + 1e-16)
    step = gni.step_function(system)
    x, p = base, np.zeros(2)
    for _ in range(20):
        x, p = step(x, p, [], [], STEP / 10)
    np.testing.assert_allclose(columns([x, p]), [0.1, 0.3, 0.0, 0.0], atol=1e-12)


def test_a_step_too_long_to_be_solved_raises() -> None:
    system, start, method = case("pair 3, linear, order 2")
    step = gni.step_function(system, method)
    with pytest.raises(RuntimeError, match="rootfinder process failed"):
        step(start.base, 40 * start.momentum, [], system.parameter_vector, 30.0)


def test_dependent_rows_are_left_out_with_the_rows_of_the_start() -> None:
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3), np.diag([1.3, 0.7, 2.1]),
        constraints=lambda x, p: np.array([[1.0, 0.4 * x[1], -0.3], [2.0, 0.8 * x[1], -0.6]]),
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.DependentConstraintsWarning)
        start = system.state([0.3, -0.2, 0.5], [0.318, 0.6, 0.9], project_start=True)
    step = gni.step_function(system, active_rows=start.active_rows)
    run = gni.integrate(system, start, step=STEP, n_steps=1)
    ends = step(start.base, start.momentum, [], [], STEP)
    np.testing.assert_allclose(columns(ends), [*run.base[1], *run.momenta[1]], atol=1e-14)


REFUSED = {
    "no system": ({"system": "skate"}, "system must be a MechanicalSystem, not str"),
    "no method": ({"method": "GNI"}, "method must be a value such as gni.GNI()"),
    "a class": ({"method": gni.GNI}, "pass an instance of it: GNI()"),
    "reference": ({"method": gni.ReferenceFlow()}, "it chooses its own steps. Use gni.GNI"),
    "arrows": ({"method": gni.DiscreteLagrangeDAlembert()}, "goes from arrow to arrow. Use gni"),
    "a row too many": ({"active_rows": (0, 1)}, "rising numbers from 0 to 0, got (0, 1)"),
    "a row twice": ({"active_rows": [0, 0]}, "rising numbers from 0 to 0, got [0, 0]"),
    "a row of text": ({"active_rows": "0"}, "rising numbers from 0 to 0, got '0'"),
    "a row that is True": ({"active_rows": (False,)}, "from 0 to 0, got (False,)"),
    "velocities": ({"velocities": 1}, "velocities must be True or False, got 1"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_requests_are_refused_with_the_mend(name: str) -> None:
    changes, message = REFUSED[name]
    request = {"system": skate()[0], "method": None, **changes}
    system, method = request.pop("system"), request.pop("method")
    with pytest.raises(gni.InputError) as caught:
        gni.step_function(system, method, **request)
    assert message in str(caught.value)


def test_inputs_of_a_wrong_size_are_refused_by_casadi() -> None:
    system, start = skate()
    with pytest.raises(RuntimeError, match="dimension"):
        gni.step_function(system)(start.base, start.momentum, [0.1] * 3, [1.7, 0.6, 0.35], STEP)
