"""One row of a work-precision table: how wrong a run is, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from groupoid_gni.reports.state_parts import Quantity
from groupoid_gni.reports.timing import RunTimes

TRUSTED = 10.0
"""An error is a number when it is at least this many times the error of the reference."""


@dataclass(frozen=True)
class MeasuredError:
    """A difference from the reference, and what the reference may be off by."""

    value: float
    estimate: float

    @property
    def resolved(self) -> bool:
        """Whether the difference says more than "small"."""
        return self.value >= TRUSTED * self.estimate

    @property
    def bound(self) -> float:
        """What the true error cannot exceed: difference plus estimate."""
        return self.value + self.estimate

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return "-"
        return f"{self.value:.2e}" if self.resolved else f"< {_rounded_up(self.bound)}"

    def to_dict(self) -> dict[str, Any]:
        """The error as a number, or None and a bound."""
        known = self.resolved and math.isfinite(self.value)
        return {"error": self.value if known else None, "bound": _number(self.bound)}


def _rounded_up(value: float) -> str:
    """One digit, upwards."""
    if value <= 0.0:
        return "1e-300"
    power = math.floor(math.log10(value))
    digit = math.ceil(value / 10.0**power - 1e-9)
    return f"{float(f'{digit}e{power}'):.0e}"


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


@dataclass(frozen=True)
class Accuracy:
    """The error at the end, and the largest at any node compared (None: only the end is known)."""

    final: MeasuredError
    largest: MeasuredError | None


@dataclass(frozen=True)
class Measurement:
    """One method with one setting.

    line : name of the method; settings of one line are points of one curve.
    step, tolerance : the setting; one of them is None.
    accuracy : of every quantity there is; empty for a run that failed.
    energy : largest relative energy error (against the reference where energy is not conserved).
    moving_energy : largest relative change of the moving energy.  constraint : largest relative
    residual.  None where there is none, or where it was not recorded (peers).
    steps, stages : steps, and stages of one step.  newton, evaluations : iterations, calls of the
    right-hand side, of the whole run; None where there are none or nobody tells.
    times : warm seconds of the loop; None for a run that failed.
    compile_seconds : of the first call: deriving, emitting, compiling; for peers, how much longer
        the first run took than a warm one.
    note : how a run failed, or what it warned of.  is_peer : not of this library.
    """

    line: str
    step: float | None
    tolerance: float | None
    accuracy: Mapping[Quantity, Accuracy]
    energy: float | None = None
    moving_energy: float | None = None
    constraint: float | None = None
    steps: int | None = None
    stages: int | None = None
    newton: int | None = None
    evaluations: int | None = None
    times: RunTimes | None = None
    compile_seconds: float | None = None
    note: str = ""
    is_peer: bool = False

    @property
    def setting(self) -> str:
        """The step or the tolerance as text."""
        if self.step is not None:
            return f"h = {self.step:.4g}"
        return f"tol = {self.tolerance:.1g}"

    def bound(self, quantity: Quantity) -> float:
        """An upper bound of the final error; infinite where nothing is known."""
        found = self.accuracy.get(quantity)
        bound = math.inf if found is None else found.final.bound
        return bound if math.isfinite(bound) else math.inf

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings, ready for JSON."""
        errors = {
            quantity.value: {
                "final": found.final.to_dict(),
                "largest": None if found.largest is None else found.largest.to_dict(),
            }
            for quantity, found in self.accuracy.items()
        }
        times = None
        if self.times is not None:
            times = {
                "median": self.times.median, "smallest": self.times.smallest,
                "spread": self.times.spread, "all": list(self.times.seconds),
            }
        return {
            "method": self.line, "step": self.step, "tolerance": self.tolerance,
            "errors": errors, "energy": _number(self.energy),
            "moving_energy": _number(self.moving_energy),
            "constraint": _number(self.constraint), "steps": self.steps, "stages": self.stages,
            "newton_iterations": self.newton, "evaluations": self.evaluations,
            "seconds": times, "compile_seconds": self.compile_seconds, "note": self.note,
            "peer": self.is_peer,
        }
