"""Retractions and Lie groups broken on purpose, one mistake each, with the laws that catch it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from broken import EXAMPLES, Broken

import groupoid_gni as gni
from groupoid_gni.expressions import arctan_ratio, versine_of_square
from groupoid_gni.verification import LawReport, check_retraction


def report(subject: gni.LieGroupoid) -> LawReport:
    """Half of the examples will do: these mistakes show at nearly every sample."""
    return check_retraction(subject, on_fail="return", examples=EXAMPLES // 2)


def group(
    base: type[Any], retraction: gni.Retraction, side: str = "left", **functions: Any
) -> Callable[[], LawReport]:
    """The check of a group with some functions replaced, made anew."""
    return lambda: report(type(f"Broken{base.__name__}", (base,), functions)(
        side=side, retraction=retraction
    ))


CAYLEY, EXPONENTIAL = gni.Cayley(), gni.Exponential()


# Retractions.


@dataclass(frozen=True)
class TwiceAsFast(gni.Retraction):
    """(1 - xi)^-1 (1 + xi), everything else derived from it."""

    def tau(self, group: gni.LieGroup, xi: Any) -> Any:
        return group.cay(2 * xi)

    def inverse(self, group: gni.LieGroup, element: Any) -> Any:
        return group.cay_inverse(element) / 2


@dataclass(frozen=True)
class CayleyWithoutTheHalf(gni.Cayley):
    """(1 - xi)^-1 (1 + xi) with the tangents of the Cayley map."""

    def tau(self, group: gni.LieGroup, xi: Any) -> Any:
        return group.cay(2 * xi)

    def inverse(self, group: gni.LieGroup, element: Any) -> Any:
        return group.cay_inverse(element) / 2


@dataclass(frozen=True)
class Bent(gni.Retraction):
    """cay(xi + xi^2/10), component by component."""

    def tau(self, group: gni.LieGroup, xi: Any) -> Any:
        return group.cay(xi + xi * xi / 10)

    def inverse(self, group: gni.LieGroup, element: Any) -> Any:
        y = group.cay_inverse(element)
        return 2 * y / (1 + np.sqrt(1 + y / 2.5))


@dataclass(frozen=True)
class HalfOfTheVelocity(gni.Cayley):
    """xi/2 as the half of xi, as if cay were exp."""

    def half(self, group: gni.LieGroup, xi: Any) -> Any:
        return xi / 2


@dataclass(frozen=True)
class ThreeTerms(gni.Exponential):
    """1 + xi + xi^2/2 + xi^3/6."""

    def tau(self, group: gni.LieGroup, xi: Any) -> Any:
        matrix, one = group.hat(xi), group.identity_element
        return one + matrix @ (one + matrix @ (one + matrix / 3) / 2)


# Functions of SO(3) and SE(2).


def norm(xi: Any) -> Any:
    return np.sqrt((xi * xi).sum(axis=-1, keepdims=True))[..., None]


def rodrigues(self: gni.SO3, xi: Any) -> Any:
    """Divides by |xi|."""
    angle, w = norm(xi), self.hat(xi)
    return np.eye(3) + np.sin(angle) / angle * w + (1 - np.cos(angle)) / angle**2 * (w @ w)


def dexp_inverse_by_cotangent(self: gni.SO3, xi: Any) -> Any:
    """Divides by |xi|."""
    angle, w = norm(xi), self.hat(xi)
    cotangent = np.cos(angle / 2) / np.sin(angle / 2)
    return np.eye(3) - w / 2 + (1 - angle / 2 * cotangent) / angle**2 * (w @ w)


def dexp_truncated(self: gni.SO3, xi: Any) -> Any:
    ad = self.ad(xi)
    return np.eye(3) + ad / 2 + ad @ ad / 6


def log_by_trace(self: gni.SO3, element: Any) -> Any:
    """Through q0 = sqrt(1 + tr)/2, which is nothing at a half turn."""
    r = element
    axis = self.vee(r - transposed(r))
    q0 = np.sqrt(1 + r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2])[..., None] / 2
    v = axis / (4 * q0)
    tangent = (v * v).sum(axis=-1, keepdims=True) / (1 + q0) ** 2
    return v / (1 + q0) * (4 * arctan_ratio(tangent))


def dexp_by_one_minus_cosine(self: gni.SO3, xi: Any) -> Any:
    """(1 - cos t)/t^2 as it is printed, with t = 0 left out."""
    square = (xi * xi).sum(axis=-1, keepdims=True)[..., None]
    versine = gni.where(square == 0, 0.5, (1 - np.cos(np.sqrt(square))) / square)
    w = self.hat(xi)
    return gni.SO3.dexp(self, xi) + (versine - versine_of_square(square)) * w


def log_that_divides_by_the_norm(self: gni.SO3, element: Any) -> Any:
    """Where |w|^2 underflows, w counts as zero."""
    w = gni.SO3.log(self, element)
    square = (w * w).sum(axis=-1, keepdims=True)
    return gni.where(square < 1e-300, 0.0 * w, w)


def translation_as_it_is(self: gni.SE2, element: Any) -> Any:
    """The lift that forgets (1 - w J/2)."""
    angle = gni.SE2().cay_inverse(element)[..., :1]
    return np.concatenate([angle, element[..., :2, 2]], axis=-1)


def overshoot(self: gni.SO2, element: Any) -> Any:
    """The Newton step of the polar projection, backwards."""
    return element - element @ (np.eye(2) - transposed(element) @ element) / 2


def transposed(matrix: Any) -> Any:
    return np.swapaxes(matrix, -1, -2)


# Groupoids.


class Plane(gni.LieGroupoid):
    """A sound pair groupoid of R^2."""

    rank = 2
    example_base_point = np.array([0.3, -0.7])

    def source(self, g: Any) -> Any:
        return g[:2]

    def target(self, g: Any) -> Any:
        return g[2:]

    def identity(self, x: Any) -> Any:
        return np.concatenate([x, x])

    def multiply(self, g: Any, h: Any) -> Any:
        return np.concatenate([g[:2], h[2:]])

    def inverse(self, g: Any) -> Any:
        return np.concatenate([g[2:], g[:2]])

    def retract(self, x: Any, xi: Any) -> Any:
        return np.concatenate([x, x + xi])

    def lift(self, g: Any) -> Any:
        return g[2:] - g[:2]


def turned(x: Any, v: Any) -> Any:
    c, s = np.cos(x[0] / 2), np.sin(x[0] / 2)
    return gni.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


class FrameOfTheStart(Plane):
    """The frame is taken where the arrow starts, so the way back has another one."""

    def retract(self, x: Any, xi: Any) -> Any:
        return np.concatenate([x, x + turned(x, xi)])

    def lift(self, g: Any) -> Any:
        return turned(-g[:2], g[2:] - g[:2])


class AroundTheMiddle(Plane):
    """x is the middle of the arrow, not its source."""

    def retract(self, x: Any, xi: Any) -> Any:
        return np.concatenate([x - xi / 2, x + xi / 2])


_OF_B_PLUS = {
    "tangent_plus_is_the_derivative", "lemma_9_5_on_arrows", "momentum_transport",
    "tangents_near_the_edge",
}
_OF_B_MINUS = {
    "tangent_minus_is_the_derivative", "lemma_9_5_on_arrows", "momentum_transport",
    "tangents_near_the_edge",
}
_OF_DTAU = {"lemma_9_4", "dtau_by_definition", "dtau_by_differences", "lemma_9_5_tangent"}
_OF_DTAU_INVERSE = {*_OF_B_PLUS, *_OF_B_MINUS, "dtau_inverse_by_definition", "lemma_9_5_inverse"}
_OF_AD = {
    "adjoint_is_conjugation", "adjoint_is_a_representation", "lemma_9_3", "lemma_9_4",
    "lemma_9_5_tangent", "lemma_9_5_inverse",
}
_OF_LIFT = {
    "lift_undoes_retraction", "retraction_undoes_lift", "tangent_plus_is_the_derivative",
    "tangent_minus_is_the_derivative", "accuracy_near_zero", "accuracy_near_the_edge",
    "tangents_near_the_edge", "dtau_inverse_by_definition",
}

BROKEN = [
    Broken(  # dtau^-1 by (52) has tau(e), which moves by 2 e: it is half of what (51) asks for
        "Cayley map without the factor 1/2, the rest derived from it",
        group(gni.SO3, TwiceAsFast()),
        frozenset({"tau_to_first_order", "lemma_9_3", *_OF_DTAU} - {"lemma_9_5_tangent"}),
    ),
    Broken(
        "Cayley map without the factor 1/2, its tangents and half with it",
        group(gni.SO3, CayleyWithoutTheHalf()),
        frozenset({
            "tau_to_first_order", "lemma_9_3", *_OF_DTAU, *_OF_DTAU_INVERSE, "half_arrows",
            "half_vectors", "cayley_is_the_quotient", "cayley_on_rotations",
        }),
    ),
    Broken(  # B- and dtau by their definitions do not ask for symmetry
        "a retraction that is not symmetric, tau(xi + xi^2/10)",
        group(gni.SO3, Bent()),
        frozenset({
            "symmetry", "tau_of_minus", "half_arrows", "half_vectors",
            "tangent_plus_is_the_derivative", "lemma_9_5_on_arrows", "momentum_transport",
            "lemma_9_5_tangent", "lemma_9_5_inverse",
        }),
    ),
    Broken(
        "xi/2 as the half of a Cayley vector",
        group(gni.SO2, HalfOfTheVelocity()),
        frozenset({"half_arrows", "half_vectors"}),
    ),
    Broken(  # angles still add, so B+ and B- are right; the transpose of tau(xi) is tau(-xi)
        "exponential series cut after xi^3, so that elements leave the group",
        group(gni.SO2, ThreeTerms()),
        frozenset({
            "lift_undoes_retraction", "retraction_undoes_lift", "half_arrows",
            "accuracy_near_zero", "accuracy_near_the_edge", "tau_of_minus",
            "elements_stay_in_the_group", "determinant_is_one", "restoration_converges",
            "half_vectors", "dtau_by_definition", "dtau_by_differences", "exponential_is_expm",
        }),
    ),
    Broken(
        "transposed Ad",
        group(gni.SO3, CAYLEY, Ad=lambda self, g: transposed(g)),
        frozenset(_OF_AD),
    ),
    Broken(
        "Ad to first order, 1 + ad",
        group(gni.SO3, CAYLEY, Ad=lambda self, g: np.eye(3) + (g - transposed(g)) / 2),
        frozenset({*_OF_AD, "adjoint_keeps_brackets"}),
    ),
    Broken(
        "sign of the bracket, as on a right group",
        group(gni.SO3, CAYLEY, ad=lambda self, xi: -self.hat(xi)),
        frozenset({"ad_is_the_commutator", "lemma_9_3", "lemma_9_4"}),
    ),
    Broken(
        "left-trivialised tangents given for the right ones",
        group(
            gni.SO3, EXPONENTIAL,
            dexp=lambda self, xi: gni.SO3.dexp(self, -xi),
            dexp_inverse=lambda self, xi: gni.SO3.dexp_inverse(self, -xi),
        ),
        frozenset({*_OF_DTAU, *_OF_DTAU_INVERSE, "dexp_series", "dexp_inverse_series"}),
    ),
    Broken(
        "dexp and its inverse exchanged",
        group(gni.SO3, EXPONENTIAL, dexp=gni.SO3.dexp_inverse, dexp_inverse=gni.SO3.dexp),
        frozenset({*_OF_DTAU, *_OF_DTAU_INVERSE, "dexp_series", "dexp_inverse_series"}),
    ),
    Broken(
        "dtau given for dtau^-1",
        group(gni.SO3, CAYLEY, dcay_inverse=gni.SO3.dcay),
        frozenset({
            *_OF_DTAU_INVERSE, "tangents_are_inverse", "dcay_inverse_formula",
            "cayley_on_rotations",
        }),
    ),
    Broken(
        "factors of dcay in the wrong order",
        group(gni.SO3, CAYLEY, dcay=lambda self, xi: gni.SO3.dcay(self, -xi)),
        frozenset({*_OF_DTAU, "tangents_are_inverse", "dcay_formula", "cayley_on_rotations"}),
    ),
    Broken(
        "series of dexp cut after ad^2",
        group(gni.SO3, EXPONENTIAL, dexp=dexp_truncated),
        frozenset({*_OF_DTAU, "tangents_are_inverse", "dexp_series"}),
    ),
    Broken(
        "sign of ad/2 in dexp^-1",
        group(
            gni.SO3, EXPONENTIAL,
            dexp_inverse=lambda self, xi: gni.SO3.dexp_inverse(self, -xi),
        ),
        frozenset({*_OF_DTAU_INVERSE, "tangents_are_inverse", "dexp_inverse_series"}),
    ),
    Broken(
        "logarithm through 1 + tr, which loses its digits near a half turn",
        group(gni.SO3, EXPONENTIAL, log=log_by_trace),
        frozenset({"accuracy_near_the_edge", "tangents_near_the_edge"}),
    ),
    Broken(  # wrong by 1e-9 at |xi| = 1e-8 only
        "dexp with 1 - cos, which loses its digits near 0",
        group(gni.SO3, EXPONENTIAL, dexp=dexp_by_one_minus_cosine),
        frozenset({"tangents_are_inverse", "lemma_9_5_tangent"}),
    ),
    Broken(
        "logarithm that takes 1e-160 for 0",
        group(gni.SO3, EXPONENTIAL, log=log_that_divides_by_the_norm),
        frozenset({"accuracy_near_zero"}),
    ),
    Broken(
        "exponential that divides by |xi|, NaN at 0",
        group(gni.SO3, EXPONENTIAL, exp=rodrigues),
        frozenset({
            "retraction_of_zero", "symmetry", "lift_undoes_retraction", "retraction_undoes_lift",
            "half_arrows", "accuracy_near_zero", "tau_of_zero", "tau_of_minus",
            "elements_stay_in_the_group", "determinant_is_one", "restoration_converges",
            "half_vectors", "adjoint_is_a_representation", "lemma_9_5_tangent",
            "lemma_9_5_inverse",
        }),
    ),
    Broken(
        "dexp^-1 that divides by |xi|, NaN at 0",
        group(gni.SO3, EXPONENTIAL, dexp_inverse=dexp_inverse_by_cotangent),
        frozenset({
            "tangents_change_places", "tangents_at_zero", "tangents_are_inverse",
            "tangent_at_zero", "lemma_9_5_inverse",
        }),
    ),
    Broken(
        "lift on SE(2) that takes the translation as it is",
        group(gni.SE2, CAYLEY, cay_inverse=translation_as_it_is),
        frozenset(_OF_LIFT),
    ),
    Broken(
        "restoration with the wrong sign",
        group(gni.SO2, CAYLEY, restore_element=overshoot),
        frozenset({"restoration_converges"}),
    ),
    Broken(
        "B+ of a right group on a left one",
        group(
            gni.SO3, CAYLEY,
            trivialised_tangent_plus=lambda self, x, xi: self.dtau_inverse(xi),
        ),
        frozenset({*_OF_B_PLUS, "tangents_change_places"}),
    ),
    Broken(
        "B- of a right group on a left one",
        group(
            gni.SO3, CAYLEY,
            trivialised_tangent_minus=lambda self, x, xi: -self.dtau_inverse(-xi),
        ),
        frozenset({*_OF_B_MINUS, "tangents_change_places"}),
    ),
    Broken(
        "B- without its minus on a right group",
        group(
            gni.SO3, CAYLEY, "right",
            trivialised_tangent_minus=lambda self, x, xi: self.dtau_inverse(-xi),
        ),
        frozenset({*_OF_B_MINUS, "tangents_change_places", "tangents_at_zero"}),
    ),
    Broken(
        "a frame that turns with the start of an arrow",
        lambda: report(FrameOfTheStart()),
        frozenset({
            "symmetry", "tangents_change_places", "lemma_9_5_on_arrows", "momentum_transport",
        }),
    ),
    Broken(
        "arrows that have x in their middle",
        lambda: report(AroundTheMiddle()),
        frozenset({
            "source_of_retraction", "symmetry", "retraction_undoes_lift", "half_arrows",
            "tangents_at_zero", "tangent_plus_is_the_derivative",
            "tangent_minus_is_the_derivative", "lemma_9_5_on_arrows", "momentum_transport",
        }),
    ),
]
