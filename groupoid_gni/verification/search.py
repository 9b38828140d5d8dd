"""Try laws on many samples, and make a failing sample small: the engine, run by Hypothesis."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import hypothesis
import numpy as np
from hypothesis import HealthCheck, Phase

from groupoid_gni.verification.gaps import Gap
from groupoid_gni.verification.laws import Law

_FEWEST = 3  # Hypothesis starts with the simplest sample, at which many a wrong law holds
_SHRINK_SECONDS = 1.0
_IN_FULL = 2  # laws per group whose failure is shrunk that long; the others mostly follow from them
_IN_BRIEF = 0.1  # part of that time for the others
_PHASES = (Phase.generate, Phase.shrink)


@dataclass(frozen=True, eq=False)
class Trial:
    """A law evaluated at one sample; ``error`` says what was raised instead of a gap."""

    sample: dict[str, Any]
    gap: Gap | None
    error: str = ""

    @property
    def residual(self) -> float:
        """The residual; infinite when something was raised or is not a number."""
        if self.gap is None or np.isnan(self.gap.residual):
            return float("inf")
        return self.gap.residual


@dataclass
class Tally:
    """What is known of one law: how often it was evaluated, its worst and its smallest failure."""

    law: Law
    evaluations: int = 0
    worst: Trial | None = None
    smallest_failure: Trial | None = None

    def add(self, trial: Trial) -> bool:
        """Count a trial; tell whether it broke the law."""
        self.evaluations += 1
        if self.worst is None or trial.residual > self.worst.residual:
            self.worst = trial
        broken = not trial.residual <= self.law.tolerance
        if broken:
            self.smallest_failure = trial
        return broken


def evaluate(law: Law, subject: Any, sample: dict[str, Any]) -> Trial:
    """The gap of a law at one sample; whatever a subject raises counts against the law."""
    copies = {k: v.copy() if isinstance(v, np.ndarray) else v for k, v in sample.items()}
    try:
        with np.errstate(all="ignore"):
            return Trial(sample, law.gap(subject, **copies))
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{last.name}, line {last.lineno}"
        return Trial(sample, None, f"{type(error).__name__} in {where}: {error}")


def survey(
    subject: Any, laws: Sequence[Law], examples: int, seed: int | None
) -> dict[str, Tally]:
    """Evaluate laws on shared samples, then shrink a failure of each law that broke.

    examples : samples per law, times the share of the law.
    seed : of the search; None for a fresh one.
    """
    tallies = {law.name: Tally(law) for law in laws}
    batches: dict[Any, list[Law]] = {}
    for law in laws:
        batches.setdefault((law.draw, law.share), []).append(law)
    for (draw, share), batch in batches.items():
        count = max(_FEWEST, ceil(examples * share))
        strategy = draw(subject)

        def try_all(sample: dict[str, Any], batch: list[Law] = batch) -> None:
            for law in batch:
                tallies[law.name].add(evaluate(law, subject, sample))

        _search(strategy, try_all, count, seed)
    broken = [law for law in laws if tallies[law.name].smallest_failure is not None]
    for place, law in enumerate(broken):
        seconds = _SHRINK_SECONDS * (1.0 if place < _IN_FULL else _IN_BRIEF)
        count = max(_FEWEST, ceil(examples * law.share))
        _shrink(subject, tallies[law.name], law.draw(subject), (count, seed, seconds))
    return tallies


class _Broken(Exception):  # noqa: N818 (never leaves this file)
    """Raised inside Hypothesis so that it shrinks."""


class _Enough(BaseException):
    """Raised inside Hypothesis so that it stops at once, as by Ctrl-C."""


def _shrink(
    subject: Any, tally: Tally, strategy: Any, limits: tuple[int, int | None, float]
) -> None:
    count, seed, seconds = limits
    began = time.monotonic()

    def try_one(sample: dict[str, Any]) -> None:
        if time.monotonic() - began > seconds:
            raise _Enough
        if tally.add(evaluate(tally.law, subject, sample)):
            raise _Broken

    try:
        _search(strategy, try_one, count, seed)
    except (_Broken, _Enough, hypothesis.errors.HypothesisException, ExceptionGroup):
        return  # the last failure seen is the smallest one found


def _search(
    strategy: Any, body: Callable[[dict[str, Any]], None], count: int, seed: int | None
) -> None:
    @hypothesis.settings(
        max_examples=count,
        database=None,
        deadline=None,
        derandomize=False,
        phases=_PHASES,
        report_multiple_bugs=False,
        print_blob=False,
        verbosity=hypothesis.Verbosity.quiet,
        suppress_health_check=list(HealthCheck),
    )
    @hypothesis.given(strategy)
    def search(sample: dict[str, Any]) -> None:
        body(sample)

    with np.errstate(all="ignore"):  # samples are drawn with functions of the subject
        (search if seed is None else hypothesis.seed(seed)(search))()
