"""The algebroid of a groupoid, differentiated from the seven functions along one direction.

An arrow g is seen in the coordinates (x, xi) = (alpha(g), lift(g)), the same for all members of a
class. A section X of AG moves them by

    X->(g) = T l_g X(beta(g)):           x' = 0,             xi' = B+(x, xi) X(beta(g))
    X<-(g) = -T r_g T i X(alpha(g)):     x' = -rho(x) X(x),  xi' = -B-(x, xi) X(x)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.expressions import RecordedFunction, record
from groupoid_gni.groupoids import LieGroupoid

# Sections, and the fields they make.


class SmoothSection(Protocol):
    """A section of AG, or its multiple by a function."""

    def at(self, x: FloatArray) -> FloatArray:
        """Its value, shape (rank,)."""

    def along(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """Its derivative along dx, shape (rank,)."""


@dataclass(frozen=True, eq=False)
class Section:
    """X(x) = a + cos(wave.x + shift) c."""

    a: FloatArray
    c: FloatArray
    wave: FloatArray
    shift: float

    def at(self, x: FloatArray) -> FloatArray:
        """Its value, shape (rank,)."""
        return self.a + np.cos(self.wave @ x + self.shift) * self.c

    def along(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """Its derivative along dx, shape (rank,)."""
        return -np.sin(self.wave @ x + self.shift) * (self.wave @ dx) * self.c


@dataclass(frozen=True, eq=False)
class Multiple:
    """f X with f(x) = sin(wave.x + shift)."""

    section: Section
    wave: FloatArray
    shift: float

    def factor(self, x: FloatArray) -> float:
        """Give f(x)."""
        return float(np.sin(self.wave @ x + self.shift))

    def slope(self, x: FloatArray, dx: FloatArray) -> float:
        """Give df along dx."""
        return float(np.cos(self.wave @ x + self.shift) * (self.wave @ dx))

    def at(self, x: FloatArray) -> FloatArray:
        """Its value, shape (rank,)."""
        return self.factor(x) * self.section.at(x)

    def along(self, x: FloatArray, dx: FloatArray) -> FloatArray:
        """Its derivative along dx, shape (rank,)."""
        return self.slope(x, dx) * self.section.at(x) + self.factor(x) * self.section.along(x, dx)


class Field(Protocol):
    """A vector field on arrows, in the coordinates (x, xi): a column of base_size + rank."""

    def at(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """Its value, shape (base_size + rank,)."""

    def along(self, x: FloatArray, xi: FloatArray, change: FloatArray) -> FloatArray:
        """Its derivative along a change of (x, xi), shape (base_size + rank,)."""


@dataclass(frozen=True, eq=False)
class LeftField:
    """X->."""

    algebroid: Algebroid
    section: SmoothSection

    def at(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """Its value, shape (base_size + rank,)."""
        end = self.algebroid.end(x, xi)
        return np.concatenate([0.0 * x, self.algebroid.plus(x, xi, self.section.at(end))])

    def along(self, x: FloatArray, xi: FloatArray, change: FloatArray) -> FloatArray:
        """Its derivative, by the chain rule through the target."""
        view = self.algebroid
        dx, dxi = view.cut(change)
        end = view.end(x, xi)
        slope = self.section.along(end, view.end_along(x, xi, dx, dxi))
        change = view.plus_along(x, xi, self.section.at(end), dx, dxi) + view.plus(x, xi, slope)
        return np.concatenate([0.0 * x, change])


@dataclass(frozen=True, eq=False)
class RightField:
    """X<-."""

    algebroid: Algebroid
    section: SmoothSection

    def at(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """Its value, shape (base_size + rank,)."""
        return -self.algebroid.minus(x, xi, self.section.at(x))

    def along(self, x: FloatArray, xi: FloatArray, change: FloatArray) -> FloatArray:
        """Its derivative, shape (base_size + rank,)."""
        dx, dxi = self.algebroid.cut(change)
        return -(
            self.algebroid.minus_along(x, xi, self.section.at(x), dx, dxi)
            + self.algebroid.minus(x, xi, self.section.along(x, dx))
        )


def bracket_of_fields(u: Field, v: Field, x: FloatArray, xi: FloatArray) -> FloatArray:
    """[U, V] = DV U - DU V at an arrow, shape (base_size + rank,)."""
    return v.along(x, xi, u.at(x, xi)) - u.along(x, xi, v.at(x, xi))


# The algebroid, from the seven functions.


class Algebroid:
    """The algebroid of a groupoid, differentiated along one direction at a time.

    ``anchor``, ``bracket``, B+ and B- as the groupoid declares them are ``self.space``'s; methods
    here are exact derivatives of the seven functions, which share nothing with closed forms. One
    direction costs a hundredth of all of them where the logarithm is a long iteration.
    """

    def __init__(self, space: LieGroupoid) -> None:
        self.space = space

    def cut(self, change: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Cut (x', xi') in two."""
        return change[: self.space.base_size], change[self.space.base_size :]

    def end(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """beta(g), g = retract(x, xi)."""
        return np.asarray(self.space.target(self.space.retract(x, xi)), dtype=float)

    def end_along(self, x: FloatArray, xi: FloatArray, dx: Any, dxi: Any) -> FloatArray:
        """Its derivative along (dx, dxi)."""
        return self._end[0](x, xi, dx, dxi, 0.0 * xi, 0.0, 0.0)

    def plus(self, x: FloatArray, xi: FloatArray, v: FloatArray) -> FloatArray:
        """B+ v = d/de lift(g retract(beta(g), e v)), shape (rank,)."""
        return self._plus[0](x, xi, 0.0 * x, 0.0 * xi, v, 0.0, 0.0)

    def plus_along(
        self, x: FloatArray, xi: FloatArray, v: FloatArray, dx: FloatArray, dxi: FloatArray
    ) -> FloatArray:
        """Its derivative along (dx, dxi) for a constant v."""
        return self._plus[1](x, xi, dx, dxi, v, 0.0, 0.0)

    def minus(self, x: FloatArray, xi: FloatArray, v: FloatArray) -> FloatArray:
        """(rho v, B- v) = d/de (alpha, lift)(retract(x, e v)^-1 g), shape (base_size + rank,)."""
        return self._minus[0](x, xi, 0.0 * x, 0.0 * xi, v, 0.0, 0.0)

    def minus_along(
        self, x: FloatArray, xi: FloatArray, v: FloatArray, dx: FloatArray, dxi: FloatArray
    ) -> FloatArray:
        """Its derivative along (dx, dxi) for a constant v."""
        return self._minus[1](x, xi, dx, dxi, v, 0.0, 0.0)

    def derived_bracket(self, x: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        """[u, v] = D_xi(B+ v) u - D_xi(B+ u) v at xi = 0, for constant components u and v."""
        still = 0.0 * x
        return self.plus_along(x, 0.0 * u, v, still, u) - self.plus_along(x, 0.0 * u, u, still, v)

    def bracket(self, x: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        """The declared structure functions on two vectors, shape (rank,)."""
        return (self.space.bracket(x) @ v) @ u

    def bracket_along(
        self, x: FloatArray, u: FloatArray, v: FloatArray, dx: FloatArray
    ) -> FloatArray:
        """The derivative of the declared structure functions along dx, on two vectors."""
        return self._bracket_change(x, dx, u, v, 0.0)

    def anchor(self, x: FloatArray, v: FloatArray) -> FloatArray:
        """The declared anchor on a vector, shape (base_size,)."""
        return self.space.anchor(x) @ v

    def anchor_along(self, x: FloatArray, v: FloatArray, dx: FloatArray) -> FloatArray:
        """The derivative of the declared anchor along dx, on a vector."""
        return self._anchor_change(x, dx, v, 0.0)

    def bracket_of_sections(
        self, first: SmoothSection, second: SmoothSection, x: FloatArray
    ) -> FloatArray:
        """[[X, Y]](x) by the declared bracket and anchor."""
        u, v = first.at(x), second.at(x)
        moved = second.along(x, self.anchor(x, u)) - first.along(x, self.anchor(x, v))
        return self.bracket(x, u, v) + moved

    def left_translation(
        self, x: FloatArray, xi: FloatArray, eta: FloatArray, change: FloatArray
    ) -> FloatArray:
        """T l_g of a change of eta at h = retract(beta(g), eta), g = retract(x, xi): (rank,)."""
        return self._left_translation(x, xi, eta, change, 0.0)

    def right_translation(
        self, x: FloatArray, xi: FloatArray, y: FloatArray, eta: FloatArray, change: FloatArray
    ) -> FloatArray:
        """T r_h of a change of (x, xi) at g = retract(x, xi), h = retract(y, eta).

        y is the target of g; shape (base_size + rank,).
        """
        return self._right_translation(x, xi, *self.cut(change), y, eta, 0.0)

    @cached_property
    def _end(self) -> tuple[RecordedFunction, RecordedFunction]:
        space = self.space

        def end(x: Any, xi: Any, v: Any, e: Any) -> Any:
            return space.target(space.retract(x, xi))

        recorded = self._moving(end, space.base_size)
        return recorded.derivative(5), recorded

    @cached_property
    def _plus(self) -> tuple[RecordedFunction, RecordedFunction]:
        space = self.space

        def lengthened(x: Any, xi: Any, v: Any, e: Any) -> Any:
            g = space.retract(x, xi)
            return space.lift(space.multiply(g, space.retract(space.target(g), e * v)))

        slope = self._moving(lengthened, space.rank).derivative(6)
        return slope, slope.derivative(5)

    @cached_property
    def _minus(self) -> tuple[RecordedFunction, RecordedFunction]:
        space = self.space

        def shortened(x: Any, xi: Any, v: Any, e: Any) -> Any:
            back = space.inverse(space.retract(x, e * v))
            arrow = space.multiply(back, space.retract(x, xi))
            return np.concatenate([space.source(arrow), space.lift(arrow)])

        slope = self._moving(shortened, space.base_size + space.rank).derivative(6)
        return slope, slope.derivative(5)

    def _moving(self, function: Callable[..., Any], size: int) -> RecordedFunction:
        """Record function(x + t dx, xi + t dxi, v, e) of (x, xi, dx, dxi, v, t, e)."""

        def moved(x: Any, xi: Any, dx: Any, dxi: Any, v: Any, t: Any, e: Any) -> Any:
            return function(x + t * dx, xi + t * dxi, v, e)

        return record(moved, self._inputs("x xi dx dxi v t e"), (size,), name=function.__name__)

    @cached_property
    def _bracket_change(self) -> RecordedFunction:
        def bracket(x: Any, dx: Any, u: Any, v: Any, t: Any) -> Any:
            return (self.space.bracket(x + t * dx) @ v) @ u

        inputs = self._inputs("x dx u v t")
        return record(bracket, inputs, (self.space.rank,), name="bracket").derivative(4)

    @cached_property
    def _anchor_change(self) -> RecordedFunction:
        def anchor(x: Any, dx: Any, v: Any, t: Any) -> Any:
            return self.space.anchor(x + t * dx) @ v

        inputs = self._inputs("x dx v t")
        return record(anchor, inputs, (self.space.base_size,), name="anchor").derivative(3)

    @cached_property
    def _left_translation(self) -> RecordedFunction:
        space = self.space

        def moved(x: Any, xi: Any, eta: Any, deta: Any, t: Any) -> Any:
            g = space.retract(x, xi)
            return space.lift(space.multiply(g, space.retract(space.target(g), eta + t * deta)))

        inputs = self._inputs("x xi eta deta t")
        return record(moved, inputs, (space.rank,), name="left translation").derivative(4)

    @cached_property
    def _right_translation(self) -> RecordedFunction:
        space = self.space

        def moved(x: Any, xi: Any, dx: Any, dxi: Any, y: Any, eta: Any, t: Any) -> Any:
            g = space.retract(x + t * dx, xi + t * dxi)
            arrow = space.multiply(g, space.retract(y, eta))
            return np.concatenate([space.source(arrow), space.lift(arrow)])

        size = (space.base_size + space.rank,)
        inputs = self._inputs("x xi dx dxi y eta t")
        return record(moved, inputs, size, name="right translation").derivative(6)

    def _inputs(self, names: str) -> dict[str, tuple[int, ...]]:
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(("t", "e"), ())
        shapes |= dict.fromkeys(("x", "dx", "y"), (self.space.base_size,))
        return {name: shapes.get(name, (self.space.rank,)) for name in names.split()}
