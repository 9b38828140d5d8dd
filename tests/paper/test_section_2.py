"""Section 2: the continuous equations (1)-(5), which the reference flow integrates."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from plain_mechanics import Mechanics, close, derivative, five, free, particle, rolling_disc

import groupoid_gni as gni
from groupoid_gni.discretization import SystemExpressions, reference_field

MAKERS = {
    "curved particle": lambda: particle(curved=True),
    "five": five,
    "rolling disc": rolling_disc,
    "curved particle, affine": lambda: particle(affine=True, curved=True),
}


@cache
def made(name: str) -> Mechanics:
    if name.startswith("free "):
        return free(made(name.removeprefix("free ")))
    return MAKERS[name]()


def acceleration(mechanics: Mechanics) -> Any:
    """q'' at the start, from the library's equations of motion for (q, p)."""
    q, v = mechanics.base, mechanics.velocity
    rows = tuple(range(len(mechanics.rows(q))))
    field = reference_field(SystemExpressions(mechanics.system, rows))
    p = mechanics.metric(q) @ v
    q_dot, p_dot = np.split(np.array(field([], np.append(q, p))).ravel(), 2)
    close(q_dot, v, 1e-15)
    turning = np.einsum("kij,k->ij", derivative(mechanics.metric, q), v)
    return np.linalg.solve(mechanics.metric(q), p_dot - turning @ v)


def covariant_acceleration(mechanics: Mechanics) -> Any:
    """``nabla_c' c'`` with the Christoffel symbols of the metric."""
    q, v = mechanics.base, mechanics.velocity
    d = derivative(mechanics.metric, q)  # d[k, i, j] = d_k G_ij
    lowered = 0.5 * (np.einsum("jik->ijk", d) + np.einsum("kij->ijk", d) - d)
    curving = np.einsum("ijk,j,k->i", lowered, v, v)
    return acceleration(mechanics) + np.linalg.solve(mechanics.metric(q), curving)


def gradient(mechanics: Mechanics) -> Any:
    q = mechanics.base
    return np.linalg.solve(mechanics.metric(q), mechanics.force(q))


@pytest.mark.parametrize("name", MAKERS)
def test_the_reference_flow_is_the_motion_of_equations_2(name: str) -> None:
    mechanics = made(name)
    run = gni.integrate(
        mechanics.system, mechanics.start, step=0.2, t_end=0.8,
        method=gni.ReferenceFlow(rtol=1e-12), compile=False,
    )
    q, v = mechanics.exact(0.8, rtol=1e-12)
    close(run.base[-1], q, 2e-11)
    close(run.velocities[-1], v, 2e-11)
    close(run.multipliers[-1], mechanics.accelerations(q, v)[1], 2e-10)
    # (1), and (24) with drift
    close(mechanics.rows(q) @ (v - mechanics.section(q)), 0, 2e-11)


@pytest.mark.parametrize("name", MAKERS)
def test_momentum_and_energy_are_those_of_the_mechanical_lagrangian_3(name: str) -> None:
    mechanics = made(name)
    q, v, start = mechanics.base, mechanics.velocity, mechanics.start
    slope = derivative(lambda u: mechanics.lagrangian(q, u), v)
    close(start.momentum, slope, 1e-15)
    run = gni.integrate(mechanics.system, start, step=0.01, n_steps=1, compile=False)
    energy = slope @ v - mechanics.lagrangian(q, v)
    np.testing.assert_allclose(run.energy()[0], energy, rtol=2e-15)


@pytest.mark.parametrize("name", ["free curved particle", "free five"])
def test_free_motion_is_newtons_equation_4_on_a_riemannian_manifold(name: str) -> None:
    mechanics = made(name)
    close(covariant_acceleration(mechanics), -gradient(mechanics), 3e-15)


@pytest.mark.parametrize("name", ["curved particle", "five", "rolling disc"])
def test_constrained_motion_is_the_projected_equation_5(name: str) -> None:
    mechanics = made(name)
    along, across = (star.T for star in mechanics.projectors(mechanics.base))
    bend = covariant_acceleration(mechanics)
    close(along @ bend, -along @ gradient(mechanics), 3e-15)
    # lambda = nabla_c' c' + grad V is a section of the orthogonal complement of D
    reaction = bend + gradient(mechanics)
    close(across @ reaction, reaction, 3e-15)
    assert np.abs(reaction).max() > 0.05


@pytest.mark.parametrize("name", MAKERS)
def test_the_projectors_split_momenta_as_the_local_expression_of_section_2(name: str) -> None:
    mechanics = made(name)
    q, p = mechanics.base, np.linspace(-0.7, 1.1, len(mechanics.base))
    along, across = mechanics.projectors(q)
    x, momentum = ca.SX.sym("x", len(q)), ca.SX.sym("p", len(q))
    rows = tuple(range(len(mechanics.rows(q))))
    node = SystemExpressions(mechanics.system, rows).node(x, ca.SX(0, 1))
    both = ca.Function("both", [x, momentum], [node.project(momentum), node.reflect(momentum)])
    kept, reflected = (np.array(side).ravel() for side in both(q, p))
    offset = mechanics.one_form(q)
    close(kept, along @ p + across @ offset, 3e-15)
    close(reflected, (along - across) @ p + 2 * across @ offset, 3e-15)
    gradients = np.linalg.solve(mechanics.metric(q), mechanics.rows(q).T)
    close(across.T @ gradients, gradients, 3e-15)
    close(along.T @ gradients, 0, 3e-15)
