"""Discrete Lagrangians L_d : G -> R as values.

Each is given by its average over the step, ``L_d = step * average``, as a function of both ends of
the arrow and of its velocity xi (the arrow is ``retract(x0, step * xi)``). Keeping the two ends
apart makes the discrete Legendre transforms (48) cheap: moving the source leaves the target alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids import LieGroupoid

Lagrangian = Callable[[Array, Array], Array]


class DiscreteLagrangian(ABC):
    """A rule that turns a Lagrangian L(x, xi) into a discrete Lagrangian.

    To write your own, subclass and give ``average``; it is recorded once, so it must be plain
    NumPy without branches on values. Make it a frozen dataclass: methods are keys of the compiled
    code.
    """

    force_weights: ClassVar[tuple[float, float]] = (0.5, 0.5)
    """Shares of an external force that act at the source and at the target of the arrow."""

    @abstractmethod
    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """L_d / step for the arrow ``retract(source, step * velocity)``.

        source, target : (base_size,), the two ends of the arrow.
        velocity : (rank,), xi.  step : scalar, h.
        Returns a scalar. ``target`` always equals ``space.target(space.retract(source, h xi))``;
        use the argument instead of computing it again.
        """

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    def adjoint(self) -> DiscreteLagrangian:
        """``L_d*(g) = -L_d(g^-1)`` at step -h, whose free step is the adjoint one."""
        return Adjoint(self)


@dataclass(frozen=True)
class Adjoint(DiscreteLagrangian):
    """``L_d*(g) = -L_d(g^-1)`` at step -h of another discrete Lagrangian."""

    original: DiscreteLagrangian

    @property
    def force_weights(self) -> tuple[float, float]:  # type: ignore[override]
        """Those of the original, exchanged."""
        first, second = self.original.force_weights
        return second, first

    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """The inverse arrow runs from target to source over the step -h with the same velocity."""
        return self.original.average(lagrangian, space, target, source, velocity, -step)

    def adjoint(self) -> DiscreteLagrangian:
        """The original."""
        return self.original


@dataclass(frozen=True)
class EulerA(DiscreteLagrangian):
    """``L_d = h L(x0, xi)``, equation (10); order 1, adjoint of Euler B (Theorem 5.4)."""

    force_weights = (1.0, 0.0)

    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """Evaluate L at the source."""
        return lagrangian(source, velocity)

    def adjoint(self) -> DiscreteLagrangian:
        """Euler B."""
        return EulerB()


@dataclass(frozen=True)
class EulerB(DiscreteLagrangian):
    """``L_d = h L(x1, xi)``, equation (10); order 1, adjoint of Euler A (Theorem 5.4)."""

    force_weights = (0.0, 1.0)

    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """Evaluate L at the target."""
        return lagrangian(target, velocity)

    def adjoint(self) -> DiscreteLagrangian:
        """Euler A."""
        return EulerA()


@dataclass(frozen=True)
class Rattle(DiscreteLagrangian):
    """``L_d = (h/2) (L(x0, xi) + L(x1, xi))``, equation (16): SHAKE and RATTLE, order 2."""

    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """Mean of L at the two ends."""
        return 0.5 * (lagrangian(source, velocity) + lagrangian(target, velocity))

    def adjoint(self) -> DiscreteLagrangian:
        """Itself."""
        return self


@dataclass(frozen=True)
class Midpoint(DiscreteLagrangian):
    """``L_d = h L(x_m, xi)`` at the target x_m of the half arrow, order 2.

    The true half arrow is used: with ``h xi / 2`` in its place the Cayley retraction would make
    the scheme not self-adjoint.
    """

    def average(
        self,
        lagrangian: Lagrangian,
        space: LieGroupoid,
        source: Array,
        target: Array,
        velocity: Array,
        step: Array,
    ) -> Array:
        """Evaluate L at the midpoint."""
        half = space.half(source, step * velocity)
        return lagrangian(space.target(space.retract(source, half)), velocity)

    def adjoint(self) -> DiscreteLagrangian:
        """Itself."""
        return self
