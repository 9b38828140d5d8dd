"""One step of a method as a ``casadi.Function``: the bridge to optimal control.

The functions hold the expressions that ``integrate`` runs as machine code. What a step solves for
is found by a rootfinder, whose derivatives are those of the implicit function theorem; so the step
can be differentiated as often as an optimiser asks for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.discretization import DiscreteLagrangian, StepProgram, SystemExpressions
from groupoid_gni.errors import InputError
from groupoid_gni.integrators.marching import compiled_step
from groupoid_gni.integrators.methods import GNI, McLachlanPerlmutter, Method, ReferenceFlow
from groupoid_gni.integrators.requests import checked_method
from groupoid_gni.systems import MechanicalSystem

_TOLERANCE = 1e-12
_ITERATIONS = 50
# at rest in equilibrium everything is round-off; sizes below this, in the user's units, count as it
_SMALL = 1e-3


def step_function(
    system: MechanicalSystem,
    method: Method | None = None,
    *,
    active_rows: Sequence[int] | None = None,
    velocities: bool = False,
) -> ca.Function:
    """One step of a method as a ``casadi.Function``.

    (base, momentum, controls, parameters, step) -> (next_base, next_momentum), columns of sizes
    base_size, rank, ``system.control_size``, ``system.parameter_vector.size`` and 1; empty ones may
    be left out of a call by name, or be ``[]``. It is the step of ``integrate``, solved to 1e-12
    relative to the velocities and the energy (or to 1e-15 where they are tiny). A momentum off the
    constraint set is not refused; a step with projection returns it to the set.

    method : ``GNI(...)`` (default), ``McLachlanPerlmutter(...)``; or a discrete Lagrangian such as
        ``Rattle()``, whose ``momentum`` is the one after the impact, ``run.momenta_after``.
    active_rows : constraint rows to keep, such as ``start.active_rows``; all when left out.
    velocities : call the second input ``velocity`` and the second output ``next_velocity``, and
        take and give ``G^-1 (p - A)`` in the place of the momentum p.

    A step without unknowns is a function of SX. The others hold a ``ca.rootfinder`` and take MX or
    numbers; where the solver fails they raise RuntimeError, whereupon IPOPT takes a shorter step
    (``integrate`` would try again from another guess). Base points are ambient: a target
    is best written in as many numbers as there are degrees of freedom. The guards of ``integrate``
    (rank of the constraints, domain of the retraction) are not part of the function: replay what
    was found.

    Raises InputError for a method without such a step, and for rows that do not exist.
    """
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"system must be a MechanicalSystem, not {type(system).__name__}")
    if not isinstance(velocities, bool):
        raise InputError(f"velocities must be True or False, got {velocities!r}")
    method = _checked_method(method)
    rows = _checked_rows(system, active_rows)
    key = ("step_function", method, rows, velocities)
    if key not in system._compiled:
        program = compiled_step(system, method, rows, compile=False).program
        expressions = SystemExpressions(system, rows)
        stage = _Stage.of(program, expressions, isinstance(method, McLachlanPerlmutter))
        system._compiled[key] = _chained(stage, program.fractions, expressions, velocities)
    function: ca.Function = system._compiled[key]
    return function


def _checked_method(method: Method | None) -> GNI | McLachlanPerlmutter | DiscreteLagrangian:
    method = checked_method(method)
    if isinstance(method, (GNI, McLachlanPerlmutter, DiscreteLagrangian)):
        return method
    reason = "its step goes from arrow to arrow"
    if isinstance(method, ReferenceFlow):
        reason = "it chooses its own steps"
    raise InputError(
        f"{method} is not offered as a step function: {reason}. Use gni.GNI(...), "
        "gni.McLachlanPerlmutter(...) or a discrete Lagrangian such as gni.Rattle()"
    )


def _checked_rows(system: MechanicalSystem, active_rows: Sequence[int] | None) -> tuple[int, ...]:
    count = system.constraint_count
    if active_rows is None:
        return tuple(range(count))
    rows = list(np.atleast_1d(np.asarray(active_rows, dtype=object)))
    whole = all(isinstance(row, (int, np.integer)) and not isinstance(row, bool) for row in rows)
    if not whole or not all(0 <= row < count for row in rows) or rows != sorted(set(rows)):
        allowed = f"rising numbers from 0 to {count - 1}" if count else "empty: it has no rows"
        raise InputError(f"active_rows of this system must be {allowed}, got {active_rows!r}")
    return tuple(int(row) for row in rows)


@dataclass(frozen=True)
class _Stage:
    """One stage, (base, momentum, controls, parameters, step, fraction) -> (base, momentum).

    kind : ``ca.SX`` where it is explicit, ``ca.MX`` where it holds a rootfinder.
    """

    function: ca.Function
    kind: Any

    @classmethod
    def of(cls, program: StepProgram, expressions: SystemExpressions, impulses: bool) -> _Stage:
        """Solve "the update is zero", carried quantities held at their first values.

        In a neighbourhood of a solution the update vanishes where the equations of the step hold
        and nowhere else, so its derivatives there are those the implicit function theorem wants.

        impulses : the numbers searched are impulses along the rows of mu, not along a unit normal.
        """
        inputs = _symbols(ca.SX, expressions, "momentum", ("fraction", 1))
        unknowns = ca.SX.sym("unknowns", program.unknowns.numel())
        at = _at(program, expressions, inputs, unknowns)
        after = [at["next_base"], at["next_momentum"]]
        if not unknowns.numel():
            return cls(ca.Function("stage", inputs, after), ca.SX)
        searched = expressions.constraint_count if program.carried.numel() else 0
        rows = ca.SX.ones(searched)
        if searched and impulses:
            rows = ca.sqrt(ca.diag(expressions.node(inputs[0], inputs[3]).gram))
        begin = _beginning(expressions, inputs, unknowns, at, rows)
        size = ca.SX.sym("size", unknowns.numel())
        relative = ca.substitute(at["update"], unknowns, size * unknowns) / size
        equations = ca.Function("equations", [unknowns, *inputs, size], [relative])
        options = {"abstol": _TOLERANCE, "abstolStep": _TOLERANCE, "max_iter": _ITERATIONS}
        solve = ca.rootfinder("solve", "newton", equations, options)
        finish = ca.Function("finish", [unknowns, *inputs], after)
        outer = _symbols(ca.MX, expressions, "momentum", ("fraction", 1))
        guess, unit = begin(*outer)
        found = unit * solve(guess, *outer, unit)
        return cls(ca.Function("stage", outer, finish(found, *outer)), ca.MX)


def _at(
    program: StepProgram,
    expressions: SystemExpressions,
    inputs: list[ca.SX],
    unknowns: ca.SX,
) -> dict[str, ca.SX]:
    """What a program computes, as expressions of the inputs of a stage and of its unknowns."""
    base, momentum, controls, theta, step, fraction = inputs
    layout = program.layout
    state = ca.SX.zeros(layout.size)
    state[layout.slices["base"]] = base
    state[layout.slices["after"]] = momentum
    # the scales of the constraints enter guards only
    scales = ca.SX.ones(expressions.constraint_count)
    parameters = ca.vertcat(theta, step, scales)
    given = ca.vertcat(fraction, controls) if program.stages > 1 else controls
    wanted = {
        "guess": program.first_guess,
        "update": program.update,
        "energy": program.energy,
        "next_base": program.next_state[layout.slices["base"]],
        "next_momentum": program.next_state[layout.slices["after"]],
    }
    told = [program.parameters, program.state, program.given, program.unknowns]
    carried = ca.Function("carried", told[:2], [program.first_carried])(parameters, state)
    told += [program.carried, program.later]
    function = ca.Function("program", told, [ca.densify(value) for value in wanted.values()])
    values = ca.cse(list(function(parameters, state, given, unknowns, carried, 0)))
    return dict(zip(wanted, values, strict=True))


def _beginning(
    expressions: SystemExpressions,
    inputs: list[ca.SX],
    unknowns: ca.SX,
    at: dict[str, ca.SX],
    rows: ca.SX,
) -> ca.Function:
    """Stage inputs -> first guess in units of the sizes to expect, and these sizes.

    Velocities: that at the start, plus the first correction. The numbers that close the stage on
    the constraint set may be round-off of zero, so theirs is what makes the energy. Neither output
    is to be differentiated: the solution does not depend on them.

    rows : sizes of the rows that the searched numbers, the last of the unknowns, belong to.
    """
    base, momentum, _, theta, *_ = inputs
    names = ["energy", "update"]
    energy, mend = ca.Function("at", [unknowns, *inputs], [at[name] for name in names])(
        at["guess"], *inputs
    )
    velocities = unknowns.numel() - rows.numel()
    speed = ca.norm_inf(expressions.velocity(base, momentum, theta))
    if velocities:
        speed += ca.norm_inf(mend[:velocities, 0])
    size = ca.vertcat(
        ca.repmat(speed, velocities, 1), (ca.sqrt(energy) + ca.fabs(mend[velocities:, 0])) / rows
    ) + _SMALL
    outputs = [at["guess"] / size, size]
    return ca.Function("begin", inputs, outputs, {"is_diff_out": [False, False]})


def _symbols(
    kind: Any, expressions: SystemExpressions, second: str, *more: tuple[str, int]
) -> list[Any]:
    sizes = {
        "base": expressions.base_size,
        second: expressions.rank,
        "controls": expressions.system.control_size,
        "parameters": expressions.parameter_size,
        "step": 1,
        **dict(more),
    }
    return [kind.sym(name, size) for name, size in sizes.items()]


def _chained(
    stage: _Stage,
    fractions: tuple[float, ...],
    expressions: SystemExpressions,
    velocities: bool,
) -> ca.Function:
    """The stages one after the other, between momenta or between velocities."""
    second = "velocity" if velocities else "momentum"
    inputs = _symbols(stage.kind, expressions, second)
    x, p, controls, theta, step = inputs
    to_momentum, to_velocity = _legendre(expressions)
    if velocities:
        p = to_momentum(x, p, theta)
    for fraction in fractions:
        x, p = stage.function(x, p, controls, theta, step, fraction)
    if velocities:
        p = to_velocity(x, p, theta)
    names = ["base", second, "controls", "parameters", "step"]
    return ca.Function("step", inputs, [x, p], names, ["next_base", f"next_{second}"])


def _legendre(expressions: SystemExpressions) -> tuple[ca.Function, ca.Function]:
    """(x, xi, theta) -> p and (x, p, theta) -> xi."""
    x, a = ca.SX.sym("x", expressions.base_size), ca.SX.sym("a", expressions.rank)
    theta = ca.SX.sym("theta", expressions.parameter_size)
    maps = expressions.momentum(x, a, theta), expressions.velocity(x, a, theta)
    return tuple(ca.Function("legendre", [x, a, theta], [ca.densify(m)]) for m in maps)  # type: ignore[return-value]
