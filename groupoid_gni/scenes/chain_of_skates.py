"""A chain of skates joined by springs: a nonholonomic system of any size."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import PairGroupoid
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.systems import MechanicalSystem, Parameters


def chain_of_skates(
    skates: int = 5,
    mass: float = 1.3,
    inertia: float = 0.4,
    stiffness: float = 2.0,
    alignment: float = 0.8,
    spacing: float = 1.0,
    tether: float = 0.1,
    seed: int = 1,
) -> Scene:
    """N knife edges in a row, each joined to the next by a spring and a torsion spring.

    ``x_i' sin(th_i) - y_i' cos(th_i) = 0`` for every skate,
    ``V = sum k/2 ((x_i+1 - x_i - d)^2 + (y_i+1 - y_i)^2) + c/2 (th_i+1 - th_i)^2 + t/2 y_i^2``.

    skates : N.  mass, inertia : m, J of each.  stiffness, alignment, spacing, tether : k, c, d, t.
    seed : of the headings and speeds at the start.

    Base (x_1, y_1, th_1, x_2, ...), velocities its derivatives. A test of how cost grows with the
    number of bodies: the work of a step is proportional to N. Kept: the energy.
    """
    if isinstance(skates, bool) or not isinstance(skates, int) or skates < 1:
        raise InputError(f"skates must be a whole number from 1, got {skates!r}")
    system = MechanicalSystem(
        PairGroupoid(3 * skates),
        metric=np.diag(np.tile([mass, mass, inertia], skates)),
        constraints=_no_side_slip,
        potential=_springs,
        parameters={"k": stiffness, "c": alignment, "d": spacing, "t": tether},
    )
    rng = np.random.default_rng(seed)
    headings = rng.uniform(-0.3, 0.3, skates)
    speeds, turns = rng.uniform(0.2, 0.8, skates), rng.uniform(-0.5, 0.5, skates)
    base = np.stack([spacing * np.arange(skates), np.zeros(skates), headings], axis=1)
    velocity = np.stack([speeds * np.cos(headings), speeds * np.sin(headings), turns], axis=1)
    return Scene(
        system,
        system.state(base.ravel(), velocity.ravel()),
        f"chain of {skates} skates joined by springs; nothing left out",
    )


def _no_side_slip(q: Array, p: Parameters) -> Array:
    headings = q[2::3]
    sines, cosines = np.sin(headings), np.cos(headings)
    count = len(headings)
    rows: list[list[Any]] = [[0.0] * (3 * count) for _ in range(count)]
    for i, row in enumerate(rows):
        row[3 * i], row[3 * i + 1] = sines[i], -cosines[i]
    return np.array(rows)


def _springs(q: Array, p: Parameters) -> Any:
    x, y, heading = q[0::3], q[1::3], q[2::3]
    apart, aside, twist = x[1:] - x[:-1] - p.d, y[1:] - y[:-1], heading[1:] - heading[:-1]
    stretched = p.k * ((apart**2).sum() + (aside**2).sum()) / 2.0
    return stretched + p.c * (twist**2).sum() / 2.0 + p.t * (y**2).sum() / 2.0
