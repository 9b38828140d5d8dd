"""Rigid bodies that roll on a plane, from Newton and Euler, in plain floats; by DOP853.

Nothing of the library is used. With r the arm from the centre of mass to the contact point, all in
the body frame: ``gamma' = gamma x W``, ``V = r x W``, and the force F of the plane eliminated from
``m (V' + W x V) = F - m g gamma`` and ``I W' + W x I W = r x F``:

    (I - m r^ r^) W' = m r x (r' x W + W x V + g gamma) - W x I W.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

Vector = tuple[float, float, float]
Arm = Callable[[Vector, Vector], tuple[Vector, Vector]]
"""(gamma, gamma') -> (r, r')."""


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def dot(a: Vector, b: Vector) -> float:
    """<a, b>."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def times(rows: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    """Matrix times vector."""
    return dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)


def solved(rows: tuple[Vector, Vector, Vector], b: Vector) -> Vector:
    """The solution of a symmetric 3 x 3 system, by Cramer's rule."""
    first, second, third = cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(*rows[:2])
    determinant = dot(rows[0], first)
    # the columns of the inverse times the determinant
    return tuple(
        (first[i] * b[0] + second[i] * b[1] + third[i] * b[2]) / determinant for i in range(3)
    )


def acceleration(
    m: float, g: float, inertia: Any, arm: Arm, gamma: Vector, spin: Vector
) -> tuple[Vector, Vector, Vector]:
    """(gamma', W', F): F is the force of the plane, in the body frame."""
    turned = cross(gamma, spin)
    r, moved = arm(gamma, turned)
    velocity = cross(r, spin)
    carried = tuple(
        a + b + g * c
        for a, b, c in zip(cross(moved, spin), cross(spin, velocity), gamma, strict=True)
    )
    torque = cross(r, carried)
    euler = cross(spin, times(inertia, spin))
    square = dot(r, r)
    rows = tuple(
        tuple(inertia[i][j] + m * ((square if i == j else 0.0) - r[i] * r[j]) for j in range(3))
        for i in range(3)
    )
    turning = solved(rows, tuple(m * a - b for a, b in zip(torque, euler, strict=True)))
    force = tuple(m * (a + b) for a, b in zip(cross(r, turning), carried, strict=True))
    return turned, turning, force


def motion(
    m: float, g: float, inertia: Any, arm: Arm, start: Any, instants: Any, rtol: float = 1e-11
) -> np.ndarray:
    """(gamma, W) at the instants, (n, 6)."""
    inertia = tuple(tuple(map(float, row)) for row in inertia)

    def rates(t: float, y: Any) -> Any:
        values = y.tolist()
        turned, turning, _ = acceleration(m, g, inertia, arm, values[:3], values[3:])
        return turned + turning

    done = solve_ivp(
        rates, (0.0, instants[-1]), start, method="DOP853", t_eval=instants, rtol=rtol, atol=rtol
    )
    if not done.success:
        raise RuntimeError(done.message)
    return done.y.T


def ellipsoid(a: float, b: float, c: float, depth: float) -> Arm:
    """The point of an ellipsoid where it touches; the centre of mass lies below its centre."""
    squares = (a * a, b * b, c * c)

    def arm(gamma: Vector, turned: Vector) -> tuple[Vector, Vector]:
        scaled = tuple(s * x for s, x in zip(squares, gamma, strict=True))
        moved = tuple(s * x for s, x in zip(squares, turned, strict=True))
        size = math.sqrt(dot(scaled, gamma))
        rate = dot(scaled, turned) / size
        r = tuple(-x / size for x in scaled)
        rates = tuple(-y / size + x * rate / size**2 for x, y in zip(scaled, moved, strict=True))
        return (r[0], r[1], r[2] + depth), rates

    return arm


def rim(radius: float) -> Arm:
    """The lowest point of a circle about the third axis."""

    def arm(gamma: Vector, turned: Vector) -> tuple[Vector, Vector]:
        x, y = gamma[0], gamma[1]
        size = math.hypot(x, y)
        rate = (x * turned[0] + y * turned[1]) / size
        r = (-radius * x / size, -radius * y / size, 0.0)
        rates = tuple(
            -radius * (turned[i] / size - gamma[i] * rate / size**2) for i in range(2)
        )
        return r, (rates[0], rates[1], 0.0)

    return arm


def reversals(instants: Any, spin: Any, smallest: float = 1.0) -> list[float]:
    """Times at which a spin has changed its sign for good: until it next exceeds ``smallest``."""
    found, sign, last = [], np.sign(spin[0]), None
    for k in range(1, len(spin)):
        if spin[k - 1] * spin[k] < 0.0:
            share = spin[k - 1] / (spin[k - 1] - spin[k])
            last = float(instants[k - 1] + share * (instants[k] - instants[k - 1]))
        if abs(spin[k]) > smallest and np.sign(spin[k]) != sign:
            found.append(last)
            sign = np.sign(spin[k])
    return found
