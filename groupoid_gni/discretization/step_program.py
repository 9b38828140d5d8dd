"""What one step computes, as expressions, before anybody decides how to run it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

HISTORY = 5
"""Steps whose unknowns are remembered for the warm start of a step of one stage."""

STAGE_HISTORY = 12
"""Stages whose unknowns are remembered for the warm start of a composition."""

RECORD = 5
"""Numbers kept of how well the warm start has foretold the stages (``codegen.surprise``)."""


@dataclass(frozen=True)
class StateLayout:
    """Where the parts of the flat state vector lie.

    ``slices`` maps a part's name to its slice; ``size`` is the total length. The parts are
    ``base``, ``before`` and ``after`` (momenta at the node before and after the impact; one and the
    same slice for a projected step), and optionally ``impulses`` and ``parasitic`` (monitor of the
    methods without projection), ``momentum`` (of the node), ``leaving`` and ``on_arrow`` (velocity
    and discrete constraint of the arrow that leaves; the Lagrange-d'Alembert method), ``work`` (of
    the external force) and ``reconstructed`` (the arrow accumulated in the loop).
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

    def node(self, states: Any) -> tuple[Any, Any]:
        """Base points and momenta of states (..., size): the mean where no other is laid out."""
        if "momentum" in self.slices:
            return states[..., self.slices["base"]], states[..., self.slices["momentum"]]
        before, after = states[..., self.slices["before"]], states[..., self.slices["after"]]
        return states[..., self.slices["base"]], 0.5 * (before + after)

    def positions(self, *names: str) -> list[int]:
        """Indices in the state of the named parts, those that are there."""
        present = [self.slices[name] for name in names if name in self.slices]
        return [i for part in present for i in range(part.start, part.stop)]


@dataclass(frozen=True)
class Guard:
    """A quantity that must stay below one, and the outcome code to report when it does not.

    decisive : a value of one or more explains a failed Newton iteration and is reported in its
        place.
    """

    value: Any
    code: int
    decisive: bool = False


@dataclass(frozen=True)
class StepProgram:
    """The expressions of one stage, as a fixed-point iteration and what follows from it.

    All are functions of (parameters, state and given, unknowns, carried, later). A step is one
    stage, or a composition: the same stage once for every entry of ``fractions``.

    parameters : physical parameters, then the step size, then the constraint scales.
    state : see ``layout``.
    unknowns : iterated within a step; their first values are extrapolated from earlier steps.
    carried : iterated too, but continued from the last step as they are.
    later : scalar symbol, 0 in the first iteration of a step and 1 in the others.
    update : to be subtracted from the unknowns.  next_carried : new carried values.
    work, energy : ``work / energy`` is the squared relative error of the current unknowns.
    quadratic : whether the iteration converges quadratically, or only superlinearly.
    next_state : state after the step, from the updated unknowns.
    arrow_velocities : the xi of every flight of the step.
    guards : checked after every step.  finite : must be finite too, besides the next state.
    first_guess, first_carried : for the first step, from parameters and state only.
    start : a program of the same layout whose one step completes a start of which only base,
        momenta and pose are known; None where nothing is missing.
    fractions : sizes of the stages in units of the step.
    given : what a stage is told besides its state: its fraction, in a composition; then the control
        inputs of the step, ``control_size`` of them.
    finish : the state a composed step ends with, from parameters and the state after its last
        stage; None where nothing is left to do.
    left : ``left / energy`` is the squared relative error that the current unknowns leave in the
        next state; zero where the next state is an expression of the updated unknowns only.
    """

    parameters: ca.SX
    state: ca.SX
    unknowns: ca.SX
    carried: ca.SX
    later: ca.SX
    update: ca.SX
    next_carried: ca.SX
    work: ca.SX
    energy: ca.SX
    quadratic: bool
    next_state: ca.SX
    arrow_velocities: ca.SX
    first_guess: ca.SX
    first_carried: ca.SX
    layout: StateLayout
    guards: tuple[Guard, ...] = field(default=())
    finite: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    start: StepProgram | None = None
    fractions: tuple[float, ...] = (1.0,)
    given: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    control_size: int = 0
    left: ca.SX = field(default_factory=lambda: ca.SX(0))
    finish: ca.SX | None = None

    @property
    def stages(self) -> int:
        """Stages of a step."""
        return len(self.fractions)

    @property
    def history(self) -> int:
        """Stages whose unknowns are remembered."""
        return HISTORY if self.stages == 1 else STAGE_HISTORY

    @property
    def record_size(self) -> int:
        """Numbers kept of how well the warm start has foretold the stages; none without one."""
        return RECORD if self.unknowns.numel() else 0

    @property
    def memory_size(self) -> int:
        """Unknowns of the last stages, carried values, record of the warm start, Newton count."""
        kept = self.history * self.unknowns.numel() + self.carried.numel()
        return kept + self.record_size + 1

    @property
    def row_size(self) -> int:
        """Numbers stored per saved node: state, arrow velocities, Newton count."""
        return self.layout.size + self.arrow_velocities.numel() + 1
