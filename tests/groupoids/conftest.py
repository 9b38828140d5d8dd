"""The catalogue of groups and groupoids, and draws of algebra vectors in four regimes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from groupoid_gni.groupoids import (
    SE2,
    SE3,
    SO2,
    SO3,
    ActionGroupoid,
    AtiyahGroupoid,
    Cayley,
    Exponential,
    FramedPairGroupoid,
    LieGroup,
    LieGroupoid,
    PairGroupoid,
    ProductGroupoid,
    QuadraticGroup,
    VectorGroup,
)


def _groups() -> list[LieGroup]:
    lorentz = np.diag([-1.0, 1.0, 1.0])
    return [
        make(side=side, retraction=retraction)
        for side in ("left", "right")
        for retraction in (Cayley(), Exponential())
        for make in (
            lambda **options: VectorGroup(3, **options),
            SO2,
            SO3,
            SE2,
            SE3,
            lambda **options: QuadraticGroup(lorentz, **options),
        )
    ] + [QuadraticGroup(np.eye(4)), QuadraticGroup(np.eye(4), retraction=Exponential())]


def turned_back(q: Any, rotation: Any) -> Any:
    """The right action q -> R^T q of rotations on directions."""
    return (q[..., None, :] @ rotation)[..., 0, :]


def turned(q: Any, rotation: Any) -> Any:
    """The left action q -> R q."""
    return (rotation @ q[..., None])[..., 0]


def _spaces() -> list[LieGroupoid]:
    direction = np.array([0.48, 0.6, 0.64])
    exponential = Exponential()
    right = SO3(side="right")
    return [
        PairGroupoid(3),
        AtiyahGroupoid(2, right),
        AtiyahGroupoid(1, SE2(retraction=exponential)),
        ProductGroupoid(SO3(retraction=exponential), PairGroupoid(1), SE3(side="right")),
        FramedPairGroupoid(VectorGroup(2), SO3()),
        FramedPairGroupoid(SE2(side="right"), SO2(retraction=exponential), SE3()),
        FramedPairGroupoid(SO3(side="right", retraction=exponential)),
        ActionGroupoid(SO3(), turned_back, direction),
        ActionGroupoid(SO3(side="right", retraction=exponential), turned, direction),
        ProductGroupoid(ActionGroupoid(SO3(), turned_back, direction), FramedPairGroupoid(SO2())),
    ]


GROUPS = _groups()
SPACES = [*_spaces(), *GROUPS]


@pytest.fixture(scope="session", params=GROUPS, ids=repr)
def group(request: pytest.FixtureRequest) -> LieGroup:
    return request.param


@pytest.fixture(scope="session", params=SPACES, ids=repr)
def space(request: pytest.FixtureRequest) -> LieGroupoid:
    return request.param


@pytest.fixture(scope="session")
def draw_xi() -> Callable[..., Any]:
    """Draw algebra vectors: 0, of size 1e-8, ordinary, or with a prescribed largest reach."""

    def draw(data: st.DataObject, space: LieGroupoid, largest_reach: float = 0.9) -> Any:
        entries = st.lists(st.floats(-1, 1), min_size=space.rank, max_size=space.rank)
        direction = np.array(data.draw(entries))
        direction = direction / max(np.linalg.norm(direction), 0.1)
        size = data.draw(st.sampled_from([0.0, 1e-8, 0.3, np.inf]))
        x = space.example_base_point
        reach_of_one = float(space.reach(x, direction))
        edge = largest_reach / reach_of_one if reach_of_one > 0.05 else 2.0
        return direction * min(size, edge)

    return draw


@pytest.fixture(scope="session")
def draw_base_point() -> Callable[..., Any]:
    """Draw base points: the example, moved by one arrow, and shifted where Q is a vector space."""

    def draw(data: st.DataObject, space: LieGroupoid) -> Any:
        x = np.array(space.example_base_point)
        entries = st.lists(st.floats(-1, 1), min_size=space.rank, max_size=space.rank)
        return space.target(space.retract(x, np.array(data.draw(entries))))

    return draw
