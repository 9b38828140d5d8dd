"""The first look at a user's groupoid: mistakes are named, right ones pass."""

import numpy as np
import pytest

import groupoid_gni as gni
from groupoid_gni.groupoids import broken_law


class Heisenberg(gni.LieGroupoid):
    """(a, b, c) with the product c + c' + (a b' - b a') / 2."""

    rank = 3
    example_base_point = np.zeros(0)

    def source(self, g):
        return g[:0]

    def target(self, g):
        return g[:0]

    def identity(self, x):
        return np.zeros(3)

    def multiply(self, g, h):
        return np.array([g[0] + h[0], g[1] + h[1], g[2] + h[2] + (g[0] * h[1] - g[1] * h[0]) / 2])

    def inverse(self, g):
        return -g

    def retract(self, x, xi):
        return xi

    def lift(self, g):
        return g


def wrong(name, function):
    return type("Wrong", (Heisenberg,), {name: function})()


MISTAKES = {
    "inverse forgotten": ("inverse", lambda self, g: g, "inverse"),
    "factor two in lift": ("lift", lambda self, g: 2.0 * g, r"lift\(retract\(x, xi\)\) = xi"),
    "product not associative": (
        "multiply",
        lambda self, g, h: np.array([g[0] + h[0], g[1] + h[1], g[2] + h[2] + g[0] * h[1] * h[2]]),
        "associativity|inverse",
    ),
    "unit not at zero": ("identity", lambda self, x: np.full(3, 0.3), r"lift\(identity"),
    "retraction not symmetric": (
        "retract",
        lambda self, x, xi: np.array([xi[0] + xi[1] ** 2, xi[1], xi[2]]),
        "lift",
    ),
}


def test_a_right_groupoid_passes_and_runs():
    space = Heisenberg()
    assert broken_law(space) is None
    system = gni.MechanicalSystem(space, np.diag([1.3, 0.7, 2.1]), constraints=[[0.2, 0.4, 1.0]])
    start = system.state(velocity=[1.0, 0.5, -0.4])
    run = gni.integrate(system, start, step=0.02, n_steps=300)
    assert np.max(np.abs(run.energy() - run.energy()[0])) < 1e-3
    assert np.max(np.abs(run.constraint_residuals(relative=True))) < 1e-14


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_in_one_function_is_named(mistake):
    name, function, law = mistake
    with pytest.raises(gni.InputError, match=f"Wrong is not a groupoid.*(?:{law})"):
        gni.MechanicalSystem(wrong(name, function), np.diag([1.3, 0.7, 2.1]))


def test_a_function_that_fails_on_floats_is_reported():
    def broken(self, g):
        raise ValueError("no inverse today")

    with pytest.raises(gni.InputError, match="failed on plain floats: ValueError: no inverse"):
        gni.MechanicalSystem(wrong("inverse", broken), np.diag([1.3, 0.7, 2.1]))


@pytest.mark.parametrize(
    "space",
    [
        gni.PairGroupoid(3),
        gni.SE3(side="right"),
        gni.AtiyahGroupoid(2, gni.SO3(retraction=gni.Exponential())),
        gni.FramedPairGroupoid(gni.VectorGroup(2), gni.SO3()),
        gni.QuadraticGroup(np.diag([1.0, 1.0, 1.0, -1.0])),
    ],
    ids=repr,
)
def test_the_built_in_groupoids_pass(space):
    assert broken_law(space) is None


def test_a_base_point_that_drifts_off_is_a_failure():
    class Leaky(gni.LieGroupoid):
        """Pairs of points of the unit circle, with an identity that knows the circle."""

        rank = 1
        example_base_point = np.array([1.0, 0.0])

        def source(self, g):
            return g[:2]

        def target(self, g):
            return g[2:]

        def identity(self, x):
            point = x / np.sqrt(x @ x)
            return np.concatenate([point, point])

        def multiply(self, g, h):
            return np.concatenate([g[:2], h[2:]])

        def inverse(self, g):
            return np.concatenate([g[2:], g[:2]])

        def retract(self, x, xi):
            c, s = np.cos(xi[0]), np.sin(xi[0])
            length = 1.0 + 0.5 * (x @ x - 1.0)
            end = length * np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]]) * (1.0 + 2e-8)
            return np.concatenate([x, end])

        def lift(self, g):
            return np.array([np.arctan2(g[0] * g[3] - g[1] * g[2], g[0] * g[2] + g[1] * g[3])])

    system = gni.MechanicalSystem(Leaky(), [[1.3]])
    start = system.state([0.6, 0.8], [0.9])
    with pytest.raises(gni.StepFailure, match=r"drifted off.*restore_base"):
        gni.integrate(system, start, step=0.05, n_steps=5000)
