"""What every free flight hands to the step it is part of.

A free flight goes from (x0, p0) over a time h without constraints. Steps know nothing else of it,
so any of them can be placed in any step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class Flight(ABC):
    """The expressions of one flight.

    unknowns : components that need a solver, as symbols; may be empty.  guess : their first values
        for a flight from (x, p).
    update : their Newton update (current minus better value).
    work : sum of |residual * update|, the squared error of the current values as an energy.
    energy : sum of |xi * dl/dxi|, the scale of ``work``.
    target, momentum : where the flight arrives, at the updated values.
    pieces : the arrows ``retract(x, eta)`` it flies along, as pairs (x, eta).
    extent : the pairs (x, eta) whose size must stay within the retraction's domain.
    velocities : the xi of its equal pieces, one after the other; empty where they are not equal.
    force_work : work of the external force along it.
    """

    unknowns: ca.SX
    guess: Callable[[ca.SX, ca.SX], ca.SX]
    update: ca.SX
    work: ca.SX
    energy: ca.SX
    target: ca.SX
    momentum: ca.SX
    pieces: tuple[tuple[ca.SX, ca.SX], ...]
    extent: tuple[tuple[ca.SX, ca.SX], ...]
    velocities: ca.SX
    force_work: ca.SX

    @abstractmethod
    def response(self, dp: ca.SX) -> ca.SX:
        """Change of the unknowns when p0 changes by the columns of dp, to first order."""


class FlightRule(ABC):
    """A recipe for flights, ready to be placed anywhere in a step."""

    @abstractmethod
    def from_momentum(self, x0: ca.SX, p0: ca.SX, h: ca.SX, theta: ca.SX, name: str) -> Flight:
        """The flight from (x0, p0), one Newton update included; unknowns are called ``name``."""
