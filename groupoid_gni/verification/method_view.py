"""A method on a system, as the laws of discrete mechanics see it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from groupoid_gni.array_types import FloatArray
from groupoid_gni.discretization import DiscreteLagrangian
from groupoid_gni.errors import InputError, ParasiticModeWarning
from groupoid_gni.integrators import GNI, Method, integrate
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

Section = Callable[[FloatArray], Any]


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

    @cached_property
    def rule(self) -> DiscreteLagrangian:
        """The discrete Lagrangian of the method, or of its first free flight."""
        if isinstance(self.method, DiscreteLagrangian):
            return self.method
        if isinstance(self.method, GNI):
            return self.method.flow.discrete_lagrangian
        raise InputError(f"{self.method} has no discrete Lagrangian")

    @property
    def self_adjoint(self) -> bool:
        """Whether a step back undoes a step: GNI always, a rule if it is its own adjoint."""
        return not self.two_step or self.rule.adjoint() == self.rule

    @property
    def order(self) -> int:
        """The order the method claims."""
        if isinstance(self.method, GNI):
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
