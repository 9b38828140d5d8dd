"""docs/conventions.md as laws: which order, which side, which sign.

A reversed product satisfies every axiom of a groupoid, and its own algebroid. What tells it from
the product meant is written here, against plain NumPy matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.groupoids import (
    SE2,
    SE3,
    SO2,
    SO3,
    ActionGroupoid,
    AtiyahGroupoid,
    Cayley,
    Exponential,
    FramedPairGroupoid,
    LieGroup,
    LieGroupoid,
    ProductGroupoid,
)
from groupoid_gni.groupoids.pair_of_points import PairOfPoints
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, gap
from groupoid_gni.verification.groupoid_laws import needs_a_base
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.strategies import pairs

_FEW = "round-off of a few products"
_DIFFERENCES = "finite differences of order eight, 1e-13 for functions of size 1"
_J = np.array([[0.0, -1.0], [1.0, 0.0]])
_convention = partial(law, "convention", draw=pairs, tolerance=1e-12, reason=_FEW)

# Which subjects a law is about.


def only_for(*kinds: type) -> Callable[[LieGroupoid], str | None]:
    """The condition that the space is one of these classes, or a subclass."""
    names = " or ".join(kind.__name__ for kind in kinds)

    def condition(space: LieGroupoid) -> str | None:
        return None if isinstance(space, kinds) else f"it is no {names}"

    return condition


def needs_matrices(space: LieGroupoid) -> str | None:
    """Why a law about products of matrices does not apply."""
    if not isinstance(space, LieGroup):
        return "it is no LieGroup"
    return None if _has_matrices(space) else "its elements are not matrices"


def needs_a_posed_group(space: LieGroupoid) -> str | None:
    """Why poses are no matrices."""
    return None if _side_of_poses(space) else "its poses are not matrices"


def needs_a_known_reach(space: LieGroupoid) -> str | None:
    """Why reach 1 is not half a turn."""
    if not isinstance(space, SO2 | SO3 | SE2 | SE3):
        return "it has no single angle of rotation"
    known = isinstance(space.retraction, Cayley | Exponential)
    return None if known else "the retraction is neither Cayley nor Exponential"


def _has_matrices(group: LieGroup) -> bool:
    return len(group.element_shape) == 2 and group.element_shape[0] == group.element_shape[1]


def _side_of_poses(space: LieGroupoid) -> str | None:
    """The side of the group whose elements are the poses, if they are matrices."""
    groups = [space]
    if isinstance(space, ActionGroupoid):
        groups = [space.group]
    if isinstance(space, ProductGroupoid):
        groups = [factor for factor in space.factors if isinstance(factor, LieGroup)]
    group = groups[0] if len(groups) == 1 else None
    return group.side if isinstance(group, LieGroup) and _has_matrices(group) else None


def _plain(value: Any) -> FloatArray:
    return np.asarray(value, dtype=np.float64)


def _by_side(group: LieGroup, first: Any, then: Any) -> FloatArray:
    """First times then as matrices on a left group, the other way round on a right one."""
    if not _has_matrices(group):
        return _plain(first) + _plain(then)
    return _plain(first @ then if group.side == "left" else then @ first)


def _element(group: LieGroup, arrow: Any) -> FloatArray:
    """The entries of an arrow row by row."""
    return np.reshape(_plain(arrow), group.element_shape)


def _rate(curve: Callable[[float], Any]) -> FloatArray:
    """The derivative of a curve at 0."""
    return central_difference(lambda t: curve(float(t[0])), [0.0])[..., 0]


# Every groupoid.


@_convention("alpha(g h) = alpha(g), beta(g h) = beta(h)", "beta(g) = alpha(h)",
             "conventions 1: diagrammatic order, Definition 8.1 (2)", applies=needs_a_base)
def diagrammatic_order(
    space: LieGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """multiply(g, h) is first g, then h."""
    g = _plain(space.retract(x, xi))
    h = _plain(space.retract(_plain(space.target(g)), eta))
    product = space.multiply(g, h)
    ends = np.concatenate([space.source(product), space.target(product)])
    return gap(ends, np.concatenate([x, space.target(h)]))


@_convention("(split(x)_1, split(x)_2, ...) = x, row by row", "x in Q",
             "conventions 1: flat arrays, row by row", applies=needs_a_base)
def parts_of_the_base(
    space: LieGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The parts of Q come one after the other, matrices row by row."""
    return gap(np.concatenate([np.ravel(part) for part in space.split(x)]), x)


# Lie groups: sides.


@_convention("multiply(g, h) = g h (left), h g (right)", "g, h as matrices",
             "conventions 2", applies=needs_matrices)
def product_order(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """The product of a right group is the opposite one."""
    g, h = _plain(group.retract(x, xi)), _plain(group.retract(x, eta))
    left = _element(group, group.multiply(g, h))
    return gap(left, _by_side(group, _element(group, g), _element(group, h)))


@_convention("d/dt multiply(W, retract(x, t v)) = W hat(v) (left), hat(v) W (right) at t = 0",
             "W in G", "conventions 2: body and space velocities", applies=needs_matrices,
             tolerance=1e-10, reason=_DIFFERENCES)
def velocity_side(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """Components are body velocities on a left group, space velocities on a right one."""
    pose = _plain(group.retract(x, xi))
    left = _rate(lambda t: group.multiply(pose, group.retract(x, t * eta)))
    return gap(_element(group, left), _by_side(group, _element(group, pose), group.hat(eta)))


@_convention("translated_basis(W) v = W hat(v) (left), hat(v) W (right)", "W in G",
             "conventions 2: body and space velocities", applies=needs_matrices)
def translated_basis_side(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The columns of a translated basis are what its velocities do."""
    pose = _element(group, group.retract(x, xi))
    left = _element(group, group.translated_basis(pose) @ eta)
    return gap(left, _by_side(group, pose, group.hat(eta)))


@_convention("D tau(xi) B+ v = g hat(v), D tau(xi) B- v = -hat(v) g (left), exchanged (right)",
             "g = tau(xi)", "conventions 2; definition 9.1", applies=needs_matrices,
             tolerance=1e-10, reason=_DIFFERENCES)
def tangents_by_side(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """B+ is about the end of an arrow, B- about its start."""
    plus = _plain(group.trivialised_tangent_plus(x, xi)) @ eta
    minus = _plain(group.trivialised_tangent_minus(x, xi)) @ eta
    g, velocity = _element(group, group.retract(x, xi)), group.hat(eta)
    rates = central_difference(lambda moved: group.retract(x, moved), xi, [plus, minus])
    right = [_by_side(group, g, velocity), -_by_side(group, velocity, g)]
    return gap([_element(group, rate) for rate in rates.T], right)


@_convention("hat([u, v]) = hat(u) hat(v) - hat(v) hat(u) (left), minus that (right)",
             "u, v in g", "conventions 2; Section 8.1", applies=needs_matrices)
def bracket_side(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """The bracket of a right group is minus the commutator."""
    left = group.hat((_plain(group.bracket(x)) @ eta) @ xi)
    u, v = group.hat(xi), group.hat(eta)
    return gap(left, _by_side(group, u, v) - _by_side(group, v, u))


@_convention("hat(C(u, v)) = hat(u) hat(v) - hat(v) hat(u)", "u, v in g, both sides",
             "C[c, a, b] of structure_constants", applies=needs_matrices)
def structure_constants_of_matrices(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The structure constants of a group are those of its matrices and know no side."""
    u, v = group.hat(xi), group.hat(eta)
    left = group.hat(np.einsum("cab,a,b->c", group.structure_constants, xi, eta))
    return gap(left, u @ v - v @ u)


# Lie groups: components.


@_convention("vee(hat(u)) = u", "u in g", "Section 7.2: the isomorphism of R^d and g",
             applies=only_for(LieGroup))
def hat_and_vee(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """Components of a matrix made of components."""
    return gap(group.vee(group.hat(eta)), eta)


@_convention("hat(u + s v) = hat(u) + s hat(v)", "u, v in g, s = 1.7",
             "Section 7.2: the isomorphism of R^d and g", applies=only_for(LieGroup))
def hat_is_linear(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """hat is a linear map."""
    return gap(group.hat(xi + 1.7 * eta), group.hat(xi) + 1.7 * group.hat(eta))


@_convention("d/dt retract(x, t v) = hat(v) at t = 0", "v in g",
             "Appendix: tau is the identity to first order", applies=only_for(LieGroup),
             tolerance=1e-10, reason=_DIFFERENCES)
def first_order_of_retraction(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Small arrows are 1 + e hat(v)."""
    return gap(_element(group, _rate(lambda t: group.retract(x, t * eta))), group.hat(eta))


@_convention("retract(x, xi)[n i + j] = tau(xi)[i, j]", "xi in g",
             "conventions 1: an element is its entries, row by row", applies=only_for(LieGroup))
def row_by_row(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """Arrows of a group are elements read like a book, and so are flatten and unflatten."""
    g = _plain(group.tau(xi))
    flat = np.array([g[index] for index in np.ndindex(*group.element_shape)])
    back = np.ravel(group.unflatten(group.flatten(g)))
    return gap([group.retract(x, xi), group.flatten(g), back], [flat, flat, flat])


@_convention("hat(z) w = z x w", "SO(3)", "equation (39)", applies=only_for(SO3))
def hat_is_the_cross_product(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The matrix of an angular velocity."""
    return gap(group.hat(xi) @ eta, np.cross(xi, eta))


@_convention("hat(w) = w [[0, -1], [1, 0]], on SE(2) the block of rotations", "SO(2), SE(2)",
             "conventions 3", applies=only_for(SO2, SE2))
def plane_turns_counterclockwise(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Positive angles turn the first axis towards the second."""
    return gap(group.hat(xi)[:2, :2], xi[0] * _J)


@_convention("hat(w, v) = [[hat(w), v], [0, 0]]", "SE(2), SE(3)",
             "conventions 3: rotation first, then translation", applies=only_for(SE2, SE3))
def rotation_first(group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray) -> Gap:
    """Rotation first, then translation; the translation is the last column."""
    n = group.element_shape[0] - 1
    right = np.zeros(group.element_shape)
    right[:n, :n] = xi[0] * _J if n == 2 else np.cross(xi[:3], np.eye(3)).T
    right[:n, n] = xi[-n:]
    return gap(group.hat(xi), right)


@_convention("reach(x, xi) = |w|/pi (exponential), |w|/r with r (1 + r^2/4) = pi (Cayley)",
             "w the rotation part of xi; SO(2), SO(3), SE(2), SE(3)",
             "conventions 4: 1 is half a turn", applies=needs_a_known_reach)
def reach_of_half_a_turn(
    group: LieGroup, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Steps of half a turn, or what an isotropic body does in it, are the first ones refused."""
    angles = {SO2: 1, SE2: 1, SO3: 3, SE3: 3}
    count = next(size for kind, size in angles.items() if isinstance(group, kind))
    roots = np.roots([0.25, 0.0, 1.0, -np.pi])
    longest = np.pi
    if isinstance(group.retraction, Cayley):
        longest = float(roots[np.abs(roots.imag) < 1e-9].real[0])
    return gap(group.reach(x, xi), np.linalg.norm(xi[:count]) / longest)


# Products, framed pairs, actions.


def _cut(vector: FloatArray, sizes: list[int]) -> list[FloatArray]:
    return np.split(vector, np.cumsum(sizes[:-1]))


@_convention("retract(x, xi) = (retract_1(x_1, xi_1), ..., retract_k(x_k, xi_k))",
             "factors in their order", "conventions 3", applies=only_for(ProductGroupoid))
def factors_in_their_order(
    space: ProductGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Base points, components and arrows of the factors come one after the other."""
    bases = _cut(x, [factor.base_size for factor in space.factors])
    velocities = _cut(xi, [factor.rank for factor in space.factors])
    parts = zip(space.factors, bases, velocities, strict=True)
    return gap(space.retract(x, xi), np.concatenate([f.retract(q, v) for f, q, v in parts]))


@_convention("retract(x, (v, eta)) = (x, x + v, tau(eta)); on Q x| G: retract(q, xi) = (q, tau)",
             "trivial Atiyah and action groupoids", "conventions 3: base part, then group part",
             applies=only_for(AtiyahGroupoid, ActionGroupoid))
def base_then_group(
    space: AtiyahGroupoid | ActionGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Base part first, then group part."""
    moved = x + xi[: x.size] if isinstance(space, AtiyahGroupoid) else x[:0]
    turned = np.ravel(space.group.tau(xi[moved.size :]))
    return gap(space.retract(x, xi), np.concatenate([x, moved, turned]))


@_convention("rho = [1 0]", "trivial Atiyah groupoids", "Section 7.4: AG = TM x g",
             applies=only_for(AtiyahGroupoid))
def anchor_forgets_the_group(
    space: AtiyahGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The anchor keeps the base part."""
    return gap(space.anchor(x), np.eye(space.base_dim, space.rank))


@_convention("beta(retract(x, xi)) = x tau(xi) (left), tau(xi) x (right), group by group",
             "pair groupoids in the frame of a group", "conventions 2: body and space frames",
             applies=only_for(FramedPairGroupoid))
def frame_side(
    space: FramedPairGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """The frame is carried by the body on left groups, fixed in space on right ones."""
    elements = _cut(x, [group.arrow_size for group in space.groups])
    velocities = _cut(xi, [group.dimension for group in space.groups])
    moved = [
        np.ravel(_by_side(group, _element(group, element), group.tau(velocity)))
        for group, element, velocity in zip(space.groups, elements, velocities, strict=True)
    ]
    return gap(space.target(space.retract(x, xi)), np.concatenate(moved))


@_convention("action(action(q, g), h) = action(q, g h) (left group), action(q, h g) (right group)",
             "q in Q, g, h in G as matrices", "the law of the action: a right action of multiply",
             applies=only_for(ActionGroupoid))
def law_of_the_action(
    space: ActionGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Left groups act from the right (q -> R^T q), right groups from the left (q -> R q)."""
    g, h = (_plain(space.group.tau(vector)) for vector in (xi, eta))
    twice = space.action(space.action(x, g), h)
    return gap(twice, space.action(x, _by_side(space.group, g, h)))


# Poses.


@_convention("pose(multiply(arrow_to(alpha(g), W), g)) = W pose(g) (left), pose(g) W (right)",
             "W a pose, poses as matrices", "Remark 7.2: W_{k+1} = W_k g_k",
             applies=needs_a_posed_group)
def reconstruction_order(
    space: LieGroupoid, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Reconstruction multiplies on the right, with the product of the group's side."""
    g = _plain(space.retract(x, xi))
    pose, step = _plain(space.pose(_plain(space.retract(x, eta)))), _plain(space.pose(g))
    moved = space.pose(space.multiply(_plain(space.arrow_to(x, pose)), g))
    return gap(moved, pose @ step if _side_of_poses(space) == "left" else step @ pose)


@_convention("pose(g h) = beta(h)", "composable g, h in Q x Q",
             "Remark 7.2 on a pair groupoid: W_k = q_k", applies=only_for(PairOfPoints))
def poses_are_targets(
    space: PairOfPoints, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """A pair of points is shown where it ends."""
    g = _plain(space.retract(x, xi))
    h = _plain(space.retract(_plain(space.target(g)), eta))
    return gap(space.pose(space.multiply(g, h)), h[h.size // 2 :])


CONVENTION_LAWS = (
    diagrammatic_order, parts_of_the_base, product_order, velocity_side, translated_basis_side,
    tangents_by_side, bracket_side, structure_constants_of_matrices, hat_and_vee, hat_is_linear,
    first_order_of_retraction, row_by_row, hat_is_the_cross_product, plane_turns_counterclockwise,
    rotation_first, reach_of_half_a_turn, factors_in_their_order, base_then_group,
    anchor_forgets_the_group, frame_side, law_of_the_action, reconstruction_order,
    poses_are_targets,
)
