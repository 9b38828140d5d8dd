"""Section 8: (47)-(50) literally, by differences of L_d along the arrows, on every groupoid."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plain_mechanics import close
from printed_schemes import RULES
from scipy.linalg import null_space

import groupoid_gni as gni

sys.path.append(str(Path(__file__).parents[1] / "discretization"))
import zoo

H = 0.09
GAUGE = "gauge, of a user"
NAMES = [*zoo.SPACES, GAUGE]
DIFFERENCES = 5e-12
"""What differences of order 8 leave; solving for h leaves 1e-15."""
_WEIGHTS = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


@cache
def gauge_groupoid() -> gni.LieGroupoid:
    """The gauge groupoid of the Hopf bundle, no product, from the examples."""
    path = Path(__file__).parents[2] / "examples" / "hopf_gauge_groupoid.py"
    specification = importlib.util.spec_from_file_location("hopf_gauge_groupoid", path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    space: gni.LieGroupoid = module.HopfGaugeGroupoid()
    return space


@cache
def animal(name: str, m: int, affine: bool) -> zoo.Animal:
    """A system with m rows; affine ones have a gyroscopic term too."""
    space = gauge_groupoid() if name == GAUGE else None
    return zoo.animal(name, m, affine=affine, gyroscopic=affine, space=space, seed=13)


def rows_for(name: str) -> int:
    """One or two rows, in turn."""
    return 1 + NAMES.index(name) % 2


def gradient(function: Callable[[Any], float], size: int, delta: float = 5e-3) -> Any:
    """At 0, by central differences of order 8."""
    steps = delta * np.arange(-4, 5)
    return np.array([_WEIGHTS @ [function(s * e) for s in steps] / delta for e in np.eye(size)])


@dataclass(frozen=True)
class Meeting:
    """Two arrows g, h that meet at q, and their Legendre transforms there, literally (48)."""

    animal: zoo.Animal
    g: Any
    h: Any

    @property
    def q(self) -> Any:
        """alpha(h) = beta(g)."""
        return self.animal.system.space.target(self.g)

    def transforms(self, rule: gni.DiscreteLagrangian) -> tuple[Any, Any]:
        """FL-(h)(v) = -v(L_d o r_h o i) and FL+(g)(v) = v(L_d o l_g), v = d/de retract(q, e)."""
        space, plain, q = self.animal.system.space, self.animal.plain, self.q

        def l_d(arrow: Any) -> float:
            ends, xi = (space.source(arrow), space.target(arrow)), space.lift(arrow) / H
            return float(H * rule.average(plain.lagrangian, space, *ends, xi, H))

        def left(e: Any) -> float:
            return l_d(space.multiply(self.g, space.retract(q, e)))

        def right(e: Any) -> float:
            return l_d(space.multiply(space.inverse(space.retract(q, e)), self.h))

        return -gradient(right, space.rank), gradient(left, space.rank)


@cache
def meeting(name: str, rule: Any, m: int, affine: bool) -> tuple[Meeting, Any, Any]:
    """An arrow that has nothing to do with the constraint, the library's next, FL-(h), FL+(g)."""
    a = animal(name, m, affine)
    space = a.system.space
    wish = a.start.velocity + 0.3 * np.cos(np.arange(space.rank))
    g = space.retract(a.start.base, H * wish)
    both = Meeting(a, g, gni.next_arrow(a.system, rule, g, step=H))
    close(space.source(both.h), both.q, 1e-14)
    return both, *both.transforms(rule)


def with_rules(names: list[str], fast: set[str]) -> Any:
    """Every groupoid and rule; fast is one rule, on some."""
    cases = []
    for i, name in enumerate(names):
        for j, rule in enumerate(RULES):
            quick = name in fast and j == i % len(RULES)
            marks = [] if quick else [pytest.mark.slow]
            cases.append(pytest.param(name, rule, id=f"{name}-{rule}", marks=marks))
    return pytest.mark.parametrize(("name", "rule"), cases)


CONSTRAINED = [name for name in NAMES if name not in {"pair 1", "SO2 left cay", "SO2 right cay",
                                                      "SO2 left exp", "SO2 right exp"}]  # fmt: skip
FAST = {
    "pair 3", "SO3 left cay", "SO3 right exp", "SE2 left exp", "SE3 right cay", "SO4 left cay",
    "R3 right exp", "atiyah left exp", "atiyah right cay", "framed left cay", "framed right exp",
    "action left exp", "action right cay", "product cay", GAUGE,
}  # fmt: skip
everywhere = with_rules(CONSTRAINED, FAST)


# (47).


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[] if n in FAST else [pytest.mark.slow]) for n in CONSTRAINED],
)
def test_projectors_47_split_the_algebroid(name: str) -> None:
    """P is what ``project_start`` does to velocities; it is onto D, along D^perp."""
    a = animal(name, rows_for(name), False)
    x, system, r = a.start.base, a.system, a.system.space.rank
    base = x if len(x) else None
    p_map = np.array([system.state(base, e, project_start=True).velocity for e in np.eye(r)]).T
    q_map = np.eye(r) - p_map
    metric, mu = a.plain.metric(x), a.plain.constraints(x)
    close(p_map @ p_map, p_map, 3e-15)
    close(q_map @ p_map, 0, 3e-15)
    close(p_map.T @ metric @ q_map, 0, 5e-15)
    close(mu @ p_map, 0, 3e-15)
    assert np.linalg.matrix_rank(q_map, tol=1e-10) == len(mu)
    normal = np.linalg.solve(metric, mu.T)
    close(q_map @ normal, normal, 5e-15)


# (48).


@everywhere
def test_a_step_leaves_with_fl_minus_and_arrives_with_fl_plus_48(name: str, rule: Any) -> None:
    """Along a run: momenta_after[k] = FL-(g_k), momenta_before[k + 1] = FL+(g_k)."""
    a = animal(name, rows_for(name), True)
    run = gni.integrate(a.system, a.start, step=H, n_steps=3, method=rule, compile=False)
    for k in (1, 2):
        minus, plus = Meeting(a, run.arrows[k - 1], run.arrows[k]).transforms(rule)
        close(run.momenta_after[k], minus, DIFFERENCES)
        close(run.momenta_before[k], plus, DIFFERENCES)


@pytest.mark.parametrize("name", ["pair 1", "SO2 right cay", "SO3 left exp", "framed left cay"])
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_without_constraints_momenta_match(name: str, rule: Any) -> None:
    """The discrete Euler-Lagrange equations after (48)."""
    _, minus, plus = meeting(name, rule, 0, True)
    close(minus, plus, DIFFERENCES)
    assert np.abs(plus).max() > 0.1


# Definition 8.2 and (50).


@everywhere
def test_definition_8_2_is_the_solver(name: str, rule: Any) -> None:
    """(49a), (49b), with the dense projectors of section 2."""
    both, minus, plus = meeting(name, rule, rows_for(name), False)
    along, across = both.animal.plain.projectors(both.q)
    close(along @ (minus - plus), 0, DIFFERENCES)
    close(across @ (minus + plus), 0, DIFFERENCES)
    assert np.abs(across @ plus).max() > 0.01


@everywhere
def test_equations_50_in_an_adapted_basis(name: str, rule: Any) -> None:
    """X_alpha spans D, X_a = G^-1 mu^a spans its complement."""
    both, minus, plus = meeting(name, rule, rows_for(name), False)
    metric, mu = both.animal.plain.metric(both.q), both.animal.plain.constraints(both.q)
    tangent, normal = null_space(mu), np.linalg.solve(metric, mu.T)
    close(tangent.T @ metric @ normal, 0, 1e-14)
    close(minus @ tangent - plus @ tangent, 0, DIFFERENCES)
    close(minus @ normal + plus @ normal, 0, DIFFERENCES)


@everywhere
def test_the_mean_momentum_lies_on_the_constraint_submanifold(name: str, rule: Any) -> None:
    """G((p+ + p-)/2, mu^a) = 0, which is Leg_G(D)."""
    both, minus, plus = meeting(name, rule, rows_for(name), False)
    metric, mu = both.animal.plain.metric(both.q), both.animal.plain.constraints(both.q)
    mean = (minus + plus) / 2
    close(mu @ np.linalg.solve(metric, mean), 0, DIFFERENCES)
    velocity = np.linalg.solve(metric, mean)
    space = both.animal.system.space
    if space.base_size:
        base = space.restore_base(both.q)
        start = both.animal.system.state(base, velocity, project_start=True)
        close(start.momentum, mean, 2 * DIFFERENCES)


@everywhere
def test_equations_49_with_affine_constraints(name: str, rule: Any) -> None:
    """As in (38), the sign mended, and with Pi = FL(Y) when L has a term <A, v>."""
    both, minus, plus = meeting(name, rule, rows_for(name), True)
    plain, q = both.animal.plain, both.q
    along, across = plain.projectors(q)
    offset = plain.offset(q)
    close(along @ (minus - plus), 0, DIFFERENCES)
    close(across @ (minus + plus) - 2 * across @ offset, 0, DIFFERENCES)
    assert np.abs(across @ offset).max() > 1e-3
