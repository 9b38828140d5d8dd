"""The table of hard cases: rows, verdicts, exit code. The cases have tests of their own."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "hard_cases")]

import hard_cases  # noqa: E402
from hard_case import HardCase, Verdict  # noqa: E402


def fails() -> Verdict:
    raise ValueError("no such thing\nat all")


CASES = [
    HardCase("one", "a |b|", "FIELD", "stays", lambda: Verdict("stayed", True)),
    HardCase("two", "hard", "FIELD", "stays", lambda: Verdict("went", False)),
    HardCase("three", "hard", "FIELD", "stays", fails),
    HardCase("four", "hard", "FIELD", "stays", lambda: Verdict("stayed", True), slow=True),
]


def test_the_table_shows_every_case_and_the_exit_code_counts_the_bad_ones(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(hard_cases.catalogue, "FAMILIES", {"Family": CASES})
    assert hard_cases.main(["--quick"]) == 2
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| case | why hard | expectation | result | verdict |"
    assert lines[1] == "| --- | --- | --- | --- | --- |"
    assert lines[2] == "| one | a \\|b\\| (FIELD) | stays | stayed | as expected |"
    assert lines[3].endswith("| went | **not as expected** |")
    assert lines[4].endswith("| ValueError: no such thing | **not as expected** |")
    assert lines[6].startswith("1 of 3 cases as expected, ")
    assert hard_cases.main([]) == 2
    assert "| four |" in capsys.readouterr().out
