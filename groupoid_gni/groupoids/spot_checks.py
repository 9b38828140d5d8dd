"""A first look at a groupoid somebody wrote: a few laws at a few small arrows.

Not a verification, only enough to catch a swapped argument or a missing factor before it turns
into plausible numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from groupoid_gni.groupoids.lie_groupoid import LieGroupoid

_SIZE = 0.1
_TOLERANCE = 1e-6


def broken_law(space: LieGroupoid) -> str | None:
    """The first law that fails at ``example_base_point``, with its numbers; None if none does."""
    rng = np.random.default_rng(1113)
    base = np.array(space.example_base_point, dtype=float)
    for _ in range(2):
        xi, eta, zeta = _SIZE * rng.uniform(-1.0, 1.0, (3, space.rank))
        for law, gap in _gaps(space, base, xi, eta, zeta):
            if not gap <= _TOLERANCE:
                return f"{law} fails by {gap:.3g} at x = {base}, xi = {xi}"
    return None


def _gaps(
    space: LieGroupoid, x: Any, xi: Any, eta: Any, zeta: Any
) -> Iterator[tuple[str, float]]:
    g = space.retract(x, xi)
    end = np.asarray(space.target(g), dtype=float)
    yield "source(retract(x, xi)) = x", _distance(space.source(g), x)
    yield "lift(retract(x, xi)) = xi", _distance(space.lift(g), xi)
    yield "lift(identity(x)) = 0", _distance(space.lift(space.identity(x)), 0.0 * xi)
    yield "target(identity(x)) = x", _distance(space.target(space.identity(x)), x)
    back = space.inverse(g)
    yield "source(inverse(g)) = target(g)", _distance(space.source(back), end)
    yield "target(inverse(g)) = source(g)", _distance(space.target(back), x)
    yield "lift(inverse(retract(x, xi))) = -xi", _distance(space.lift(back), -xi)
    closed = space.multiply(back, g)
    yield "lift(multiply(inverse(g), g)) = 0", _distance(space.lift(closed), 0.0 * xi)
    # not inverse(g): where arrows are classes, its representative fits g even if no other does
    returned = space.multiply(g, space.retract(end, -xi))
    yield "multiply(g, retract(target(g), -xi)) = identity", _distance(
        space.lift(returned), 0.0 * xi
    )
    h = space.retract(end, eta)
    k = space.retract(np.asarray(space.target(h), dtype=float), zeta)
    yield "target(multiply(g, h)) = target(h)", _distance(
        space.target(space.multiply(g, h)), space.target(h)
    )
    left = space.multiply(space.multiply(g, h), k)
    right = space.multiply(g, space.multiply(h, k))
    yield "associativity of multiply", _distance(space.lift(left), space.lift(right))


def _distance(a: Any, b: Any) -> float:
    return float(np.max(np.abs(np.asarray(a, dtype=float) - np.asarray(b, dtype=float)), initial=0))
