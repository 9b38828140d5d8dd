"""A method on a system, as the laws of discrete mechanics see it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from groupoid_gni.array_types import FloatArray
from groupoid_gni.discretization import (
    DiscreteLagrangian,
    EnergyPreserving,
    Flow,
    Splitting,
    Variational,
)
from groupoid_gni.errors import InputError, ParasiticModeWarning
from groupoid_gni.integrators import (
    GNI,
    DiscreteLagrangeDAlembert,
    McLachlanPerlmutter,
    Method,
    integrate,
)
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

Section = Callable[[FloatArray], Any]

ArrowMethod = DiscreteLagrangian | DiscreteLagrangeDAlembert
"""Methods that go from arrow to arrow; the others go from momentum to momentum, in stages."""


@dataclass(frozen=True, eq=False)
class MethodView:
    """What is checked by ``check_method``.

    step : the step size of the runs.
    symmetries : sections ``x -> (rank,)`` of AG under which L and the constraints are invariant
        and which take values in D.
    """

    method: Method
    system: MechanicalSystem
    step: float
    symmetries: tuple[Section, ...] = ()

    @property
    def two_step(self) -> bool:
        """Whether the method is a discrete Lagrangian of the paper's scheme (49)."""
        return isinstance(self.method, DiscreteLagrangian)

    @property
    def flow(self) -> Flow:
        """The free flight of the stages; that of the discrete Lagrangian for arrow methods."""
        if isinstance(self.method, (GNI, McLachlanPerlmutter)):
            return self.method.flow
        if isinstance(self.method, DiscreteLagrangeDAlembert):
            return Variational(self.method.discrete_lagrangian)
        if isinstance(self.method, DiscreteLagrangian):
            return Variational(self.method)
        raise InputError(f"{self.method} does not step, so it has no free flight")

    @property
    def variational(self) -> bool:
        """Whether the free flights are those of a discrete Lagrangian."""
        return isinstance(self.flow, Variational)

    @property
    def splitting(self) -> bool:
        """Whether the free flights are products of explicit flows."""
        return isinstance(self.flow, Splitting)

    @property
    def energy_preserving(self) -> bool:
        """Whether the free flights keep the energy."""
        return isinstance(self.flow, EnergyPreserving)

    @cached_property
    def rule(self) -> DiscreteLagrangian:
        """The discrete Lagrangian of the method, or of its first free flight; see ``variational``.

        Raises InputError where there is none.
        """
        flow = self.flow
        if isinstance(flow, Variational):
            return flow.discrete_lagrangian
        raise InputError(f"the flights of {self.method} are not those of a discrete Lagrangian")

    @property
    def bare(self) -> bool:
        """Whether the method is a GNI without projection, and there is something to project to."""
        constrained = self.system.constraint_count > 0
        return isinstance(self.method, GNI) and self.method.projection is None and constrained

    @property
    def projected(self) -> bool:
        """Whether the method is a GNI with projection, and there is something to project to."""
        constrained = self.system.constraint_count > 0
        return isinstance(self.method, GNI) and not self.bare and constrained

    @property
    def fractions(self) -> tuple[float, ...]:
        """Sizes of the stages in units of the step."""
        if isinstance(self.method, McLachlanPerlmutter):
            return self.method.fractions
        if not isinstance(self.method, GNI):
            return (1.0,)
        if self.system.constraint_count or self.method.projection is not None:
            return self.method.fractions
        return GNI(self.method.order).fractions

    @property
    def shows_arrows(self) -> bool:
        """Whether runs keep the arrows of their steps."""
        return len(self.fractions) == 1 and not self.splitting

    @property
    def self_adjoint(self) -> bool:
        """Whether a step back undoes a step: palindromes of stages always, a rule if it is its own
        adjoint, [28] if its rule and its constraint are.
        """
        if isinstance(self.method, DiscreteLagrangeDAlembert):
            return all(
                rule.adjoint() == rule for rule in (self.rule, self.method.constraint.rule)
            )
        if isinstance(self.method, DiscreteLagrangian):
            return self.rule.adjoint() == self.rule
        return self.fractions == self.fractions[::-1]

    @property
    def order(self) -> int:
        """The order the method claims."""
        if isinstance(self.method, (GNI, McLachlanPerlmutter)):
            return self.method.order
        return 2 if self.self_adjoint else 1

    def run(
        self,
        state: State,
        steps: int,
        *,
        system: MechanicalSystem | None = None,
        step: float | None = None,
        **options: Any,
    ) -> Trajectory:
        """A run of the method, interpreted and without the parasitic alarm.

        system, step : in place of the view's.  options : further ones of ``integrate``.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ParasiticModeWarning)
            return integrate(
                self.system if system is None else system, state,
                step=self.step if step is None else step, n_steps=steps, method=self.method,
                **{"compile": False, **options},
            )
