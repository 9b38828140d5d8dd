"""Every law on everything shipped, with as many samples as the Hypothesis profile asks for.

At length: ``pytest --hypothesis-profile=thorough tests/verification/test_everything_shipped.py``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import pytest

import groupoid_gni as gni
from groupoid_gni.verification import (
    BrokenLawWarning,
    LawReport,
    Verdict,
    catalogue,
    check_groupoid,
    check_method,
    check_retraction,
    check_system,
)

SPACES = {
    f"{name}, {variant}": space
    for name, variants in {**catalogue.groups(), **catalogue.groupoids()}.items()
    for variant, space in variants.items()
}
SYSTEMS = catalogue.systems_for_methods()
FEW = catalogue.methods_on_few_systems()
METHODS = {**catalogue.methods(), **{name: method for name, (method, _) in FEW.items()}}
PAIRS = [
    *[(method, system) for method in catalogue.methods() for system in SYSTEMS],
    *[(method, system) for method, (_, systems) in FEW.items() for system in systems],
]

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BrokenLawWarning)  # the robot's heading is integrable
        yield


def assert_all_hold(report: LawReport) -> None:
    assert report.passed
    for found in report.findings:
        assert (found.evaluations > 0) is (found.verdict is not Verdict.NOT_APPLICABLE)


@pytest.mark.parametrize("name", SPACES)
def test_groupoids_and_retractions(name: str, search_seed: int | None) -> None:
    assert_all_hold(check_groupoid(SPACES[name], seed=search_seed))
    assert_all_hold(check_retraction(SPACES[name], seed=search_seed))


@pytest.mark.parametrize("name", SYSTEMS)
def test_systems(name: str, search_seed: int | None) -> None:
    assert_all_hold(check_system(SYSTEMS[name][0], seed=search_seed))


@pytest.mark.parametrize(("method", "system"), PAIRS)
def test_methods(method: str, system: str, search_seed: int | None) -> None:
    body, symmetries = SYSTEMS[system]
    report = check_method(METHODS[method], body, symmetries=symmetries, seed=search_seed)
    assert_all_hold(report)


def test_every_law_applies_to_something_shipped() -> None:
    some = {name.split(",")[0]: space for name, space in SPACES.items()}.values()
    reports = [check_groupoid(space, examples=1) for space in some]
    reports += [check_retraction(space, examples=1) for space in (*some, gni.SO3())]
    reports += [check_system(system, examples=1) for system, _ in SYSTEMS.values()]
    reports += [
        check_method(METHODS[method], *SYSTEMS[system][:1], symmetries=SYSTEMS[system][1],
                     examples=1)
        for method, system in [
            *[(method, system) for method in ("RATTLE", "GNI")
              for system in ("rolling ball", "sphere, any D", "springs, any D")],
            ("GNI 6, energy", "springs, any D"), ("GNI, bare", "springs, any D"),
        ]
    ]
    tried: dict[str, int] = {}
    for report in reports:
        for found in report.findings:
            tried[found.law.name] = tried.get(found.law.name, 0) + found.evaluations
    assert [law for law, count in tried.items() if not count] == []
