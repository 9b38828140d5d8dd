"""The scenes of the report in the two forms in which other people's integrators take them.

``Derived``: equations without multipliers, derived by hand, written for any module with sin and cos
(NumPy, heyoka, jax.numpy, a tracer). ``Stated``: mass matrix, constraint rows, forces, as somebody
writes them who derives nothing by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import peers

import groupoid_gni as gni

Rates = Callable[[Any, Sequence[Any]], list[Any]]
Node = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Derived:
    """y' = rates(module, y).  start : (N,).  node : y -> (base, velocity) of the library."""

    start: np.ndarray
    rates: Rates
    node: Callable[[np.ndarray], Node]


@dataclass(frozen=True)
class Stated:
    """M v' = force + mu^T lambda, mu v' = bias, q' = turned(q, v); y = (q, v).

    parts : y -> (q', M, mu, force, bias).
    """

    start: np.ndarray
    parts: Callable[[np.ndarray], tuple[np.ndarray, ...]]
    node: Callable[[np.ndarray], Node]

    def field(self, t: float, y: np.ndarray) -> np.ndarray:
        """y', the multipliers solved for in every call."""
        rate, metric, mu, force, bias = self.parts(y)
        return np.concatenate([rate, peers.constrained(metric, mu, force, bias)])


@dataclass(frozen=True)
class Native:
    """A scene in both forms."""

    derived: Derived
    stated: Stated


def _split(size: int) -> Callable[[np.ndarray], Node]:
    return lambda y: (y[:size], y[size:])


def _numbers(scene: gni.scenes.Scene) -> Any:
    """Parameters by attribute: floats, or arrays."""
    values = scene.system.parameters
    return peers._Numbers({k: float(v) if np.ndim(v) == 0 else v for k, v in values.items()})


def _of_model(model: peers.Model, base_size: int, parts: Any) -> Native:
    form = model.forms[0]
    derived = Derived(
        form.start, form.taylor, lambda y: _split(base_size)(form.library_state(y))
    )
    return Native(derived, Stated(model.numpy.start, parts, _split(base_size)))


def rolling_ball(scene: gni.scenes.Scene) -> Native:
    """v' = rate J v; the spin follows from rolling."""
    p = _numbers(scene)
    rate = p.Theta * p.I / (p.I + p.m * p.r**2)
    spin = float(scene.start.velocity[4])

    def node(y: np.ndarray) -> Node:
        (x, z), v = y[:2], y[2:]
        turning = [(p.Theta * x - v[1]) / p.r, (p.Theta * z + v[0]) / p.r, spin]
        return y[:2], np.array([*v, *turning])

    metric = np.diag([p.m, p.m, p.I, p.I, p.I])
    mu = np.array([[1.0, 0.0, 0.0, -p.r, 0.0], [0.0, 1.0, p.r, 0.0, 0.0]])

    def parts(y: np.ndarray) -> tuple[np.ndarray, ...]:
        return y[2:4], metric, mu, np.zeros(5), p.Theta * np.array([-y[3], y[2]])

    start = np.concatenate([scene.start.base, scene.start.velocity])
    derived = Derived(start[:4], lambda m, y: [y[2], y[3], -rate * y[3], rate * y[2]], node)
    return Native(derived, Stated(start, parts, _split(2)))


def inhomogeneous_ball(scene: gni.scenes.Scene) -> Native:
    """Two rows of R and the place; what is conserved gives the spin."""
    p = _numbers(scene)
    metric = np.diag([p.m, p.m, *p.I])

    def parts(y: np.ndarray) -> tuple[np.ndarray, ...]:
        R, v, omega = y[2:11].reshape(3, 3), y[11:13], y[13:]
        mu = np.zeros((2, 5))
        mu[0, 0] = mu[1, 1] = 1.0
        mu[0, 2:], mu[1, 2:] = -p.r * R[1], p.r * R[0]
        force = np.concatenate([np.zeros(2), np.cross(p.I * omega, omega)])
        rate = np.concatenate([v, np.cross(R, omega).ravel()])
        return rate, metric, mu, force, p.Theta * np.array([-v[1], v[0]])

    return _of_model(peers.ball(), 11, parts)


def chaplygin_sleigh(scene: gni.scenes.Scene) -> Native:
    """omega and the speed along the blade."""
    p = _numbers(scene)
    metric = np.array(
        [[p.J + p.m * p.a**2, 0.0, p.m * p.a], [0.0, p.m, 0.0], [p.m * p.a, 0.0, p.m]]
    )
    blade = np.array([[0.0, 0.0, 1.0]])

    def parts(v: np.ndarray) -> tuple[np.ndarray, ...]:
        return np.zeros(0), metric, blade, _plane_force(metric @ v, v), np.zeros(1)

    return _of_model(peers.sleigh(), 0, parts)


def _plane_force(momentum: np.ndarray, v: np.ndarray) -> np.ndarray:
    """ad* on SE(2) in (omega, along, across)."""
    return np.array([
        v[2] * momentum[1] - v[1] * momentum[2], v[0] * momentum[2], -v[0] * momentum[1]
    ])  # fmt: skip


def suslov(scene: gni.scenes.Scene) -> Native:
    """Omega_1 and Omega_2."""
    p = _numbers(scene)

    def parts(v: np.ndarray) -> tuple[np.ndarray, ...]:
        return np.zeros(0), p.I, p.a[None, :], np.cross(p.I @ v, v), np.zeros(1)

    return _of_model(peers.suslov(), 0, parts)


def veselova(scene: gni.scenes.Scene) -> Native:
    """The vertical and Omega; the multiplier from gamma . Omega' = 0."""
    p = _numbers(scene)
    a, b, c = (float(i) for i in p.I)
    w = [float(x) for x in p.weight]

    def rates(m: Any, y: Sequence[Any]) -> list[Any]:
        g, o = y[:3], y[3:]
        torque = peers._cross([a * o[0], b * o[1], c * o[2]], o)
        weight = peers._cross(g, w)
        free = [(torque[i] + weight[i]) / (a, b, c)[i] for i in range(3)]
        raised = [g[0] / a, g[1] / b, g[2] / c]
        pull = -peers._dot(g, free) / peers._dot(g, raised)
        return [*peers._cross(g, o), *(free[i] + pull * raised[i] for i in range(3))]

    def parts(y: np.ndarray) -> tuple[np.ndarray, ...]:
        g, o = y[:3], y[3:]
        force = np.cross(p.I * o, o) + np.cross(g, p.weight)
        return np.cross(g, o), np.diag(p.I), g[None, :], force, np.zeros(1)

    start = np.concatenate([scene.start.base, scene.start.velocity])
    return Native(Derived(start, rates, _split(3)), Stated(start, parts, _split(3)))


def constrained_particle(scene: gni.scenes.Scene) -> Native:
    """(y, x, y', x'); z' = y x'."""
    p = _numbers(scene)

    def rates(m: Any, u: Sequence[Any]) -> list[Any]:
        y, x, vy, vx = u
        pulled = (-(p.k_x / p.m) * x - y * vy * vx) / (1.0 + y * y)
        return [vy, vx, -(p.k_y / p.m) * y, pulled]

    def parts(u: np.ndarray) -> tuple[np.ndarray, ...]:
        y, x, vy, vx, _ = u
        force = -np.array([p.k_y * y, p.k_x * x, 0.0])
        mu = np.array([[0.0, -y, 1.0]])
        return u[2:4], p.m * np.eye(3), mu, force, np.array([vy * vx])

    start = np.concatenate([scene.start.base, scene.start.velocity])
    derived = Derived(start[:4], rates, lambda u: (u[:2], np.append(u[2:], u[0] * u[3])))
    return Native(derived, Stated(start, parts, _split(2)))


def two_wheeled_robot(scene: gni.scenes.Scene) -> Native:
    """(psi_1, omega, u), with a detent on the first wheel."""
    p = _numbers(scene)
    mass, offset = p.m_0 + 2.0 * p.m_1, p.m_0 * p.l
    turning = p.J_0 + p.m_0 * p.l**2 + 2.0 * p.m_1 * p.c**2 + p.J_2
    along = mass + 2.0 * p.J_2 / p.R**2
    twist = turning + 2.0 * p.J_2 * (p.c / p.R) ** 2

    def rates(m: Any, y: Sequence[Any]) -> list[Any]:
        psi, omega, u = y
        pull = (p.k / p.R) * m.cos(psi)
        return [
            (u - p.c * omega) * (1.0 / p.R),
            (p.c * pull - offset * u * omega) * (1.0 / twist),
            (offset * omega * omega - pull) * (1.0 / along),
        ]

    def node(y: np.ndarray) -> Node:
        psi, omega, u = y
        wheels = [(u - p.c * omega) / p.R, (u + p.c * omega) / p.R]
        return np.array([psi]), np.array([*wheels, omega, u, 0.0])

    body = np.array([[turning, 0.0, offset], [0.0, mass, 0.0], [offset, 0.0, mass]])
    metric = np.zeros((5, 5))
    metric[0, 0] = metric[1, 1] = p.J_2
    metric[2:, 2:] = body
    mu = np.array(
        [[0.0, 0, 0, 0, 1], [-p.R, 0, -p.c, 1, 0], [0, -p.R, p.c, 1, 0]]
    )

    def parts(y: np.ndarray) -> tuple[np.ndarray, ...]:
        v = y[3:]
        force = np.concatenate([[-p.k * np.cos(y[0]), 0.0], _plane_force(body @ v, v)])
        return y[1:2], metric, mu, force, np.zeros(3)

    base, velocity = scene.start.base, scene.start.velocity
    start = np.concatenate([base, velocity])
    derived = Derived(np.array([base[0], velocity[2], velocity[3]]), rates, node)
    return Native(derived, Stated(start, parts, _split(1)))


def variable_transmission(scene: gni.scenes.Scene) -> Native:
    """(x, z, y, z', y'); x' = -f(y) z'. The driver's angle y is not wrapped."""
    p = _numbers(scene)
    c0, c1, c2, c3 = (float(c) for c in p.c)

    def driver(m: Any, y: Any) -> tuple[Any, Any, Any]:
        """f, f', V_y."""
        sine, cosine = m.sin(y), m.cos(y)
        sine2, cosine2 = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
        f = c0 + c1 * sine + c2 * cosine + c3 * sine2
        return f, c1 * cosine - c2 * sine + 2.0 * c3 * cosine2, p.e * cosine2 - sine

    def pull(x: Any, z: Any) -> tuple[Any, Any]:
        return x + p.q * x * (x * x + z * z), p.k * z + p.q * z * x * x

    def rates(m: Any, u: Sequence[Any]) -> list[Any]:
        x, z, y, s, w = u
        f, slope, along = driver(m, y)
        vx, vz = pull(x, z)
        return [-f * s, s, w, (f * vx - vz - f * slope * w * s) / (1.0 + f * f), -along]

    def turned(y: float) -> list[float]:
        return [np.cos(y), -np.sin(y), np.sin(y), np.cos(y)]

    def node(u: np.ndarray) -> Node:
        x, z, y, s, w = u
        return np.array([x, z, *turned(y)]), np.array([-driver(np, y)[0] * s, s, w])

    def parts(u: np.ndarray) -> tuple[np.ndarray, ...]:
        x, z, y = u[:3]
        f, slope, along = driver(np, y)
        mu = np.array([[1.0, f, 0.0]])
        force = -np.array([*pull(x, z), along])
        return u[3:], np.eye(3), mu, force, np.array([-slope * u[5] * u[4]])

    x, z, cosine, _, sine, _ = scene.start.base
    angle = float(np.arctan2(sine, cosine))
    velocity = scene.start.velocity
    derived = Derived(np.array([x, z, angle, *velocity[1:]]), rates, node)
    stated = Stated(
        np.array([x, z, angle, *velocity]), parts,
        lambda u: (np.array([u[0], u[1], *turned(u[2])]), u[3:]),
    )  # fmt: skip
    return Native(derived, stated)


MAKERS: dict[str, Callable[[gni.scenes.Scene], Native]] = {
    maker.__name__: maker
    for maker in (
        rolling_ball, inhomogeneous_ball, chaplygin_sleigh, suslov, veselova,
        constrained_particle, two_wheeled_robot, variable_transmission,
    )
}  # fmt: skip
