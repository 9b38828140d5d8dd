"""Hypothesis profiles: quick (the default, repeatable) and thorough (many examples, new each time).

At length: ``pytest --hypothesis-profile=thorough tests/verification/test_everything_shipped.py``.
"""

from __future__ import annotations

import hypothesis
import pytest

hypothesis.settings.register_profile("quick", max_examples=15, deadline=None, derandomize=True)
hypothesis.settings.register_profile("thorough", max_examples=200, deadline=None)
hypothesis.settings.load_profile("quick")


@pytest.fixture(scope="session")
def search_seed() -> int | None:
    """The seed of law checks: fixed, but fresh under the thorough profile."""
    return 0 if hypothesis.settings().derandomize else None


LONG_FILES = (
    "test_laws_bite", "test_method_run_laws", "test_method_equation_laws", "test_retraction_laws",
    "test_section_5", "test_section_6", "test_section_7",
)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of many short tests that are slow together."""
    for item in items:
        if item.path.stem in LONG_FILES:
            item.add_marker(pytest.mark.slow)
