"""The pages of docs/ that hold code are executed, and print what they say they print."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(page for page in DOCS.glob("*.md") if "```python" in page.read_text("utf-8"))
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?|[-+]?\.\d+")


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """(code, what it prints) for every Python block."""
    parts = re.split(r"^```(\w*)\n(.*?)^```$", page.read_text("utf-8"), flags=re.M | re.S)
    texts, languages, bodies = parts[0::3], parts[1::3], parts[2::3]
    for i, language in enumerate(languages):
        if language != "python":
            continue
        printed = ""
        if i + 1 < len(languages) and languages[i + 1] == "text" and not texts[i + 1].strip():
            printed = bodies[i + 1]
        yield bodies[i], printed


def assert_same_print(said: str, printed: str) -> None:
    """Words are the same; numbers agree to four digits, counts of evaluations are not compared."""
    said_lines, printed_lines = said.strip().splitlines(), printed.strip().splitlines()
    assert len(said_lines) == len(printed_lines), printed
    for ours, theirs in zip(said_lines, printed_lines, strict=True):
        assert NUMBER.sub("#", ours).split() == NUMBER.sub("#", theirs).split(), printed
        if "evaluations" in ours:
            continue
        numbers = [[float(n) for n in NUMBER.findall(line)] for line in (ours, theirs)]
        np.testing.assert_allclose(*numbers, rtol=1e-4, atol=1e-12)


def test_there_are_pages_with_code() -> None:
    assert "write_your_own_groupoid.md" in [page.name for page in PAGES]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_prints_what_it_says(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    capsys.readouterr()
    for code, said in blocks(page):
        exec(compile(code, page.name, "exec"), names)
        assert_same_print(said, capsys.readouterr().out)


def test_the_comparison_bites() -> None:
    assert_same_print("residual 0.05884, a\n", "residual  0.058841, a")
    for other in ("residual 0.0589, a", "residual 0.05884, b", "residual 0.05884, a\nmore"):
        with pytest.raises(AssertionError):
            assert_same_print("residual 0.05884, a", other)
