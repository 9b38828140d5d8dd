"""Reports: text, dict and HTML say the same."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.verification import LawReport, Verdict, check_groupoid


class Shifted(gni.PairGroupoid):
    """Its target is a little off."""

    def target(self, g: Any) -> Any:
        """Give the wrong point."""
        return super().target(g) + 1e-6


@pytest.fixture(scope="module")
def sound() -> LawReport:
    return check_groupoid(gni.PairGroupoid(2), examples=5)


@pytest.fixture(scope="module")
def broken() -> LawReport:
    return check_groupoid(Shifted(2), examples=5, on_fail="return")


def test_text(sound: LawReport, broken: LawReport) -> None:
    lines = str(sound).splitlines()
    assert lines[0].startswith("PairGroupoid(2): ")
    assert "laws hold" in lines[0]
    assert lines[2].split() == ["law", "verdict", "worst", "allowed", "tried", "statement"]
    tried = [f for f in sound.findings if f.verdict is not Verdict.NOT_APPLICABLE]
    assert all(f.evaluations for f in tried)
    table = [line for line in lines[3:] if not line.startswith("does not apply")]
    assert [line.split()[0] for line in table] == [f.law.name for f in tried]
    assert any("it is no LieGroup: product_order, " in line for line in lines)
    text = str(broken)
    assert "target_of_identity fails for" in text
    assert "beta(epsilon(x)) = x" in text
    assert "Definition 8.1" in text
    assert repr(broken) == text


def test_dict_is_plain_json(broken: LawReport) -> None:
    data = json.loads(json.dumps(broken.to_dict()))
    assert data["passed"] is False
    found = next(f for f in data["findings"] if f["law"] == "target_of_identity")
    assert found["verdict"] == "FAILED"
    assert found["counterexample"]["residual"] > found["tolerance"]
    assert set(found["counterexample"]["sample"]) == {"x"}
    assert data["evaluations"] == sum(f["evaluations"] for f in data["findings"])


def test_html_escapes(broken: LawReport) -> None:
    text = broken._repr_html_()
    tried = [f for f in broken.findings if f.verdict is not Verdict.NOT_APPLICABLE]
    assert text.count("<tr>") == 1 + len(tried)
    assert text.count("<p>does not apply") >= 1
    assert "&gt;" in text or "&#x27;" in text
    assert "<pre>" in text
    assert "<pre>" not in check_groupoid(gni.SO2(), examples=3)._repr_html_()


def test_findings_by_name_and_verdict(sound: LawReport, broken: LawReport) -> None:
    assert sound["associativity"].verdict is Verdict.PASSED
    assert sound.passed
    assert sound.failures == ()
    assert not broken.passed
    with pytest.raises(KeyError, match="no law 'commutativity'"):
        sound["commutativity"]


def test_reports_are_frozen(sound: LawReport) -> None:
    with pytest.raises(FrozenInstanceError):
        sound.subject = "another"  # type: ignore[misc]


def test_small_mistakes_show(broken: LawReport) -> None:
    worst = broken["target_of_identity"].worst
    assert worst is not None
    assert 1e-7 < worst < 1e-5
    sample = broken["target_of_identity"].counterexample
    assert sample is not None
    np.testing.assert_array_equal(sample.sample["x"], gni.PairGroupoid(2).example_base_point)
