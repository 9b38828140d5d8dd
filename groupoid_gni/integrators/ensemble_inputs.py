"""The members of an ensemble: one start and one set of parameter values each, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.integrators.requests import checked_start
from groupoid_gni.systems import MechanicalSystem, State, real_array


@dataclass(frozen=True, eq=False)
class Member:
    """Number in the ensemble, start, flat parameters, and those that differ from the system's."""

    number: int
    start: State
    theta: FloatArray
    values: Mapping[str, FloatArray] = field(default_factory=dict)

    def system(self, shared: MechanicalSystem) -> MechanicalSystem:
        """The member's system; it shares recordings and machine code."""
        return shared.with_parameters(**self.values) if self.values else shared


def checked_members(
    system: MechanicalSystem,
    starts: State | Sequence[State],
    parameters: Mapping[str, ArrayLike] | None,
) -> tuple[list[Member], dict[int, str]]:
    """Members whose start holds with their parameters, and why the others were refused.

    Raises InputError where the ensemble as a whole makes no sense.
    """
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"system must be a MechanicalSystem, not {type(system).__name__}")
    tables = _parameter_tables(system, parameters or {})
    given = _start_list(starts)
    count = _member_count(given, tables)
    if len(given) == 1:
        given = given * count
    members, refused = [], {}
    for number, start in enumerate(given):
        try:
            members.append(_member(system, number, start, tables))
        except InputError as error:
            refused[number] = str(error)
    if not members:
        raise InputError(f"every member was refused; member 0: {refused[0]}")
    return members, refused


def _member(
    system: MechanicalSystem, number: int, start: State, tables: Mapping[str, FloatArray]
) -> Member:
    if not tables:
        return Member(number, checked_start(system, start), system.parameter_vector)
    values = {name: table[number] for name, table in tables.items()}
    own = system.with_parameters(**values)
    return Member(number, checked_start(own, start), own.parameter_vector, values)


def _start_list(starts: State | Sequence[State]) -> list[State]:
    if isinstance(starts, State):
        return [starts]
    given = list(starts)
    for number, start in enumerate(given):
        if not isinstance(start, State):
            raise InputError(
                f"starts[{number}] is a {type(start).__name__}; make starts with "
                "system.state(base, velocity)"
            )
    return given


def _parameter_tables(
    system: MechanicalSystem, parameters: Mapping[str, ArrayLike]
) -> dict[str, FloatArray]:
    tables = {}
    for name, given in parameters.items():
        if name not in system.parameters:
            raise InputError(
                f"unknown parameter {name!r}; this system has: "
                f"{', '.join(system.parameters) or 'none'}"
            )
        table = real_array(f"parameters[{name!r}]", given)
        shape = system.parameters[name].shape
        if table.ndim != len(shape) + 1 or table.shape[1:] != shape:
            raise InputError(
                f"parameters[{name!r}] must have shape (members, *{shape}), got {table.shape}"
            )
        tables[name] = table
    return tables


def _member_count(starts: list[State], tables: Mapping[str, FloatArray]) -> int:
    """The number of members; one start serves all."""
    counts = {f"parameters[{name!r}]": len(table) for name, table in tables.items()}
    if len(starts) != 1 or not counts:
        counts["starts"] = len(starts)
    if len(set(counts.values())) != 1:
        listed = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise InputError(f"the ensemble has no single number of members: {listed}")
    count = next(iter(counts.values()))
    if count == 0:
        raise InputError("an ensemble needs at least one member")
    return count


def parameter_grid(**axes: ArrayLike) -> dict[str, FloatArray]:
    """All combinations of the values of some scalar parameters, as ``parameters``.

    axes : name -> (n,) values. Returns name -> (product of n,), the last name fastest.
    """
    values = {name: real_array(name, axis) for name, axis in axes.items()}
    for name, axis in values.items():
        if axis.ndim != 1:
            raise InputError(f"{name} must be a list of numbers, got shape {axis.shape}")
    mesh = np.meshgrid(*values.values(), indexing="ij")
    return {name: grid.ravel() for name, grid in zip(values, mesh, strict=True)}
