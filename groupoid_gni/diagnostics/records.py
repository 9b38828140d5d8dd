"""Everything worth knowing about a run, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from groupoid_gni.diagnostics.energy_drift import DriftReport, energy_drift
from groupoid_gni.diagnostics.modified_energy import ModifiedEnergy, modified_energy
from groupoid_gni.diagnostics.moving_energy import MovingEnergy, moving_energy
from groupoid_gni.diagnostics.nonholonomic_momentum import (
    NonholonomicMomentum,
    nonholonomic_momentum,
)
from groupoid_gni.diagnostics.sections import Section
from groupoid_gni.errors import InputError
from groupoid_gni.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class RunRecords:
    """What applies to a run; ``str`` gives a table.

    title : method, step and nodes.
    energy : (at the start, at the end, largest change).  drift : what it does in the long run.
    moving, moving_drift : moving energy, if a section was given.
    modified : exact modified energy; None when there is none, ``modified_reason`` says why.
    momenta : nonholonomic momenta by the names they were asked for.
    constraint : largest relative residual at a node; None without constraints.
    parasitic : largest (-1)^k amplitude relative to |p|; None for methods without.
    """

    title: str
    energy: tuple[float, float, float]
    drift: DriftReport
    moving: MovingEnergy | None
    moving_drift: DriftReport | None
    modified: ModifiedEnergy | None
    modified_reason: str
    momenta: Mapping[str, NonholonomicMomentum]
    constraint: float | None
    parasitic: float | None

    def __str__(self) -> str:
        start, end, change = self.energy
        rows = [
            ("energy", f"{start:.10g} at the start, {end:.10g} at the end, change {change:.2e}"),
            ("", str(self.drift)),
        ]
        if self.moving is not None:
            values = self.moving.values
            change = float(np.max(np.abs(values - values[0])))
            rows += [
                ("moving energy", f"{values[0]:.10g} at the start, change {change:.2e}"),
                ("", str(self.moving_drift)),
            ]
        if self.modified is not None:
            change = float(np.max(np.abs(self.modified.values - self.modified.values[0])))
            rows.append(("modified energy", f"{self.modified.formula}, change {change:.2e}"))
        for name, momentum in self.momenta.items():
            change = float(np.max(np.abs(momentum.values - momentum.values[0])))
            balance = float(np.max(np.abs(momentum.balance)))
            text = f"{momentum.values[0]:.6g} at the start, change {change:.2e}, "
            rows.append((name, text + f"balance {balance:.1e}"))
        if self.constraint is not None:
            rows.append(("constraints", f"largest relative residual {self.constraint:.1e}"))
        if self.parasitic is not None:
            rows.append(("parasitic", f"largest amplitude {self.parasitic:.2e} of |p|"))
        width = max(len(name) for name, _ in rows)
        return "\n".join([self.title, *(f"  {name:<{width}}  {text}" for name, text in rows)])


def records(
    run: Trajectory,
    *,
    generator: Section | None = None,
    momenta: Mapping[str, Section] | None = None,
) -> RunRecords:
    """All records that apply to a run.

    generator : Y' of a moving energy, see ``moving_energy``.
    momenta : name -> section, see ``nonholonomic_momentum``.
    Raises InputError when the generator is no symmetry generator or a section has a wrong shape.
    """
    energy = run.energy()
    moving = None if generator is None else moving_energy(run, generator)
    modified, reason = None, ""
    try:
        modified = modified_energy(run)
    except InputError as error:
        reason = str(error)
    constraint, parasitic = None, None
    if run.system.constraint_count:
        constraint = float(np.max(np.abs(run.constraint_residuals(relative=True))))
    if "parasitic" in run.layout.slices:
        parasitic = float(run.parasitic_maximum[-1])
    change = float(np.max(np.abs(energy - energy[0])))
    return RunRecords(
        title=f"{run.method_name}, step {run.step_size:g}, {len(run)} nodes to {run.times[-1]:g}",
        energy=(float(energy[0]), float(energy[-1]), change),
        drift=energy_drift(run, energy),
        moving=moving,
        moving_drift=None if moving is None else energy_drift(run, moving.values),
        modified=modified,
        modified_reason=reason,
        momenta={
            name: nonholonomic_momentum(run, section)
            for name, section in (momenta or {}).items()
        },
        constraint=constraint,
        parasitic=parasitic,
    )
