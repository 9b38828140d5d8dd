"""The continuously variable transmission: two oscillators geared by a driver that turns."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.groupoids import SO2, FramedPairGroupoid, VectorGroup
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import MechanicalSystem, Parameters


def variable_transmission(
    gearing: ArrayLike = (0.0, 1.0, 0.0, 0.0),
    stiffness: float = 1.7,
    quartic: float = 0.3,
    asymmetry: float = 0.5,
    position: ArrayLike = (1.0, 0.5),
    velocity: float = 0.3,
    driver: float = 0.3,
    driver_speed: float = 2.5,
) -> Scene:
    """Two oscillators x, z and a driver at the angle y, unit masses, with ``x' + f(y) z' = 0``.

    ``f = c_0 + c_1 sin y + c_2 cos y + c_3 sin 2y``,
    ``V = (x^2 + k z^2)/2 + q (x^4/4 + x^2 z^2/2) + cos y + e/2 sin 2y``.

    gearing : (c_0, c_1, c_2, c_3).  stiffness : k.  quartic : q.  asymmetry : e.
    position, velocity : (x, z) and z' at the start; x' follows.  driver, driver_speed : y, y'.

    A test of long-time behaviour in the manner of Modin and Verdier (Numer. Math. 145, 2020): the
    motion is reversible for e = 0 and f = sin y, and not in general; then hardly any method keeps
    the energy unless it is made to. Kept: the energy.

    The driver is a rotation, so that its angle never grows: in R the round-off of a large y would
    be what limits the energy. Base (x, z, rotation of y row by row), velocity (x', z', y').
    """
    c = checked_numbers("gearing", gearing, (4,))
    place = checked_numbers("position", position, (2,))
    system = MechanicalSystem(
        FramedPairGroupoid(VectorGroup(2), SO2()),
        metric=np.eye(3),
        constraints=lambda x, p: np.array([[1.0, _ratio(x, p), 0.0]]),
        potential=_potential,
        parameters={"c": c, "k": stiffness, "q": quartic, "e": asymmetry},
    )
    cosine, sine = np.cos(driver), np.sin(driver)
    base = np.array([*place, cosine, -sine, sine, cosine])
    slope = float(c @ [1.0, sine, cosine, np.sin(2.0 * driver)])
    return Scene(
        system,
        system.state(base, [-slope * velocity, velocity, driver_speed]),
        "continuously variable transmission on R^2 x SO(2); nothing left out",
    )


def _ratio(x: Array, p: Parameters) -> Any:
    cosine, sine = x[2], x[4]
    return p.c[0] + p.c[1] * sine + p.c[2] * cosine + 2.0 * p.c[3] * sine * cosine


def _potential(x: Array, p: Parameters) -> Any:
    springs = (x[0] ** 2 + p.k * x[1] ** 2) / 2.0
    coupling = p.q * (x[0] ** 4 / 4.0 + (x[0] * x[1]) ** 2 / 2.0)
    return springs + coupling + x[2] + p.e * x[4] * x[2]


