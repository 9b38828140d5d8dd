"""Methods as values: what to step with.

A discrete Lagrangian is itself a method (the paper's two-step GNI); ``GNI`` is the projected step,
the library's default; ``DiscreteLagrangeDAlembert`` is the method of [28], for comparison;
``ReferenceFlow`` integrates the equations of motion to a tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from groupoid_gni.discretization import (
    CompositionTable,
    ConstraintAtBothEnds,
    DiscreteConstraint,
    DiscreteLagrangian,
    Flow,
    Rattle,
    Variational,
    default_table,
)
from groupoid_gni.errors import InputError


@dataclass(frozen=True)
class SymmetricProjection:
    """Lend a normal momentum before each stage and take it back after, so that it ends on the
    constraint set: exact constraint, self-adjoint, no parasitic mode.
    """


@dataclass(frozen=True)
class GNI:
    """Geometric nonholonomic integrator; the library's default method.

    Each stage flies half its time, is reflected, and flies the other half. With the symmetric
    projection it maps the constraint set to itself to round-off, is self-adjoint, and has no
    parasitic mode; a step of order 4, 6 or 8 is a composition of such stages (docs/theory.md).

    order : 2, 4, 6 or 8.
    flow : the free flight: ``Variational(...)``, ``Splitting()`` or ``EnergyPreserving()``.
    projection : ``SymmetricProjection()``, or None for bare stages: cheaper, of the same order, and
        with the parasitic mode of two-step methods, which is monitored; for short runs.
    table : a ``CompositionTable`` in place of the default one of this order.
    """

    order: int = 2
    flow: Flow = field(default_factory=Variational)
    projection: SymmetricProjection | None = field(default_factory=SymmetricProjection)
    table: CompositionTable | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.flow, Flow):
            raise InputError(f"flow must be a free flight such as Variational(), not {self.flow!r}")
        if not (self.projection is None or isinstance(self.projection, SymmetricProjection)):
            raise InputError(
                f"projection must be SymmetricProjection() or None, not {self.projection!r}"
            )
        if self.table is None:
            self._check_order()
        elif not isinstance(self.table, CompositionTable):
            raise InputError(f"table must be a CompositionTable, not {self.table!r}")
        elif self.table.order != self.order:
            raise InputError(
                f"the table {self.table.name} is of order {self.table.order}, not "
                f"order={self.order!r}"
            )
        elif self.table.projected != (self.projection is not None):
            kind = "projected" if self.table.projected else "bare"
            raise InputError(
                f"the table {self.table.name} is for {kind} stages; it goes with "
                f"projection={'SymmetricProjection()' if self.table.projected else None}"
            )

    def _check_order(self) -> None:
        try:
            default_table(self.order, self.projection is not None)
        except InputError as error:
            raise InputError(f"GNI(order={self.order!r}) is not available: {error}") from error

    @property
    def fractions(self) -> tuple[float, ...]:
        """Sizes of the stages in units of the step."""
        table = self.table or default_table(self.order, self.projection is not None)
        return tuple(table.stages)

    def __str__(self) -> str:
        parts = [f"order={self.order}"]
        if self.flow != Variational():
            parts.append(f"flow={self.flow}")
        if self.projection is None:
            parts.append("projection=None")
        if self.table is not None:
            parts.append(f"table={self.table.name!r}")
        return f"GNI({', '.join(parts)})"


@dataclass(frozen=True)
class McLachlanPerlmutter:
    """The reversible method of McLachlan and Perlmutter (J. Nonlinear Sci. 16, 2006).

    Fly half the step, take the impulse of the constraint force, fly the other half; the impulse is
    such that the constraint holds at the end. Self-adjoint and exactly on the constraint, on every
    groupoid; on R^n their equation (4.18). For comparison: where the motion is not reversible its
    energy drifts more than that of ``GNI`` does (docs/how_to_choose.md).

    order : 2, 4, 6 or 8.  flow : as for ``GNI``.
    """

    order: int = 2
    flow: Flow = field(default_factory=Variational)

    def __post_init__(self) -> None:
        GNI(self.order, self.flow)

    @property
    def fractions(self) -> tuple[float, ...]:
        """Sizes of the stages in units of the step."""
        return GNI(self.order, self.flow).fractions

    def __str__(self) -> str:
        flow = "" if self.flow == Variational() else f", flow={self.flow}"
        return f"McLachlanPerlmutter(order={self.order}{flow})"


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
    """The equations of motion themselves, by DOP853 (order 8, adaptive) with dense output.

    Not structure-preserving: use it for short-time accuracy and as an oracle. Step sizes follow the
    tolerance, not ``step``, which only says where nodes are; between its own steps the method
    interpolates with order 7. Base points (and reconstructed arrows) are put back on their manifold
    after every step and at every node. ``run.error_estimate()`` tells how large the error is.
    Control inputs are constant over each ``step``; the method then begins anew at every node.

    rtol : relative tolerance per step.
    atol : absolute tolerance of base coordinates and velocities (of momenta, times the inertia at
        the start); rtol * 1e-2 when left out.

    Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, sections II.4-II.6, II.10.
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


SteppingMethod = DiscreteLagrangian | GNI | McLachlanPerlmutter | DiscreteLagrangeDAlembert
Method = SteppingMethod | ReferenceFlow
