"""Groupoids broken on purpose, one mistake each, with the laws that must catch it."""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np
from broken import Broken

import groupoid_gni as gni
from groupoid_gni.verification import LawReport, check_groupoid, search

FEW = 8


class Translations(gni.LieGroupoid):
    """A sound pair groupoid of R^2, written with the seven functions only."""

    rank = 2
    example_base_point = np.array([0.3, -0.7])

    def source(self, g: Any) -> Any:
        return g[..., :2]

    def target(self, g: Any) -> Any:
        return g[..., 2:]

    def identity(self, x: Any) -> Any:
        return np.concatenate([x, x], axis=-1)

    def multiply(self, g: Any, h: Any) -> Any:
        return np.concatenate([g[..., :2], h[..., 2:]], axis=-1)

    def inverse(self, g: Any) -> Any:
        return np.concatenate([g[..., 2:], g[..., :2]], axis=-1)

    def retract(self, x: Any, xi: Any) -> Any:
        return np.concatenate([x, x + xi], axis=-1)

    def lift(self, g: Any) -> Any:
        return g[..., 2:] - g[..., :2]


class Line(gni.LieGroupoid):
    """A sound groupoid R x R x R => R: pairs of points with a phase, (a, b, s)(b, c, t)."""

    rank = 2
    example_base_point = np.array([0.4])

    def source(self, g: Any) -> Any:
        return g[:1]

    def target(self, g: Any) -> Any:
        return g[1:2]

    def identity(self, x: Any) -> Any:
        return np.concatenate([x, x, 0 * x])

    def multiply(self, g: Any, h: Any) -> Any:
        return gni.array([g[0], h[1], g[2] + h[2]])

    def inverse(self, g: Any) -> Any:
        return gni.array([g[1], g[0], -g[2]])

    def retract(self, x: Any, xi: Any) -> Any:
        return np.concatenate([x, x + xi[:1], xi[1:]])

    def lift(self, g: Any) -> Any:
        return gni.array([g[1] - g[0], g[2]])


def variant(sound: type[gni.LieGroupoid] = Translations, **functions: Any) -> gni.LieGroupoid:
    """A sound groupoid with some functions replaced."""
    made = type("Broken" + "And".join(functions), (sound,), functions)()
    assert isinstance(made, gni.LieGroupoid)
    return made


def report(space: gni.LieGroupoid) -> LawReport:
    """All laws, on few examples and without making failures small, which takes most of the time."""
    with patch.object(search, "_shrink"):
        return check_groupoid(space, on_fail="return", examples=FEW)


def broken(mistake: str, make: Any, *caught_by: str) -> Broken:
    return Broken(mistake, lambda: report(make()), frozenset(caught_by))


def join(*parts: Any) -> Any:
    return np.concatenate(parts, axis=-1)


def skewed(self: Any, g: Any, h: Any) -> Any:
    """A phase c = u v (u^2 - v^2), u and v the shifts: zero with an identity or an inverse."""
    u, v = g[1] - g[0], h[1] - h[0]
    return gni.array([g[0], h[1], g[2] + h[2] + u * v * (u * u - v * v)])


def late(self: Any, g: Any, h: Any) -> Any:
    """The second phase counted one and a half times."""
    return gni.array([g[0], h[1], g[2] + 1.5 * h[2]])


def tidied(self: Any, g: Any) -> Any:
    """Rounded, but only when it is run plainly."""
    vector = g[..., 2:] - g[..., :2]
    return vector if vector.dtype == object else np.round(vector, 9)


def branching(self: Any, x: Any, xi: Any) -> Any:
    """Another formula for long steps, chosen by an if."""
    if xi[0] > 2.0:
        return join(x, x + 2.0)
    return join(x, x + xi)


def unchecked() -> gni.LieGroupoid:
    """A multiply put in afterwards, without the check of the base class."""
    space = variant(multiply=Translations._multiply_unchecked)
    type(space).multiply = Translations._multiply_unchecked  # type: ignore[method-assign]
    return space


def left_action_of_a_left_group() -> gni.LieGroupoid:
    return gni.ActionGroupoid(
        gni.SO3(), lambda q, rotation: (rotation @ q[..., None])[..., 0], [0.48, 0.6, 0.64]
    )


class StartsWhereItShouldEnd(gni.ActionGroupoid):
    def arrow_to(self, base_point: Any, pose: Any = None) -> Any:
        if pose is None:
            return self.identity(base_point)
        return join(base_point, np.ravel(pose))


class TransposedPose(gni.AtiyahGroupoid):
    def pose(self, arrow: Any) -> Any:
        return np.swapaxes(super().pose(arrow), -1, -2)


def turned_back(q: Any, rotation: Any) -> Any:
    return (q[..., None, :] @ rotation)[..., 0, :]


BROKEN = [
    broken(
        "identity that drifts at its end",
        lambda: variant(identity=lambda self, x: join(x, x + 0.1)),
        "left_inverse", "left_unit", "right_inverse", "right_unit", "target_of_identity",
    ),
    broken(
        "identity that starts elsewhere",
        lambda: variant(identity=lambda self, x: join(x + 0.1, x)),
        "arrows_end_on_the_base", "left_inverse", "left_unit", "right_inverse", "right_unit",
        "source_of_identity",
    ),
    broken(
        "identity with a phase",
        lambda: variant(Line, identity=lambda self, x: join(x, x, 0 * x + 0.1)),
        "left_inverse", "left_unit", "right_inverse", "right_unit",
    ),
    broken(
        "product that forgets its first factor",
        lambda: variant(multiply=lambda self, g, h: h),
        "associativity", "diagrammatic_order", "frame_at_identities", "inverse_of_product",
        "left_inverse", "left_unit", "restoration_moves_nothing", "right_invariance",
        "right_inverse", "right_unit", "source_of_product",
    ),
    broken(
        "product that forgets its last factor",
        lambda: variant(multiply=lambda self, g, h: g),
        "associativity", "diagrammatic_order", "frame_at_identities", "inverse_of_product",
        "left_inverse", "left_unit", "restoration_moves_nothing", "right_inverse", "right_unit",
        "target_of_product", "targets_follow_the_anchor",
    ),
    broken(
        "reversed product of pairs",
        lambda: variant(multiply=lambda self, g, h: join(h[..., :2], g[..., 2:])),
        "associativity", "diagrammatic_order", "frame_at_identities", "left_inverse", "left_unit",
        "right_invariance", "right_inverse", "right_unit", "source_of_product", "target_of_product",
        "targets_follow_the_anchor",
    ),
    broken(
        "phase that is no cocycle",
        lambda: variant(Line, multiply=skewed),
        "associativity", "left_and_right_commute", "left_invariance", "right_invariance",
    ),
    broken(
        "phase of the second factor counted one and a half times",
        lambda: variant(Line, multiply=late),
        "associativity", "frame_at_identities", "inverse_of_product", "left_invariance",
        "left_inverse", "left_unit", "restoration_moves_nothing", "right_inverse", "right_unit",
    ),
    broken(
        "inverse that does not swap",
        lambda: variant(inverse=lambda self, g: g),
        "associativity", "ends_have_local_sections", "ends_of_inverse", "frame_at_identities",
        "inverse_of_product", "left_inverse", "left_unit", "minus_by_differences",
        "restoration_moves_nothing", "right_invariance", "right_inverse", "right_unit",
    ),
    broken(
        "inverse that keeps the phase",
        lambda: variant(Line, inverse=lambda self, g: gni.array([g[1], g[0], g[2]])),
        "associativity", "frame_at_identities", "inverse_of_product", "left_inverse", "left_unit",
        "restoration_moves_nothing", "right_inverse", "right_unit",
    ),
    broken(
        "target on the wrong side of the source",
        lambda: variant(target=lambda self, g: 2 * g[..., :2] - g[..., 2:]),
        "associativity", "diagrammatic_order", "ends_have_local_sections", "ends_of_inverse",
        "inverse_of_product", "left_and_right_commute", "left_inverse", "left_unit",
        "minus_by_differences", "restoration_moves_nothing", "right_fields_close",
        "right_invariance", "right_inverse", "right_unit", "target_of_product",
    ),
    broken(
        "retraction whose source moves",
        lambda: variant(retract=lambda self, x, xi: join(x + 0.1 * xi, x + xi)),
        "associativity", "diagrammatic_order", "ends_have_local_sections", "inverse_of_product",
        "left_invariance", "minus_by_differences", "plus_by_differences", "recorded_equals_plain",
        "right_invariance", "source_of_product", "target_of_product",
    ),
    broken(
        "left action of a left group",
        left_action_of_a_left_group,
        "anchor_is_a_morphism", "associativity", "diagrammatic_order", "inverse_of_product",
        "law_of_the_action", "left_and_right_commute", "left_fields_close", "leibniz",
        "right_fields_close", "right_invariance", "target_of_product", "targets_follow_the_anchor",
    ),
    broken(
        "multiply without the check of composability",
        unchecked,
        "strangers_are_refused",
    ),
    broken(
        "lift rounded in plain calls only",
        lambda: variant(lift=tidied),
        "minus_by_differences", "plus_by_differences", "recorded_equals_plain",
    ),
    broken(
        "retraction with an if",
        lambda: variant(retract=branching),
        "anchor_by_differences", "anchor_is_a_morphism", "bracket_is_antisymmetric",
        "frame_at_identities", "jacobi_identity", "left_and_right_commute", "left_fields_close",
        "left_invariance", "leibniz", "minus_by_differences", "plus_by_differences",
        "recorded_equals_plain", "right_fields_close", "right_invariance",
        "targets_follow_the_anchor",
    ),
    broken(
        "restore_base that moves points",
        lambda: variant(restore_base=lambda self, x: (1 + 1e-9) * x),
        "restoration_moves_nothing",
    ),
    broken(
        "restore_arrow that moves arrows",
        lambda: variant(restore_arrow=lambda self, g: (1 + 1e-9) * g),
        "restoration_moves_nothing",
    ),
    broken(
        "base_defect of another manifold",
        lambda: variant(base_defect=lambda self, x: (x * x).sum(axis=-1) - 1),
        "arrows_end_on_the_base",
    ),
    broken(
        "arrow_to that starts at the point",
        lambda: StartsWhereItShouldEnd(gni.SO3(), turned_back, [0.48, 0.6, 0.64]),
        "poses_make_arrows", "reconstruction_order",
    ),
    broken(
        "transposed pose",
        lambda: TransposedPose(1, gni.SO3()),
        "poses_make_arrows", "reconstruction_order",
    ),
]
