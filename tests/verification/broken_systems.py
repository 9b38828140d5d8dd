"""Systems broken on purpose, and the library broken under sound ones, with the laws that see it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import casadi as ca
import numpy as np
from broken import Broken

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.discretization.elimination import cholesky, solve_linear, solve_lower
from groupoid_gni.discretization.system_expressions import Node, as_matrix
from groupoid_gni.expressions import RecordedFunction
from groupoid_gni.systems import starts
from groupoid_gni.verification import LawReport, check_system, search

TERMS = ("metric", "constraints", "potential", "drift", "gyroscopic")
FEW = 5
"""Examples: a system is wrong everywhere or nowhere."""
KNOBS = {"nudge": 1.0}
"""A global that the terms of a system read, as no function should."""


def metric(x: Any, p: Any) -> Any:
    bulge = np.array([0.4, -0.2, 0.3, 0.1])
    root = np.array(
        [[1.3, 0.0, 0.0, 0.0], [0.2, 0.9, 0.0, 0.0], [-0.1, 0.3, 1.1, 0.0], [0.2, 0.1, -0.3, 1.4]]
    )
    swell = np.sin(p.k * x[0] + x[1]) ** 2
    return KNOBS["nudge"] * (root @ root.T + swell * np.outer(bulge, bulge))


def rows(x: Any, p: Any) -> Any:
    return KNOBS["nudge"] * np.array(
        [[1.0, 0.3 * x[1], -0.4, 0.2], [0.1, 1.0, 0.5 + 0.2 * np.cos(x[0]), -0.3]]
    )


def drift(x: Any, p: Any) -> Any:
    return KNOBS["nudge"] * np.array([0.3 * np.cos(x[1]), -0.2, 0.4 * x[0], 0.1])


def one_form(x: Any, p: Any) -> Any:
    return KNOBS["nudge"] * np.array([0.2 * x[1], 0.5, np.sin(x[0]), -0.3])


def height(x: Any, p: Any) -> Any:
    return KNOBS["nudge"] * (p.k * x[0] ** 2 / 2 + 0.7 * np.cos(x[1]) + 0.2 * x[0] * x[1])


def rounded_height(x: Any, p: Any) -> Any:
    plainly = isinstance(x, np.ndarray) and x.dtype == float
    return height(np.round(x, 3) if plainly else x, p)


def seen_from(q: Any, pose: Any) -> Any:
    """A place as seen from a body with the given pose: a right action of SE(2)."""
    return (pose[..., :2, :2].swapaxes(-1, -2) @ (q - pose[..., :2, 2])[..., None])[..., 0]


def system(**changes: Any) -> gni.MechanicalSystem:
    """A sound system with every term on a small groupoid with an anchor and a bracket."""
    terms = {
        "metric": metric, "constraints": rows, "drift": drift, "gyroscopic": one_form,
        "potential": height, "parameters": {"k": 1.3}, **changes,
    }
    space = gni.ProductGroupoid(
        gni.ActionGroupoid(gni.SE2(), seen_from, [0.3, -0.7]), gni.VectorGroup(1)
    )
    return gni.MechanicalSystem(space, **terms)


LINEAR: dict[str, Any] = {"drift": None, "gyroscopic": None}


def report(subject: gni.MechanicalSystem) -> LawReport:
    """Without shrinking, which changes no verdict and takes most of the time."""
    with patch.object(search, "_shrink", lambda *_: None):
        return check_system(subject, on_fail="return", examples=FEW)


def mutant(target: Any, name: str, mistake: Any, **changes: Any) -> Callable[[], LawReport]:
    """Check a sound system with one attribute of the library replaced."""

    def check() -> LawReport:
        with patch.object(target, name, mistake):
            return report(system(**changes))

    return check


def after_building(nudge: float, **changes: Any) -> Callable[[], LawReport]:
    """Check a system whose terms change when it has been built."""

    def check() -> LawReport:
        with patch.dict(KNOBS):
            made = system(**changes)
            KNOBS["nudge"] = nudge
            return report(made)

    return check


# The mistakes, as an author would make them.


def only_normal_part(self: Node, p: ca.SX) -> ca.SX:
    return ca.mtimes(self.mu.T, self.impulse(p))


def exchanged(self: Node, p: ca.SX) -> ca.SX:
    return -p + ca.mtimes(self.mu.T, 2 * self.impulse(p))


def printed_sign(self: Node, p: ca.SX) -> ca.SX:
    return self.reflect_change(p) + ca.mtimes(self.mu.T, 2 * self.impulse(ca.SX(p.shape[0], 1)))


def soft(self: Node, p: ca.SX) -> ca.SX:
    return p - ca.mtimes(self.mu.T, self.impulse(p))


def along_gradients(self: Node, p: ca.SX) -> ca.SX:
    return p - ca.mtimes(self.normal, self.impulse(p))


def transposed_basis(self: Node, components: ca.SX) -> ca.SX:
    return ca.mtimes(self.mu.T, solve_lower(self.lower, components))


def node_with(change: Callable[[Node], None]) -> Any:
    """The constructor of a node, spoiled."""
    sound = Node.__init__

    def init(self: Node, *arguments: Any) -> None:
        sound(self, *arguments)
        change(self)

    return init


def lowered(node: Node) -> None:
    """G in place of G^-1."""
    node.normal = ca.mtimes(node.metric, node.mu.T)
    node.gram = ca.mtimes(node.mu, node.normal)
    node.lower = cholesky(node.gram)[0]


def diagonal_gram(node: Node) -> None:
    node.gram = ca.diag(ca.diag(node.gram))


def euclidean_gram(node: Node) -> None:
    node.gram = ca.mtimes(node.mu, node.mu.T)


def without_form(node: Node) -> None:
    node._gyroscopic = ca.SX(*node._gyroscopic.shape)


def large_form(node: Node) -> None:
    node._gyroscopic *= 1 + 1e-9


def columns_first(self: SystemExpressions, x: ca.SX, theta: ca.SX) -> ca.SX:
    flat = self.system.recorded("constraints").call_sx(x, theta)
    return ca.reshape(flat, self.constraint_count, self.rank)


def momentum_of_mass(self: SystemExpressions, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
    return ca.mtimes(self.metric(x, theta), xi)


def velocity_of_all(self: SystemExpressions, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
    return solve_linear(self.metric(x, theta), p)


def kinetic(self: SystemExpressions, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
    return ca.dot(xi, ca.mtimes(self.metric(x, theta), xi)) / 2


def energy_minus_potential(self: SystemExpressions, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
    xi = self.velocity(x, p, theta)
    return kinetic(self, x, xi, theta) - self.potential(x, theta)


def energy_with_form(self: SystemExpressions, x: ca.SX, p: ca.SX, theta: ca.SX) -> ca.SX:
    xi = self.velocity(x, p, theta)
    return (
        kinetic(self, x, xi, theta) + ca.dot(self.section("gyroscopic", x, theta), xi)
        + self.potential(x, theta)
    )


def half_of_each_pair(self: SystemExpressions, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
    matrix = self.metric(x, theta)
    diagonal = ca.dot(ca.diag(matrix), xi * xi) / 2
    pairs = ca.dot(xi, ca.mtimes(ca.triu(matrix, False), xi)) / 2
    linear = ca.dot(self.section("gyroscopic", x, theta), xi)
    return diagonal + pairs + linear - self.potential(x, theta)


def gradient_of_the_rest(self: SystemExpressions, x: ca.SX, xi: ca.SX, theta: ca.SX) -> ca.SX:
    """The metric forgotten."""
    rest = ca.dot(self.section("gyroscopic", x, theta), xi) - self.potential(x, theta)
    return ca.gradient(rest, x)


def c_for_fortran(self: RecordedFunction, argument_index: int) -> RecordedFunction:
    """The entries of a derivative of a term column by column."""
    sound = _DERIVATIVE(self, argument_index)
    if self.name not in TERMS:
        return sound
    shape = (int(np.prod(self.output_shape)), sound.output_shape[-1])
    inputs = sound.function.sx_in()
    flat = ca.vec(as_matrix(sound.call_sx(*inputs), *shape))
    function = ca.Function(sound.function.name(), inputs, [flat])
    return RecordedFunction(sound.name, function, sound.input_shapes, sound.output_shape)


_DERIVATIVE = RecordedFunction.derivative
_IMPULSE = Node.impulse
_MULTIPLIERS = SystemExpressions.multipliers
_AD_STAR = gni.SE2.ad_star
_ANCHOR = gni.ProductGroupoid.anchor
_NEAREST = starts._nearest_velocity


def near_without_metric(v: Any, metric: Any, mu: Any, violation: Any) -> Any:
    return _NEAREST(v, np.eye(len(v)), mu, violation)


def laws(names: str) -> frozenset[str]:
    return frozenset(names.split())


BROKEN = [
    Broken(
        "P used for Q in the projection",
        mutant(Node, "project", only_normal_part),
        laws(
            "projectors_are_complementary projectors_annihilate_each_other "
            "projectors_are_orthogonal velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints removed_covectors_are_constraint_forces "
            "projection_is_the_dense_one"
        ),
    ),
    Broken(
        "P and Q exchanged in the reflection",
        mutant(Node, "reflect", exchanged),
        laws(
            "reflection_is_the_dense_one reflection_is_an_involution reflection_is_an_isometry "
            "change_of_reflection_is_linear mean_of_an_impact_obeys_the_constraints "
            "reflection_is_gauge_invariant"
        ),
    ),
    Broken(
        "+2 Q* Pi as printed in (38b)",
        mutant(Node, "reflect", printed_sign),
        laws(
            "reflection_is_the_dense_one reflection_is_an_isometry "
            "mean_of_an_impact_obeys_the_constraints reflection_is_gauge_invariant"
        ),
    ),
    Broken(
        "reflection without its factor 2",
        mutant(Node, "reflect", soft),
        laws(
            "reflection_is_the_dense_one reflection_is_an_involution reflection_is_an_isometry "
            "change_of_reflection_is_linear mean_of_an_impact_obeys_the_constraints"
        ),
    ),
    Broken(
        "reflection without its factor 2, linear",
        mutant(Node, "reflect", soft, **LINEAR),
        laws(
            "reflection_is_the_dense_one reflection_is_an_involution reflection_is_an_isometry "
            "linear_reflection_keeps_kinetic_energy change_of_reflection_is_linear "
            "mean_of_an_impact_obeys_the_constraints"
        ),
    ),
    Broken(
        "the affine part in a change of momentum",
        mutant(Node, "reflect_change", Node.reflect),
        laws("change_of_reflection_is_linear"),
    ),
    Broken(
        "G in place of G^-1 in Q*",
        mutant(Node, "__init__", node_with(lowered)),
        laws(
            "projectors_are_orthogonal velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints projection_is_the_dense_one "
            "impulse_is_the_dense_one normal_vectors_are_orthonormal "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "multipliers_are_the_dense_ones motion_keeps_the_constraints"
        ),
    ),
    Broken(
        "mu mu^T in place of C",
        mutant(Node, "__init__", node_with(euclidean_gram)),
        laws(
            "projectors_are_idempotent projectors_annihilate_each_other projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints projection_is_the_dense_one "
            "impulse_is_the_dense_one reflection_is_the_dense_one reflection_is_an_involution "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "multipliers_are_the_dense_ones motion_keeps_the_constraints"
        ),
    ),
    Broken(
        "C replaced by its diagonal",
        mutant(Node, "__init__", node_with(diagonal_gram)),
        laws(
            "projectors_are_idempotent projectors_annihilate_each_other projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints projection_is_the_dense_one "
            "impulse_is_the_dense_one reflection_is_the_dense_one reflection_is_an_involution "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "rows_may_be_recombined multipliers_are_the_dense_ones motion_keeps_the_constraints"
        ),
    ),
    Broken(
        "gradients Z^a where rows mu^a belong",
        mutant(Node, "project", along_gradients),
        laws(
            "projectors_are_complementary projectors_are_idempotent "
            "projectors_annihilate_each_other projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints removed_covectors_are_constraint_forces "
            "projection_is_the_dense_one"
        ),
    ),
    Broken(
        "Pi without A",
        mutant(Node, "__init__", node_with(without_form)),
        laws(
            "projection_is_the_dense_one impulse_is_the_dense_one "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "reflection_is_gauge_invariant"
        ),
    ),
    Broken(
        "rows of mu read column by column",
        mutant(SystemExpressions, "constraints", columns_first),
        laws(
            "projectors_are_complementary projectors_are_idempotent "
            "projectors_annihilate_each_other projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints removed_covectors_are_constraint_forces "
            "projection_is_the_dense_one impulse_is_the_dense_one "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "mean_of_an_impact_obeys_the_constraints momentum_moves_by_the_forces "
            "multipliers_are_the_dense_ones motion_keeps_the_constraints "
            "constraints_work_along_the_drift"
        ),
    ),
    Broken(
        "rows mu^a as the normal basis",
        mutant(Node, "normal_vector", lambda self, c: ca.mtimes(self.mu.T, c)),
        laws("normal_vectors_are_orthonormal normal_components_are_coordinates"),
    ),
    Broken(
        "L^-1 for L^-T in the normal basis",
        mutant(Node, "normal_vector", transposed_basis),
        laws("normal_vectors_are_orthonormal normal_components_are_coordinates"),
    ),
    Broken(
        "momentum without A",
        mutant(SystemExpressions, "momentum", momentum_of_mass),
        laws("momentum_is_the_slope_of_the_lagrangian velocity_inverts_momentum"),
    ),
    Broken(
        "velocity with A",
        mutant(SystemExpressions, "velocity", velocity_of_all),
        laws(
            "velocity_inverts_momentum energy_is_the_legendre_transform base_moves_by_the_anchor "
            "momentum_moves_by_the_forces multipliers_are_the_dense_ones "
            "motion_keeps_the_constraints constraints_work_along_the_drift"
        ),
    ),
    Broken(
        "energy with -V",
        mutant(SystemExpressions, "energy", energy_minus_potential),
        laws("energy_is_the_legendre_transform"),
    ),
    Broken(
        "energy with A",
        mutant(SystemExpressions, "energy", energy_with_form),
        laws("energy_is_the_legendre_transform"),
    ),
    Broken(
        "half of each pair in the Lagrangian",
        mutant(SystemExpressions, "lagrangian", half_of_each_pair),
        laws(
            "lagrangian_is_the_plain_one energy_is_the_legendre_transform "
            "base_gradient_is_the_slope_of_the_lagrangian momentum_moves_by_the_forces "
            "multipliers_are_the_dense_ones constraints_work_along_the_drift"
        ),
    ),
    Broken(
        "metric forgotten in dL/dx",
        mutant(SystemExpressions, "base_gradient", gradient_of_the_rest),
        laws(
            "base_gradient_is_the_slope_of_the_lagrangian momentum_moves_by_the_forces "
            "multipliers_are_the_dense_ones constraints_work_along_the_drift"
        ),
    ),
    Broken(
        "metric forgotten in dL/dx, linear",
        mutant(SystemExpressions, "base_gradient", gradient_of_the_rest, **LINEAR),
        laws(
            "base_gradient_is_the_slope_of_the_lagrangian momentum_moves_by_the_forces "
            "multipliers_are_the_dense_ones motion_keeps_the_energy"
        ),
    ),
    Broken(
        "bracket of the other side",
        mutant(gni.SE2, "ad_star", lambda self, x, xi, p: -_AD_STAR(self, x, xi, p)),
        laws("momentum_moves_by_the_forces multipliers_are_the_dense_ones"),
    ),
    Broken(
        "anchor of the inverse action",
        mutant(gni.ProductGroupoid, "anchor", lambda self, x: -_ANCHOR(self, x)),
        laws(
            "base_moves_by_the_anchor momentum_moves_by_the_forces multipliers_are_the_dense_ones"
        ),
    ),
    Broken(
        "sign of the multipliers",
        mutant(SystemExpressions, "multipliers", lambda *a: -_MULTIPLIERS(*a)),
        laws("multipliers_are_the_dense_ones motion_keeps_the_constraints"),
    ),
    Broken(
        "derivatives in column order",
        mutant(RecordedFunction, "derivative", c_for_fortran),
        laws(
            "slope_of_metric_is_that_of_the_plain_one "
            "slope_of_constraints_is_that_of_the_plain_one "
            "slope_of_drift_is_that_of_the_plain_one slope_of_gyroscopic_is_that_of_the_plain_one"
        ),
    ),
    Broken(
        "nearest velocity without the metric",
        mutant(starts, "_nearest_velocity", near_without_metric),
        laws("states_are_consistent"),
    ),
    Broken(
        "impulse too large by 1e-9",
        mutant(Node, "impulse", lambda *a: _IMPULSE(*a) * (1 + 1e-9)),
        laws(
            "projectors_are_idempotent projectors_annihilate_each_other projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints projection_is_the_dense_one "
            "impulse_is_the_dense_one reflection_is_the_dense_one reflection_is_an_involution "
            "reflection_is_an_isometry change_of_reflection_is_linear "
            "mean_of_an_impact_obeys_the_constraints"
        ),
    ),
    Broken(
        "A too large by 1e-9 in Pi",
        mutant(Node, "__init__", node_with(large_form)),
        laws(
            "projection_is_the_dense_one impulse_is_the_dense_one "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "reflection_is_gauge_invariant"
        ),
    ),
    Broken(
        "a global that changes by 3e-10",
        after_building(1.0 + 3e-10),
        laws(
            "projectors_are_complementary projectors_are_idempotent projection_is_the_dense_one "
            "impulse_is_the_dense_one normal_vectors_are_orthonormal "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "reflection_is_an_isometry mean_of_an_impact_obeys_the_constraints "
            "recorded_metric_is_the_plain_one recorded_constraints_is_the_plain_one "
            "recorded_potential_is_the_plain_one recorded_drift_is_the_plain_one "
            "recorded_gyroscopic_is_the_plain_one slope_of_metric_is_that_of_the_plain_one "
            "slope_of_constraints_is_that_of_the_plain_one "
            "slope_of_potential_is_that_of_the_plain_one slope_of_drift_is_that_of_the_plain_one "
            "slope_of_gyroscopic_is_that_of_the_plain_one lagrangian_is_the_plain_one "
            "momentum_is_the_slope_of_the_lagrangian energy_is_the_legendre_transform "
            "base_gradient_is_the_slope_of_the_lagrangian base_moves_by_the_anchor "
            "momentum_moves_by_the_forces multipliers_are_the_dense_ones "
            "motion_keeps_the_constraints constraints_work_along_the_drift states_are_consistent"
        ),
    ),
    Broken(
        "a global that changes by 3e-10, linear",
        after_building(1.0 + 3e-10, **LINEAR),
        laws(
            "projectors_are_complementary projectors_are_idempotent impulse_is_the_dense_one "
            "normal_vectors_are_orthonormal recorded_metric_is_the_plain_one "
            "recorded_constraints_is_the_plain_one recorded_potential_is_the_plain_one "
            "slope_of_metric_is_that_of_the_plain_one "
            "slope_of_constraints_is_that_of_the_plain_one "
            "slope_of_potential_is_that_of_the_plain_one lagrangian_is_the_plain_one "
            "momentum_is_the_slope_of_the_lagrangian energy_is_the_legendre_transform "
            "base_gradient_is_the_slope_of_the_lagrangian base_moves_by_the_anchor "
            "momentum_moves_by_the_forces multipliers_are_the_dense_ones motion_keeps_the_energy "
            "states_are_consistent"
        ),
    ),
    Broken(
        "potential that rounds when run plainly",
        lambda: report(system(potential=rounded_height)),
        laws(
            "recorded_potential_is_the_plain_one lagrangian_is_the_plain_one "
            "energy_is_the_legendre_transform states_are_consistent"
        ),
    ),
    Broken(
        "metric that is not symmetric",
        lambda: report(system(metric=np.eye(4) + 0.1 * np.eye(4, k=1))),
        laws(
            "metric_is_symmetric velocity_inverts_momentum base_moves_by_the_anchor "
            "momentum_moves_by_the_forces projectors_are_orthogonal "
            "velocities_split_into_allowed_and_orthogonal "
            "projected_covectors_obey_the_constraints projection_is_the_dense_one "
            "impulse_is_the_dense_one normal_vectors_are_orthonormal "
            "normal_components_are_coordinates reflection_is_the_dense_one "
            "reflection_is_an_isometry "
            "mean_of_an_impact_obeys_the_constraints lagrangian_is_the_plain_one "
            "momentum_is_the_slope_of_the_lagrangian energy_is_the_legendre_transform "
            "multipliers_are_the_dense_ones motion_keeps_the_constraints "
            "constraints_work_along_the_drift states_are_consistent"
        ),
    ),
    Broken(
        "metric that is not positive",
        lambda: report(system(metric=np.diag([1.0, 1.0, 1.0, -0.5]), constraints=None, **LINEAR)),
        laws(
            "metric_is_positive_definite lagrangian_is_the_plain_one "
            "momentum_is_the_slope_of_the_lagrangian velocity_inverts_momentum "
            "energy_is_the_legendre_transform base_gradient_is_the_slope_of_the_lagrangian "
            "base_moves_by_the_anchor momentum_moves_by_the_forces motion_keeps_the_energy "
            "states_are_consistent"
        ),
    ),
]
