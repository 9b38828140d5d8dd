"""The verification suite: the laws of groupoids, retractions, systems and methods, as a product.

``check_groupoid(G)``, ``check_retraction(G)``, ``check_system(system)`` and
``check_method(method, system)`` try every law on samples drawn by Hypothesis and return a
LawReport; the strategies are exported for tests of your own.
"""

from groupoid_gni.errors import BrokenLawError, BrokenLawWarning
from groupoid_gni.verification.checks import (
    check_groupoid,
    check_method,
    check_retraction,
    check_system,
)
from groupoid_gni.verification.gaps import Gap, arrow_gap, gap
from groupoid_gni.verification.geomstats_points import geomstats_points
from groupoid_gni.verification.laws import Law
from groupoid_gni.verification.parametrization import LawCase, law_cases, parametrize_with_laws
from groupoid_gni.verification.report import Finding, LawReport, Verdict
from groupoid_gni.verification.strategies import (
    algebroid_vectors,
    arrows,
    base_points,
    composable_pairs,
    composable_triples,
    states,
)

__all__ = [
    "BrokenLawError",
    "BrokenLawWarning",
    "Finding",
    "Gap",
    "Law",
    "LawCase",
    "LawReport",
    "Verdict",
    "algebroid_vectors",
    "arrow_gap",
    "arrows",
    "base_points",
    "check_groupoid",
    "check_method",
    "check_retraction",
    "check_system",
    "composable_pairs",
    "composable_triples",
    "gap",
    "geomstats_points",
    "law_cases",
    "parametrize_with_laws",
    "states",
]
