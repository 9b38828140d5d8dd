"""The four checks: one line, and a user knows which law an object breaks."""

from __future__ import annotations

from collections.abc import Mapping

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import LieGroup, LieGroupoid
from groupoid_gni.verification.groupoid_laws import GROUPOID_LAWS
from groupoid_gni.verification.judging import OnFail, check_laws
from groupoid_gni.verification.report import LawReport


def check_groupoid(
    space: LieGroupoid,
    *,
    on_fail: OnFail = "raise",
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> LawReport:
    """Check definition 8.1, the algebroid, and for a Lie group the conventions of this library.

    on_fail : "raise" BrokenLawError, "warn" BrokenLawWarning, or only "return" the report.
    expected_failures : {law: reason} for laws known to fail.
    examples : samples per law; those of the active Hypothesis profile when left out (100 unless
        changed).
    seed : of the search; None searches afresh every time.
    Raises InputError for arguments that make no sense, BrokenLawError see ``on_fail``.
    """
    if not isinstance(space, LieGroupoid):
        raise InputError(f"check_groupoid takes a LieGroupoid, not {type(space).__name__}")
    return check_laws(
        repr(space), {"groupoid": space}, GROUPOID_LAWS,
        on_fail=on_fail, expected_failures=expected_failures, examples=examples, seed=seed,
    )
