"""MatrixGroup: against closed forms and SciPy's expm and logm; where Cayley leaves; refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, logm

import groupoid_gni as gni
from groupoid_gni.expressions import record


def unit(n: int, i: int, j: int) -> Any:
    matrix = np.zeros((n, n))
    matrix[i, j] = 1.0
    return matrix


def spin_two() -> Any:
    """so(3) on traceless symmetric matrices, five dimensions: all orthogonal, 5 x 5."""
    shapes = [
        (unit(3, 0, 1) + unit(3, 1, 0)) / np.sqrt(2),
        (unit(3, 0, 2) + unit(3, 2, 0)) / np.sqrt(2),
        (unit(3, 1, 2) + unit(3, 2, 1)) / np.sqrt(2),
        np.diag([1.0, -1.0, 0.0]) / np.sqrt(2),
        np.diag([1.0, 1.0, -2.0]) / np.sqrt(6),
    ]
    images = [[w @ s - s @ w for s in shapes] for w in gni.SO3().basis]
    return [[[np.sum(r * image) for image in row] for r in shapes] for row in images]


GL2 = [unit(2, i, j) for i in range(2) for j in range(2)]
SL2 = [np.diag([1.0, -1.0]), unit(2, 0, 1), unit(2, 1, 0)]
SL3 = [unit(3, i, j) for i in range(3) for j in range(3) if i != j]
SL3 += [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])]
MIXING = np.array([[0.9, 0.3, -0.2], [0.1, 1.2, 0.4], [-0.5, 0.2, 0.7]])
ALGEBRAS = {
    "GL(2)": GL2,
    "SL(2)": SL2,
    "SL(3)": SL3,
    "triangular": [unit(3, i, j) for i in range(3) for j in range(i + 1)],
    "Heisenberg": [unit(3, 0, 1), unit(3, 1, 2), unit(3, 0, 2)],
    "similarities": [*gni.SE2().basis, np.diag([1.0, 1.0, 0.0])],
    "Poincare line": [unit(3, 0, 1) + unit(3, 1, 0), unit(3, 0, 2), unit(3, 1, 2)],
    "SE(3), oblique": np.einsum("ab,bij->aij", np.kron(np.eye(2), MIXING), gni.SE3().basis),
    "spin 2": spin_two(),
    "one squeeze": [np.diag([1.0, 2.0])],
}
CAYLEY_LEAVES = {"SL(3)", "spin 2", "one squeeze"}


def group_of(name: str, **options: Any) -> gni.MatrixGroup:
    retraction = gni.Exponential() if name in CAYLEY_LEAVES else gni.Cayley()
    return gni.MatrixGroup(ALGEBRAS[name], **{"retraction": retraction, **options})


def vectors(dimension: int, count: int = 6, size: float = 0.7) -> Any:
    rng = np.random.default_rng(31 * dimension + count)
    return size * rng.uniform(-1.0, 1.0, (count, dimension)) / np.sqrt(dimension)


def close(ours: Any, theirs: Any, tolerance: float = 1e-13) -> None:
    scale = 1.0 + np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("retraction", [gni.Cayley(), gni.Exponential()], ids=repr)
@pytest.mark.parametrize("kind", [gni.SO2, gni.SO3, gni.SE2, gni.SE3])
def test_the_closed_forms_are_special_cases(kind: Any, retraction: Any, side: str) -> None:
    closed = kind(side=side, retraction=retraction)
    general = gni.MatrixGroup(closed.basis, side=side, retraction=retraction)
    xi = vectors(closed.dimension, size=2.0)
    g, h = closed.exp(xi), closed.exp(xi[::-1] / 3)
    for name in ("hat", "ad", "exp", "dexp", "dexp_inverse", "cay", "dcay", "dcay_inverse",
                 "cay_half", "rotation_size", "tau", "dtau", "half_vector"):
        close(getattr(general, name)(xi), getattr(closed, name)(xi), 1e-12)
    for name in ("vee", "log", "cay_inverse", "inverse_element", "Ad", "translated_basis"):
        argument = closed.hat(xi) if name == "vee" else g
        close(getattr(general, name)(argument), getattr(closed, name)(argument), 1e-12)
    point = np.zeros((len(xi), 0))
    close(general.multiply(general.flatten(g), general.flatten(h)),
          closed.multiply(closed.flatten(g), closed.flatten(h)))
    for name in ("trivialised_tangent_plus", "trivialised_tangent_minus"):
        close(getattr(general, name)(point, xi), getattr(closed, name)(point, xi), 1e-12)
    # the closed logarithm reaches half a turn, the general one 3 radians
    shorter = np.pi / 3.0 if retraction == gni.Exponential() else 1.0
    close(general.reach(point, xi), shorter * closed.reach(point, xi), 1e-12)
    close(general.bracket(point[0]), closed.bracket(point[0]))


@pytest.mark.parametrize("name", ALGEBRAS)
def test_exponential_logarithm_and_adjoint_are_those_of_matrices(name: str) -> None:
    group = group_of(name)
    for xi, eta in zip(vectors(group.dimension), vectors(group.dimension, 7), strict=False):
        g = expm(group.hat(xi))
        close(group.exp(xi), g)
        close(group.hat(group.log(g)), logm(g).real, 1e-12)
        close(group.inverse_element(g), expm(-group.hat(xi)))
        close(group.hat(group.Ad(g) @ eta), g @ group.hat(eta) @ np.linalg.inv(g))
        close(group.Ad(g), expm(group.ad(xi)), 1e-12)


@pytest.mark.parametrize("name", ALGEBRAS)
def test_the_laws_of_a_retraction(name: str) -> None:
    group, step = group_of(name), 1e-5
    close(group.tau(np.zeros(group.dimension)), group.identity_element, 1e-16)
    for xi, eta in zip(vectors(group.dimension), vectors(group.dimension, 7), strict=False):
        g = group.tau(xi)
        close(g @ group.tau(-xi), group.identity_element)
        close(group.tau_inverse(g), xi, 1e-12)
        half = group.tau(group.half_vector(xi))
        close(half @ half, g)
        close(group.dtau(xi), group.Ad(g) @ group.dtau(-xi), 1e-12)  # (53)
        change = (group.tau(xi + step * eta) - group.tau(xi - step * eta)) / (2 * step)
        close(group.hat(group.dtau(xi) @ eta), change @ np.linalg.inv(g), 1e-8)  # definition 9.1


@pytest.mark.parametrize("name", ALGEBRAS)
def test_cayley_is_refused_exactly_where_it_leaves(name: str) -> None:
    group = group_of(name, retraction=gni.Exponential())
    outside = []
    for xi in vectors(group.dimension):
        algebra_vector = logm(group.cay(xi)).real
        outside.append(np.abs(algebra_vector - group.hat(group.vee(algebra_vector))).max())
    if name in CAYLEY_LEAVES:
        assert max(outside) > 1e-4
        with pytest.raises(gni.InputError, match=r"leaves this group.*retraction=Exponential\(\)"):
            gni.MatrixGroup(ALGEBRAS[name])
    else:
        assert max(outside) < 1e-13
        assert gni.MatrixGroup(ALGEBRAS[name]).retraction == gni.Cayley()


@pytest.mark.parametrize("name", ["GL(2)", "SL(3)", "Heisenberg", "SE(3), oblique"])
def test_recorded_functions_give_the_same_numbers(name: str) -> None:
    group = group_of(name)
    xi = vectors(group.dimension, 3)[0]
    g = group.exp(xi)
    functions = {"exp": xi, "dexp_inverse": xi, "dexp": xi, "dcay_inverse": xi, "ad": xi,
                 "rotation_size": xi, "cay": xi, "half_vector": xi, "tau_inverse": g, "Ad": g,
                 "inverse_element": g, "element_defect": g, "restore_element": g}
    for function, argument in functions.items():
        plain = getattr(group, function)
        expected = plain(argument)
        recorded = record(plain, {"a": argument.shape}, np.shape(expected), name=function)
        close(recorded(argument), expected)


@pytest.mark.parametrize("angle", [np.pi / 2, np.pi / 2 - 1e-9])
def test_the_recorded_inverse_at_a_quarter_turn(angle: float) -> None:
    """Elimination without pivots is wrong by 0.1 there: the first entry is 6e-17."""
    closed, general = gni.SE3(), gni.MatrixGroup(gni.SE3().basis)
    pose = closed.flatten(closed.exp(np.array([0.0, 0.0, angle, 110.0, -20.0, 3.0])))
    recorded = record(general.inverse, {"g": (16,)}, (16,), name="inverse")
    np.testing.assert_allclose(recorded(pose), closed.inverse(pose), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ALGEBRAS)
def test_the_reach_bounds_eigenvalues(name: str) -> None:
    group = group_of(name)
    for xi in vectors(group.dimension, 40):
        eigenvalues = np.linalg.eigvals(group.hat(xi))
        bounded = np.abs(eigenvalues.imag if name == "SL(3)" else eigenvalues).max()
        # Nilpotent matrices have numerical eigenvalues of size cube root of round-off.
        assert bounded <= group.rotation_size(xi) + 1e-5


def test_the_reach_is_free_of_the_unit_of_length() -> None:
    xi = np.array([0.31, -0.42, 0.53, 8e4, 7e3, -9e5])
    oblique = np.array(ALGEBRAS["SE(3), oblique"])
    inner = np.array(
        [[1.0, 0.2, 0.0, 0.0], [0.3, 1.1, 0.0, 0.1], [0.0, 0.4, 0.9, 0.0], [0.0, 0.0, 0.0, 2.0]]
    )
    turned = inner @ oblique @ np.linalg.inv(inner)
    assert gni.MatrixGroup(gni.SE3().basis).rotation_size(xi) == pytest.approx(
        np.linalg.norm(xi[:3]), rel=1e-15
    )
    still = np.concatenate([np.zeros(3), xi[3:]])
    assert gni.MatrixGroup(turned).rotation_size(still) < 1e-8
    triangular = group_of("triangular")
    assert triangular.rotation_size(np.array([0.6, 50.0, 0.8, 70.0, 9.0, 0.0])) == 1.0


def test_the_components_do_not_depend_on_units() -> None:
    scales = np.array([1e-9, 3.0, 1e8, 1e-4, 1e11, 0.2])
    group = gni.MatrixGroup(scales[:, None, None] * gni.SE3().basis)
    xi = np.array([0.31, -0.42, 0.53, 8.0, -0.07, 2.2]) / scales
    np.testing.assert_allclose(group.vee(group.hat(xi)), xi, rtol=1e-14)
    np.testing.assert_allclose(group.ad(xi) @ xi * scales, np.zeros(6), atol=1e-14)


def test_quadratic_groups_share_hat_and_vee() -> None:
    assert issubclass(gni.QuadraticGroup, gni.MatrixGroup)
    assert gni.QuadraticGroup.hat is gni.MatrixGroup.hat
    assert gni.QuadraticGroup.vee is gni.MatrixGroup.vee
    assert "dimension 6" in repr(gni.QuadraticGroup(np.eye(4)))
    general = gni.MatrixGroup(gni.QuadraticGroup(np.eye(4)).basis)
    assert repr(general) == (
        "MatrixGroup(<4 x 4, dimension 6>, side='left', retraction=Cayley())"
    )


@pytest.mark.parametrize(
    ("basis", "message"),
    [
        (np.eye(2), r"shape \(d, n, n\).*\(2, 2\)"),
        (np.zeros((2, 2, 3)), r"\(2, 2, 3\)"),
        (np.zeros((0, 2, 2)), r"\(0, 2, 2\)"),
        ([[[1.0, 2.0], [3.0, 4.0]], [[1.0]]], "of one size"),
        ([1j * np.eye(2)], r"real \[\[A, -B\], \[B, A\]\]"),
        ([np.eye(2), np.diag([1.0, np.nan])], r"basis\[1\] has entries that are not finite"),
        ([*SL2, 2.5 * SL2[1]], r"basis\[3\] is a combination"),
        ([np.zeros((2, 2))], r"basis\[0\] is a combination"),
        (gni.SO3().basis[:2], r"basis\[0\] basis\[1\] - basis\[1\] basis\[0\] is not in the span"),
        (1e-6 * gni.SO3().basis[:2], "not in the span"),
    ],
)
def test_refused_bases(basis: Any, message: str) -> None:
    with pytest.raises(gni.InputError, match=message):
        gni.MatrixGroup(basis)


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_geodesics_of_the_general_linear_group(method: Any) -> None:
    """For <X, Y> = tr X^T Y the geodesic through 1 is exp(t A^T) exp(t (A - A^T))."""
    group = gni.MatrixGroup(GL2)
    velocity, t_end = np.array([[0.3, -0.5], [0.7, 0.2]]), 2.0
    exact = expm(t_end * velocity.T) @ expm(t_end * (velocity - velocity.T))
    system = gni.MechanicalSystem(group, metric=np.eye(4))
    start = system.state(velocity=group.vee(velocity))
    errors = []
    for step in (0.04, 0.02):
        run = gni.integrate(system, start, step=step, t_end=t_end, method=method)
        errors.append(np.abs(run.reconstruct()[-1] - exact).max())
        assert np.ptp(run.energy()) < 1e-13
    assert errors[0] < 2e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_a_nonholonomic_run_on_the_heisenberg_group() -> None:
    """Nothing turns there, so steps of any size are allowed; constraint and energy are exact."""
    group = group_of("Heisenberg", side="right")
    system = gni.MechanicalSystem(
        group, metric=np.diag([1.3, 0.8, 2.1]), constraints=[[0.2, 0.0, 1.0]]
    )
    start = system.state(velocity=[400.0, 900.0, -80.0])
    run = gni.integrate(system, start, step=1e-4, t_end=0.02)
    assert np.ptp(run.energy()) < 1e-12 * run.energy()[0]
    assert np.abs(run.constraint_residuals()).max() < 1e-10
    assert np.ptp(run.velocities, axis=0).max() > 10.0
    assert np.abs(np.diagonal(run.reconstruct(), axis1=1, axis2=2) - 1.0).max() < 1e-13


@pytest.mark.slow
def test_a_run_on_a_group_that_cayley_leaves() -> None:
    group = group_of("SL(3)")
    rng = np.random.default_rng(8)
    root = rng.normal(size=(8, 8)) / 4
    system = gni.MechanicalSystem(
        group, metric=root @ root.T + np.diag(rng.uniform(0.7, 2.3, 8)),
        constraints=rng.normal(size=(1, 8)),
    )
    start = system.state(velocity=rng.normal(size=8) / 3, project_start=True)
    run = gni.integrate(system, start, step=0.05, t_end=1.0)
    assert np.abs(np.linalg.det(run.reconstruct()) - 1.0).max() < 1e-12
    assert np.abs(run.constraint_residuals()).max() < 1e-13
    finer = gni.integrate(system, start, step=0.025, t_end=1.0)
    finest = gni.integrate(system, start, step=0.0125, t_end=1.0)
    there = [r.velocities[-1] for r in (run, finer, finest)]
    ratio = np.linalg.norm(there[0] - there[1]) / np.linalg.norm(there[1] - there[2])
    assert np.log2(ratio) == pytest.approx(2.0, abs=0.1)
