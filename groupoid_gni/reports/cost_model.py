"""What a method costs on a system: operations counted in the emitted code, and times measured."""

from __future__ import annotations

import time
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from groupoid_gni.codegen import (
    MachineCode,
    machine_has_fused_products,
    operations_by_place,
    step_kernel_ir,
)
from groupoid_gni.codegen.adaptive_kernel import FlowLayout, adaptive_kernel_ir
from groupoid_gni.codegen.tape import (
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SUBTRACT_PRODUCT,
    Operation,
)
from groupoid_gni.discretization import StepProgram, SystemExpressions, reference_flow
from groupoid_gni.errors import GNIWarning, InputError
from groupoid_gni.integrators import Method, ReferenceFlow, integrate, step_program
from groupoid_gni.integrators.requests import checked_method, checked_step, checked_whole
from groupoid_gni.reports.markdown import markdown_table
from groupoid_gni.scenes import Scene
from groupoid_gni.systems import MechanicalSystem, State

_KINDS: dict[str, tuple[int, ...]] = {
    "multiply-add": (MULTIPLY_ADD, MULTIPLY_SUBTRACT, SUBTRACT_PRODUCT),
    "add": (ca.OP_ADD, ca.OP_SUB, ca.OP_NEG),
    "multiply": (ca.OP_MUL, ca.OP_SQ, ca.OP_TWICE),
    "divide": (ca.OP_DIV, ca.OP_INV),
    "square root": (ca.OP_SQRT,),
    "sine": (ca.OP_SIN, ca.OP_COS),
}
_NO_WORK = (ca.OP_CONST, ca.OP_INPUT)
OTHER = "other"
KINDS = (*_KINDS, OTHER)
_PLACE = {code: kind for kind, codes in _KINDS.items() for code in codes}


@dataclass(frozen=True)
class BuildTimes:
    """Seconds from a recorded system to machine code, nothing taken from a cache.

    derive : differentiating and simplifying expressions.  emit : writing the IR.  compile : LLVM.
    """

    derive: float
    emit: float
    compile: float

    @property
    def total(self) -> float:
        """All three."""
        return self.derive + self.emit + self.compile


@dataclass(frozen=True, eq=False)
class CostModel:
    """What a step costs.

    system, method : in words.
    operations : place -> kind -> count; places are ``run`` (once before the loop), ``stage``,
        ``iteration`` (of Newton, each time) and ``step`` (at the end of a composed step). Kinds are
        those of ``KINDS``; a multiply-add counts once.
    stages : of one step.  unknowns : of the Newton iteration.  state_size : numbers that make the
        state, arrows not counted.  ir_lines : of the emitted module.  build : times to make it.
    iterations : Newton iterations per step; nanoseconds : per step, the smallest of the repeats.
        None when no start was given.  step_size : at which the last two were measured.
    """

    system: str
    method: str
    operations: Mapping[str, Mapping[str, int]]
    stages: int
    unknowns: int
    state_size: int
    ir_lines: int
    build: BuildTimes
    iterations: float | None = None
    nanoseconds: float | None = None
    step_size: float | None = None

    def per_step(self, kind: str | None = None) -> float | None:
        """Operations of a kind (of all kinds) in a step, at the iterations that were measured.

        Raises InputError for a kind that there is not.
        """
        if kind is not None and kind not in KINDS:
            raise InputError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
        if self.iterations is None:
            return None
        kinds = KINDS if kind is None else (kind,)
        counts = {
            place: sum(found[k] for k in kinds) for place, found in self.operations.items()
        }
        inside = self.iterations * counts["iteration"]
        return float(self.stages * counts["stage"] + inside + counts["step"])

    def table(self) -> str:
        """Operations by place and kind, then everything else."""
        rows = [[place, *(str(found[kind]) for kind in KINDS)]
                for place, found in self.operations.items()]  # fmt: skip
        lines = [
            f"{self.method} on {self.system}",
            "",
            markdown_table(["operations", *KINDS], rows),
            "",
            f"stages per step {self.stages}, unknowns {self.unknowns}, state {self.state_size} "
            f"numbers, IR {self.ir_lines} lines",
            f"derive {self.build.derive:.3f} s, emit {self.build.emit:.3f} s, LLVM "
            f"{self.build.compile:.3f} s",
        ]
        if self.nanoseconds is not None:
            lines.append(
                f"{self.nanoseconds:.0f} ns and {self.iterations:.2f} Newton iterations per step "
                f"of {self.step_size:g}, {self.per_step():.0f} operations"
            )
        return "\n".join(lines)

    __str__ = table

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and strings, ready for JSON."""
        return {
            "system": self.system, "method": self.method,
            "operations": {place: dict(found) for place, found in self.operations.items()},
            "operations_per_step": self.per_step(), "stages": self.stages,
            "unknowns": self.unknowns, "state_size": self.state_size, "ir_lines": self.ir_lines,
            "build_seconds": {"derive": self.build.derive, "emit": self.build.emit,
                              "compile": self.build.compile},
            "newton_iterations": self.iterations, "nanoseconds": self.nanoseconds,
            "step_size": self.step_size,
        }  # fmt: skip


def cost(
    scene: Scene | tuple[MechanicalSystem, State] | MechanicalSystem,
    method: Method | None = None,
    *,
    step: float = 0.02,
    n_steps: int = 1000,
    repeats: int = 10,
) -> CostModel:
    """Count the operations of a step in the emitted code and measure what it takes.

    scene : a scene or (system, start); for a system alone nothing is run.
    method : a stepping method; ``GNI()`` when left out.
    step, n_steps, repeats : of the runs that are timed; the start is the scene's.
    Raises InputError for a method without steps of its own.
    """
    method = checked_method(method)
    if isinstance(method, ReferenceFlow):
        raise InputError(
            "ReferenceFlow chooses its own steps, so there is no cost per step; see the "
            "evaluations and own_steps of its runs"
        )
    size, count = checked_step(step), checked_whole("n_steps", n_steps, 1)
    turns = checked_whole("repeats", repeats, 1)
    system, start = _system_and_start(scene)
    rows = tuple(range(system.constraint_count)) if start is None else start.active_rows
    program, build, ir = built(system, method, rows)
    counts = {
        place: counted(operations) for place, operations in operations_by_place(program).items()
    }
    iterations, nanoseconds = None, None
    if start is not None:
        iterations, nanoseconds = _measured(system, start, method, size, count, turns)
    return CostModel(
        system=_in_words(scene, system),
        method=str(method),
        operations=counts,
        stages=program.stages,
        unknowns=program.unknowns.numel(),
        state_size=program.layout.size,
        ir_lines=ir.count("\n"),
        build=build,
        iterations=iterations,
        nanoseconds=nanoseconds,
        step_size=None if start is None else size,
    )


def counted(operations: Iterable[Operation]) -> dict[str, int]:
    """How many operations of each kind; constants and inputs are none."""
    found = Counter(
        _PLACE.get(operation.code, OTHER)
        for operation in operations
        if operation.code not in _NO_WORK
    )
    return {kind: found[kind] for kind in KINDS}


def built(
    system: MechanicalSystem, method: Method, rows: tuple[int, ...]
) -> tuple[StepProgram, BuildTimes, str]:
    """Derive, emit and compile a stepping method anew: its program, the times, the IR."""
    began = time.perf_counter()
    program = step_program(system, method, rows)  # type: ignore[arg-type]
    derived = time.perf_counter()
    ir = step_kernel_ir(program, lanes=1, fused=machine_has_fused_products())
    emitted = time.perf_counter()
    MachineCode(ir, cached=False)
    times = BuildTimes(derived - began, emitted - derived, time.perf_counter() - emitted)
    return program, times, ir


def flow_build_times(system: MechanicalSystem, rows: tuple[int, ...]) -> BuildTimes:
    """The same for the equations of motion."""
    began = time.perf_counter()
    function = reference_flow(SystemExpressions(system, rows))
    derived = time.perf_counter()
    layout = FlowLayout.of(function)
    ir = adaptive_kernel_ir(function, machine_has_fused_products(), layout)
    emitted = time.perf_counter()
    MachineCode(ir, cached=False)
    return BuildTimes(derived - began, emitted - derived, time.perf_counter() - emitted)


def _measured(
    system: MechanicalSystem, start: State, method: Method, step: float, count: int, repeats: int
) -> tuple[float, float]:
    """Newton iterations and nanoseconds per step."""
    seconds = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GNIWarning)
        for _ in range(repeats):
            run = integrate(
                system, start, step=step, n_steps=count, method=method, save_every=count
            )
            seconds.append(run.seconds)
    return float(run.rows[-1, -1]) / count, 1e9 * min(seconds) / count


def _system_and_start(scene: Any) -> tuple[MechanicalSystem, State | None]:
    if isinstance(scene, MechanicalSystem):
        return scene, None
    made = as_scene(scene)
    return made.system, made.start


def as_scene(scene: Any) -> Scene:
    """A scene, also from (system, start).  Raises InputError for anything else."""
    if isinstance(scene, Scene):
        return scene
    pair = isinstance(scene, tuple) and len(scene) == 2
    if pair and isinstance(scene[0], MechanicalSystem) and isinstance(scene[1], State):
        return Scene(scene[0], scene[1], f"a system on {type(scene[0].space).__name__}")
    raise InputError(
        "scene must be a gni.scenes.Scene or (system, start), for example "
        f"gni.scenes.rolling_ball(); got {type(scene).__name__}"
    )


def _in_words(scene: Any, system: MechanicalSystem) -> str:
    return scene.description if isinstance(scene, Scene) else type(system.space).__name__
