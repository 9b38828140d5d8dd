"""The laws of a groupoid, of its retraction, and closed forms against derived ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groupoid_gni.errors import InputError, NotComposableError
from groupoid_gni.expressions import record
from groupoid_gni.groupoids import (
    SE3,
    SO3,
    AtiyahGroupoid,
    DerivedGroupoid,
    LieGroupoid,
    PairGroupoid,
    ProductGroupoid,
)

few = settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
Draw = Callable[..., Any]


class ScaledLine(LieGroupoid):
    """Pairs of points (a, b), a > 0, in the frame e1 = a d/da, e2 = a d/db: [e1, e2] = e2.

    Written as a user would: the seven functions, two attributes, no super().__init__().
    """

    rank = 2
    example_base_point = (1.3, -0.4)

    def source(self, g: Any) -> Any:
        return g[:2]

    def target(self, g: Any) -> Any:
        return g[2:]

    def identity(self, x: Any) -> Any:
        return np.concatenate([x, x])

    def multiply(self, g: Any, h: Any) -> Any:
        return np.concatenate([g[:2], h[2:]])

    def inverse(self, g: Any) -> Any:
        return np.concatenate([g[2:], g[:2]])

    def retract(self, x: Any, xi: Any) -> Any:
        a, b = x
        a_next = a * (1 + xi[0] / 2) / (1 - xi[0] / 2)
        return np.array([a, b, a_next, b + xi[1] * (a + a_next) / 2])

    def lift(self, g: Any) -> Any:
        mean = (g[0] + g[2]) / 2
        return np.array([(g[2] - g[0]) / mean, (g[3] - g[1]) / mean])


class WrongTangent(SO3):
    """SO(3) with a slip of sign in dcay^{-1}."""

    def dcay_inverse(self, xi: Any) -> Any:
        return super().dcay_inverse(-xi)


def close(a: Any, b: Any, tolerance: float = 1e-11) -> None:
    scale = 1 + np.abs(b).max(initial=0.0)
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


@few
@given(data=st.data())
def test_axioms(space: LieGroupoid, draw_xi: Draw, draw_base_point: Draw, data: Any) -> None:
    x = draw_base_point(data, space)
    g = space.retract(x, draw_xi(data, space))
    h = space.retract(space.target(g), draw_xi(data, space, 0.6))
    k = space.retract(space.target(h), draw_xi(data, space, 0.3))
    close(space.source(g), x)
    close(space.source(space.multiply(g, h)), x)
    close(space.target(space.multiply(g, h)), space.target(h))
    close(
        space.multiply(space.multiply(g, h), k), space.multiply(g, space.multiply(h, k)), 1e-12
    )
    close(space.multiply(space.identity(x), g), g, 1e-13)
    close(space.multiply(g, space.identity(space.target(g))), g, 1e-13)
    close(space.multiply(g, space.inverse(g)), space.identity(x), 1e-12)
    assert space.same_arrow(space.inverse(space.inverse(g)), g)


@few
@given(data=st.data())
def test_retraction_laws(
    space: LieGroupoid, draw_xi: Draw, draw_base_point: Draw, data: Any
) -> None:
    x, xi = draw_base_point(data, space), draw_xi(data, space)
    g = space.retract(x, xi)
    end = space.target(g)
    close(space.retract(x, np.zeros(space.rank)), space.identity(x), 1e-15)
    close(space.lift(g), xi)
    close(space.inverse(g), space.retract(end, -xi), 1e-13)
    first = space.retract(x, space.half(x, xi))
    second = space.retract(space.target(first), space.half(x, xi))
    close(space.multiply(first, second), g, 1e-13)


@few
@given(data=st.data())
def test_closed_forms_are_the_derived_ones(
    space: LieGroupoid, derived: DerivedGroupoid, draw_xi: Draw, draw_base_point: Draw, data: Any
) -> None:
    x, xi = draw_base_point(data, space), draw_xi(data, space)
    close(space.anchor(x), derived.anchor(x))
    close(space.bracket(x), derived.bracket(x))
    close(space.trivialised_tangent_plus(x, xi), derived.trivialised_tangent_plus(x, xi))
    close(space.trivialised_tangent_minus(x, xi), derived.trivialised_tangent_minus(x, xi))
    xi = draw_xi(data, space, 0.5)
    close(space.half(x, xi), derived.half(x, xi))


@pytest.fixture(scope="module")
def derived_of() -> dict[int, DerivedGroupoid]:
    return {}


@pytest.fixture(scope="module")
def derived(space: LieGroupoid, derived_of: dict[int, DerivedGroupoid]) -> DerivedGroupoid:
    return derived_of.setdefault(id(space), DerivedGroupoid(space))


def test_a_wrong_closed_form_is_caught() -> None:
    wrong, xi = WrongTangent(), np.array([0.3, -0.2, 0.5])
    x = wrong.example_base_point
    derived = DerivedGroupoid(wrong).trivialised_tangent_plus(x, xi)
    assert np.abs(wrong.trivialised_tangent_plus(x, xi) - derived).max() > 0.1


@few
@given(data=st.data())
def test_recorded_functions_give_the_float_values(
    space: LieGroupoid, recorded: dict[str, Any], draw_xi: Draw, draw_base_point: Draw, data: Any
) -> None:
    x, xi = draw_base_point(data, space), draw_xi(data, space)
    for name, function in recorded.items():
        close(function(x, xi), getattr(space, name)(x, xi), 1e-12)


@pytest.fixture(scope="module")
def recorded(space: LieGroupoid) -> dict[str, Any]:
    n, r = space.base_size, space.rank
    shapes = {
        "retract": (space.arrow_size,),
        "trivialised_tangent_plus": (r, r),
        "trivialised_tangent_minus": (r, r),
        "half": (r,),
        "reach": (),
    }
    return {
        name: record(getattr(space, name), {"x": (n,), "xi": (r,)}, shape, name=name)
        for name, shape in shapes.items()
    }


def test_restoration_and_defect_can_be_recorded(space: LieGroupoid) -> None:
    n, m = space.base_size, space.arrow_size
    x = np.array(space.example_base_point)
    for name, shape in (("restore_base", (n,)), ("base_defect", ()), ("anchor", (n, space.rank))):
        function = record(getattr(space, name), {"x": (n,)}, shape, name=name)
        close(function(x), getattr(space, name)(x), 1e-15)
    restore = record(space.restore_arrow, {"g": (m,)}, (m,), name="restore_arrow")
    close(restore(space.identity(x)), space.identity(x), 1e-15)


def test_restoration_is_quadratic_and_keeps_good_points(space: LieGroupoid) -> None:
    rng = np.random.default_rng(5)
    x = space.target(space.retract(space.example_base_point, 0.4 * rng.normal(size=space.rank)))
    assert space.base_defect(x) < 1e-14
    close(space.restore_base(x), x, 1e-14)
    g = space.retract(x, 0.2 * rng.normal(size=space.rank))
    close(space.restore_arrow(g), g, 1e-14)
    spoilt = x + 1e-5 * rng.normal(size=x.shape)
    if space.base_defect(spoilt) > 1e-7:
        assert space.base_defect(space.restore_base(spoilt)) < 1e-8


def test_batches_equal_loops(space: LieGroupoid) -> None:
    rng = np.random.default_rng(3)
    start = np.array(space.example_base_point)
    x = space.target(space.retract(start, 0.3 * rng.normal(size=(2, 1, space.rank))))
    xi = 0.3 * rng.normal(size=(3, space.rank))
    g = space.retract(x, xi)
    assert np.shape(g)[:-1] in ((2, 3), (3,))  # over a point x carries no information
    h = space.retract(space.target(g), 0.5 * xi)
    batched = {
        "multiply": space.multiply(g, h), "inverse": space.inverse(g), "lift": space.lift(g),
        "pose": space.pose(g),
    }
    for i in range(3):
        member = (0, i) if g.ndim == 3 else (i,)
        single = {
            "multiply": space.multiply(g[member], h[member]), "inverse": space.inverse(g[member]),
            "lift": space.lift(g[member]), "pose": space.pose(g[member]),
        }
        for name, value in single.items():
            close(batched[name][member], value, 1e-14)
        for name in ("trivialised_tangent_plus", "trivialised_tangent_minus", "half", "reach"):
            function = getattr(space, name)
            whole = np.broadcast_to(
                function(x, xi), (2, 3, *np.shape(function(x[0, 0], xi[i])))
            )
            close(whole[0, i], function(x[0, 0], xi[i]), 1e-14)
    for name in ("anchor", "bracket", "identity", "base_defect", "restore_base"):
        close(getattr(space, name)(x)[1, 0], getattr(space, name)(x[1, 0]), 1e-14)


def test_lemma_9_5(group: Any, draw_xi: Draw) -> None:
    """B+ = -B- Ad_g, with the arrow's own Ad; on a right group that is Ad of the inverse."""
    xi = 0.4 * np.random.default_rng(8).normal(size=group.dimension)
    element = group.tau(xi if group.side == "left" else -xi)
    x = group.example_base_point
    plus, minus = group.trivialised_tangent_plus(x, xi), group.trivialised_tangent_minus(x, xi)
    close(plus, -minus @ group.Ad(element), 1e-13)


def test_arrow_to_shows_its_pose_and_reconstructs(space: LieGroupoid) -> None:
    rng = np.random.default_rng(4)
    x = np.array(space.example_base_point)
    g = space.retract(x, 0.3 * rng.normal(size=space.rank))
    before = space.arrow_to(x, space.pose(space.identity(x)))
    close(space.target(before), x, 1e-15)
    close(space.pose(space.multiply(before, g)), space.pose(g), 1e-14)
    assert space.same_arrow(space.arrow_to(x), space.identity(x))
    other = space.arrow_to(space.target(g), space.pose(g))
    close(space.target(other), space.target(g), 1e-14)
    close(space.pose(other), space.pose(g), 1e-14)


def test_arrows_that_do_not_meet_are_refused() -> None:
    space = AtiyahGroupoid(2, SO3())
    g = space.retract(np.array([0.2, 0.1]), np.array([1.0, 2.0, 0.1, 0.2, 0.3]))
    h = space.retract(np.array([0.7, -0.1]), np.array([0.5, 0.0, 0.0, 0.1, 0.0]))
    with pytest.raises(NotComposableError) as refusal:
        space.multiply(g, h)
    text = str(refusal.value)
    for part in (
        "AtiyahGroupoid(base_dim=2", "[1.2, 2.1]", "[0.7, -0.1]", "gap 2.2e+00",
        "allowed 3.1e-10", "swapped arguments", "multiply(then, first)",
    ):
        assert part in text
    batch = np.stack([g, g])
    good = space.retract(space.target(g), np.zeros(5))
    with pytest.raises(NotComposableError, match=r"batch member \(1,\)"):
        space.multiply(batch, np.stack([good, h]))
    with pytest.raises(NotComposableError):
        space.multiply(np.full_like(g, np.nan), h)
    with pytest.raises(NotComposableError):
        ScaledLine().multiply(np.array([1.0, 2, 3, 4]), np.array([3.0, 5, 1, 2]))


def test_a_user_groupoid_needs_the_seven_functions_only() -> None:
    line = ScaledLine()
    assert (line.base_size, line.arrow_size, line.rank) == (2, 4, 2)
    x, xi = np.array([0.7, 0.2]), np.array([0.4, -0.3])
    close(line.anchor(x), np.diag([0.7, 0.7]), 1e-15)
    structure = np.zeros((2, 2, 2))
    structure[1, 0, 1], structure[1, 1, 0] = 1.0, -1.0
    close(line.bracket(x), structure, 1e-14)
    g = line.retract(x, xi)
    close(line.lift(g), xi, 1e-15)
    close(line.inverse(g), line.retract(line.target(g), -xi), 1e-15)
    eta = line.half(x, xi)
    first = line.retract(x, eta)
    close(line.multiply(first, line.retract(line.target(first), eta)), g, 1e-15)
    assert line.half(np.stack([x, x]), xi).shape == (2, 2)
    step = 1e-6
    for direction in np.eye(2):
        longer, shorter = (
            line.lift(line.multiply(g, line.retract(line.target(g), sign * step * direction)))
            for sign in (1, -1)
        )
        numeric = (longer - shorter) / (2 * step)
        close(line.trivialised_tangent_plus(x, xi) @ direction, numeric, 1e-9)
    assert line.reach(x, xi) == line.base_defect(x) == 0.0
    assert line.restore_base(x) is x
    assert line.restore_arrow(g) is g
    assert line.split(x) == [x]
    assert repr(line) == "ScaledLine()"


def test_the_anchor_is_a_homomorphism() -> None:
    """rho [e_a, e_b] = [rho e_a, rho e_b], by finite differences of the anchor."""
    line, x, step = ScaledLine(), np.array([0.9, 0.3]), 1e-5
    rho = line.anchor(x)
    change = np.stack(
        [(line.anchor(x + step * e) - line.anchor(x - step * e)) / (2 * step) for e in np.eye(2)],
        axis=-1,
    )
    fields = np.einsum("iaj,jb->iba", change, rho) - np.einsum("ibj,ja->iba", change, rho)
    close(np.einsum("ic,cab->iab", rho, line.bracket(x)), -fields.swapaxes(1, 2), 1e-8)


def test_same_arrow() -> None:
    space = PairGroupoid(2)
    g = np.array([[0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 3.0, 4.0]])
    h = g + np.array([[0, 0, 0, 1e-12], [0, 1e-3, 0, 0]])
    assert space.same_arrow(g, h).tolist() == [True, False]
    rotations = SO3()
    a, b = (rotations.retract(np.zeros(0), np.array([0.1, w, 0.2])) for w in (0.3, 0.4))
    assert rotations.same_arrow(a, a)
    assert not rotations.same_arrow(a, b)


def test_reach_is_one_at_the_stated_limits() -> None:
    from groupoid_gni.groupoids import Exponential

    w = SO3().reach(np.zeros(0), np.array([0.0, 1.0, 0.0])) ** -1
    assert abs(w * (1 + w * w / 4) - np.pi) < 1e-14
    assert SO3(retraction=Exponential()).reach(np.zeros(0), np.array([0, 0, np.pi])) == 1.0
    space = ProductGroupoid(PairGroupoid(1), SO3(), SE3())
    xi = np.array([9.0, 0.1, 0, 0, 0, 0.5, 0, 9, 9, 9])
    assert space.reach(space.example_base_point, xi) == pytest.approx(0.5 / w, rel=1e-14)


def test_refused_definitions() -> None:
    class Unfinished(LieGroupoid):
        rank = 1
        example_base_point = np.zeros(1)

        def source(self, g: Any) -> Any:
            return g[:1]

    with pytest.raises(TypeError, match="lift"):
        Unfinished()

    class WithoutRank(ScaledLine):
        example_base_point = np.zeros((2, 2))

    with pytest.raises(InputError, match="1-d array"):
        _ = WithoutRank().base_size

    class WithoutFacts(ScaledLine):
        @property
        def rank(self) -> int:
            raise AttributeError

    with pytest.raises(InputError, match="has no rank"):
        WithoutFacts().anchor(np.zeros(2))
    with pytest.raises(InputError, match="needs a LieGroupoid"):
        DerivedGroupoid(3)
