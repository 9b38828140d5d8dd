"""Discrete mechanics, part III: stages and what they are composed of; exact energy; bare stages.

Section numbers are those of docs/theory.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen import InterpretedStep, StepRunner
from groupoid_gni.discretization import (
    SystemExpressions,
    bare_program,
    impulse_program,
    projected_program,
)
from groupoid_gni.integrators import GNI, McLachlanPerlmutter
from groupoid_gni.trajectory import Trajectory
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, gap
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.method_run_laws import (
    free_motions,
    free_view,
    from_momentum,
    kept_run,
    momentum_unit,
    motions,
    needs_rows,
    parameters_at,
)
from groupoid_gni.verification.method_variants import dependent_rows_are_fine
from groupoid_gni.verification.method_view import MethodView
from groupoid_gni.verification.system_view import SystemView

_FEW_STEPS = 8
_FINE = 2.0**-7  # of differences in h, in units of the step: K_h varies over a step

_law = partial(law, "method", share=0.2)


# One stage of the method, from any momentum.


@lru_cache(maxsize=8)
def _stage(view: MethodView, rows: tuple[int, ...]) -> StepRunner:
    """The runner of one stage: the program of the method with one fraction in place of all."""
    e = SystemExpressions(view.system, rows)
    outward, homeward = view.flow.flights(e)
    program = projected_program
    if isinstance(view.method, McLachlanPerlmutter):
        program = impulse_program
    elif view.bare:
        program = bare_program
    return InterpretedStep(program(e, outward, homeward, (1.0,), False))


def _rows_at(view: MethodView, x: FloatArray) -> tuple[int, ...]:
    with dependent_rows_are_fine():
        return view.system.independent_rows(x)


def _after_stage(
    view: MethodView, rows: tuple[int, ...], node: tuple[FloatArray, FloatArray], size: float
) -> tuple[FloatArray, FloatArray]:
    """One stage of the given size from (x, p)."""
    runner = _stage(view, rows)
    parameters = parameters_at(view, view.system, node[0], rows, size)
    return runner.program.layout.node(from_momentum(runner, parameters, *node, 1)[0])


def _momentum(view: MethodView, x: FloatArray, xi: FloatArray) -> FloatArray:
    system = view.system
    return np.asarray(system.evaluate("metric", x) @ xi + system.evaluate("gyroscopic", x))


def _node_gap(
    view: MethodView,
    left: tuple[FloatArray, FloatArray],
    right: tuple[FloatArray, FloatArray],
) -> Gap:
    """Base points, and momenta in units of their own."""
    sizes = [float(np.max(np.abs(p), initial=0.0)) for _, p in (left, right)]
    unit = max(*sizes, momentum_unit(view.system, right[0]))
    one, other = (np.append(x, p / unit) for x, p in (left, right))
    return gap(one, other)


def _needs_stages(view: MethodView) -> str | None:
    return None if len(view.fractions) > 1 else "a step of it is one stage"


@_law("F_h = K_{g_s h} ... K_{g_2 h} K_{g_1 h}", "one step of a composition with fractions g_i",
      "theory 4.3, 5.1; Yoshida 1990", draw=motions, applies=_needs_stages, tolerance=1e-11,
      reason="both end their iterations at round-off, and stages spread it")
def composed_steps_are_products_of_stages(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """The stages of a step are steps of the sizes of the table, in its order."""
    run = kept_run(view, x, xi, 1)
    node = run.base[0], run.momenta[0]
    for fraction in view.fractions:
        node = _after_stage(view, run.active_rows, node, fraction * view.step)
    return _node_gap(view, (run.base[1], run.momenta[1]), node)


# Exact energy.


def _keeps_energy(view: MethodView) -> str | None:
    if not view.energy_preserving:
        return "its flights are not those of EnergyPreserving()"
    return None


def _keeps_energy_on_constraint(view: MethodView) -> str | None:
    if not isinstance(view.method, GNI):
        return "only a reflection, or what is lent and taken back, keeps the energy"
    if view.system.has("drift"):
        return "affine constraints do work"
    return _keeps_energy(view) or needs_rows(view)


def _energy_gap(run: Trajectory) -> Gap:
    """The energy of all nodes, less the work of the force, against that of the first."""
    energy = run.energy()
    kept = energy - run.work()
    kinetic = 0.5 * np.einsum("kr,kr->k", run.velocities, run.momenta)
    scale = float(np.max(np.abs(kinetic)) + np.ptp(energy))
    if run.system.has("potential"):
        scale += float(np.max(np.abs(run.system.evaluate("potential", run.base))))
    return gap(kept, np.full_like(kept, kept[0]), scale or 1.0)


_exact_energy = partial(
    _law, tolerance=1e-12, reason="round-off of a few steps of several stages each"
)


@_exact_energy("H(x_k, p_k) = H(x_0, p_0) + work of the force", "GNI with flights of "
               "EnergyPreserving(), with projection or without, any order, linear constraints",
               "design 2.3; theory 6.6, 9.2", draw=motions, applies=_keeps_energy_on_constraint)
def energy_is_kept_exactly(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Flights keep the energy, reflections too, and what is lent is taken back."""
    return _energy_gap(kept_run(view, x, xi, _FEW_STEPS))


@_exact_energy("H(F(x, p)) = H(x, p) + work of the force",
               "flights of EnergyPreserving(), any metric, potential and gyroscopic term",
               "theory 6.3, 6.4", draw=free_motions, applies=_keeps_energy)
def energy_preserving_flights_keep_the_energy(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """Without constraints nothing changes the energy but the force."""
    return _energy_gap(kept_run(free_view(view), x, xi, _FEW_STEPS))


# Bare stages.


def _needs_bare(view: MethodView) -> str | None:
    return None if view.bare else "its stages are not bare"


_on_bare = partial(_law, draw=free_motions, applies=_needs_bare)


@_on_bare("K_{-h} K_h = 1", "a bare stage, from any momentum, on the constraint or off it",
          "theory 2.1", tolerance=1e-12, reason="round-off of two stages")
def bare_stage_is_its_own_adjoint(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A bare stage of the opposite size undoes a bare stage."""
    node, rows = (x, _momentum(view, x, xi)), _rows_at(view, x)
    there = _after_stage(view, rows, node, view.step)
    return _node_gap(view, _after_stage(view, rows, there, -view.step), node)


@_on_bare("R K_h = 1 + h (X + R_* X)/2 + O(h^2), X = x' d/dx + p' d/dp without constraints",
          "a bare stage, from any momentum", "theory 3.1, 5.1: R K_h is the adjoint of M_h = K_h R",
          tolerance=1e-8, reason="differences of order eight in h, and along R_* X")
def bare_stage_tends_to_the_reflection(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """At h = 0 a bare stage reflects; to first order it moves by the mean of a field and its
    mirror image.
    """
    p, rows, r = _momentum(view, x, xi), _rows_at(view, x), len(xi)
    plain = SystemView(view.system)
    unit = max(momentum_unit(view.system, x), float(np.max(np.abs(p))))

    def reflected(y: FloatArray, q: FloatArray) -> FloatArray:
        node = plain.node(y)
        mirrored = (node.along - node.across) @ q + 2.0 * node.across @ node.offset
        return np.append(y, mirrored / unit)

    def moved(size: FloatArray) -> FloatArray:
        return reflected(*_after_stage(view, rows, (x, p), float(size[0])))

    found = central_difference(moved, np.zeros(1), step=_FINE * view.step)[:, 0]
    field = _free_field(view)
    mirror = reflected(x, p)[len(x) :] * unit
    along = field(x, mirror)
    # R_* X at (x, p) is the derivative of R along X at R(x, p)
    image = central_difference(
        lambda t: reflected(x + t[0] * along[:-r], mirror + t[0] * along[-r:]),
        np.zeros(1), step=_FINE * view.step,
    )[:, 0]
    own = field(x, p)
    expected = (np.append(own[:-r], own[-r:] / unit) + image) / 2.0
    return gap(found, expected)


def _free_field(view: MethodView) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """x' and p' without constraints, one after the other."""
    plain = SystemView(free_view(view).system)
    return lambda x, p: np.concatenate(plain.rates(x, p))


METHOD_FLOW_LAWS = (
    composed_steps_are_products_of_stages, energy_is_kept_exactly,
    energy_preserving_flights_keep_the_energy, bare_stage_is_its_own_adjoint,
    bare_stage_tends_to_the_reflection,
)
