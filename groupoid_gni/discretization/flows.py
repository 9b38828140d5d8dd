"""Free flights as values: what flies between two impacts.

Each gives the two flight rules of a bare step, outward and homeward, the second the adjoint of the
first.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from groupoid_gni.discretization.discrete_lagrangians import DiscreteLagrangian, EulerB
from groupoid_gni.discretization.energy_preserving_flight import EnergyPreservingStep
from groupoid_gni.discretization.flight import FlightRule
from groupoid_gni.discretization.free_flight import FreeFlight
from groupoid_gni.discretization.splitting_flight import SplittingStep
from groupoid_gni.discretization.system_expressions import SystemExpressions
from groupoid_gni.errors import InputError


class Flow(ABC):
    """A kind of free flight; one of those below."""

    @abstractmethod
    def flights(self, expressions: SystemExpressions) -> tuple[FlightRule, FlightRule]:
        """The outward and the homeward flight; raises InputError where the system does not fit."""


@dataclass(frozen=True)
class Variational(Flow):
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

    def flights(self, expressions: SystemExpressions) -> tuple[FlightRule, FlightRule]:
        """The flight of the discrete Lagrangian and that of its adjoint."""
        first = self.discrete_lagrangian
        return FreeFlight(expressions, first), FreeFlight(expressions, first.adjoint())

    def __str__(self) -> str:
        return f"Variational({self.discrete_lagrangian})"


@dataclass(frozen=True)
class Splitting(Flow):
    """Explicit flights for constant metrics: one-parameter subgroups, then a kick.

    Poisson (Casimirs are kept), reversible, no equation to solve. The metric must not depend on the
    base point, there must be no gyroscopic term, and forces must not depend on the velocity. Every
    retraction will do on SO(3) and in the plane; on SE(3) with a full inertia matrix it must be
    ``Exponential()``.
    """

    def flights(self, expressions: SystemExpressions) -> tuple[FlightRule, FlightRule]:
        """Kinetic terms and then the kick; the kick and then the kinetic terms backwards."""
        outward = SplittingStep(expressions)
        return outward, outward.homeward()

    def __str__(self) -> str:
        return "Splitting()"


@dataclass(frozen=True)
class EnergyPreserving(Flow):
    """Flights that keep the energy to round-off, on any groupoid, with any metric and potential.

    With linear constraints so does every ``GNI(order, flow=EnergyPreserving())`` with projection;
    with affine ones the moving energy is kept where the free flight keeps <p, Y'>. On a Lie group
    Casimirs are kept too. Implicit.
    """

    def flights(self, expressions: SystemExpressions) -> tuple[FlightRule, FlightRule]:
        """One self-adjoint rule, twice."""
        rule = EnergyPreservingStep(expressions)
        return rule, rule

    def __str__(self) -> str:
        return "EnergyPreserving()"
