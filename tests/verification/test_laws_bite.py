"""Laws with teeth: every broken object is caught, by the laws that should and by no others."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))
import broken_algebroids
import broken_conventions
import broken_flows
import broken_groupoids
import broken_methods
import broken_retractions
import broken_runs
import broken_systems
from broken import Broken

CATALOGUE: list[Broken] = [
    *broken_algebroids.BROKEN, *broken_conventions.BROKEN, *broken_flows.BROKEN,
    *broken_groupoids.BROKEN, *broken_methods.BROKEN,
    *broken_retractions.BROKEN, *broken_runs.BROKEN,
    *broken_systems.BROKEN,
]


@pytest.mark.parametrize("broken", CATALOGUE, ids=lambda b: b.mistake)
def test_broken_objects_are_caught_by_their_laws_and_no_others(broken: Broken) -> None:
    report = broken.check()
    assert {found.law.name for found in report.failures} == broken.caught_by, report
    assert all(found.counterexample is not None for found in report.failures)
