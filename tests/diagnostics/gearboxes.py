"""Continuously variable transmissions: x' + f(y) z' = 0 between two oscillators, y driving."""

from __future__ import annotations

from typing import Any

import numpy as np

import groupoid_gni as gni

REVERSIBLE = (0.0, 1.0, 0.0, 0.0)
NOT_REVERSIBLE = (0.3, 1.0, 0.4, 0.5)


def gearbox(
    ratio: tuple[float, ...],
    *,
    asymmetry: float = 0.5,
    quartic: float = 0.3,
    driver: bool = True,
    stiffness: tuple[float, float, float] = (1.0, 0.0, 1.7),
    metric: Any = None,
) -> tuple[gni.MechanicalSystem, gni.State]:
    """f = a + b sin y + c cos y + d sin 2y; driver potential cos y + asymmetry/2 sin 2y.

    stiffness : of x, y and z; quartic : of x^4/4 + x^2 z^2/2.
    """
    k_x, k_y, k_z = stiffness

    def potential(q: Any, p: Any) -> Any:
        x, y, z = q[0], q[1], q[2]
        springs = (k_x * x**2 + k_y * y**2 + k_z * z**2) / 2
        coupled = quartic * (x**4 / 4 + x**2 * z**2 / 2)
        drive = np.cos(y) + asymmetry / 2 * np.sin(2 * y) if driver else 0.27 * y * k_y
        return springs + coupled + drive

    def constraints(q: Any, p: Any) -> Any:
        y, (a, b, c, d) = q[1], ratio
        f = a + b * np.sin(y) + c * np.cos(y) + d * np.sin(2 * y)
        return gni.array([[1.0, 0.0, f]])

    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=np.eye(3) if metric is None else metric,
        constraints=constraints,
        potential=potential,
    )
    return system, system.state([1.0, 0.3, 0.5], [0.0, 2.5, 0.3], project_start=True)
