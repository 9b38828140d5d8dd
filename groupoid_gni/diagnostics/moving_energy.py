"""The moving energy of a system with affine constraints, and the symmetry that gives one.

Along a motion ``dE/dt = lambda mu Y`` and ``d/dt <p, Y'> = Y'^c L + lambda mu Y'``, so

    d/dt (E - <p, Y'>) = lambda mu (Y - Y') - Y'^c L,

which vanishes when Y' - Y is a section of D and L is invariant under the complete lift of Y'
(Fasso and Sansonetto, arXiv 1503.06661).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.diagnostics.sections import (
    Section,
    SectionAlongMotion,
    checked_points,
    nodes_of,
    recorded_section,
    samples_around,
)
from groupoid_gni.errors import InputError
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.trajectory import Trajectory

_TOLERANCE = 1e-9
_SAMPLES = 96


@dataclass(frozen=True, eq=False)
class SymmetryReport:
    """Whether a section Y' gives a moving energy, in numbers.

    outside : largest ``|mu^a (Y' - Y)| / (|mu^a| (|Y'| + |Y|))``; zero when Y' - Y is in D.
    variance : largest ``|Y'^c L|`` over the sum of the sizes of its terms; zero when L is
        invariant under Y'.
    worst_outside, worst_variance : base points where these were found.
    samples : how many base points were tried, each with a random velocity.
    """

    outside: float
    variance: float
    worst_outside: FloatArray
    worst_variance: FloatArray
    samples: int

    @property
    def holds(self) -> bool:
        """Whether both conditions hold to 1e-9."""
        return self.outside <= _TOLERANCE and self.variance <= _TOLERANCE

    def __str__(self) -> str:
        if self.holds:
            return (
                f"a symmetry generator: Y' - Y in D to {self.outside:.1e}, L invariant to "
                f"{self.variance:.1e} at {self.samples} points"
            )
        parts = []
        if not self.outside <= _TOLERANCE:
            parts.append(
                f"mu (Y' - Y) is not zero: {self.outside:.2g} of its largest possible size at "
                f"x = {self.worst_outside}"
            )
        if not self.variance <= _TOLERANCE:
            parts.append(
                f"L is not invariant under Y': its derivative is {self.variance:.2g} of the sum "
                f"of its terms at x = {self.worst_variance}"
            )
        return "not a symmetry generator: " + "; ".join(parts)


@dataclass(frozen=True, eq=False)
class MovingEnergy:
    """``E - <p, Y'>`` at the nodes of a run.

    values : (n,).
    rate : (n,) its exact rate ``lambda mu (Y - Y') - Y'^c L`` along the motion through each node;
        round-off when ``symmetry.holds``.
    symmetry : whether Y' satisfies the conditions.
    """

    values: FloatArray
    rate: FloatArray
    symmetry: SymmetryReport

    def __str__(self) -> str:
        change = float(np.max(np.abs(self.values - self.values[0])))
        return (
            f"moving energy {self.values[0]:.10g} at the start, largest change {change:.2e} "
            f"({self.symmetry})"
        )


def symmetry_report(
    system: MechanicalSystem, section: Section, points: ArrayLike | None = None
) -> SymmetryReport:
    """Try the two conditions of a moving energy: Y' - Y in D, and L invariant under Y'.

    section : Y', a function (x, p) -> (rank,) or a constant array.
    points : base points (k, base_size) around which to sample; the space's example when left out.

    Without drift a section of D that passes gives a conserved momentum ``<p, Y'>`` (Noether).
    Raises InputError for a section of a wrong shape or points outside the domain.
    """
    centres = checked_points(system, points)
    samples = samples_around(system, centres, _SAMPLES)
    rows = tuple(range(system.constraint_count))
    generator = SectionAlongMotion(system, rows, recorded_section(system, section, centres))
    values = generator.values(samples.base)
    outside = np.zeros(len(values))
    if rows:
        relative = system.constraint_residuals(samples.base, values, relative=True)
        outside = np.max(np.abs(relative), axis=1)
    lie = np.abs(generator.lie_derivative(samples.base, samples.velocities))
    scale = generator.lie_scale(samples.base, samples.velocities)
    variance = lie / np.where(scale > 0.0, scale, 1.0)
    k, j = int(np.argmax(outside)), int(np.argmax(variance))
    return SymmetryReport(
        outside=float(outside[k]),
        variance=float(variance[j]),
        worst_outside=samples.base[k],
        worst_variance=samples.base[j],
        samples=len(values),
    )


def moving_energy(
    run: Trajectory, section: Section, *, require_symmetry: bool = True
) -> MovingEnergy:
    """``E - <p, Y'>`` at ``run.momenta``, Y' a symmetry generator with Y' - Y in D.

    section : Y', a function (x, p) -> (rank,) or a constant array.
    require_symmetry : refuse a section that does not satisfy the conditions; with False the
        result tells the rate at which the quantity then changes.
    Raises InputError saying which condition fails, where, and by how much.
    """
    system = run.system
    nodes = nodes_of(run)
    report = symmetry_report(system, section, nodes)
    if require_symmetry and not report.holds:
        raise InputError(
            f"the section gives no moving energy: {report}. Find one with "
            "gni.diagnostics.find_moving_energy(system), or pass require_symmetry=False"
        )
    generator = SectionAlongMotion(
        system, run.active_rows, recorded_section(system, section, nodes)
    )
    values = run.energy() - np.sum(run.momenta * generator.values(run.base), axis=1)
    drift = recorded_section(
        system, system.plain["drift"] if system.has("drift") else np.zeros(system.space.rank), nodes
    )
    carried = SectionAlongMotion(system, run.active_rows, drift)
    rate = (
        carried.force_part(run.base, run.velocities)
        - generator.force_part(run.base, run.velocities)
        - generator.lie_derivative(run.base, run.velocities)
    )
    return MovingEnergy(values, rate, report)
