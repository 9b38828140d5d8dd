"""Systems made from a system, that must move as it does.

A variant is the same mechanics written otherwise: in another frame, with the product turned round,
with other rows for the same constraints, before a reduction, with a term that says nothing. The
opposite groupoid and the one before a reduction have no closed forms: their anchor, B+, B- and
bracket are derived from the seven functions.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import DependentConstraintsWarning
from groupoid_gni.expressions import array
from groupoid_gni.groupoids import FramedPairGroupoid, LieGroup, LieGroupoid
from groupoid_gni.groupoids.components import join
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

# Other groupoids.


class _SameArrows(LieGroupoid):
    """A groupoid with the arrows of another one, whose frame is F times the old one."""

    def __init__(self, space: LieGroupoid, frame: FloatArray) -> None:
        self.space, self.frame, self.back = space, frame, np.linalg.inv(frame)
        self.rank, self.example_base_point = space.rank, space.example_base_point

    def identity(self, x: Array) -> Array:
        """Give the same identity."""
        return self.space.identity(x)

    def inverse(self, g: Array) -> Array:
        """Give the same inverse."""
        return self.space.inverse(g)

    # derived, a half arrow of a large groupoid takes seconds to record
    def half(self, x: Array, xi: Array) -> Array:
        """Give ``F^-1 half(x, F xi)``."""
        return self.back @ self.space.half(x, self.frame @ xi)

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the reach of ``F xi``."""
        return self.space.reach(x, self.frame @ xi)

    def base_defect(self, x: Array) -> Array:
        """Give the same defect."""
        return self.space.base_defect(x)

    def restore_base(self, x: Array) -> Array:
        """Restore as the groupoid does."""
        return self.space.restore_base(x)

    def restore_arrow(self, g: Array) -> Array:
        """Restore as the groupoid does."""
        return self.space.restore_arrow(g)


class Reframed(_SameArrows):
    """The same groupoid in the frame ``e'_a = F e_a``: ``retract'(x, xi') = retract(x, F xi')``."""

    def source(self, g: Array) -> Array:
        """Give the same source."""
        return self.space.source(g)

    def target(self, g: Array) -> Array:
        """Give the same target."""
        return self.space.target(g)

    def multiply(self, g: Array, h: Array) -> Array:
        """Give the same product."""
        return self.space.multiply(g, h)

    def retract(self, x: Array, xi: Array) -> Array:
        """Give ``retract(x, F xi)``."""
        return self.space.retract(x, self.frame @ xi)

    def lift(self, g: Array) -> Array:
        """Give ``F^-1 lift(g)``."""
        return self.back @ self.space.lift(g)

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give ``F^-1 B+ F``."""
        return self.back @ self.space.trivialised_tangent_plus(x, self.frame @ xi) @ self.frame

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give ``F^-1 B- F``."""
        return self.back @ self.space.trivialised_tangent_minus(x, self.frame @ xi) @ self.frame


class Opposite(_SameArrows):
    """The opposite groupoid: source and target exchanged, ``multiply'(g, h) = multiply(h, g)``.

    Inversion is an isomorphism onto it; ``retract'(x, xi) = retract(x, -xi)^-1`` makes its
    velocities the negative ones. Of a left group it is the right one.
    """

    def __init__(self, space: LieGroupoid) -> None:
        super().__init__(space, -np.eye(space.rank))

    def source(self, g: Array) -> Array:
        """Give the target."""
        return self.space.target(g)

    def target(self, g: Array) -> Array:
        """Give the source."""
        return self.space.source(g)

    def multiply(self, g: Array, h: Array) -> Array:
        """Give the product in the other order."""
        return self.space.multiply(h, g)

    def retract(self, x: Array, xi: Array) -> Array:
        """Give ``retract(x, -xi)^-1``."""
        return self.space.inverse(self.space.retract(x, -xi))

    def lift(self, g: Array) -> Array:
        """Give ``-lift(g^-1)``."""
        return -self.space.lift(self.space.inverse(g))


class PairsOfArrows(LieGroupoid):
    """Pairs (W, W') of arrows with one source: what a groupoid is the reduction of.

    Base points are the arrows W; ``retract(W, xi) = (W, W retract(beta(W), xi))``; ``W^-1 W'`` maps
    it onto the groupoid. Of a group it is the pair groupoid in the frame of the group's side.
    """

    def __init__(self, space: LieGroupoid) -> None:
        self.space, self.rank, self._size = space, space.rank, space.arrow_size
        start = np.asarray(space.example_base_point, dtype=np.float64)
        self.example_base_point = np.asarray(space.identity(start), dtype=np.float64)

    def source(self, g: Array) -> Array:
        """Give W."""
        return g[..., : self._size]

    def target(self, g: Array) -> Array:
        """Give W'."""
        return g[..., self._size :]

    def identity(self, x: Array) -> Array:
        """Give (W, W)."""
        return join(x, x)

    def multiply(self, g: Array, h: Array) -> Array:
        """Give (W, W')(W', W'') = (W, W'')."""
        return join(self.source(g), self.target(h))

    def inverse(self, g: Array) -> Array:
        """Give (W', W)."""
        return join(self.target(g), self.source(g))

    def retract(self, x: Array, xi: Array) -> Array:
        """Give (W, W retract(beta(W), xi))."""
        step = self.space.retract(self.space.target(x), xi)
        return join(x, self.space.multiply(x, step))

    def lift(self, g: Array) -> Array:
        """Give ``lift(W^-1 W')``."""
        return self.space.lift(
            self.space.multiply(self.space.inverse(self.source(g)), self.target(g))
        )

    def half(self, x: Array, xi: Array) -> Array:
        """Give the half arrow at beta(W)."""
        return self.space.half(self.space.target(x), xi)

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the reach at beta(W)."""
        return self.space.reach(self.space.target(x), xi)

    def restore_base(self, x: Array) -> Array:
        """Restore the arrow W."""
        return self.space.restore_arrow(x)


def other_side(group: LieGroup) -> LieGroup:
    """The same group with body and space velocities exchanged."""
    twin = copy(group)
    for name in [name for name in vars(twin) if name.startswith("_recorded")]:
        delattr(twin, name)
    twin.side = "right" if group.side == "left" else "left"
    return twin


# Other systems.


def _itself(x: Any) -> Any:
    return x


@dataclass(frozen=True, eq=False)
class Variant:
    """A system that must move as another one does, and how to compare them.

    frame, shift : F and c in ``xi = F xi'`` and ``p' = F^T p + c``.
    begin : from a base point to one of the variant.  end : back.
    """

    system: MechanicalSystem
    frame: FloatArray
    shift: FloatArray
    begin: Callable[[FloatArray], FloatArray] = _itself
    end: Callable[[FloatArray], ArrayLike] = _itself

    def state(self, x: FloatArray, xi: FloatArray) -> State:
        """The start that belongs to a start of the original."""
        velocity = np.asarray(np.linalg.solve(self.frame, xi), dtype=float)
        return start(self.system, self.begin(x), velocity)

    def original(self, run: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Base points, velocities and momenta (before and after, stacked), told by the original."""
        base = np.array([self.end(point) for point in run.base], dtype=np.float64)
        momenta = np.stack([run.momenta_before, run.momenta_after]) - self.shift
        # rows are covectors: p = F^-T (p' - c)
        return base, run.velocities @ self.frame.T, momenta @ np.linalg.inv(self.frame)


def start(system: MechanicalSystem, x: FloatArray, xi: FloatArray) -> State:
    """A state of a system; dependent rows are left out without a warning."""
    with dependent_rows_are_fine():
        return system.state(x if system.space.base_size else None, xi, project_start=True)


@contextmanager
def dependent_rows_are_fine() -> Iterator[None]:
    """No warning of constraint rows that are left out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DependentConstraintsWarning)
        yield


def rewritten(
    system: MechanicalSystem,
    space: LieGroupoid,
    *,
    frame: FloatArray | None = None,
    rows: FloatArray | None = None,
    shift: FloatArray | None = None,
    place: Callable[[Any], Any] = _itself,
) -> MechanicalSystem:
    """The terms of a system and the force on it, written for another groupoid.

    frame : F in ``xi = F xi'``.  rows : A in ``mu' = A mu``.  shift : c in ``A' = A + c``.
    place : from the new base point to the old one.
    """
    plain, one = dict(system.plain), np.eye(space.rank)
    f = one if frame is None else frame
    back = one if frame is None else np.linalg.inv(frame)
    c = np.zeros(space.rank) if shift is None else shift

    def term(name: str, x: Any, p: Any) -> Any:
        return array(plain[name](place(x), p))

    terms: dict[str, Any] = {"metric": lambda x, p: f.T @ term("metric", x, p) @ f}
    if system.constraint_count:
        a = np.eye(system.constraint_count) if rows is None else rows
        terms["constraints"] = lambda x, p: a @ term("constraints", x, p) @ f
    if "drift" in plain:
        terms["drift"] = lambda x, p: back @ term("drift", x, p)
    if "potential" in plain:
        terms["potential"] = lambda x, p: plain["potential"](place(x), p)
    if "gyroscopic" in plain:
        terms["gyroscopic"] = lambda x, p: f.T @ term("gyroscopic", x, p) + c
    elif shift is not None:
        terms["gyroscopic"] = c
    push = system._force
    if push is not None:
        terms["force"] = lambda x, xi, p: f.T @ array(push(place(x), f @ xi, p))
    return MechanicalSystem(space, parameters=dict(system.parameters), **terms)


def without_constraints(system: MechanicalSystem) -> MechanicalSystem:
    """The same Lagrangian and the same force on the same groupoid, moving freely."""
    terms: dict[str, Any] = {
        name: term for name, term in system.plain.items() if name not in ("constraints", "drift")
    }
    terms["force"] = system._force
    return MechanicalSystem(system.space, parameters=dict(system.parameters), **terms)


def recombined(system: MechanicalSystem) -> Variant:
    """Rows A mu with an invertible A, and one combination of them too many."""
    m, r = system.constraint_count, system.space.rank
    numbers = np.arange(1.0, (m + 1) * m + 1.0).reshape(m + 1, m)
    rows = 1.2 * np.eye(m + 1, m) + 0.6 * np.sin(numbers) / m  # the first m dominate diagonally
    return Variant(rewritten(system, system.space, rows=rows), np.eye(r), np.zeros(r))


def awkward_frame(inertias: FloatArray) -> FloatArray:
    """A frame that stretches every component and mixes the two halves of them, (r, r).

    inertias : (r,), so that what is mixed has the same energy, whatever the units.
    It and its inverse are sparse: with a full one, machine code for 12 components takes seconds.
    """
    rank, half = len(inertias), len(inertias) // 2
    numbers, one = np.arange(1.0, rank + 1.0), np.arange(half)
    frame = np.diag(1.2 + 0.5 * np.sin(numbers))
    ratio = np.sqrt(inertias[one] / inertias[one + half])
    frame[one + half, one] = 0.6 * np.cos(numbers[:half]) * ratio
    return frame


def _inertias(system: MechanicalSystem) -> FloatArray:
    """The diagonal of the metric at the example base point."""
    x = np.array(system.space.example_base_point, dtype=np.float64)
    return np.asarray(np.diag(system.evaluate("metric", x)), dtype=float)


def reframed(system: MechanicalSystem) -> Variant:
    """The system in an awkward constant frame."""
    r = system.space.rank
    frame = awkward_frame(_inertias(system))
    other = rewritten(system, Reframed(system.space, frame), frame=frame)
    return Variant(other, frame, np.zeros(r))


def opposite(system: MechanicalSystem) -> Variant:
    """The system on the opposite groupoid; on a Lie group, with the other side."""
    space, r = system.space, system.space.rank
    other = other_side(space) if isinstance(space, LieGroup) else Opposite(space)
    frame = -np.eye(r)
    return Variant(rewritten(system, other, frame=frame), frame, np.zeros(r))


def unreduced(system: MechanicalSystem) -> Variant:
    """The system on pairs of arrows; on a Lie group, on its framed pair groupoid."""
    space, r = system.space, system.space.rank
    if isinstance(space, LieGroup):
        point = np.zeros(0)
        other = rewritten(system, FramedPairGroupoid(space), place=lambda x: point)
        return Variant(
            other, np.eye(r), np.zeros(r),
            lambda x: np.asarray(space.identity(x), dtype=float), lambda w: point,
        )
    other = rewritten(system, PairsOfArrows(space), place=space.target)
    return Variant(
        other, np.eye(r), np.zeros(r),
        lambda x: np.asarray(space.identity(x), dtype=float), space.target,
    )


def coordinate_velocities(space: LieGroupoid) -> FloatArray:
    """Which components of the velocity are differences of coordinates, (r,), 0 or 1.

    Those with ``B+^T e^a = e^a, B-^T e^a = -e^a``: a constant one-form along them is closed, and
    what it adds to L_d are the values of a function at both ends.
    """
    found = np.ones(space.rank)
    x = np.array(space.example_base_point, dtype=np.float64)
    for wave in (1.0, 2.0):
        xi = 0.4 * np.cos(wave + 2.0 * np.arange(space.rank))
        xi = xi * min(1.0, 0.4 / max(float(np.asarray(space.reach(x, xi))), 1e-3))
        plus, minus = space.trivialised_tangent_plus(x, xi), space.trivialised_tangent_minus(x, xi)
        off = np.abs(plus - np.eye(space.rank)) + np.abs(minus + np.eye(space.rank))
        found[np.max(off, axis=1) > 1e-13] = 0.0
        x = np.asarray(space.target(space.retract(x, xi)), dtype=float)
    return found


def regauged(system: MechanicalSystem) -> Variant:
    """The system with a constant closed one-form added to L."""
    r = system.space.rank
    form = coordinate_velocities(system.space) * (0.7 + 0.3 * np.cos(np.arange(1.0, r + 1.0)))
    form = form * _inertias(system)
    return Variant(rewritten(system, system.space, shift=form), np.eye(r), form)
