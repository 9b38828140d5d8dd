"""How far a stage lies from what the stages before it led to expect.

The first iteration of a stage measures e^2 of the unknowns that were extrapolated from the stages
before: the *surprise* q of the stage. It is tiny where the steps resolve the motion, and large
where they do not, or where the solution found belongs to another motion. Where the whole run is
coarse it is large everywhere, so that a surprise is recorded only where it stands out from those
before it:

    recorded if q > FACTOR usual and q > largest and energy > FAINT peak,
    usual <- q, but at most RISE times and at least usual / FALL.

In a composition the stages differ in size, and some are foretold a thousand times better than
others; the one that is foretold best is watched, once a step.

The same rule serves both runners: ``noted`` the interpreter, the rest the machine code, which
nearly never comes to ``next_largest``.
"""

from __future__ import annotations

from collections.abc import Sequence

from groupoid_gni.codegen.emitter import Emitter
from groupoid_gni.discretization.step_program import RECORD

PEAK, USUAL, LARGEST, WHERE, PRIMED = range(RECORD)
"""Entries of the record: largest energy, the q that is usual, largest q that stood out and the
number of its stage, first stage that is judged."""

FACTOR = 100.0
"""A q that much above the usual one stands out: its e is ten times as large."""

RISE, FALL = 1.2, 1.05
"""What the usual q follows by at most, from one stage watched to the next: a motion that becomes
faster than the steps resolve leaves it behind, one that is coarse throughout does not."""

FIRST = 1e-5
"""The usual q of the beginning."""

LEARNING = 50
"""Stages after a fresh guess that are not judged: the first are foretold badly, and the usual q has
still to be found."""

LEAST = 1e-6
"""Smallest usual q; so that no stage stands out with an e below 0.01."""

FAINT = 1e-4
"""Part of the largest energy below which a motion is too slow to surprise: where it turns round, or
has come to rest, relative errors mean little."""


def noted(
    record: Sequence[float], q: float, energy: float, stage: int, watched: bool
) -> list[float]:
    """The record after a stage with this number.

    q : e^2 of its first iteration.  energy : that of the last.
    """
    peak, usual, largest, where, primed = record
    peak = max(energy, peak)
    if watched:
        stands_out = q > max(FACTOR * usual, largest) and energy > FAINT * peak
        if stands_out and stage >= primed:
            largest, where = q, float(stage)
        usual = max(min(q, RISE * usual), usual / FALL, LEAST)
    return [peak, usual, largest, where, primed]


def stands_out(e: Emitter, usual: str, q: str) -> str:
    """Flags as instructions: q is far above the usual one."""
    return e.compare("ogt", q, e.binary("fmul", usual, e.pooled(FACTOR)))


def next_usual(e: Emitter, usual: str, q: str) -> str:
    """The entry USUAL after a stage that is watched."""
    high = e.binary("fmul", usual, e.pooled(RISE))
    low = e.binary("fmul", usual, e.pooled(1.0 / FALL))
    following = e.select(e.compare("olt", q, high), q, high)
    return larger(e, larger(e, following, low), e.pooled(LEAST))


def next_largest(
    e: Emitter, record: Sequence[str], q: str, energy: str, stage: str, flags: str
) -> list[str]:
    """The entries LARGEST and WHERE after a stage that stands out where ``flags`` say so.

    record : with the PEAK that includes this stage.  stage : its number, a double per lane.
    """
    peak, _, largest, where, primed = record
    for flag in (
        e.compare("ogt", energy, e.binary("fmul", peak, e.pooled(FAINT))),
        e.compare("ogt", q, largest),
        e.compare("oge", stage, primed),
    ):
        flags = e.assign(f"and {e.flag_type} {flags}, {flag}")
    return [e.select(flags, q, largest), e.select(flags, stage, where)]


def larger(e: Emitter, a: str, b: str) -> str:
    """``a > b ? a : b``: one instruction, and b where a is not a number."""
    return e.select(e.compare("ogt", a, b), a, b)
