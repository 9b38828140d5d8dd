"""What a check found: a table for reading, a dict for machines, HTML for notebooks."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from groupoid_gni.verification.laws import Law
from groupoid_gni.verification.search import Tally, Trial


class Verdict(Enum):
    """How a law ended."""

    PASSED = "passed"
    FAILED = "FAILED"
    EXPECTED = "failed as expected"
    WARNED = "warning"
    NOT_APPLICABLE = "does not apply"


@dataclass(frozen=True, eq=False)
class Finding:
    """One law on one subject.

    evaluations : how often the law was evaluated.  worst : the largest residual, None if never.
    counterexample : the smallest sample that broke it, with its numbers; None if none did.
    note : why it does not apply, or why the failure was expected.
    """

    law: Law
    verdict: Verdict
    evaluations: int
    worst: float | None
    counterexample: Trial | None
    note: str = ""

    def explain(self, subject: str) -> str:
        """The law with its numbers, for error messages."""
        lines = [
            f"{self.law.name} fails for {subject}",
            f"  law        {self.law.statement}",
            f"  for        {self.law.context}   [{self.law.source}]",
        ]
        trial = self.counterexample
        if trial is None:
            return "\n".join(lines)
        if trial.gap is None:
            lines.append(f"  raised     {trial.error}")
        else:
            lines.append(
                f"  residual   {trial.residual:.3g}, allowed {self.law.tolerance:.1g} "
                f"({self.law.reason})"
            )
        lines.extend(f"  at {name:<7} {_shown(value)}" for name, value in trial.sample.items())
        if trial.gap is not None:
            lines.append(f"  left       {_shown(trial.gap.left)}")
            lines.append(f"  right      {_shown(trial.gap.right)}")
        lines.append(
            f"  (smallest example found in {self.evaluations} evaluations; worst residual "
            f"{self.worst:.3g})"
        )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists."""
        trial = self.counterexample
        return {
            "law": self.law.name,
            "group": self.law.group,
            "statement": self.law.statement,
            "context": self.law.context,
            "source": self.law.source,
            "tolerance": self.law.tolerance,
            "verdict": self.verdict.value,
            "evaluations": self.evaluations,
            "worst": self.worst,
            "counterexample": None if trial is None else _plain(trial),
            "note": self.note,
        }


def finding(tally: Tally, expected: str | None) -> Finding:
    """The verdict on a tally; ``expected`` is the declared reason for a failure, if any."""
    verdict, note = Verdict.PASSED, ""
    if tally.smallest_failure is not None:
        verdict = Verdict.WARNED if tally.law.advisory else Verdict.FAILED
        if expected is not None:
            verdict, note = Verdict.EXPECTED, expected
    elif expected is not None:
        note = "expected to fail, but no failure was found"
    worst = None if tally.worst is None else tally.worst.residual
    return Finding(tally.law, verdict, tally.evaluations, worst, tally.smallest_failure, note)


@dataclass(frozen=True, eq=False)
class LawReport:
    """The findings of one check.

    subject : what was checked.  findings : one per law, in order.
    ``print(report)`` shows the table; ``report.failures`` the laws that broke.
    """

    subject: str
    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether no law failed (expected failures and warnings aside)."""
        return not self.failures

    @property
    def failures(self) -> tuple[Finding, ...]:
        """The laws that failed unexpectedly."""
        return self.having(Verdict.FAILED)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """The advisory laws that do not hold."""
        return self.having(Verdict.WARNED)

    @property
    def evaluations(self) -> int:
        """Number of evaluations of laws, all in all."""
        return sum(found.evaluations for found in self.findings)

    def having(self, verdict: Verdict) -> tuple[Finding, ...]:
        """The findings with a verdict."""
        return tuple(found for found in self.findings if found.verdict is verdict)

    def __getitem__(self, name: str) -> Finding:
        """The finding of a law by its name; KeyError if it was not tried."""
        for found in self.findings:
            if found.law.name == name:
                return found
        raise KeyError(f"no law {name!r} in this report; see [f.law.name for f in report.findings]")

    def explain(self) -> str:
        """Every broken law with its numbers."""
        broken = [*self.failures, *self.warnings]
        return "\n\n".join(found.explain(self.subject) for found in broken)

    def __str__(self) -> str:
        parts = [f"{self.subject}: {self.headline()}", self._table()]
        if broken := self.explain():
            parts.append(broken)
        return "\n\n".join(parts)

    __repr__ = __str__

    def headline(self) -> str:
        """One line: how many laws passed, failed, did not apply."""
        count = {verdict: len(self.having(verdict)) for verdict in Verdict}
        said = [f"{count[Verdict.PASSED]} laws hold"]
        if count[Verdict.FAILED]:
            said.append(f"{count[Verdict.FAILED]} FAILED")
        if count[Verdict.EXPECTED]:
            said.append(f"{count[Verdict.EXPECTED]} failed as expected")
        if count[Verdict.WARNED]:
            said.append(f"{count[Verdict.WARNED]} warnings")
        if count[Verdict.NOT_APPLICABLE]:
            said.append(f"{count[Verdict.NOT_APPLICABLE]} do not apply")
        first = f"; the first to fail: {self.failures[0].law.name}" if self.failures else ""
        return ", ".join(said) + f" ({self.evaluations} evaluations){first}"

    def _rows(self) -> list[tuple[str, str, str, str, str, str]]:
        return [
            (
                f.law.name,
                f.verdict.value,
                f"{f.worst:.1e}",
                f"{f.law.tolerance:.0e}",
                str(f.evaluations),
                f.note or f.law.statement,
            )
            for f in self.findings
            if f.verdict is not Verdict.NOT_APPLICABLE
        ]

    def _left_out(self) -> list[str]:
        """A line per reason, with the laws that do not apply for it."""
        reasons: dict[str, list[str]] = {}
        for found in self.having(Verdict.NOT_APPLICABLE):
            reasons.setdefault(found.note, []).append(found.law.name)
        return [f"does not apply, {why}: {', '.join(names)}" for why, names in reasons.items()]

    def _table(self) -> str:
        rows = [("law", "verdict", "worst", "allowed", "tried", "statement"), *self._rows()]
        widths = [max(len(row[i]) for row in rows) for i in range(5)]
        lines = []
        for row in rows:
            cells = [row[0].ljust(widths[0]), row[1].ljust(widths[1])]
            cells += [row[i].rjust(widths[i]) for i in (2, 3, 4)]
            lines.append("  ".join([*cells, row[5]]).rstrip())
        return "\n".join([*lines, *self._left_out()])

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON."""
        return {
            "subject": self.subject,
            "passed": self.passed,
            "evaluations": self.evaluations,
            "findings": [found.to_dict() for found in self.findings],
        }

    def _repr_html_(self) -> str:
        head = "".join(
            f"<th>{name}</th>"
            for name in ("law", "verdict", "worst", "allowed", "tried", "statement")
        )
        body = "".join(
            "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
            for row in self._rows()
        )
        left_out = "".join(f"<p>{html.escape(line)}</p>" for line in self._left_out())
        failed = f"<pre>{html.escape(self.explain())}</pre>" if self.explain() else ""
        title = html.escape(f"{self.subject}: {self.headline()}")
        return f"<p><b>{title}</b></p><table><tr>{head}</tr>{body}</table>{left_out}{failed}"


def merged(reports: Mapping[str, LawReport]) -> dict[str, dict[str, Finding]]:
    """The findings of several reports by law, then by the name given to the subject."""
    table: dict[str, dict[str, Finding]] = {}
    for name, report in reports.items():
        for found in report.findings:
            table.setdefault(found.law.name, {})[name] = found
    return table


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return np.array2string(
            value, separator=", ", max_line_width=100, prefix=" " * 13, threshold=60,
            floatmode="unique",
        )
    return repr(value)


def _plain(trial: Trial) -> dict[str, Any]:
    sides = {} if trial.gap is None else {
        "left": trial.gap.left.tolist(), "right": trial.gap.right.tolist(),
    }
    sample = {k: v.tolist() if isinstance(v, np.ndarray) else repr(v)
              for k, v in trial.sample.items()}
    residual = None if trial.gap is None else trial.residual
    return {"sample": sample, "residual": residual, "error": trial.error, **sides}
