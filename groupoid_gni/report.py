"""``python -m groupoid_gni.report``: everything measured, as a page with figures.

Writes ``measured_results.md``, ``figures/measured_*.png`` and ``measured/*.md`` (every setting)
into a folder (docs/ by default).
Peers are those of ``tests/benchmarks/report_peers.py`` where the sources are checked out.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import Any

from groupoid_gni.errors import InputError
from groupoid_gni.reports.page import write_report

_PEERS = Path(__file__).resolve().parents[1] / "tests" / "benchmarks" / "report_peers.py"


def comparisons_from(path: Path) -> Any:
    """What ``comparisons()`` of a Python file gives; None where there is no such file.

    Raises InputError for a file without that function.
    """
    if not path.exists():
        return None
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    if not hasattr(module, "comparisons"):
        raise InputError(f"{path} must have a function comparisons() -> reports.Comparisons")
    return module.comparisons()


def main(arguments: list[str] | None = None) -> int:
    """Measure and write."""
    parser = argparse.ArgumentParser(prog="python -m groupoid_gni.report", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="under three minutes, for a look")
    parser.add_argument("--output", type=Path, default=Path("docs"), help="folder (docs)")
    parser.add_argument("--scenes", nargs="*", help="only these, and only what is about them")
    parser.add_argument("--peers", type=Path, default=_PEERS, help="Python file with the peers")
    parser.add_argument("--no-peers", action="store_true", help="leave them out")
    given = parser.parse_args(arguments)
    comparisons = None if given.no_peers else comparisons_from(given.peers)
    page = write_report(
        given.output, quick=given.quick, scenes=given.scenes or None, comparisons=comparisons
    )
    print(f"wrote {page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
