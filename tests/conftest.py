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
