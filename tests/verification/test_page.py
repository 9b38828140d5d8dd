"""The page of all laws: what its cells say, and that the one in docs/ is about these laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import groupoid_gni as gni
from groupoid_gni.plotting import plot_laws
from groupoid_gni.verification import LawReport, check_groupoid
from groupoid_gni.verification.__main__ import cell, page, panels
from groupoid_gni.verification.algebroid_laws import ALGEBROID_LAWS
from groupoid_gni.verification.appendix_laws import APPENDIX_LAWS
from groupoid_gni.verification.convention_laws import CONVENTION_LAWS
from groupoid_gni.verification.groupoid_laws import GROUPOID_LAWS
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.retraction_laws import RETRACTION_LAWS
from groupoid_gni.verification.system_laws import SYSTEM_LAWS

PAGE = Path(__file__).parents[2] / "docs" / "verified_laws.md"


class Shifted(gni.PairGroupoid):
    """Its target is a little off."""

    def target(self, g: Any) -> Any:
        """Give the wrong point."""
        return super().target(g) + 1e-6


def table_of(**reports: LawReport) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for name, report in reports.items():
        for found in report.findings:
            table.setdefault(found.law.name, {})[name] = [found]
    return table


def test_cells_tables_and_panels() -> None:
    sound = check_groupoid(gni.SO2(), examples=2)
    broken = check_groupoid(Shifted(2), examples=2, on_fail="return")
    assert cell([sound["source_of_identity"]]) == "·"
    assert cell([broken["target_of_identity"]]).startswith("**")
    found = {"Groupoids": table_of(circle=sound, shifted=broken)}
    text = page(found, 2)
    assert f"{len(broken.failures)} broken" in text
    assert "| law | circle | shifted | allowed |" in text
    laws, objects, ratios = panels(found)["Groupoids"]
    assert objects == ["circle", "shifted"]
    assert ratios[laws.index("target_of_identity"), 1] > 1e3
    assert np.isnan(ratios[laws.index("target_of_identity"), 0])
    assert plot_laws(panels(found)).axes


def test_the_page_in_docs_knows_every_law_and_none_is_broken() -> None:
    text = PAGE.read_text("utf-8")
    laws = (
        *GROUPOID_LAWS, *ALGEBROID_LAWS, *CONVENTION_LAWS, *RETRACTION_LAWS, *APPENDIX_LAWS,
        *SYSTEM_LAWS, *METHOD_EQUATION_LAWS, *METHOD_RUN_LAWS, *METHOD_FLOW_LAWS,
    )
    assert len({law.name for law in laws}) == len(laws)
    assert f"{len(laws)} laws, " in text
    for law in laws:
        assert f"- **{law.name}**: `{law.statement}`" in text, law.name
    assert ", 0 broken." in text
