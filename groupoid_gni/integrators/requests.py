"""Checks of what ``integrate`` is asked for; every refusal says how to mend the request."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.integrators.methods import GNI, Method
from groupoid_gni.systems import MechanicalSystem, State, real_array
from groupoid_gni.trajectory import starting_arrow

_MEMORY_SHARE = 0.5


def checked_method(method: Method | None) -> Method:
    """The method as a value; ``GNI()`` when left out."""
    if method is None:
        return GNI()
    if isinstance(method, type):
        raise InputError(f"method is the class {method.__name__}; pass an instance of it: "
                         f"{method.__name__}()")
    if not isinstance(method, Method):
        raise InputError(
            f"method must be a value such as gni.GNI(), gni.Rattle() or gni.ReferenceFlow(), "
            f"not {method!r}"
        )
    try:
        hash(method)
    except TypeError as error:
        raise InputError(
            f"{type(method).__name__} cannot be hashed, but methods are keys of the compiled code: "
            "make it a frozen dataclass, @dataclass(frozen=True)"
        ) from error
    return method


def checked_step(step: float) -> float:
    """A finite step size that is not zero."""
    try:
        h = float(step)
    except (TypeError, ValueError) as error:
        raise InputError(f"step must be a number, got {step!r}") from error
    if not np.isfinite(h) or h == 0.0:
        raise InputError(f"step must be finite and not zero, got {step!r}")
    return h


def checked_count(h: float, t_end: float | None, n_steps: int | None) -> int:
    """The number of steps, from exactly one of ``t_end`` and ``n_steps``."""
    if (t_end is None) == (n_steps is None):
        raise InputError("give exactly one of t_end and n_steps")
    if n_steps is not None:
        return checked_whole("n_steps", n_steps, 0)
    try:
        end = float(t_end)  # type: ignore[arg-type]
    except (TypeError, ValueError) as error:
        raise InputError(f"t_end must be a number, got {t_end!r}") from error
    if not np.isfinite(end):
        raise InputError(f"t_end must be finite, got {t_end!r}")
    ratio = end / h
    if ratio < 0:
        raise InputError(f"t_end = {end} lies behind the start for step = {h}; change one sign")
    if not ratio < 2.0**53:
        raise InputError(f"step = {h} is too small for t_end = {end}: more than 2^53 steps")
    n = round(ratio)
    if abs(ratio - n) > 1e-6:
        raise InputError(
            f"t_end = {end} is not a whole number of steps of {h}: {ratio:.6g} steps. Use "
            f"step={end / max(n, 1):.17g} or n_steps={int(ratio)}"
        )
    return n


def checked_whole(name: str, value: Any, smallest: int) -> int:
    """A whole number from ``smallest`` up to 2^53."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole and not (isinstance(value, (float, np.floating)) and float(value).is_integer()):
        raise InputError(f"{name} must be a whole number, got {value!r}")
    if not smallest <= value < 2**53:
        raise InputError(f"{name} must be at least {smallest} and below 2^53, got {value!r}")
    return int(value)


def checked_start(system: MechanicalSystem, start: State) -> State:
    """The start, checked again with the current parameters of the system."""
    if not isinstance(start, State):
        raise InputError(
            f"start must be made with system.state(base, velocity), got {type(start).__name__}"
        )
    if start.base.shape != (system.space.base_size,) or (
        start.velocity.shape != (system.space.rank,)
    ):
        raise InputError(
            f"start belongs to another system: base {start.base.shape} and velocity "
            f"{start.velocity.shape}, this system needs ({system.space.base_size},) and "
            f"({system.space.rank},)"
        )
    # with_parameters may have changed metric and drift since the start was made
    return system.checked_again(start)


def checked_pose(
    system: MechanicalSystem, state: State, reconstruct: ArrayLike | bool | None
) -> FloatArray | None:
    """The arrow W_0 to accumulate from, or None."""
    if reconstruct is None or reconstruct is False:
        return None
    pose = None if reconstruct is True else reconstruct
    return starting_arrow(system.space, state.base, pose)


def checked_controls(
    system: MechanicalSystem, controls: ArrayLike | None, steps: int
) -> FloatArray | None:
    """The control inputs of all steps, (steps, inputs); None for a system without."""
    size = system.control_size
    if not size:
        if controls is not None:
            raise InputError(
                "this system has no control inputs; give it a force(x, xi, p, u) and controls=..."
            )
        return None
    if controls is None:
        raise InputError(
            f"this system has {size} control input(s): pass controls, shape ({steps}, {size}), or "
            f"({size},) for constant ones"
        )
    given = real_array("controls", controls)
    if given.shape == (size,):
        given = np.broadcast_to(given, (max(steps, 1), size))
    if given.ndim != 2 or given.shape[1] != size or len(given) < steps:
        raise InputError(
            f"controls must have shape ({steps}, {size}), one row for each step, or ({size},); got "
            f"{given.shape}"
        )
    if not np.all(np.isfinite(given)):
        step, entry = np.argwhere(~np.isfinite(given))[0]
        raise InputError(f"controls[{step}, {entry}] is {given[step, entry]}; it must be finite")
    return np.array(given)


def check_memory(rows: int, width: int) -> None:
    """Refuse a request whose result would not fit into memory."""
    needed = 8.0 * rows * width
    try:
        available = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_AVPHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        available = 8 * 2**30
    if needed > _MEMORY_SHARE * available:
        suggestion = int(np.ceil(needed / (0.05 * available)))
        raise InputError(
            f"saving {rows} nodes of {width} numbers takes {needed / 2**30:.1f} GiB and "
            f"{available / 2**30:.1f} GiB are free; use save_every={suggestion} or more"
        )
