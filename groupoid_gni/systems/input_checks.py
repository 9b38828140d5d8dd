"""Checks that turn what a user passes into arrays, or say what is wrong with it."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from reprlib import repr as short
from typing import Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import GNIError, InputError
from groupoid_gni.groupoids import LieGroupoid, broken_law

BaseFunction = Callable[[Any, Any], Any]


def place(x: FloatArray) -> str:
    """The place a message speaks of, in words."""
    return f"at the base point {x}" if x.size else "at the only base point"


def check_space(space: Any) -> None:
    """The space must be a groupoid, and an instance of it."""
    if isinstance(space, type):
        raise InputError(
            f"space is the class {space.__name__}; pass an instance of it: {space.__name__}(...)"
        )
    if not isinstance(space, LieGroupoid):
        raise InputError(
            f"space must be a LieGroupoid, not {type(space).__name__}; a Lie group or "
            "PairGroupoid(n) will do, or subclass gni.LieGroupoid"
        )
    if type(space).__module__.startswith("groupoid_gni."):
        return
    try:
        law = broken_law(space)
    except GNIError:
        raise
    except Exception as error:
        raise InputError(
            f"a function of {type(space).__name__} failed on plain floats: "
            f"{type(error).__name__}: {error}"
        ) from error
    if law is not None:
        raise InputError(
            f"{type(space).__name__} is not a groupoid with a symmetric retraction: {law}. The "
            "seven functions and their laws are listed in the docstring of gni.LieGroupoid; "
            "gni.verification.check_groupoid(space) tries them all and shows the smallest example"
        )


def check_signature(name: str, function: BaseFunction) -> None:
    """A term takes the base point and the parameters."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None, None)
    except TypeError as error:
        raise InputError(
            f"{name} must take two arguments (x, p): the base point and the parameters; "
            f"its signature is {signature}"
        ) from error


def checked_control_size(controls: Any, force: Any) -> int:
    """The number of control inputs; they need a force to act through."""
    if isinstance(controls, bool) or not isinstance(controls, (int, np.integer)) or controls < 0:
        raise InputError(
            f"controls is the number of control inputs, a whole number from 0; got {controls!r}"
        )
    if controls and force is None:
        raise InputError("controls need a force(x, xi, p, u) that they act through")
    return int(controls)


def check_force_signature(force: Any, controls: int) -> None:
    """A force takes the base point, the velocity, the parameters and, if any, the inputs."""
    if not callable(force):
        raise InputError(
            "force must be a function (x, xi, p) or, with controls, (x, xi, p, u); for a constant "
            "one write force=lambda x, xi, p: np.array([...])"
        )
    try:
        signature = inspect.signature(force)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*[None] * (4 if controls else 3))
    except TypeError as error:
        wanted = "(x, xi, p, u): base point, velocity, parameters, control inputs"
        if not controls:
            wanted = (
                "(x, xi, p): base point, velocity, parameters; with control inputs u as a fourth, "
                "pass controls=their number too"
            )
        raise InputError(f"force must take {wanted}; its signature is {signature}") from error


def constant_function(constant: FloatArray) -> BaseFunction:
    """A term that is the same everywhere."""
    def constant_function(x: Any, p: Any) -> FloatArray:
        return constant

    return constant_function


def constant_array(name: str, given: ArrayLike, shape: tuple[int, ...] | None) -> FloatArray:
    """A constant term as a read-only array of the right shape."""
    constant = np.array(real_array(f"{name}, unless it is a function (x, p),", given))
    if not np.all(np.isfinite(constant)):
        raise InputError(f"{name} holds NaN or infinity:\n{constant}")
    if shape is not None and constant.shape != shape:
        raise InputError(f"{name} must have shape {shape}, got {constant.shape}")
    constant.setflags(write=False)
    return constant


def real_array(name: str, given: Any) -> FloatArray:
    """Real numbers of any kind as floats; text, complex, masked and ragged input is refused."""
    if isinstance(given, np.ma.MaskedArray) and np.ma.is_masked(given):
        raise InputError(f"{name} has masked entries; fill them first: array.filled(value)")
    try:
        array = np.asarray(given)
        if array.dtype.kind == "O":
            array = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must hold real numbers, got {short(given)}: {error}") from error
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name} must hold real numbers, got {array.dtype}: {short(given)}")
    return array.astype(float, copy=False)


def finite_vector(name: str, given: ArrayLike | None, size: int) -> FloatArray:
    """A finite real vector of the given length."""
    if given is None:
        raise InputError(f"{name} is missing; it needs {size} components")
    vector = np.array(real_array(name, given))
    if vector.shape != (size,):
        raise InputError(
            f"{name} must have shape ({size},), got {vector.shape}; components are ordered base "
            "part, then group part, rotations before translations"
        )
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise InputError(f"{name}[{bad[0]}] is {vector[bad[0]]}; every component must be finite")
    return vector
