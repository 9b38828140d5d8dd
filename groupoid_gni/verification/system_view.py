"""A mechanical system as its laws see it: the library's expressions, and dense NumPy twins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.discretization import SystemExpressions, reference_field
from groupoid_gni.discretization.system_expressions import as_matrix
from groupoid_gni.groupoids import DerivedGroupoid
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.systems.starts import independent_rows

Rows = tuple[int, ...]


class _Recombined(SystemExpressions):
    """The same system with constraint rows ``M mu``."""

    matrix: ca.SX

    def constraints(self, x: ca.SX, theta: ca.SX) -> ca.SX:
        """M times the active rows."""
        return ca.mtimes(self.matrix, super().constraints(x, theta))


class _Gauged(SystemExpressions):
    """The same system with the one-form ``A + a``."""

    form: ca.SX

    def section(self, name: str, x: ca.SX, theta: ca.SX) -> ca.SX:
        """Add a to A."""
        own = super().section(name, x, theta)
        return own + self.form if name == "gyroscopic" else own


class _Library:
    """The library's expressions of a system with some constraint rows, at symbols x, theta."""

    def __init__(self, system: MechanicalSystem, rows: Rows) -> None:
        self.expressions = e = SystemExpressions(system, rows)
        self.x, self.theta = ca.SX.sym("x", e.base_size), ca.SX.sym("t", e.parameter_size)
        self.node = e.node(self.x, self.theta)

    def recombined(self, p: ca.SX, matrix: ca.SX) -> ca.SX:
        """``R(p)`` with rows ``matrix @ mu``."""
        e, count = self.expressions, self.expressions.constraint_count
        variant = _Recombined(e.system, e.active_rows)
        variant.matrix = as_matrix(matrix, count, count)
        return variant.node(self.x, self.theta).reflect(p)

    def gauged(self, p: ca.SX, form: ca.SX) -> ca.SX:
        """``R(p)`` with ``A + form``."""
        variant = _Gauged(self.expressions.system, self.expressions.active_rows)
        variant.form = form
        return variant.node(self.x, self.theta).reflect(p)

    def rates(self, p: ca.SX) -> ca.SX:
        """``x', p'``."""
        return reference_field(self.expressions)(self.theta, ca.vertcat(self.x, p))

    def of(self, name: str, argument: ca.SX) -> ca.SX:
        """One of the functions of ``SystemExpressions``."""
        return getattr(self.expressions, name)(self.x, argument, self.theta)

    def compiled(self, name: str) -> ca.Function:
        """Function (x, two arguments, theta) of that name."""
        kinds, formula = _FORMULAS.get(name, ("r0", lambda b, first, _: b.of(name, first)))
        m, r = self.expressions.constraint_count, self.expressions.rank
        sizes = {"r": r, "m": m, "M": m * m, "0": 0}
        first, second = (ca.SX.sym("a", sizes[kind]) for kind in kinds)
        value = ca.densify(formula(self, first, second))
        return ca.Function(name, [self.x, first, second, self.theta], [value])


# name -> what its two arguments are (r: rank, m: active rows, M: m * m, 0: nothing), expression
_FORMULAS: dict[str, tuple[str, Callable[[_Library, ca.SX, ca.SX], ca.SX]]] = {
    "project": ("r0", lambda b, p, _: b.node.project(p)),
    "reflect": ("r0", lambda b, p, _: b.node.reflect(p)),
    "reflect_change": ("r0", lambda b, p, _: b.node.reflect_change(p)),
    "impulse": ("r0", lambda b, p, _: b.node.impulse(p)),
    "normal_vector": ("m0", lambda b, c, _: b.node.normal_vector(c)),
    "normal_component": ("r0", lambda b, p, _: b.node.normal_component(p)),
    "rates": ("r0", lambda b, p, _: b.rates(p)),
    "reflect_recombined": ("rM", lambda b, p, matrix: b.recombined(p, matrix)),
    "reflect_gauged": ("rr", lambda b, p, form: b.gauged(p, form)),
}


@dataclass(frozen=True, eq=False)
class SystemView:
    """What is checked by ``check_system``: every function at a base point x, on plain arrays.

    The methods down to ``rates`` evaluate the expressions of which the library makes its machine
    code, restricted to the constraint rows that are independent at x. The others use the
    functions as the user wrote them, and take complex arrays where those do.
    """

    system: MechanicalSystem
    _libraries: dict[Rows, _Library] = field(default_factory=dict, init=False, repr=False)
    _functions: dict[tuple[Rows, str], ca.Function] = field(
        default_factory=dict, init=False, repr=False
    )
    _nodes: dict[bytes, DenseNode] = field(default_factory=dict, init=False, repr=False)

    def _library(
        self, name: str, x: FloatArray, first: FloatArray, second: Array | None = None
    ) -> FloatArray:
        rows = self.node(x).rows
        if (rows, name) not in self._functions:
            if rows not in self._libraries:
                self._libraries[rows] = _Library(self.system, rows)
            self._functions[rows, name] = self._libraries[rows].compiled(name)
        other = np.zeros(0) if second is None else np.ravel(second)
        given = self._functions[rows, name](x, first, other, self.theta)
        return np.array(given, dtype=np.float64).ravel()

    @property
    def theta(self) -> FloatArray:
        """The physical parameters, flat."""
        return self.system.parameter_vector

    def project(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """``P* p + Q* Pi``."""
        return self._library("project", x, p)

    def reflect(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """``R(p)``."""
        return self._library("reflect", x, p)

    def reflect_change(self, x: FloatArray, dp: FloatArray) -> FloatArray:
        """``(P* - Q*) dp``."""
        return self._library("reflect_change", x, dp)

    def impulse(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """``C^-1 mu G^-1 (p - Pi)``, (m,)."""
        return self._library("impulse", x, p)

    def normal_vector(self, x: FloatArray, components: FloatArray) -> FloatArray:
        """``N components``."""
        return self._library("normal_vector", x, components)

    def normal_component(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """Components of ``Q* (p - Pi)`` in the basis N, (m,)."""
        return self._library("normal_component", x, p)

    def momentum(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """The Legendre transform of xi."""
        return self._library("momentum", x, xi)

    def velocity(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """The inverse Legendre transform of p."""
        return self._library("velocity", x, p)

    def energy(self, x: FloatArray, p: FloatArray) -> float:
        """``H(x, p)``."""
        return float(self._library("energy", x, p)[0])

    def lagrangian(self, x: FloatArray, xi: FloatArray) -> float:
        """``L(x, xi)``."""
        return float(self._library("lagrangian", x, xi)[0])

    def base_gradient(self, x: FloatArray, xi: FloatArray) -> FloatArray:
        """``dL/dx``, (base_size,)."""
        return self._library("base_gradient", x, xi)

    def multipliers(self, x: FloatArray, p: FloatArray) -> FloatArray:
        """lambda of the equations of motion, (m,)."""
        return self._library("multipliers", x, p)

    def reflect_recombined(self, x: FloatArray, p: FloatArray, matrix: FloatArray) -> FloatArray:
        """``R(p)`` of the same system with constraint rows ``matrix @ mu``."""
        return self._library("reflect_recombined", x, p, matrix)

    def reflect_gauged(self, x: FloatArray, p: FloatArray, form: FloatArray) -> FloatArray:
        """``R(p)`` of the same system with the one-form ``A + form``."""
        return self._library("reflect_gauged", x, p, form)

    def rates(self, x: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        """``x', p'`` of the equations of motion."""
        rate = self._library("rates", x, p)
        return rate[: x.size], rate[x.size :]

    # The functions as given.

    def term(self, name: str, x: Array) -> Array:
        """``metric``, ``constraints`` (all rows), ... in plain NumPy; zero if left out."""
        if self.system.has(name):
            return np.asarray(self.system.with_flat_parameters(name)(x, self.theta))
        rank = self.system.space.rank
        return np.zeros({"potential": (), "constraints": (0, rank)}.get(name, (rank,)))

    def lagrangian_terms(self, x: Array, xi: Array) -> Array:
        """All ``1/2 G_ab xi^a xi^b``, ``A_a xi^a`` and ``-V``, one dimension."""
        kinetic = np.outer(xi, xi) * self.term("metric", x) / 2
        linear = self.term("gyroscopic", x) * xi
        return np.concatenate([kinetic.ravel(), linear, [-self.term("potential", x)]])

    def plain_lagrangian(self, x: Array, xi: Array) -> Any:
        """``1/2 xi G xi + A xi - V``."""
        kinetic = xi @ self.term("metric", x) @ xi / 2
        return kinetic + self.term("gyroscopic", x) @ xi - self.term("potential", x)

    def plain_velocity(self, x: Array, p: Array) -> Array:
        """``G^-1 (p - A)``."""
        return inverse_of(self.term("metric", x)) @ (p - self.term("gyroscopic", x))

    def energy_terms(self, x: Array, p: Array) -> Array:
        """All terms of ``<p, xi> - L``, one dimension."""
        xi = self.plain_velocity(x, p)
        return np.concatenate([p * xi, -self.lagrangian_terms(x, xi)])

    def violation_terms(self, x: Array, p: Array, rows: Rows) -> Array:
        """``mu G^-1 p, -mu G^-1 A, -mu Y`` of some rows, (3, m)."""
        mu = self.term("constraints", x)[list(rows)]
        raised = mu @ inverse_of(self.term("metric", x))
        return np.stack(
            [raised @ p, -raised @ self.term("gyroscopic", x), -mu @ self.term("drift", x)]
        )

    def node(self, x: FloatArray) -> DenseNode:
        """The plain twin at x; the last one is kept, for the next law about the same sample."""
        key = x.tobytes()
        if key not in self._nodes:
            made = DenseNode(self, x)
            self._nodes.clear()
            self._nodes[key] = made
        return self._nodes[key]

    @cached_property
    def derived(self) -> DerivedGroupoid:
        """The groupoid without closed forms: anchor and bracket from the seven functions."""
        return DerivedGroupoid(self.system.space)


class DenseNode:
    """Metric and constraints at one base point in plain NumPy, by explicit inverses.

    rows : the constraint rows that are kept at x.  metric, inverse : G, G^-1.
    mu : the kept rows.  gram : ``C = mu G^-1 mu^T``.
    drift, gyroscopic : Y, A.  offset : ``Pi = G Y + A``.
    along, across : ``P*, Q*``.  lower : L with ``G = L L^T``.
    row_sizes : ``|mu^a|`` in G^-1.
    condition : by how much round-off may grow; what changes of units do to G and C is left out.
    kept : what laws worked out at x, for the next law that asks.
    """

    def __init__(self, view: SystemView, x: FloatArray) -> None:
        self.kept: dict[Any, Any] = {}
        self.metric = np.array(view.term("metric", x), dtype=np.float64)
        symmetric = (self.metric + self.metric.T) / 2
        self.rows: Rows = independent_rows(view.system, x, symmetric).kept
        self.inverse = inverse_of(self.metric)
        self.mu = np.array(view.term("constraints", x), dtype=np.float64)[list(self.rows)]
        self.drift = np.array(view.term("drift", x), dtype=np.float64)
        self.gyroscopic = np.array(view.term("gyroscopic", x), dtype=np.float64)
        self.offset = self.metric @ self.drift + self.gyroscopic
        self.gram = self.mu @ self.inverse @ self.mu.T
        self.row_sizes = np.sqrt(np.diag(self.gram))
        self.across = self.mu.T @ inverse_of(self.gram) @ self.mu @ self.inverse
        self.along = np.eye(len(self.metric)) - self.across
        self.lower = np.linalg.cholesky(symmetric)
        self.condition = _condition(symmetric) * _condition(self.gram)

    def in_frame(self, covectors: FloatArray) -> FloatArray:
        """Components in an orthonormal frame of G, where every unit of measurement is gone."""
        return np.linalg.solve(self.lower, covectors)

    def size(self, *covectors: FloatArray) -> float:
        """``|p|`` in G^-1, added up."""
        return float(sum(np.linalg.norm(self.in_frame(p)) for p in covectors))

    def speed(self, *velocities: FloatArray) -> float:
        """``|xi|`` in G, added up."""
        return float(sum(np.linalg.norm(self.lower.T @ xi) for xi in velocities))


def inverse_of(matrix: Array) -> Array:
    """The inverse, with the diagonal scaled to one first: units of measurement cost no digits."""
    scale = _scale(matrix)
    return np.asarray(np.linalg.inv(matrix / scale) / scale)


def _condition(matrix: FloatArray) -> float:
    """The condition number after scaling the diagonal to one."""
    return float(np.linalg.cond(matrix / _scale(matrix))) if matrix.size else 1.0


def _scale(matrix: Array) -> FloatArray:
    size = np.sqrt(np.abs(np.diag(matrix).real))
    size[size == 0.0] = 1.0
    return np.asarray(np.outer(size, size), dtype=np.float64)
