"""The Hopf gauge groupoid of the examples: laws of classes, the oracle, orders, a local frame."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import groupoid_gni as gni
from groupoid_gni.verification import check_method, check_system

EXAMPLE = Path(__file__).parents[2] / "examples" / "hopf_gauge_groupoid.py"
# the south pole, a point next to it, one on the seam, one on each side of the seam
SPECIAL = [[0, 0, -1], [1e-9, 0, -1], [0.8, -0.6, 0], [0.8, -0.6, 1e-13], [0.8, -0.6, -1e-13]]


def _load() -> Any:
    specification = importlib.util.spec_from_file_location("hopf_gauge_groupoid", EXAMPLE)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


hopf = _load()
space = hopf.HopfGaugeGroupoid()


@pytest.fixture(autouse=True)
def _no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GROUPOID_GNI_CACHE", "")


def spun(g: Any, angle: float) -> Any:
    """The same class by another pair: (p s, q s)."""
    c, d = np.cos(angle), np.sin(angle)
    return np.concatenate([c * half + d * hopf.times_k(half) for half in (g[:4], g[4:])])


def random_chain(rng: Any, size: float = 1.5) -> tuple[Any, list[Any]]:
    """A base point and three arrows g, h, k that follow one another, each pair spun at random."""
    x = rng.normal(size=3)
    x /= np.linalg.norm(x)
    arrows, end = [], x
    for _ in range(3):
        arrows.append(spun(space.retract(end, size * rng.uniform(-1, 1, 3)), 7 * rng.random()))
        end = space.target(arrows[-1])
    return x, arrows


def rotation_of(a: Any) -> Any:
    """The matrix of y -> a y a^-1."""
    columns = [hopf.product(hopf.product(a, np.array([0.0, *e])), hopf.conjugate(a))[1:]
               for e in np.eye(3)]  # fmt: skip
    return np.stack(columns, axis=1)


def to_action(g: Any) -> Any:
    """The isomorphism [p, q] -> (hopf(p), rotation of q p^-1)."""
    turn = rotation_of(hopf.product(g[4:], hopf.conjugate(g[:4])))
    return np.concatenate([hopf.hopf(g[:4]), turn.ravel()])


def close(a: Any, b: Any, tolerance: float = 1e-13) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def gaps(groupoid: Any, rng: Any) -> dict[str, float]:
    """By how much each law fails on random arrows; arrows are compared as classes."""

    def apart(g: Any, h: Any) -> float:
        ends = [groupoid.source(g) - groupoid.source(h), groupoid.target(g) - groupoid.target(h)]
        difference = groupoid.lift(groupoid._multiply_unchecked(groupoid.inverse(g), h))
        return float(np.max(np.abs([*ends, difference])))

    x, _ = random_chain(rng)
    xi, eta, zeta = rng.uniform(-0.6, 0.6, (3, 3))
    g = groupoid.retract(x, xi)
    end = groupoid.target(g)
    h = spun(groupoid.retract(end, eta), 2.0)
    k = spun(groupoid.retract(groupoid.target(h), zeta), 0.7)
    multiply, inverse = groupoid._multiply_unchecked, groupoid.inverse
    return {
        "unit": max(
            apart(multiply(g, groupoid.identity(end)), g),
            apart(multiply(groupoid.identity(x), g), g),
        ),
        "associativity": apart(multiply(multiply(g, h), k), multiply(g, multiply(h, k))),
        "inverse": max(
            apart(multiply(g, inverse(g)), groupoid.identity(x)),
            float(np.max(np.abs(groupoid.source(inverse(g)) - end))),
        ),
        "lift": float(np.max(np.abs(groupoid.lift(g) - xi))),
        "symmetry": apart(inverse(g), groupoid.retract(end, -xi)),
        "class": float(np.max(np.abs(groupoid.lift(spun(g, 1.0)) - groupoid.lift(g)))),
    }


def test_the_section_covers_the_sphere_and_the_base_is_kept() -> None:
    rng = np.random.default_rng(1)
    for x in [*np.array(SPECIAL, dtype=float), *rng.normal(size=(20, 3))]:
        close(hopf.hopf(hopf.section(x)), x / np.linalg.norm(x), 1e-15)
    assert space.base_defect(np.array([0.0, 0.0, -1.0])) < 1e-15
    assert space.base_defect(np.array([0.0, 0.6, -0.9])) > 0.05


@pytest.mark.parametrize("seed", range(5))
def test_laws_hold_for_classes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    assert max(gaps(space, rng).values()) < 1e-14
    _, (g, h, _) = random_chain(rng)
    assert space.same_arrow(spun(g, 1.0), g, 1e-13)
    assert space.same_arrow(space.multiply(spun(g, 0.4), spun(h, 5.0)), space.multiply(g, h), 1e-13)
    assert space.same_arrow(space.inverse(spun(g, 3.0)), space.inverse(g), 1e-13)
    assert not space.same_arrow(spun(g, 1.0), space.retract(space.source(g), space.lift(g) + 1e-6))
    for other in (hopf.times_k(g[4:]), -g[4:]):  # in the same fibre as q, but not [p, q]
        assert not space.same_arrow(np.concatenate([g[:4], other]), g)
    with pytest.raises(gni.NotComposableError):
        space.multiply(g, space.inverse(h))


@pytest.mark.slow
def test_all_laws_hold_and_name_the_mistake_in_each_broken_copy(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = hopf.verify(examples=10)
    for law, groupoid in hopf.broken_copies().items():
        assert law in found[type(groupoid).__name__]
        with pytest.raises(gni.InputError, match="is not a groupoid with a symmetric retraction"):
            hopf.veselova_top(groupoid)
    said = capsys.readouterr().out
    assert said.count("laws hold") == 2
    assert "FAILED" not in said.split("\n\n")[0]
    assert "right_unit fails for UnalignedProduct" in said


def test_the_top_and_its_runs_obey_all_laws() -> None:
    top = hopf.veselova_top(space).with_parameters(Omega=0.4)
    check_system(top, examples=8)
    check_method(gni.GNI(), top, examples=8)


@pytest.mark.parametrize("seed", range(3))
def test_isomorphism_onto_the_action_groupoid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    action, (x, (g, h, _)) = hopf.oracle_groupoid(), random_chain(rng)
    xi = rng.uniform(-1, 1, 3)
    close(to_action(space.multiply(g, h)), action.multiply(to_action(g), to_action(h)))
    close(to_action(space.inverse(g)), action.inverse(to_action(g)))
    close(to_action(space.retract(x, xi)), action.retract(x, xi))
    close(action.lift(to_action(space.retract(x, xi))), xi)


@pytest.mark.parametrize("x", [[0.48, -0.6, 0.64], [0.0, 0.36, -1.0], *SPECIAL])
def test_derived_structure_is_that_of_the_oracle_also_at_the_seam(x: list[float]) -> None:
    action, xi = hopf.oracle_groupoid(), np.array([0.7, -0.4, 1.1])
    point = np.array(x, dtype=float) / np.linalg.norm(x)
    for name in ("trivialised_tangent_plus", "trivialised_tangent_minus", "half"):
        close(getattr(space, name)(point, xi), getattr(action, name)(point, xi))
    for name in ("anchor", "bracket"):
        close(getattr(space, name)(point), getattr(action, name)(point))


@pytest.mark.parametrize("method", [gni.GNI(), gni.Rattle()], ids=str)
def test_runs_and_reconstruction_agree_with_the_action_groupoid(method: Any) -> None:
    runs = []
    for groupoid in (space, hopf.oracle_groupoid()):
        top = hopf.veselova_top(groupoid).with_parameters(Omega=0.37)
        start = top.state(hopf.BASE, hopf.VELOCITY, project_start=True)
        runs.append(gni.integrate(top, start, step=0.04, t_end=6.0, method=method))
    assert hopf.difference(*runs).max() < 1e-12
    assert np.any(np.diff(runs[0].base[:, 2] > 0))  # the seam was crossed
    assert hopf.off_sphere(runs[0]).max() < 1e-15
    pairs, rotations = (run.reconstruct() for run in runs)
    close(pairs[:, :4], np.broadcast_to(pairs[0, :4], pairs[:, :4].shape), 0.0)
    for pair, rotation, x in zip(pairs, rotations, runs[0].base, strict=True):
        close(hopf.hopf(pair[4:]), x)
        close(rotation_of(hopf.product(pair[4:], hopf.conjugate(pair[:4]))), rotation, 1e-12)


def newton_euler(top: Any, start: Any, times: Any) -> Any:
    """x(t) from M' = torque + lambda n, x' = omega x x, written out by hand."""
    p = {name: np.array(value) for name, value in top.parameters.items()}
    A, C, n = p["A"], p["C"], p["n"]

    def omega_of(x: Any, momentum: Any) -> Any:
        spin = (momentum @ x - p["s"]) / C
        return (momentum - (momentum @ x) * x) / A + spin * x

    def field(_: float, y: Any) -> Any:
        x, momentum = y[:3], y[3:]
        omega = omega_of(x, momentum)
        moved = np.cross(omega, x)
        slope = np.array([0, 0, p["weight"]]) + p["stiffness"] * (p["field"] @ x) * p["field"]
        torque = -np.cross(x, slope)

        def acceleration(force: Any) -> Any:
            """n.omega' when M' = force."""
            change = force @ x + momentum @ moved
            across = (force - change * x - (momentum @ x) * moved) / A
            return n @ (across + change / C * x + (omega @ x) * moved)

        push = acceleration(torque + n) - acceleration(torque)
        return np.concatenate([moved, torque - acceleration(torque) / push * n])

    y0 = np.concatenate([start.base, start.momentum])
    span = (0.0, times[-1])
    return solve_ivp(field, span, y0, "DOP853", times, rtol=1e-12, atol=1e-13).y[:3].T


def test_orders_and_the_equations_written_by_hand() -> None:
    top = hopf.veselova_top(space).with_parameters(Omega=0.37)
    start = top.state(hopf.BASE, hopf.VELOCITY, project_start=True)
    settings = {"t_end": 2.0, "step": 0.1}
    reference = gni.integrate(top, start, method=gni.ReferenceFlow(rtol=1e-12), **settings)
    close(reference.base, newton_euler(top, start, reference.times), 1e-10)
    for method in (gni.GNI(), gni.Rattle()):
        errors = []
        for split in (2, 4, 8):
            run = gni.integrate(
                top, start, step=0.1 / split, t_end=2.0, method=method, save_every=split
            )
            errors.append(np.abs(run.base - reference.base).max())
        orders = np.log2(np.array(errors[:-1]) / errors[1:])
        close(orders, 2.0, 0.05)


class DiracFrame(hopf.HopfGaugeGroupoid):
    """The frame p e_a of the section at the midpoint (p + q)/|p + q|: no left turns of S^3 in it.

    The circle acts on the side of this frame, so lift first moves the pair by a phase s that puts
    the midpoint on the section; that makes it a function of the class, and symmetric. Singular
    where x is the south pole, the end of the section (Dirac's string).
    """

    def retract(self, x: Any, xi: Any) -> Any:
        p = hopf.section(x)
        forward = np.concatenate([[1.0], xi / 4])
        c = hopf.product(hopf.times_k(p), forward)[3]
        d = -hopf.product(p, forward)[3]
        p = (c * p + d * hopf.times_k(p)) / np.sqrt(c * c + d * d)
        return np.concatenate([p, hopf.product(p, hopf.turn(xi))])

    def lift(self, g: Any) -> Any:
        middle = g[:4] + g[4:]
        c, d = middle[0], -middle[3]
        p, q = ((c * half + d * hopf.times_k(half)) for half in (g[:4], g[4:]))
        a = hopf.product(hopf.conjugate(p), q) / (c * c + d * d)
        return 4 * a[1:] / (1 + a[0])


def test_a_frame_of_the_bundle_with_a_string_gives_the_same_motion() -> None:
    """Components (v_1, v_2, v_fibre) in the frame p e_a: the metric is constant, the row is not."""
    local = DiracFrame()
    x = np.array([0.48, -0.6, 0.64])
    xi, eta = np.array([0.3, -0.5, 0.4]), np.array([0.2, 0.1, -0.6])
    g = local.retract(x, xi)
    end = local.target(g)
    close(local.lift(spun(g, 2.0)), xi)
    assert local.same_arrow(local.inverse(g), local.retract(end, -xi), 1e-13)
    assert local.same_arrow(
        local.multiply(g, local.retract(end, eta)),
        local.multiply(spun(g, 1.0), spun(local.retract(end, eta), 4.0)), 1e-13,
    )  # fmt: skip
    assert np.abs(local.bracket(x) - local.bracket(end)).max() > 0.1

    top = hopf.veselova_top(space)
    start = top.state(hopf.BASE, hopf.VELOCITY, project_start=True)

    def frame(x: Any) -> Any:
        p = hopf.section(x)
        turned = [hopf.product(hopf.product(p, np.array([0.0, *e])), hopf.conjugate(p))[1:]
                  for e in np.eye(3)]  # fmt: skip
        return np.stack(turned, axis=1)

    other = gni.MechanicalSystem(
        local,
        metric=lambda x, p: p.A * np.diag([1.0, 1.0, 0.0]) + p.C * np.diag([0.0, 0.0, 1.0]),
        constraints=lambda x, p: (p.n @ frame(x))[None, :],
        potential=top.plain["potential"],
        gyroscopic=lambda x, p: p.s * np.array([0.0, 0.0, 1.0]),
        parameters=top.parameters,
    )
    moved = other.state(start.base, frame(start.base).T @ start.velocity)
    settings = {"t_end": 1.0, "step": 0.1}
    exact = gni.integrate(top, start, method=gni.ReferenceFlow(rtol=1e-12), **settings)
    again = gni.integrate(other, moved, method=gni.ReferenceFlow(rtol=1e-12), **settings)
    close(again.base, exact.base, 1e-9)
    errors = []
    for split in (2, 4, 8):
        run = gni.integrate(other, moved, step=0.1 / split, t_end=1.0, save_every=split)
        assert np.abs(run.constraint_residuals()).max() < 1e-14
        errors.append(np.abs(run.base - exact.base).max())
    close(np.log2(np.array(errors[:-1]) / errors[1:]), 2.0, 0.05)
