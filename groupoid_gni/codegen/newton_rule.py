"""When Newton's iteration for a step is finished.

Residual times update, summed in absolute value and divided by the kinetic scale of the step, is the
square of a relative error e_k that does not depend on units. Where the iteration converges
quadratically, ``e_{k+1}`` is about ``e_k^3 / e_{k-1}^2``, elsewhere at most ``e_k^2 / e_{k-1}``;
it stops after the update that is predicted to leave less than round-off. What the current unknowns
leave in the next state, because it is not an expression of the updated ones, must be at round-off
by itself. The same numbers serve both runners.
"""

from __future__ import annotations

AT_ROUND_OFF = 1e-31
"""e_k^2 at which nothing can be gained."""

PREDICTED = 1e-32
"""Bound on the predicted next t = e^2: ``t_k^3 / t_{k-1}^2`` or ``t_k^2 / t_{k-1}``."""

BEFORE_FIRST = 1e-14
"""e^2 assumed before the first update: it suffices at e = 1e-10 (quadratic) or 3e-12."""

LEFT = 1e-27
"""Bound on the e^2 left in the normal part; the next state feels e times the step."""

STAGNATION = 0.06
"""A reduction of e^2 worse than this factor, below ``STAGNATION_LEVEL``, is round-off."""

STAGNATION_LEVEL = 1e-22
"""e^2 below which stagnation is accepted (ill-conditioned problems end there)."""

NO_GAIN = 0.5
"""A reduction of e^2 worse than this factor, below ``NO_GAIN_LEVEL``, is round-off as well, but
only after ``NO_GAIN_AFTER`` updates: one update of a quasi-Newton method may gain nothing and the
next gain much."""

NO_GAIN_LEVEL = 1e-17
"""e^2 below which no gain at all is accepted: forces at coordinates of size 1e5 and more are no
better than that."""

NO_GAIN_AFTER = 10
"""Updates of a stage that converges to round-off where it can are fewer."""

MAX_ITERATIONS = 30
"""Iterations before the step is given up."""

TINY = 1e-300
"""Keeps the quotient finite for a system at rest."""


def finished(now: float, last: float, left: float, quadratic: bool, updates: int) -> bool:
    """Whether the iteration may stop after the update with e^2 = ``now``, ``left`` in the state.

    updates : how many there were before this one.
    """
    predicted = now * now * now <= PREDICTED * last * last if quadratic else (
        now * now <= PREDICTED * last
    )
    return (
        now <= AT_ROUND_OFF
        or (predicted and left <= LEFT)
        or (now >= STAGNATION * last and now <= STAGNATION_LEVEL)
        or (updates >= NO_GAIN_AFTER and now >= NO_GAIN * last and now <= NO_GAIN_LEVEL)
    )
