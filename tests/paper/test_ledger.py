"""docs/equations.md is complete, in order, and true: its paths import, its tests exist.

A row is ``| item | what it says | function(s) | test(s) |``. An item is an equation, ``(6)`` or
``(13a-e)``, a named statement, ``Theorem 5.2``, or words for an unnumbered display.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

TESTS = Path(__file__).parents[1]
PAGE = TESTS.parent / "docs" / "equations.md"

# The last letter of the equations that have parts, from the paper.
PARTS = {
    2: "b", 7: "b", 9: "b", 11: "b", 12: "b", 13: "e", 14: "e", 15: "e", 17: "b", 18: "b", 19: "b",
    20: "b", 22: "c", 23: "c", 26: "b", 27: "b", 28: "b", 30: "b", 33: "b", 37: "f", 38: "b",
    41: "b", 45: "b", 49: "b", 50: "b",
}
LAST_EQUATION = 54
STATEMENTS = [
    "Definition 4.1", "Remark 5.1", "Theorem 5.2", "Definition 5.3", "Theorem 5.4", "Remark 5.5",
    "Definition 6.1", "Definition 7.1", "Remark 7.2",
    "Figure 1", "Figure 2", "Figure 3", "Figure 4", "Definition 8.1", "Definition 8.2",
    "Definition 9.1", "Remark 9.2", "Lemma 9.3", "Lemma 9.4", "Lemma 9.5",
]

_EQUATION = re.compile(r"\((\d+)(?:([a-z])(?:-([a-z]))?)?\)")
_STATEMENT = re.compile(
    r"(Definition|Remark|Theorem|Proposition|Lemma|Corollary) \d+\.\d+|Figure \d+"
)
_QUOTED = re.compile(r"`([^`]*)`")


@dataclass(frozen=True)
class Row:
    """One row of the ledger."""

    item: str
    says: str
    functions: tuple[str, ...]
    tests: tuple[str, ...]


def quoted(cell: str) -> tuple[str, ...]:
    """The names of a cell; nothing else may stand between them but commas."""
    assert not _QUOTED.sub("", cell).replace(",", "").strip(), f"not in backquotes: {cell}"
    return tuple(_QUOTED.findall(cell))


@cache
def rows() -> tuple[Row, ...]:
    found = []
    for line in PAGE.read_text("utf-8").splitlines():
        if not line.startswith("|") or line.startswith(("| item |", "|---")):
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        assert len(cells) == 4, f"not four cells: {line}"
        found.append(Row(cells[0], cells[1], quoted(cells[2]), quoted(cells[3])))
    return tuple(found)


def equations(item: str) -> Iterator[str]:
    """The equations an item stands for, each part by itself: 13a, 13b, ..."""
    match = _EQUATION.fullmatch(item)
    if match is None:
        return
    number, first, last = match.groups()
    if first is None:
        yield number
        return
    for letter in range(ord(first), ord(last or first) + 1):
        yield number + chr(letter)


def all_equations() -> list[str]:
    """Every equation of the paper, part by part."""
    names = []
    for number in range(1, LAST_EQUATION + 1):
        last = PARTS.get(number)
        letters = [chr(c) for c in range(ord("a"), ord(last) + 1)] if last else [""]
        names.extend(f"{number}{letter}" for letter in letters)
    return names


def number_of(name: str) -> int:
    return int(re.sub(r"\D", "", name))


@cache
def listed_equations() -> tuple[str, ...]:
    return tuple(name for row in rows() for name in equations(row.item))


def test_every_numbered_equation_has_a_row() -> None:
    assert sorted(set(all_equations()) - set(listed_equations())) == []


def test_every_definition_remark_lemma_theorem_and_figure_has_a_row() -> None:
    assert sorted(set(STATEMENTS) - {row.item for row in rows()}) == []


def test_nothing_is_listed_twice_and_nothing_that_the_paper_has_not() -> None:
    items = [row.item for row in rows()]
    assert len(items) == len(set(items))
    listed = listed_equations()
    assert len(listed) == len(set(listed))
    assert sorted(set(listed) - set(all_equations())) == []
    named = {item for item in items if _STATEMENT.fullmatch(item)}
    assert sorted(named - set(STATEMENTS)) == []
    for item in items:
        known = _EQUATION.fullmatch(item) or _STATEMENT.fullmatch(item)
        assert known or item.startswith(("Section ", "Appendix")), f"what is '{item}'?"


def test_rows_come_in_the_order_of_the_paper() -> None:
    places = [number_of(name) for name in listed_equations()]
    assert places == sorted(places)
    order = [STATEMENTS.index(row.item) for row in rows() if row.item in STATEMENTS]
    assert order == sorted(order)


def resolve(path: str) -> Any:
    """The object a dotted path names: the longest module, then attributes.

    A function of an example, ``examples/file.py::function``, is looked up and not imported.
    """
    if "::" in path:
        file, name = path.split("::")
        assert file.startswith("examples/")
        assert name in names_of_functions(TESTS.parent / file), f"{path} does not exist"
        return name
    parts = path.split(".")
    assert parts[0] == "groupoid_gni", f"{path} is not in the library"
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for name in parts[length:]:
            found = getattr(found, name)
        return found
    raise AssertionError(path)


@cache
def names_of_functions(file: Path) -> frozenset[str]:
    tree = ast.parse(file.read_text("utf-8"))
    return frozenset(node.name for node in tree.body if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.item)
def test_paths_import_and_tests_exist(row: Row) -> None:
    assert row.says
    assert row.functions
    assert row.tests
    for path in row.functions:
        resolve(path)
    for test in row.tests:
        file, name = test.split("::")
        assert name.startswith("test_")
        assert name in names_of_functions(TESTS / file), f"{test} does not exist"


def test_the_errata_it_names_exist() -> None:
    errata = (PAGE.parent / "errata.md").read_text("utf-8")
    named = {number for row in rows() for number in re.findall(r"\bE(\d+)\b", row.says)}
    assert named
    assert named <= set(re.findall(r"^### (\d+)\. ", errata, re.MULTILINE))


def test_the_ledger_refuses_what_is_wrong() -> None:
    assert list(equations("(13a-e)")) == ["13a", "13b", "13c", "13d", "13e"]
    assert list(equations("Theorem 5.2")) == []
    assert len(all_equations()) == 94
    with pytest.raises(AttributeError):
        resolve("groupoid_gni.EulerC")
    with pytest.raises(AssertionError):
        resolve("examples/figures_of_the_paper.py::figure_5")
    with pytest.raises(AssertionError):
        quoted("`groupoid_gni.EulerA` and more")
    assert "test_nobody" not in names_of_functions(Path(__file__))
