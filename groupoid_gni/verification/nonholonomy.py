"""How fast the allowed directions grow by brackets: what makes constraints nonholonomic.

``D_1 = D``, ``D_(k+1) = D_k + [D, D_k] + [Y, D_k]``, with D the allowed directions and Y the drift.
If ``D_2 = D`` the constraints are integrable (Frobenius; with a drift they may move with time).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.discretization.elimination import solve_linear
from groupoid_gni.discretization.system_expressions import as_matrix
from groupoid_gni.expressions import record
from groupoid_gni.verification.system_view import SystemView

_NEW = 1e-7
"""Part of a bracket that must lie outside of what is already there."""
_NATURAL = 1e-4
"""Terms smaller than this part of their natural size may be round-off around zero."""


def growth(view: SystemView, x: FloatArray) -> tuple[int, ...]:
    """Ranks of ``D_1, D_2, ...`` at x up to the last that grew; x must be a generic point.

    Ranks are decided by singular directions relative to the terms of each bracket, in an
    orthonormal frame of G, so that no unit of measurement matters.
    """
    kept = view.node(x).kept
    if "ranks" not in kept:
        kept["ranks"] = _growth(_Sections(view, x))
    ranks: tuple[int, ...] = kept["ranks"]
    return ranks


def _growth(space: _Sections) -> tuple[int, ...]:
    allowed = space.rank - len(space.node.rows)
    chosen, found = _enlarged(
        np.zeros((space.rank, 0)), space.numbers(space.allowed), 0.0, allowed
    )
    first = [space.section(space.allowed[:, k], 1.0) for k in chosen]
    drift = space.drift()
    pairs = [*combinations(first, 2), *product(drift, first)]
    ranks = [found.shape[1]]
    while found.shape[1] < space.rank and pairs:
        brackets = [space.bracket(a, b) for a, b in pairs]
        chosen, found = _enlarged(found, space.relative(brackets), _NEW, space.rank)
        if not chosen:
            break
        ranks.append(found.shape[1])
        newest = [space.section(ca.sum2(brackets[k].terms), brackets[k].natural) for k in chosen]
        pairs = list(product([*first, *drift], newest))
    return tuple(ranks)


def _enlarged(
    found: FloatArray, columns: FloatArray, threshold: float, most: int
) -> tuple[list[int], FloatArray]:
    """Which columns enlarge an orthonormal basis by more than a threshold, and what it becomes."""
    chosen: list[int] = []
    while found.shape[1] < most and columns.shape[1]:
        rest = columns - found @ (found.T @ columns)
        rest = rest - found @ (found.T @ rest)
        lengths = np.linalg.norm(rest, axis=0)
        best = int(np.argmax(lengths))
        if not lengths[best] > threshold:
            break
        chosen.append(best)
        found = np.column_stack([found, rest[:, best] / lengths[best]])
    return chosen, found


@dataclass(frozen=True, eq=False)
class _Section:
    """A section of AG near x: its expression, (r, 1), and the slope of that, (r, base_size).

    natural : the size it has at x if nothing cancels.
    """

    expression: ca.SX
    slope: ca.SX
    natural: float


@dataclass(frozen=True, eq=False)
class _Bracket:
    """The terms of a bracket, one per column, (r, 3), and its natural size."""

    terms: ca.SX
    natural: float


class _Sections:
    """Sections of AG near x.

    allowed : sections that span D, one per column.
    """

    def __init__(self, view: SystemView, x: FloatArray) -> None:
        self.view, self.at, self.node = view, x, view.node(x)
        self.expressions = e = SystemExpressions(view.system, self.node.rows)
        self.rank, self.x, self.theta = e.rank, ca.SX.sym("x", e.base_size), ca.SX(view.theta)
        # D does not depend on the metric, so a constant one at hand will do to project
        weights = ca.SX(ca.diag(ca.DM(1.0 / np.diag(self.node.metric))))
        mu = e.constraints(self.x, self.theta)
        normal = ca.mtimes(weights, mu.T)
        along = ca.mtimes(normal, solve_linear(ca.mtimes(mu, normal), mu))
        self.allowed = ca.mtimes(ca.SX.eye(e.rank) - along, ca.sqrt(weights))
        self.anchor = e.anchor(self.x) if e.base_size else ca.SX(0, e.rank)
        bracket = record(
            view.system.space.bracket, {"x": (e.base_size,)}, (e.rank,) * 3, name="bracket"
        )
        self.structure = as_matrix(bracket.call_sx(self.x), e.rank, e.rank**2)
        self.rate = self._natural_rate()

    def drift(self) -> list[_Section]:
        """Y, if there is one."""
        if not self.view.system.has("drift"):
            return []
        drift = self.expressions.section("drift", self.x, self.theta)
        return [self.section(drift, self.node.speed(self.node.drift))]

    def section(self, expression: ca.SX, natural: float) -> _Section:
        """A section with its slope."""
        return _Section(expression, ca.jacobian(expression, self.x), natural)

    def bracket(self, a: _Section, b: _Section) -> _Bracket:
        """The terms ``C(a, b), db (rho a), -da (rho b)`` of ``[a, b]``."""
        terms = [
            ca.mtimes(self.structure, ca.kron(a.expression, b.expression)),
            ca.mtimes(b.slope, ca.mtimes(self.anchor, a.expression)),
            -ca.mtimes(a.slope, ca.mtimes(self.anchor, b.expression)),
        ]
        return _Bracket(ca.horzcat(*terms), self.rate * a.natural * b.natural)

    def numbers(self, expression: ca.SX) -> FloatArray:
        """The columns at x, in an orthonormal frame of G."""
        value = ca.Function("value", [self.x], [ca.densify(expression)])(self.at)
        return np.asarray(self.node.lower.T @ np.array(value, dtype=np.float64))

    def relative(self, brackets: list[_Bracket]) -> FloatArray:
        """Brackets in units of what their terms amount to, one per column."""
        terms = self.numbers(ca.horzcat(*[b.terms for b in brackets]))
        terms = terms.reshape(self.rank, len(brackets), 3)
        sizes = np.sum(np.linalg.norm(terms, axis=0), axis=1)
        sizes = np.maximum(sizes, [_NATURAL * b.natural for b in brackets])
        sizes[sizes == 0.0] = 1.0
        return np.asarray(np.sum(terms, axis=2) / sizes)

    def _natural_rate(self) -> float:
        """How fast D and Y turn along vectors of size one: the size of a bracket, if generic."""
        node, x, theta = self.node, self.at, self.view.theta
        system = self.view.system
        frame = np.linalg.inv(node.lower.T)
        structure = np.einsum("cab,ai,bj->cij", system.space.bracket(x), frame, frame)
        rate = float(np.max(np.abs(np.tensordot(node.lower.T, structure, 1)), initial=0.0))
        if not x.size:
            return rate
        moved = np.asarray(system.space.anchor(x)) @ frame
        slope = system.recorded("constraints").derivative(0)(x, theta)[list(node.rows)] @ moved
        turning = np.linalg.norm(np.einsum("cd,acj->adj", frame, slope), axis=1)
        rate += float(np.max(turning / node.row_sizes[:, None], initial=0.0))
        speed = node.speed(node.drift)
        if speed > 0.0:
            slope = node.lower.T @ (system.recorded("drift").derivative(0)(x, theta) @ moved)
            rate += float(np.max(np.linalg.norm(slope, axis=0), initial=0.0)) / speed
        return rate
