"""How an integration can end, as numbers and as sentences."""

from __future__ import annotations

from enum import IntEnum


class Outcome(IntEnum):
    """Outcome codes; zero and above are not failures. Stable: they are stored in files."""

    SUCCESS = 0
    INTERRUPTED = 2
    NEWTON_FAILED = -1
    CONSTRAINTS_SINGULAR = -4
    NOT_FINITE = -5
    LEFT_DOMAIN = -6
    CONSTRAINT_LOST = -7
    ADAPTIVE_STEP_FAILED = -8
    METRIC_INDEFINITE = -9
    LEFT_BASE = -10
    PROJECTION_SINGULAR = -11
    START_REFUSED = -12

    @property
    def sentence(self) -> str:
        """What happened and the usual mend."""
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.SUCCESS: "The end of the interval was reached.",
    Outcome.INTERRUPTED: "Interrupted by the user; the part computed so far is kept.",
    Outcome.NEWTON_FAILED: (
        "Newton's method for the next arrow did not converge. Usual mend: a smaller step."
    ),
    Outcome.CONSTRAINTS_SINGULAR: (
        "The constraints became dependent: C = mu G^-1 mu^T is singular at a node, or the rows "
        "turned over between two nodes. Usual mend: leave out the redundant row, or stop before "
        "the point where the distribution changes its rank; where the condition numbers are "
        "moderate the rows turn by more than a quarter turn per step: use a smaller step."
    ),
    Outcome.NOT_FINITE: (
        "The state became infinite or NaN. Usual mend: a smaller step, or look for a singularity "
        "of the metric or the potential near the last good point."
    ),
    Outcome.LEFT_DOMAIN: (
        "The motion of one step leaves the domain of the retraction: about half a turn or more "
        "per step. Usual mend: a smaller step."
    ),
    Outcome.CONSTRAINT_LOST: (
        "A constraint row that was left out as dependent at the start is violated now: the rank "
        "of the distribution has changed. Usual mend: start at a point of full rank."
    ),
    Outcome.ADAPTIVE_STEP_FAILED: (
        "The adaptive reference method could not go on. Usual mend: look for a singularity near "
        "the last good point, or loosen rtol."
    ),
    Outcome.LEFT_BASE: (
        "The base point has drifted off the base manifold. Usual mend: give the groupoid a "
        "restore_base(x) that brings nearby points back, or check that target(retract(x, xi)) "
        "stays on it."
    ),
    Outcome.PROJECTION_SINGULAR: (
        "The equation for the normal momentum that a projected step lends and takes back has "
        "become singular: the parasitic multiplier of the bare step has reached +1. Usual mend: a "
        "smaller step."
    ),
    Outcome.START_REFUSED: "The start of this member was refused.",
    Outcome.METRIC_INDEFINITE: (
        "The metric is no longer positive definite. Usual mend: stop before that point, or look "
        "for a coordinate in which the inertia does not vanish."
    ),
}
