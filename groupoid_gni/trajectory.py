"""What an integration returns: the saved nodes, and everything that can be computed from them."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.discretization import StateLayout, SystemExpressions
from groupoid_gni.errors import InputError, TrajectoryFileError
from groupoid_gni.expressions import record
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, real_array

_FORMAT = "groupoid_gni trajectory 1"
_ARROW_TOLERANCE = 1e-8
UNRESOLVED = 0.5
"""Relative change of the velocity in one step from which on it is spoken of."""
# CasADi evaluates a few thousand points at once faster than a million
_BLOCK = 4096


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The saved nodes of a run.

    Attributes
    ----------
    system, method_name, step_size : what was run.
    node_steps : (n,) int, step numbers of the saved nodes; ``times = node_steps * step_size``.
    rows : (n, row) raw rows: state, arrow velocities, Newton count (see ``layout``).
    layout : where the parts of the state lie in a row.
    active_rows : constraint rows that took part in the step.
    flights : equal arrows that make a step (0 where arrows are not stored).
    outcome, detail : how the run ended; ``success``, ``status``, ``message`` follow SciPy.
    seconds : wall time of the loop.  rescued_steps : stages that needed a second try.
    surprise : how far, relative to the velocity, a suspect step lay from what the steps before it
        led to expect; 0 where none is suspect.  surprising_step : its number, from 1.
    controls : (steps, inputs) control inputs, or None.
    evaluations, own_steps : of reference runs: calls of the equations of motion, accepted steps.
    again : the same motion more precisely and in how many steps; reference runs, not stored.

    Shapes below: n nodes, r = rank, m = number of constraint rows as given.
    """

    system: MechanicalSystem
    method_name: str
    step_size: float
    node_steps: np.ndarray
    rows: FloatArray
    layout: StateLayout
    active_rows: tuple[int, ...]
    flights: int
    outcome: Outcome = Outcome.SUCCESS
    detail: str = ""
    seconds: float = 0.0
    rescued_steps: int = 0
    surprise: float = 0.0
    surprising_step: int = 0
    controls: FloatArray | None = None
    evaluations: int = 0
    own_steps: int = 0
    again: Callable[[], tuple[Trajectory, int]] | None = field(default=None, repr=False)
    _expressions: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        for array in (self.node_steps, self.rows):
            array.setflags(write=False)

    @property
    def success(self) -> bool:
        """Whether the end of the interval was reached."""
        return self.outcome is Outcome.SUCCESS

    @property
    def status(self) -> int:
        """Outcome code (``groupoid_gni.Outcome``); 0 is success."""
        return int(self.outcome)

    @property
    def message(self) -> str:
        """How the run ended, in words."""
        return " ".join(part for part in (self.outcome.sentence, self.detail) if part)

    def __deepcopy__(self, memo: dict[int, Any]) -> Trajectory:
        return self

    def __len__(self) -> int:
        return len(self.node_steps)

    def __repr__(self) -> str:
        return f"<Trajectory of {len(self)} nodes, {self.method_name}: {self.outcome.name}>"

    @property
    def times(self) -> FloatArray:
        """(n,) times of the saved nodes."""
        return np.asarray(self.node_steps * self.step_size)

    def _part(self, name: str) -> FloatArray:
        if name not in self.layout.slices:
            raise InputError(f"this trajectory has no {name}: {self.method_name} does not store it")
        return self.rows[:, self.layout.slices[name]]

    @property
    def base(self) -> FloatArray:
        """(n, base_size) base points."""
        return self._part("base")

    @property
    def momenta_before(self) -> FloatArray:
        """(n, r) momenta p+ on arrival at the node, before the impact."""
        return self._part("before")

    @property
    def momenta_after(self) -> FloatArray:
        """(n, r) momenta p- on departure from the node, after the impact."""
        return self._part("after")

    @property
    def momenta(self) -> FloatArray:
        """(n, r) mean of the two; it satisfies the constraints (equation (9b), section 8).

        DiscreteLagrangeDAlembert: their common part on D, lifted to the constraint set.
        """
        return np.asarray(self.layout.node(self.rows)[1])

    @cached_property
    def velocities(self) -> FloatArray:
        """(n, r) velocity components of ``momenta`` in the frame of AG."""
        return self._evaluate("velocity", self.momenta)

    @cached_property
    def multipliers(self) -> FloatArray:
        """(n, m) constraint forces lambda with ``p' = ... + mu^T lambda`` (per unit time).

        Two-step and Lagrange-d'Alembert methods: the impulse of the node divided by the step.
        Projected and reference methods: the multiplier of the equations of motion at the node. Zero
        for rows left out.
        """
        if self.layout.slices["before"] != self.layout.slices["after"]:
            change = self.momenta_after - self.momenta_before
            values = self._evaluate("along_rows", change) / self.step_size
        else:
            values = self._evaluate("multipliers", self.momenta)
        full = np.zeros((len(self), self.system.constraint_count))
        full[:, list(self.active_rows)] = values
        return full

    def energy(self) -> FloatArray:
        """(n,) energy ``<p, xi> - L`` at ``momenta``."""
        return self._evaluate("energy", self.momenta)[:, 0]

    def work(self) -> FloatArray:
        """(n,) work of the external force since the start, as the method counts it.

        Sum of the discrete force times the velocity of the arrow it acts on. Zero without a force.
        """
        if not self.system.has("force"):
            return np.zeros(len(self))
        return np.asarray(self._part("work")[:, 0])

    def energy_balance(self) -> FloatArray:
        """(n,) change of the energy minus the work of the external force.

        Round-off for ``GNI(flow=EnergyPreserving())`` with linear constraints, of the order of the
        method otherwise. An affine constraint does work of its own, which is not subtracted.
        """
        energy = self.energy()
        return np.asarray(energy - energy[0] - self.work())

    def constraint_residuals(self, relative: bool = False) -> FloatArray:
        """(n, m) ``mu (xi - Y)`` of all rows as given, at ``velocities``.

        Round-off for every method that steps; what DiscreteLagrangeDAlembert itself imposes
        is ``arrow_residuals``.

        relative : divide by ``|mu^a| (|xi| + |Y|)`` in the norms of the metric, the largest value
            the row could take; independent of units and of the scale of the row. |xi| is the
            largest of the node's velocity and of those before and after the impact.
        """
        residuals = self.system.constraint_residuals(self.base, self.velocities)
        if not relative or not self.system.constraint_count:
            return residuals
        speeds = [
            self.system.speeds(self.base, self._evaluate("velocity", p))
            for p in (self.momenta, self.momenta_before, self.momenta_after)
        ]
        return residuals / self.system.constraint_scales(self.base, np.max(speeds, axis=0))

    def arrow_residuals(self, relative: bool = False) -> FloatArray:
        """(n, active rows) discrete constraint of the arrow that leaves each node (M_c of [28]).

        relative : divide by ``|mu^a| (|xi| + |Y|)`` at the node, xi the velocity of the arrow.
        Raises InputError when the method has no discrete constraint.
        """
        residuals = self._part("on_arrow")
        if not relative:
            return residuals
        speeds = self.system.speeds(self.base, self._part("leaving"))
        scales = self.system.constraint_scales(self.base, speeds)
        return np.asarray(residuals / scales[:, list(self.active_rows)])

    def velocity_changes(self) -> FloatArray:
        """(n - 1,) change of the velocity from node to node, relative to the larger of the two.

        In the norm of the metric. Near one or above, the motion is not resolved by the nodes; if
        every step was saved, not by the steps either, however well the energy is kept.
        """
        return self.system.velocity_changes(self.base, self.velocities)

    @property
    def newton_iterations(self) -> FloatArray:
        """(n - 1,) Newton iterations between consecutive saved nodes."""
        return np.diff(self.rows[:, -1])

    @property
    def parasitic_amplitude(self) -> FloatArray:
        """(n,) size of the (-1)^k part of a two-step run, relative to ``|p|`` in G^-1."""
        return np.sqrt(self._part("parasitic")[:, 0])

    @property
    def parasitic_maximum(self) -> FloatArray:
        """(n,) largest ``parasitic_amplitude`` up to each node, unsaved nodes included."""
        return np.sqrt(self._part("parasitic")[:, 1])

    @property
    def parasitic_bound(self) -> float:
        """Largest (relative impulse)^2, an O(h^2) quantity the amplitude is compared with."""
        return float(self._part("parasitic")[-1, 2])

    @property
    def parasitic_at_start(self) -> float:
        """Largest ``parasitic_amplitude`` of the first dozen nodes."""
        return float(np.sqrt(self._part("parasitic")[-1, 4]))

    def error_estimate(self) -> FloatArray:
        """(n,) estimate of the error of base points and velocities, reference runs only.

        The motion is integrated again at a hundredth of the tolerances (1e-14 at the least), when
        first asked. The estimate of a node is the largest difference of any base coordinate or
        velocity component up to there, plus the round-off of the steps, ``2^-50 sqrt(steps)`` of
        the largest entry. Infinite where the second run did not arrive. It sees what the method
        does, and round-off as far as the motion amplifies it; not errors of the equations.

        Raises InputError for other methods, and for runs read from a file.
        """
        if self.again is None:
            raise InputError(
                f"{self.method_name} has no error estimate here: only ReferenceFlow runs can be "
                "repeated at a tighter tolerance, and not after they were read from a file. "
                "Compare with a run of half the step, or with method=gni.ReferenceFlow()"
            )
        if "error" not in self._expressions:
            self._expressions["error"] = self._difference(*self.again())
        return np.array(self._expressions["error"])

    def _difference(self, other: Trajectory, steps: int) -> FloatArray:
        """Largest difference up to each node, with round-off; see ``error_estimate``."""
        n = min(len(self), len(other))
        mine, others = (
            np.hstack([run.base[:n], run.velocities[:n]]) for run in (self, other)
        )
        size = np.maximum.accumulate(np.max(np.abs(mine), axis=1))
        difference = np.maximum.accumulate(np.max(np.abs(mine - others), axis=1))
        round_off = 2.0**-50 * np.sqrt(max(steps, 1)) * size
        return np.append(difference + round_off, np.full(len(self) - n, np.inf))

    @property
    def final_state(self) -> tuple[FloatArray, FloatArray]:
        """(base, velocity) of the last node, ready for ``system.state(*...)``."""
        return self.base[-1].copy(), self.velocities[-1].copy()

    @cached_property
    def arrows(self) -> FloatArray:
        """(n - 1, arrow_size) arrows g_k from node k to node k + 1.

        Raises InputError when not every node was saved.
        """
        if self.flights == 0:
            raise InputError(
                f"{self.method_name} does not store the arrows of its steps. To accumulate them "
                "while running, use integrate(..., reconstruct=W0)"
            )
        velocities = self.rows[1:, self.layout.size : -1]
        if np.any(np.diff(self.node_steps) != 1) or np.any(np.isnan(velocities)):
            raise InputError(
                "the arrows between saved nodes were not stored (save_every > 1). To accumulate "
                "them while running, use integrate(..., reconstruct=W0)"
            )
        space, r = self.system.space, self.system.space.rank
        retract = self._space_function("retract")
        share = self.step_size / self.flights
        x = self.base[:-1]
        arrow = retract(x, share * velocities[:, :r])
        for begin in range(r, r * self.flights, r):
            middle = self._space_function("target")(arrow)
            then = retract(middle, share * velocities[:, begin : begin + r])
            arrow = self._space_function("multiply")(arrow, then)
        return np.asarray(arrow).reshape(len(self) - 1, space.arrow_size)

    def reconstruct(self, start: ArrayLike | None = None) -> FloatArray:
        """Poses ``W_{k+1} = W_k g_k`` (Remark 7.2), (n, *pose shape).

        start : pose W_0; the identity when left out. When the run itself was asked to reconstruct
            (``integrate(..., reconstruct=W0)``), those poses are returned and ``start`` must be
            left out.
        """
        space = self.system.space
        if "reconstructed" in self.layout.slices:
            if start is not None:
                raise InputError("the run was reconstructed already; call reconstruct() bare")
            return np.asarray(space.pose(self._part("reconstructed")))
        first = starting_arrow(space, self.base[0], start)
        return np.asarray(space.pose(self._accumulate(first, self.arrows)))

    def _accumulate(self, first: FloatArray, arrows: FloatArray) -> FloatArray:
        """All partial products, in blocks so that NumPy sees long batches."""
        multiply, restore = (self._space_function(n) for n in ("multiply", "restore_arrow"))
        n = len(arrows)
        length = max(1, int(np.sqrt(n)))
        partial = np.array(arrows)
        for i in range(1, length):
            block = arrows[i::length]
            partial[i::length] = multiply(partial[i - 1 :: length][: len(block)], block)
        result = np.empty((n + 1, arrows.shape[1]))
        result[0] = carry = first
        for begin in range(0, n, length):
            block = partial[begin : begin + length]
            product = restore(multiply(np.broadcast_to(carry, block.shape), block))
            result[begin + 1 : begin + 1 + len(block)] = product
            carry = product[-1]
        return result

    def _space_function(self, name: str) -> Any:
        """A groupoid function that takes batches, whoever wrote it."""
        if name not in self._expressions:
            space: LieGroupoid = self.system.space
            x, g = {"x": (space.base_size,)}, (space.arrow_size,)
            inputs, output = {
                "retract": ({**x, "xi": (space.rank,)}, g),
                "target": ({"g": g}, (space.base_size,)),
                "multiply": ({"first": g, "then": g}, g),
                "restore_arrow": ({"g": g}, g),
            }[name]
            self._expressions[name] = record(getattr(space, name), inputs, output, name=name)
        return self._expressions[name]

    def _evaluate(self, quantity: str, p: FloatArray) -> FloatArray:
        """A quantity of the system at every node, (n, size)."""
        if quantity not in self._expressions:
            self._expressions[quantity] = self._quantity(quantity)
        function, theta = self._expressions[quantity], self.system.parameter_vector
        columns = (self.base.T, p.T, self._controls_at_nodes().T)
        blocks = [
            np.array(function(*[c[:, i : i + _BLOCK] for c in columns], theta)).T
            for i in range(0, len(self), _BLOCK)
        ]
        return np.concatenate(blocks).reshape(len(self), -1)

    def _controls_at_nodes(self) -> FloatArray:
        """(n, inputs) of the step that leaves each node; of the last step at the end."""
        if self.controls is None or not len(self.controls):
            return np.zeros((len(self), self.system.control_size))
        return np.asarray(self.controls[np.minimum(self.node_steps, len(self.controls) - 1)])

    def _quantity(self, quantity: str) -> ca.Function:
        e = SystemExpressions(self.system, self.active_rows)
        x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
        theta = ca.SX.sym("theta", e.parameter_size)
        expression = {
            "velocity": lambda: e.velocity(x, p, theta),
            "energy": lambda: e.energy(x, p, theta),
            "along_rows": lambda: e.node(x, theta).along_rows(p),
            "multipliers": lambda: e.multipliers(x, p, theta),
        }[quantity]()
        inputs = [x, p, e.controls, theta]
        return ca.Function(quantity, inputs, [ca.cse(ca.densify(expression))])

    def summary(self) -> str:
        """Steps, outcome, energy and constraint records in a few lines."""
        steps = int(self.node_steps[-1])
        energy = self.energy()
        scale = float(np.max(np.abs(energy))) or 1.0
        lines = [
            f"{self.method_name} on {type(self.system.space).__name__}: {steps} steps of "
            f"{self.step_size:g}, t = {self.times[0]:g} ... {self.times[-1]:g}, "
            f"{len(self)} nodes saved",
            f"  outcome      {self.outcome.name.lower()}: {self.message}",
            f"  energy       {energy[0]:.12g} at the start, {energy[-1]:.12g} at the end, largest "
            f"relative change {np.max(np.abs(energy - energy[0])) / scale:.2e}",
        ]
        if self.system.has("drift"):
            lines.append(f"  moving       {self._moving_energy_in_words()}")
        if self.system.constraint_count:
            worst = float(np.max(np.abs(self.constraint_residuals(relative=True))))
            lines.append(f"  constraints  largest relative residual {worst:.2e}")
        if "on_arrow" in self.layout.slices:
            worst = float(np.max(np.abs(self.arrow_residuals(relative=True))))
            lines[-1] += f" at nodes, {worst:.2e} on arrows"
        if "parasitic" in self.layout.slices:
            largest = self.parasitic_maximum[-1]
            lines.append(f"  parasitic    largest amplitude {largest:.2e} of |p|")
        if "work" in self.layout.slices:
            lines.append(
                f"  force        work {self.work()[-1]:.12g}, largest defect of the energy balance "
                f"{np.max(np.abs(self.energy_balance())):.2e}"
            )
        if steps and self.rows[-1, -1] > 0:
            lines.append(f"  Newton       {self.rows[-1, -1] / steps:.2f} iterations per step")
        if self.rescued_steps:
            lines.append(f"  second tries {self.rescued_steps} stages needed one")
        if self.surprise:
            begins = (self.surprising_step - 1) * self.step_size
            lines.append(
                f"  surprise     the step from t = {begins:g} is off its extrapolation by "
                f"{self.surprise:.0%}: compare with half the step"
            )
        if steps and steps == len(self) - 1 and not self.own_steps:
            changes = self.velocity_changes()
            worst = int(np.argmax(changes))
            if changes[worst] > UNRESOLVED:
                lines.append(
                    f"  resolution   the velocity changes by {changes[worst]:.0%} in the step from "
                    f"t = {self.times[worst]:g}: compare with half the step"
                )
        if self.seconds > 0.0 and steps:
            lines.append(
                f"  time         {self.seconds:.3g} s, {self.seconds / steps * 1e9:.0f} ns per step"
            )
        return "\n".join(lines)

    def _moving_energy_in_words(self) -> str:
        """The moving energy, where a linear symmetry generator gives one; a drift does work."""
        from groupoid_gni.diagnostics import find_moving_energy, moving_energy

        try:
            search = find_moving_energy(self.system, self.base[:: max(1, len(self) // 16)])
            if search.moving is None:
                return "no moving energy found with linear sections; the drift does work"
            found = moving_energy(self, search.moving)
        except InputError as error:
            return f"no moving energy: {error}"
        change = float(np.max(np.abs(found.values - found.values[0])))
        return f"energy {found.values[0]:.12g} at the start, largest change {change:.2e}"

    def plot(self, axes: Any = None) -> Any:
        """Motion, velocities, energy change and constraint residual, as a matplotlib figure.

        axes : four axes objects in that order; a new figure is made when left out.
        """
        from groupoid_gni.plotting import plot_trajectory

        return plot_trajectory(self, axes=axes)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write an ``.npz`` file (no pickle), atomically; return its path."""
        target = Path(path)
        if target.suffix != ".npz":
            target = target.with_name(target.name + ".npz")
        header = {
            "format": _FORMAT,
            "space": type(self.system.space).__name__,
            "rank": self.system.space.rank,
            "base_size": self.system.space.base_size,
            "method": self.method_name,
            "step_size": self.step_size,
            "layout": {k: [s.start, s.stop] for k, s in self.layout.slices.items()},
            "layout_size": self.layout.size,
            "active_rows": list(self.active_rows),
            "flights": self.flights,
            "outcome": int(self.outcome),
            "detail": self.detail,
            "seconds": self.seconds,
            "rescued_steps": self.rescued_steps,
            "surprise": self.surprise,
            "surprising_step": self.surprising_step,
            "parameters": list(self.system.parameters),
        }
        arrays: dict[str, Any] = {f"parameter_{k}": v for k, v in self.system.parameters.items()}
        arrays["fingerprint"] = _fingerprint(self.system, self.base[0])
        if self.controls is not None:
            arrays["controls"] = self.controls
        handle, name = tempfile.mkstemp(dir=target.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(
                    file,
                    header=np.array(json.dumps(header)),
                    node_steps=self.node_steps,
                    rows=self.rows,
                    **arrays,
                )
            os.replace(name, target)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        return target

    @classmethod
    def load(cls, path: str | os.PathLike[str], system: MechanicalSystem) -> Trajectory:
        """Read a file written by ``save``; ``system`` is the system it was made with.

        The stored parameter values are put into the system. Raises TrajectoryFileError when the
        file is not a trajectory or does not belong to such a system, FileNotFoundError when there
        is no such file.
        """
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header.get("format") != _FORMAT:
                    raise TrajectoryFileError(
                        f"{path} has the unknown format {header.get('format')!r}"
                    )
                steps, rows = file["node_steps"], file["rows"]
                values = {k: file[f"parameter_{k}"] for k in header["parameters"]}
                fingerprint = file["fingerprint"]
                controls = file.get("controls")
        except (FileNotFoundError, TrajectoryFileError):
            raise
        except Exception as error:
            raise TrajectoryFileError(
                f"{path} is not a complete trajectory file of groupoid_gni "
                f"({type(error).__name__}: {error}); write it again with run.save(path)"
            ) from error
        _check_same_system(path, header, values, system)
        system = system.with_parameters(**values)
        found = _fingerprint(system, rows[0, slice(*header["layout"]["base"])])
        if not np.allclose(found, fingerprint, rtol=1e-9, atol=0.0, equal_nan=True):
            raise TrajectoryFileError(
                f"{path} belongs to another system: at the first node the metric, the constraints, "
                "the drift or the potential differ from those of the given one"
            )
        layout = StateLayout(
            {k: slice(*v) for k, v in header["layout"].items()}, header["layout_size"]
        )
        return cls(
            system=system,
            method_name=header["method"],
            step_size=header["step_size"],
            node_steps=steps,
            rows=rows,
            layout=layout,
            active_rows=tuple(header["active_rows"]),
            flights=header["flights"],
            outcome=Outcome(header["outcome"]),
            detail=header["detail"],
            seconds=header["seconds"],
            rescued_steps=header["rescued_steps"],
            # files of earlier versions have no such record
            surprise=header.get("surprise", 0.0),
            surprising_step=header.get("surprising_step", 0),
            controls=controls,
        )


def starting_arrow(
    space: LieGroupoid, base_point: FloatArray, pose: ArrayLike | None
) -> FloatArray:
    """The arrow W_0 ending at the base point with the given pose; the identity for None."""
    identity = np.asarray(space.identity(base_point), dtype=float)
    if pose is None:
        return identity
    given = real_array("the pose", pose)
    try:
        arrow = np.asarray(space.arrow_to(base_point, given), dtype=float)
    except (TypeError, ValueError) as error:
        name = type(space).__name__
        raise InputError(f"the pose {pose!r} does not fit {name}: {error}") from error
    if arrow.shape != (space.arrow_size,):
        raise InputError(
            f"the pose has shape {np.shape(pose)}; poses of {type(space).__name__} have shape "
            f"{np.shape(space.pose(identity))}"
        )
    return checked_arrow("the pose", space, arrow)


def checked_arrow(name: str, space: LieGroupoid, arrow: FloatArray) -> FloatArray:
    """Refuse an arrow that is not finite, off its group or of a determinant not positive."""
    if not np.all(np.isfinite(arrow)):
        raise InputError(f"{name} must be finite, got {arrow}")
    defect = float(np.max(np.abs(space.restore_arrow(arrow) - arrow), initial=0.0))
    matrix = np.asarray(space.pose(arrow))
    square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1]
    if defect > _ARROW_TOLERANCE or (square and np.linalg.det(matrix) <= 0.0):
        raise InputError(
            f"{name} is not on the group of {type(space).__name__}: it is off by {defect:.3g} "
            f"(allowed {_ARROW_TOLERANCE:.0e}), or its determinant is not positive"
        )
    return arrow


def _fingerprint(system: MechanicalSystem, base: FloatArray) -> FloatArray:
    """All terms of a system at one base point, one after the other."""
    names = ("metric", "constraints", "drift", "gyroscopic", "potential")
    return np.concatenate([np.ravel(system.evaluate(name, base)) for name in names])


def _check_same_system(
    path: Any, header: dict[str, Any], values: dict[str, FloatArray], system: MechanicalSystem
) -> None:
    space = system.space
    shapes = {name: value.shape for name, value in values.items()}
    found = (header["space"], header["rank"], header["base_size"], shapes)
    wanted = {name: value.shape for name, value in system.parameters.items()}
    given = (type(space).__name__, space.rank, space.base_size, wanted)
    if found != given:
        raise TrajectoryFileError(
            f"{path} belongs to another system: it has (space, rank, base size, parameters) "
            f"{found}, the given one {given}"
        )
