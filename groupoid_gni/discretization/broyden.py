"""A quasi-Newton search for the few numbers that close a stage on the constraint set."""

from __future__ import annotations

import casadi as ca

from groupoid_gni.discretization.step_program import Guard
from groupoid_gni.outcomes import Outcome

_LARGEST_INVERSE = 50.0
LEAST_MOVE = 1e-26
"""Square of a move, over the energy, below which it is round-off and teaches nothing."""


class Broyden:
    """Broyden's iteration for ``closing(value) = 0``, kept over the stages of a run.

    value : the m numbers searched, ``g^power`` times the symbols ``unknown``, g the fraction of the
        stage: the unknown is smooth from stage to stage.
    slope : the Jacobian of ``closing`` as the stage size tends to zero. The rest is odd in the
        stage size and changes by O(h^2) from stage to stage: the inverse is ``1/slope + g D``, and
        D is carried along. ``carried`` is (D, last move, last closing).
    """

    def __init__(self, m: int, fraction: ca.SX, slope: float, power: int) -> None:
        self._m, self._fraction, self._power = m, fraction, power
        self._inverse_slope = ca.SX.eye(m) / slope
        self.later = ca.SX.sym("later")
        self.unknown = ca.SX.sym("searched", m)
        self.value = fraction**power * self.unknown
        self._bend = ca.SX.sym("bend", m, m)
        self._moved, self._before = ca.SX.sym("moved", m), ca.SX.sym("before", m)
        self.carried = ca.vertcat(ca.vec(self._bend), self._moved, self._before)
        self.first_carried = ca.SX.zeros(m * m + 2 * m, 1)
        self.update, self.change = ca.SX(0, 1), ca.SX(0, 1)
        self.next_carried, self.work = ca.SX(0, 1), ca.SX(0)
        self.guards: list[Guard] = []

    def close(self, closing: ca.SX, energy: ca.SX, scale: ca.SX | None = None) -> None:
        """Set ``change`` (current minus better value), ``update`` (of the unknown) and the rest.

        scale : matrix that makes ``value^T scale value`` an energy; 1 when left out.
        """
        if self._m == 0:
            return
        inverse = self._inverse_slope + self._fraction * self._bend
        better = self._updated(inverse, closing - self._before, energy)
        self.change = ca.mtimes(better, closing)
        self.update = self.change / self._fraction**self._power
        bend = (better - self._inverse_slope) / self._fraction
        self.next_carried = ca.vertcat(ca.vec(bend), -self.change, closing)
        measured = closing if scale is None else ca.mtimes(scale, closing)
        self.work = ca.sum1(ca.fabs(measured * self.change))
        size = ca.sqrt(ca.sumsqr(better)) / _LARGEST_INVERSE
        self.guards = [Guard(size, Outcome.PROJECTION_SINGULAR, decisive=True)]

    def _updated(self, inverse: ca.SX, change: ca.SX, energy: ca.SX) -> ca.SX:
        """Broyden's formula for the inverse; left alone where the last step was round-off.

        What is learnt while the flights are still far off may be nonsense: an inverse that is to
        change by more than a factor of four, or its sign, is given up for that of ``slope``.
        """
        moved = self._moved
        expected = ca.mtimes(inverse, change)
        denominator = ca.dot(moved, expected)
        size = ca.dot(moved, moved)
        tells = ca.logic_and(self.later, size > LEAST_MOVE * energy)
        believable = ca.logic_and(4 * denominator > size, denominator < 4 * size)
        safe = ca.if_else(believable, denominator, 1)
        row = ca.mtimes(moved.T, inverse)
        correction = ca.mtimes(moved - expected, row) / safe
        fresh = self._inverse_slope - inverse
        return inverse + ca.if_else(tells, ca.if_else(believable, correction, fresh), 0)
