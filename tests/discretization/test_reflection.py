"""The reflection of (49) and the projectors of section 2, against dense NumPy."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
import zoo
from hypothesis import given, settings
from hypothesis import strategies as st

from groupoid_gni.discretization import SystemExpressions

CASES = [
    (name, m, affine)
    for name in ("pair 3", "SO3 right cay", "SE3 left cay", "atiyah right cay", "framed left cay")
    for m in (1, 2, 3)
    for affine in (False, True)
] + [("twelve", 3, True), ("action left exp", 2, True), ("product exp", 3, True)]
_MADE: dict[Any, Any] = {}


def node_functions(name: str, m: int, affine: bool) -> tuple[zoo.Animal, ca.Function]:
    """(x, p) -> reflection, projection, normal part, impulse, violation, all of the library."""
    if (name, m, affine) not in _MADE:
        a = zoo.animal(name, m, affine=affine, gyroscopic=True)
        e = SystemExpressions(a.system, tuple(range(a.system.constraint_count)))
        x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
        theta = ca.SX(a.system.parameter_vector)
        node = e.node(x, theta)
        outputs = [
            node.reflect(p),
            node.project(p),
            node.normal_vector(node.normal_component(p)),
            node.impulse(p),
            node.violation(p),
            node.normal_component(p),
        ]
        _MADE[name, m, affine] = a, ca.Function("node", [x, p], outputs)
    return _MADE[name, m, affine]


numbers = st.floats(-3, 3)


@pytest.mark.parametrize(("name", "m", "affine"), CASES)
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_reflection_is_the_affine_isometric_involution_of_equation_49(
    name: str, m: int, affine: bool, data: st.DataObject
) -> None:
    a, function = node_functions(name, m, affine)
    space = a.system.space
    p = np.array(data.draw(st.lists(numbers, min_size=space.rank, max_size=space.rank)))
    step = np.array(data.draw(st.lists(st.floats(-1, 1), min_size=space.rank, max_size=space.rank)))
    x = space.target(space.retract(a.start.base, 0.4 * step))

    def of_library(p: Any) -> list[Any]:
        return [np.array(v).ravel() for v in function(x, p)]

    reflected, projected, normal, impulse, violation, components = of_library(p)
    inverse, offset = np.linalg.inv(a.plain.metric(x)), a.plain.offset(x)
    mu = a.plain.constraints(x)
    along, across = a.plain.projectors(x)
    near = {"rtol": 0, "atol": 1e-13 * (3 + np.abs(p).max())}
    np.testing.assert_allclose(reflected, (along - across) @ p + 2 * across @ offset, **near)
    np.testing.assert_allclose(projected, along @ p + across @ offset, **near)
    np.testing.assert_allclose(normal, across @ (p - offset), **near)
    np.testing.assert_allclose(mu.T @ impulse, across @ (p - offset), **near)
    np.testing.assert_allclose(violation, mu @ inverse @ (p - offset), **near)
    np.testing.assert_allclose(of_library(reflected)[0], p, **near)
    size = (p - offset) @ inverse @ (p - offset)
    after = (reflected - offset) @ inverse @ (reflected - offset)
    np.testing.assert_allclose(after, size, rtol=1e-13, atol=1e-13)
    # N is a G^-1-orthonormal basis: |components| is the length of the normal part.
    np.testing.assert_allclose(
        components @ components, (p - offset) @ inverse @ across @ (p - offset), **near
    )
    mean = (p + reflected) / 2
    np.testing.assert_allclose(mu @ inverse @ (mean - offset), 0, atol=near["atol"])


def test_printed_projector_43_of_the_homogeneous_ball() -> None:
    import groupoid_gni as gni

    m, r, inertia, table = 1.9, 0.7, 0.55, 1.4
    scene = gni.scenes.rolling_ball(m, r, inertia, table)
    e = SystemExpressions(scene.system, (0, 1))
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 5)
    node = e.node(x, ca.SX(scene.system.parameter_vector))
    reflect = ca.Function("reflect", [x, p], [node.reflect(p)])
    d = m * r * r + inertia
    printed = (
        np.array(
            [
                [inertia, 0, 0, -r * inertia, 0],
                [0, inertia, r * inertia, 0, 0],
                [0, m * r, m * r * r, 0, 0],
                [-m * r, 0, 0, m * r * r, 0],
                [0, 0, 0, 0, 0],
            ]
        )
        / d
    )
    point, momentum = np.array([0.3, -1.1]), np.array([0.4, -0.2, 1.1, 0.7, -0.9])
    offset = m * table * np.array([-point[1], point[0], 0, 0, 0])  # Pi as printed after (45)
    expected = momentum - 2 * printed.T @ (momentum - offset)
    found = np.array(reflect(point, momentum)).ravel()
    np.testing.assert_allclose(found, expected, atol=1e-15)
