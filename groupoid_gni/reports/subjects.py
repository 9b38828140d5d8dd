"""A method of the library with one setting on one scene: run it for its errors, run it for time."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.diagnostics import LinearSection, find_moving_energy, moving_energy
from groupoid_gni.errors import GNIError, GNIWarning, ParasiticModeWarning
from groupoid_gni.integrators import Method, ReferenceFlow, integrate
from groupoid_gni.reports.cost_model import built, flow_build_times
from groupoid_gni.reports.measurements import Accuracy, MeasuredError, Measurement
from groupoid_gni.reports.peers import Peer, PeerRun
from groupoid_gni.reports.state_parts import Quantity, StateParts, StateShape
from groupoid_gni.reports.timing import RunTimes
from groupoid_gni.reports.truth import TrueNodes, Truth
from groupoid_gni.scenes import Scene
from groupoid_gni.trajectory import Trajectory

_MOST_NODES = 200
DOP853_STAGES = 12


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene up to a time, the truth about it, and the moving energy it keeps, if any."""

    scene: Scene
    t_end: float
    truth: Truth
    section: LinearSection | None
    _built: dict[Method, tuple[int, float]] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(
        cls, scene: Scene, t_end: float, reference: ReferenceFlow | None, attitude: bool
    ) -> Problem:
        """Choose the truth: the exact motion where there is one and no reference is given."""
        flow = ReferenceFlow(rtol=1e-13) if reference is None else reference
        exact = reference is None and scene.exact is not None
        shape = StateShape.of(scene.system.space, scene.start.base)
        poses = attitude and shape.turns_only_when_reconstructed
        truth = Truth(scene, t_end, flow, exact, shape, poses)
        return cls(scene, t_end, truth, _moving_section(scene))

    def stages_and_compile_seconds(self, method: Method) -> tuple[int, float]:
        """Stages of a step of a method, and what it takes to compile; measured once."""
        if method not in self._built:
            system, rows = self.scene.system, self.scene.start.active_rows
            if isinstance(method, ReferenceFlow):
                self._built[method] = DOP853_STAGES, flow_build_times(system, rows).total
            else:
                program, times, _ = built(system, method, rows)
                self._built[method] = program.stages, times.total
        return self._built[method]

    def energy_error(self, run: Trajectory, truth: TrueNodes) -> float:
        """Largest relative error at the nodes."""
        system, energy = self.scene.system, run.energy()
        conserved = not (system.has("drift") or system.has("force"))
        wanted = energy[:1] if conserved else truth.energy
        return _largest(energy - wanted) / (_largest(truth.energy) or 1.0)

    def moving_energy_change(self, run: Trajectory) -> float | None:
        """Largest relative change; None where none is known."""
        if self.section is None:
            return None
        values = moving_energy(run, self.section, require_symmetry=False).values
        return _largest(values - values[0]) / (_largest(values) or 1.0)


def _moving_section(scene: Scene) -> LinearSection | None:
    if not scene.system.has("drift"):
        return None
    points = scene.start.base[None] if len(scene.start.base) else None
    try:
        return find_moving_energy(scene.system, points).moving
    except GNIError:
        return None


def _largest(values: FloatArray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


@dataclass(eq=False)
class Subject:
    """Something to measure; ``measured`` is made once its errors are known.

    line, setting : see Measurement.
    """

    problem: Problem
    line: str
    measured: Measurement = field(init=False)

    def seconds(self) -> float:
        """Run once and give the seconds of the loop."""
        raise NotImplementedError

    def look(self) -> Measurement:
        """Run once and measure everything but the times."""
        raise NotImplementedError


@dataclass(eq=False)
class SteppingSubject(Subject):
    """A method of the library: ``count`` steps, or a ReferenceFlow (count 1, nodes in between)."""

    method: Method
    count: int

    @property
    def _is_flow(self) -> bool:
        return isinstance(self.method, ReferenceFlow)

    def _run(self, nodes: int, reconstruct: bool) -> tuple[Trajectory, str]:
        """A run with that many nodes after the start, and what it warned of."""
        scene = self.problem.scene
        count = nodes if self._is_flow else self.count
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", GNIWarning)
            run = integrate(
                scene.system, scene.start, step=self.problem.t_end / count, n_steps=count,
                method=self.method, save_every=count // nodes, reconstruct=reconstruct,
                on_failure="return",
            )  # fmt: skip
        kinds = dict.fromkeys(warning.category for warning in caught)
        said = ["parasitic mode" if kind is ParasiticModeWarning else kind.__name__
                for kind in kinds if issubclass(kind, GNIWarning)]  # fmt: skip
        return run, ", ".join(said)

    def seconds(self) -> float:
        """Only the last node is saved, nothing is reconstructed."""
        return self._run(1, False)[0].seconds

    def look(self) -> Measurement:
        """Errors at up to 200 nodes, a divisor of the number of steps."""
        known: dict[str, Any] = {
            "line": self.line,
            "step": None if self._is_flow else self.problem.t_end / self.count,
            "tolerance": self.method.rtol if isinstance(self.method, ReferenceFlow) else None,
        }
        stages, known["compile_seconds"] = self.problem.stages_and_compile_seconds(self.method)
        nodes = _MOST_NODES if self._is_flow else _largest_divisor(self.count)
        truth = self.problem.truth
        run, note = self._run(nodes, truth.reconstruct)
        if not run.success:
            return Measurement(**known, accuracy={}, note=run.outcome.name.lower())
        true = truth.at(nodes)
        poses = run.reconstruct() if truth.reconstruct else None
        parts = truth.parts(run.base, run.velocities, poses)
        residual = None
        if run.system.constraint_count:
            residual = _largest(run.constraint_residuals(relative=True))
        newton = int(run.rows[-1, -1])
        return Measurement(
            **known,
            accuracy=_accuracies(parts.gaps(true.parts), true),
            energy=self.problem.energy_error(run, true),
            moving_energy=self.problem.moving_energy_change(run),
            constraint=residual,
            steps=run.own_steps if self._is_flow else self.count,
            stages=stages,
            newton=None if self._is_flow else newton,
            evaluations=run.evaluations if self._is_flow else None,
            note=note,
        )


def _largest_divisor(count: int) -> int:
    return next(n for n in range(min(count, _MOST_NODES), 0, -1) if count % n == 0)


def _accuracies(
    gaps: dict[Quantity, FloatArray], true: TrueNodes
) -> dict[Quantity, Accuracy]:
    found = {}
    for quantity, gap in gaps.items():
        estimate = true.estimates[quantity]
        worst = int(np.argmax(gap))
        found[quantity] = Accuracy(
            MeasuredError(float(gap[-1]), float(estimate[-1])),
            MeasuredError(float(gap[worst]), float(estimate[worst])),
        )
    return found


@dataclass(eq=False)
class PeerSubject(Subject):
    """A peer at one tolerance."""

    peer: Peer
    tolerance: float
    _first_wall: float = field(default=0.0, init=False)

    def seconds(self) -> float:
        """As the peer measures it."""
        return self.peer.run(self.tolerance).seconds

    def look(self) -> Measurement:
        """Errors at the end."""
        known: dict[str, Any] = {
            "line": self.line, "step": None, "tolerance": self.tolerance, "is_peer": True,
        }
        began = time.perf_counter()
        try:
            run = self.peer.run(self.tolerance)
        except RuntimeError as error:
            return Measurement(**known, accuracy={}, note=str(error).splitlines()[0][:80])
        self._first_wall = time.perf_counter() - began
        true = self.problem.truth.at(1)
        return Measurement(
            **known, accuracy=self._accuracies(run, true), steps=run.steps,
            evaluations=run.evaluations,
        )

    def _accuracies(self, run: PeerRun, true: TrueNodes) -> dict[Quantity, Accuracy]:
        parts = self.problem.truth.parts(run.base[None], run.velocity[None])
        last = StateParts(
            true.parts.base[-1:], true.parts.velocities[-1:], true.parts.position[-1:],
            tuple(rotation[-1:] for rotation in true.parts.rotations),
        )
        return {
            quantity: Accuracy(
                MeasuredError(float(gap[0]), float(true.estimates[quantity][-1])), None
            )
            for quantity, gap in parts.gaps(last).items()
        }

    def compile_seconds(self, times: RunTimes) -> float:
        """How much longer the first run took."""
        return max(0.0, self._first_wall - times.median)
