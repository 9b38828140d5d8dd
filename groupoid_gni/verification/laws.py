"""Laws as data: a statement of mathematics, where it comes from, and how to measure its failure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groupoid_gni.errors import InputError
from groupoid_gni.verification.gaps import Gap

Draw = Callable[[Any], Any]
"""From a subject to the Hypothesis strategy of samples: dicts with the arguments of a law."""


@dataclass(frozen=True, eq=False)
class Law:
    """One law.

    name : its name, unique within the suite.
    group : "groupoid", "algebroid", "convention", "retraction", "appendix", "system", "method".
    statement : the law as mathematics.  context : what it is claimed for.
    source : definition, equation or lemma of the paper, or where else it comes from.
    draw : the samples it is tried on.
    gap : ``gap(subject, **sample)``, the two sides.
    tolerance, reason : the largest residual allowed, and why that much.
    share : part of the examples spent on it; below one for expensive laws.
    applies : why a subject is outside the law, or None.
    advisory : whether breaking it is worth a warning only.
    """

    name: str
    group: str
    statement: str
    context: str
    source: str
    draw: Draw
    gap: Callable[..., Gap]
    tolerance: float
    reason: str
    share: float
    applies: Callable[[Any], str | None]
    advisory: bool

    def __str__(self) -> str:
        return f"{self.statement}   for {self.context}   [{self.source}]"


def always(subject: Any) -> str | None:
    """No condition."""
    return None


def law(
    group: str,
    statement: str,
    context: str,
    source: str,
    *,
    draw: Draw,
    tolerance: float,
    reason: str,
    share: float = 1.0,
    applies: Callable[[Any], str | None] = always,
    advisory: bool = False,
) -> Callable[[Callable[..., Gap]], Law]:
    """Turn a function ``gap(subject, **sample) -> Gap`` into a Law of the same name."""
    if not (tolerance > 0.0 and 0.0 < share <= 1.0 and reason):
        raise InputError(
            f"the law '{statement}' needs a tolerance > 0 with its reason and a share in (0, 1]"
        )

    def make(measure: Callable[..., Gap]) -> Law:
        return Law(
            measure.__name__, group, statement, context, source, draw, measure,
            tolerance, reason, share, applies, advisory,
        )

    return make
