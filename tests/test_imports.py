"""House rules that a machine can check: who imports whom, docstrings, lengths, no asserts."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import groupoid_gni

PACKAGE = Path(groupoid_gni.__file__).parent
# A module may import its own room and those before it. Rooms on one line do not see each other.
ORDER = [
    ["errors", "array_types", "outcomes"],
    ["expressions"],
    ["groupoids"],
    ["systems"],
    ["geomstats_bridge"],
    ["discretization", "scenes"],
    ["codegen"],
    ["trajectory"],
    ["integrators"],
    ["diagnostics"],
    ["plotting"],
    ["reports"],
    ["report"],
    ["verification"],
]
PLACE = {room: number for number, rooms in enumerate(ORDER) for room in rooms}
SCENES_MAY_USE = {"errors", "array_types", "groupoids", "systems", "scenes"}
# Convenience methods that look right, inside a function only.
LAZY = {
    ("trajectory", "plotting"),  # run.plot()
    ("trajectory", "diagnostics"),  # the moving energy in run.summary()
    ("systems", "integrators"),  # system.compiled(method)
}
HEAVY = ["scipy", "matplotlib", "hypothesis", "geomstats", "tqdm"]
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if "__pycache__" not in p.parts)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    return [*module.split("."), ""][1]


def names(path: Path) -> str:
    return name_of(path)


@cache
def imports_of(path: Path) -> list[tuple[str, bool]]:
    """(module, whether lazily) for every import; those under TYPE_CHECKING are left out."""
    found = []

    def walk(node: ast.AST, lazy: bool) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            return
        if isinstance(node, ast.Import):
            found.extend((alias.name, lazy) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in {path}"
            module = node.module or ""
            if module == "groupoid_gni":
                found.extend((f"groupoid_gni.{alias.name}", lazy) for alias in node.names)
            else:
                found.append((module, lazy))
        inside = isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for child in ast.iter_child_nodes(node):
            walk(child, lazy or inside)

    walk(tree_of(path), False)
    return found


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_imports_look_left_only(path: Path) -> None:
    here = room_of(name_of(path))
    if here == "":
        return  # the front door
    assert here in PLACE, f"the room {here} is not in the order"
    for module, lazy in imports_of(path):
        if not module.startswith("groupoid_gni"):
            continue
        there = room_of(module)
        if lazy and (here, there) in LAZY:
            continue
        assert there in PLACE, f"{name_of(path)} imports {module}"
        left = PLACE[there] < PLACE[here] or there == here
        assert left or PLACE[here] == PLACE[there] == 0, f"{name_of(path)} imports {module}"
        if here == "scenes":
            assert there in SCENES_MAY_USE, f"{name_of(path)} imports {module}"


def test_every_lazy_exception_is_still_needed() -> None:
    used = {
        (room_of(name_of(path)), room_of(module))
        for path in MODULES
        for module, lazy in imports_of(path)
        if lazy and module.startswith("groupoid_gni.")
    }
    assert used >= LAZY


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_nothing_imports_plotting_or_verification_at_module_level(path: Path) -> None:
    here = room_of(name_of(path))
    for module, lazy in imports_of(path):
        there = room_of(module) if module.startswith("groupoid_gni") else ""
        if there in ("plotting", "verification") and there != here and here != "verification":
            assert lazy, f"{name_of(path)} imports {module}"


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_heavy_packages_are_imported_lazily_or_in_their_own_room(path: Path) -> None:
    here = room_of(name_of(path))
    own = {"matplotlib": "plotting", "hypothesis": "verification"}
    for module, lazy in imports_of(path):
        top = module.split(".")[0]
        if top in HEAVY and own.get(top) != here:
            assert lazy, f"{name_of(path)} imports {module}"


def test_there_are_no_import_cycles_between_modules() -> None:
    known = {name_of(path): path for path in MODULES}

    def needed(path: Path) -> Iterator[str]:
        for module, lazy in imports_of(path):
            if not lazy and module in known and module != name_of(path):
                yield module

    state: dict[str, str] = {}

    def visit(module: str, trail: tuple[str, ...]) -> None:
        if state.get(module) == "done":
            return
        assert state.get(module) != "open", " -> ".join([*trail, module])
        state[module] = "open"
        for other in needed(known[module]):
            # a package's front door imports its modules; from inside the room that is no cycle
            inside = module.startswith(other + ".")
            if not inside:
                visit(other, (*trail, module))
        state[module] = "done"

    for module in known:
        visit(module, ())


def test_importing_the_library_imports_no_heavy_package() -> None:
    script = (
        "import sys, groupoid_gni; "
        f"print(*(name for name in {HEAVY!r} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True,
        cwd=PACKAGE.parent,
    )
    assert done.stdout.split() == []


def public(node: ast.AST, inside: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Public classes, functions and methods, with their dotted names."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        if child.name.startswith("_"):
            continue
        yield inside + child.name, child
        if isinstance(child, ast.ClassDef):
            yield from public(child, f"{inside}{child.name}.")


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_every_public_name_has_a_docstring(path: Path) -> None:
    assert ast.get_docstring(tree_of(path)), f"{path} has no module docstring"
    bare = [name for name, node in public(tree_of(path)) if not ast.get_docstring(node)]
    assert bare == []


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_no_function_is_longer_than_sixty_lines(path: Path) -> None:
    long = {}
    for node in ast.walk(tree_of(path)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            length = (node.end_lineno or 0) - node.lineno + 1
            docstring = node.body[0] if ast.get_docstring(node) else None
            if docstring is not None:
                length -= (docstring.end_lineno or 0) - docstring.lineno + 1
            if length > 60:
                long[node.name] = length
    assert long == {}


@pytest.mark.parametrize("path", MODULES, ids=names)
def test_library_code_has_no_assert_and_no_foreign_letters_in_names(path: Path) -> None:
    for node in ast.walk(tree_of(path)):
        assert not isinstance(node, ast.Assert), f"assert in line {node.lineno}"
        for field in ("name", "id", "arg", "attr"):
            name = getattr(node, field, None)
            assert not isinstance(name, str) or name.isascii(), name
