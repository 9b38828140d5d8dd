"""Mechanical systems on R^n in plain NumPy, each with the library's system of the same numbers.

What is differentiated here is differentiated by the complex step, exact to round-off, so nothing
below shares a derivative with the library. All numbers are awkward on purpose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import groupoid_gni as gni

Field = Callable[[Any], Any]
_TINY = 1e-40


def derivative(function: Field, x: Any) -> Any:
    """``d function / dx_i`` along the first axis, by the complex step."""
    x = np.asarray(x, dtype=float)
    return np.array([np.imag(function(x + 1j * _TINY * e)) / _TINY for e in np.eye(len(x))])


def close(found: Any, wanted: Any, tolerance: float) -> None:
    """Equal up to an absolute tolerance alone; NumPy would add a relative one of 1e-7."""
    np.testing.assert_allclose(found, wanted, rtol=0, atol=tolerance)


def slope(steps: Any, errors: Any) -> float:
    """The slope of log error over log step by least squares."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


@dataclass(frozen=True)
class Mechanics:
    """``L = 1/2 v G v - V`` with ``mu (v - Y) = 0`` on R^n, and a start on the constraint."""

    name: str
    metric: Field
    rows: Field
    potential: Field
    drift: Field | None
    base: Any
    wish: Any

    @cached_property
    def system(self) -> gni.MechanicalSystem:
        """The same for the library."""
        drift, free = self.drift, len(self.rows(self.base)) == 0
        return gni.MechanicalSystem(
            gni.PairGroupoid(len(self.base)),
            metric=lambda x, p: self.metric(x),
            constraints=None if free else lambda x, p: self.rows(x),
            potential=lambda x, p: self.potential(x),
            drift=None if drift is None else lambda x, p: drift(x),
        )

    @property
    def start(self) -> gni.State:
        """The start for the library."""
        return self.system.state(self.base, self.velocity)

    @cached_property
    def velocity(self) -> Any:
        """The velocity on the constraint nearest to the wish."""
        q, p = self.base, self.metric(self.base) @ np.asarray(self.wish)
        along, across = self.projectors(q)
        return np.linalg.solve(self.metric(q), along @ p + across @ self.one_form(q))

    def section(self, q: Any) -> Any:
        """Y of (24)."""
        return np.zeros(len(q)) if self.drift is None else self.drift(q)

    def one_form(self, q: Any) -> Any:
        """Pi = G(Y, .) of section 6."""
        return self.metric(q) @ self.section(q)

    def force(self, q: Any) -> Any:
        """V_q."""
        return derivative(self.potential, q)

    def projectors(self, q: Any) -> tuple[Any, Any]:
        """P* and Q*, the transposes of the local expressions of section 2."""
        inverse, mu = np.linalg.inv(self.metric(q)), self.rows(q)
        gradients = mu @ inverse
        q_map = gradients.T @ np.linalg.inv(gradients @ mu.T) @ mu
        return np.eye(len(inverse)) - q_map.T, q_map.T

    def lagrangian(self, q: Any, v: Any) -> Any:
        """(3)."""
        return 0.5 * v @ self.metric(q) @ v - self.potential(q)

    def accelerations(self, q: Any, v: Any) -> tuple[Any, Any]:
        """q'' and lambda of (2), both constraints of (2b) or (24) differentiated once."""
        n, mu, metric = len(q), self.rows(q), self.metric(q)
        turning = np.einsum("kij,k->ij", derivative(self.metric, q), v)
        by_base = derivative(lambda x: self.lagrangian(x, v), q)
        violation = derivative(lambda x: self.rows(x) @ (v - self.section(x)), q)
        left = np.block([[metric, -mu.T], [mu, np.zeros((len(mu), len(mu)))]])
        found = np.linalg.solve(left, np.concatenate([by_base - turning @ v, -v @ violation]))
        return found[:n], found[n:]

    def exact(self, end: float, rtol: float = 1e-11) -> tuple[Any, Any]:
        """(q, v) at a time, equations (2) by DOP853."""
        n = len(self.base)

        def rate(t: float, y: Any) -> Any:
            return np.concatenate([y[n:], self.accelerations(y[:n], y[n:])[0]])

        y0 = np.concatenate([self.base, self.velocity])
        y = solve_ivp(rate, (0.0, end), y0, method="DOP853", rtol=rtol, atol=rtol).y[:, -1]
        return y[:n], y[n:]


_MASS = np.array([[1.3, 0.2, 0.0], [0.2, 0.9, 0.1], [0.0, 0.1, 1.6]])
_MASS_OF_FIVE = np.diag([1.1, 0.8, 1.7, 0.6, 1.3]) + 0.09 * np.outer(
    [1, -2, 0.5, 1, -1], [1, -2, 0.5, 1, -1]
)


def particle(affine: bool = False, curved: bool = False) -> Mechanics:
    """A particle with ``z' - y x' + 0.3 sin(x) y' = ...`` in a tilted quartic well."""
    bulge = np.array([0.5, -0.4, 0.7])
    curvature = 1.0 if curved else 0.0
    return Mechanics(
        f"particle{', affine' if affine else ''}{', curved' if curved else ''}",
        lambda x: _MASS + curvature * np.sin(0.7 * x[0] - x[2] + 0.4) ** 2 * np.outer(bulge, bulge),
        lambda x: np.array([[-x[1], 0.3 * np.sin(x[0]), 1.0]]),
        lambda x: 0.4 * (x @ x) ** 2 + 0.3 * x[0] * x[2] + 0.5 * x[2],
        (lambda x: np.array([0.2 * x[2], 0.4, 0.6 * np.cos(x[1])])) if affine else None,
        np.array([0.5, -0.4, 0.3]),
        [0.7, 0.5, -0.2],
    )


def knife_edge(table: float = 0.0) -> Mechanics:
    """A knife edge (x, y, angle) on a table that turns, held by springs."""
    mass, inertia = 1.4, 0.35
    return Mechanics(
        "knife edge" if table == 0.0 else "knife edge on a turntable",
        lambda x: np.diag([mass, mass, inertia]),
        lambda x: np.array([[-np.sin(x[2]), np.cos(x[2]), 0.0]]),
        lambda x: 0.8 * x[0] + 0.3 * (x[0] ** 2 + x[1] ** 2) ** 2 + 0.4 * np.cos(x[2] - 0.3),
        (lambda x: table * np.array([-x[1], x[0], 0.0])) if table else None,
        np.array([0.6, -0.3, 0.8]),
        [0.9, 0.4, 1.1],
    )


def rolling_disc(table: float = 0.0) -> Mechanics:
    """An upright disc (x, y, heading, roll) rolling on a table that turns; two rows."""
    radius, inertia = 0.45, np.diag([1.7, 1.7, 0.3, 0.5])
    return Mechanics(
        "rolling disc" if table == 0.0 else "rolling disc on a turntable",
        lambda x: inertia,
        lambda x: np.array(
            [[1.0, 0.0, 0.0, -radius * np.cos(x[2])], [0.0, 1.0, 0.0, -radius * np.sin(x[2])]]
        ),
        lambda x: 0.7 * x[1] + 0.2 * (x[0] ** 2 + x[1] ** 2) ** 2 + 0.3 * np.sin(x[3] + x[2]),
        (lambda x: table * np.array([-x[1], x[0], 0.0, 0.0])) if table else None,
        np.array([0.5, -0.6, 0.4, 0.2]),
        [0.3, 0.2, 0.9, 1.2],
    )


def five() -> Mechanics:
    """Five degrees of freedom, two rows, nothing symmetric."""
    tilt = np.array([[0.3, -0.2, 0.5, 0.1, 0.4], [-0.4, 0.2, 0.1, 0.6, -0.3]])
    rows = np.array([[1.0, 0.2, 0.0, -0.3, 0.1], [0.1, -0.2, 1.0, 0.4, 0.0]])
    pull = np.array([0.5, -0.7, 0.3, 0.6, -0.4])
    return Mechanics(
        "five",
        lambda x: _MASS_OF_FIVE,
        lambda x: rows + np.sin(x[1] + 0.5 * x[3]) * tilt,
        lambda x: 0.5 * (pull @ x) ** 2 + 0.1 * (x @ x) ** 2 + 0.3 * np.sin(x[0] - x[4]),
        None,
        np.array([0.3, -0.5, 0.2, 0.6, -0.1]),
        [0.8, 0.3, -0.6, 0.4, 0.9],
    )


def free(mechanics: Mechanics) -> Mechanics:
    """The same without constraints."""
    q = mechanics.base
    nothing = np.zeros((0, len(q)))
    return Mechanics(
        mechanics.name + ", free", mechanics.metric, lambda x: nothing, mechanics.potential, None,
        q, mechanics.wish,
    )


def sleigh(table: float) -> Mechanics:
    """A sleigh (x, y, angle) on a table that turns, its mass ahead of the blade."""
    mass, inertia, ahead = 1.3, 0.4, 0.35

    def metric(x: Any) -> Any:
        along, across = -mass * ahead * np.sin(x[2]), mass * ahead * np.cos(x[2])
        return np.array(
            [[mass, 0.0, along], [0.0, mass, across], [along, across, inertia + mass * ahead**2]]
        )

    return Mechanics(
        "sleigh on a turntable",
        metric,
        lambda x: np.array([[-np.sin(x[2]), np.cos(x[2]), 0.0]]),
        lambda x: 0.5 * x[0] ** 2 + 0.3 * x[1] ** 4 + 0.6 * np.cos(x[2] + x[0]),
        lambda x: table * np.array([-x[1], x[0], 0.0]),
        np.array([0.5, 0.4, -0.7]),
        [0.6, -0.5, 0.9],
    )


def hat(z: Any) -> Any:
    """(39)."""
    return np.array([[0.0, -z[2], z[1]], [z[2], 0.0, -z[0]], [-z[1], z[0], 0.0]])


def angular_velocities(rho: Any) -> tuple[Any, Any]:
    """The matrices of rho' -> Omega and rho' -> omega of section 7.4.2, R = exp(rho)."""
    size = np.sqrt(rho @ rho)
    even = np.sin(size) / size * np.eye(3) - (np.sin(size) - size) / size**3 * np.outer(rho, rho)
    odd = (np.cos(size) - 1) / size**2 * hat(rho)
    return even + odd, even - odd


def rolling_ball(table: float) -> Mechanics:
    """The inhomogeneous ball of section 7.4.2 in its chart (x, y, rho), on a table that turns."""
    mass, radius, moments = 1.7, 0.8, np.diag([0.9, 0.5, 0.7])

    def metric(x: Any) -> Any:
        body, _ = angular_velocities(x[2:])
        plane, none = mass * np.eye(2), np.zeros((2, 3))
        return np.concatenate(
            [
                np.concatenate([plane, none], axis=1),
                np.concatenate([none.T, body.T @ moments @ body], axis=1),
            ]
        )

    def rows(x: Any) -> Any:
        _, space = angular_velocities(x[2:])
        spin = radius * np.stack([-space[1], space[0]])
        return np.concatenate([np.eye(2), spin], axis=1)

    return Mechanics(
        "ball on a turntable",
        metric,
        rows,
        lambda x: 0.4 * x[0] ** 2 + 0.2 * x[1],
        lambda x: table * np.array([-x[1], x[0], 0.0, 0.0, 0.0]),
        np.array([0.7, -0.2, 0.5, 0.4, -0.6]),
        [0.3, 0.6, 0.4, -0.2, 0.5],
    )
