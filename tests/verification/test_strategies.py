"""Strategies: what they draw belongs where it should, in every regime, and shrinks."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import find, given, settings
from hypothesis import strategies as st

import groupoid_gni as gni
from groupoid_gni import verification
from groupoid_gni.verification import strategies

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

NAMES = ["pair 3", "SO3 left exp", "SE2 right cay", "action left cay", "framed right exp"]
SPACES = {name: zoo.SPACES[name]() for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_points_and_arrows_lie_on_their_manifolds(name: str) -> None:
    space = SPACES[name]

    @given(verification.base_points(space), verification.arrows(space))
    def lie(x: Any, g: Any) -> None:
        assert x.shape == (space.base_size,)
        assert g.shape == (space.arrow_size,)
        assert np.max(space.base_defect(x), initial=0.0) < 1e-14
        assert np.max(space.base_defect(space.target(g)), initial=0.0) < 1e-13

    lie()


@pytest.mark.parametrize("name", NAMES)
def test_chains_are_composable(name: str) -> None:
    space = SPACES[name]

    @given(verification.composable_pairs(space), verification.composable_triples(space))
    def meet(pair: Any, triple: Any) -> None:
        for chain in (pair, triple):
            for g, h in pairwise(chain):
                space.multiply(g, h)

    meet()


@pytest.mark.parametrize("name", ["SO3 left exp", "SO3 left cay", "framed right exp"])
def test_every_regime_is_reached(name: str) -> None:
    space, seen = SPACES.get(name) or zoo.SPACES[name](), set()

    @settings(max_examples=300, derandomize=True, database=None)
    @given(verification.algebroid_vectors(space))
    def look(xi: Any) -> None:
        reach = float(space.reach(space.example_base_point, xi))
        assert reach <= strategies.EDGE * (1 + 1e-12)
        size = float(np.max(np.abs(xi)))
        if abs(reach - strategies.EDGE) < 1e-9:
            seen.add("edge")
        elif size == 0.0:
            seen.add("zero")
        elif size < 1e-150:
            seen.add("1e-160")
        elif size < 1e-5:
            seen.add("tiny")
        elif size > 0.01:
            seen.add("ordinary")

    look()
    assert seen == {"edge", "zero", "1e-160", "tiny", "ordinary"}


def test_vectors_shrink_to_few_simple_components() -> None:
    space = gni.SE3(retraction=gni.Exponential())
    vector = find(
        verification.algebroid_vectors(space), lambda xi: np.max(np.abs(xi)) > 0.1,
        settings=settings(database=None, derandomize=True),
    )
    assert np.count_nonzero(vector) == 1


def test_states_are_consistent() -> None:
    scene = gni.scenes.inhomogeneous_ball()

    @given(verification.states(scene.system))
    def consistent(state: Any) -> None:
        again = scene.system.state(state.base, state.velocity)
        np.testing.assert_allclose(again.momentum, state.momentum, atol=1e-14)

    consistent()


def test_strategies_compose_with_those_of_hypothesis() -> None:
    both = st.one_of(*(verification.arrows(space) for space in SPACES.values()))
    assert isinstance(find(both, lambda g: True), np.ndarray)
