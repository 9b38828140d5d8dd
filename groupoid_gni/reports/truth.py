"""The motion that errors are measured against, with an estimate of its own error."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.integrators import ReferenceFlow, integrate
from groupoid_gni.reports.state_parts import Quantity, StateParts, StateShape
from groupoid_gni.scenes import Scene
from groupoid_gni.trajectory import Trajectory

_CLOCK = 4.0 * 2.0**-52


@dataclass(frozen=True, eq=False)
class TrueNodes:
    """A motion at nodes, and what it may be off by.

    energy : (n,).  estimates : (n,) of every quantity, growing in time.
    """

    parts: StateParts
    energy: FloatArray
    estimates: dict[Quantity, FloatArray]


@dataclass(frozen=True, eq=False)
class Truth:
    """The exact motion of a scene, or the equations of motion by ``reference``.

    reference : the flow that the motion is computed with; a scene with an exact motion needs it
        for the attitude, and for what the energy does where it is not conserved.
    shape : what is a rotation.
    reconstruct : whether poses are accumulated, for scenes whose base does not turn.
    """

    scene: Scene
    t_end: float
    reference: ReferenceFlow
    use_exact: bool
    shape: StateShape
    reconstruct: bool
    _known: dict[int, TrueNodes] = field(default_factory=dict, init=False, repr=False)

    @property
    def source(self) -> str:
        """What the errors are measured against, in words."""
        return "the exact motion" if self.use_exact else str(self.reference)

    def at(self, count: int) -> TrueNodes:
        """The motion at ``k t_end / count``, k = 0 ... count."""
        if count not in self._known:
            self._known[count] = self._nodes(count)
        return self._known[count]

    def parts(
        self, base: FloatArray, velocities: FloatArray, poses: FloatArray | None = None
    ) -> StateParts:
        """Nodes of a motion of this scene in parts."""
        return StateParts.of(self.shape, base, velocities, poses)

    def _nodes(self, count: int) -> TrueNodes:
        run = self._flow(self.reference, count)
        poses = run.reconstruct() if self.reconstruct else None
        parts = self.parts(run.base, run.velocities, poses)
        estimate = run.error_estimate()
        estimates = dict.fromkeys(parts.quantities, estimate)
        if Quantity.ATTITUDE in estimates:
            estimates[Quantity.ATTITUDE] = self._attitude_estimate(parts, count)
        if self.use_exact:
            parts, from_formula = self._exact(count, parts)
            for quantity in parts.quantities:
                if quantity is not Quantity.ATTITUDE:
                    estimates[quantity] = from_formula
        return TrueNodes(parts, run.energy(), estimates)

    def _flow(self, method: ReferenceFlow, count: int) -> Trajectory:
        run = integrate(
            self.scene.system, self.scene.start, step=self.t_end / count, n_steps=count,
            method=method, reconstruct=self.reconstruct, on_failure="return",
        )
        if not run.success:
            raise InputError(
                f"the reference {method} did not reach t_end = {self.t_end:g}, so there is "
                f"nothing to compare with: {run.message} Choose a smaller t_end"
            )
        return run

    def _attitude_estimate(self, parts: StateParts, count: int) -> FloatArray:
        """Difference from a run at ten times the tolerance, whose error is the larger one."""
        run = self._flow(ReferenceFlow(rtol=10.0 * self.reference.rtol), count)
        poses = run.reconstruct() if self.reconstruct else None
        other = self.parts(run.base, run.velocities, poses)
        gap = parts.gaps(other)[Quantity.ATTITUDE]
        return np.maximum.accumulate(gap) + 2.0**-50

    def _exact(self, count: int, flow: StateParts) -> tuple[StateParts, FloatArray]:
        """The formula at the nodes, and what the round-off of times and start does to it."""
        exact: Any = self.scene.exact
        times = np.arange(count + 1) * (self.t_end / count)
        base, velocities = exact(times)
        parts = self.parts(base, velocities)
        rotations = parts.rotations or flow.rotations
        parts = StateParts(base, velocities, parts.position, rotations)
        shifted = self.parts(*exact(times * (1.0 + _CLOCK)))
        start = self.scene.start
        at_start = max(
            float(np.max(np.abs(base[0] - start.base), initial=0.0)),
            float(np.max(np.abs(velocities[0] - start.velocity), initial=0.0)),
        )
        by_clock = np.maximum.accumulate(parts.gaps(shifted)[Quantity.STATE])
        return parts, by_clock + at_start + _CLOCK * parts.size()
