"""Discrete constraint submanifolds M_c of the groupoid as values: where an arrow is constrained.

The arrow ``retract(x0, h xi)`` lies in M_c when ``mu (xi - Y) = 0`` holds at a point of it, or on
the mean of two. Each is one of the rules that make a discrete Lagrangian from L, applied to the
violation ``mu(x) (xi - Y(x))`` instead.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from groupoid_gni.discretization.discrete_lagrangians import (
    DiscreteLagrangian,
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
)


class DiscreteConstraint(ABC):
    """Where the constraint is imposed on an arrow; one of the four below."""

    @property
    @abstractmethod
    def rule(self) -> DiscreteLagrangian:
        """The rule of evaluation; its adjoint is that of M_c under inversion of arrows."""


@dataclass(frozen=True)
class ConstraintAtSource(DiscreteConstraint):
    """``mu(x0) (xi - Y(x0)) = 0``; not self-adjoint, the adjoint is ``ConstraintAtTarget``."""

    @property
    def rule(self) -> DiscreteLagrangian:
        """As Euler A."""
        return EulerA()


@dataclass(frozen=True)
class ConstraintAtTarget(DiscreteConstraint):
    """``mu(x1) (xi - Y(x1)) = 0``; not self-adjoint, the adjoint is ``ConstraintAtSource``."""

    @property
    def rule(self) -> DiscreteLagrangian:
        """As Euler B."""
        return EulerB()


@dataclass(frozen=True)
class ConstraintAtBothEnds(DiscreteConstraint):
    """Mean of ``mu (xi - Y)`` over the two ends is zero; self-adjoint."""

    @property
    def rule(self) -> DiscreteLagrangian:
        """As Rattle."""
        return Rattle()


@dataclass(frozen=True)
class ConstraintAtMidpoint(DiscreteConstraint):
    """``mu (xi - Y) = 0`` at the target of the true half arrow; self-adjoint."""

    @property
    def rule(self) -> DiscreteLagrangian:
        """As Midpoint."""
        return Midpoint()
