"""Closed forms of the built-in groupoids and the generic path give one and the same motion."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

METHODS = [gni.GNI(), gni.Rattle(), gni.Midpoint()]
NAMES = [name for name in zoo.SPACES if not (name.startswith("SO4") and name.endswith("exp"))]


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def largest_difference(name: str, method: Any, steps: int, h: float, compile: bool) -> float:
    """Closed forms against derived ones over a run; relative to the size of the momenta."""
    number = NAMES.index(name)
    runs = []
    for space in (zoo.SPACES[name](), gni.DerivedGroupoid(zoo.SPACES[name]())):
        a = zoo.animal(
            name, 1 + number % 3, affine=number % 2 == 0, gyroscopic=number % 3 == 0, space=space
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", gni.ParasiticModeWarning)
            runs.append(
                gni.integrate(
                    a.system, a.start, step=h, n_steps=steps, method=method, compile=compile
                )
            )
    closed, derived = runs
    assert closed.system.has("potential") == (closed.system.space.base_size > 0)
    return max(
        np.abs(getattr(closed, part) - getattr(derived, part)).max(initial=0.0)
        for part in ("base", "momenta_before", "momenta_after", "velocities")
    )


@pytest.mark.parametrize("name", NAMES)
def test_closed_forms_agree_with_the_generic_path_over_a_few_steps(name: str) -> None:
    compile = name in ("pair 3", "SO3 left cay", "SE2 right exp")
    method = gni.Rattle() if name == "twelve" else METHODS[NAMES.index(name) % 3]
    assert largest_difference(name, method, 50 if compile else 20, 0.03, compile) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("name", NAMES)
def test_closed_forms_agree_with_the_generic_path_over_a_thousand_steps(
    name: str, method: Any
) -> None:
    assert largest_difference(name, method, 1000, 0.002, True) < 1e-11


def test_a_user_groupoid_of_seven_functions_alone_runs() -> None:
    """Rotations by unit quaternions: nothing but the seven functions, by hand."""

    class Quaternions(gni.LieGroupoid):
        rank = 3
        example_base_point = np.zeros(0)

        def source(self, g: Any) -> Any:
            return g[..., :0]

        def target(self, g: Any) -> Any:
            return g[..., :0]

        def identity(self, x: Any) -> Any:
            return np.array([1.0, 0.0, 0.0, 0.0])

        def multiply(self, g: Any, h: Any) -> Any:
            v, w = g[1:], h[1:]
            real = g[0] * h[0] - v @ w
            cross = np.stack(
                [v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]]
            )
            return np.concatenate([np.stack([real]), g[0] * w + h[0] * v + cross])

        def inverse(self, g: Any) -> Any:
            return np.concatenate([g[:1], -g[1:]])

        def retract(self, x: Any, xi: Any) -> Any:
            length = np.sqrt(1 + xi @ xi / 4)
            return np.concatenate([np.stack([1 / length]), xi / (2 * length)])

        def lift(self, g: Any) -> Any:
            return 2 * g[1:] / g[0]

    metric, rows = np.diag([0.8, 1.3, 1.7]), [[0.3, -0.2, 1.1]]
    for method in METHODS:
        runs = []
        for space in (Quaternions(), gni.SO3()):
            system = gni.MechanicalSystem(space, metric=metric, constraints=rows)
            start = system.state(velocity=[0.9, -0.7, 0.4], project_start=True)
            runs.append(gni.integrate(system, start, step=0.04, n_steps=60, method=method))
        np.testing.assert_allclose(runs[0].momenta, runs[1].momenta, atol=1e-13)
