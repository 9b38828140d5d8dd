"""LLVM IR to machine code, with a cache of object files on disk.

A broken or unwritable cache means compiling again, never failing. The environment variable
``GROUPOID_GNI_CACHE`` moves the cache, or switches it off when it is empty.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm

LARGE_PROGRAM = 5000
"""Operations above which code is cut into parts."""
_CACHE_VARIABLE = "GROUPOID_GNI_CACHE"


@cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


@cache
def _host() -> tuple[str, str]:
    _initialise()
    return llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


@cache
def machine_has_fused_products() -> bool:
    """Whether a multiply-add in one rounding is one instruction here."""
    return host_has("fma") or host_has("neon")


def host_has(feature: str) -> bool:
    """Whether the processor has a feature, by LLVM's name for it."""
    return f"+{feature}" in _host()[1].split(",")


def _cache_folder() -> Path | None:
    chosen = os.environ.get(_CACHE_VARIABLE)
    if chosen is not None:
        return Path(chosen) if chosen else None
    root = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(root) if root else Path.home() / ".cache") / "groupoid_gni"
    except RuntimeError:
        return None


def _key(ir: str, level: int) -> str:
    cpu, features = _host()
    parts = [ir, llvmlite.__version__, str(llvm.llvm_version_info), cpu, features, str(level)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _read(path: Path) -> bytes | None:
    """A cached object, unless it is damaged or not ours to trust."""
    try:
        if hasattr(os, "getuid") and path.stat().st_uid != os.getuid():
            return None
        content = path.read_bytes()
    except OSError:
        return None
    digest, code = content[:32], content[32:]
    return code if hashlib.sha256(code).digest() == digest else None


def _write(path: Path, code: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, name = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            os.replace(name, path)
        except OSError:
            Path(name).unlink(missing_ok=True)
    except OSError:
        return


def _optimisation_level(ir: str) -> int:
    # one function above this size compiles in seconds at level 2, in tenths at level 0
    longest = max(function.count("\n") for function in ir.split("\ndefine "))
    if longest > LARGE_PROGRAM:
        return 0
    # many short functions gain nothing at level 2
    return 1 if ir.count("\n") > LARGE_PROGRAM else 2


class MachineCode:
    """One compiled module.

    Attributes
    ----------
    source : str, the LLVM IR.
    from_cache : bool, whether the object file was found on disk.
    """

    def __init__(self, ir: str, *, cached: bool = True) -> None:
        """Compile IR text, or link its object file; ``cached=False`` compiles in any case."""
        self.source = ir
        cpu, features = _host()
        level = _optimisation_level(ir)
        self._target_machine = llvm.Target.from_default_triple().create_target_machine(
            cpu=cpu, features=features, opt=level, jit=True
        )
        folder = _cache_folder() if cached else None
        path = folder / (_key(ir, level) + ".o") if folder else None
        code = _read(path) if path else None
        self.from_cache = code is not None
        if code is None:
            code = self._compile()
            if path:
                _write(path, code)
        self._library = self._link(code)

    def _compile(self) -> bytes:
        module = llvm.parse_assembly(self.source)
        module.verify()
        return bytes(self._target_machine.emit_object(module))

    def _link(self, code: bytes) -> Any:
        self._engine = llvm.create_lljit_compiler(self._target_machine)
        builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
        for name in ("advance", "evaluate"):
            if f"@{name}(" in self.source:
                builder = builder.export_symbol(name)
        return builder.link(self._engine, f"groupoid_gni_{id(self)}")

    def function(self, name: str, *kinds: Any, returns: Any = None) -> Any:
        """A ctypes function for one of the module's entry points; it keeps the module alive."""
        entry = ctypes.CFUNCTYPE(returns, *kinds)(self._library[name])
        entry.machine_code = self  # type: ignore[attr-defined]
        return entry

    @property
    def assembly(self) -> str:
        """The machine code as assembly text."""
        return str(self._target_machine.emit_assembly(llvm.parse_assembly(self.source)))
