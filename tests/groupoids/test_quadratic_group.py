"""Quadratic groups: SO(4), Lorentz, symplectic; their domains; refused matrices."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm, logm

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, Cayley, Exponential, QuadraticGroup

SYMPLECTIC = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.eye(2), np.zeros((2, 2))]])
FORMS = {
    "SO(4)": (np.eye(4), 6),
    "Lorentz": (np.diag([-1.0, 1.0, 1.0, 1.0]), 6),
    "Sp(4)": (SYMPLECTIC, 10),
    "weighted": (np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 3.0]]), 3),
}


@pytest.mark.parametrize("retraction", [Cayley(), Exponential()], ids=repr)
@pytest.mark.parametrize("name", FORMS)
def test_elements_preserve_the_form(name: str, retraction: Cayley | Exponential) -> None:
    form, dimension = FORMS[name]
    group = QuadraticGroup(form, retraction=retraction)
    assert group.dimension == dimension
    xi = 0.4 * np.random.default_rng(7).normal(size=dimension)
    element = group.tau(xi)
    np.testing.assert_allclose(element.T @ form @ element, form, atol=1e-14)
    np.testing.assert_allclose(group.tau_inverse(element), xi, atol=1e-13)
    np.testing.assert_allclose(group.inverse_element(element) @ element, np.eye(len(form)),
                               atol=1e-14)
    half = group.tau(group.half_vector(xi))
    np.testing.assert_allclose(half @ half, element, atol=1e-14)
    np.testing.assert_allclose(group.dtau(xi) @ group.dtau_inverse(xi), np.eye(dimension),
                               atol=1e-13)
    np.testing.assert_allclose(group.exp(xi), expm(group.hat(xi)), atol=1e-14)
    np.testing.assert_allclose(group.hat(group.log(element)), logm(element), atol=1e-12)
    if name == "SO(4)":  # the other forms are not restored by the Euclidean projection
        assert group.element_defect(group.restore_element(element * (1 + 1e-6))) < 1e-11


@pytest.mark.parametrize("name", FORMS)
def test_restoration(name: str) -> None:
    form, dimension = FORMS[name]
    group = QuadraticGroup(form)
    rng = np.random.default_rng(9)
    spoilt = group.cay(0.3 * rng.normal(size=dimension)) + 1e-6 * rng.normal(size=form.shape)
    assert group.element_defect(spoilt) > 1e-7
    assert group.element_defect(group.restore_element(spoilt)) < 1e-10


@pytest.mark.parametrize("angle", [1.0, 2.0, 3.0])
def test_the_stated_domain_of_the_logarithm(angle: float) -> None:
    closed, general = SO3(), QuadraticGroup(np.eye(3), basis=SO3().basis)
    w = angle * np.array([0.48, -0.6, 0.64])
    np.testing.assert_allclose(general.log(closed.exp(w)), w, atol=1e-12)
    np.testing.assert_allclose(general.dexp_inverse(w), closed.dexp_inverse(w), atol=1e-13)
    np.testing.assert_allclose(general.cay_half(w), closed.cay_half(w), atol=1e-14)
    np.testing.assert_allclose(general.vee(general.hat(w)), w, atol=1e-15)


def test_boosts() -> None:
    group = QuadraticGroup(np.diag([-1.0, 1.0]))
    for rapidity in (0.5, 2.0, 4.0):
        xi = group.vee(rapidity * np.array([[0.0, 1.0], [1.0, 0.0]]))
        expected = [[np.cosh(rapidity), np.sinh(rapidity)], [np.sinh(rapidity), np.cosh(rapidity)]]
        np.testing.assert_allclose(group.exp(xi), expected, rtol=1e-13)
        np.testing.assert_allclose(group.log(group.exp(xi)), xi, atol=1e-11)


def test_refused_input() -> None:
    with pytest.raises(InputError, match="square"):
        QuadraticGroup(np.ones((2, 3)))
    with pytest.raises(InputError, match="symmetric or antisymmetric"):
        QuadraticGroup(np.array([[1.0, 2.0], [0.0, 1.0]]))
    with pytest.raises(InputError, match="invertible"):
        QuadraticGroup(np.diag([1.0, 0.0]))
    with pytest.raises(InputError, match=r"shape \(3, 3, 3\)"):
        QuadraticGroup(np.eye(3), basis=np.zeros((2, 3, 3)))
    with pytest.raises(InputError, match="not in the algebra"):
        QuadraticGroup(np.eye(2), basis=np.eye(2)[None])
    dependent = np.repeat(SO3().basis[:1], 3, axis=0)
    with pytest.raises(InputError, match="depend"):
        QuadraticGroup(np.eye(3), basis=dependent)
