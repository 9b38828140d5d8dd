"""Why a user's function could not be recorded: where, what, and the mend.

Takes the exception that came out of the function, gives the text of a RecordingError; decides
nothing and runs nothing of the user's.
"""

from __future__ import annotations

import functools
import inspect
import linecache
import os
import re
import traceback
from collections.abc import Callable
from types import FrameType
from typing import Any, Final

import casadi
import numpy as np

from groupoid_gni.errors import GNIError

__all__ = ["explain", "location"]

_HERE: Final = os.path.dirname(os.path.abspath(__file__))
_LIBRARY: Final = os.path.dirname(_HERE)
_NUMERICAL: Final = (
    os.path.dirname(os.path.abspath(np.__file__)),
    os.path.dirname(os.path.abspath(casadi.__file__)),
)
_SCIPY: Final = f"{os.sep}scipy{os.sep}"
# What the math module calls differently from NumPy.
_NUMPY_NAMES: Final = {
    "acos": "arccos", "acosh": "arccosh", "asin": "arcsin", "asinh": "arcsinh", "atan": "arctan",
    "atan2": "arctan2", "atanh": "arctanh", "pow": "power", "fsum": "sum", "dist": "linalg.norm",
}  # fmt: skip
_ITEM_ASSIGNMENT: Final = re.compile(r"\]\s*(\+|-|\*|/|@|\*\*|//|%)?=(?!=)")
_BRANCH: Final = re.compile(r"\b(if|elif|while|and|or|not|assert|max|min|sorted)\b")


def location(function: Callable[..., Any]) -> str:
    """Give "file:line" of a function's definition, or its representation if it has none."""
    while isinstance(function, functools.partial):
        function = function.func
    function = inspect.unwrap(function)
    # The class, not the object, says how an object is called.
    method = vars(type(function)).get("__call__")
    code = getattr(function, "__code__", None) or getattr(method, "__code__", None)
    return repr(function) if code is None else f"{code.co_filename}:{code.co_firstlineno}"


def _is_below(filename: str, *folders: str) -> bool:
    return any(filename.startswith(folder + os.sep) for folder in folders)


def _failing_frame(error: BaseException) -> tuple[FrameType, int] | None:
    """Find the innermost frame of the user; of this library outside this room if there is none."""
    frames = [
        (frame, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not _is_below(frame.f_code.co_filename, _HERE, *_NUMERICAL)
        and _SCIPY not in frame.f_code.co_filename
        and not frame.f_code.co_filename.startswith("<__array_function__")
    ]
    users = [pair for pair in frames if not _is_below(pair[0].f_code.co_filename, _LIBRARY)]
    innermost = users or frames
    return innermost[-1] if innermost else None


def _math_function(source: str, frame: FrameType) -> str | None:
    """Name the function of Python's math module that a source line calls, if there is one."""
    for called in re.findall(r"([A-Za-z_][\w.]*)\s*\(", source):
        first, *rest = called.split(".")
        found = frame.f_locals.get(first, frame.f_globals.get(first))
        for attribute in rest:
            found = getattr(found, attribute, None)
        if getattr(found, "__module__", None) == "math":
            return str(getattr(found, "__name__", called))
    return None


def _mend(error: BaseException, source: str, frame: FrameType | None) -> str:
    """Advise on the commonest causes, the surest sign first."""
    text = str(error)
    if "read-only" in text:
        return "Do not change an argument in place; work on a copy: x = x.copy()."
    if any(_SCIPY in f.f_code.co_filename for f, _ in traceback.walk_tb(error.__traceback__)):
        return "SciPy cannot be recorded. Use group.exp, or gni.array arithmetic."
    called = None if frame is None else _math_function(source, frame)
    if called is not None:
        return f"Use np.{_NUMPY_NAMES.get(called, called)} in place of math.{called}."
    wants_number = "is not a float" in text or "float array" in text or "with a sequence" in text
    if wants_number and _ITEM_ASSIGNMENT.search(source):
        return "Build the array with gni.array([...]), or start from np.zeros_like(x)."
    if "linalg." in source and "recorded" not in text:
        return "Build the matrix with gni.array([...]) in place of np.array([...])."
    if "used as indices" in text or "valid indices" in text:
        return "Masks cannot be recorded. Use gni.where(condition, a, b)."
    if "has no truth value" in text and not _BRANCH.search(source):
        return "If the array is a fresh np.array([...]), build it with gni.array([...])."
    if isinstance(error, TypeError) and ("ufunc" in text or "has no callable" in text):
        return "Build the array with gni.array([...]) in place of np.array([...])."
    return ""


def explain(name: str, function: Callable[..., Any], error: BaseException) -> str:
    """Say where a function stopped while it was being recorded, what happened, and the mend.

    name : what the function is to the user, such as "metric".
    error : the exception, with its traceback.
    """
    found = _failing_frame(error)
    kind = "" if isinstance(error, GNIError) else f"{type(error).__name__}: "
    if found is None:
        place, source, frame = location(function), "", None
    else:
        frame, line = found
        filename = frame.f_code.co_filename
        place = f"{filename}:{line}"
        source = linecache.getline(filename, line, frame.f_globals).strip()
    lines = [f"{name} cannot be recorded; it stopped at {place}"]
    if source:
        lines.append(f"    {source}")
    lines.append(f"  What happened: {kind}{error}")
    mend = _mend(error, source, frame)
    if mend:
        lines.append(f"  Mend: {mend}")
    return "\n".join(lines)
