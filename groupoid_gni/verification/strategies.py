"""Hypothesis strategies: points, vectors, arrows and states of any groupoid or system.

Vectors come from four regimes: ordinary, near the edge of the retraction's domain, tiny (down to
1e-160) and zero; they shrink towards few, simple components. Everything drawn is a NumPy array.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.systems import MechanicalSystem, State

EDGE = 0.95
"""Largest reach of a vector that is drawn."""
TINY = (1e-4, 1e-8, 1e-160)
# Four in five are neither tiny nor zero: else most chains of three have an identity in them.
_REGIMES = (*("ordinary", "edge") * 8, *TINY, 0.0)
_LONGEST = 1.0  # of a vector where the reach says nothing
_SHRUNK = 0.47  # an ordinary vector that had to be shortened
_STRETCH = 20.0

def _simplicity(part: int) -> tuple[int, int, bool]:
    """Order of preference when shrinking: 0, 1, 1/2, tenths, hundredths, thousandths."""
    level = next(i for i, unit in enumerate((1000, 500, 100, 10, 1)) if part % unit == 0)
    return (-1 if part == 0 else level, abs(part), part < 0)


# A grid, as floats would be tiny too often; simple numbers first, so that examples shrink to them.
_THOUSANDTHS = tuple(sorted(range(-1000, 1001), key=_simplicity))

Draw = Callable[[Any], Any]
Sample = dict[str, Any]


def _entries(size: int, bound: float = 1.0) -> st.SearchStrategy[FloatArray]:
    one = st.sampled_from(_THOUSANDTHS)
    return st.tuples(*[one] * size).map(lambda parts: np.array(parts) * (bound / 1000))


def _reach(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> float:
    return float(np.asarray(space.reach(x, xi)))


def _to_the_edge(space: LieGroupoid, x: FloatArray, xi: FloatArray, edge: float) -> FloatArray:
    longest = float(np.max(np.abs(xi), initial=0.0))
    if longest < 1e-3:
        return xi
    reach = _reach(space, x, xi)
    stretch = edge / reach if reach > 0.0 else edge * _LONGEST / longest
    return xi * min(stretch, _STRETCH)


@st.composite
def algebroid_vectors(
    draw: Draw, space: LieGroupoid, x: FloatArray | None = None, *, largest_reach: float = EDGE
) -> FloatArray:
    """Elements of A_x G, shape (rank,), in the frame of the groupoid.

    x : the base point; the groupoid's example when left out.
    largest_reach : the edge; where a groupoid's reach is zero, the largest entry.
    """
    x = np.asarray(space.example_base_point, dtype=float) if x is None else x
    xi = draw(_entries(space.rank))
    regime = draw(st.sampled_from(_REGIMES))
    if regime == "edge":
        return _to_the_edge(space, x, xi, largest_reach)
    if isinstance(regime, float):
        return xi * regime
    if _reach(space, x, xi) >= largest_reach:
        xi = xi * (_SHRUNK * largest_reach / _reach(space, x, xi))
    return xi * min(1.0, largest_reach / EDGE)


@st.composite
def base_points(draw: Draw, space: LieGroupoid) -> FloatArray:
    """Points of Q, shape (base_size,): the example point moved along an arrow."""
    x = np.array(space.example_base_point, dtype=np.float64)
    if not space.base_size:
        return x
    xi = draw(_entries(space.rank))
    if not xi.any():
        return x
    reach = _reach(space, x, xi)
    moved = space.target(space.retract(x, xi * min(1.0, 0.8 / max(reach, 1e-3))))
    return np.asarray(space.restore_base(np.asarray(moved, dtype=float)), dtype=float)


def _samples(space: LieGroupoid, names: tuple[str, ...]) -> st.SearchStrategy[Sample]:
    edge = EDGE / max(len(names), 1)  # so that the product stays in the domain of lift

    @st.composite
    def sample(draw: Draw) -> Sample:
        x = here = draw(base_points(space))
        drawn: Sample = {"x": x}
        for name in names:
            drawn[name] = draw(algebroid_vectors(space, here, largest_reach=edge))
            here = np.asarray(space.target(space.retract(here, drawn[name])), dtype=float)
        return drawn

    return sample()


def points(space: LieGroupoid) -> st.SearchStrategy[Sample]:
    """Samples {x}."""
    return _samples(space, ())


def vectors(space: LieGroupoid) -> st.SearchStrategy[Sample]:
    """Samples {x, xi}: the arrow g = retract(x, xi)."""
    return _samples(space, ("xi",))


def pairs(space: LieGroupoid) -> st.SearchStrategy[Sample]:
    """Samples {x, xi, eta}: g = retract(x, xi), then h = retract(target(g), eta)."""
    return _samples(space, ("xi", "eta"))


def triples(space: LieGroupoid) -> st.SearchStrategy[Sample]:
    """Samples {x, xi, eta, zeta}: three arrows in a row."""
    return _samples(space, ("xi", "eta", "zeta"))


def chain(space: LieGroupoid, x: FloatArray, *steps: FloatArray) -> tuple[FloatArray, ...]:
    """Arrows in a row: the first starts at x, each next one where the last one ends."""
    arrows = []
    for step in steps:
        arrows.append(np.asarray(space.retract(x, step), dtype=float))
        x = np.asarray(space.target(arrows[-1]), dtype=float)
    return tuple(arrows)


def _chained(space: LieGroupoid) -> Callable[[Sample], tuple[FloatArray, ...]]:
    return lambda sample: chain(space, *sample.values())


def arrows(space: LieGroupoid) -> st.SearchStrategy[FloatArray]:
    """Arrows, shape (arrow_size,)."""
    return vectors(space).map(lambda sample: chain(space, *sample.values())[0])


def composable_pairs(space: LieGroupoid) -> st.SearchStrategy[tuple[FloatArray, ...]]:
    """Pairs (g, h) with target(g) = source(h)."""
    return pairs(space).map(_chained(space))


def composable_triples(space: LieGroupoid) -> st.SearchStrategy[tuple[FloatArray, ...]]:
    """Triples (g, h, k) that meet."""
    return triples(space).map(_chained(space))


@st.composite
def states(draw: Draw, system: MechanicalSystem) -> State:
    """Consistent states: the drawn velocity moved to the nearest one on the constraint."""
    x = draw(base_points(system.space))
    xi = draw(_entries(system.space.rank))
    try:
        return system.state(x if system.space.base_size else None, xi, project_start=True)
    except InputError:
        assume(False)
        raise
