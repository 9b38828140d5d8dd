"""Closed forms that are wrong: anchor, bracket, B+, B- and half, with the laws that must tell."""

from __future__ import annotations

from typing import Any

import numpy as np
from broken_groupoids import broken, variant

import groupoid_gni as gni


class HalfPlane(gni.LieGroupoid):
    """Pairs of points (a, b), a > 0, in the frame a d/da, a d/db: [e1, e2] = e2, closed forms."""

    rank = 2
    example_base_point = np.array([1.3, -0.4])

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
        growth = (1 + xi[0] / 2) / (1 - xi[0] / 2)
        return gni.array([x[0], x[1], x[0] * growth, x[1] + xi[1] * x[0] * (1 + growth) / 2])

    def lift(self, g: Any) -> Any:
        mean = (g[0] + g[2]) / 2
        return gni.array([(g[2] - g[0]) / mean, (g[3] - g[1]) / mean])

    def anchor(self, x: Any) -> Any:
        return x[0] * np.eye(2)

    def bracket(self, x: Any) -> Any:
        return SOLVABLE

    def trivialised_tangent_plus(self, x: Any, xi: Any) -> Any:
        s, t = xi / 2
        return gni.array([[1 - s * s, 0], [-t * (1 + s), 1 + s]])

    def trivialised_tangent_minus(self, x: Any, xi: Any) -> Any:
        s, t = xi / 2
        return gni.array([[s * s - 1, 0], [-t * (1 - s), s - 1]])

    def half(self, x: Any, xi: Any) -> Any:
        s = xi[0] / 2
        root = np.sqrt(1 - s * s)
        return gni.array([2 * s / (1 + root), xi[1] / (1 + root)])


PLUS, MINUS = HalfPlane.trivialised_tangent_plus, HalfPlane.trivialised_tangent_minus
SOLVABLE = np.zeros((2, 2, 2))
SOLVABLE[1, 0, 1], SOLVABLE[1, 1, 0] = 1.0, -1.0
NO_ALGEBRA = gni.SE2().structure_constants.copy()
NO_ALGEBRA[0, 1, 2], NO_ALGEBRA[0, 2, 1] = 0.5, -0.5
NO_ALGEBRA[1, 1, 2], NO_ALGEBRA[1, 2, 1] = 0.5, -0.5


class RightSE2(gni.SE2):
    """Rigid motions of the plane, seen from space."""

    def __init__(self) -> None:
        super().__init__(side="right")


def closed(**functions: Any) -> gni.LieGroupoid:
    """The half plane with some closed forms replaced."""
    return variant(HalfPlane, **functions)


def of(kind: type[gni.LieGroupoid], *arguments: Any, **functions: Any) -> gni.LieGroupoid:
    """A built-in space with some functions replaced."""
    made = type("Broken" + kind.__name__, (kind,), functions)(*arguments)
    assert isinstance(made, gni.LieGroupoid)
    return made


BROKEN = [
    broken(
        "anchor with the wrong sign",
        lambda: closed(anchor=lambda self, x: -x[0] * np.eye(2)),
        "anchor_by_differences", "anchor_is_a_morphism", "declared_anchor", "left_fields_close",
        "leibniz", "right_fields_close", "right_invariance", "targets_follow_the_anchor",
    ),
    broken(
        "anchor of the pair groupoid in a moving frame",
        lambda: closed(anchor=lambda self, x: np.eye(2)),
        "anchor_by_differences", "anchor_is_a_morphism", "declared_anchor", "left_fields_close",
        "leibniz", "right_fields_close", "right_invariance", "targets_follow_the_anchor",
    ),
    broken(
        "anchor off by a millionth",
        lambda: closed(anchor=lambda self, x: 1.000001 * x[0] * np.eye(2)),
        "anchor_by_differences", "anchor_is_a_morphism", "declared_anchor", "left_fields_close",
        "leibniz", "right_fields_close", "right_invariance", "targets_follow_the_anchor",
    ),
    broken(
        "bracket with the wrong sign",
        lambda: closed(bracket=lambda self, x: -SOLVABLE),
        "anchor_is_a_morphism", "declared_bracket", "left_fields_close", "leibniz",
        "right_fields_close",
    ),
    broken(
        "bracket of the pair groupoid in a moving frame",
        lambda: closed(bracket=lambda self, x: 0 * SOLVABLE),
        "anchor_is_a_morphism", "declared_bracket", "left_fields_close", "leibniz",
        "right_fields_close",
    ),
    broken(
        "bracket with the result as its last index",
        lambda: closed(bracket=lambda self, x: np.moveaxis(SOLVABLE, 0, -1)),
        "anchor_is_a_morphism", "bracket_is_antisymmetric", "declared_bracket", "jacobi_identity",
        "left_fields_close", "leibniz", "right_fields_close",
    ),
    broken(
        "bracket of a right group without the minus",
        lambda: of(RightSE2, bracket=lambda self, x: self.structure_constants),
        "bracket_side", "declared_bracket", "left_fields_close", "right_fields_close",
    ),
    broken(
        "bracket that is none",
        lambda: of(gni.SE2, bracket=lambda self, x: NO_ALGEBRA),
        "bracket_side", "declared_bracket", "jacobi_identity", "left_fields_close",
        "right_fields_close",
    ),
    broken(
        "B+ with the wrong sign",
        lambda: closed(trivialised_tangent_plus=lambda self, x, xi: -PLUS(self, x, xi)),
        "declared_plus", "frame_at_identities", "plus_by_differences", "targets_follow_the_anchor",
    ),
    broken(
        "B+ transposed",
        lambda: closed(trivialised_tangent_plus=lambda self, x, xi: PLUS(self, x, xi).T),
        "declared_plus", "left_invariance", "plus_by_differences", "targets_follow_the_anchor",
    ),
    broken(
        "B+ of the wrong side",
        lambda: of(gni.SE2, trivialised_tangent_plus=lambda self, x, xi: self.dtau_inverse(xi)),
        "declared_plus", "left_invariance", "plus_by_differences", "tangents_by_side",
    ),
    broken(
        "B+ off by a millionth",
        lambda: closed(trivialised_tangent_plus=lambda self, x, xi: PLUS(self, x, 1.000001 * xi)),
        "declared_plus", "left_invariance", "plus_by_differences", "targets_follow_the_anchor",
    ),
    broken(
        "B- with the wrong sign",
        lambda: closed(trivialised_tangent_minus=lambda self, x, xi: -MINUS(self, x, xi)),
        "declared_minus", "frame_at_identities", "minus_by_differences", "right_invariance",
    ),
    broken(
        "B- transposed",
        lambda: closed(trivialised_tangent_minus=lambda self, x, xi: MINUS(self, x, xi).T),
        "declared_minus", "minus_by_differences", "right_invariance",
    ),
    broken(
        "momentum transport of the inverse arrow",
        lambda: of(gni.SO3, coadjoint=lambda self, x, xi: self.Ad(self.tau(xi))),
        "declared_coadjoint",
    ),
    broken(
        "momentum transport off by a millionth",
        lambda: of(
            RightSE2, coadjoint=lambda self, x, xi: RightSE2.coadjoint(self, x, 1.000001 * xi)
        ),
        "declared_coadjoint",
    ),
    broken(
        "rate of a momentum of the other side",
        lambda: of(RightSE2, ad_star=lambda self, x, xi, p: self.ad(xi).T @ p),
        "declared_ad_star",
    ),
    broken(
        "half of a Cayley vector as half the vector",
        lambda: of(gni.SO3, half=lambda self, x, xi: xi / 2),
        "declared_half",
    ),
    broken(
        "half arrow off by a millionth",
        lambda: closed(half=lambda self, x, xi: 1.000001 * HalfPlane.half(self, x, xi)),
        "declared_half",
    ),
]
