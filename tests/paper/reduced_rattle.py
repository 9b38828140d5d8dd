"""Reduced systems on R^n x G in plain NumPy, and the algorithm (37) for them, section 7.

Groups are sets of matrices with a basis of their algebra; tau is differentiated by the complex
step, Ad is conjugation, nothing of the library is used but to build the twin `Reduced.system`. A
right group (space velocities) is the left one with all arrows inverted: erratum 14.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from plain_mechanics import Field, derivative

import groupoid_gni as gni

_SO3 = np.array([[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
                 [[0, -1, 0], [1, 0, 0], [0, 0, 0]]], dtype=float)  # fmt: skip
_SE2 = np.array([[[0, -1, 0], [1, 0, 0], [0, 0, 0]], [[0, 0, 1], [0, 0, 0], [0, 0, 0]],
                 [[0, 0, 0], [0, 0, 1], [0, 0, 0]]], dtype=float)  # fmt: skip
_GROUPS: dict[str, tuple[Any, Callable[..., gni.LieGroup]]] = {
    "SO(3)": (_SO3, gni.SO3),
    "SE(2)": (_SE2, gni.SE2),
}
_TINY = 1e-40


def exponential(matrix: Any) -> Any:
    """exp by its series, of one matrix of ordinary size or of many, real or complex."""
    power = total = np.eye(matrix.shape[-1])
    for k in range(1, 26):
        power = power @ matrix / k
        total = total + power
    return total


def root(residual: Callable[[Any], Any], guess: Any) -> Any:
    """A zero, by Newton's method with a Jacobian by differences, kept for a few iterations."""
    x, delta = np.array(guess, dtype=float), 1e-5
    for _ in range(2):
        steps = delta * np.eye(len(x))
        columns = [(residual(x + step) - residual(x - step)) / (2 * delta) for step in steps]
        inverse = np.linalg.inv(np.array(columns).T)
        for _ in range(5):
            x = x - inverse @ residual(x)
    return x


@dataclass(frozen=True)
class Group:
    """A group of matrices with side and retraction."""

    name: str
    side: str
    retraction: gni.Retraction

    @property
    def basis(self) -> Any:
        """E_s, (d, k, k)."""
        return _GROUPS[self.name][0]

    @property
    def of_library(self) -> gni.LieGroup:
        """The same for the library."""
        return _GROUPS[self.name][1](side=self.side, retraction=self.retraction)

    def hat(self, xi: Any) -> Any:
        """xi^s E_s, also of many xi."""
        return np.tensordot(xi, self.basis, 1)

    def vee(self, matrix: Any) -> Any:
        """The components of a matrix of the algebra, or of many."""
        flat = self.basis.reshape(len(self.basis), -1)
        return matrix.reshape(*matrix.shape[:-2], -1) @ np.linalg.pinv(flat)

    def tau(self, xi: Any) -> Any:
        """exp or cay, also of many xi, real or complex."""
        matrix = self.hat(xi)
        one = np.eye(matrix.shape[-1])
        if isinstance(self.retraction, gni.Exponential):
            return exponential(matrix)
        return np.linalg.solve(one - matrix / 2, one + matrix / 2)

    def tau_inverse(self, element: Any) -> Any:
        """The inverse of tau: log by its series, so only for small changes, or that of cay."""
        one = np.eye(len(element))
        if isinstance(self.retraction, gni.Exponential):
            power, total = one, np.zeros_like(element)
            for k in range(1, 40):
                power = power @ (one - element)
                total = total - power / k
            return self.vee(total)
        return self.vee(2 * np.linalg.solve(element + one, element - one))

    def change(self, xi: Any) -> Any:
        """T_xi tau, (d, k, k)."""
        return np.imag(self.tau(xi + 1j * _TINY * np.eye(len(xi)))) / _TINY

    def dtau(self, xi: Any) -> Any:
        """(34), (51)."""
        return self.vee(self.change(xi) @ np.linalg.inv(self.tau(xi))).T

    def turned(self, xi: Any) -> Any:
        """xi on a left group, -xi on a right one."""
        return xi if self.side == "left" else -xi

    def leave(self, sigma: Any) -> Any:
        """(dtau^-1_sigma)^*, a matrix."""
        return np.linalg.inv(self.dtau(self.turned(sigma))).T

    def arrive(self, sigma: Any) -> Any:
        """(dtau^-1_{-sigma})^*, a matrix."""
        return self.leave(-sigma)

    def transport(self, sigma: Any) -> Any:
        """Ad^*_{tau(sigma)}, a matrix."""
        g = self.tau(self.turned(sigma))
        return self.vee(g @ self.basis @ np.linalg.inv(g))

    def product(self, first: Any, then: Any) -> Any:
        """First one arrow, then the other."""
        return first @ then if self.side == "left" else then @ first


@dataclass(frozen=True)
class Reduced:
    """``L = 1/2 G(v, v) - V`` with ``mu (v - Y) = 0`` on T R^n x g; v = (x', xi)."""

    name: str
    group: Group
    metric: Field
    rows: Field
    potential: Field
    drift: Field | None
    base: Any
    wish: Any

    @property
    def n(self) -> int:
        """The dimension of M."""
        return len(self.base)

    @cached_property
    def system(self) -> gni.MechanicalSystem:
        """The same for the library, on R^n x R^n x G."""
        return self._on(gni.AtiyahGroupoid(self.n, self.group.of_library))

    @cached_property
    def unreduced(self) -> gni.MechanicalSystem:
        """The same for the library on all of Q = R^n x G."""
        return self._on(gni.FramedPairGroupoid(gni.VectorGroup(self.n), self.group.of_library))

    def _on(self, space: gni.LieGroupoid) -> gni.MechanicalSystem:
        n, drift = self.n, self.drift
        return gni.MechanicalSystem(
            space,
            metric=lambda x, p: self.metric(x[:n]),
            constraints=lambda x, p: self.rows(x[:n]),
            potential=lambda x, p: self.potential(x[:n]),
            drift=None if drift is None else lambda x, p: drift(x[:n]),
        )

    @cached_property
    def velocity(self) -> Any:
        """The velocity on the constraint nearest to the wish."""
        x, p = self.base, self.metric(self.base) @ np.asarray(self.wish)
        along, across = self.projectors(x)
        return np.linalg.solve(self.metric(x), along @ p + across @ self.one_form(x))

    def section(self, x: Any) -> Any:
        """Y of section 7.3."""
        return np.zeros(len(self.wish)) if self.drift is None else self.drift(x)

    def one_form(self, x: Any) -> Any:
        """Pi = G(Y, .)."""
        return self.metric(x) @ self.section(x)

    def projectors(self, x: Any) -> tuple[Any, Any]:
        """P* and Q*."""
        inverse, mu = np.linalg.inv(self.metric(x)), self.rows(x)
        across = mu.T @ np.linalg.solve(mu @ inverse @ mu.T, mu @ inverse)
        return np.eye(len(inverse)) - across, across

    def lagrangian(self, x: Any, v: Any) -> Any:
        """L of section 7."""
        return 0.5 * v @ self.metric(x) @ v - self.potential(x)

    def pull(self, x: Any, v: Any) -> Any:
        """V_x, less the force of a metric that depends on x; (37) has a constant one."""
        return -derivative(lambda y: self.lagrangian(y, v), x)


# Discrete Lagrangians, Legendre transforms (29), the equations (30) and (38).


def retracted_lagrangian(reduced: Reduced, rule: Any, h: float) -> Callable[[Any, Any, Any], Any]:
    """l_d(x0, x1, sigma) of a rule; that of `Rattle` is the one printed in section 7.2."""

    def at(share: float) -> Callable[[Any, Any, Any], Any]:
        return lambda x0, x1, sigma: h * reduced.lagrangian(
            (1.0 - share) * x0 + share * x1, np.concatenate([x1 - x0, sigma]) / h
        )

    euler_a, euler_b = at(0.0), at(1.0)
    return {
        gni.EulerA(): euler_a,
        gni.EulerB(): euler_b,
        gni.Rattle(): lambda *arrow: 0.5 * euler_a(*arrow) + 0.5 * euler_b(*arrow),
        gni.Midpoint(): at(0.5),
    }[rule]


def moment(
    reduced: Reduced, rule: Any, h: float, x0: Any, x1: Any, xi: Any
) -> tuple[Any, Any]:
    """The group parts of FL- and FL+, as after (34)."""
    l_d, sigma = retracted_lagrangian(reduced, rule, h), h * xi
    by_sigma = derivative(lambda y: l_d(x0, x1, y), sigma)
    return reduced.group.leave(sigma) @ by_sigma, reduced.group.arrive(sigma) @ by_sigma


def legendre(
    reduced: Reduced, rule: Any, h: float, x0: Any, x1: Any, xi: Any
) -> tuple[Any, Any]:
    """FL- and FL+ through l_d."""
    l_d = retracted_lagrangian(reduced, rule, h)
    first = derivative(lambda y: l_d(y, x1, h * xi), x0)
    second = derivative(lambda y: l_d(x0, y, h * xi), x1)
    leave, arrive = moment(reduced, rule, h, x0, x1, xi)
    return np.concatenate([-first, leave]), np.concatenate([second, arrive])


def next_pair(
    reduced: Reduced, rule: Any, h: float, arrow: tuple[Any, Any, Any]
) -> tuple[Any, Any]:
    """(30), or (38) with - 2 Q* Pi: (x_{k-1}, x_k, xi_{k-1}) -> (x_{k+1}, xi_k)."""
    n, (x0, x1, xi) = reduced.n, arrow
    arrived = legendre(reduced, rule, h, x0, x1, xi)[1]
    (along, across), offset = reduced.projectors(x1), reduced.one_form(x1)

    def residual(unknown: Any) -> Any:
        leave = legendre(reduced, rule, h, x1, unknown[:n], unknown[n:])[0]
        # P* and Q* of anything are independent, so their sum vanishes where both do
        return along @ (leave - arrived) + across @ (leave + arrived - 2 * offset)

    found = root(residual, np.concatenate([2 * x1 - x0, xi]))
    return found[:n], found[n:]


# The algorithm (37).

State = tuple[Any, Any, Any, Any, Any]
"""(x_k, p~_k, xi_k, M~_k, lambda_k), lambda as in (33): an impulse."""


def next_base(
    reduced: Reduced, h: float, x: Any, p: Any, xi: Any, impulse: Any
) -> tuple[Any, Any]:
    """(37a), and (37c) with the inverse of the base block, erratum 15: x_{k+1} and p_{k+1/2}.

    Explicit for a constant metric. Otherwise the metric of l_d is the mean over both ends and the
    force knows the velocity: the same two lines are repeated until x_{k+1} stands still.
    """
    n, there = reduced.n, x
    for _ in range(80):
        velocity = np.concatenate([(there - x) / h, xi])
        half = p - h / 2 * (reduced.pull(x, velocity) + reduced.rows(x)[:, :n].T @ impulse / h)
        metric = (reduced.metric(x) + reduced.metric(there)) / 2
        before, coupling = there, metric[:n, n:] @ xi
        there = x + h * np.linalg.solve(metric[:n, :n], half - coupling)
        if np.max(np.abs(there - before)) < 1e-17:
            break
    return there, half


def reduced_rattle(reduced: Reduced, h: float, state: State) -> State:
    """One step of (37), in the order of the paper; with an affine term also its (37d) is that."""
    n, (x, p, xi, m, impulse) = reduced.n, state
    # (37a), (37c)
    x1, half = next_base(reduced, h, x, p, xi, impulse)
    velocity = np.concatenate([(x1 - x) / h, xi])
    # (37d), (37e), (37b) in (37f): linear in p~, M~, lambda
    mu = reduced.rows(x1)
    gradients = mu @ np.linalg.inv(reduced.metric(x1))
    carried = reduced.group.transport(h * xi) @ m
    kicked = np.concatenate([half - h / 2 * reduced.pull(x1, velocity), carried])
    weight = np.repeat([0.5, 1.0], [n, len(xi)])[:, None]
    mean = np.repeat([1.0, 0.5], [n, len(xi)])
    size = len(kicked)
    left = np.block(
        [[np.eye(size), weight * mu.T], [gradients * mean, np.zeros((len(mu), len(mu)))]]
    )
    wanted = mu @ reduced.section(x1) - gradients[:, n:] @ carried / 2
    found = np.linalg.solve(left, np.concatenate([kicked, wanted]))
    p1, m1, impulse1 = found[:n], found[n:size], found[size:]

    def residual(xi1: Any) -> Any:
        x2, _ = next_base(reduced, h, x1, p1, xi1, impulse1)
        return moment(reduced, gni.Rattle(), h, x1, x2, xi1)[0] - m1

    return x1, p1, root(residual, xi), m1, impulse1


# Four systems.


def steered_sleigh(tau: gni.Retraction) -> Reduced:
    """A sleigh whose blade is steered by a rotor on a spring, R^1 x SE(2); body velocities."""
    inertia = np.array(
        [[0.3, 0.2, 0.0, 0.0], [0.2, 0.9, 0.0, 0.45], [0.0, 0.0, 1.3, 0.0], [0.0, 0.45, 0.0, 1.3]]
    )
    return Reduced(
        "steered sleigh",
        Group("SE(2)", "left", tau),
        lambda x: inertia,
        lambda x: np.array([[0.0, 0.6 * np.cos(x[0]), -np.sin(x[0]), np.cos(x[0])]]),
        lambda x: 0.7 * x[0] ** 2 - 0.4 * np.cos(2 * x[0] - 0.3) + 0.2 * x[0] ** 4,
        None,
        np.array([0.4]),
        [0.9, 0.7, 1.1, 0.2],
    )


def ball(tau: gni.Retraction) -> Reduced:
    """A ball on springs on a table that turns, R^2 x SO(3); space velocities.

    The moments, which a ball has equal, differ: only so does the side matter, erratum 14.
    """
    inertia, radius, table = np.diag([1.7, 1.7, 0.6, 0.9, 0.7]), 0.8, 0.9
    rows = np.array([[1.0, 0.0, 0.0, -radius, 0.0], [0.0, 1.0, radius, 0.0, 0.0]])
    return Reduced(
        "ball",
        Group("SO(3)", "right", tau),
        lambda x: inertia,
        lambda x: rows,
        lambda x: 0.6 * x[0] ** 2 + 0.3 * x[1] ** 4 + 0.4 * np.sin(x[0] - x[1]),
        lambda x: table * np.array([-x[1], x[0], 0.0, 0.0, 0.0]),
        np.array([0.5, -0.7]),
        [0.4, 0.6, -0.3, 0.5, 0.8],
    )


def coupled(tau: gni.Retraction) -> Reduced:
    """Two rows and a full constant metric on R^2 x SE(2); body velocities."""
    root = np.array(
        [[0.3, -0.2, 0.5, 0.1, 0.4], [0.2, 0.6, -0.1, 0.3, -0.3], [-0.5, 0.1, 0.2, 0.4, 0.1]]
    )
    inertia = root.T @ root + np.diag([0.9, 1.3, 0.7, 1.1, 0.8])
    rows = np.array([[1.0, 0.2, -0.3, 0.4, 0.1], [0.3, -0.4, 0.5, 0.2, 1.0]])
    tilt = np.array([[0.0, 0.4, 0.2, -0.1, 0.3], [-0.2, 0.1, 0.0, 0.5, 0.2]])
    return Reduced(
        "coupled",
        Group("SE(2)", "left", tau),
        lambda x: inertia,
        lambda x: rows + np.sin(x[0] + 0.7 * x[1]) * tilt,
        lambda x: 0.5 * x[0] ** 2 + 0.3 * np.cos(x[1] - 0.4 * x[0]) + 0.2 * x[1] ** 4,
        None,
        np.array([0.3, -0.6]),
        [0.7, 0.5, 0.8, -0.4, 0.6],
    )


def flexible(tau: gni.Retraction) -> Reduced:
    """Metric, rows and drift all depend on the shape, R^2 x SO(3); body velocities."""
    inertia = np.diag([0.9, 1.2, 0.8, 1.4, 0.7])
    bulge, bend = np.array([0.4, -0.3, 0.5, 0.2, -0.4]), np.array([0.1, 0.5, -0.2, 0.4, 0.3])
    rows, tilt = np.array([[0.3, -0.2, 1.0, 0.4, 0.1]]), np.array([[0.4, 0.3, 0.1, -0.3, 0.5]])
    still = np.array([0.2, -0.1, 0.3, 0.1, -0.2])

    def metric(x: Any) -> Any:
        first, second = np.cos(x[0] - 0.4), 0.8 * np.sin(x[1] + 0.5 * x[0])
        return inertia + first**2 * np.outer(bulge, bulge) + second**2 * np.outer(bend, bend)

    return Reduced(
        "flexible",
        Group("SO(3)", "left", tau),
        metric,
        lambda x: rows + np.cos(x[1]) * tilt,
        lambda x: 0.4 * x[0] ** 2 * x[1] + 0.5 * x[1] ** 2 + 0.2 * np.sin(2 * x[0]),
        lambda x: still + 0.3 * x[0] * bend,
        np.array([0.6, -0.4]),
        [0.5, 0.7, -0.6, 0.9, 0.4],
    )


def coordinates_of(state: State) -> Any:
    """All numbers of a state, one after the other."""
    return np.concatenate(state)


def states_of(reduced: Reduced, run: gni.Trajectory) -> list[State]:
    """(x, p~, xi, M~, lambda) of every node but the last of a `Rattle` run of the library."""
    n = reduced.n
    xi = run.rows[1:, run.layout.size : -1][:, n:]
    return [
        (run.base[k], run.momenta[k, :n], xi[k], run.momenta_after[k, n:],
         -run.step_size * run.multipliers[k])
        for k in range(len(run) - 1)
    ]  # fmt: skip
