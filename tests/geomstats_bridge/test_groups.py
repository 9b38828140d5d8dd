"""LieGroup.from_geomstats: the groups, through the solver, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.geomstats_bridge import geomstats_module

SPACES = {
    "SO(2)": ("special_orthogonal.SpecialOrthogonal", 2),
    "SO(3)": ("special_orthogonal.SpecialOrthogonal", 3),
    "SO(4)": ("special_orthogonal.SpecialOrthogonal", 4),
    "SO(5)": ("special_orthogonal.SpecialOrthogonal", 5),
    "SE(2)": ("special_euclidean.SpecialEuclidean", 2),
    "SE(3)": ("special_euclidean.SpecialEuclidean", 3),
    "SE(4)": ("special_euclidean.SpecialEuclidean", 4),
    "GL(3)": ("general_linear.GeneralLinear", 3),
    "triangular": ("positive_lower_triangular_matrices.PositiveLowerTriangularMatrices", 3),
}
EXPONENTIAL = gni.Exponential()


def space_of(name: str, **options: Any) -> Any:
    (module, kind), n = SPACES[name][0].split("."), SPACES[name][1]
    return getattr(geomstats_module(f"geomstats.geometry.{module}"), kind)(n, **options)


def vectors(dimension: int, size: float = 0.8) -> Any:
    rng = np.random.default_rng(7 * dimension)
    return size * rng.uniform(-1.0, 1.0, (5, dimension)) / np.sqrt(dimension)


@pytest.mark.parametrize("name", SPACES)
def test_the_group_is_that_of_geomstats(name: str) -> None:
    space = space_of(name)
    group = gni.LieGroup.from_geomstats(space, retraction=EXPONENTIAL)
    assert type(group) is (gni.QuadraticGroup if "SO" in name else gni.MatrixGroup)
    assert np.array_equal(group.basis, space.lie_algebra.basis)
    xi = vectors(group.dimension)
    close = {"rtol": 0, "atol": 2e-14}
    np.testing.assert_allclose(group.hat(xi), space.lie_algebra.matrix_representation(xi), **close)
    a, b = group.exp(xi), group.exp(1.7 * xi[::-1])
    np.testing.assert_allclose(a, space.exp(group.hat(xi)), **close)
    np.testing.assert_allclose(group.compose(a, b), space.compose(a, b), **close)
    np.testing.assert_allclose(group.inverse_element(a), space.inverse(a), **close)
    assert np.all(space.belongs(a))
    assert np.all(space.belongs(group.cay(xi)))
    if name != "triangular":  # geomstats has no bracket there
        theirs = space.lie_algebra.bracket(group.hat(xi), group.hat(xi[::-1]))
        ours = group.hat((group.ad(xi) @ xi[::-1][..., None])[..., 0])
        np.testing.assert_allclose(ours, theirs, **close)
    np.testing.assert_allclose(group.hat(group.log(a[0])), space.log(a[0]), rtol=0, atol=1e-12)


def test_options_are_handed_on() -> None:
    for name in ("SO(4)", "SE(3)"):
        group = gni.LieGroup.from_geomstats(space_of(name), side="right", retraction=EXPONENTIAL)
        assert (group.side, group.retraction) == ("right", EXPONENTIAL)
        plain = gni.MatrixGroup.from_geomstats(space_of(name))
        assert (plain.side, plain.retraction) == ("left", gni.Cayley())
    np.testing.assert_array_equal(
        gni.QuadraticGroup.from_geomstats(space_of("SO(4)")).quadratic_form, np.eye(4)
    )


def like_a_space(basis: Any, **changes: Any) -> Any:
    """An object with the attributes that are read, and no more."""
    facts = {
        "lie_algebra": SimpleNamespace(basis=basis),
        "identity": np.eye(np.shape(basis)[-1]),
        "belongs": lambda element: True,
        "compose": lambda a, b: a @ b,
    }
    return SimpleNamespace(**{**facts, **changes})


@pytest.mark.parametrize(
    "form",
    [
        np.diag([-1.0, 1.0, 1.0, 1.0]),
        np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 3.0]]),
        np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]]),
    ],
    ids=["Lorentz", "weighted", "symplectic"],
)
def test_any_quadratic_form_is_found(form: Any) -> None:
    algebra = gni.QuadraticGroup(form).basis
    mixing = np.random.default_rng(3).normal(size=(len(algebra),) * 2)
    basis = np.einsum("ab,bij->aij", mixing, algebra)
    group = gni.LieGroup.from_geomstats(like_a_space(basis))
    assert isinstance(group, gni.QuadraticGroup)
    index = np.unravel_index(np.abs(form).argmax(), form.shape)
    found = group.quadratic_form / group.quadratic_form[index]
    expected = form / form[index]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_subgroups_of_rotations_are_no_quadratic_groups() -> None:
    """The forms of two planes are many; that of unit quaternions belongs to all of SO(4)."""
    planes = np.zeros((2, 4, 4))
    planes[0, :2, :2] = planes[1, 2:, 2:] = [[0.0, -1.0], [1.0, 0.0]]
    two_turns = np.array([[0.0, -1.0], [1.0, 0.0]])
    swap, signs = np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([1.0, -1.0])
    quaternions = [np.kron(np.eye(2), two_turns), np.kron(two_turns, signs),
                   np.kron(two_turns, swap)]
    for basis in (planes, quaternions):
        assert type(gni.LieGroup.from_geomstats(like_a_space(basis))) is gni.MatrixGroup


SL3 = [np.outer(a, b) for a in np.eye(3) for b in np.eye(3) if a @ b == 0.0]
SL3 += [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])]
TURNS = gni.SO3().basis


@pytest.mark.parametrize(
    ("space", "message"),
    [
        (lambda: geomstats_module("geomstats.geometry.special_orthogonal").SpecialOrthogonal,
         r"a class; pass an instance, such as SpecialOrthogonal\(n=3\)"),
        (lambda: space_of("SO(3)", point_type="vector"), r"\(3,\).*point_type='matrix'"),
        (lambda: space_of("SE(3)", point_type="vector"), r"\(6,\).*point_type='matrix'"),
        (lambda: geomstats_module("geomstats.geometry.heisenberg").HeisenbergVectors(),
         r"Heisenberg.*MatrixGroup\(basis\)"),
        (lambda: geomstats_module("geomstats.geometry.hypersphere").Hypersphere(2),
         "no lie_algebra.*PairGroupoid"),
        (lambda: np.eye(3), "no lie_algebra"),
        (lambda: like_a_space(TURNS, lie_algebra=SimpleNamespace()), "no basis of matrices"),
        (lambda: like_a_space(TURNS, compose=lambda a, b: b @ a), r"its compose\(g, h\) is not"),
        (lambda: like_a_space(TURNS, identity=2.0 * np.eye(3)), "its identity is not"),
        (lambda: like_a_space(TURNS, identity=np.eye(4)), "its identity is not"),
        (lambda: like_a_space(TURNS, belongs=lambda g: g[0, 1] == 0.0), "another group"),
        (lambda: like_a_space(TURNS, belongs=lambda g: g.numpy()), "GEOMSTATS_BACKEND=numpy"),
        (lambda: like_a_space(TURNS[:2]), "not in the span of the basis"),
        (lambda: like_a_space(SL3), r"leaves this group.*retraction=Exponential\(\)"),
    ],
)
def test_refused_spaces(space: Any, message: str) -> None:
    with pytest.raises(gni.InputError, match=message):
        gni.LieGroup.from_geomstats(space())


def test_the_result_is_of_the_class_that_was_asked() -> None:
    with pytest.raises(gni.InputError, match=r"QuadraticGroup: write LieGroup\.from_geomstats"):
        gni.SO3.from_geomstats(space_of("SO(3)"))
    with pytest.raises(gni.InputError, match="would give a MatrixGroup"):
        gni.QuadraticGroup.from_geomstats(space_of("SE(3)"))
    assert gni.LieGroup.from_geomstats(like_a_space(SL3), retraction=EXPONENTIAL).dimension == 8


# Through the solver.

def spd(dimension: int, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(dimension, dimension))
    return root @ root.T / dimension + np.diag(rng.uniform(0.7, 2.3, dimension))


def system_of(group: Any, change: Any) -> Any:
    """A system of dimension 6 with awkward numbers, in the frame e_a = change[a, b] e'_b."""
    rng = np.random.default_rng(11)
    rows, velocity = rng.normal(size=(2, 6)), rng.normal(size=6)
    system = gni.MechanicalSystem(
        group,
        metric=lambda x, p: p.m * change @ spd(6, 5) @ change.T,
        constraints=rows @ change.T,
        parameters={"m": 1.37},
    )
    return system, system.state(velocity=np.linalg.inv(change).T @ velocity, project_start=True)


def integrate(group: Any, change: Any, method: Any) -> Any:
    system, start = system_of(group, change)
    return gni.integrate(system, start, step=0.04, t_end=1.6, method=method)


def compare(ours: Any, theirs: Any, change: Any) -> None:
    np.testing.assert_allclose(ours.velocities @ change, theirs.velocities, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.reconstruct(), theirs.reconstruct(), rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.energy(), theirs.energy(), rtol=0, atol=1e-12)
    assert np.abs(ours.constraint_residuals()).max() < 1e-13
    assert np.ptp(theirs.velocities, axis=0).max() > 0.1


@pytest.mark.parametrize(("side", "method"), [("left", None), ("right", gni.Rattle())], ids=str)
def test_se3_runs_as_our_own(side: Any, method: Any) -> None:
    group = gni.LieGroup.from_geomstats(space_of("SE(3)"), side=side)
    closed = integrate(gni.SE3(side=side), np.eye(6), method)
    compare(integrate(group, np.eye(6), method), closed, np.eye(6))
    change = np.diag([0.5, -2.0, 1.3, 100.0, 0.7, -3.1])[[4, 0, 5, 2, 1, 3]]
    other = gni.MatrixGroup(np.einsum("ab,bij->aij", change, group.basis), side=side)
    compare(integrate(other, change, method), closed, change)


@pytest.mark.parametrize("method", [None, gni.Rattle()], ids=str)
def test_so4_runs_as_the_quadratic_group_in_another_basis(method: Any) -> None:
    group = gni.LieGroup.from_geomstats(space_of("SO(4)"))
    theirs = gni.QuadraticGroup(np.eye(4))
    change = theirs.vee(group.basis)
    run = integrate(group, change, method)
    compare(run, integrate(theirs, np.eye(6), method), change)
    poses = run.reconstruct()
    assert np.all(group.element_defect(poses) < 1e-14)
    assert np.all(space_of("SO(4)").belongs(poses))


@pytest.mark.parametrize("name", ["SO(4)", "SE(3)"])
def test_the_energy_error_is_of_second_order(name: str) -> None:
    group = gni.LieGroup.from_geomstats(space_of(name))
    system, start = system_of(group, np.eye(6))
    coarse, fine = (
        np.ptp(gni.integrate(system, start, step=h, t_end=1.6).energy()) for h in (0.04, 0.02)
    )
    assert 1e-6 < fine < 1e-2
    assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    ("name", "side"), [("SO(4)", "right"), ("SE(3)", "left"), ("SE(3)", "right"), ("SO(5)", "left")]
)
def test_a_free_motion_keeps_its_momentum_in_space(name: str, side: Any) -> None:
    """W_k carries the momentum back to the start: p_k = Ad_{W_k}^{+-T} p_0 (lemma 9.5)."""
    group = gni.LieGroup.from_geomstats(space_of(name), side=side)
    d = group.dimension
    system = gni.MechanicalSystem(group, metric=spd(d, 9))
    start = system.state(velocity=np.random.default_rng(2).normal(size=d))
    run = gni.integrate(system, start, step=0.05, t_end=3.0, method=gni.Rattle())
    poses = run.reconstruct()
    carried = group.Ad(poses if side == "left" else group.inverse_element(poses))
    expected = np.einsum("nab,a->nb", carried, run.momenta[0])
    np.testing.assert_allclose(run.momenta, expected, rtol=0, atol=1e-11)
    assert np.ptp(run.momenta, axis=0).max() > 0.5
    assert np.abs(poses[-1] - poses[0]).max() > 0.5
