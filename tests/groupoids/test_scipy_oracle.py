"""SO(3) and SE(3) against the rotations and rigid transforms of SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.spatial.transform as transforms

import groupoid_gni as gni

Rotation = transforms.Rotation
RigidTransform = getattr(transforms, "RigidTransform", None)  # since SciPy 1.16
with_rigid_transforms = pytest.mark.skipif(RigidTransform is None, reason="needs SciPy 1.16")

EXPONENTIAL = gni.Exponential()
ROTATIONS = {
    "SO3": gni.SO3(retraction=EXPONENTIAL),
    "QuadraticGroup": gni.QuadraticGroup(np.eye(3), gni.SO3().basis, retraction=EXPONENTIAL),
    "MatrixGroup": gni.MatrixGroup(gni.SO3().basis, retraction=EXPONENTIAL),
}
MOTIONS = {
    "SE3": gni.SE3(retraction=EXPONENTIAL),
    "MatrixGroup": gni.MatrixGroup(gni.SE3().basis, retraction=EXPONENTIAL),
}


@pytest.fixture(params=ROTATIONS.values(), ids=ROTATIONS)
def rotations(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture(params=MOTIONS.values(), ids=MOTIONS)
def motions(request: pytest.FixtureRequest) -> Any:
    return request.param


def rotation_vectors(largest: float, count: int = 30) -> Any:
    """Rotation vectors of all lengths up to the largest, tiny ones among them."""
    rng = np.random.default_rng(17)
    axes = rng.normal(size=(count, 3))
    lengths = np.concatenate([[0.0, 1e-12, 1e-5], np.linspace(0.2, largest, count - 3)])
    return lengths[:, None] * axes / np.linalg.norm(axes, axis=1, keepdims=True)


def close(ours: Any, theirs: Any, tolerance: float = 4e-15) -> None:
    scale = 1.0 + np.abs(theirs).max()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * scale)


def test_rotations_exponential_and_logarithm(rotations: Any) -> None:
    closed = isinstance(rotations, gni.SO3)  # the series hold up to an angle of 3
    w = rotation_vectors(np.pi - 1e-7 if closed else 3.0)
    theirs = Rotation.from_rotvec(w)
    close(rotations.exp(w), theirs.as_matrix(), 4e-15 if closed else 2e-14)
    close(rotations.log(theirs.as_matrix()), theirs.as_rotvec(), 4e-15 if closed else 1e-11)


def test_rotations_products_inverses_and_adjoint(rotations: Any) -> None:
    w, v = rotation_vectors(2.9), rotation_vectors(2.9)[::-1]
    first, second = Rotation.from_rotvec(w), Rotation.from_rotvec(v)
    a, b = first.as_matrix(), second.as_matrix()
    close(rotations.compose(a, b), (first * second).as_matrix())
    close(rotations.inverse_element(a), first.inv().as_matrix())
    close(np.einsum("nij,nj->ni", rotations.Ad(a), v), first.apply(v))
    bracket = (rotations.ad(w) @ v[..., None])[..., 0]
    close(bracket, np.cross(w, v))


def test_rotations_cayley_is_the_rodrigues_vector(rotations: Any) -> None:
    """cay(w) turns about w by 2 arctan(|w|/2): SciPy's modified parameters, halved twice."""
    w = rotation_vectors(5.0)
    length = np.linalg.norm(w, axis=1, keepdims=True)
    axes = w / np.where(length > 0.0, length, 1.0)
    theirs = Rotation.from_mrp(np.tan(np.arctan(length / 2) / 2) * axes)
    close(rotations.cay(w), theirs.as_matrix())


def screws(largest: float) -> Any:
    """Components (rotation, translation) with translations up to 20."""
    w = rotation_vectors(largest)
    return np.concatenate([w, 20.0 * np.random.default_rng(4).uniform(-1, 1, w.shape)], axis=1)


@with_rigid_transforms
def test_motions_exponential_and_logarithm(motions: Any) -> None:
    xi = screws(3.0)
    theirs = RigidTransform.from_exp_coords(xi)
    close(motions.exp(xi), theirs.as_matrix(), 2e-14)
    close(motions.log(theirs.as_matrix()), theirs.as_exp_coords(), 1e-11)


@with_rigid_transforms
def test_motions_products_inverses_and_adjoint(motions: Any) -> None:
    xi, eta = screws(2.9), screws(2.9)[::-1]
    first, second = RigidTransform.from_exp_coords(xi), RigidTransform.from_exp_coords(eta)
    g, h = first.as_matrix(), second.as_matrix()
    close(motions.compose(g, h), (first * second).as_matrix(), 1e-14)
    close(motions.inverse_element(g), first.inv().as_matrix(), 1e-14)
    moved = np.einsum("nij,nj->ni", motions.Ad(g), eta)
    close((first * second * first.inv()).as_matrix(), motions.exp(moved), 1e-12)
