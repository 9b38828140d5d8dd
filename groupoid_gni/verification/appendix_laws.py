"""The appendix of the paper, law by law: retraction maps of a Lie group of matrices.

Here everything is a matrix: what the group computes in components is compared with products of
matrices, derivatives of them, SciPy's exponential and the series of the paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
from math import factorial
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.groupoids import SO3, Cayley, Exponential
from groupoid_gni.verification import strategies
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, gap
from groupoid_gni.verification.group_view import GroupView
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.retraction_laws import SCALES, ordinary

_FEW = "round-off of a few products of matrices"
_DIFFERENCES = "finite differences of order eight, 1e-13 for functions of size 1"
_SCALED = "v = xi, 1e-4 xi, 1e-8 xi, 1e-160 xi; xi in g"
_NO_MATRICES = "the elements are not matrices"


def _velocities(view: GroupView) -> Any:
    """Samples {x, xi}."""
    return strategies.vectors(view.group)


def _two_velocities(view: GroupView) -> Any:
    """Samples {x, xi, eta}."""
    return strategies.pairs(view.group)


def _ordinary_velocities(view: GroupView) -> Any:
    """Samples {x, xi} without small ones, for expensive laws."""
    return ordinary(view.group)


def of_matrices(view: GroupView) -> str | None:
    """Why there are no matrices to compare with."""
    return None if view.has_matrices else _NO_MATRICES


def of_exponentials(view: GroupView) -> str | None:
    """Why this is not about the exponential map."""
    if isinstance(view.group.retraction, Exponential):
        return of_matrices(view)
    return "the retraction is not the exponential map"


def of_cayley(view: GroupView) -> str | None:
    """Why this is not about the Cayley map."""
    if isinstance(view.group.retraction, Cayley):
        return of_matrices(view)
    return "the retraction is not the Cayley map"


def of_cayley_rotations(view: GroupView) -> str | None:
    """Why the formulas printed for SO(3) are not meant."""
    return of_cayley(view) if isinstance(view.group, SO3) else "the group is not SO3"


def of_traceless_algebra(view: GroupView) -> str | None:
    """Why the determinant need not be 1."""
    if (reason := of_matrices(view)) is not None:
        return reason
    traces = np.trace(view.basis, axis1=-2, axis2=-1)
    return None if np.max(np.abs(traces)) < 1e-12 else "the algebra has matrices with a trace"


def of_restored_elements(view: GroupView) -> str | None:
    """Why restoration has nothing to do."""
    group = view.group
    pushed = _pushed(view, np.asarray(group.identity_element, dtype=float))
    if float(group.element_defect(pushed)) == 0.0:
        return "element_defect is always 0"
    if np.array_equal(group.restore_element(pushed), pushed):
        return "restore_element leaves every element as it is, its default"
    return None


_law = partial(law, "appendix", tolerance=1e-12, reason=_FEW, applies=of_matrices)
_expensive = partial(law, "appendix", draw=_ordinary_velocities, share=0.2)
_exact = partial(_expensive, tolerance=1e-12, reason=_FEW, applies=of_matrices)
_derivative = partial(_expensive, tolerance=1e-10, reason=_DIFFERENCES, applies=of_matrices)


# The retraction map.


@_law("tau(0) = e", "every retraction map", "Appendix", draw=_velocities)
def tau_of_zero(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """Zero is mapped to the neutral element."""
    return gap(view.tau(0.0 * xi), view.one)


@_law("tau(xi) tau(-xi) = e", "xi in g", "Appendix", draw=_velocities)
def tau_of_minus(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The opposite velocity gives the inverse matrix."""
    g, back = view.tau(xi), view.tau(-xi)
    return gap(g @ back, view.one, _size(g) * _size(back))


@_derivative("d/de tau(e b) = hat(b) at e = 0", "b in g", "section 7.2: tau approximates the flow")
def tau_to_first_order(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """At zero tau is the identity to first order."""
    return gap(central_difference(lambda e: view.tau(e * xi), 0.0, [1.0])[..., 0], view.hat(xi))


@_law("element_defect(g) = 0, restore_element(g) = g", "g = tau(xi)", "Appendix: tau maps to G",
      draw=_velocities)
def elements_stay_in_the_group(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """tau does not leave the group, so there is nothing to restore."""
    group, g = view.group, np.asarray(view.group.tau(xi), dtype=float)
    found = [float(group.element_defect(g)), *np.ravel(group.restore_element(g))]
    return gap(found, [0.0, *np.ravel(g)], _size(g) ** 2)


@_law("det tau(xi) = 1", "algebras of traceless matrices", "the determinant of a connected group",
      draw=_velocities, applies=of_traceless_algebra)
def determinant_is_one(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """tau preserves volume and orientation."""
    g = view.tau(xi)
    return gap(np.linalg.det(g), 1.0, _size(g) ** 2)


@_law("element_defect(g') = 0 after 4 restorations of g' = g + 1e-3", "g = tau(xi)",
      "restore_element: one Newton step", draw=_velocities, applies=of_restored_elements)
def restoration_converges(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """What has left the group is brought back, quadratically."""
    group = view.group
    element = _pushed(view, np.asarray(group.tau(xi), dtype=float))
    scale = _size(element) ** 2
    for _ in range(4):
        element = np.asarray(group.restore_element(element), dtype=float)
    return gap(group.element_defect(element), 0.0, scale)


def _size(matrix: Array) -> float:
    """1 plus the largest entry: what round-off in a product is compared with."""
    return 1.0 + float(np.max(np.abs(matrix), initial=0.0))


def _pushed(view: GroupView, element: FloatArray) -> FloatArray:
    """The element with every entry moved, by another amount, by up to 1e-3."""
    push = np.sin(np.arange(1.0, 1.0 + element.size)).reshape(element.shape)
    return element + 1e-3 * push / _size(element)


@_law("tau(eta)^2 = tau(xi), eta = half_vector(xi)", "|xi| <= 1/2, where the derived half is exact",
      "conventions, section 4", draw=_velocities)
def half_vectors(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """Half a velocity, used twice, gives the element."""
    xi = xi / max(1.0, 2.0 * float(np.linalg.norm(xi)))
    root = view.tau(np.asarray(view.group.half_vector(xi), dtype=float))
    return gap(root @ root, view.tau(xi))


# The adjoint action.


@_exact("[xi, E_b] = hat(ad_xi e_b)", "xi in g", "Lemma 9.3: [xi, eta] = ad_xi eta")
def ad_is_the_commutator(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """ad is the commutator of matrices, whatever the side."""
    a = view.hat(xi)
    return gap(view.hats(view.group.ad(xi)), a @ view.basis - view.basis @ a)


@_exact("hat(Ad_g e_b) = g E_b g^-1", "g = tau(xi)", "Lemma 9.3")
def adjoint_is_conjugation(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """Ad is conjugation with the matrix."""
    g = view.tau(xi)
    g_inverse = np.linalg.inv(g)
    return gap(
        view.hats(_adjoint(view, xi)), g @ view.basis @ g_inverse, _size(g) * _size(g_inverse)
    )


@_law("Ad_{g h} = Ad_g Ad_h", "g = tau(xi), h = tau(eta)", "Lemma 9.3", draw=_two_velocities)
def adjoint_is_a_representation(
    view: GroupView, x: FloatArray, xi: FloatArray, eta: FloatArray
) -> Gap:
    """Ad turns products into products, in this order."""
    group = view.group
    product = np.asarray(group.compose(group.tau(xi), group.tau(eta)), dtype=float)
    first, then = _adjoint(view, xi), _adjoint(view, eta)
    return gap(group.Ad(product), first @ then, _size(first) * _size(then))


@_exact("Ad_g [a, b] = [Ad_g a, Ad_g b]", "g = tau(xi), a and b in g", "proof of Lemma 9.4")
def adjoint_keeps_brackets(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """Ad is an automorphism of the algebra."""
    Ad = _adjoint(view, xi)
    structure = np.stack([_ad(view, unit) for unit in np.eye(view.group.dimension)], axis=1)
    left = np.einsum("ck,kab->cab", Ad, structure)
    right = np.einsum("ckl,ka,lb->cab", structure, Ad, Ad)
    return gap(left, right, _size(Ad) ** 2)


@_derivative("d/de Ad_{g tau(e b)} a = -Ad_g [a, b] at e = 0", "g = tau(xi), a and b in g",
             "Lemma 9.3")
def lemma_9_3(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """How Ad varies with the element."""
    group, g = view.group, view.group.tau(xi)
    change = central_difference(
        lambda e: group.Ad(np.asarray(group.compose(g, group.tau(e)), dtype=float)), 0.0 * xi
    )
    brackets = np.stack([-_ad(view, b) for b in np.eye(group.dimension)], axis=-1)
    return gap(change, -np.einsum("ck,kab->cab", _adjoint(view, xi), brackets))


@_derivative("D_xi(Ad_{tau(xi)} a) b = -[Ad_{tau(xi)} a, dtau_xi b]", "a and b in g", "Lemma 9.4")
def lemma_9_4(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """How Ad of the retraction varies with the velocity."""
    group = view.group
    change = central_difference(lambda v: group.Ad(np.asarray(group.tau(v), dtype=float)), xi)
    moved = [_ad(view, b) @ _adjoint(view, xi) for b in np.asarray(group.dtau(xi), dtype=float).T]
    return gap(change, np.stack(moved, axis=-1))


def _adjoint(view: GroupView, xi: FloatArray) -> FloatArray:
    return np.asarray(view.group.Ad(np.asarray(view.group.tau(xi), dtype=float)), dtype=float)


def _ad(view: GroupView, b: FloatArray) -> FloatArray:
    return np.asarray(view.group.ad(b), dtype=float)


# The right-trivialised tangent.


@_exact("hat(dtau_xi e_b) = (T_xi tau e_b) tau(xi)^-1", "T_xi tau by exact differentiation",
        "Definition 9.1, (51)")
def dtau_by_definition(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """dtau is the derivative of tau, moved to e by right translation."""
    return _definition_51(view, xi, view.tau_change(xi))


@_derivative("hat(dtau_xi e_b) = (T_xi tau e_b) tau(xi)^-1", "T_xi tau by finite differences",
             "Definition 9.1, (51)")
def dtau_by_differences(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The same without recording."""
    return _definition_51(view, xi, np.moveaxis(central_difference(view.tau, xi), -1, 0))


def _definition_51(view: GroupView, xi: FloatArray, change: FloatArray) -> Gap:
    back = np.linalg.inv(view.tau(xi))
    return gap(view.hats(view.group.dtau(xi)), change @ back, _size(change) * _size(back))


@_derivative("dtau_xi^-1 b = d/de tau^-1(tau(e b) tau(xi)) at e = 0", "b in g",
             "Definition 9.1, (52)")
def dtau_inverse_by_definition(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """dtau^-1 is the derivative of tau^-1 after right translation."""
    group, g = view.group, view.group.tau(xi)

    def moved(e: FloatArray) -> Any:
        return group.tau_inverse(np.asarray(group.compose(group.tau(e), g), dtype=float))

    return gap(group.dtau_inverse(xi), central_difference(moved, 0.0 * xi))


@_law("dtau_v dtau_v^-1 = 1", _SCALED, "Definition 9.1", draw=_velocities)
def tangents_are_inverse(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The two tangents undo each other."""
    pairs = [_tangents(view, s * xi) for s in SCALES]
    found = np.stack([there @ back for there, back in pairs])
    one = np.broadcast_to(np.eye(view.group.dimension), found.shape)
    return gap(found, one, _size(pairs[0][0]) * _size(pairs[0][1]))


@_law("dtau_0 = dtau_0^-1 = 1", "every retraction map that is the identity to first order",
      "Definition 9.1 at xi = 0", draw=_velocities)
def tangent_at_zero(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """At zero velocities need no correction."""
    one = np.eye(view.group.dimension)
    return gap(np.stack(_tangents(view, 0.0 * xi)), np.stack([one, one]))


@_law("dtau_v = Ad_{tau(v)} dtau_{-v}", _SCALED, "Lemma 9.5 (53)", draw=_velocities)
def lemma_9_5_tangent(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """Right and left tangent differ by Ad."""
    left = np.stack([_tangents(view, s * xi)[0] for s in SCALES])
    Ad = np.stack([_adjoint(view, s * xi) for s in SCALES])
    opposite = np.stack([_tangents(view, -s * xi)[0] for s in SCALES])
    return gap(left, Ad @ opposite, _size(Ad) * _size(opposite))


@_law("dtau_v^-1 = dtau_{-v}^-1 Ad_{tau(-v)}", _SCALED, "Lemma 9.5 (54)", draw=_velocities)
def lemma_9_5_inverse(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The same for the inverse tangents."""
    left = np.stack([_tangents(view, s * xi)[1] for s in SCALES])
    Ad = np.stack([_adjoint(view, -s * xi) for s in SCALES])
    opposite = np.stack([_tangents(view, -s * xi)[1] for s in SCALES])
    return gap(left, opposite @ Ad, _size(Ad) * _size(opposite))


def _tangents(view: GroupView, xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    there, back = view.group.dtau(xi), view.group.dtau_inverse(xi)
    return np.asarray(there, dtype=float), np.asarray(back, dtype=float)


# (a) The exponential map.


@_exact("exp(xi) = expm(hat(xi))", "expm of SciPy", "Appendix (a)", applies=of_exponentials)
def exponential_is_expm(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The closed form is the exponential of the matrix."""
    from scipy.linalg import expm

    return gap(view.tau(xi), expm(view.hat(xi)))


@_exact("dexp_xi = sum of ad_xi^j / (j+1)!", "40 terms and more", "Appendix (a)",
        applies=of_exponentials)
def dexp_series(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The tangent of the exponential map is its series."""
    series = _power_series([1.0 / factorial(j + 1) for j in range(60)], _ad(view, xi))
    return gap(_tangents(view, xi)[0], series)


@_exact("dexp_xi^-1 = sum of B_j ad_xi^j / j!", "eigenvalues of ad_xi up to 4.5 < 2 pi",
        "Appendix (a), B_j the Bernoulli numbers", applies=of_exponentials)
def dexp_inverse_series(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The inverse tangent of the exponential map is the Bernoulli series."""
    radius = float(np.max(np.abs(np.linalg.eigvals(_ad(view, xi)))))
    xi = xi * min(1.0, 4.5 / max(radius, 1e-3))
    return gap(_tangents(view, xi)[1], _power_series(_bernoulli_over_factorial(), _ad(view, xi)))


@cache
def _bernoulli_over_factorial() -> tuple[float, ...]:
    """Give B_j / j!: 1, -1/2, and 2 (-1)^{k+1} zeta(2k) / (2 pi)^{2k} for j = 2k."""
    from scipy.special import zeta

    even = [-2.0 * (-1.0) ** k * zeta(2 * k) / (2.0 * np.pi) ** (2 * k) for k in range(1, 80)]
    return (1.0, -0.5, *(value for number in even for value in (float(number), 0.0)))


def _power_series(coefficients: Sequence[float], matrix: FloatArray) -> FloatArray:
    one = np.eye(len(matrix))
    result = 0.0 * one
    for coefficient in reversed(coefficients):
        result = coefficient * one + matrix @ result
    return result


# (b) The Cayley map.


@_exact("cay(xi) = (e - xi/2)^-1 (e + xi/2)", "quadratic groups, rigid motions", "Appendix (b)",
        applies=of_cayley)
def cayley_is_the_quotient(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The closed form is the quotient of matrices."""
    half = view.hat(xi) / 2.0
    return gap(view.tau(xi), np.linalg.solve(view.one - half, view.one + half))


@_exact("dcay_xi b = (e - xi/2)^-1 b (e + xi/2)^-1", "b in g", "Appendix (b)", applies=of_cayley)
def dcay_formula(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The tangent of the Cayley map, as matrices."""
    half = view.hat(xi) / 2.0
    left, right = np.linalg.inv(view.one - half), np.linalg.inv(view.one + half)
    return gap(
        view.hats(_tangents(view, xi)[0]), left @ view.basis @ right, _size(left) * _size(right)
    )


@_exact("dcay_xi^-1 b = (e - xi/2) b (e + xi/2)", "b in g", "Appendix (b)", applies=of_cayley)
def dcay_inverse_formula(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The inverse tangent of the Cayley map, as matrices."""
    half = view.hat(xi) / 2.0
    right = (view.one - half) @ view.basis @ (view.one + half)
    return gap(view.hats(_tangents(view, xi)[1]), right)


@_exact("cay = 1 + 4/(4+|w|^2) (w^ + w^ w^/2), dcay = 2/(4+|w|^2) (2 + w^), "
        "dcay^-1 = 1 - w^/2 + w w^T/4", "SO(3)", "Appendix: applications to SO(3)",
        applies=of_cayley_rotations)
def cayley_on_rotations(view: GroupView, x: FloatArray, xi: FloatArray) -> Gap:
    """The formulas printed for SO(3), with the hat map of (39)."""
    (a, b, c), square, one = xi, xi @ xi, np.eye(3)
    w = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
    printed = [
        one + 4.0 / (4.0 + square) * (w + w @ w / 2.0),
        2.0 / (4.0 + square) * (2.0 * one + w),
        one - w / 2.0 + np.outer(xi, xi) / 4.0,
    ]
    return gap(np.stack([view.tau(xi), *_tangents(view, xi)]), np.stack(printed))


APPENDIX_LAWS = (
    tau_of_zero, tau_of_minus, tau_to_first_order, elements_stay_in_the_group, determinant_is_one,
    restoration_converges, half_vectors, ad_is_the_commutator, adjoint_is_conjugation,
    adjoint_is_a_representation, adjoint_keeps_brackets, lemma_9_3, lemma_9_4, dtau_by_definition,
    dtau_by_differences, dtau_inverse_by_definition, tangents_are_inverse, tangent_at_zero,
    lemma_9_5_tangent, lemma_9_5_inverse, exponential_is_expm, dexp_series, dexp_inverse_series,
    cayley_is_the_quotient, dcay_formula, dcay_inverse_formula, cayley_on_rotations,
)
