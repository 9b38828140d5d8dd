"""A zoo of small mechanical systems, one recipe on every kind of groupoid.

Each system also exists a second time as plain NumPy functions (`Plain`), which share nothing with
the library but the numbers. Loaded by path from other test folders, see `tests/integrators`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import groupoid_gni as gni

DIRECTION = np.array([0.48, 0.6, 0.64])


def turned_back(q: Any, rotation: Any) -> Any:
    """The right action q -> R^T q on directions."""
    return (q[..., None, :] @ rotation)[..., 0, :]


def turned(q: Any, rotation: Any) -> Any:
    """The left action q -> R q on directions."""
    return (rotation @ q[..., None])[..., 0]


def spaces() -> dict[str, Callable[[], gni.LieGroupoid]]:
    """Makers of every kind of groupoid, both sides, both retractions, and one of size 12."""
    made: dict[str, Callable[[], gni.LieGroupoid]] = {
        "pair 1": lambda: gni.PairGroupoid(1),
        "pair 3": lambda: gni.PairGroupoid(3),
    }
    retractions = {"cay": gni.Cayley(), "exp": gni.Exponential()}
    for tau, retraction in retractions.items():
        for side in ("left", "right"):
            options = {"side": side, "retraction": retraction}
            for group in (gni.SO2, gni.SO3, gni.SE2, gni.SE3):
                made[f"{group.__name__} {side} {tau}"] = lambda g=group, o=options: g(**o)
            made[f"R3 {side} {tau}"] = lambda o=options: gni.VectorGroup(3, **o)
            made[f"SO4 {side} {tau}"] = lambda o=options: gni.QuadraticGroup(np.eye(4), **o)
            made[f"atiyah {side} {tau}"] = lambda o=options: gni.AtiyahGroupoid(2, gni.SO3(**o))
            made[f"framed {side} {tau}"] = lambda o=options: gni.FramedPairGroupoid(
                gni.VectorGroup(2), gni.SO3(**o)
            )
            made[f"action {side} {tau}"] = lambda o=options: gni.ActionGroupoid(
                gni.SO3(**o), turned_back if o["side"] == "left" else turned, DIRECTION
            )
        made[f"product {tau}"] = lambda t=retraction: gni.ProductGroupoid(
            gni.FramedPairGroupoid(gni.SE2(retraction=t)),
            gni.PairGroupoid(1),
            gni.SO3(side="right", retraction=t),
        )
    made["twelve"] = lambda: gni.ProductGroupoid(
        gni.PairGroupoid(3),
        gni.FramedPairGroupoid(gni.SO3()),
        gni.SO3(side="right"),
        gni.SO3(retraction=gni.Exponential()),
    )
    return made


SPACES = spaces()
SMALL = ["pair 3", "SO3 left cay", "SE2 right exp", "atiyah right cay", "framed left cay"]


@dataclass(frozen=True)
class Plain:
    """The functions of a system, in plain NumPy."""

    metric: Callable[[Any], Any]
    constraints: Callable[[Any], Any]
    drift: Callable[[Any], Any]
    gyroscopic: Callable[[Any], Any]
    potential: Callable[[Any], Any]

    def lagrangian(self, x: Any, xi: Any) -> Any:
        """1/2 G(xi, xi) + A xi - V."""
        return 0.5 * xi @ self.metric(x) @ xi + self.gyroscopic(x) @ xi - self.potential(x)

    def momentum(self, x: Any, xi: Any) -> Any:
        """G xi + A."""
        return self.metric(x) @ xi + self.gyroscopic(x)

    def offset(self, x: Any) -> Any:
        """Pi = G Y + A."""
        return self.momentum(x, self.drift(x))

    def projectors(self, x: Any) -> tuple[Any, Any]:
        """Dense P* and Q* of section 2, by explicit inverses."""
        inverse, mu = np.linalg.inv(self.metric(x)), self.constraints(x)
        along = mu.T @ np.linalg.inv(mu @ inverse @ mu.T) @ mu @ inverse
        return np.eye(len(inverse)) - along, along


@dataclass(frozen=True)
class Animal:
    """A system, its plain twin, and a start."""

    name: str
    system: gni.MechanicalSystem
    plain: Plain
    start: gni.State


def animal(
    name: str,
    m: int = 1,
    *,
    affine: bool = False,
    potential: bool = True,
    gyroscopic: bool = False,
    curved: bool = True,
    speed: float = 1.0,
    seed: int = 7,
    space: gni.LieGroupoid | None = None,
) -> Animal:
    """Make a system with m constraints on a named groupoid; awkward numbers from a seed.

    curved : whether metric and constraints depend on the base point.
    """
    space = SPACES[name]() if space is None else space
    n, r = space.base_size, space.rank
    m = min(m, r - 1)
    rng = np.random.default_rng([seed, r, n, m])
    root = rng.uniform(-0.3, 0.3, (r, r))
    inertia = root @ root.T + np.diag(rng.uniform(0.7, 1.9, r))
    bulge, wave, shift = rng.uniform(-0.5, 0.5, r), rng.uniform(-0.9, 0.9, n), rng.uniform(0.2, 1)
    rows = np.eye(m, r) + rng.uniform(-0.4, 0.4, (m, r))
    tilt, roll = rng.uniform(-0.3, 0.3, (m, r)), rng.uniform(-0.9, 0.9, n)
    push, pull = rng.uniform(-0.6, 0.6, n), rng.uniform(-0.8, 0.8, n)
    still, flow = rng.uniform(-0.4, 0.4, r), rng.uniform(-0.3, 0.3, r)
    twist, turn = rng.uniform(-0.5, 0.5, r), rng.uniform(-0.5, 0.5, r)
    bend = 1.0 if curved and n else 0.0

    def metric(x: Any, bend: Any = bend) -> Any:
        return inertia + bend * np.sin(wave @ x + shift) ** 2 * np.outer(bulge, bulge)

    def constraints(x: Any, bend: Any = bend) -> Any:
        return rows + bend * np.cos(roll @ x) * tilt

    def height(x: Any, weight: Any = 0.7) -> Any:
        return weight * (push @ x + 0.5 * (pull @ x) ** 2 + 0.1 * (pull @ x) ** 4)

    def drift(x: Any, rate: Any = 0.8) -> Any:
        return rate * (still + np.cos(wave @ x + shift) * flow)

    def one_form(x: Any, charge: Any = 0.6) -> Any:
        return charge * (twist + np.sin(roll @ x + shift) * turn)

    has_potential = potential and n > 0
    system = gni.MechanicalSystem(
        space,
        metric=(lambda x, p: metric(x, p.bend)) if bend else inertia,
        constraints=((lambda x, p: constraints(x, p.bend)) if bend else rows) if m else None,
        potential=(lambda x, p: height(x, p.weight)) if has_potential else None,
        drift=(lambda x, p: drift(x, p.rate)) if affine and m else None,
        gyroscopic=(lambda x, p: one_form(x, p.charge)) if gyroscopic else None,
        parameters={"bend": bend, "weight": 0.7, "rate": 0.8, "charge": 0.6},
    )
    nothing = np.zeros(r)
    plain = Plain(
        metric=metric,
        constraints=constraints,
        drift=drift if affine and m else lambda x: nothing,
        gyroscopic=one_form if gyroscopic else lambda x: nothing,
        potential=height if has_potential else lambda x: 0.0,
    )
    x = np.array(space.example_base_point)
    x = space.target(space.retract(x, rng.uniform(-0.4, 0.4, r)))
    velocity = speed * rng.uniform(-1, 1, r)
    start = system.state(x if n else None, velocity, project_start=True)
    return Animal(name, system, plain, start)
