"""What laws of systems are tried on, and how their sides are compared."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from groupoid_gni.array_types import FloatArray
from groupoid_gni.verification.differences import STEP, central_difference, complex_step
from groupoid_gni.verification.gaps import Gap
from groupoid_gni.verification.strategies import Draw, Sample, base_points
from groupoid_gni.verification.system_view import DenseNode, SystemView

_WORST_CONDITION = 1e8
"""Of G and C; beyond, the step itself gives up."""
_SIZES = (1.0, 1e6, 1e-8)
_ENOUGH = 1e-12
_AGREE = 0.1
"""Part of a failure by which differences may be off and still confirm it."""

Derivative = Callable[..., FloatArray]


def _entries(size: int) -> st.SearchStrategy[FloatArray]:
    """Vectors of multiples of 1/16 from -8 to 8, in one draw; no square of one underflows."""
    drawn = st.binary(min_size=size, max_size=size)
    return drawn.map(lambda numbers: np.frombuffer(numbers, dtype=np.int8) / 16.0)


def _generic(view: SystemView, x: FloatArray) -> FloatArray:
    """x moved a little, off the round numbers where terms have kinks and ranks drop."""
    space = view.system.space
    if not space.base_size:
        return x
    awkward = 0.07 * np.cos(np.sqrt(2.0) * np.arange(1.0, space.rank + 1.0))
    moved = np.asarray(space.target(space.retract(x, awkward)), dtype=float)
    return np.asarray(space.restore_base(moved), dtype=float)


def _usable(view: SystemView, x: FloatArray) -> bool:
    """Whether the terms are finite at x and its constraints not nearly dependent.

    What else may be wrong at x is for the laws to find.
    """
    try:
        with np.errstate(all="ignore"):
            finite = all(np.all(np.isfinite(view.term(name, x))) for name in view.system.plain)
            return finite and view.node(x).condition < _WORST_CONDITION
    except Exception:
        return True


@st.composite
def motions(draw: Draw, view: SystemView) -> Sample:
    """Samples {x, xi, p, q}: any velocity and any two covectors, on or off the constraints.

    Covectors are of the size of G times a velocity, much larger or much smaller; p may also be
    a combination of constraint rows.
    """
    rank = view.system.space.rank
    x = _generic(view, draw(base_points(view.system.space)))
    assume(_usable(view, x))
    metric, rows = _metric_and_rows(view, x)
    xi = draw(_entries(rank)) * draw(st.sampled_from(_SIZES))
    p = metric @ draw(_entries(rank)) * draw(st.sampled_from(_SIZES))
    if len(rows) and draw(st.integers(0, 3)) == 3:
        p = rows.T @ draw(_entries(len(rows)))
    return {"x": x, "xi": xi, "p": p, "q": metric @ draw(_entries(rank))}


def _metric_and_rows(view: SystemView, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """G and mu; a metric that cannot be had is a finding, and not made here."""
    try:
        found = [np.array(view.term(name, x), dtype=float) for name in ("metric", "constraints")]
    except Exception:
        return np.eye(view.system.space.rank), np.zeros((0, view.system.space.rank))
    return found[0], found[1]


def has_constraints(view: SystemView) -> str | None:
    """Why a law about constraints does not apply."""
    return None if view.system.constraint_count else "the system has no constraints"


def has_base(view: SystemView) -> str | None:
    """Why a law about derivatives along the base does not apply."""
    return None if view.system.space.base_size else "the base is a point"


def has_term(name: str) -> Callable[[SystemView], str | None]:
    """Why a law about one term does not apply."""

    def applies(view: SystemView) -> str | None:
        return None if view.system.has(name) else f"the system has no {name}"

    return applies


def covector_gap(node: DenseNode, left: FloatArray, right: FloatArray, *sizes: FloatArray) -> Gap:
    """Covectors compared in units of the covectors ``sizes``."""
    scale = node.condition * node.size(*sizes)
    return Gap(node.in_frame(left), node.in_frame(right), scale or 1.0)


def along_roads(measure: Callable[[Derivative], Gap]) -> Gap:
    """The gap with plain functions differentiated exactly where they are analytic.

    There, differences confirm what complex steps find, and complex steps are exact. A term with
    abs in it misleads complex steps, and a kink nearby misleads wide differences: then the
    smallest gap counts, with an allowance for the digits that differences lose.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a complex number losing its imaginary part is a dead end
        try:
            exact = measure(complex_step)
        except Exception:
            exact = Gap(np.zeros(0), np.zeros(1), 1.0)
        best = exact
        for derive, allowance in _DIFFERENCES:
            if best.residual < _ENOUGH:
                break
            found = measure(derive)
            if _agree(exact, found):
                return exact
            found = Gap(found.left, found.right, found.scale * allowance)
            if not best.residual <= found.residual:
                best = found
    return best


def _agree(exact: Gap, found: Gap) -> bool:
    apart = [
        Gap(mine, other, exact.scale).residual
        for mine, other in ((exact.left, found.left), (exact.right, found.right))
    ]
    return max(apart) < _AGREE * exact.residual < np.inf


def _unit_difference(
    function: Callable[[Any], Any],
    x: FloatArray,
    directions: FloatArray | None = None,
    *,
    step: float,
) -> FloatArray:
    """Central differences along one direction of any length, or along the unit vectors."""
    length = 1.0 if directions is None else float(np.max(np.abs(directions), initial=0.0)) or 1.0
    given = None if directions is None else directions / length
    return central_difference(function, x, given, step=step) * length


_DIFFERENCES = (
    (partial(_unit_difference, step=STEP), 1e3),
    (partial(_unit_difference, step=STEP / 128.0), 1e4),
)
