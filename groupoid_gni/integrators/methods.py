"""Methods as values: what to step with.

A discrete Lagrangian is itself a method (the paper's two-step GNI); ``GNI`` is the projected step,
the library's default; ``DiscreteLagrangeDAlembert`` is the method of [28], for comparison;
``ReferenceFlow`` integrates the equations of motion to a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from groupoid_gni.discretization import (
    ConstraintAtBothEnds,
    DiscreteConstraint,
    DiscreteLagrangian,
    EulerB,
    Rattle,
)
from groupoid_gni.errors import InputError


@dataclass(frozen=True)
class Variational:
    """The free flight of a discrete Lagrangian: solve FL-(g) = p, then p+ = FL+(g).

    discrete_lagrangian : the first half of the step; the second half uses its adjoint. The default
        pair Euler B, Euler A evaluates the potential once per step, where the impact is.
    """

    discrete_lagrangian: DiscreteLagrangian = field(default_factory=EulerB)

    def __post_init__(self) -> None:
        if not isinstance(self.discrete_lagrangian, DiscreteLagrangian):
            raise InputError(
                "Variational takes a discrete Lagrangian such as gni.Rattle(), not "
                f"{self.discrete_lagrangian!r}"
            )


@dataclass(frozen=True)
class GNI:
    """Geometric nonholonomic integrator with symmetric projection; the default method.

    Each step flies h/2, is reflected, flies h/2, with a normal momentum lent before and taken back
    after, so that the step maps the constraint set to itself to round-off, is self-adjoint, and has
    no parasitic mode.

    order : 2.
    flow : the free flight, ``Variational(...)``.
    """

    order: int = 2
    flow: Variational = field(default_factory=Variational)

    def __post_init__(self) -> None:
        if self.order != 2:
            raise InputError(
                f"GNI(order={self.order!r}) is not available; this version has order=2. For more "
                "digits over short times use ReferenceFlow(rtol=...)"
            )
        if not isinstance(self.flow, Variational):
            raise InputError(f"flow must be a free flight such as Variational(), not {self.flow!r}")

    def __str__(self) -> str:
        if self.flow == Variational():
            return f"GNI(order={self.order})"
        return f"GNI(order={self.order}, flow=Variational({self.flow.discrete_lagrangian}))"


@dataclass(frozen=True)
class DiscreteLagrangeDAlembert:
    """The discrete Lagrange-d'Alembert method of [28], Iglesias-Ponte et al. 2008, for comparison.

    ``<FL-(h) - FL+(g), X> = 0`` for all X in D_q, and every arrow lies in the discrete constraint
    M_c; with affine constraints M_c is affine and D linear. The momentum of a node is the common
    part of FL+(g) and FL-(h) on D_q, lifted to the constraint set.

    discrete_lagrangian : L_d.
    constraint : M_c, by where ``mu (xi - Y) = 0`` is imposed on the arrow ``retract(x0, h xi)``:
        ``ConstraintAtBothEnds()`` (the mean), ``ConstraintAtMidpoint()``, ``ConstraintAtSource()``,
        ``ConstraintAtTarget()``.

    Self-adjoint, and so of order 2, when both are: Rattle or Midpoint, with BothEnds or Midpoint.
    Otherwise of order 1; the adjoint has the adjoints of both. Over a point all four constraints
    are one. M_c is written in the retraction, which matters more than for GNI: on the ball of
    Figure 1 the errors are half of Rattle's with the exponential and 280 times Rattle's with
    Cayley (docs/decisions/0012-discrete-lagrange-dalembert.md).
    """

    discrete_lagrangian: DiscreteLagrangian = field(default_factory=Rattle)
    constraint: DiscreteConstraint = field(default_factory=ConstraintAtBothEnds)

    def __post_init__(self) -> None:
        if not isinstance(self.discrete_lagrangian, DiscreteLagrangian):
            raise InputError(
                "DiscreteLagrangeDAlembert takes a discrete Lagrangian such as gni.Rattle(), not "
                f"{self.discrete_lagrangian!r}"
            )
        if not isinstance(self.constraint, DiscreteConstraint):
            raise InputError(
                "constraint must be a value such as gni.ConstraintAtBothEnds(), not "
                f"{self.constraint!r}"
            )

    def __str__(self) -> str:
        return f"DiscreteLagrangeDAlembert({self.discrete_lagrangian}, {self.constraint})"


@dataclass(frozen=True)
class ReferenceFlow:
    """The equations of motion themselves, by an adaptive method of order 8 (SciPy's DOP853).

    Not structure-preserving: use it for short-time accuracy and as an oracle.

    rtol : relative tolerance per step.
    atol : absolute tolerance of base coordinates and velocities (of momenta, times the inertia at
        the start); rtol * 1e-2 when left out.
    """

    rtol: float = 1e-10
    atol: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("rtol", self.rtol), ("atol", self.atol)):
            number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            if value is not None and not (number and 0.0 < value < 1.0):
                raise InputError(f"{name} must lie between 0 and 1, got {value!r}")
        if self.rtol < 1e-13:
            raise InputError(f"rtol={self.rtol} is below what doubles can give; use 1e-13 or more")

    def __str__(self) -> str:
        atol = "" if self.atol is None else f", atol={self.atol:g}"
        return f"ReferenceFlow(rtol={self.rtol:g}{atol})"


SteppingMethod = DiscreteLagrangian | GNI | DiscreteLagrangeDAlembert
Method = SteppingMethod | ReferenceFlow
