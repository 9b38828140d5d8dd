"""The cache of object files: found again, never trusted when damaged, never needed."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from groupoid_gni.codegen import MachineCode, field_ir


def module(factor: float = 1.7) -> str:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    return field_ir(ca.Function("f", [a, b], [factor * a - b]), 1, False)


def value(code: MachineCode) -> float:
    a, b, output = np.array([2.0]), np.array([0.4]), np.empty(1)
    function = code.function("evaluate", *[ctypes.c_void_p] * 3)
    function(a.ctypes.data, b.ctypes.data, output.ctypes.data)
    return float(output[0])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_second_time_the_object_is_read_from_disk(folder: Path) -> None:
    first, second = MachineCode(module()), MachineCode(module())
    assert (first.from_cache, second.from_cache) == (False, True)
    assert value(first) == value(second) == pytest.approx(3.0)
    assert len(list(folder.iterdir())) == 1


def test_other_text_is_another_object(folder: Path) -> None:
    MachineCode(module())
    other = MachineCode(module(-0.3))
    assert not other.from_cache
    assert value(other) == pytest.approx(-1.0)
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "text", "directory"])
def test_a_damaged_object_is_compiled_again(folder: Path, damage: str) -> None:
    MachineCode(module())
    (file,) = folder.iterdir()
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    spoiled = {"truncated": content[:100], "flipped": content, "empty": b"", "text": b"x" * 999}
    if damage == "directory":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes(spoiled[damage])
    again = MachineCode(module())
    assert not again.from_cache
    assert value(again) == pytest.approx(3.0)
    assert MachineCode(module()).from_cache == (damage != "directory")


def test_an_unusable_folder_means_compiling(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("GROUPOID_GNI_CACHE", str(tmp_path / "file" / "below"))
    for _ in range(2):
        code = MachineCode(module())
        assert not code.from_cache
        assert value(code) == pytest.approx(3.0)


def test_an_empty_variable_switches_the_cache_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")
    monkeypatch.chdir(tmp_path)
    assert not MachineCode(module()).from_cache
    assert not MachineCode(module()).from_cache
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners here")
def test_the_folder_is_private_and_nothing_is_left_behind(folder: Path) -> None:
    MachineCode(module())
    assert folder.stat().st_mode & 0o077 == 0
    assert all(file.suffix == ".o" for file in folder.iterdir())
