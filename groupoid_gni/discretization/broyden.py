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
    groups : numbers that are searched together; each group learns an inverse Jacobian of its own,
        and what couples different groups, which is of higher order in the step, is left to the
        iteration.
    slope : the Jacobian of ``closing`` as the stage size tends to zero. The rest is odd in the
        stage size and changes by O(h^2) from stage to stage: the inverse is ``1/slope + g D``, and
        D is carried along. ``carried`` is (D, last move, last closing), group after group.
    """

    def __init__(
        self, groups: list[list[int]], fraction: ca.SX, slope: float, power: int
    ) -> None:
        self._groups = groups
        self._power, self._fraction = power, fraction
        m = sum(len(group) for group in groups)
        self.later = ca.SX.sym("later")
        self.unknown = ca.SX.sym("searched", m)
        self.value = fraction**power * self.unknown
        self._searches = [_Search(len(group), fraction, slope, self.later) for group in groups]
        parts = [search.carried for search in self._searches]
        self.carried = ca.vertcat(*parts) if parts else ca.SX(0, 1)
        self.first_carried = ca.SX.zeros(self.carried.numel(), 1)
        self.update, self.change = ca.SX(0, 1), ca.SX(0, 1)
        self.next_carried, self.work = ca.SX(0, 1), ca.SX(0)
        self.guards: list[Guard] = []

    def close(self, closing: ca.SX, energy: ca.SX, scale: ca.SX | None = None) -> None:
        """Set ``change`` (current minus better value), ``update`` (of the unknown) and the rest.

        scale : matrix that makes ``value^T scale value`` an energy; 1 when left out.
        """
        if not self._groups:
            return
        steps = [
            search.step(closing[group, 0], energy)
            for search, group in zip(self._searches, self._groups, strict=True)
        ]
        change = ca.SX(closing.numel(), 1)
        for group, (moved, _, _) in zip(self._groups, steps, strict=True):
            change[group, 0] = moved
        self.change = ca.densify(change)
        self.update = self.change / self._fraction**self._power
        self.next_carried = ca.vertcat(*[carried for _, carried, _ in steps])
        measured = closing if scale is None else ca.mtimes(scale, closing)
        self.work = ca.sum1(ca.fabs(measured * self.change))
        self.guards = [
            Guard(size / _LARGEST_INVERSE, Outcome.PROJECTION_SINGULAR, decisive=True)
            for _, _, size in steps
        ]


class _Search:
    """The inverse Jacobian of one group of numbers."""

    def __init__(self, m: int, fraction: ca.SX, slope: float, later: ca.SX) -> None:
        self._fraction, self._later = fraction, later
        self._inverse_slope = ca.SX.eye(m) / slope
        self._bend = ca.SX.sym("bend", m, m)
        self._moved, self._before = ca.SX.sym("moved", m), ca.SX.sym("before", m)
        self.carried = ca.vertcat(ca.vec(self._bend), self._moved, self._before)

    def step(self, closing: ca.SX, energy: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Current minus better value, what is carried on, and the size of the inverse."""
        inverse = self._inverse_slope + self._fraction * self._bend
        better = self._updated(inverse, closing - self._before, energy)
        change = ca.mtimes(better, closing)
        bend = (better - self._inverse_slope) / self._fraction
        return change, ca.vertcat(ca.vec(bend), -change, closing), ca.sqrt(ca.sumsqr(better))

    def _updated(self, inverse: ca.SX, change: ca.SX, energy: ca.SX) -> ca.SX:
        """Broyden's formula for the inverse; left alone where the last step was round-off.

        What is learnt while the flights are still far off may be nonsense: an inverse that is to
        change by more than a factor of four, or its sign, is given up for that of ``slope``.
        """
        moved = self._moved
        expected = ca.mtimes(inverse, change)
        denominator = ca.dot(moved, expected)
        size = ca.dot(moved, moved)
        tells = ca.logic_and(self._later, size > LEAST_MOVE * energy)
        believable = ca.logic_and(4 * denominator > size, denominator < 4 * size)
        safe = ca.if_else(believable, denominator, 1)
        row = ca.mtimes(moved.T, inverse)
        correction = ca.mtimes(moved - expected, row) / safe
        fresh = self._inverse_slope - inverse
        return inverse + ca.if_else(tells, ca.if_else(believable, correction, fresh), 0)
