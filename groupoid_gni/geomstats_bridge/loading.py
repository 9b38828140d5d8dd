"""The one import of geomstats.

Takes a module name, gives the module; NumPy and the warning filters are left as they were found.
"""

from __future__ import annotations

import importlib
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import numpy as np

from groupoid_gni.errors import GNIError, InputError

_BACKEND = "geomstats.backend"
_REMOVED_NAME = "trapz"
_one_at_a_time = threading.RLock()


def geomstats_module(name: str = "geomstats") -> ModuleType:
    """Import a module of geomstats, also where a plain import fails.

    geomstats 2.8 does ``from numpy import trapz``, which NumPy 2.4 no longer has, and its loader
    warns. While it is imported for the first time the name stands for ``numpy.trapezoid`` and
    warnings are off; both are put back. Afterwards plain imports of geomstats work as well.

    Parameters
    ----------
    name : str
        Such as "geomstats.geometry.special_orthogonal".

    Returns
    -------
    module

    Raises
    ------
    InputError
        When ``name`` is no module of geomstats.
    GNIError
        When geomstats cannot be imported, with the command that installs it.
    """
    if not isinstance(name, str) or name.partition(".")[0] != "geomstats":
        raise InputError(
            f"geomstats_module({name!r}): write the full name of a module of geomstats, such as "
            f"'geomstats.geometry.special_orthogonal'."
        )
    with _one_at_a_time:
        if name in sys.modules and _BACKEND in sys.modules:
            return importlib.import_module(name)
        with _trapz_in_numpy(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _import(_BACKEND)
            return _import(name)


@contextmanager
def _trapz_in_numpy() -> Iterator[None]:
    missing = not hasattr(np, _REMOVED_NAME)
    if missing:
        setattr(np, _REMOVED_NAME, np.trapezoid)
    try:
        yield
    finally:
        if missing:
            delattr(np, _REMOVED_NAME)


def _import(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if name != _BACKEND and error.name is not None and name.startswith(error.name):
            raise InputError(
                f"geomstats_module({name!r}): the installed geomstats has no module "
                f"{error.name!r}. Check the name."
            ) from error
        raise _failure(name, error) from error
    except Exception as error:
        raise _failure(name, error) from error


def _failure(name: str, error: Exception) -> GNIError:
    missing = error.name if isinstance(error, ModuleNotFoundError) else None
    package = (missing or "geomstats").partition(".")[0]
    return GNIError(
        f"{name} cannot be imported: {type(error).__name__}: {error}. Install or renew it with\n"
        f"    {sys.executable} -m pip install --upgrade {package}\n"
        f"The rest of groupoid_gni works without it."
    )
