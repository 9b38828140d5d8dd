"""What the numbers belong to: processor, system, versions."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import llvmlite.binding as llvm

_PACKAGES = ("numpy", "scipy", "casadi", "llvmlite")


def machine_facts(packages: Sequence[str] = ()) -> str:
    """Markdown list of the machine and of the versions of the packages that are installed."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    versions = [f"{name} {found}" for name in (*_PACKAGES, *packages)
                if (found := _version_of(name))]  # fmt: skip
    lines = [
        f"processor: {_processor()} (LLVM: {llvm.get_host_cpu_name()}), {cores} cores",
        f"system: {platform.system()} {platform.release()}, {platform.machine()}",
        f"Python {sys.version.split()[0]}, groupoid_gni {_version_of('groupoid-gni') or 'unknown'}",
        ", ".join(versions),
    ]
    return "\n".join(f"- {line}" for line in lines)


def _version_of(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
