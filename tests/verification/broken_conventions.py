"""Sound groupoids of the wrong order, side, sign or scale, with the laws that must tell."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from broken_algebroids import of
from broken_groupoids import broken

import groupoid_gni as gni

CLOSED_FORMS = (
    "anchor", "trivialised_tangent_plus", "trivialised_tangent_minus", "bracket", "coadjoint",
    "ad_star", "half",
)
FORGOTTEN = {name: getattr(gni.LieGroupoid, name) for name in CLOSED_FORMS}
GENERAL = {
    name: getattr(gni.LieGroup, name)
    for name in (
        "ad", "Ad", "compose", "inverse_element", "exp", "log", "dexp", "dexp_inverse", "cay",
        "cay_inverse", "dcay", "dcay_inverse", "cay_half",
    )
}


def reversed_product(self: Any, g: Any, h: Any) -> Any:
    return self.flatten(self.compose(self.unflatten(h), self.unflatten(g)))


def with_the_opposite_hat(kind: Any) -> gni.LieGroupoid:
    """A group with hat and vee of the other sign, and everything else that follows from them."""
    return of(
        kind,
        hat=lambda self, xi: kind.hat(self, -xi),
        vee=lambda self, matrix: -kind.vee(self, matrix),
        **GENERAL,
    )


def column_by_column() -> gni.LieGroupoid:
    """SO(3) with matrices written column after column."""
    return of(
        gni.SO3,
        flatten=lambda self, element: gni.SO3.flatten(self, np.swapaxes(element, -1, -2)),
        unflatten=lambda self, arrow: np.swapaxes(gni.SO3.unflatten(self, arrow), -1, -2),
    )


def translation_first() -> gni.LieGroupoid:
    """SE(2) with components (v, w), and everything else that follows from it."""
    order, back = [2, 0, 1], [1, 2, 0]
    return of(
        gni.SE2,
        hat=lambda self, xi: gni.SE2.hat(self, xi[..., order]),
        vee=lambda self, matrix: gni.SE2.vee(self, matrix)[..., back],
        rotation_size=lambda self, xi: np.abs(xi[..., 2]),
        **GENERAL,
    )


class Doubled(gni.Retraction):
    """The Cayley map without its factor 1/2."""

    def tau(self, group: Any, xi: Any) -> Any:
        return group.cay(2 * xi)

    def inverse(self, group: Any, element: Any) -> Any:
        return group.cay_inverse(element) / 2


class GroupFirst(gni.AtiyahGroupoid):
    """Components (eta, v)."""

    def retract(self, x: Any, xi: Any) -> Any:
        return super().retract(x, xi[..., ::-1])

    def lift(self, g: Any) -> Any:
        return super().lift(g)[..., ::-1]


class SpaceFrame(gni.FramedPairGroupoid):
    """A left group, but retract(x, xi) = (x, tau(xi) x)."""

    def __init__(self) -> None:
        super().__init__(gni.SO3())
        self.right = gni.FramedPairGroupoid(gni.SO3(side="right"))

    def retract(self, x: Any, xi: Any) -> Any:
        return self.right.retract(x, xi)

    def lift(self, g: Any) -> Any:
        return self.right.lift(g)


class InversePose(gni.AtiyahGroupoid):
    """Poses seen from the body."""

    def pose(self, arrow: Any) -> Any:
        return np.swapaxes(super().pose(arrow), -1, -2)

    def arrow_to(self, base_point: Any, pose: Any = None) -> Any:
        return super().arrow_to(base_point, None if pose is None else np.asarray(pose).T)


def forgetting(kind: type[gni.LieGroupoid], *arguments: Any) -> Callable[[], gni.LieGroupoid]:
    return lambda: of(kind, *arguments, **FORGOTTEN)


BROKEN = [
    broken(
        "reversed product of a Lie group, consistently",
        lambda: of(gni.SO3, multiply=reversed_product, **FORGOTTEN),
        "bracket_side", "product_order", "reconstruction_order", "tangents_by_side",
        "velocity_side",
    ),
    broken(
        "reversed product of a Lie group, closed forms kept",
        lambda: of(gni.SO3, multiply=reversed_product),
        "declared_ad_star", "declared_bracket", "declared_coadjoint", "declared_minus",
        "declared_plus", "left_fields_close", "left_invariance", "minus_by_differences",
        "plus_by_differences", "product_order", "reconstruction_order", "right_fields_close",
        "right_invariance", "velocity_side",
    ),
    broken(
        "right-handed became left-handed",
        lambda: with_the_opposite_hat(gni.SO3),
        "hat_is_the_cross_product",
    ),
    broken(
        "clockwise angles",
        lambda: with_the_opposite_hat(gni.SO2),
        "plane_turns_counterclockwise",
    ),
    broken(
        "translation first",
        translation_first,
        "plane_turns_counterclockwise", "reach_of_half_a_turn", "rotation_first",
    ),
    broken(
        "hat transposed",
        lambda: of(gni.SE2, hat=lambda self, xi: -gni.SE2.hat(self, xi)),
        "bracket_side", "first_order_of_retraction", "hat_and_vee", "plane_turns_counterclockwise",
        "rotation_first", "structure_constants_of_matrices", "tangents_by_side", "velocity_side",
    ),
    broken(
        "vee without its factor",
        lambda: of(gni.SO3, vee=lambda self, matrix: 2 * gni.SO3.vee(self, matrix)),
        "bracket_side", "declared_bracket", "hat_and_vee", "left_fields_close",
        "right_fields_close", "structure_constants_of_matrices",
    ),
    broken(
        "hat of the angle's sine",
        lambda: of(gni.SO2, hat=lambda self, xi: gni.SO2.hat(self, np.sin(xi))),
        "first_order_of_retraction", "hat_and_vee", "hat_is_linear", "plane_turns_counterclockwise",
        "tangents_by_side", "translated_basis_side", "velocity_side",
    ),
    broken(
        "structure constants of the other order",
        lambda: of(gni.SE2, structure_constants=-gni.SE2().structure_constants),
        "bracket_side", "declared_bracket", "left_fields_close", "right_fields_close",
        "structure_constants_of_matrices",
    ),
    broken(
        "elements column by column",
        column_by_column,
        "first_order_of_retraction", "product_order", "row_by_row", "tangents_by_side",
        "translated_basis_side", "velocity_side",
    ),
    broken(
        "translated basis on the wrong side",
        lambda: of(gni.SO3, translated_basis=gni.SO3(side="right").translated_basis),
        "translated_basis_side",
    ),
    broken(
        "reach of a quarter turn",
        lambda: of(gni.SO3, rotation_size=lambda self, xi: 2 * gni.SO3.rotation_size(self, xi)),
        "reach_of_half_a_turn",
    ),
    broken(
        "Cayley map without its factor 1/2",
        lambda: gni.SO3(retraction=Doubled()),
        "declared_ad_star", "declared_bracket", "first_order_of_retraction", "left_fields_close",
        "right_fields_close", "tangents_by_side", "velocity_side",
    ),
    broken(
        "group part first",
        forgetting(GroupFirst, 1, gni.SO2()),
        "anchor_forgets_the_group", "base_then_group", "factors_in_their_order",
    ),
    broken(
        "space frame of a left group",
        forgetting(SpaceFrame),
        "frame_side",
    ),
    broken(
        "inverse poses",
        lambda: InversePose(1, gni.SO3()),
        "reconstruction_order",
    ),
    broken(
        "pose of a pair where it starts",
        lambda: of(gni.PairGroupoid, 2, pose=lambda self, arrow: self.source(arrow)),
        "poses_are_targets", "poses_make_arrows",
    ),
    broken(
        "parts of the base in another order",
        lambda: of(gni.PairGroupoid, 2, split=lambda self, x: [x[1:], x[:1]]),
        "parts_of_the_base",
    ),
]
