"""What one step computes, as expressions, before anybody decides how to run it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca


@dataclass(frozen=True)
class StateLayout:
    """Where the parts of the flat state vector lie.

    ``slices`` maps a part's name to its slice; ``size`` is the total length. The parts are
    ``base``, ``before`` and ``after`` (momenta at the node before and after the impact; one and the
    same slice for a projected step), and optionally ``normals`` and ``parasitic`` (monitor of the
    two-step methods) and ``reconstructed`` (the arrow accumulated in the loop).
    """

    slices: dict[str, slice]
    size: int

    @classmethod
    def of(cls, parts: dict[str, int], aliases: dict[str, str] | None = None) -> StateLayout:
        """Lay out parts of the given sizes one after the other."""
        slices, start = {}, 0
        for name, size in parts.items():
            slices[name] = slice(start, start + size)
            start += size
        for alias, name in (aliases or {}).items():
            slices[alias] = slices[name]
        return cls(slices, start)


@dataclass(frozen=True)
class Guard:
    """A quantity that must stay below one, and the outcome code to report when it does not."""

    value: Any
    code: int


@dataclass(frozen=True)
class StepProgram:
    """The expressions of one step.

    parameters : SX, physical parameters, then the step size, then the constraint scales.
    state : SX, see ``layout``.  unknowns : SX, solved for by Newton's method (may be empty).
    residual : SX, zero at the solution, in units conjugate to the unknowns (momentum against
        velocity), so that residual * update is an energy.
    update : SX, the Newton update ``jacobian^{-1} residual``, to be subtracted.
    scale : SX, energy against which residual * update is measured.
    first_guess : SX, unknowns for the first step, from parameters and state only.
    next_state : SX.  arrow_velocities : SX, the xi of every flight of the step, for the arrows.
    guards : checked after every step.
    """

    parameters: ca.SX
    state: ca.SX
    unknowns: ca.SX
    residual: ca.SX
    update: ca.SX
    scale: ca.SX
    first_guess: ca.SX
    next_state: ca.SX
    arrow_velocities: ca.SX
    layout: StateLayout
    guards: tuple[Guard, ...] = field(default=())

    @property
    def row_size(self) -> int:
        """Numbers stored per saved node: state, arrow velocities, Newton count."""
        return self.layout.size + self.arrow_velocities.numel() + 1
