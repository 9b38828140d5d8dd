"""Sections 2, 6 and 8.2: the metric, the projectors, the reflection.

Covectors are compared in an orthonormal frame of the metric and in units of what went in, so that
masses may be as small or as different as they like.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.verification.gaps import Gap, holds, relative_gap
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.system_samples import covector_gap, has_constraints, motions
from groupoid_gni.verification.system_view import SystemView

_FEW = "round-off of a few small solves, in units of their condition number"
_law = partial(law, "system", draw=motions, tolerance=1e-12, reason=_FEW)
_constrained = partial(_law, applies=has_constraints)


# The metric.


@_law("G_x(a, b) = G_x(b, a)", "a, b in A_x G", "Section 2, (3); Section 8.2 (i)")
def metric_is_symmetric(view: SystemView, x: FloatArray, **_: FloatArray) -> Gap:
    """The metric is symmetric; the step reads only one half of it."""
    metric = view.term("metric", x)
    size = np.sqrt(np.abs(np.diag(metric))) + 1e-300
    return relative_gap(metric / np.outer(size, size), metric.T / np.outer(size, size))


@law("system", "G_x(a, a) > 0", "a in A_x G, a not 0", "Section 2, (3); Section 8.2 (i)",
     draw=motions, tolerance=0.5, reason="true or not")
def metric_is_positive_definite(view: SystemView, x: FloatArray, **_: FloatArray) -> Gap:
    """Every direction has inertia."""
    metric = view.term("metric", x)
    size = np.sqrt(np.abs(np.diag(metric))) + 1e-300
    smallest = float(np.min(np.linalg.eigvalsh(metric / np.outer(size, size))))
    return holds(smallest > float(len(metric) * np.finfo(float).eps))


# Projectors. The library's own are the linear parts of `project` and of `impulse`.


def _along(view: SystemView, x: FloatArray, p: FloatArray) -> FloatArray:
    return view.project(x, p) - view.project(x, np.zeros_like(p))


def _across(view: SystemView, x: FloatArray, p: FloatArray) -> FloatArray:
    change = view.impulse(x, p) - view.impulse(x, np.zeros_like(p))
    return np.asarray(view.node(x).mu.T @ change)


def _projector(view: SystemView, x: FloatArray) -> FloatArray:
    """P on velocities: the transpose of P*."""
    unit = np.diag(np.sqrt(np.diag(view.node(x).metric)))
    columns = [_along(view, x, column) for column in unit]
    return np.stack(columns) / np.diag(unit)[:, None]


@_constrained("P* p + Q* p = p", "p in A*_x G", "Section 2: P = Id - Q")
def projectors_are_complementary(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The two parts of a covector make it up."""
    node = view.node(x)
    whole = _along(view, x, p) + _across(view, x, p)
    return covector_gap(node, whole, p, p, node.offset)


@_constrained("P* P* p = P* p, Q* Q* p = Q* p", "p in A*_x G", "Section 2, (47)")
def projectors_are_idempotent(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Projecting twice is projecting once."""
    node, along, across = view.node(x), _along(view, x, p), _across(view, x, p)
    twice = np.stack([_along(view, x, along), _across(view, x, across)], axis=1)
    return covector_gap(node, twice, np.stack([along, across], axis=1), p, node.offset)


@_constrained("P* Q* p = 0, Q* P* p = 0", "p in A*_x G", "Section 2, (47)")
def projectors_annihilate_each_other(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """What one keeps the other kills."""
    node = view.node(x)
    crossed = np.stack(
        [_along(view, x, _across(view, x, p)), _across(view, x, _along(view, x, p))], axis=1
    )
    return covector_gap(node, crossed, np.zeros_like(crossed), p, node.offset)


@_constrained("G^-1(P* p, Q* q) = 0", "p, q in A*_x G", "Section 2: orthogonal projectors")
def projectors_are_orthogonal(
    view: SystemView, x: FloatArray, p: FloatArray, q: FloatArray, **_: FloatArray
) -> Gap:
    """The two parts are orthogonal in the inverse metric."""
    node = view.node(x)
    product = _along(view, x, p) @ node.inverse @ _across(view, x, q)
    sizes = node.size(p, node.offset) * node.size(q, node.offset)
    return Gap(np.array(product), np.array(0.0), node.condition * sizes or 1.0)


@_constrained("mu P v = 0, G(P v, v - P v) = 0", "v in A_x G, P: AG -> D the transpose of P*",
              "Section 2: TQ = D + D^perp; (47)")
def velocities_split_into_allowed_and_orthogonal(
    view: SystemView, x: FloatArray, xi: FloatArray, **_: FloatArray
) -> Gap:
    """P maps velocities into D, along the orthogonal complement of D."""
    node = view.node(x)
    allowed = _projector(view, x) @ xi
    speed = node.speed(xi)
    left = np.append(node.mu @ allowed / node.row_sizes * speed,
                     allowed @ node.metric @ (xi - allowed))
    condition = node.condition * (1.0 + node.size(node.offset))
    return Gap(left, np.zeros_like(left), condition * speed**2 or 1.0)


@_constrained("mu G^-1 P* p = 0", "p in A*_x G", "Section 2: P* is onto G(D, .)")
def projected_covectors_obey_the_constraints(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The kept part obeys the linear constraints."""
    node = view.node(x)
    left = node.mu @ node.inverse @ _along(view, x, p) / node.row_sizes
    return Gap(left, np.zeros_like(left), node.condition * node.size(p, node.offset) or 1.0)


@_constrained("<Q* p, v> = <p - P* p, v> = 0", "p in A*_x G, v in D_x",
              "Section 2: Q* p in D^o = span{mu^a}")
def removed_covectors_are_constraint_forces(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """What is taken away is a combination of constraint rows: it does no work along D."""
    node = view.node(x)
    allowed = np.linalg.svd(np.linalg.solve(node.lower, node.mu.T).T)[2][len(node.rows) :]
    removed = np.stack([_across(view, x, p), p - _along(view, x, p)], axis=1)
    left = allowed @ node.in_frame(removed)
    scale = node.condition * node.size(p, node.offset) or 1.0
    return Gap(left, np.zeros_like(left), scale)


@_constrained("project(p) = P* p + Q* Pi, Q* = mu^T (mu G^-1 mu^T)^-1 mu G^-1",
              "p in A*_x G, Pi = G Y + A", "Section 2; (25)")
def projection_is_the_dense_one(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The projection onto the constraint set, against explicit inverses."""
    node = view.node(x)
    dense = node.along @ p + node.across @ node.offset
    return covector_gap(node, view.project(x, p), dense, p, node.offset)


@_constrained("mu^T impulse(p) = Q* (p - Pi)", "p in A*_x G", "Section 2; (27a), (9a)")
def impulse_is_the_dense_one(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The impulse of the constraints, against explicit inverses."""
    node = view.node(x)
    dense = node.across @ (p - node.offset)
    return covector_gap(node, node.mu.T @ view.impulse(x, p), dense, p, node.offset)


@_constrained("N^T G^-1 N = 1", "x in Q", "basis of D^o in which the projected step moves")
def normal_vectors_are_orthonormal(
    view: SystemView, x: FloatArray, **_: FloatArray
) -> Gap:
    """The basis of the normal space is orthonormal in the inverse metric."""
    node = view.node(x)
    unit = np.eye(len(node.rows))
    columns = [node.in_frame(view.normal_vector(x, component)) for component in unit]
    basis = np.array(columns).reshape(len(unit), len(node.metric))
    return Gap(basis @ basis.T, unit, node.condition)


@_constrained("N normal_component(p) = Q* (p - Pi)", "p in A*_x G",
              "basis of D^o in which the projected step moves")
def normal_components_are_coordinates(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Components in that basis give the normal part back."""
    node = view.node(x)
    back = view.normal_vector(x, view.normal_component(x, p))
    return covector_gap(node, back, node.across @ (p - node.offset), p, node.offset)


# The reflection.


@_constrained("R(p) = (P* - Q*) p + 2 Q* Pi", "p in A*_x G", "(26), (49); sign of (38b) mended")
def reflection_is_the_dense_one(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The impact, against explicit inverses."""
    node = view.node(x)
    dense = (node.along - node.across) @ p + 2.0 * node.across @ node.offset
    return covector_gap(node, view.reflect(x, p), dense, p, node.offset)


@_constrained("R(R(p)) = p", "p in A*_x G", "(49): an elastic impact")
def reflection_is_an_involution(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Two impacts are none."""
    node = view.node(x)
    return covector_gap(node, view.reflect(x, view.reflect(x, p)), p, p, node.offset)


@_constrained("|R(p) - Pi| = |p - Pi| in G^-1", "p in A*_x G", "(26), (49)")
def reflection_is_an_isometry(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """An impact is elastic, seen from the drift."""
    node = view.node(x)
    after = node.size(view.reflect(x, p) - node.offset)
    scale = node.condition * node.size(p, node.offset) or 1.0
    return Gap(np.array(after), np.array(node.size(p - node.offset)), scale)


def _plain_kinetic(view: SystemView) -> str | None:
    for name in ("drift", "gyroscopic"):
        if view.system.has(name):
            return f"the system has a {name} term"
    return has_constraints(view)


@_law("|R(p)| = |p| in G^-1", "p in A*_x G, Y = 0, A = 0", "(8): energy is kept by an impact",
      applies=_plain_kinetic)
def linear_reflection_keeps_kinetic_energy(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Linear constraints take no energy."""
    node = view.node(x)
    after = np.array(node.size(view.reflect(x, p)))
    return Gap(after, np.array(node.size(p)), node.condition * node.size(p) or 1.0)


@_constrained("R(p + q) - R(p) = (P* - Q*) q", "p, q in A*_x G", "(49)")
def change_of_reflection_is_linear(
    view: SystemView, x: FloatArray, p: FloatArray, q: FloatArray, **_: FloatArray
) -> Gap:
    """Differences are reflected by the linear part alone."""
    node = view.node(x)
    change = view.reflect(x, p + q) - view.reflect(x, p)
    return covector_gap(node, view.reflect_change(x, q), change, p, q, node.offset)


@_constrained("mu (G^-1 ((p + R(p))/2 - A) - Y) = 0", "p in A*_x G",
              "Section 6, after (27); (50b) and the remark after it")
def mean_of_an_impact_obeys_the_constraints(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """The mean of the momenta before and after satisfies the affine constraints."""
    node = view.node(x)
    mean = (p + view.reflect(x, p)) / 2.0
    velocity = node.inverse @ (mean - node.gyroscopic)
    left = node.mu @ (velocity - node.drift) / node.row_sizes
    scale = node.condition * node.size(p, node.offset, node.gyroscopic) or 1.0
    return Gap(left, np.zeros_like(left), scale)


@_constrained("R is the same with rows M mu", "M invertible, p in A*_x G",
              "Section 2: R depends on D, not on the mu^a that span D^o", share=0.3)
def rows_may_be_recombined(
    view: SystemView, x: FloatArray, p: FloatArray, **_: FloatArray
) -> Gap:
    """Other rows with the same span give the same impact."""
    sizes = view.node(x).row_sizes
    count = len(sizes)
    waves = np.sin(np.arange(1.0, count**2 + 1.0)).reshape(count, count)
    matrix = (np.eye(count) + waves / (2.0 * max(count, 1))) / sizes
    other = view.reflect_recombined(x, p, matrix)
    return covector_gap(view.node(x), other, view.reflect(x, p), p, view.node(x).offset)


@_constrained("R_(A + a)(p + a) = R_A(p) + a", "a any one-form, p in A*_x G",
              "Pi = G Y + A: adding dS/dt to L changes nothing", share=0.3)
def reflection_is_gauge_invariant(
    view: SystemView, x: FloatArray, p: FloatArray, q: FloatArray, **_: FloatArray
) -> Gap:
    """A gauge term shifts every momentum and nothing else."""
    node = view.node(x)
    shifted = view.reflect_gauged(x, p + q, q)
    return covector_gap(node, shifted, view.reflect(x, p) + q, p, q, node.offset, node.gyroscopic)


IMPACT_LAWS = (
    metric_is_symmetric, metric_is_positive_definite, projectors_are_complementary,
    projectors_are_idempotent, projectors_annihilate_each_other, projectors_are_orthogonal,
    velocities_split_into_allowed_and_orthogonal, projected_covectors_obey_the_constraints,
    removed_covectors_are_constraint_forces, projection_is_the_dense_one,
    impulse_is_the_dense_one, normal_vectors_are_orthonormal, normal_components_are_coordinates,
    reflection_is_the_dense_one, reflection_is_an_involution, reflection_is_an_isometry,
    linear_reflection_keeps_kinetic_energy, change_of_reflection_is_linear,
    mean_of_an_impact_obeys_the_constraints, rows_may_be_recombined,
    reflection_is_gauge_invariant,
)
