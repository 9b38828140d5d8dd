"""check_groupoid: what is shipped obeys, the invariant fields are those of the paper."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_algebroids
import broken_conventions
import broken_groupoids
import zoo

import groupoid_gni as gni
from groupoid_gni.verification import Verdict, check_groupoid, strategies
from groupoid_gni.verification.algebroid_laws import ALGEBROID_LAWS
from groupoid_gni.verification.algebroid_view import (
    Algebroid,
    LeftField,
    Multiple,
    RightField,
    Section,
    bracket_of_fields,
)
from groupoid_gni.verification.appendix_laws import APPENDIX_LAWS
from groupoid_gni.verification.catalogue import groupoids, groups
from groupoid_gni.verification.convention_laws import CONVENTION_LAWS
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.groupoid_laws import GROUPOID_LAWS
from groupoid_gni.verification.retraction_laws import RETRACTION_LAWS
from groupoid_gni.verification.search import _search

LAWS = (*GROUPOID_LAWS, *ALGEBROID_LAWS, *CONVENTION_LAWS)
FEW = 8
EXPENSIVE = ("SO4 left exp", "SO4 right exp", "SE3 right exp", "product exp", "twelve")
CATALOGUE = {
    f"{kind}: {variant}": space
    for table in (groups(), groupoids())
    for kind, variants in table.items()
    for variant, space in variants.items()
}
SOUND: dict[str, Callable[[], gni.LieGroupoid]] = {
    "half plane": broken_algebroids.HalfPlane,
    "line": broken_groupoids.Line,
    "SO3 left cay": zoo.SPACES["SO3 left cay"],
    "SE2 right exp": zoo.SPACES["SE2 right exp"],
    "action left exp": zoo.SPACES["action left exp"],
    "framed right cay": zoo.SPACES["framed right cay"],
    "product cay": zoo.SPACES["product cay"],
}


def obeys(space: gni.LieGroupoid, examples: int) -> gni.verification.LawReport:
    report = check_groupoid(space, examples=examples)
    for found in report.findings:
        assert (found.evaluations > 0) is (found.verdict is not Verdict.NOT_APPLICABLE)
        assert bool(found.note) is (found.verdict is Verdict.NOT_APPLICABLE)
    return report


@pytest.mark.parametrize("name", [name for name in zoo.SPACES if name not in EXPENSIVE])
def test_the_zoo_obeys(name: str) -> None:
    obeys(zoo.SPACES[name](), FEW)


@pytest.mark.slow
@pytest.mark.parametrize("name", zoo.SPACES)
def test_the_zoo_obeys_on_many_samples(name: str) -> None:
    obeys(zoo.SPACES[name](), 20)


def test_every_law_has_its_own_name_a_subject_and_a_mistake_it_catches() -> None:
    named = [law.name for law in (*LAWS, *RETRACTION_LAWS, *APPENDIX_LAWS)]
    assert len(set(named)) == len(named)
    views = [(Algebroid(space), space) for space in CATALOGUE.values()]
    for law in LAWS:
        assert any(
            law.applies(view if law.group == "algebroid" else space) is None
            for view, space in views
        ), law.name
    mistakes = [
        *broken_groupoids.BROKEN, *broken_algebroids.BROKEN, *broken_conventions.BROKEN
    ]
    assert {name for one in mistakes for name in one.caught_by} == {law.name for law in LAWS}


def test_seven_functions_are_enough() -> None:
    report = obeys(broken_groupoids.Line(), FEW)
    silent = {found.law.name: found.note for found in report.having(Verdict.NOT_APPLICABLE)}
    for name in ("anchor", "plus", "minus", "bracket", "half"):
        assert "it is derived" in silent[f"declared_{name}"]
    assert not set(silent) & {"left_fields_close", "leibniz", "plus_by_differences"}
    assert report["left_fields_close"].worst < 1e-13


def test_laws_that_do_not_apply_say_why() -> None:
    notes = {found.law.name: found.note for found in obeys(gni.VectorGroup(2), FEW).findings}
    assert notes["leibniz"] == notes["source_of_identity"] == "the base is a point"
    assert notes["product_order"] == "its elements are not matrices"
    assert notes["frame_side"] == "it is no FramedPairGroupoid"
    assert notes["rotation_first"] == "it is no SE2 or SE3"
    assert notes["reach_of_half_a_turn"] == "it has no single angle of rotation"
    own = gni.SO2(retraction=broken_conventions.Doubled())
    notes = {found.law.name: found.note
             for found in check_groupoid(own, on_fail="return", examples=2).findings}
    assert notes["reach_of_half_a_turn"] == "the retraction is neither Cayley nor Exponential"


def test_a_reversed_product_breaks_conventions_only() -> None:
    reversed_one = next(b for b in broken_conventions.BROKEN if "consistently" in b.mistake)
    failures = reversed_one.check().failures
    assert {found.law.group for found in failures} == {"convention"}


@pytest.mark.parametrize("name", SOUND)
def test_most_samples_are_neither_tiny_nor_zero(name: str) -> None:
    space = SOUND[name]()
    for draw in (strategies.vectors, strategies.pairs, strategies.triples):
        sizes: list[float] = []
        _search(
            draw(space),
            lambda sample, sizes=sizes: sizes.append(
                min(np.max(np.abs(v)) for key, v in sample.items() if key != "x")
            ),
            25, 0,
        )
        assert sum(size > 1e-3 for size in sizes) >= 3


# The fields of section 8.1.


def arrow_and_sections(space: gni.LieGroupoid) -> tuple[Any, ...]:
    rng = np.random.default_rng(11)
    n, r = space.base_size, space.rank
    x = np.array(space.example_base_point, dtype=float)
    x = space.target(space.retract(x, rng.uniform(-0.3, 0.3, r)))
    xi = rng.uniform(-0.4, 0.4, r)
    one, two = (
        Section(*rng.uniform(-1, 1, (2, r)), rng.uniform(-1, 1, n), shift) for shift in (0.3, 1.1)
    )
    return x, xi, one, two


@pytest.mark.parametrize("name", SOUND)
def test_fields_are_those_of_the_paper(name: str) -> None:
    """X->(g) = T l_g X(beta(g)) and X<-(g) = -T r_g T i X(alpha(g)), in source and lift."""
    space = SOUND[name]()
    x, xi, section, _ = arrow_and_sections(space)
    view, g = Algebroid(space), space.retract(x, xi)
    end = np.asarray(space.target(g))

    def seen(arrow: Any) -> Any:
        return np.concatenate([space.source(arrow), space.lift(arrow)])

    left = central_difference(
        lambda e: seen(space.multiply(g, space.retract(end, e[0] * section.at(end)))), [0.0]
    )
    right = -central_difference(
        lambda e: seen(space.multiply(space.inverse(space.retract(x, e[0] * section.at(x))), g)),
        [0.0],
    )
    assert LeftField(view, section).at(x, xi) == pytest.approx(left[:, 0], abs=1e-12)
    assert RightField(view, section).at(x, xi) == pytest.approx(right[:, 0], abs=1e-12)
    in_parts = np.concatenate([
        -space.anchor(x) @ section.at(x),
        -space.trivialised_tangent_minus(x, xi) @ section.at(x),
    ])
    assert RightField(view, section).at(x, xi) == pytest.approx(in_parts, abs=1e-14)


@pytest.mark.parametrize("side", ["left", "right"])
def test_fields_of_a_matrix_group(side: str) -> None:
    """On a left group X-> = g hat(X) and X<- = hat(X) g."""
    group = gni.SE2(side=side)
    x, xi, section, _ = arrow_and_sections(group)
    g, velocity = group.tau(xi), group.hat(section.at(x))
    fields = {"X->": g @ velocity, "X<-": velocity @ g}
    if side == "right":
        fields = {"X->": velocity @ g, "X<-": g @ velocity}
    for name, field in (("X->", LeftField), ("X<-", RightField)):
        change = field(Algebroid(group), section).at(x, xi)
        rate = central_difference(group.tau, xi, [change])[..., 0]
        np.testing.assert_allclose(rate, fields[name], atol=1e-12)


@pytest.mark.parametrize("name", SOUND)
def test_derivatives_of_fields(name: str) -> None:
    space = SOUND[name]()
    view = Algebroid(space)
    x, xi, one, two = arrow_and_sections(space)
    scaled = Multiple(two, 0.7 * one.wave, 0.2)
    for section in (one, scaled):
        dx = np.random.default_rng(2).normal(size=x.shape)
        slope = central_difference(
            lambda t, section=section, dx=dx: section.at(x + t[0] * dx), [0.0]
        )[:, 0]
        assert section.along(x, dx) == pytest.approx(slope, abs=1e-12)
    for field in (LeftField(view, one), LeftField(view, scaled), RightField(view, two)):
        change = RightField(view, one).at(x, xi) + LeftField(view, two).at(x, xi)
        dx, dxi = view.cut(change)
        slope = central_difference(
            lambda t, field=field, dx=dx, dxi=dxi: field.at(x + t[0] * dx, xi + t[0] * dxi), [0.0]
        )
        assert field.along(x, xi, change) == pytest.approx(slope[:, 0], abs=1e-11)


def test_brackets_of_fields_and_sections_on_the_half_plane() -> None:
    """[e1, e2] = e2; with sections that vary, by the Leibniz rule on paper."""
    space = broken_algebroids.HalfPlane()
    view = Algebroid(space)
    x, xi = np.array([0.7, 0.2]), np.array([0.4, -0.3])
    zero, flat = np.zeros(2), np.zeros(2)
    e1, e2 = (Section(unit, zero, flat, 0.0) for unit in np.eye(2))
    np.testing.assert_allclose(view.bracket_of_sections(e1, e2, x), [0.0, 1.0])
    found = bracket_of_fields(LeftField(view, e1), LeftField(view, e2), x, xi)
    np.testing.assert_allclose(found, LeftField(view, e2).at(x, xi), atol=1e-14)
    wave = np.array([0.5, 0.0])  # f = sin(0.5 a + 0.2), rho(e1) f = 0.5 a cos(0.5 a + 0.2)
    scaled = Multiple(e2, wave, 0.2)
    angle = 0.5 * x[0] + 0.2
    np.testing.assert_allclose(
        view.bracket_of_sections(e1, scaled, x), [0.0, np.sin(angle) + 0.35 * np.cos(angle)]
    )


@pytest.mark.parametrize("name", SOUND)
def test_the_algebroid_is_that_of_derived_groupoid(name: str) -> None:
    space = SOUND[name]()
    derived, view = gni.DerivedGroupoid(space), Algebroid(space)
    x, xi, one, two = arrow_and_sections(space)
    u, v = one.at(x), two.at(x)
    np.testing.assert_allclose(
        view.plus(x, xi, v), derived.trivialised_tangent_plus(x, xi) @ v, atol=1e-14
    )
    start, lift = view.cut(view.minus(x, xi, v))
    np.testing.assert_allclose(start, derived.anchor(x) @ v, atol=1e-14)
    np.testing.assert_allclose(lift, derived.trivialised_tangent_minus(x, xi) @ v, atol=1e-14)
    np.testing.assert_allclose(
        view.derived_bracket(x, u, v), (derived.bracket(x) @ v) @ u, atol=1e-13
    )


@pytest.mark.parametrize(
    ("part", "change"),
    [
        ("anchor", lambda x: 1.0 + 1e-9 * x[0]),
        ("bracket", lambda x: 1.0 + 1e-9),
        ("trivialised_tangent_plus", lambda x: 1.0 + 1e-9),
        ("trivialised_tangent_minus", lambda x: 1.0 + 1e-9),
        ("half", lambda x: 1.0 + 1e-9),
    ],
)
def test_mistakes_in_the_ninth_digit_are_seen(part: str, change: Callable[[Any], Any]) -> None:
    right = getattr(broken_algebroids.HalfPlane, part)
    wrong = broken_algebroids.closed(
        **{part: lambda self, x, *xi: change(x) * right(self, x, *xi)}
    )
    report = broken_groupoids.report(wrong)
    short = {"trivialised_tangent_plus": "plus", "trivialised_tangent_minus": "minus"}
    assert f"declared_{short.get(part, part)}" in {f.law.name for f in report.failures}
