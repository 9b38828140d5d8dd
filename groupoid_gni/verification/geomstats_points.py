"""Points of geomstats spaces as a Hypothesis strategy; takes the spaces, never imports them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from groupoid_gni.array_types import FloatArray

_TOLERANCE = 1e-10


@st.composite
def geomstats_points(draw: Callable[[Any], Any], space: Any) -> FloatArray:
    """Points of a geomstats space, in its own shape, by its ``random_point``.

    Only points that ``belongs`` accepts are drawn. geomstats draws from NumPy's global random
    state; it is put back, so that a test cannot change what other code draws.
    """
    with _borrowed_random_state(draw(st.integers(0, 2**32 - 1))):
        point = np.asarray(space.random_point(), dtype=float)
    assume(bool(space.belongs(point, atol=_TOLERANCE)))
    return point


@contextmanager
def _borrowed_random_state(seed: int) -> Iterator[None]:
    saved = np.random.get_state()  # noqa: NPY002 (geomstats knows no other)
    np.random.seed(seed)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(saved)  # noqa: NPY002
