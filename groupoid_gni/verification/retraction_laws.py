"""The retraction of a groupoid, its trivialised tangents and lemma 9.5, without closed forms.

Whatever a groupoid computes by formula is compared with its definition in terms of the seven
functions, differentiated by finite differences of plain calls.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from hypothesis import strategies as st

from groupoid_gni.array_types import FloatArray
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.verification.differences import STEP, central_difference
from groupoid_gni.verification.gaps import Gap, arrow_gap, gap
from groupoid_gni.verification.groupoid_laws import needs_a_base
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.strategies import base_points, chain, pairs, vectors

_FEW = "round-off of a few products and one lift"
_DIFFERENCES = "finite differences of order eight, 1e-13 for functions of size 1"
_law = partial(law, "retraction", tolerance=1e-12, reason=_FEW)
_derivative = partial(law, "retraction", tolerance=1e-10, reason=_DIFFERENCES, share=0.15)

SCALES = (1.0, 1e-4, 1e-8, 1e-160)
EDGES = (1.0 - 1e-6, 0.999, 0.99, 0.97)  # the hardest first: Hypothesis starts there
_SHORT = 1e-3
_FLAT = 0.1  # the least reach of a vector of length 1 that is stretched to the edge


@st.composite
def ordinary(draw: Callable[[Any], Any], space: LieGroupoid) -> dict[str, Any]:
    """Samples {x, xi}: xi never small, with a reach of 0.9 at most; for expensive laws."""
    x = draw(base_points(space))
    xi = draw(st.tuples(*[st.floats(-1.0, 1.0, allow_subnormal=False)] * space.rank).map(np.array))
    if np.max(np.abs(xi), initial=0.0) < _SHORT:
        xi = np.ones(space.rank)
    return {"x": x, "xi": xi * min(1.0, 0.9 / max(_reach(space, x, xi), 1e-3))}


@st.composite
def _near_the_edge(draw: Callable[[Any], Any], space: LieGroupoid) -> dict[str, Any]:
    """Samples {x, xi} with a reach between 0.97 and 1 - 1e-6."""
    x, xi = draw(ordinary(space)).values()
    if _reach(space, x, xi) < _FLAT * np.max(np.abs(xi)):
        xi = np.ones(space.rank)
    edge = draw(st.sampled_from(EDGES))
    return {"x": x, "xi": xi * (edge / max(_reach(space, x, xi), 1e-3))}


def _reach(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> float:
    return float(np.asarray(space.reach(x, xi)))


def _plain(values: Any) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


@_law("alpha(retract(x, xi)) = x", "x in Q, xi in A_x G", "section 8.1: A_x G = ker T alpha",
      draw=vectors, applies=needs_a_base)
def source_of_retraction(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """A retraction moves along the fibre of the source."""
    return gap(space.source(space.retract(x, xi)), x)


@_law("retract(x, 0) = epsilon(x)", "x in Q", "Appendix: tau(0) = e", draw=vectors)
def retraction_of_zero(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """Zero velocity stays."""
    return arrow_gap(space, _plain(space.retract(x, np.zeros_like(xi))), space.identity(x))


@_law("retract(x, xi)^-1 = retract(x', -xi)", "x' = beta(retract(x, xi))",
      "Appendix: tau(xi) tau(-xi) = e", draw=vectors)
def symmetry(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """The opposite velocity leads back."""
    g = _plain(space.retract(x, xi))
    back = _plain(space.retract(_plain(space.target(g)), -xi))
    return arrow_gap(space, _plain(space.inverse(g)), back)


@_law("lift(retract(x, xi)) = xi", "xi up to the edge of the domain",
      "Appendix: tau is a local diffeomorphism", draw=vectors)
def lift_undoes_retraction(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """The lift finds the velocity again."""
    return gap(space.lift(space.retract(x, xi)), xi)


@_law("retract(alpha(g), lift(g)) = g", "g a product of two arrows of reach below 1/4",
      "Appendix: tau is a local diffeomorphism", draw=pairs)
def retraction_undoes_lift(
    space: LieGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The retraction finds the arrow again, also one that no retraction made."""
    # Halved, because a product need not have a logarithm, for example in SL(2).
    g = _plain(space.multiply(*chain(space, x, xi / 2.0, eta / 2.0)))
    return arrow_gap(space, _plain(space.retract(_plain(space.source(g)), space.lift(g))), g)


@_law("retract(x, eta) retract(x', eta) = retract(x, xi), eta = half(x, xi)",
      "|xi| <= 1/2, where the derived half arrow is exact", "conventions, section 4", draw=vectors)
def half_arrows(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """Two equal halves make the whole."""
    xi = xi / max(1.0, 2.0 * float(np.linalg.norm(xi)))
    eta = _plain(space.half(x, xi))
    return arrow_gap(
        space, _plain(space.multiply(*chain(space, x, eta, eta))), _plain(space.retract(x, xi))
    )


@_law("B-(x, xi) = -B+(x', -xi)", "x' = beta(retract(x, xi))",
      "follows from retract(x, xi)^-1 = retract(x', -xi)", draw=vectors)
def tangents_change_places(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """The way back exchanges the two trivialised tangents."""
    end = _plain(space.target(space.retract(x, xi)))
    return gap(
        space.trivialised_tangent_minus(x, xi), -_plain(space.trivialised_tangent_plus(end, -xi))
    )


@_law("B+(x, 0) = 1, B-(x, 0) = -1", "x in Q", "definition 9.1 at xi = 0", draw=vectors)
def tangents_at_zero(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """At an identity arrow nothing is between the two algebroids."""
    one, zero = np.eye(space.rank), np.zeros_like(xi)
    tangents = space.trivialised_tangent_plus(x, zero), space.trivialised_tangent_minus(x, zero)
    return gap(np.stack(tangents), np.stack([one, -one]))


def _lengthened(space: LieGroupoid, x: FloatArray, xi: FloatArray, step: float) -> FloatArray:
    g = _plain(space.retract(x, xi))
    end = _plain(space.target(g))
    return central_difference(
        lambda e: space.lift(space.multiply(g, _plain(space.retract(end, e)))),
        np.zeros(space.rank), step=step,
    )


def _shortened(space: LieGroupoid, x: FloatArray, xi: FloatArray, step: float) -> FloatArray:
    g = _plain(space.retract(x, xi))
    return central_difference(
        lambda e: space.lift(space.multiply(_plain(space.inverse(space.retract(x, e))), g)),
        np.zeros(space.rank), step=step,
    )


@_derivative("B+ = d/de lift(g retract(beta(g), e)) at e = 0", "g = retract(x, xi)",
             "conventions, section 4; definition 9.1", draw=ordinary)
def tangent_plus_is_the_derivative(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """B+ is what lengthening the arrow at its end does to its lift."""
    return gap(space.trivialised_tangent_plus(x, xi), _lengthened(space, x, xi, STEP))


@_derivative("B- = d/de lift(retract(x, e)^-1 g) at e = 0", "g = retract(x, xi)",
             "conventions, section 4; definition 9.1", draw=ordinary)
def tangent_minus_is_the_derivative(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """B- is what shortening the arrow at its start does to its lift."""
    return gap(space.trivialised_tangent_minus(x, xi), _shortened(space, x, xi, STEP))


def _adjoint(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> FloatArray:
    """Ad_g : A_beta -> A_alpha, d/de lift(g retract(beta(g), e) k^-1) at e = 0.

    Away from isotropy e moves the end, so k is the arrow to there of the bisection
    ``y -> retract(y, xi)`` through g; by symmetry ``k^-1 = retract(its end, -xi)``.
    """
    g = _plain(space.retract(x, xi))
    end = _plain(space.target(g))

    def conjugated(e: FloatArray) -> FloatArray:
        small = _plain(space.retract(end, e))
        back = _plain(space.retract(_plain(space.target(small)), -xi))
        return _plain(space.lift(space.multiply(_plain(space.multiply(g, small)), back)))

    return central_difference(conjugated, np.zeros(space.rank))


@_derivative("B+ = -B- Ad_g", "g = retract(x, xi), Ad_g e = d/de lift(g retract(beta(g), e) k^-1)",
             "Lemma 9.5 on a groupoid; k in the bisection y -> retract(y, xi)", draw=ordinary)
def lemma_9_5_on_arrows(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """The two trivialised tangents differ by the adjoint action of the arrow."""
    minus = _plain(space.trivialised_tangent_minus(x, xi))
    return gap(space.trivialised_tangent_plus(x, xi), -minus @ _adjoint(space, x, xi))


@_derivative("-B+^T B-^-T = Ad_g^*", "g = retract(x, xi)",
             "Lemma 9.5 and (48): FL+ = B+^T p, FL- = -B-^T p", draw=ordinary)
def momentum_transport(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """A free momentum is carried along an arrow by the coadjoint action."""
    plus, minus = space.trivialised_tangent_plus(x, xi), space.trivialised_tangent_minus(x, xi)
    transport = -np.linalg.solve(_plain(minus), _plain(plus)).T
    return gap(transport, _adjoint(space, x, xi).T)


def tells_tiny_steps_apart(space: LieGroupoid) -> str | None:
    """Whether the coordinates of an arrow can hold a step of 1e-160: they must start at zero."""
    try:
        small = np.linspace(0.13, 0.29, space.rank)
        x = _plain(space.target(space.retract(_plain(space.example_base_point), small)))
        change = central_difference(lambda xi: space.retract(x, xi), np.zeros(space.rank))
        moving = np.max(np.abs(change), axis=-1) > 1e-9
        start = _plain(space.identity(x))
    except Exception:  # whatever a broken subject raises will break the law as well
        return None
    if np.any(start[moving] != 0.0):
        return "arrows near an identity differ in coordinates that are not zero: 1 + 1e-160 is 1"
    return None


@_law("|lift(retract(x, s xi)) - s xi| <= 1e-12 s |xi|",
      "s = 1, 1e-4, 1e-8, 1e-160, and exactly 0 at s = 0, if arrows can hold it",
      "no division by |xi|, no 1 - cos near 0", draw=ordinary, applies=tells_tiny_steps_apart)
def accuracy_near_zero(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """Small steps keep all their digits, and zero stays zero."""
    found = [_plain(space.lift(space.retract(x, s * xi))) / s for s in SCALES]
    nothing = _plain(space.lift(space.retract(x, 0.0 * xi))) / SCALES[-1]
    return gap([*found, nothing], [*[xi] * len(SCALES), 0.0 * xi], float(np.max(np.abs(xi))))


def has_an_edge(space: LieGroupoid) -> str | None:
    """Why there is no edge of the domain."""
    x = np.asarray(space.example_base_point, dtype=float)
    vectors = [*np.eye(space.rank), np.ones(space.rank)]
    if any(_reach(space, x, xi) > 1e-3 for xi in vectors):
        return None
    return "reach is 0: the retraction is global, or nobody said where it ends"


@_law("lift(retract(x, xi)) = xi, lift(retract(x, xi)^-1) = -xi", "0.97 <= reach(x, xi) < 1",
      "reach: 1 is the largest step allowed", draw=_near_the_edge, applies=has_an_edge)
def accuracy_near_the_edge(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """The largest steps that are not refused are still right."""
    g = _plain(space.retract(x, xi))
    found = np.concatenate([space.lift(g), space.lift(space.inverse(g))])
    return gap(found, np.concatenate([xi, -xi]))


@_derivative("B+ and B- are the derivatives of their definitions", "0.97 <= reach(x, xi) <= 0.999",
             "conventions, section 4; reach: 1 is the largest step allowed",
             draw=_near_the_edge, applies=has_an_edge)
def tangents_near_the_edge(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """No trivialised tangent breaks down before the retraction does."""
    reach = _reach(space, x, xi)
    xi = xi * min(1.0, 0.999 / reach)
    longest = max(_reach(space, x, unit) for unit in np.eye(space.rank))
    step = min(STEP, (1.0 - min(reach, 0.999)) / (8.0 * max(longest, 1e-3)))
    found = space.trivialised_tangent_plus(x, xi), space.trivialised_tangent_minus(x, xi)
    wanted = _lengthened(space, x, xi, step), _shortened(space, x, xi, step)
    return gap(np.stack(found), np.stack(wanted))


RETRACTION_LAWS = (
    source_of_retraction, retraction_of_zero, symmetry, lift_undoes_retraction,
    retraction_undoes_lift, half_arrows, tangents_change_places, tangents_at_zero,
    tangent_plus_is_the_derivative, tangent_minus_is_the_derivative, lemma_9_5_on_arrows,
    momentum_transport, accuracy_near_zero, accuracy_near_the_edge, tangents_near_the_edge,
)
