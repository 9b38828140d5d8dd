"""The guarded import: what it leaves behind, what it says when it fails."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.geomstats_bridge import geomstats_module, loading

OLD_NAME = "trapz"

SCRIPT = """
import sys, threading, warnings
import numpy as np
from groupoid_gni.geomstats_bridge import geomstats_module

def state():
    return (hasattr(np, "trapz"), np.random.get_state()[1].tolist(), list(warnings.filters),
            np.geterr(), np.get_printoptions())

assert "geomstats" not in sys.modules
if not hasattr(np, "trapz"):
    try:
        import geomstats.backend
    except ImportError as error:
        assert "trapz" in str(error)
warnings.simplefilter("error")
before, names = state(), ["lie_group", "special_orthogonal", "special_euclidean", "hypersphere"]
found = []
def load(name):
    found.append(geomstats_module("geomstats.geometry." + name).__name__)
threads = [threading.Thread(target=load, args=(name,)) for name in names]
for thread in threads: thread.start()
for thread in threads: thread.join()
assert sorted(name.split(".")[-1] for name in found) == sorted(names), found
assert state() == before
import geomstats.geometry.spd_matrices
from geomstats.learning.frechet_mean import FrechetMean
print(geomstats_module().__name__, geomstats_module("geomstats.learning.kmeans").__name__)
"""


def test_a_first_import_leaves_everything_as_it_was() -> None:
    """After a plain import has failed, with warnings as errors, from four threads at once."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True,
        cwd=Path(gni.__file__).parents[1],
    )
    assert done.stderr == ""
    assert done.stdout.split() == ["geomstats", "geomstats.learning.kmeans"]


def test_nothing_is_left_in_this_process() -> None:
    random = np.random.get_state()[1].copy()  # noqa: NPY002 - the global state is what is tested
    module = geomstats_module("geomstats.geometry.special_orthogonal")
    space = module.SpecialOrthogonal(4)
    gni.LieGroup.from_geomstats(space)
    assert np.array_equal(random, np.random.get_state()[1])  # noqa: NPY002
    assert hasattr(np, OLD_NAME) == (tuple(map(int, np.__version__.split(".")[:2])) < (2, 4))
    assert geomstats_module("geomstats.geometry.special_orthogonal") is module


@pytest.mark.parametrize("name", ["numpy", "geomstatsx", "special_orthogonal", "", 3])
def test_names_of_other_packages_are_refused(name: Any) -> None:
    with pytest.raises(gni.InputError, match=r"'geomstats\.geometry\.special_orthogonal'"):
        geomstats_module(name)


def test_modules_that_do_not_exist() -> None:
    with pytest.raises(gni.InputError, match=r"no module '\S+special_ortogonal'"):
        geomstats_module("geomstats.geometry.special_ortogonal")


@pytest.mark.parametrize(
    ("error", "package"),
    [
        (ModuleNotFoundError("No module named 'geomstats'", name="geomstats"), "geomstats"),
        (ImportError("cannot import name 'trapz' from 'numpy'"), "geomstats"),
        (ModuleNotFoundError("No module named 'torch'", name="torch"), "torch"),
        (RuntimeError("Unknown backend 'jax'"), "geomstats"),
    ],
    ids=str,
)
def test_a_failing_import_names_the_command(
    monkeypatch: pytest.MonkeyPatch, error: Exception, package: str
) -> None:
    def fail(name: str) -> None:
        assert hasattr(np, OLD_NAME)
        raise error

    had = hasattr(np, OLD_NAME)
    monkeypatch.setattr(loading.importlib, "import_module", fail)
    with pytest.raises(gni.GNIError, match=rf"(?s){error}.*pip install --upgrade {package}\n"):
        geomstats_module("geomstats.geometry.never_loaded")
    assert hasattr(np, OLD_NAME) == had
