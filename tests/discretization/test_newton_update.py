"""One Newton update: affine groups are solved once and for all, the others updated."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np

from groupoid_gni.discretization.newton_update import NewtonUpdate

A = np.array([[1.7, 0.4], [-0.3, 1.2]])
HERE = np.array([0.3, -0.4, 0.6, 0.9])


def value(expression: ca.SX, symbols: ca.SX, at: np.ndarray) -> np.ndarray:
    return np.array(ca.Function("v", [symbols], [expression])(at))


def mixed() -> tuple[ca.SX, ca.SX]:
    """Components 0 and 3 affine and coupled, 1 and 2 not affine and coupled."""
    v = ca.SX.sym("v", 4)
    affine = ca.mtimes(ca.SX(A), ca.vertcat(v[0], v[3])) - ca.SX([0.7, -0.2])
    curved = ca.vertcat(v[1] ** 3 + 2 * v[1] - 0.5 * v[2], v[2] + 0.2 * ca.sin(v[1]) - 0.4)
    return ca.vertcat(affine[0], curved, affine[1]), v


def test_only_groups_that_are_not_affine_need_a_solver() -> None:
    residual, v = mixed()
    solver = NewtonUpdate.of(residual, v)
    assert solver.implicit == (1, 2)
    np.testing.assert_array_equal(value(solver.unknowns, v, HERE).ravel(), HERE[[1, 2]])
    better = value(solver.better(), v, HERE).ravel()
    np.testing.assert_allclose(better[[0, 3]], np.linalg.solve(A, [0.7, -0.2]), rtol=0, atol=1e-15)
    full = value(ca.jacobian(residual, v), v, HERE)
    dense = np.linalg.solve(full, value(residual, v, HERE)).ravel()
    np.testing.assert_allclose(better[[1, 2]], (HERE - dense)[[1, 2]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        value(solver.update, v, HERE).ravel(), dense[[1, 2]], rtol=0, atol=1e-15
    )


def test_work_is_residual_times_update_of_the_unknowns_only() -> None:
    residual, v = mixed()
    solver = NewtonUpdate.of(residual, v)
    update = value(solver.update, v, HERE).ravel()
    expected = np.sum(np.abs(value(residual, v, HERE).ravel()[[1, 2]] * update))
    np.testing.assert_allclose(float(value(solver.work, v, HERE)[0, 0]), expected, rtol=1e-14)


def test_repeated_updates_converge_quadratically() -> None:
    residual, v = mixed()
    step = ca.Function("step", [v], [NewtonUpdate.of(residual, v).better()])
    values, sizes = np.array([0.0, 0.9, 0.9, 0.0]), []
    for _ in range(6):
        better = np.array(step(values)).ravel()
        sizes.append(np.max(np.abs(better - values)))
        values = better
    assert np.max(np.abs(value(residual, v, values))) < 1e-15
    small = [s for s in sizes if 1e-12 < s < 0.1]
    assert all(after < 2.0 * before**2 for before, after in pairwise(small))


def test_the_response_is_the_change_of_the_solution() -> None:
    residual, v = mixed()
    solver = NewtonUpdate.of(residual, v)
    push = np.array([[0.2, -0.5], [0.3, 0.7], [-0.4, 0.1], [0.9, 0.6]])
    full = value(ca.jacobian(residual, v), v, HERE)
    found = value(solver.response(ca.SX(push)), v, HERE)
    np.testing.assert_allclose(found, np.linalg.solve(full, push)[[1, 2]], rtol=0, atol=1e-15)


def test_affine_equations_have_no_unknowns() -> None:
    v = ca.SX.sym("v", 2)
    solver = NewtonUpdate.of(ca.mtimes(ca.SX(A), v) - ca.SX([0.7, -0.2]), v)
    assert solver.implicit == ()
    assert solver.unknowns.numel() == solver.update.numel() == 0
    found = value(solver.better(), v, np.array([5.0, -3.0])).ravel()
    np.testing.assert_allclose(found, np.linalg.solve(A, [0.7, -0.2]), rtol=0, atol=1e-15)
