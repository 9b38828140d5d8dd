"""The symbols every step program starts from, and the guards every step shares."""

from __future__ import annotations

from typing import Any

import casadi as ca

from groupoid_gni.discretization.elimination import (
    between_factors,
    coupled_groups,
    larger,
    unit_triangular_factor,
)
from groupoid_gni.discretization.step_program import Guard
from groupoid_gni.discretization.system_expressions import Node, SystemExpressions
from groupoid_gni.outcomes import Outcome

_SINGULAR_PIVOT = 1e-13
_VANISHING_ROW = 1e-12


class StepInputs:
    """Symbols: physical parameters, step size, constraint scales; fraction and control inputs.

    theta, scales, controls : columns.  whole : the step size.  h : the size of the stage, which is
        the step size or the fraction of the stage times it.  fraction : the symbol, or 1 where a
        step is one stage.
    all : what stays the same in a run.  given : what may differ from stage to stage.
    """

    def __init__(self, expressions: SystemExpressions, composed: bool = False) -> None:
        self.theta = ca.SX.sym("theta", expressions.parameter_size)
        self.whole = ca.SX.sym("h")
        self.scales = ca.SX.sym("scales", expressions.constraint_count)
        self.controls = expressions.controls
        self.fraction = ca.SX.sym("fraction") if composed else ca.SX(1)
        self.h = self.fraction * self.whole if composed else self.whole
        self.all = ca.vertcat(self.theta, self.whole, self.scales)
        self.given = ca.vertcat(self.fraction, self.controls) if composed else self.controls

    def conditioning(self, last: Node, node: Node) -> list[Guard]:
        """Independent rows at the node, not turned over since the last one; a definite metric.

        A guard divides only by pivots that an earlier guard has found good, and the first that
        fires is the one reported: a rank drop exactly at a node is told as such.
        """
        singular, indefinite = Outcome.CONSTRAINTS_SINGULAR, Outcome.METRIC_INDEFINITE
        guards = []
        definite = ca.SX(1)
        for i, pivot in enumerate(node.metric_pivots):
            missing = _SINGULAR_PIVOT * node.metric[i, i] - pivot
            definite = ca.logic_and(definite, missing < 0)
            guards.append(Guard(ca.if_else(missing < 0, 0, 2), indefinite))
        for i, pivot in enumerate(node.pivots):
            missing = _SINGULAR_PIVOT * node.gram[i, i] - pivot
            vanished = _VANISHING_ROW * self.scales[i] - node.gram[i, i]
            worse = (larger(missing, vanished) if i else vanished) / self.scales[i]
            # where the metric fails, C fails with it, and the metric is the one to name
            worse = ca.if_else(definite, worse, -1) if node.metric_pivots else worse
            guards.append(Guard(1 + worse, singular, decisive=True))
        if node.pivots and not ca.is_equal(ca.cse(last.mu), ca.cse(node.mu), 1):
            guards += [Guard(1 - size, singular) for size in _facing(last, node, self.scales)]
        return guards


def _facing(last: Node, node: Node, scales: ca.SX) -> list[Any]:
    """Numbers, one for each group of rows, positive while no normal direction has turned over.

    With ``F = mu G^-1 mu'^T`` between the nodes and ``C' = mu' G'^-1 mu'^T``, what is looked at for
    two rows is whether both eigenvalues of ``C'^-1 F`` have a positive real part, which no scaling
    of the rows changes. For more rows it is whether ``U^-1 F U'^-T``, C = U D U^T, has a positive
    definite symmetric part: the products of the orthogonal bases that come of the rows one after
    the other. Either holds wherever the rows turn by less than a right angle; the sign of the
    determinant alone would miss two directions that turn over at once.
    """
    facing = ca.mtimes(last.mu, node.normal)
    sizes: list[Any] = []
    for group in coupled_groups(ca.sparsify(facing) + node.gram):
        overlap, after = facing[group, group], node.gram[group, group]
        if len(group) == 2:
            numbers = _eigenvalues_of_two(overlap, after)
        else:
            numbers = _pivots(overlap, last.gram[group, group], after)
        least = numbers[-1]
        for number in reversed(numbers[:-1]):
            least = ca.if_else(number > 0, least, number)
        sizes.append(least / scales[group[0]])
    return sizes


def _eigenvalues_of_two(facing: ca.SX, after: ca.SX) -> list[Any]:
    """``det F`` and ``trace adj(C') F``: the product and the sum, times ``det C' > 0``."""
    mixed = (facing[0, 1] + facing[1, 0]) * after[0, 1]
    return [
        facing[0, 0] * facing[1, 1] - facing[0, 1] * facing[1, 0],
        after[1, 1] * facing[0, 0] + after[0, 0] * facing[1, 1] - mixed,
    ]


def _pivots(facing: ca.SX, before: ca.SX, after: ca.SX) -> list[Any]:
    """Pivots of the symmetric part of ``U^-1 F U'^-T``."""
    first, second = (unit_triangular_factor(gram)[0] for gram in (before, after))
    overlap = between_factors(first, facing, second)
    return unit_triangular_factor((overlap + overlap.T) / 2)[1]
