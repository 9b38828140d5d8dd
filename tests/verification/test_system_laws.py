"""The laws of mechanical systems on scenes and zoo animals, and nonholonomy known by hand."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent))
sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import broken_systems
import zoo

import groupoid_gni as gni
from groupoid_gni.verification import BrokenLawWarning, Verdict, check_system
from groupoid_gni.verification.judging import check_laws
from groupoid_gni.verification.nonholonomy import growth
from groupoid_gni.verification.system_laws import SYSTEM_LAWS
from groupoid_gni.verification.system_view import SystemView

ADVISORY = {"constraints_are_not_integrable", "constraints_reach_everywhere"}
FEW = 5
ANIMALS: dict[str, Callable[[], zoo.Animal]] = {
    "free, with a one-form": lambda: zoo.animal("pair 3", 0, gyroscopic=True),
    "free body": lambda: zoo.animal("SE3 left exp", 0, potential=False),
    "blade": lambda: zoo.animal("pair 3", 1),
    "affine blade": lambda: zoo.animal("pair 3", 1, affine=True, gyroscopic=True),
    "point base": lambda: zoo.animal("SE2 right exp", 1, affine=True),
    "two rows": lambda: zoo.animal("atiyah right cay", 2, affine=True, gyroscopic=True),
    "three rows": lambda: zoo.animal("framed left cay", 3),
    "action": lambda: zoo.animal("action left cay", 1, gyroscopic=True),
    "product": lambda: zoo.animal("product exp", 3, affine=True),
    "derived": lambda: zoo.animal(
        "", 2, space=gni.DerivedGroupoid(zoo.SPACES["atiyah left cay"]()), gyroscopic=True
    ),
    "twelve": lambda: zoo.animal("twelve", 2, affine=True),
}


@pytest.mark.parametrize("name", ANIMALS)
def test_animals_obey_the_laws(name: str) -> None:
    report = check_system(ANIMALS[name]().system, examples=FEW)
    assert report.passed
    assert not report.warnings


@pytest.mark.parametrize("name", ["chaplygin_sleigh", "rolling_ball", "inhomogeneous_ball"])
def test_scenes_obey_the_laws(name: str) -> None:
    report = check_system(getattr(gni.scenes, name)().system, examples=FEW)
    assert report.passed
    assert not report.warnings


@pytest.mark.slow
@pytest.mark.parametrize("name", zoo.SPACES)
def test_the_whole_zoo_obeys_the_laws(name: str) -> None:
    m = list(zoo.SPACES).index(name) % 4
    animal = zoo.animal(name, m, affine=m % 2 == 1, gyroscopic=m != 1, seed=3)
    assert check_system(animal.system, on_fail="return", examples=20).passed


def test_every_law_applies_to_something_and_bites() -> None:
    caught = {name for broken in broken_systems.BROKEN for name in broken.caught_by}
    assert caught | ADVISORY == {law.name for law in SYSTEM_LAWS}
    sound = check_system(broken_systems.system(), examples=FEW)
    linear = check_system(broken_systems.system(**broken_systems.LINEAR), examples=FEW)
    for law in SYSTEM_LAWS:
        verdicts = {report[law.name].verdict for report in (sound, linear)}
        assert Verdict.PASSED in verdicts
        assert verdicts <= {Verdict.PASSED, Verdict.NOT_APPLICABLE}


def particle(rows: Callable[[Any], Any], size: int = 3, **terms: Any) -> gni.MechanicalSystem:
    return gni.MechanicalSystem(
        gni.PairGroupoid(size), np.diag(np.linspace(0.6, 1.9, size)),
        constraints=lambda x, p: np.array(rows(x)), **terms,
    )


def test_dependent_rows_are_left_out() -> None:
    twice = particle(
        lambda x: [[1.0, 0.4 * x[1], -0.3], [0.0, 0.0, 0.0], [2.0, 0.8 * x[1], -0.6]],
        drift=lambda x, p: np.array([0.1, 0.2 * x[0], 0.3]),
    )
    once = SystemView(twice)
    assert once.node(np.array([0.1, 0.2, 0.3])).rows == (0,)
    assert check_system(twice, examples=FEW).passed


def test_units_do_not_matter() -> None:
    """Masses of a gas molecule, of a car, and both."""
    rng = np.random.default_rng(5)
    root = np.eye(3) + rng.uniform(-0.3, 0.3, (3, 3))
    for masses in ([1e-26] * 3, [1e3] * 3, [1e-9, 1.0, 1e7]):
        unit = np.sqrt(masses)
        system = gni.MechanicalSystem(
            gni.PairGroupoid(3), root @ root.T * np.outer(unit, unit),
            constraints=lambda x, p, unit=unit: np.array([[1.0, 0.4 * x[0], -0.7]]) * unit,
            potential=lambda x, p, unit=unit: unit[0] ** 2 * np.cos(x[0]),
        )
        report = check_system(system, examples=FEW)
        assert max(f.worst or 0.0 for f in report.findings) < 1e-13


def test_terms_that_are_not_analytic_are_no_mistakes() -> None:
    springs = particle(
        lambda x: [[1.0 + np.abs(x[1]), x[2], np.maximum(x[0], 0.0)]],
        potential=lambda x, p: gni.where(x[0] > 0.0, x[0] ** 2, 0.0) + np.linalg.norm(x),
    )
    assert check_system(springs, examples=20).passed


def test_points_outside_the_domain_are_no_mistakes() -> None:
    kepler = particle(lambda x: [[1.0, x[0], 0.2]], potential=lambda x, p: np.log(x[0] + 0.2))
    assert check_system(kepler, examples=FEW).passed
    nowhere = particle(lambda x: [[1.0, x[0], 0.2]], potential=lambda x, p: np.log(x[0] - 9.0))
    with pytest.raises(gni.InputError, match="no point was found"):
        check_system(nowhere, examples=FEW)


def test_only_systems_are_taken() -> None:
    with pytest.raises(gni.InputError, match="takes a MechanicalSystem, not PairGroupoid"):
        check_system(gni.PairGroupoid(2))  # type: ignore[arg-type]


# Nonholonomy.


def rubber_ball() -> gni.MechanicalSystem:
    """A ball that rolls without slipping or spinning."""
    ball = gni.scenes.rolling_ball().system
    rows = [[1.0, 0, 0, -0.8, 0], [0, 1.0, 0.8, 0, 0], [0, 0, 0, 0, 1.0]]
    return gni.MechanicalSystem(ball.space, np.diag([1.3, 1.3, 0.5, 0.5, 0.5]), constraints=rows)


def car(trailers: int) -> gni.MechanicalSystem:
    """(x, y, theta_0, theta_1, ...): wheels under a car and its trailers, rods of length one."""
    def rows(x: Any) -> Any:
        found = []
        for k in range(trailers + 1):
            row = [-np.sin(x[2 + k]), np.cos(x[2 + k]), *[0.0] * (trailers + 1)]
            for i in range(1, k + 1):
                row[2 + i] = -np.cos(x[2 + i] - x[2 + k])
            found.append(row)
        return found

    return particle(rows, 3 + trailers)


GROWTHS: dict[str, tuple[Callable[[], gni.MechanicalSystem], tuple[int, ...]]] = {
    "sleigh": (lambda: gni.scenes.chaplygin_sleigh().system, (2, 3)),
    "rolling ball": (lambda: gni.scenes.rolling_ball().system, (3, 5)),
    "inhomogeneous ball": (lambda: gni.scenes.inhomogeneous_ball().system, (3, 5)),
    "rubber ball": (rubber_ball, (2, 3, 5)),
    "nonholonomic particle": (lambda: particle(lambda x: [[-x[1], 0.0, 1.0]]), (2, 3)),
    "Martinet": (lambda: particle(lambda x: [[-(x[1] ** 2), 0.0, 1.0]]), (2, 3)),
    "Engel": (
        lambda: particle(lambda x: [[-x[2], 1.0, 0.0, 0.0], [-x[3], 0.0, 1.0, 0.0]], 4), (2, 3, 4)
    ),
    "Goursat": (
        lambda: particle(lambda x: [[-x[k + 1], *np.eye(4)[k - 1]] for k in (1, 2, 3)], 5),
        (2, 3, 4, 5),
    ),
    "car": (lambda: car(0), (2, 3)),
    "car with a trailer": (lambda: car(1), (2, 3, 4)),
    "car with two trailers": (lambda: car(2), (2, 3, 4, 5)),
    "ski on a moving slope": (
        lambda: particle(lambda x: [[0, 0, 1.0]], drift=lambda x, p: np.array([0, 0, x[0]])), (2, 3)
    ),
    "half a particle": (
        lambda: particle(lambda x: [[-x[1], 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]], 4), (2, 3)
    ),
    "sphere": (lambda: particle(lambda x: [[x[0], x[1], x[2]]]), (2,)),
    "sphere, scaled": (
        lambda: particle(lambda x: np.exp(x[0] * x[1]) * np.array([[x[0], x[1], x[2]]])), (2,)
    ),
    "plane": (lambda: particle(lambda x: [[1.0, 2.0, -0.7]]), (2,)),
    "moving plane": (lambda: particle(lambda x: [[0, 0, 1.0]], drift=[0.0, 0.0, 0.4]), (2,)),
    "line": (lambda: particle(lambda x: [[1.0, x[1], x[2]], [0.3, x[0], 1.0]]), (1,)),
    "subgroup": (
        lambda: gni.MechanicalSystem(
            gni.SE2(), np.diag([0.7, 1.2, 1.2]), constraints=[[1.0, 0.0, 0.0]]
        ),
        (2,),
    ),
}


@pytest.mark.parametrize("name", GROWTHS)
def test_growth_known_by_hand(name: str) -> None:
    make, expected = GROWTHS[name]
    system = make()
    rng = np.random.default_rng(11)
    space = system.space
    for _ in range(3):
        xi = rng.uniform(-0.8, 0.8, space.rank)
        x = np.asarray(space.target(space.retract(np.array(space.example_base_point), xi)))
        assert growth(SystemView(system), x) == expected
    report = check_laws(
        name, {"system": SystemView(system)}, [law for law in SYSTEM_LAWS if law.advisory],
        on_fail="return", expected_failures=None, examples=FEW, seed=0,
    )
    assert report.passed
    warned = {found.law.name for found in report.warnings}
    assert ("constraints_are_not_integrable" in warned) == (len(expected) == 1)
    assert ("constraints_reach_everywhere" in warned) == (expected[-1] < space.rank)


@pytest.mark.parametrize("seed", range(8))
def test_gradients_in_disguise_are_found_out(seed: int) -> None:
    """Rows M(x) df with any functions f and any invertible M are integrable."""
    rng = np.random.default_rng(seed)
    size, count = 5, 1 + seed % 3
    waves, mix = rng.uniform(-1.5, 1.5, (count, size)), rng.uniform(-1.0, 1.0, (count, count))
    bend = rng.uniform(-1.0, 1.0, (count, size, size))
    bend = bend + np.swapaxes(bend, 1, 2)

    def rows(x: Any) -> Any:
        gradients = np.cos(waves @ x)[:, None] * waves + bend @ x + 0.1 * x**2
        return (3.0 * np.eye(count) + np.sin(mix * x[0]) + mix * x[1]) @ gradients

    system = particle(rows, size)
    assert growth(SystemView(system), rng.uniform(-1.0, 1.0, size)) == (size - count,)


def test_a_tiny_twist_is_no_round_off() -> None:
    twisted = particle(lambda x: [[-1e-6 * x[1], 0.0, 1.0]])
    assert growth(SystemView(twisted), np.array([0.3, 0.2, 0.1])) == (2, 3)


def test_integrable_constraints_warn_and_say_what_to_do() -> None:
    sphere = GROWTHS["sphere"][0]()
    with pytest.warns(BrokenLawWarning, match="INTEGRABLE") as caught:
        report = check_system(sphere, examples=FEW)
    assert report.passed
    text = " ".join(str(caught[0].message).split())
    assert "coordinates on the leaf" in text
    assert "look at the rows mu" in text
    assert "left [2.]" in text
    assert "right [3.]" in text
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_system(
            sphere, examples=FEW,
            expected_failures=dict.fromkeys(ADVISORY, "it is a sphere"),
        )
