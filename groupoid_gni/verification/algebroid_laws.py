"""Section 8.1: the Lie algebroid, by the invariant vector fields of its sections.

``Algebroid`` differentiates the seven functions themselves, so that what a class declares in closed
form can be told wrong; differences of plain calls need no recording either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from hypothesis import strategies as st

from groupoid_gni.array_types import FloatArray
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.groupoids.lie_groupoid import half_by_iteration
from groupoid_gni.verification.algebroid_view import (
    Algebroid,
    LeftField,
    Multiple,
    RightField,
    Section,
    bracket_of_fields,
)
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, gap
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.retraction_laws import ordinary
from groupoid_gni.verification.strategies import EDGE, algebroid_vectors, base_points

_SHIFTS = (0.37, 1.13, 0.71)  # of the waves, so that none has a node at x = 0
_LIFTABLE = 0.6  # reach of two arrows together: in SL(2) some products of longer ones have no lift
_PARTS = 997  # of the unit, an awkward number; floats would be tiny too often
_SHORT = 0.3  # of a vector's length: six iterations are enough there

# What the laws are tried on.


def _drawn(
    view: Algebroid, arrows: tuple[str, ...], others: Mapping[str, tuple[int, ...]], edge: float
) -> st.SearchStrategy[dict[str, FloatArray]]:
    """A base point, arrows in a row of a total reach below the edge, and arrays by their shapes."""
    space = view.space
    one = st.integers(-_PARTS, _PARTS).map(lambda part: part / _PARTS)
    stops = np.cumsum([math.prod(shape) for shape in others.values()], dtype=int)
    numbers = st.tuples(*[one] * int(stops[-1]))  # one strategy: half the time

    @st.composite
    def sample(draw: Callable[[Any], Any]) -> dict[str, FloatArray]:
        x = here = draw(base_points(space))
        drawn = {"x": x}
        for name in arrows:
            reach = edge / len(arrows)
            drawn[name] = draw(algebroid_vectors(space, here, largest_reach=reach))
            here = view.end(here, drawn[name])
        parts = np.split(np.array(draw(numbers), dtype=np.float64), stops)
        items = zip(others.items(), parts, strict=False)
        return drawn | {name: part.reshape(shape) for (name, shape), part in items}

    return sample()


def sections(view: Algebroid) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi, first, second, waves}: an arrow, (a, c) of two sections, three waves."""
    pair = (2, view.space.rank)
    shapes = {"first": pair, "second": pair, "waves": (3, view.space.base_size)}
    return _drawn(view, ("xi",), shapes, EDGE)


def directions(view: Algebroid) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi, v}: an arrow and a vector."""
    return _drawn(view, ("xi",), {"v": (view.space.rank,)}, EDGE)


def pairs_and_directions(view: Algebroid) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi, eta, v}: two arrows whose product can be lifted, and a vector."""
    return _drawn(view, ("xi", "eta"), {"v": (view.space.rank,)}, _LIFTABLE)


def fibres(view: Algebroid) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, u, v, w}: three vectors over a point."""
    return _drawn(view, (), dict.fromkeys("uvw", (view.space.rank,)), EDGE)


def never_small(view: Algebroid) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi} with ordinary vectors only, for expensive laws."""
    return ordinary(view.space)


def _two(first: FloatArray, second: FloatArray, waves: FloatArray) -> tuple[Section, Section]:
    return (
        Section(first[0], first[1], waves[0], _SHIFTS[0]),
        Section(second[0], second[1], waves[1], _SHIFTS[1]),
    )


# Which subjects a law is about.


def needs_a_base(view: Algebroid) -> str | None:
    """Why a law about base points does not apply."""
    return None if view.space.base_size else "the base is a point"


def declares(name: str) -> Callable[[Algebroid], str | None]:
    """The condition that the groupoid has a closed form of ``name``."""

    def condition(view: Algebroid) -> str | None:
        derived = getattr(type(view.space), name) is getattr(LieGroupoid, name)
        return f"{name} has no closed form here, it is derived" if derived else None

    return condition


_ROUND_OFF = "round-off of two derivatives of a few products and a lift"
_NUMBERS = "round-off of a lift over the step, 2^-9, of differences of order eight"
_algebroid = partial(law, "algebroid")
_exact = partial(_algebroid, tolerance=1e-12, reason=_ROUND_OFF)
_on_pairs = partial(_exact, draw=pairs_and_directions, share=0.5)
_on_sections = partial(_exact, draw=sections, share=0.5)
_on_fibres = partial(_exact, draw=fibres, share=0.5)
_on_arrows = partial(_exact, draw=directions)
_numerical = partial(_algebroid, draw=directions, tolerance=1e-10, reason=_NUMBERS)

# Invariant fields.


@_on_pairs("T l_g (X->(h)) = X->(g h)", "composable g, h, X in Gamma(AG)",
           "Section 8.1: left-invariant")
def left_invariance(
    view: Algebroid, x: FloatArray, xi: FloatArray, eta: FloatArray, v: FloatArray
) -> Gap:
    """The field made of the declared B+ moves along with left translations."""
    plus, y = view.space.trivialised_tangent_plus, view.end(x, xi)
    product = view.space.multiply(view.space.retract(x, xi), view.space.retract(y, eta))
    left = view.left_translation(x, xi, eta, plus(y, eta) @ v)
    return gap(left, plus(x, np.asarray(view.space.lift(product), dtype=float)) @ v)


@_on_pairs("T r_h (X<-(g)) = X<-(g h), T beta (X<-(g)) = 0", "composable g, h, X in Gamma(AG)",
           "Section 8.1: right-invariant")
def right_invariance(
    view: Algebroid, x: FloatArray, xi: FloatArray, eta: FloatArray, v: FloatArray
) -> Gap:
    """The field made of the declared rho and B- moves along with right translations."""
    space, y = view.space, view.end(x, xi)
    product = space.multiply(space.retract(x, xi), space.retract(y, eta))
    whole = np.asarray(space.lift(product), dtype=float)
    moved = -view.anchor(x, v)
    field = np.concatenate([moved, -space.trivialised_tangent_minus(x, xi) @ v])
    then = np.concatenate([moved, -space.trivialised_tangent_minus(x, whole) @ v])
    left = view.right_translation(x, xi, y, eta, field)
    end = view.end_along(x, xi, *view.cut(field))
    return gap(np.concatenate([left, end]), np.concatenate([then, 0.0 * end]))


@_on_sections("[X->, Y->] = [[X, Y]]->", "X, Y in Gamma(AG)", "Section 8.1: the bracket of AG")
def left_fields_close(
    view: Algebroid, x: FloatArray, xi: FloatArray, first: FloatArray, second: FloatArray,
    waves: FloatArray,
) -> Gap:
    """The bracket of left-invariant fields is that of the declared bracket and anchor."""
    one, two = _two(first, second, waves)
    left = bracket_of_fields(LeftField(view, one), LeftField(view, two), x, xi)
    bracket = view.bracket_of_sections(one, two, view.end(x, xi))
    return gap(left, np.concatenate([0.0 * x, view.plus(x, xi, bracket)]))


@_on_sections("[X<-, Y<-] = -[[X, Y]]<-", "X, Y in Gamma(AG)", "Section 8.1, last display")
def right_fields_close(
    view: Algebroid, x: FloatArray, xi: FloatArray, first: FloatArray, second: FloatArray,
    waves: FloatArray,
) -> Gap:
    """The bracket of right-invariant fields is minus that of the declared bracket and anchor."""
    one, two = _two(first, second, waves)
    left = bracket_of_fields(RightField(view, one), RightField(view, two), x, xi)
    return gap(left, view.minus(x, xi, view.bracket_of_sections(one, two, x)))


@_on_sections("[X->, Y<-] = 0", "X, Y in Gamma(AG)", "Section 8.1, last display")
def left_and_right_commute(
    view: Algebroid, x: FloatArray, xi: FloatArray, first: FloatArray, second: FloatArray,
    waves: FloatArray,
) -> Gap:
    """What is done at one end does not see what is done at the other."""
    one, two = _two(first, second, waves)
    u, v = LeftField(view, one), RightField(view, two)
    change, back = v.along(x, xi, u.at(x, xi)), u.along(x, xi, v.at(x, xi))
    return gap(change, back)


@_on_arrows("T beta (X->(g)) = rho(X)(beta(g))", "g in G, X in Gamma(AG)",
            "Section 8.1: rho(X) = T beta X", applies=needs_a_base)
def targets_follow_the_anchor(
    view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray
) -> Gap:
    """Along the field made of the declared B+, the target moves by the declared anchor."""
    change = view.space.trivialised_tangent_plus(x, xi) @ v
    return gap(view.end_along(x, xi, 0.0 * x, change), view.anchor(view.end(x, xi), v))


# The algebroid.


@_on_sections("rho([[X, Y]]) = [rho(X), rho(Y)]", "X, Y in Gamma(AG)",
              "Section 8.1: T beta of [X->, Y->]", applies=needs_a_base)
def anchor_is_a_morphism(
    view: Algebroid, x: FloatArray, xi: FloatArray, first: FloatArray, second: FloatArray,
    waves: FloatArray,
) -> Gap:
    """The anchor maps the declared bracket to the bracket of vector fields on Q."""
    one, two = _two(first, second, waves)
    u, v = (view.anchor(x, section.at(x)) for section in (one, two))

    def slope(section: Section, dx: FloatArray) -> FloatArray:
        change = view.anchor_along(x, section.at(x), dx)
        return change + view.anchor(x, section.along(x, dx))

    left = view.anchor(x, view.bracket_of_sections(one, two, x))
    return gap(left, slope(two, u) - slope(one, v))


@_on_fibres("[u, v] = -[v, u]", "u, v in A_x G", "Section 8.1: a Lie bracket")
def bracket_is_antisymmetric(
    view: Algebroid, x: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray
) -> Gap:
    """The declared bracket changes sign with the order."""
    return gap(view.bracket(x, u, v), -view.bracket(x, v, u))


@_on_sections("[X->, (f Y)->] = (f [[X, Y]] + (rho(X) f) Y)->", "X, Y in Gamma(AG), f on Q",
              "Leibniz rule of an algebroid", applies=needs_a_base)
def leibniz(
    view: Algebroid, x: FloatArray, xi: FloatArray, first: FloatArray, second: FloatArray,
    waves: FloatArray,
) -> Gap:
    """Functions come out of the bracket of fields by the declared anchor."""
    one, two = _two(first, second, waves)
    scaled, y = Multiple(two, waves[2], _SHIFTS[2]), view.end(x, xi)
    left = bracket_of_fields(LeftField(view, one), LeftField(view, scaled), x, xi)
    inner = scaled.factor(y) * view.bracket_of_sections(one, two, y)
    outer = scaled.slope(y, view.anchor(y, one.at(y))) * two.at(y)
    return gap(left, np.concatenate([0.0 * x, view.plus(x, xi, inner + outer)]))


@_on_fibres("[[u, [[v, w]]]] + [[v, [[w, u]]]] + [[w, [[u, v]]]] = 0",
            "u, v, w in Gamma(AG) with constant components", "Section 8.1: a Lie bracket")
def jacobi_identity(
    view: Algebroid, x: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray
) -> Gap:
    """The declared structure functions, with their change along the anchor."""
    def double(u: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
        outer = view.bracket(x, u, view.bracket(x, v, w))
        return outer + view.bracket_along(x, v, w, view.anchor(x, u))

    return gap(double(u, v, w) + double(v, w, u), -double(w, u, v))


@_on_arrows("B+(x, 0) = 1, B-(x, 0) = -1", "x in Q",
            "the frame of the retraction is the frame e_a")
def frame_at_identities(
    view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray
) -> Gap:
    """At identities, lengthening by e_a changes the a-th component."""
    still, one = 0.0 * xi, np.eye(view.space.rank)
    left = [view.space.trivialised_tangent_plus(x, still),
            view.space.trivialised_tangent_minus(x, still)]
    return gap(np.stack(left), np.stack([one, -one]))


# Closed forms against derivatives of the seven functions.


@_on_arrows("rho(x) v = d/de beta(retract(x, e v))", "v in A_x G",
            "Section 8.1: rho(X) = T beta X",
            applies=lambda view: needs_a_base(view) or declares("anchor")(view))
def declared_anchor(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """The closed form of the anchor is the recorded derivative."""
    return gap(view.anchor(x, v), view.end_along(x, 0.0 * xi, 0.0 * x, v))


@_on_arrows("B+(x, xi) v = d/de lift(g retract(beta(g), e v))", "g = retract(x, xi), v in A G",
            "definition 9.1, on groupoids", applies=declares("trivialised_tangent_plus"))
def declared_plus(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """The closed form of B+ is the recorded derivative."""
    return gap(view.space.trivialised_tangent_plus(x, xi) @ v, view.plus(x, xi, v))


@_on_arrows("B-(x, xi) v = d/de lift(retract(x, e v)^-1 g)", "g = retract(x, xi), v in A_x G",
            "definition 9.1, on groupoids", applies=declares("trivialised_tangent_minus"))
def declared_minus(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """The closed form of B- is the recorded derivative."""
    right = view.cut(view.minus(x, xi, v))[1]
    return gap(view.space.trivialised_tangent_minus(x, xi) @ v, right)


@_on_fibres("[u, v] = D_xi(B+ v) u - D_xi(B+ u) v at xi = 0", "u, v with constant components",
            "Section 8.1: [X->, Y->] at identities", applies=declares("bracket"))
def declared_bracket(
    view: Algebroid, x: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray
) -> Gap:
    """The closed form of the bracket is the recorded derivative."""
    return gap(view.bracket(x, u, v), view.derived_bracket(x, u, v))


@_on_arrows("B-(x, xi) T^T v = -B+(x, xi) v", "T = coadjoint(x, xi), v in A G",
            "Lemma 9.5: B+ = -B- Ad, T = Ad^T", applies=declares("coadjoint"))
def declared_coadjoint(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """The closed form of the momentum transport is that of the two derivatives."""
    carried = np.asarray(view.space.coadjoint(x, xi), dtype=float).T @ v
    return gap(view.cut(view.minus(x, xi, carried))[1], -view.plus(x, xi, v))


@_on_fibres("<ad*_u p, w> = <p, [u, w]>", "u, w in A_x G, p in A*_x G",
            "equations (2a) on AG", applies=declares("ad_star"))
def declared_ad_star(
    view: Algebroid, x: FloatArray, u: FloatArray, v: FloatArray, w: FloatArray
) -> Gap:
    """The closed form of the rate of a momentum is that of the recorded bracket."""
    left = np.asarray(view.space.ad_star(x, u, v), dtype=float) @ w
    return gap(left, v @ view.derived_bracket(x, u, w))


@_exact("half(x, xi) = lim eta + (lift(retract(x, eta)^-1 g) - eta)/2 + ...",
        "g = retract(x, xi), up to 0.3 of the reach", "the half arrow, by iteration",
        draw=never_small, share=0.3, applies=declares("half"))
def declared_half(view: Algebroid, x: FloatArray, xi: FloatArray) -> Gap:
    """The closed form of the half arrow is the limit of the iteration that needs none."""
    space, xi = view.space, _SHORT * xi
    g = space.retract(x, xi)

    def remainder(eta: FloatArray) -> FloatArray:
        return np.asarray(space.lift(space.multiply(space.inverse(space.retract(x, eta)), g)))

    right = half_by_iteration(xi, remainder, partial(view.derived_bracket, x))
    return gap(space.half(x, xi), right)


# Definitions by differences of the plain functions, without any recording.


@_numerical("rho(x) v = d/de beta(retract(x, e v))", "v in A_x G",
            "Section 8.1: rho(X) = T beta X", applies=needs_a_base)
def anchor_by_differences(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """The anchor is how targets move when arrows leave the identity."""
    right = central_difference(lambda e: view.end(x, e[0] * v), [0.0])
    return gap(view.anchor(x, v), right[:, 0])


@_numerical("B+(x, xi) v = d/de lift(g retract(beta(g), e v))", "g = retract(x, xi), v in A G",
            "definition 9.1, on groupoids")
def plus_by_differences(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """B+ is how the components change when the end of an arrow moves."""
    space, y = view.space, view.end(x, xi)
    g = space.retract(x, xi)
    right = central_difference(
        lambda e: space.lift(space.multiply(g, space.retract(y, e[0] * v))), [0.0]
    )
    return gap(space.trivialised_tangent_plus(x, xi) @ v, right[:, 0])


@_numerical("B-(x, xi) v = d/de lift(retract(x, e v)^-1 g)", "g = retract(x, xi), v in A_x G",
            "definition 9.1, on groupoids")
def minus_by_differences(view: Algebroid, x: FloatArray, xi: FloatArray, v: FloatArray) -> Gap:
    """B- is how the components change when the start of an arrow moves."""
    space = view.space
    g = space.retract(x, xi)
    right = central_difference(
        lambda e: space.lift(space.multiply(space.inverse(space.retract(x, e[0] * v)), g)), [0.0]
    )
    return gap(space.trivialised_tangent_minus(x, xi) @ v, right[:, 0])


ALGEBROID_LAWS = (
    left_invariance, right_invariance, left_fields_close, right_fields_close,
    left_and_right_commute, targets_follow_the_anchor,
    anchor_is_a_morphism, bracket_is_antisymmetric, leibniz, jacobi_identity, frame_at_identities,
    declared_anchor, declared_plus, declared_minus, declared_bracket, declared_coadjoint,
    declared_ad_star, declared_half,
    anchor_by_differences, plus_by_differences, minus_by_differences,
)
