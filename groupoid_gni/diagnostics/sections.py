"""Sections X of the algebroid, and how the Lagrangian and the momentum change along them.

With ``L(x, v)``, ``p = dL/dv`` and the anchor rho, the complete lift of X acts on L by

    X^c L = rho(X)^i dL/dx^i + p_a (rho(v)^i dX^a/dx^i + [v, X]^a),

the bracket taken with constant components (structure functions only). Along a motion
``p_a' = rho_a^i dL/dx^i + <p, [v, e_a]> + lambda mu_a`` this gives the momentum equation

    d/dt <p, X> = X^c L + lambda mu X.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.errors import InputError
from groupoid_gni.expressions import RecordedFunction, record
from groupoid_gni.systems import MechanicalSystem, real_array
from groupoid_gni.systems.input_checks import check_signature, constant_array, constant_function
from groupoid_gni.trajectory import Trajectory

Section = Callable[[Any, Any], Any] | ArrayLike
"""A function (x, p) -> (rank,) of base point and parameters, as ``drift``; or a constant array."""

_MOST_NODES = 64
_SPREAD = 0.3
_SEED = 20151118


def recorded_section(
    system: MechanicalSystem, section: Section, points: FloatArray
) -> RecordedFunction:
    """The recording (x, flat parameters) -> (rank,) of a section, compared with plain calls.

    points : (k, base_size), where the comparison is made.
    Raises InputError or RecordingError when the section has a wrong shape or cannot be recorded.
    """
    r, layout = system.space.rank, system.parameter_layout
    if callable(section):
        check_signature("section", section)
        plain = section
    else:
        plain = constant_function(constant_array("section", section, (r,)))

    def with_flat_parameters(x: Array, flat: Array) -> Any:
        return plain(x, layout.namespace(flat))

    with_flat_parameters.__wrapped__ = plain  # type: ignore[attr-defined]
    inputs = {"x": (system.space.base_size,), "parameters": (layout.size,)}
    checks = [(x, system.parameter_vector) for x in points[:3]]
    return record(with_flat_parameters, inputs, (r,), name="section", check_points=checks)


class SectionAlongMotion:
    """What a section does to the Lagrangian and to the momentum, as functions of many nodes.

    section : the recording of X.
    """

    def __init__(
        self, system: MechanicalSystem, active_rows: tuple[int, ...], section: RecordedFunction
    ) -> None:
        self.system = system
        self.section = section
        self._expressions = e = SystemExpressions(system, active_rows)
        space = system.space
        self._structure = record(
            space.bracket, {"x": (e.base_size,)}, (e.rank, e.rank, e.rank), name="bracket"
        )
        self._functions: dict[str, RecordedFunction] = {}

    def values(self, base: FloatArray) -> FloatArray:
        """X at base points, (n, rank)."""
        return np.asarray(self.section(base, self.system.parameter_vector))

    def lie_derivative(self, base: FloatArray, velocities: FloatArray) -> FloatArray:
        """``X^c L`` at base points and velocities, (n,)."""
        return self._evaluate("value", base, velocities)

    def lie_scale(self, base: FloatArray, velocities: FloatArray) -> FloatArray:
        """Sum of the sizes of the terms of ``X^c L``, (n,): what cancels in it."""
        return self._evaluate("scale", base, velocities)

    def force_part(self, base: FloatArray, velocities: FloatArray) -> FloatArray:
        """``lambda mu X``, lambda the multiplier of the equations of motion, (n,)."""
        return self._evaluate("force", base, velocities)

    def _evaluate(self, name: str, base: FloatArray, velocities: FloatArray) -> FloatArray:
        if name not in self._functions:
            self._functions[name] = self._function(name)
        function = self._functions[name]
        return np.asarray(function(base, velocities, self.system.parameter_vector))

    def _function(self, name: str) -> RecordedFunction:
        e = self._expressions
        x, v = ca.SX.sym("x", e.base_size), ca.SX.sym("v", e.rank)
        theta = ca.SX.sym("theta", e.parameter_size)
        make = {"value": self._lie, "scale": self._scale, "force": self._force}[name]
        value = ca.densify(ca.cse(make(x, v, theta)))
        shapes = ((e.base_size,), (e.rank,), (e.parameter_size,))
        return RecordedFunction(name, ca.Function(name, [x, v, theta], [value]), shapes, ())

    def _lie(self, x: ca.SX, v: ca.SX, theta: ca.SX) -> ca.SX:
        e = self._expressions
        p, X = e.momentum(x, v, theta), self.section.call_sx(x, theta)
        along_base, force = e.unconstrained_field(x, p, theta)
        change = ca.dot(X, force)
        if e.base_size:
            change += ca.dot(p, ca.jtimes(X, x, along_base))
        return change

    def _scale(self, x: ca.SX, v: ca.SX, theta: ca.SX) -> ca.SX:
        e = self._expressions
        p, X = ca.fabs(e.momentum(x, v, theta)), self.section.call_sx(x, theta)
        C = ca.fabs(ca.reshape(self._structure.call_sx(x), e.rank * e.rank, e.rank))
        # columns of C run over c, rows over (a, b) with b fastest
        pairs = ca.kron(ca.fabs(v), ca.fabs(X))
        size = ca.dot(pairs, ca.mtimes(C, p))
        if e.base_size:
            rho = ca.fabs(e.anchor(x))
            slope = ca.fabs(e.base_gradient(x, v, theta))
            size += ca.dot(slope, ca.mtimes(rho, ca.fabs(X)))
            size += ca.dot(p, ca.mtimes(ca.fabs(ca.jacobian(X, x)), ca.mtimes(rho, ca.fabs(v))))
        return size

    def _force(self, x: ca.SX, v: ca.SX, theta: ca.SX) -> ca.SX:
        e = self._expressions
        if not e.constraint_count:
            return ca.SX(0)
        p, X = e.momentum(x, v, theta), self.section.call_sx(x, theta)
        return ca.dot(e.multipliers(x, p, theta), ca.mtimes(e.constraints(x, theta), X))


@dataclass(frozen=True)
class Samples:
    """Base points (k, base_size) and velocities (k, rank) of unit size in the metric."""

    base: FloatArray
    velocities: FloatArray


def nodes_of(run: Trajectory) -> FloatArray:
    """Up to 64 base points of a run, evenly spread over it."""
    return run.base[np.unique(np.linspace(0, len(run) - 1, _MOST_NODES).astype(int))]


def checked_points(system: MechanicalSystem, points: ArrayLike | None) -> FloatArray:
    """Base points (k, base_size) as given; the example point of the space when left out."""
    size = system.space.base_size
    if points is None:
        return np.array(system.space.example_base_point, dtype=float).reshape(1, size)
    array = np.atleast_2d(real_array("points", points))
    if array.ndim != 2 or array.shape[1] != size or not len(array):
        raise InputError(f"points must have shape (k, {size}), got {np.shape(points)}")
    if not np.all(np.isfinite(array)):
        raise InputError("points must be finite")
    return array


def samples_around(
    system: MechanicalSystem, points: FloatArray, count: int, seed: int = _SEED
) -> Samples:
    """Points near the given ones, reached by random arrows, with random velocities; seeded.

    The given points come first. Points where a term of the system is not finite are left out.
    Raises InputError when none is left.
    """
    rng = np.random.default_rng(seed)
    space = system.space
    base = [points[k % len(points)] for k in range(max(count, len(points)))]
    for k in range(len(points), len(base)):
        arrow = space.retract(base[k], _SPREAD * rng.uniform(-1.0, 1.0, space.rank))
        moved = np.asarray(space.target(arrow), dtype=float)
        base[k] = np.asarray(space.restore_base(moved), dtype=float)
    array = np.array(base).reshape(len(base), space.base_size)
    with np.errstate(all="ignore"):
        terms = [system.evaluate(name, array).reshape(len(array), -1) for name in system.plain]
        finite = np.all(np.isfinite(np.concatenate(terms, axis=1)), axis=1)
        velocities = rng.normal(size=(len(array), space.rank))
        velocities /= system.speeds(array, velocities)[:, None]
        finite &= np.all(np.isfinite(velocities), axis=1)
    if not np.any(finite):
        raise InputError(
            "the system is not finite at any of the sampled base points; pass points of its domain"
        )
    return Samples(array[finite], velocities[finite])
