"""The nonholonomic momentum of a section, and the equation it obeys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.diagnostics.quadrature import cumulative_integral
from groupoid_gni.diagnostics.sections import (
    Section,
    SectionAlongMotion,
    nodes_of,
    recorded_section,
)
from groupoid_gni.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class NonholonomicMomentum:
    """``J = <p, X>`` along a run of n nodes, and its balance.

    values : (n,) J.
    rate : (n,) dJ/dt from the momentum equation ``X^c L + lambda mu X``, at the nodes.
    force_part : (n,) the part ``lambda mu X``; zero when X lies in D.
    balance : (n,) ``J(t) - J(0)`` minus the integral of ``rate``; the error of the run in J.
    quadrature_error : how far the integrals through 6 and through 4 nodes differ; ``balance``
        says nothing below it.
    outside : largest ``|mu^a X| / (|mu^a| |X|)`` at a node, 0 when X is a section of D.
    """

    values: FloatArray
    rate: FloatArray
    force_part: FloatArray
    balance: FloatArray
    quadrature_error: float
    outside: float

    def __str__(self) -> str:
        change = np.max(np.abs(self.values - self.values[0]))
        worst = np.max(np.abs(self.balance))
        where = (
            "in D" if self.outside < 1e-10
            else f"out of D by {self.outside:.2g}, constraint force included"
        )
        return (
            f"momentum     {self.values[0]:.6g} at the start, largest change {change:.2e}, "
            f"balance {worst:.1e} (section {where})"
        )


def nonholonomic_momentum(run: Trajectory, section: Section) -> NonholonomicMomentum:
    """``J = <p, X>`` of a section X at ``run.momenta``, with the equation for its rate.

    section : function (x, p) -> (rank,) of base point and parameters, or a constant array. For the
        nonholonomic momentum map X is a section of D, ``mu X = 0``; otherwise the constraint force
        does its part, which is reported.

    The rate is exact for the motion through each node: no differences in time are taken.
    Raises InputError when the section has a wrong shape, RecordingError when it cannot be recorded.
    """
    system, base = run.system, run.base
    nodes = nodes_of(run)
    X = SectionAlongMotion(system, run.active_rows, recorded_section(system, section, nodes))
    sections = X.values(base)
    values = np.sum(run.momenta * sections, axis=1)
    force = X.force_part(base, run.velocities)
    rate = X.lie_derivative(base, run.velocities) + force
    integral = cumulative_integral(run.times, rate)
    coarser = cumulative_integral(run.times, rate, points=4)
    return NonholonomicMomentum(
        values=values,
        rate=rate,
        force_part=force,
        balance=values - values[0] - integral,
        quadrature_error=float(np.max(np.abs(integral - coarser))),
        outside=_outside(run, sections),
    )


def _outside(run: Trajectory, sections: FloatArray) -> float:
    system = run.system
    if not system.constraint_count:
        return 0.0
    along = np.einsum("nar,nr->na", system.evaluate("constraints", run.base), sections)
    # the scales are |mu^a| (speed + |Y|), and |Y| has no part here
    one, two = (system.constraint_scales(run.base, np.full(len(run), s)) for s in (1.0, 2.0))
    size = (two - one) * system.speeds(run.base, sections)[:, None]
    return float(np.max(np.abs(along) / np.where(size > 0.0, size, 1.0)))
