"""Every group against the general matrix formulas, SciPy's expm and the laws of the appendix."""

from __future__ import annotations

from collections.abc import Callable
from math import factorial
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SE2, SO3, Cayley, Exponential, LieGroup, VectorGroup

few = settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
Draw = Callable[..., Any]


def close(a: Any, b: Any, tolerance: float = 1e-13) -> None:
    scale = 1 + np.abs(b).max(initial=0.0)
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


@few
@given(data=st.data())
def test_closed_forms_are_the_general_matrix_formulas(
    group: LieGroup, draw_xi: Draw, data: Any
) -> None:
    if isinstance(group, VectorGroup):
        return  # its elements are no matrices
    xi = draw_xi(data, group)
    g, h = group.exp(xi), group.cay(-xi / 3)
    close(group.ad(xi), LieGroup.ad(group, xi))
    for name in ("exp", "dexp_inverse", "dexp", "cay", "dcay", "dcay_inverse", "cay_half"):
        close(getattr(group, name)(xi), getattr(LieGroup, name)(group, xi), 1e-12)
    for name in ("Ad", "inverse_element", "cay_inverse"):
        close(getattr(group, name)(h), getattr(LieGroup, name)(group, h), 1e-12)
    close(group.log(g), LieGroup.log(group, g), 1e-11)
    close(group.compose(g, h), g @ h)
    close(group.vee(group.hat(xi)), xi)


@few
@given(data=st.data())
def test_exponential_is_that_of_scipy(group: LieGroup, draw_xi: Draw, data: Any) -> None:
    xi = draw_xi(data, group)
    if isinstance(group, VectorGroup):
        close(group.exp(xi), xi)
        return
    close(group.exp(xi), expm(group.hat(xi)), 1e-13)
    close(group.log(group.exp(xi)), xi, 1e-12)
    ad = group.ad(xi)
    series = sum(np.linalg.matrix_power(ad, j) / factorial(j + 1) for j in range(45))
    close(group.dexp(xi), series, 1e-12)


@few
@given(data=st.data())
def test_retraction_and_trivialised_tangents(group: LieGroup, draw_xi: Draw, data: Any) -> None:
    xi = draw_xi(data, group)
    close(group.tau(np.zeros(group.dimension)), group.identity_element, 1e-16)
    there, back = group.tau(xi), group.tau(-xi)
    condition = (1 + np.abs(there).max()) * (1 + np.abs(back).max())  # large for boosts only
    close(group.compose(there, back), group.identity_element, 1e-14 * condition)
    close(group.tau_inverse(group.tau(xi)), xi, 1e-12)
    close(group.dtau(xi) @ group.dtau_inverse(xi), np.eye(group.dimension))
    half = group.tau(group.half_vector(xi))
    close(group.compose(half, half), group.tau(xi))
    # (53): dtau_xi = Ad_{tau(xi)} dtau_{-xi}
    close(group.dtau(xi), group.Ad(group.tau(xi)) @ group.dtau(-xi))


@few
@given(data=st.data())
def test_definition_9_1(group: LieGroup, draw_xi: Draw, data: Any) -> None:
    """dtau_xi eta = (d/de tau(xi + e eta)) tau(xi)^{-1}, by central differences."""
    xi, step = draw_xi(data, group, 0.6), 1e-5
    back = group.inverse_element(group.tau(xi))
    for a, direction in enumerate(np.eye(group.dimension)):
        ahead, behind = (
            group.compose(group.tau(xi + sign * step * direction), back) for sign in (1, -1)
        )
        if isinstance(group, VectorGroup):
            numeric = (ahead - behind) / (2 * step)
        else:
            numeric = group.vee((ahead - behind) / (2 * step))
        close(group.dtau(xi)[:, a], numeric, 1e-8)


def test_bracket_is_that_of_matrices_up_to_the_side(group: LieGroup) -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, group.dimension))
    sign = 1.0 if group.side == "left" else -1.0
    ours = np.einsum("cab,a,b->c", group.bracket(group.example_base_point), a, b)
    if isinstance(group, VectorGroup):
        close(ours, np.zeros(3))
        return
    first, second = group.hat(a), group.hat(b)
    close(ours, sign * group.vee(first @ second - second @ first))


def test_elements_and_arrows(group: LieGroup) -> None:
    rng = np.random.default_rng(2)
    elements = group.tau(0.4 * rng.normal(size=(2, 3, group.dimension)))
    assert elements.shape == (2, 3, *group.element_shape)
    arrows = group.flatten(elements)
    assert arrows.shape == (2, 3, group.arrow_size)
    close(group.unflatten(arrows), elements, 1e-16)
    assert np.all(group.element_defect(elements) < 1e-13)
    spoilt = elements + 1e-4 * rng.normal(size=elements.shape)
    if not isinstance(group, VectorGroup):
        assert np.all(group.element_defect(spoilt) > 1e-6)
        assert np.all(group.element_defect(group.restore_element(spoilt)) < 1e-6)
    element = elements[0, 1]
    step = 1e-5
    numeric = np.stack(
        [
            group.multiply(group.flatten(element), group.retract(np.zeros(0), step * e))
            - group.multiply(group.flatten(element), group.retract(np.zeros(0), -step * e))
            for e in np.eye(group.dimension)
        ],
        axis=-1,
    ) / (2 * step)
    close(group.translated_basis(element), numeric, 1e-9)


def test_sides_and_retractions_are_checked() -> None:
    with pytest.raises(InputError, match=r"'left'.*'right'"):
        SO3(side="body")
    with pytest.raises(InputError, match=r"Cayley\(\) or Exponential\(\)"):
        SE2(retraction=Cayley)
    assert repr(SO3(retraction=Exponential())) == "SO3(side='left', retraction=Exponential())"
    assert Cayley() == Cayley()
