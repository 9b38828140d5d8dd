"""The statements of docs/theory.md, by small dense NumPy code that shares nothing with the library.

A system here is a phase space of points (x, p) with functions of x: metric G, rows mu, drift Y,
gyroscopic A. A free step is a function (x, p, h) -> (x, p). Everything else is built from these.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

Array = np.ndarray[Any, Any]
Point = tuple[Array, Array]
FreeStep = Callable[[Array, Array, float], Point]


@dataclass(frozen=True)
class System:
    """G, mu, Y, A, V and its gradient as functions of x; field: the free motion (x', p')."""

    metric: Callable[[Array], Array]
    rows: Callable[[Array], Array]
    field: Callable[[Array, Array], Point]
    potential: Callable[[Array], float] = lambda x: 0.0
    drift: Callable[[Array], Array] | None = None
    gyroscopic: Callable[[Array], Array] | None = None
    turn: Callable[[Array], Array] | None = None

    def A(self, x: Array) -> Array:
        return self.gyroscopic(x) if self.gyroscopic else np.zeros(len(self.metric(x)))

    def Y(self, x: Array) -> Array:
        return self.drift(x) if self.drift else np.zeros(len(self.metric(x)))

    def Pi(self, x: Array) -> Array:
        return self.metric(x) @ self.Y(x) + self.A(x)

    def N(self, x: Array) -> Array:
        """mu^T L^-T, turned by an orthogonal matrix of x where ``turn`` is given."""
        mu = self.rows(x)
        C = mu @ np.linalg.solve(self.metric(x), mu.T)
        N = mu.T @ np.linalg.inv(np.linalg.cholesky(C)).T
        return N @ self.turn(x) if self.turn else N

    def s(self, x: Array, p: Array) -> Array:
        """Normal components N^T G^-1 (p - Pi)."""
        return self.N(x).T @ np.linalg.solve(self.metric(x), p - self.Pi(x))

    def reflect(self, x: Array, p: Array) -> Array:
        mu, raised = self.rows(x), np.linalg.solve(self.metric(x), self.rows(x).T)
        Q = mu.T @ np.linalg.solve(mu @ raised, raised.T)
        return p - 2 * Q @ (p - self.Pi(x))

    def project(self, x: Array, p: Array) -> Array:
        return p - self.N(x) @ self.s(x, p)

    def energy(self, x: Array, p: Array) -> float:
        q = p - self.A(x)
        return float(q @ np.linalg.solve(self.metric(x), q) / 2 + self.potential(x))

    def force(self, x: Array, p: Array) -> Array:
        """Normal components of the constraint force: -ds along the free motion."""
        dx, dp = self.field(x, p)

        def slope(e: float) -> Array:
            return (self.s(x + e * dx, p + e * dp) - self.s(x - e * dx, p - e * dp)) / (2 * e)

        return (slope(2e-3) - 4 * slope(1e-3)) / 3

    def motion(self, x: Array, p: Array, t: float) -> Point:
        """The nonholonomic motion to 1e-13; every right side is taken on the constraint set."""
        n = len(x)

        def rate(_: float, y: Array) -> Array:
            on = self.project(y[:n], y[n:])
            dx, dp = self.field(y[:n], on)
            return np.concatenate([dx, dp + self.N(y[:n]) @ self.force(y[:n], on)])

        start = np.concatenate([x, p])
        end = solve_ivp(rate, (0, t), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        return end[:n], end[n:]


def bare(system: System, first: FreeStep, second: FreeStep) -> FreeStep:
    """K_h: second_{h/2} R first_{h/2}, the right one first."""

    def step(x: Array, p: Array, h: float) -> Point:
        x, p = first(x, p, h / 2)
        return second(x, system.reflect(x, p), h / 2)

    return step


def polar(a: Array) -> Array:
    u, _, v = np.linalg.svd(a)
    return u @ v


def lend(system: System, K: FreeStep, x: Array, p: Array, h: float) -> tuple[Array, Array, Point]:
    """(nu, W, end) of the projected step, by Broyden's method from the Jacobian -2."""
    m = len(system.rows(x))
    nu, inverse, N0 = np.zeros(m), -np.eye(m) / 2, system.N(x)
    last: tuple[Array, Array] | None = None
    for _ in range(60):
        x1, arrived = K(x, p + N0 @ nu, h)
        N1 = system.N(x1)
        S = (np.linalg.inv(system.metric(x)) + np.linalg.inv(system.metric(x1))) / 2
        W = polar(N1.T @ S @ N0)
        closing = W.T @ system.s(x1, arrived) - nu
        if last is not None:
            moved, change = nu - last[0], closing - last[1]
            expected = inverse @ change
            if moved @ expected > 1e-300:
                inverse = inverse + np.outer((moved - expected) / (moved @ expected),
                                             moved @ inverse)
        size = np.abs(closing).max()
        if size < 1e-15 or (size < 1e-13 and last is not None and size >= np.abs(last[1]).max()):
            break
        last = nu, closing
        nu = nu - inverse @ closing
    return nu, W, (x1, arrived - N1 @ W @ nu)


def projected(system: System, K: FreeStep) -> FreeStep:
    return lambda x, p, h: lend(system, K, x, p, h)[2]


def composed(step: FreeStep, stages: Any) -> FreeStep:
    def whole(x: Array, p: Array, h: float) -> Point:
        for fraction in stages:
            x, p = step(x, p, fraction * h)
        return x, p

    return whole


def run(step: FreeStep, x: Array, p: Array, h: float, n: int) -> Point:
    for _ in range(n):
        x, p = step(x, p, h)
    return x, p


def slope(sizes: Any, errors: Any) -> float:
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def gap(a: Point, b: Point) -> float:
    return float(max(np.abs(u - v).max(initial=0.0) for u, v in zip(a, b, strict=True)))


# Particles in R^n with a constant metric: Euler A and B, and the mean (16), are explicit.


def particle(mass: Array, rows: Callable[[Array], Array], V: Any, dV: Any, **more: Any) -> System:
    return System(lambda x: np.diag(mass), rows, lambda x, p: (p / mass, -dV(x)), V, **more)


def euler_a(mass: Array, dV: Any) -> FreeStep:
    def step(x: Array, p: Array, h: float) -> Point:
        p = p - h * dV(x)
        return x + h * p / mass, p

    return step


def euler_b(mass: Array, dV: Any) -> FreeStep:
    def step(x: Array, p: Array, h: float) -> Point:
        x = x + h * p / mass
        return x, p - h * dV(x)

    return step


def mean(mass: Array, dV: Any) -> FreeStep:
    a, b = euler_a(mass, dV), euler_b(mass, dV)
    return lambda x, p, h: b(*a(x, p, h / 2), h / 2)


MASS = np.array([1.3, 0.8, 1.1])


def well(x: Array) -> float:
    quartic = 0.3 * x[0] ** 4 / 4 + 0.2 * x[0] ** 2 * x[2] ** 2 / 2
    return float(x[0] ** 2 / 2 + 0.85 * x[2] ** 2 + quartic - np.cos(x[1]) - 0.2 * x[1] * x[2])


def well_slope(x: Array) -> Array:
    return np.array([
        x[0] + 0.3 * x[0] ** 3 + 0.2 * x[0] * x[2] ** 2,
        np.sin(x[1]) - 0.2 * x[2],
        1.7 * x[2] + 0.2 * x[0] ** 2 * x[2] - 0.2 * x[1],
    ])


def twisted(x: Array) -> Array:
    return np.array([[-x[1] - 0.4, 0.3 * np.sin(x[0]), 1.0]])


A, B, MEAN = euler_a(MASS, well_slope), euler_b(MASS, well_slope), mean(MASS, well_slope)


@cache
def one_row() -> tuple[System, FreeStep, Point]:
    system = particle(MASS, twisted, well, well_slope)
    x = np.array([0.7, 0.4, -0.3])
    return system, bare(system, B, A), (x, system.project(x, np.array([0.5, 1.1, 0.2])))


MASS4 = np.array([1.3, 0.8, 1.1, 0.9])


def two_rows(x: Array) -> Array:
    return np.array([
        [-x[1] - 0.4, 0.2, 1.0, 0.3 * x[3]],
        [0.5, -np.sin(x[0]) + 0.2 * x[2], 0.0, 1.2],
    ])


def well4(x: Array) -> float:
    return float(well(x[:3]) + 0.6 * x[3] ** 2 + 0.3 * x[3] * x[0] ** 2)


def well4_slope(x: Array) -> Array:
    head = well_slope(x[:3]) + np.array([0.6 * x[3] * x[0], 0, 0])
    return np.append(head, 1.2 * x[3] + 0.3 * x[0] ** 2)


@cache
def two_row_system() -> tuple[System, FreeStep, Point]:
    system = particle(MASS4, two_rows, well4, well4_slope)
    K = bare(system, euler_b(MASS4, well4_slope), euler_a(MASS4, well4_slope))
    x = np.array([0.7, 0.4, -0.3, 0.2])
    return system, K, (x, system.project(x, np.array([0.5, 1.1, 0.2, -0.4])))


# Lie-Poisson equations p_a' = <p, [xi, e_a]>, by the implicit midpoint rule.


def lie_poisson(metric: Array, C: Array, row: Array) -> tuple[System, FreeStep]:
    """C[c, a, b]: [e_a, e_b] = C[c, a, b] e_c; one constant constraint row."""
    inverse = np.linalg.inv(metric)

    def turn(p: Array) -> Array:
        return np.einsum("c,cba,b->a", p, C, inverse @ p)

    def midpoint(x: Array, p: Array, h: float) -> Point:
        end = p + h * turn(p)
        for _ in range(60):
            better = p + h * turn((p + end) / 2)
            moved, end = np.abs(better - end).max(), better
            if moved < 1e-16:
                break
        return x, end

    system = System(lambda x: metric, lambda x: row[None, :], lambda x, p: (x, turn(p)))
    return system, midpoint


def constants(rank: int, *brackets: tuple[int, int, int, float]) -> Array:
    C = np.zeros((rank, rank, rank))
    for a, b, c, value in brackets:
        C[c, a, b], C[c, b, a] = value, -value
    return C


SE2 = constants(3, (0, 1, 2, 1.0), (0, 2, 1, -1.0))
NOT_UNIMODULAR = constants(3, (0, 1, 1, 0.6), (0, 2, 2, 0.25), (0, 1, 2, 0.4))
M_SLEIGH, J_SLEIGH, A_SLEIGH = 1.2, 0.9, 0.35
NOWHERE = np.zeros(0)


def sleigh() -> tuple[System, FreeStep]:
    """xi = (omega, u, w) at the blade, w = 0; the centre of mass is A_SLEIGH ahead of it."""
    m, J, a = M_SLEIGH, J_SLEIGH, A_SLEIGH
    G = np.array([[J + m * a * a, 0, m * a], [0, m, 0], [m * a, 0, m]])
    return lie_poisson(G, SE2, np.array([0.0, 0.0, 1.0]))


# 1. The reflection.


def awkward() -> tuple[System, Array, Array]:
    """Base-dependent everything, affine and gyroscopic, two rows in R^4."""

    def G(x: Array) -> Array:
        return np.diag([1.3, 0.8 + x[0] ** 2, 1.1, 0.9]) + 0.2 * np.outer(np.cos(x), np.cos(x))

    system = System(
        G, two_rows, lambda x, p: (x, p), well4,
        drift=lambda x: np.array([x[1], 0.3, -x[0], 0.2]),
        gyroscopic=lambda x: np.array([0.4 * x[2], -x[0], 0.1, x[1] ** 2]),
    )
    return system, np.array([0.7, 0.4, -0.3, 0.2]), np.array([0.5, 1.1, 0.2, -0.4])


def test_the_reflection_is_an_isometric_involution_with_the_constraint_set_as_mirror() -> None:
    system, x, p = awkward()
    inverse = np.linalg.inv(system.metric(x))
    turned = system.reflect(x, p)
    before, after = p - system.Pi(x), turned - system.Pi(x)
    np.testing.assert_allclose(system.reflect(x, turned), p, atol=1e-14)
    assert before @ inverse @ before == pytest.approx(after @ inverse @ after, rel=1e-14)
    np.testing.assert_allclose(system.s(x, turned), -system.s(x, p), atol=1e-14)
    on = system.project(x, p)
    np.testing.assert_allclose(system.reflect(x, on), on, atol=1e-14)
    other = on + system.reflect(x, p) - p
    assert np.abs(system.reflect(x, other) - other).max() > 0.1


def test_the_reflection_keeps_energy_less_momentum_along_sections_of_the_affine_distribution(
) -> None:
    system, x, p = awkward()
    mu = system.rows(x)
    along = np.array([0.3, -0.7, 0.2, 0.9])
    d = along - np.linalg.pinv(mu) @ mu @ along
    moving = system.Y(x) + d

    def change(section: Array) -> float:
        end = system.reflect(x, p)
        return float(system.energy(x, end) - system.energy(x, p) - (end - p) @ section)

    assert abs(change(moving)) < 1e-14
    assert abs(change(np.zeros(4))) > 0.1
    assert abs(change(moving + along - d)) > 0.1
    assert abs((system.reflect(x, p) - p) @ d) < 1e-14


def test_a_normal_part_adds_half_its_square_whatever_the_section() -> None:
    system, x, p = awkward()
    p, nu = system.project(x, p), np.array([0.3, -0.8])
    lent = p + system.N(x) @ nu
    gained = system.energy(x, lent) - system.energy(x, p) - (lent - p) @ system.Y(x)
    assert gained == pytest.approx(nu @ nu / 2, rel=1e-13)


# 2. The step between impacts.


def test_the_bare_step_is_self_adjoint_and_tends_to_the_reflection() -> None:
    for system, K, (x, p) in (one_row(), two_row_system()):
        off = p + 0.2
        assert gap(K(*K(x, off, 0.3), -0.3), (x, off)) < 1e-14
        assert gap(K(x, off, 0.0), (x, system.reflect(x, off))) < 1e-15


def test_with_euler_halves_it_is_rattle_seen_between_impacts() -> None:
    system, K, (x, p) = one_row()
    h = 0.3
    middle = A(x, p, h / 2)
    for _ in range(5):
        x, plus = MEAN(x, p, h)
        p = system.reflect(x, plus)
        middle = K(*middle, h)
        assert gap(middle, A(x, p, h / 2)) < 1e-14


# 3. The parasitic mode.


def off_constraint(system: System, K: FreeStep, start: Point, h: float, n: int, e: float = 1e-5
                   ) -> Array:
    """(m, m): what (-1)^n s_n answers to s_0, central differences."""
    columns = []
    for direction in np.eye(len(system.rows(start[0]))):
        ends = []
        for sign in (e, -e):
            x, p = start[0], start[1] + sign * system.N(start[0]) @ direction
            ends.append(system.s(*run(K, x, p, h, n)))
        columns.append((-1) ** n * (ends[0] - ends[1]) / (2 * e))
    return np.array(columns).T


def test_on_the_sleigh_the_mode_grows_by_minus_the_integral_of_the_divergence() -> None:
    system, F = sleigh()
    m, J, a = M_SLEIGH, J_SLEIGH, A_SLEIGH
    momentum = system.metric(NOWHERE) @ np.array([1.5, -0.6, 0.0])
    h, n = 0.0125, 640

    def rate(_: float, y: Array) -> list[float]:
        """(omega', u', minus the divergence m a u / (J + m a^2))."""
        slowing = m * a * y[1] / (J + m * a * a)
        return [-slowing * y[0], a * y[0] ** 2, slowing]

    predicted = solve_ivp(rate, (0, n * h), [1.5, -0.6, 0.0], rtol=1e-11, atol=1e-12).y[2, -1]
    assert predicted > 1.5
    grown = off_constraint(system, bare(system, F, F), (NOWHERE, momentum), h, n)
    assert np.log(grown[0, 0]) == pytest.approx(predicted, rel=0.01)


def test_where_the_free_motion_changes_volume_its_divergence_is_added() -> None:
    G = np.array([[1.1, 0.2, 0.1], [0.2, 0.9, -0.3], [0.1, -0.3, 1.4]])
    system, F = lie_poisson(G, NOT_UNIMODULAR, np.array([0.2, 1.0, 0.5]))
    p0 = system.project(NOWHERE, np.array([0.8, 0.5, -0.4]))
    tangent = np.linalg.qr(system.rows(NOWHERE).T @ np.ones((1, 1)), mode="complete")[0][:, 1:]
    frame = np.linalg.solve(np.linalg.cholesky(tangent.T @ G @ tangent), tangent.T).T

    def X(w: Array) -> Array:
        p = G @ frame @ w
        dp = system.field(NOWHERE, p)[1]
        return frame.T @ dp

    def rate(_: float, y: Array) -> Array:
        e, w = 1e-5, y[:2]
        divergence = sum((X(w + e * d) - X(w - e * d)) @ d for d in np.eye(2)) / (2 * e)
        modular = np.einsum("aba,b->", NOT_UNIMODULAR, frame @ w)
        return np.array([*X(w), -divergence, modular])

    h, n = 0.01, 300
    end = solve_ivp(rate, (0, n * h), [*(frame.T @ p0), 0, 0], rtol=1e-10, atol=1e-12).y[:, -1]
    grown = np.log(off_constraint(system, bare(system, F, F), (NOWHERE, p0), h, n)[0, 0])
    assert abs(end[3]) > 0.2
    assert grown == pytest.approx(end[2] + end[3], abs=0.01 * (abs(end[2]) + abs(end[3])))


def test_where_the_motion_keeps_volume_the_mode_neither_grows_nor_decays() -> None:
    """z' = y x' with equal masses: x' sqrt(1 + y^2), y' are coordinates in which div X = 0."""
    one = np.ones(3)
    system = particle(one, lambda x: np.array([[-x[1], 0.0, 1.0]]), well, well_slope)
    K = bare(system, euler_b(one, well_slope), euler_a(one, well_slope))
    x = np.array([0.7, 0.4, -0.3])
    start = x, system.project(x, np.array([0.5, 1.1, 0.2]))
    sizes = [abs(off_constraint(system, K, start, 10 / n, n)[0, 0] - 1) for n in (250, 500, 1000)]
    assert sizes[-1] < 0.01
    assert slope((4, 2, 1), sizes) > 0.8


def test_with_two_rows_the_determinant_obeys_the_law() -> None:
    system, K, (x0, p0) = two_row_system()

    def frame(x: Array) -> Array:
        """An orthonormal frame of D, smooth in x: Cholesky of a fixed pair of projected vectors."""
        G, mu = system.metric(x), system.rows(x)
        fixed = np.eye(4)[:, :2]
        raised = np.linalg.solve(G, mu.T)
        inside = fixed - raised @ np.linalg.solve(mu @ raised, mu @ fixed)
        return np.linalg.solve(np.linalg.cholesky(inside.T @ G @ inside), inside.T).T

    def X(y: Array) -> Array:
        """The field in the coordinates (x, w), xi = frame w, of which dx dw is the volume."""
        x, w, e = y[:4], y[4:], 1e-5
        p = system.metric(x) @ frame(x) @ w
        dx, dp = system.field(x, p)
        dframe = (frame(x + e * dx) - frame(x - e * dx)) / (2 * e)
        return np.concatenate([dx, frame(x).T @ dp + dframe.T @ system.metric(x) @ frame(x) @ w])

    def rate(_: float, y: Array) -> Array:
        e = 1e-4
        divergence = sum((X(y[:6] + e * d) - X(y[:6] - e * d)) @ d for d in np.eye(6)) / (2 * e)
        return np.array([*X(y[:6]), -divergence])

    h, n = 0.01, 400
    start = [*x0, *(frame(x0).T @ p0), 0.0]
    end = solve_ivp(rate, (0, n * h), start, rtol=1e-6, atol=1e-8).y[:, -1]
    exact = system.motion(x0, p0, n * h)
    np.testing.assert_allclose(end[:4], exact[0], atol=1e-4)
    block = off_constraint(system, K, (x0, p0), h, n)
    assert abs(end[6]) > 0.1
    assert np.log(np.linalg.det(block)) == pytest.approx(end[6], rel=0.02)


def amplitude(values: list[Array]) -> float:
    """Size of the (-1)^k part of seven values: their sixth difference over 64."""
    weights = np.array([1, -6, 15, -20, 15, -6, 1]) / 64
    return float(np.abs(sum(w * v for w, v in zip(weights, values, strict=True))).max())


def nodes(system: System, F: FreeStep, x: Array, p: Array, h: float) -> list[Array]:
    values = [system.s(x, p)]
    for _ in range(6):
        x, plus = F(x, p, h)
        p = system.reflect(x, plus)
        values.append(system.s(x, p))
    return values


SIZES = (0.025, 0.0125, 0.00625)


def test_starts_excite_the_mode_at_the_orders_1_2_and_3() -> None:
    system, K, (x, p) = one_row()
    found: dict[str, list[float]] = {"naive": [], "bare": [], "half": [], "half, Euler A": []}
    for h in SIZES:
        half = p + h / 2 * system.N(x) @ system.force(x, p)
        found["naive"].append(amplitude(nodes(system, MEAN, x, p, h)))
        found["half"].append(amplitude(nodes(system, MEAN, x, half, h)))
        found["half, Euler A"].append(amplitude(nodes(system, A, x, half, h)))
        between = [system.s(*run(K, x, p, h, k)) for k in range(7)]
        found["bare"].append(amplitude(between))
    orders = {name: slope(SIZES, values) for name, values in found.items()}
    wanted = {"naive": 1, "bare": 2, "half": 3, "half, Euler A": 2}
    for name, order in wanted.items():
        assert orders[name] == pytest.approx(order, abs=0.15), name
    exact = np.abs(system.force(x, p)).max() / 2
    assert found["naive"][-1] / SIZES[-1] == pytest.approx(exact, rel=0.02)


# 4. The projected step.


@pytest.mark.parametrize("made", [one_row, two_row_system])
def test_the_projected_step_maps_the_constraint_set_to_itself_and_is_self_adjoint(
    made: Callable[[], tuple[System, FreeStep, Point]],
) -> None:
    system, K, start = made()
    step = projected(system, K)
    end = step(*start, 0.25)
    assert np.abs(system.s(*end)).max() < 1e-14
    assert gap(step(*end, -0.25), start) < 1e-13
    nu, W, _ = lend(system, K, *start, 0.25)
    back, _, _ = lend(system, K, *end, -0.25)
    np.testing.assert_allclose(back, W @ nu, atol=1e-13)
    assert np.abs(nu).max() > 1e-3
    assert gap(step(*start, 1e-9), start) < 1e-8


def test_the_isometry_makes_the_choice_of_basis_irrelevant() -> None:
    system, K, start = two_row_system()

    def turn(x: Array) -> Array:
        angle = 3 * x[0] - x[1] + 0.4
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    other = replace(system, turn=turn)
    ours, theirs = projected(system, K)(*start, 0.25), projected(other, K)(*start, 0.25)
    assert gap(ours, theirs) < 1e-13
    nu, W, _ = lend(system, K, *start, 0.25)
    turned, _, _ = lend(other, K, *start, 0.25)
    assert np.abs(nu - turned).max() > 1e-3
    without = K(start[0], start[1] + system.N(start[0]) @ nu, 0.25)
    assert np.abs((W - np.eye(2)) @ nu).max() > 1e-5
    assert np.abs(other.N(without[0]) @ turned - system.N(without[0]) @ W @ nu).max() > 1e-3


def test_it_is_self_adjoint_with_a_curved_metric_drift_gyroscopic_term_and_two_rows_at_once(
) -> None:
    def G(x: Any) -> list[list[Any]]:
        diagonal = [1.3 + 0.5 * x[1] ** 2, 0.8 + 0.6 * x[0] ** 2, 1.1 + 0.4 * x[3] ** 2, 0.9]
        mixed = 0.3 * sin(x[0] + x[2])
        return [[diagonal[a] if a == b else mixed if abs(a - b) == 2 else 0.1 for b in range(4)]
                for a in range(4)]

    curved = Curved(G, lambda x: 0.3 * x[0] ** 4 - cos(x[1]) + x[3] ** 2 * x[2],
                    lambda x: [0.4 * x[2], -1.0 * x[0], 0.1 * x[3], x[1] ** 2])
    system = curved.system(two_rows, drift=lambda x: np.array([x[1], 0.3, -x[0], 0.2]))
    x = np.array([0.7, 0.4, -0.3, 0.2])
    start = x, system.project(x, np.array([0.5, 1.1, 0.2, -0.4]))
    step = projected(system, bare(system, curved.step, curved.step))
    nu, W, end = lend(system, bare(system, curved.step, curved.step), *start, 0.2)
    assert np.abs(system.s(*end)).max() < 1e-14
    assert gap(step(*end, -0.2), start) < 1e-13
    assert np.abs((W - np.eye(2)) @ nu).max() > 1e-4
    counts, exact = (3, 6, 12), system.motion(*start, 0.4)
    errors = [gap(run(step, *start, 0.4 / n, n), exact) for n in counts]
    assert slope([0.4 / n for n in counts], errors) == pytest.approx(2, abs=0.15)


def test_nu_is_an_even_function_of_h_about_the_midpoint() -> None:
    system, K, start = one_row()
    sizes = (0.1, 0.07, 0.05)
    even, odd, from_start = [], [], []
    for h in sizes:
        ahead = lend(system, K, *system.motion(*start, -h / 2), h)[0][0]
        behind = lend(system, K, *system.motion(*start, h / 2), -h)[0][0]
        even.append(abs(ahead + behind) / 2)
        odd.append(abs(ahead - behind) / 2)
        pair = [lend(system, K, *start, size)[0][0] for size in (h, -h)]
        from_start.append(abs(pair[0] - pair[1]) / 2)
    assert slope(sizes, even) == pytest.approx(2, abs=0.05)
    assert slope(sizes, from_start) == pytest.approx(3, abs=0.1)
    assert slope(sizes, odd) == pytest.approx(5, abs=0.1)


def test_with_two_rows_half_of_the_isometry_makes_nu_even() -> None:
    system, K, start = two_row_system()
    nu, W, end = lend(system, K, *start, 0.25)
    back, back_W, _ = lend(system, K, *end, -0.25)

    def root(rotation: Array) -> Array:
        return polar(np.eye(2) + rotation)

    np.testing.assert_allclose(root(W) @ nu, root(back_W) @ back, atol=1e-13)
    assert np.abs(nu - back).max() > 1e-5


SUZUKI = [1 / (4 - 4 ** (1 / 3))] * 5
SUZUKI[2] = 1 - 4 * SUZUKI[0]
YOSHIDA6 = [0.784513610477560, 0.235573213359357, -1.17767998417887]
YOSHIDA6 = [*YOSHIDA6, 1 - 2 * sum(YOSHIDA6), *YOSHIDA6[::-1]]


@cache
def exact_end(name: str, t: float) -> Point:
    system, _, start = {"one": one_row, "two": two_row_system}[name]()
    return system.motion(*start, t)


@pytest.mark.parametrize(
    ("name", "stages", "order", "counts"),
    [
        ("one", [1.0], 2, (16, 32, 64)),
        ("two", [1.0], 2, (16, 32, 64)),
        ("one", SUZUKI, 4, (4, 8, 16)),
        ("two", SUZUKI, 4, (4, 8, 16)),
        ("one", YOSHIDA6, 6, (8, 12, 18)),
    ],
)
def test_compositions_of_the_projected_step_have_the_order_of_their_table(
    name: str, stages: list[float], order: int, counts: tuple[int, ...]
) -> None:
    system, K, start = {"one": one_row, "two": two_row_system}[name]()
    step = composed(projected(system, K), stages)
    errors = [gap(run(step, *start, 1.6 / n, n), exact_end(name, 1.6)) for n in counts]
    assert slope([1.6 / n for n in counts], errors) == pytest.approx(order, abs=0.25)


def test_the_closing_equation_fails_where_the_bare_step_has_a_normal_multiplier_one() -> None:
    """A free particle behind a skate with heading 4 y (1 - x), from the origin along the x axis."""
    one = np.ones(2)

    def rows(x: Array) -> Array:
        heading = 4 * x[1] * (1 - x[0])
        return np.array([[-np.sin(heading), np.cos(heading)]])

    system = particle(one, rows, lambda x: 0.0, lambda x: np.zeros(2))
    drift = mean(one, lambda x: np.zeros(2))
    K, x, p = bare(system, drift, drift), np.zeros(2), np.array([1.0, 0.0])

    def jacobian(h: float) -> float:
        ends = [K(x, p + np.array([0, e]), h) for e in (1e-5, -1e-5)]
        return float((system.s(*ends[0]) - system.s(*ends[1]))[0] / 2e-5) - 1

    for h in (0.01, 0.3, 1.0):
        middle, end = 4 * h * (1 - h / 2), 4 * h * (1 - h)
        assert jacobian(h) == pytest.approx(-2 + middle * (1 - end / 2), abs=1e-7)
    assert jacobian(1e-3) == pytest.approx(-2, abs=0.01)
    assert abs(jacobian(1.0)) < 1e-7


# 5. Compositions of the bare step.


def half_table(a: list[float], b: list[float]) -> list[float]:
    """Stages g_1 = a_1, g_2 = b_1 - g_1, g_3 = a_2 - g_2, ... of a palindromic splitting table."""
    a = [*a, 1 - 2 * sum(a), *a[::-1]]
    b = [*b, 0.5 - sum(b)]
    b = [*b, *b[::-1]]
    stages = [a[0]]
    for k, beta in enumerate(b):
        stages.append(beta - stages[-1])
        stages.append(a[k + 1] - stages[-1])
    assert abs(stages.pop()) < 1e-13
    return stages


# Blanes and Moan 2002, J. Comput. Appl. Math. 142, table 2 (S6, order 4)
S6 = half_table(
    [0.0792036964311957, 0.353172906049774, -0.0420650803577195],
    [0.209515106613362, -0.143851773179818],
)


def test_the_reflected_bare_step_is_a_first_order_method_with_the_reflected_adjoint() -> None:
    system, K, (x, p) = one_row()
    off, h = p + 0.15, 0.3

    def M(x: Array, p: Array, h: float) -> Point:
        return K(x, system.reflect(x, p), h)

    there = M(x, off, h)
    y, r = there[0], system.reflect(*there)
    back = M(y, r, -h)
    assert gap((back[0], system.reflect(*back)), (x, off)) < 1e-14
    moved = [(M(x, off, h)[1] - off) / h for h in (1e-4, -1e-4)]
    mirrored = system.reflect(x, off)
    e = 1e-6
    dx, dp = system.field(x, mirrored)
    image = (system.reflect(x + e * dx, mirrored + e * dp)
             - system.reflect(x - e * dx, mirrored - e * dp)) / (2 * e)
    np.testing.assert_allclose(sum(moved) / 2, (system.field(x, off)[1] + image) / 2, atol=1e-5)


@pytest.mark.parametrize(
    ("stages", "along", "across", "counts"),
    [
        ([1.0], 2, 2, (32, 64, 128)),
        (S6, 4, 4, (16, 32, 64)),
        ([g / 2 for g in SUZUKI for _ in range(2)], 4, 4, (8, 16, 32)),
        (SUZUKI, 4, 2, (8, 16, 32)),
        ([g / 2 for g in YOSHIDA6 for _ in range(2)], 6, 6, (8, 12, 18)),
        (YOSHIDA6, 4, 2, (32, 64, 128)),
    ],
    ids=["one", "S6", "Suzuki doubled", "Suzuki", "Yoshida doubled", "Yoshida"],
)
def test_compositions_of_the_bare_step_pair_up_or_stop_at_order_four(
    stages: list[float], along: int, across: int, counts: tuple[int, ...]
) -> None:
    system, K, start = one_row()
    exact = exact_end("one", 1.6)
    step = composed(K, stages)
    ends = [run(step, *start, 1.6 / n, n) for n in counts]
    sizes = [1.6 / n for n in counts]
    tangent = [gap((x, system.project(x, p)), exact) for x, p in ends]
    normal = [float(np.abs(system.s(x, p)).max()) for x, p in ends]
    assert slope(sizes, tangent) == pytest.approx(along, abs=0.35)
    assert slope(sizes, normal) == pytest.approx(across, abs=0.35)


# 6. Discrete gradients and the energy-preserving step.


class Pair:
    """Values of an expression at two points, and the row s of its divided differences."""

    def __init__(self, start: Any, end: Any, row: Array) -> None:
        self.start, self.end, self.row = start, end, row

    @property
    def mean(self) -> Any:
        return (self.start + self.end) / 2

    def __add__(self, other: Any) -> Pair:
        other = constant(other, self)
        return Pair(self.start + other.start, self.end + other.end, self.row + other.row)

    def __mul__(self, other: Any) -> Pair:
        other = constant(other, self)
        row = self.mean * other.row + other.mean * self.row
        return Pair(self.start * other.start, self.end * other.end, row)

    def __truediv__(self, other: Pair) -> Pair:
        start, end = self.start / other.start, self.end / other.end
        row = (self.row - (start + end) / 2 * other.row) / other.mean
        return Pair(start, end, row)

    def __pow__(self, n: int) -> Pair:
        mixed = sum(self.start**k * self.end ** (n - 1 - k) for k in range(n))
        return Pair(self.start**n, self.end**n, mixed * self.row)

    def __neg__(self) -> Pair:
        return self * -1.0

    def __sub__(self, other: Any) -> Pair:
        return self + -1.0 * constant(other, self)

    __radd__, __rmul__ = __add__, __mul__


def constant(value: Any, like: Pair) -> Pair:
    return value if isinstance(value, Pair) else Pair(value, value, np.zeros(len(like.row)))


def sinc(x: float) -> float:
    return float(np.sinc(x / np.pi))


def sin(a: Any) -> Any:
    if not isinstance(a, Pair):
        return np.sin(a)
    half = (a.end - a.start) / 2
    return Pair(np.sin(a.start), np.sin(a.end), np.cos(a.mean) * sinc(half) * a.row)


def cos(a: Any) -> Any:
    if not isinstance(a, Pair):
        return np.cos(a)
    half = (a.end - a.start) / 2
    return Pair(np.cos(a.start), np.cos(a.end), -np.sin(a.mean) * sinc(half) * a.row)


def exp(a: Any) -> Any:
    if not isinstance(a, Pair):
        return np.exp(a)
    half = (a.end - a.start) / 2
    factor = np.exp(a.mean) * (np.sinh(half) / half if half else 1.0)
    return Pair(np.exp(a.start), np.exp(a.end), factor * a.row)


def sqrt(a: Any) -> Any:
    if not isinstance(a, Pair):
        return np.sqrt(a)
    start, end = np.sqrt(a.start), np.sqrt(a.end)
    return Pair(start, end, a.row / (start + end))


def log(a: Any) -> Any:
    if not isinstance(a, Pair):
        return np.log(a)
    ratio = (a.end - a.start) / (a.end + a.start)
    factor = 2 * (np.arctanh(ratio) / ratio if ratio else 1.0) / (a.end + a.start)
    return Pair(np.log(a.start), np.log(a.end), factor * a.row)


def pairs(start: Array, end: Array) -> list[Pair]:
    return [Pair(*ends) for ends in zip(start, end, np.eye(len(start)), strict=True)]


def discrete_gradient(f: Callable[[Any], Any], start: Array, end: Array) -> Array:
    return np.asarray(constant(f(pairs(start, end)), Pair(0, 0, 0 * start)).row)


def tangle(x: Any) -> Any:
    """Every operation once, on three variables."""
    r = sqrt(x[0] ** 2 + x[1] * x[1] + 1.3)
    return exp(0.4 * x[2]) * sin(x[0] * x[1]) / r + log(r + x[2] ** 4) - cos(x[2] - x[0]) ** 3


def test_the_rows_of_differences_are_a_symmetric_discrete_gradient() -> None:
    a, b = np.array([0.7, -0.4, 0.9]), np.array([-0.2, 0.8, 1.7])
    s = discrete_gradient(tangle, a, b)
    assert s @ (b - a) == pytest.approx(tangle(b) - tangle(a), abs=1e-14)
    np.testing.assert_allclose(discrete_gradient(tangle, b, a), s, atol=1e-15)
    e = 1e-6
    slopes = [(tangle(a + e * d) - tangle(a - e * d)) / (2 * e) for d in np.eye(3)]
    np.testing.assert_allclose(discrete_gradient(tangle, a, a), slopes, atol=1e-9)


def test_the_rows_of_differences_lose_no_digits_near_the_diagonal() -> None:
    a, d = np.array([0.7, -0.4, 0.9]), np.array([3e-9, -2e-9, 1e-9])
    middle = discrete_gradient(tangle, a, a)
    np.testing.assert_allclose(discrete_gradient(tangle, a - d, a + d), middle, atol=4e-15)
    lazy = (tangle(a + 3e-9 * np.eye(3)[0]) - tangle(a - 3e-9 * np.eye(3)[0])) / 6e-9
    assert abs(lazy - middle[0]) > 1e-10


def spread(x: Any) -> list[list[Any]]:
    """A metric on R^3 that depends on x, as expressions."""
    return [
        [1.3 + 0.3 * x[1] ** 2, 0.2 * sin(x[0]), 0.1 * x[2]],
        [0.2 * sin(x[0]), 1.1 + 0.2 * x[0] * x[0], 0.15 * cos(x[1])],
        [0.1 * x[2], 0.15 * cos(x[1]), 1.6 + 0.4 * x[2] ** 2],
    ]


def hill(x: Any) -> Any:
    return 0.5 * x[0] ** 2 + 0.1 * x[0] ** 4 - cos(x[1]) + 0.3 * x[2] ** 4 + 0.2 * sin(x[0] * x[2])


def wind(x: Any) -> list[Any]:
    return [0.3 * x[1] * x[2], -0.2 * x[0] ** 2, 0.4 * sin(x[0])]


@dataclass(frozen=True)
class Curved:
    """V, G, A on R^n as expressions, with the energy-preserving step of statement 6."""

    G: Callable[[Any], list[list[Any]]]
    V: Callable[[Any], Any]
    A: Callable[[Any], list[Any]]
    friction: Array | None = None

    def metric(self, x: Array) -> Array:
        return np.array(self.G(x), dtype=float)

    def linear(self, x: Array) -> Array:
        return np.array(self.A(x), dtype=float)

    def impulse(self, x0: Array, q0: Array, x1: Array, q1: Array, xi: Array, h: float) -> Array:
        """b = h nabla(W - A xi); the differences of G^-1 through -G0^-1 DG G1^-1."""
        ends = pairs(x0, x1)
        total = np.zeros(len(x0)) + constant(self.V(ends), ends[0]).row
        lowered = [(np.linalg.solve(self.metric(x0), q), np.linalg.solve(self.metric(x1), q))
                   for q in (q0, q1)]
        entries = self.G(ends)
        for a, row in enumerate(entries):
            for b, entry in enumerate(row):
                weight = sum(u[a] * w[b] + u[b] * w[a] for u, w in lowered) / 8
                total = total - weight * constant(entry, ends[0]).row
        for value, component in zip(self.A(ends), xi, strict=True):
            total = total - component * constant(value, ends[0]).row
        if self.friction is not None:
            total = total + self.friction @ xi
        return h * total

    def step(self, x0: Array, p0: Array, h: float) -> Point:
        return self.step_and_velocity(x0, p0, h)[0]

    def step_and_velocity(self, x0: Array, p0: Array, h: float) -> tuple[Point, Array]:
        G0, q0 = self.metric(x0), p0 - self.linear(x0)
        xi, p1, moved = np.linalg.solve(G0, q0), p0, np.inf
        for _ in range(80):
            x1 = x0 + h * xi
            q1 = p1 - self.linear(x1)
            better = p0 - self.impulse(x0, q0, x1, q1, xi, h)
            both = q0 + better - self.linear(x1)
            velocity = (np.linalg.solve(G0, both) + np.linalg.solve(self.metric(x1), both)) / 4
            before, moved = moved, max(np.abs(better - p1).max(), np.abs(velocity - xi).max())
            p1, xi = better, velocity
            if moved < 1e-14 and moved >= before:
                break
        return (x0 + h * xi, p1), xi

    def field(self, x: Array, p: Array) -> Point:
        q = p - self.linear(x)
        xi = np.linalg.solve(self.metric(x), q)
        return xi, -self.impulse(x, q, x, q, xi, 1.0)

    def system(self, rows: Callable[[Array], Array], **more: Any) -> System:
        return System(self.metric, rows, self.field, self.V, gyroscopic=self.linear, **more)


NO_ROWS = np.zeros((0, 3))


def test_the_energy_preserving_step_is_exact_on_a_curved_space_with_a_gyroscopic_term() -> None:
    curved = Curved(spread, hill, wind)
    system = curved.system(lambda x: NO_ROWS)
    start = np.array([0.6, -0.4, 0.5]), np.array([0.8, 0.5, -0.9])
    x, p = start
    for _ in range(50):
        x, p = curved.step(x, p, 0.1)
        assert abs(system.energy(x, p) - system.energy(*start)) < 1e-14
    assert gap((x, p), start) > 0.5
    assert gap(curved.step(*curved.step(*start, 0.2), -0.2), start) < 1e-14
    counts, exact = (8, 16, 32), system.motion(*start, 1.0)
    errors = [gap(run(curved.step, *start, 1 / n, n), exact) for n in counts]
    assert slope([1 / n for n in counts], errors) == pytest.approx(2, abs=0.1)


def hat(w: Array) -> Array:
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def cay(w: Array) -> Array:
    return np.linalg.solve(np.eye(3) - hat(w) / 2, np.eye(3) + hat(w) / 2)


INERTIA = np.array([[1.2, 0.2, -0.1], [0.2, 0.8, 0.15], [-0.1, 0.15, 1.7]])


def top_potential(x: Any) -> Any:
    return 0.7 * x[2] + 0.3 * x[0] ** 2 + 0.2 * sin(x[0] * x[1])


def top_step(x0: Array, p0: Array, h: float) -> Point:
    """On the action groupoid R^3 x| SO(3), body frame: x' = x x xi, p' = p x xi - x x dV."""
    xi = np.linalg.solve(INERTIA, p0)
    for _ in range(60):
        zeta = h * xi / 2
        R = cay(zeta)
        middle = R.T @ x0
        x1 = R.T @ middle
        rhobar = 4 / (4 + zeta @ zeta) * hat(middle)
        np.testing.assert_allclose(h * rhobar @ xi, x1 - x0, atol=1e-14)
        p1 = R.T @ (R.T @ p0 - h * rhobar.T @ discrete_gradient(top_potential, x0, x1))
        better = np.linalg.solve(INERTIA, p0 + p1) / 2
        moved, xi = np.abs(better - xi).max(), better
        if moved < 1e-16:
            break
    return x1, p1


def test_the_energy_preserving_step_is_exact_on_an_action_groupoid_with_its_casimirs() -> None:
    x, p = np.array([0.5, -0.3, 0.9]), np.array([1.1, 0.4, -0.8])
    end = run(top_step, x, p, 0.1, 60)

    def kept(x: Array, p: Array) -> list[float]:
        return [p @ np.linalg.solve(INERTIA, p) / 2 + top_potential(x), x @ x, x @ p]

    np.testing.assert_allclose(kept(*end), kept(x, p), atol=2e-14)
    assert gap(end, (x, p)) > 0.3
    assert gap(top_step(*top_step(x, p, 0.2), -0.2), (x, p)) < 1e-14

    def rate(_: float, y: Array) -> Array:
        x, p = y[:3], y[3:]
        xi = np.linalg.solve(INERTIA, p)
        push = np.cross(x, discrete_gradient(top_potential, x, x))
        return np.concatenate([np.cross(x, xi), np.cross(p, xi) + push])

    exact = solve_ivp(rate, (0, 1), [*x, *p], rtol=1e-11, atol=1e-12).y[:, -1]
    counts = (8, 16, 32)
    errors = [gap(run(top_step, x, p, 1 / n, n), (exact[:3], exact[3:])) for n in counts]
    assert slope([1 / n for n in counts], errors) == pytest.approx(2, abs=0.1)


def test_on_a_group_the_energy_preserving_step_stays_on_the_coadjoint_orbit() -> None:
    zero = np.zeros(3)
    p = np.array([1.1, 0.4, -0.8])
    for _ in range(20):
        before, xi = p, np.linalg.solve(INERTIA, p)
        for _ in range(40):
            R = cay(0.15 * xi / 2)
            p = R.T @ R.T @ before
            xi = np.linalg.solve(INERTIA, before + p) / 2
        np.testing.assert_allclose(p @ p, before @ before, atol=4e-15)
        energy = [v @ np.linalg.solve(INERTIA, v) for v in (p, before)]
        assert energy[0] == pytest.approx(energy[1], abs=4e-15)
    assert np.abs(p - zero).max() > 0.1


def twisted_retraction(xi: Array) -> Array:
    """tau(xi) = exp(phi(xi)), phi odd and not along xi: symmetric, but Ad moves xi."""
    side = np.array([[0.3, 0.8, -0.2], [0.1, -0.5, 0.7], [-0.6, 0.2, 0.4]])
    phi = xi + 0.8 * (xi @ xi) * side @ xi
    half = np.sqrt(phi @ phi) / 2
    return cay(phi * np.tan(half) / half)


def corrected_step(p0: Array, h: float, corrected: bool = True) -> tuple[Array, float]:
    xi, kappa = np.linalg.solve(INERTIA, p0), 0.0
    for _ in range(60):
        R = twisted_retraction(h * xi / 2)
        free = R.T @ R.T @ p0
        push = R.T @ INERTIA @ xi
        kappa = float((free - p0) @ xi / (push @ xi)) if corrected else 0.0
        p1 = free - kappa * push
        better = np.linalg.solve(INERTIA, p0 + p1) / 2
        moved, xi = np.abs(better - xi).max(), better
        if moved < 1e-16:
            break
    return p1, kappa


def test_where_the_arrow_moves_its_velocity_one_scalar_restores_the_energy() -> None:
    p = np.array([1.1, 0.4, -0.8])

    def energy(p: Array) -> float:
        return float(p @ np.linalg.solve(INERTIA, p) / 2)

    assert abs(energy(corrected_step(p, 0.3, corrected=False)[0]) - energy(p)) > 1e-5
    end, kappa = corrected_step(p, 0.3)
    assert energy(end) == pytest.approx(energy(p), abs=4e-15)
    back, other = corrected_step(end, -0.3)
    np.testing.assert_allclose(back, p, atol=1e-14)
    assert other == pytest.approx(-kappa, abs=1e-13)
    sizes = (0.2, 0.1, 0.05)
    assert slope(sizes, [abs(corrected_step(p, h)[1]) for h in sizes]) > 1.8

    def fine(h: float, n: int) -> Array:
        q = p
        for _ in range(n):
            q = corrected_step(q, h)[0]
        return q

    rate = solve_ivp(lambda _, q: np.cross(q, np.linalg.solve(INERTIA, q)), (0, 1), p,
                     rtol=1e-11, atol=1e-12).y[:, -1]
    errors = [np.abs(fine(1 / n, n) - rate).max() for n in (6, 12, 24)]
    assert slope((1 / 6, 1 / 12, 1 / 24), errors) == pytest.approx(2, abs=0.15)


def test_projected_with_the_energy_preserving_step_everything_is_exact_and_of_order_four() -> None:
    curved = Curved(spread, hill, wind)
    system = curved.system(twisted)
    x = np.array([0.6, -0.4, 0.5])
    start = x, system.project(x, np.array([0.8, 0.5, -0.9]))
    step = projected(system, bare(system, curved.step, curved.step))
    state = start
    for _ in range(8):
        state = step(*state, 0.1)
        assert abs(system.energy(*state) - system.energy(*start)) < 2e-14
        assert np.abs(system.s(*state)).max() < 1e-14
    assert gap(step(*step(*start, 0.2), -0.2), start) < 1e-13
    exact, counts = system.motion(*start, 0.8), (2, 3, 4)
    suzuki = composed(step, SUZUKI)
    ends = [run(suzuki, *start, 0.8 / n, n) for n in counts]
    errors = [gap(end, exact) for end in ends]
    assert slope([0.8 / n for n in counts], errors) == pytest.approx(4, abs=0.4)
    assert all(abs(system.energy(*end) - system.energy(*start)) < 2e-14 for end in ends)


def test_with_an_affine_constraint_the_moving_energy_is_exact_and_the_energy_is_not() -> None:
    """z is cyclic: Y' = Y = (0, 0, 0.7) generates a symmetry, and the free step keeps p_z."""

    def G(x: Any) -> list[list[Any]]:
        return [[1.3 + 0.3 * x[1] ** 2, 0.2 * sin(x[0]), 0.1], [0.2 * sin(x[0]), 1.1, 0.15],
                [0.1, 0.15, 1.6 + 0.4 * x[0] ** 2]]

    curved = Curved(G, lambda x: 0.5 * x[0] ** 4 - cos(x[1]), lambda x: [0.0, 0.0, 0.0])
    Y = np.array([0.0, 0.0, 0.7])
    system = curved.system(lambda x: np.array([[-x[1] - 0.4, 0.3 * np.sin(x[0]), 1.0]]),
                           drift=lambda x: Y)
    x = np.array([0.6, -0.4, 0.5])
    state = x, system.project(x, np.array([0.8, 0.5, -0.9]))
    step = projected(system, bare(system, curved.step, curved.step))
    first = system.energy(*state), system.energy(*state) - state[1] @ Y
    changes = []
    for _ in range(15):
        state = step(*state, 0.1)
        assert abs(system.energy(*state) - state[1] @ Y - first[1]) < 2e-14
        changes.append(abs(system.energy(*state) - first[0]))
    assert max(changes) > 0.05


# 7. Explicit splitting.


def poisson_defect(step: Callable[[Array], Array], B: Callable[[Array], Array], p: Array) -> float:
    """J B(p) J^T - B(p1), the Jacobian by the complex step."""
    e = 1e-30
    columns = [step(p + 1j * e * d).imag / e for d in np.eye(len(p))]
    J = np.array(columns).T
    return float(np.abs(J @ B(p) @ J.T - B(step(p.astype(complex)).real)).max())


def factors(G: Array) -> list[tuple[float, Array]]:
    """(d_k, u_k) with G^-1 = sum d_k u_k u_k^T, from G = L D L^T."""
    L = np.linalg.cholesky(G)
    D = np.diag(L) ** 2
    U = np.linalg.inv(L / np.diag(L)).T
    return [(1 / D[k], U[:, k]) for k in range(len(G))]


def rotation_splitting(p: Array, h: float) -> Array:
    """Palindromic product of Cayley rotations about u_k; p <- Ad^T p = tau^T p."""
    terms = factors(INERTIA)
    for d, u in [*terms[:-1], (2 * terms[-1][0], terms[-1][1]), *terms[-2::-1]]:
        p = cay((h / 2 * d * (u @ p)) * u).T @ p
    return p


def test_explicit_splitting_is_poisson_of_order_two_and_keeps_the_casimir() -> None:
    p = np.array([1.1, 0.4, -0.8])
    G = sum(d * np.outer(u, u) for d, u in factors(INERTIA))
    np.testing.assert_allclose(G @ INERTIA, np.eye(3), atol=1e-14)
    assert poisson_defect(lambda q: rotation_splitting(q, 0.4), lambda q: -hat(q), p) < 1e-14
    end = rotation_splitting(p, 0.4)
    assert end @ end == pytest.approx(p @ p, rel=1e-15)
    np.testing.assert_allclose(rotation_splitting(end, -0.4), p, atol=1e-15)
    exact = solve_ivp(lambda _, q: np.cross(q, np.linalg.solve(INERTIA, q)), (0, 1), p,
                      rtol=1e-11, atol=1e-12).y[:, -1]
    counts, errors = (8, 16, 32), []
    for n in counts:
        q = p
        for _ in range(n):
            q = rotation_splitting(q, 1 / n)
        errors.append(np.abs(q - exact).max())
    assert slope([1 / n for n in counts], errors) == pytest.approx(2, abs=0.1)


def screw(u: Array) -> Array:
    matrix = np.zeros((4, 4), dtype=u.dtype)
    matrix[:3, :3], matrix[:3, 3] = hat(u[:3]), u[3:]
    return matrix


def se3_adjoint(g: Array) -> Array:
    columns = []
    for d in np.eye(6):
        m = g @ screw(d) @ np.linalg.inv(g)
        columns.append(np.array([m[2, 1], m[0, 2], m[1, 0], *m[:3, 3]]))
    return np.array(columns).T


def se3_bracket(p: Array) -> Array:
    """B[a, b] = <p, [e_b, e_a]> up to sign, the Lie-Poisson matrix of SE(3)."""
    B = np.zeros((6, 6))
    for a, da in enumerate(np.eye(6)):
        for b, db in enumerate(np.eye(6)):
            m = screw(da) @ screw(db) - screw(db) @ screw(da)
            B[a, b] = np.array([m[2, 1], m[0, 2], m[1, 0], *m[:3, 3]]) @ p
    return B


@pytest.mark.parametrize("pitch", [0.0, 0.7])
def test_the_cayley_factor_is_poisson_where_the_cube_of_u_is_along_u(pitch: float) -> None:
    w, v = np.array([0.4, -0.9, 0.6]), np.array([0.9, 0.4, 0.0])
    u = np.array([*w, *(v + pitch * w)])
    assert w @ v == pytest.approx(0)
    cube, square = np.linalg.matrix_power(screw(u), 3), w @ w
    assert (np.abs(cube + square * screw(u)).max() < 1e-14) == (pitch == 0)
    p = np.array([0.7, -0.3, 0.5, 0.6, 1.1, -0.4])

    def flow(q: Array, tau: Callable[[Array], Array]) -> Array:
        return se3_adjoint(tau(screw(0.6 * (u @ q) * u))).T @ q

    def cayley(m: Array) -> Array:
        return np.linalg.solve(np.eye(4) - m / 2, np.eye(4) + m / 2)

    def series(m: Array) -> Array:
        total, term = np.eye(4) + 0j, np.eye(4) + 0j
        for k in range(1, 30):
            term = term @ m / k
            total = total + term
        return total

    assert poisson_defect(lambda q: flow(q, series), se3_bracket, p) < 1e-13
    defect = poisson_defect(lambda q: flow(q, cayley), se3_bracket, p)
    assert (defect < 1e-13) if pitch == 0 else (defect > 1e-3)
    assert u @ flow(p, cayley) == pytest.approx(u @ p, rel=1e-14)


# 8. Modified energy.

SPRING = np.array([[1.4, 0.3, -0.2], [0.3, 0.9, 0.1], [-0.2, 0.1, 2.0]])


@cache
def springs() -> tuple[System, FreeStep, Point]:
    system = particle(MASS, twisted, lambda x: float(x @ SPRING @ x) / 2, lambda x: SPRING @ x)
    x = np.array([0.7, 0.4, -0.3])
    F = mean(MASS, lambda x: SPRING @ x)
    return system, F, (x, system.project(x, np.array([0.5, 1.1, 0.2])))


def modified(x: Array, p: Array, h: float) -> float:
    stiffness = SPRING - h**2 / 4 * SPRING @ np.diag(1 / MASS) @ SPRING
    return float(p @ (p / MASS) + x @ stiffness @ x) / 2


def test_quadratic_potentials_have_an_exact_modified_energy_for_any_distribution() -> None:
    system, F, (x, p) = springs()
    h, start = 0.4, modified(x, p, 0.4)
    real = []
    for _ in range(2000):
        x, plus = F(x, p, h)
        p = system.reflect(x, plus)
        assert abs(modified(x, plus, h) - start) < 1e-12
        assert abs(modified(x, p, h) - start) < 1e-12
        real.append(system.energy(x, p))
    assert np.ptp(real) > 1e-3


def test_euler_a_and_b_keep_nothing_even_there() -> None:
    system, _, start = springs()
    for step in (euler_a(MASS, lambda x: SPRING @ x), euler_b(MASS, lambda x: SPRING @ x)):
        x, p = start
        for _ in range(4000):
            x, plus = step(x, p, 0.1)
            p = system.reflect(x, plus)
        assert system.energy(x, p) > 10 * system.energy(*start)


def test_the_bare_and_the_projected_step_have_it_too_with_half_the_step() -> None:
    system, F, start = springs()
    h, K = 0.4, bare(system, F, F)
    for step in (K, projected(system, K)):
        x, p = start
        for _ in range(200):
            x, p = step(x, p, h)
            assert abs(modified(x, p, h / 2) - modified(*start, h / 2)) < 2e-13
    a, b = euler_a(MASS, lambda x: SPRING @ x), euler_b(MASS, lambda x: SPRING @ x)

    def between(x: Array, p: Array) -> float:
        v = p / MASS
        return float(p @ v - h**2 / 4 * v @ SPRING @ v + x @ SPRING @ x) / 2

    x, p = start
    for _ in range(200):
        x, p = bare(system, b, a)(x, p, h)
        assert abs(between(x, p) - between(*start)) < 2e-13
    x, p = start
    for _ in range(20):
        x, p = projected(system, bare(system, b, a))(x, p, h)
    assert abs(between(x, p) - between(*start)) > 1e-6


def test_reversing_the_momentum_reverses_the_projected_step() -> None:
    system, K, (x, p) = one_row()
    step = projected(system, K)
    end, back = step(x, p, 0.3), step(x, -p, -0.3)
    assert gap(end, (back[0], -back[1])) < 1e-13


def driven_oscillators(
    f: Callable[[float], float], second: float, h: float, n: int
) -> Array:
    """Energies of the projected step: x' + f(y) z' = 0, y driven by a pendulum, quartic x and z.

    Unit masses and one row, so that the step is a few lines: secant method from the slope -2.
    """

    def potential(x: Array) -> float:
        quartic = 0.3 * (x[0] ** 4 / 4 + x[0] ** 2 * x[2] ** 2 / 2)
        pendulum = math.cos(x[1]) + second / 2 * math.sin(2 * x[1])
        return float(x[0] ** 2 / 2 + 0.85 * x[2] ** 2 + quartic + pendulum)

    def force(x: Array) -> Array:
        return -np.array([
            x[0] + 0.3 * (x[0] ** 3 + x[0] * x[2] ** 2),
            -math.sin(x[1]) + second * math.cos(2 * x[1]),
            1.7 * x[2] + 0.3 * x[0] ** 2 * x[2],
        ])

    def normal(x: Array) -> Array:
        ratio = f(x[1])
        length = math.sqrt(1 + ratio * ratio)
        return np.array([1 / length, 0.0, ratio / length])

    def fly(x: Array, p: Array) -> Point:
        x = x + h / 2 * p
        kick, N = h / 2 * force(x), normal(x)
        p = p + kick
        p = p - 2 * (N @ p) * N + kick
        return x + h / 2 * p, p

    x, nu = np.array([1.0, 0.3, 0.5]), 0.0
    p = np.array([-f(0.3) * 0.3, 2.5, 0.3])
    energies = np.empty(n)
    for k in range(n):
        N0, last = normal(x), nu
        end, arrived = fly(x, p + nu * N0)
        closing = normal(end) @ arrived - nu
        nu += closing / 2
        for _ in range(20):
            end, arrived = fly(x, p + nu * N0)
            N1 = normal(end)
            before, closing = closing, N1 @ arrived - nu
            if abs(closing) < 1e-14 or nu == last or closing == before:
                break
            last, nu = nu, nu - closing * (nu - last) / (closing - before)
        x, p = end, arrived - (N1 @ arrived) * N1
        energies[k] = p @ p / 2 + potential(x)
    return energies


def test_the_energy_is_flat_when_reversible_and_drifts_as_h_squared_when_not() -> None:
    def drift(f: Callable[[float], float], second: float, h: float) -> float:
        n = int(500 / h)
        return float(np.polyfit(h * np.arange(n), driven_oscillators(f, second, h, n), 1)[0])

    def lopsided(y: float) -> float:
        return 0.3 + math.sin(y) + 0.4 * math.cos(y) + 0.5 * math.sin(2 * y)

    coarse, fine = drift(lopsided, 0.5, 0.1), drift(lopsided, 0.5, 0.05)
    assert coarse == pytest.approx(4.2e-6, rel=0.2)
    assert coarse / fine == pytest.approx(4, abs=0.5)
    assert abs(drift(math.sin, 0.0, 0.1)) < 0.1 * coarse


# 9. Forces.

FRICTION = np.array([[0.3, 0.1, 0.0], [0.1, 0.2, -0.05], [0.0, -0.05, 0.4]])


def test_the_energy_balance_of_a_forced_energy_preserving_run_is_exact() -> None:
    curved = Curved(spread, hill, wind, friction=FRICTION)
    system = curved.system(twisted)
    spent = 0.0

    def flight(x: Array, p: Array, h: float) -> Point:
        nonlocal spent
        end, xi = curved.step_and_velocity(x, p, h)
        spent = h * xi @ FRICTION @ xi
        return end

    def two_flights(x: Array, p: Array, h: float) -> tuple[Point, float]:
        x, p = flight(x, p, h / 2)
        first = spent
        end = flight(x, system.reflect(x, p), h / 2)
        return end, first + spent

    K = bare(system, curved.step, curved.step)
    x = np.array([0.6, -0.4, 0.5])
    p = system.project(x, np.array([0.8, 0.5, -0.9]))
    for _ in range(10):
        nu, _, end = lend(system, K, x, p, 0.1)
        lost = two_flights(x, p + system.N(x) @ nu, 0.1)[1]
        assert system.energy(*end) - system.energy(x, p) == pytest.approx(-lost, abs=2e-14)
        assert lost > 1e-3
        x, p = end


def test_a_force_split_over_the_ends_keeps_the_forced_step_self_adjoint_and_consistent() -> None:
    drag = np.array([0.3, 0.2, 0.4])

    def forced(x0: Array, p0: Array, h: float) -> Point:
        """FL- - f- = p0, FL+ + f+ = p1 for the mean and f = -(1 + x_0^2) drag xi."""
        left = MASS + h / 2 * (1 + x0[0] ** 2) * drag
        xi = (p0 - h / 2 * well_slope(x0)) / left
        x1 = x0 + h * xi
        return x1, MASS * xi - h / 2 * well_slope(x1) - h / 2 * (1 + x1[0] ** 2) * drag * xi

    x, p = np.array([0.7, 0.4, -0.3]), np.array([0.5, 1.1, 0.2])
    assert gap(forced(*forced(x, p, 0.3), -0.3), (x, p)) < 1e-14

    def field(x: Array, p: Array) -> Point:
        return p / MASS, -well_slope(x) - (1 + x[0] ** 2) * drag * p / MASS

    system = System(lambda x: np.diag(MASS), twisted, field, well)
    p = system.project(x, p)
    step = projected(system, bare(system, forced, forced))
    exact, counts = system.motion(x, p, 1.0), (8, 16, 32)
    errors = [gap(run(step, x, p, 1 / n, n), exact) for n in counts]
    assert slope([1 / n for n in counts], errors) == pytest.approx(2, abs=0.1)
