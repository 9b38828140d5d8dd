"""The appendix: retraction maps, their trivialised tangents (51)-(54), lemmas 9.3 to 9.5."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Any

import numpy as np
import pytest
from plain_mechanics import close, derivative
from scipy.linalg import expm
from scipy.special import bernoulli

import groupoid_gni as gni

_LORENTZ = np.diag([-1.0, 1.0, 1.0])
MAKERS: dict[str, Callable[..., gni.LieGroup]] = {
    "SO(3)": gni.SO3,
    "SE(2)": gni.SE2,
    "SE(3)": gni.SE3,
    "SO(1, 2)": lambda **options: gni.QuadraticGroup(_LORENTZ, **options),
}
CASES = [
    pytest.param(
        MAKERS[name](side=side, retraction=tau),
        id=f"{name}, {side}, {type(tau).__name__}",
        marks=[] if side == "left" else pytest.mark.slow,
    )
    for name in MAKERS
    for side in ("left", "right")
    for tau in (gni.Cayley(), gni.Exponential())
]
groups = pytest.mark.parametrize("group", CASES)


def vectors(group: gni.LieGroup) -> tuple[Any, Any, Any]:
    """xi, eta and lambda, none of them small or parallel."""
    return tuple(np.random.default_rng(4).uniform(-0.9, 0.9, (3, group.dimension)))


def printed_tau(group: gni.LieGroup) -> Callable[[Any], Any]:
    """exp or cay of a matrix of the algebra, also of a complex one."""
    one = np.eye(len(group.hat(np.zeros(group.dimension))))
    basis = np.array([group.hat(e) for e in np.eye(group.dimension)])

    def tau(xi: Any) -> Any:
        matrix = np.tensordot(xi, basis, 1)
        if isinstance(group.retraction, gni.Exponential):
            return expm(matrix)
        return np.linalg.solve(one - matrix / 2, one + matrix / 2)

    return tau


def tangent(group: gni.LieGroup, xi: Any) -> tuple[Any, Any]:
    """tau(xi) and T_xi tau e_b for every b, (b, k, k)."""
    tau = printed_tau(group)
    return tau(xi), derivative(tau, xi)


def bracket(group: gni.LieGroup, a: Any, b: Any) -> Any:
    """The commutator of matrices as a vector."""
    first, second = group.hat(a), group.hat(b)
    return group.vee(first @ second - second @ first)


@groups
def test_retraction_maps_are_the_printed_ones(group: gni.LieGroup) -> None:
    xi, _, _ = vectors(group)
    g = printed_tau(group)(xi)
    close(group.tau(xi), g, 3e-14)
    one = np.eye(len(g))
    close(group.tau(0 * xi), one, 1e-16)
    close(group.tau(xi) @ group.tau(-xi), one, 3e-14)


@groups
def test_definition_9_1_and_the_inverse_52(group: gni.LieGroup) -> None:
    xi, _, _ = vectors(group)
    g, change = tangent(group, xi)
    moved = change @ np.linalg.inv(g)
    columns = np.array([group.vee(m) for m in moved]).T
    close(group.dtau(xi), columns, 1e-14)
    # (T_xi tau)^-1 o T_e r: the change of xi that moves tau(xi) by e_b tau(xi)
    wanted = np.array([group.hat(e) @ g for e in np.eye(group.dimension)])
    flat = change.reshape(group.dimension, -1).T
    found = np.linalg.lstsq(flat, wanted.reshape(group.dimension, -1).T, rcond=None)[0]
    close(group.dtau_inverse(xi), found, 1e-14)


@groups
def test_lemma_9_3_and_the_adjoint(group: gni.LieGroup) -> None:
    xi, eta, lam = vectors(group)
    tau = printed_tau(group)
    g = tau(xi)

    def moved(t: Any) -> Any:
        element = tau(xi + t[0] * eta)
        return element @ group.hat(lam) @ np.linalg.inv(element)

    change = group.vee(derivative(moved, np.zeros(1))[0])
    delta = derivative(lambda t: tau(xi + t[0] * eta), np.zeros(1))[0]
    body = group.vee(np.linalg.inv(g) @ delta)
    close(bracket(group, lam, body), group.ad(lam) @ body, 3e-15)
    close(change, -group.Ad(g) @ group.ad(lam) @ body, 2e-14)


@groups
def test_lemma_9_4(group: gni.LieGroup) -> None:
    xi, eta, lam = vectors(group)
    tau = printed_tau(group)

    def moved(v: Any) -> Any:
        return tau(v) @ group.hat(lam) @ np.linalg.inv(tau(v))

    change = np.array([group.vee(m) for m in derivative(moved, xi)]).T @ eta
    right = -bracket(group, group.Ad(group.tau(xi)) @ lam, group.dtau(xi) @ eta)
    close(change, right, 2e-14)


@groups
def test_lemma_9_5_equations_53_and_54(group: gni.LieGroup) -> None:
    xi, eta, _ = vectors(group)
    there, back = group.Ad(group.tau(xi)), group.Ad(group.tau(-xi))
    close(group.dtau(xi) @ eta, there @ group.dtau(-xi) @ eta, 1e-14)
    left, right = group.dtau_inverse(xi) @ eta, group.dtau_inverse(-xi) @ back @ eta
    close(left, right, 1e-14)
    assert np.abs(group.dtau_inverse(xi) @ back @ eta - right).max() > 0.05


@groups
def test_remark_9_2_the_two_sides_of_54_are_changes_at_xi_and_at_minus_xi(
    group: gni.LieGroup,
) -> None:
    xi, eta, _ = vectors(group)
    (g, change), (g_back, change_back) = tangent(group, xi), tangent(group, -xi)
    at_xi = np.tensordot(group.dtau_inverse(xi) @ eta, change, 1)
    close(at_xi, group.hat(eta) @ g, 1e-14)
    at_minus_xi = np.tensordot(group.dtau_inverse(xi) @ eta, change_back, 1)
    turned = group.vee(g_back @ group.hat(eta) @ g)
    close(at_minus_xi, group.hat(turned) @ g_back, 1e-14)


@pytest.mark.parametrize("name", MAKERS)
def test_series_of_the_exponential(name: str) -> None:
    group = MAKERS[name](retraction=gni.Exponential())
    xi, _, _ = vectors(group)
    ad = group.ad(xi)
    powers = [np.linalg.matrix_power(ad, j) for j in range(41)]
    series = sum(power / factorial(j + 1) for j, power in enumerate(powers))
    close(group.dtau(xi), series, 3e-15)
    # B_1 = -1/2
    numbers = bernoulli(40)
    series = sum(numbers[j] / factorial(j) * power for j, power in enumerate(powers))
    close(group.dtau_inverse(xi), series, 3e-14)


@pytest.mark.parametrize("name", MAKERS)
def test_tangents_of_the_cayley_map(name: str) -> None:
    group = MAKERS[name](retraction=gni.Cayley())
    xi, eta, _ = vectors(group)
    x, y = group.hat(xi), group.hat(eta)
    one = np.eye(len(x))
    there = np.linalg.solve(one - x / 2, y) @ np.linalg.inv(one + x / 2)
    close(group.hat(group.dtau(xi) @ eta), there, 5e-15)
    back = (one - x / 2) @ y @ (one + x / 2)
    close(group.hat(group.dtau_inverse(xi) @ eta), back, 5e-15)


def test_quadratic_groups_and_their_algebra() -> None:
    group = MAKERS["SO(1, 2)"](retraction=gni.Cayley())
    xi, _, _ = vectors(group)
    omega, y = group.hat(xi), group.tau(xi)
    close(_LORENTZ @ omega + omega.T @ _LORENTZ, 0, 1e-15)
    close(y.T @ _LORENTZ @ y, _LORENTZ, 1e-14)


def test_printed_formulas_on_so3() -> None:
    w, group = np.array([0.7, -0.4, 1.1]), gni.SO3(retraction=gni.Cayley())
    hat, one = group.hat(w), np.eye(3)
    cay = one + 4 / (4 + w @ w) * (hat + hat @ hat / 2)
    close(group.tau(w), cay, 1e-15)
    dcay = 2 / (4 + w @ w) * (2 * one + hat)
    close(group.dtau(w), dcay, 1e-15)
    inverse = one - hat / 2 + np.outer(w, w) / 4
    close(group.dtau_inverse(w), inverse, 1e-15)
    close(group.ad(w) @ w[::-1], np.cross(w, w[::-1]), 1e-16)
