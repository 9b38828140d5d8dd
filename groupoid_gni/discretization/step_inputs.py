"""The symbols every step program starts from, and the guards every step shares."""

from __future__ import annotations

import math

import casadi as ca

from groupoid_gni.discretization.elimination import coupled_groups, determinant
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
            worse = (ca.fmax(missing, vanished) if i else vanished) / self.scales[i]
            # where the metric fails, C fails with it, and the metric is the one to name
            worse = ca.if_else(definite, worse, -1) if node.metric_pivots else worse
            guards.append(Guard(1 + worse, singular, decisive=True))
        if node.pivots and not ca.is_equal(ca.cse(last.mu), ca.cse(node.mu), 1):
            facing = ca.mtimes(last.mu, node.normal)
            for group in coupled_groups(facing):
                scale = math.prod(ca.vertsplit(self.scales[group]))
                guards.append(Guard(1 - determinant(facing[group, group]) / scale, singular))
        return guards
