"""What a deliberately broken object is: a mistake, and the laws that must catch it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from groupoid_gni.verification import LawReport

EXAMPLES = 25


@dataclass(frozen=True)
class Broken:
    """A mistake an author could make.

    check : runs the check on the broken object, with ``examples=EXAMPLES, on_fail="return"``.
    caught_by : exactly the laws that fail.
    """

    mistake: str
    check: Callable[[], LawReport]
    caught_by: frozenset[str]
