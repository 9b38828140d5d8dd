"""Discrete mechanics, part II: what runs keep, adjoints, reversibility, orders, bookkeeping.

The samples are starts in general position, never at rest; each law makes its runs from them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.codegen.runners import StepRunner
from groupoid_gni.discretization import DiscreteLagrangian, Midpoint, Rattle
from groupoid_gni.errors import InputError, StepFailure
from groupoid_gni.groupoids import LieGroupoid, PairGroupoid
from groupoid_gni.integrators import (
    GNI,
    ReferenceFlow,
    compiled_step,
    next_arrow,
)
from groupoid_gni.integrators.methods import SteppingMethod
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.trajectory import Trajectory
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, arrow_gap, gap
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.method_variants import (
    dependent_rows_are_fine,
    start,
    without_constraints,
)
from groupoid_gni.verification.method_view import ArrowMethod, MethodView

_STEPS = 24
_LONGEST = 0.3  # reach of one step of the motions that are drawn


# Samples.


def _entries(size: int, bound: float) -> st.SearchStrategy[FloatArray]:
    one = st.floats(-bound, bound, allow_subnormal=False)
    return st.tuples(*[one] * size).map(lambda values: np.array(values, dtype=np.float64))


@st.composite
def _motions(draw: Callable[[Any], Any], view: MethodView) -> dict[str, FloatArray]:
    space = view.system.space
    numbers = np.arange(space.rank)
    x = np.array(space.example_base_point, dtype=np.float64)
    # general position: even the simplest sample neither rests nor starts at a special point
    away = 0.4 * np.sin(1.0 + 2.4 * numbers) + draw(_entries(space.rank, 0.4))
    if space.base_size:
        away = away * min(1.0, 0.8 / max(_reach(space, x, away), 1e-3))
        x = np.asarray(space.target(space.retract(x, away)), dtype=float)
        x = np.asarray(space.restore_base(x), dtype=float)
    xi = 0.9 * np.sin(2.0 + 2.4 * numbers) + draw(_entries(space.rank, 0.7))
    xi = xi * min(1.0, _LONGEST / max(_reach(space, x, view.step * xi), 1e-3))
    try:
        return {"x": x, "xi": start(view.system, x, xi).velocity.copy()}
    except InputError:
        assume(False)
        raise


def motions(view: MethodView) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi}: consistent starts in general position."""
    return _motions(view)


def _reach(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> float:
    return float(np.asarray(space.reach(x, xi)))


# What is made from a view.


@lru_cache(maxsize=4)
def free_view(view: MethodView) -> MethodView:
    """The same method on the system without its constraints."""
    return replace(view, system=without_constraints(view.system))


def free_motions(view: MethodView) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi}: starts of the system without its constraints."""
    return _motions(free_view(view))


def kept_run(
    view: MethodView,
    x: FloatArray,
    xi: FloatArray,
    steps: int,
    step: float | None = None,
    reconstruct: bool = False,
) -> Trajectory:
    """A run from a start; made once for the laws that look at it one after the other."""
    h = view.step if step is None else step
    return _kept_run(view, x.tobytes(), xi.tobytes(), steps, h, reconstruct)


@lru_cache(maxsize=8)
def _kept_run(
    view: MethodView, x: bytes, xi: bytes, steps: int, step: float, reconstruct: bool
) -> Trajectory:
    begin = start(view.system, np.frombuffer(x), np.frombuffer(xi))
    return view.run(begin, steps, step=step, reconstruct=reconstruct)


def parameters_at(
    view: MethodView,
    system: MechanicalSystem,
    x: FloatArray,
    rows: tuple[int, ...],
    step: float | None = None,
) -> FloatArray:
    """What a step program of a system is given: parameters, step size, scales of the rows at x."""
    mu = system.evaluate("constraints", x)[list(rows)]
    scales = np.sum(mu * np.linalg.solve(system.evaluate("metric", x), mu.T).T, axis=1)
    h = view.step if step is None else step
    return np.concatenate([system.parameter_vector, [h], scales])


def _ready(
    view: MethodView,
    system: MechanicalSystem,
    x: FloatArray,
    rows: tuple[int, ...] = (),
    rule: DiscreteLagrangian | None = None,
    step: float | None = None,
) -> tuple[StepRunner, FloatArray]:
    """The runner of the view's method, or of a two-step rule, and its parameters at x."""
    runner = compiled_step(system, rule or _stepping(view), rows, compile=False)
    return runner, parameters_at(view, system, x, rows, step)


def from_momentum(
    runner: StepRunner, parameters: FloatArray, x: FloatArray, p: FloatArray, steps: int
) -> FloatArray:
    """The states (steps, ...) of a run that leaves x with any momentum."""
    state = np.zeros(runner.program.layout.size)
    for name, part in (("base", x), ("before", p), ("after", p)):
        state[runner.program.layout.slices[name]] = part
    begun, stages = runner.begin(parameters, state), runner.program.stages
    _, rows, outcome = runner.advance(parameters, begun, stages * steps, stages)
    if outcome is not Outcome.SUCCESS:
        raise StepFailure(outcome.sentence)
    return rows[:, : len(state)]


def _free_step(
    view: MethodView, rule: DiscreteLagrangian | None, step: float
) -> Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """One step (x, p) -> (x', p') without constraints, by the view's method or a two-step rule."""
    system = free_view(view).system

    def stepped(x: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
        runner, parameters = _ready(view, system, x, (), rule, step)
        state = from_momentum(runner, parameters, x, p, 1)[0]
        return runner.program.layout.node(state)

    return stepped


def _stepping(view: MethodView) -> SteppingMethod:
    if not isinstance(view.method, SteppingMethod):
        raise InputError(f"the laws of runs are about methods that step, not {view.method}")
    return view.method


def _momentum(system: MechanicalSystem, x: FloatArray, xi: FloatArray) -> FloatArray:
    return np.asarray(system.evaluate("metric", x) @ xi + system.evaluate("gyroscopic", x))


def momentum_unit(system: MechanicalSystem, x: FloatArray) -> float:
    """The size of momenta at velocities of size one."""
    return float(np.max(np.abs(system.evaluate("metric", x))))


def needs_rows(view: MethodView) -> str | None:
    """Laws about constraints."""
    return None if view.system.constraint_count else "there are no constraints"


def needs_no_force(view: MethodView) -> str | None:
    """Laws about what a motion left to itself keeps."""
    return "an external force acts" if view.system.has("force") else None


def arrows_of(view: MethodView, run: Trajectory) -> FloatArray:
    """The arrows of the steps, (n - 1, arrow size); from the products where only those are kept."""
    if view.shows_arrows:
        return run.arrows
    space = run.system.space
    products = run.rows[:, run.layout.slices["reconstructed"]]
    made = [space.multiply(space.inverse(w), then) for w, then in pairwise(products)]
    return np.array(made, dtype=float)


_law = partial(law, "method", draw=motions, share=0.2)


# Without constraints.


def _tensor_among_momenta(space: LieGroupoid, x: FloatArray, p: FloatArray) -> FloatArray:
    return -np.einsum("cab,c->ab", np.asarray(space.bracket(x), dtype=float), p)


def _poisson_tensor(space: LieGroupoid, x: FloatArray, p: FloatArray) -> FloatArray:
    """The linear one of A*G: ``x' = rho xi``, ``p_a' = -rho_a^i dH/dx^i + <p, [xi, e_a]>``."""
    rho = np.asarray(space.anchor(x), dtype=float)
    nothing = np.zeros((len(x), len(x)))
    return np.block([[nothing, rho], [-rho.T, _tensor_among_momenta(space, x, p)]])


def _canonical(view: MethodView) -> str | None:
    if view.energy_preserving:
        return "flights that keep the energy are not canonical"
    return needs_no_force(view)


@_law("DF Lambda(z) DF^T = Lambda(F(z)), {x^i, p_a} = rho^i_a, {p_a, p_b} = -C^c_ab p_c",
      "the step z -> F(z) without constraints, z = (x, p) in A*G",
      "section 3: the discrete flow is symplectic; Poisson on the dual of the algebroid",
      draw=free_motions, tolerance=1e-10,
      reason="differences of order eight lose four digits and more where a term varies fast",
      applies=_canonical)
def free_step_is_a_poisson_map(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Free flight is a canonical transformation."""
    system, space = view.system, view.system.space
    step, p, still = _free_step(view, None, view.step), _momentum(system, x, xi), np.zeros(len(xi))
    inertia = np.diag(system.evaluate("metric", x))

    def at(u: FloatArray) -> FloatArray:
        return np.asarray(space.target(space.retract(x, u)), dtype=float)

    def moved(u: FloatArray) -> FloatArray:
        return np.concatenate(step(at(u), p))

    def pushed(w: FloatArray) -> FloatArray:
        return np.concatenate(step(x, p + inertia * w))

    by_momentum = central_difference(pushed, still) / inertia
    by_place = np.zeros_like(by_momentum)
    if movable := [a for a, e in enumerate(np.eye(len(xi))) if np.any(at(0.1 * e) != x)]:
        by_place[:, movable] = central_difference(moved, still, np.eye(len(xi))[movable])
    mixed = by_place @ by_momentum.T
    among_momenta = by_momentum @ _tensor_among_momenta(space, x, p) @ by_momentum.T
    unit = momentum_unit(system, x)
    units = np.append(np.ones(len(x)), np.full(len(p), 1.0 / unit))
    left, right = mixed - mixed.T + among_momenta, _poisson_tensor(space, *step(x, p))
    return gap(*(unit * units[:, None] * side * units for side in (left, right)))


def _over_a_point(view: MethodView) -> str | None:
    return "the base is not a point" if view.system.space.base_size else needs_no_force(view)


@_law("p_N = Ad^T p_0 with Ad of the product g_0 ... g_N-1", "runs without constraints on a group",
      "section 3: the discrete momentum map is preserved; Lemma 9.5", draw=free_motions,
      tolerance=1e-12, reason="round-off of a few steps and of differences of order eight",
      applies=_over_a_point)
def momentum_in_space_is_kept(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """What turns a free body leaves its angular momentum in space alone."""
    space = view.system.space
    run = kept_run(free_view(view), x, xi, 8, reconstruct=not free_view(view).shows_arrows)
    whole = _product(space, arrows_of(free_view(view), run))
    back = space.inverse(whole)

    def conjugated(e: FloatArray) -> FloatArray:
        return np.asarray(
            space.lift(space.multiply(space.multiply(whole, space.retract(x, e)), back))
        )

    adjoint = central_difference(conjugated, np.zeros(len(xi)))
    left, right = run.momenta_after[-1], adjoint.T @ run.momenta_after[0]
    return gap(left, right, _largest(left, right, momentum_unit(view.system, x)))


def _largest(*sides: ArrayLike) -> float:
    return max(float(np.max(np.abs(side), initial=0.0)) for side in sides)


def _product(space: LieGroupoid, arrows: FloatArray) -> FloatArray:
    whole = arrows[0]
    for arrow in arrows[1:]:
        whole = space.multiply(whole, arrow)
    return np.asarray(whole, dtype=float)


def _needs_rule(view: MethodView) -> str | None:
    return None if view.variational else "its flights are not those of a discrete Lagrangian"


@_law("F_L*(-h) F_L(h) = 1", "the free flight F_L of the method's L_d, (x, p) in A*G",
      "Definition 5.3", draw=free_motions, tolerance=1e-12, reason="round-off of two steps",
      applies=_needs_rule)
def adjoint_undoes_the_free_flight(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Flying back with the adjoint rule returns."""
    p = _momentum(view.system, x, xi)
    there = _free_step(view, view.rule, view.step)(x, p)
    back = _free_step(view, view.rule.adjoint(), -view.step)(*there)
    unit = _largest(p, momentum_unit(view.system, x))
    return gap(np.append(back[0], back[1] / unit), np.append(x, p / unit))


# What runs keep.


def _has_symmetries(view: MethodView) -> str | None:
    if not view.symmetries:
        return "no symmetries are given"
    return _needs_rule(view) or needs_no_force(view)


@_law("<p_k, Y(x_k)> is the same at all nodes, before and after the impact",
      "runs, sections Y in D that leave L_d invariant",
      "section 3: the discrete momentum map; impacts change p in the annihilator of D",
      tolerance=1e-12, reason="round-off of a few dozen steps", applies=_has_symmetries)
def momentum_of_a_symmetry_is_kept(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A symmetry along the constraints has its momentum conserved."""
    run = kept_run(view, x, xi, _STEPS)
    left, right, sizes = [], [], []
    for section in view.symmetries:
        values = np.array([np.asarray(section(point), dtype=float) for point in run.base])
        for momenta in (run.momenta_before, run.momenta_after):
            products = momenta * values
            left.append(np.sum(products, axis=1))
            right.append(np.full(len(run), np.sum(products[0])))
            sizes.append(float(np.max(np.sum(np.abs(products), axis=1))))
    return gap(left, right, max(*sizes, 1e-3 * momentum_unit(view.system, x)))


def _biinvariant(view: MethodView) -> str | None:
    system = view.system
    if system.space.base_size:
        return "the base is not a point"
    if not view.two_step:
        return "such motions on the constraint are steady, and other methods stay there"
    if system.has("force"):
        return "an external force acts"
    if system.has("drift") or system.has("gyroscopic"):
        return "claimed without drift and gyroscopic term"
    point = np.zeros(0)
    metric, structure = system.evaluate("metric", point), np.asarray(system.space.bracket(point))
    lowered = np.einsum("dc,cab->dab", metric, structure)  # <e_d, [e_a, e_b]>
    defect = np.max(np.abs(lowered + np.einsum("dab->bad", lowered)))
    return "the metric is not bi-invariant" if defect > 1e-12 * np.max(np.abs(metric)) else None


@_law("1/2 p G^-1 p is the same at all nodes, before and after the impact",
      "two-step runs from any arrow, bi-invariant metric on a Lie group, any linear constraints",
      "section 4, energy preservation [23]", draw=free_motions, tolerance=1e-12,
      reason="round-off of a few dozen steps", applies=_biinvariant)
def energy_of_a_biinvariant_metric_is_kept(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """Flights turn p and impacts reflect it: its length stays, on the constraint or off it."""
    system = view.system
    with dependent_rows_are_fine():
        rows = system.independent_rows(x)
    runner, parameters = _ready(view, system, x, rows)
    p = _momentum(system, x, xi)
    states = from_momentum(runner, parameters, x, p, _STEPS)
    slices = runner.program.layout.slices
    momenta = np.concatenate([[p], states[:, slices["before"]], states[:, slices["after"]]])
    energies = 0.5 * np.sum(momenta * np.linalg.solve(system.evaluate("metric", x), momenta.T).T, 1)
    return gap(energies, np.full_like(energies, energies[0]), float(energies[0]) or 1.0)


def _kinetic_energies(view: MethodView, run: Trajectory, momenta: FloatArray) -> FloatArray:
    return 0.5 * np.einsum("kr,kr->k", momenta, view.system.velocities(run.base, momenta))


def _quadratic_on_pairs(view: MethodView) -> str | None:
    system = view.system
    if not isinstance(system.space, PairGroupoid):
        return "claimed on R^n x R^n"
    if not (isinstance(view.method, (DiscreteLagrangian, GNI)) and view.variational
            and view.rule in (Rattle(), Midpoint())):
        return "claimed for (49) and GNI with the flights of Rattle and Midpoint"
    if view.rule == Rattle() and len(set(view.fractions)) > 1:
        return "stages of different sizes keep different energies"
    if system.has("force"):
        return "an external force acts"
    if system.has("drift") or system.has("gyroscopic"):
        return "claimed without drift and gyroscopic term"
    n = system.space.base_size
    points = np.cos(1.0 + np.arange(5 * n)).reshape(5, n)
    tensors = [system.evaluate("metric", points)]
    if system.has("potential"):
        hessian = system.recorded("potential").derivative(0).derivative(0)
        tensors.append(np.asarray(hessian(points, system.parameter_vector)))
    for tensor, words in zip(tensors, ("metric", "curvature of the potential"), strict=False):
        if np.ptp(tensor, axis=0).max() > 1e-12 * np.abs(tensor).max():
            return f"the {words} is not constant"
    return None


@_law("1/2 p M^-1 p + V - w h^2/8 V' M^-1 V' is the same at all nodes; w = 1 for Rattle, g^2/4 "
      "for GNI of Rattle with stages g h, 0 for Midpoint and GNI of Midpoint",
      "runs on R^n x R^n, constant M, quadratic V, any linear constraints", "design 2.3 and 2.6",
      tolerance=1e-12, reason="round-off of a few dozen steps", applies=_quadratic_on_pairs)
def energy_of_a_quadratic_potential_is_kept(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """A spring's flights keep a quadratic form in q and p, and impacts keep it too."""
    system, run = view.system, kept_run(view, x, xi, _STEPS)
    potential = np.zeros(len(run))
    if system.has("potential"):
        recorded = system.recorded("potential")
        force = np.asarray(recorded.derivative(0)(run.base, system.parameter_vector))
        raised = np.linalg.solve(system.evaluate("metric", run.base), force[..., None])[..., 0]
        weight = 1.0 if view.two_step else view.fractions[0] ** 2 / 4.0
        weight = 0.0 if view.rule == Midpoint() else weight
        shift = weight * view.step**2 / 8 * np.sum(force * raised, axis=1)
        potential = system.evaluate("potential", run.base) - shift
    kinetic = [_kinetic_energies(view, run, p) for p in (run.momenta_before, run.momenta_after)]
    energies = np.concatenate([k + potential for k in kinetic])
    scale = float(np.max(np.abs(kinetic)) + np.max(np.abs(potential)))
    return gap(energies, np.full_like(energies, energies[-1]), scale or 1.0)


# Adjoints and time reversal.


def _needs_arrows(view: MethodView) -> str | None:
    return None if view.two_step else "only discrete Lagrangians go by (49) from arrow to arrow"


def _needs_self_adjoint(view: MethodView) -> str | None:
    return None if view.self_adjoint else "the method is not its own adjoint"


def _needs_even_lagrangian(view: MethodView) -> str | None:
    if view.system.has("drift") or view.system.has("gyroscopic"):
        return "drift and gyroscopic terms change sign with the velocity"
    if view.system.has("force"):
        return "an external force need not be even in the velocity"
    return _needs_self_adjoint(view)


def _next_arrow(
    view: MethodView, rule: ArrowMethod, arrow: FloatArray, step: float
) -> FloatArray:
    with dependent_rows_are_fine():
        return next_arrow(view.system, rule, arrow, step=step)


@_law("h = next(L, g, step) implies g^-1 = next(L*, h^-1, -step)",
      "arrows g on the constraint or off it, two-step methods", "Theorem 5.4, Definition 5.3",
      draw=free_motions, tolerance=1e-12, reason="round-off of two steps", applies=_needs_arrows)
def adjoint_undoes_the_arrow(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The adjoint rule goes back along the same arrows, impacts included."""
    space, step = view.system.space, view.step
    g = np.asarray(space.retract(x, step * xi), dtype=float)
    follower = _next_arrow(view, view.rule, g, step)
    back = _next_arrow(view, view.rule.adjoint(), space.inverse(follower), -step)
    return _velocity_gap(space, back, space.inverse(g), step)


def _velocity_gap(space: LieGroupoid, g: FloatArray, h: FloatArray, step: float) -> Gap:
    """Two arrows compared by their ends and, over the step size, by what lies between them."""
    sides = arrow_gap(space, g, h)
    unit = np.ones(sides.left.shape)
    unit[-space.rank :] = step
    return gap(sides.left / unit, sides.right / unit)


def _there_and_back(view: MethodView, x: FloatArray, xi: FloatArray, sign: float) -> Gap:
    """A run and its return with the step ``sign * h``; velocities keep the sign ``-sign``."""
    method, space = view.method, view.system.space
    if isinstance(method, ArrowMethod):
        there = kept_run(view, x, xi, _STEPS // 2)
        arrow = space.inverse(there.arrows[-1])
        gaps = []
        for expected in there.arrows[-2::-1]:
            arrow = _next_arrow(view, method, arrow, sign * view.step)
            gaps.append(_velocity_gap(space, arrow, space.inverse(expected), view.step))
        return gap([g.left for g in gaps], [g.right for g in gaps])
    # from momentum to momentum, on the constraint or off it
    there = kept_run(view, x, xi, _there_steps(view))
    runner, parameters = _ready(
        view, view.system, there.base[0], there.active_rows, step=sign * view.step
    )
    last = -sign * there.momenta[-1]
    states = from_momentum(runner, parameters, there.base[-1], last, len(there) - 1)
    base, momenta = runner.program.layout.node(states)
    unit = _largest(there.momenta, momentum_unit(view.system, x))
    return gap(
        np.concatenate([base, momenta / unit], axis=1),
        np.concatenate([there.base, -sign * there.momenta / unit], axis=1)[-2::-1],
    )


def _there_steps(view: MethodView) -> int:
    """Steps there: about two dozen stages, two steps at least."""
    return max(2, _STEPS // len(view.fractions))


@_law("F(-h) F(h) = 1", "runs of self-adjoint methods there and back", "Definition 5.3, F* = F",
      tolerance=1e-11, reason="round-off of two dozen steps, as much as the motion spreads it",
      applies=_needs_self_adjoint)
def run_backwards_returns(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A run with the opposite step goes back through the same nodes."""
    return _there_and_back(view, x, xi, -1.0)


@_law("S F(h) S F(h) = 1, S(x, v) = (x, -v)",
      "runs of self-adjoint methods, L even in the velocity and linear constraints",
      "Remark 5.1: reversible methods", tolerance=1e-11,
      reason="round-off of two dozen steps, as much as the motion spreads it",
      applies=_needs_even_lagrangian)
def turned_round_motion_returns(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """With the velocity turned round the motion goes back through the same nodes."""
    return _there_and_back(view, x, xi, 1.0)


# Orders.


_COARSEST = 4  # steps of the coarsest run
_FIRST, _LAST = 3, 5
_STRETCH = {1: 1.0, 2: 1.0, 4: 4.0, 6: 8.0, 8: 12.0}
"""Coarsest step in units of the view's, by order: errors of every order show above round-off."""
_RESOLVED = 2e-10
"""Relative error above which the reference, good to 1e-12, tells a slope to 0.02."""


@lru_cache(maxsize=4)
def _exact(view: MethodView) -> MethodView:
    return replace(view, method=ReferenceFlow(rtol=1e-12))


def _order_gap(
    view: MethodView,
    x: FloatArray,
    xi: FloatArray,
    quantity: Callable[[Trajectory], FloatArray],
    size: Callable[[Trajectory], FloatArray],
) -> Gap:
    """How fast a quantity at the nodes (n, ...) converges to the true one, and the claim.

    size : of what is compared; its norm is the unit of errors.
    """
    coarsest = view.step * _stretch(view, x, xi)
    exact = kept_run(_exact(view), x, xi, _COARSEST, coarsest)
    truth, unit = quantity(exact), float(np.linalg.norm(size(exact))) or 1.0

    @lru_cache
    def error(level: int) -> float:
        fold = 2**level
        try:
            run = kept_run(view, x, xi, _COARSEST * fold, coarsest / fold)
        except StepFailure:
            if level > 1:
                raise
            return np.inf
        return float(np.linalg.norm(quantity(run)[::fold] - truth)) / unit

    first = _FIRST if view.order <= 2 else 1
    slope = _slope(error, view.order, first)
    return gap(min(slope, view.order), view.order, max(1.0, view.order / 2.0))


def _stretch(view: MethodView, x: FloatArray, xi: FloatArray) -> float:
    """The coarsest step in units of the view's; no arrow of it longer than the domain."""
    longest = _reach(view.system.space, x, view.step * xi)
    return max(1.0, min(_STRETCH[view.order], 0.9 / max(longest, 1e-3)))


def _slope(error: Callable[[int], float], claimed: int, first: int) -> float:
    """log2 of the quotient of errors one level apart, where the reference resolves them.

    The next power of h may cancel the leading one at some step size; halving goes on until the
    slope is as claimed, or is not. An error that is never resolved has all orders.
    """
    slope = float(claimed)
    for level in range(first, first + _LAST - _FIRST + 1):
        if error(level) <= _RESOLVED:
            break
        slope = float(np.log2(error(level - 1) / error(level)))
        if slope >= claimed - 0.1:
            return slope
    else:
        return slope
    for coarser in range(level - 1, 0, -1):
        if error(coarser) > _RESOLVED:
            return float(np.log2(error(coarser - 1) / error(coarser)))
    return slope


@_law("error(h) = O(h^order): log2 error(h) / error(h/2) >= order",
      "short runs against the equations of motion", "Theorem 5.2 and [24]; equations (2)",
      tolerance=0.2, share=0.15,
      reason="the next power of h still shows at the step sizes tried; in units of order / 2")
def order_is_as_claimed(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Places and velocities converge to the true motion as fast as claimed."""

    def state(run: Trajectory) -> FloatArray:
        return np.concatenate([run.base, run.velocities], axis=1)

    return _order_gap(view, x, xi, state, state)


def _needs_impulses(view: MethodView) -> str | None:
    if not view.two_step:
        return "claimed for (49); in stages the multipliers of the equations of motion are shown"
    return None if view.system.constraint_count else "there are no constraints"


@_law("error(h) = O(h^order) for mu^T lambda, lambda = impulse / h", "short two-step runs",
      "equation (9a), proof of Theorem 5.2", tolerance=0.2, share=0.15,
      reason="the next power of h still shows at the step sizes tried", applies=_needs_impulses)
def impulses_become_constraint_forces(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The impulses of the impacts become the forces of the constraints."""

    def force(run: Trajectory) -> FloatArray:
        rows = view.system.evaluate("constraints", run.base)
        return np.asarray(np.einsum("ka,kar->kr", run.multipliers, rows))

    def change(run: Trajectory) -> FloatArray:
        return np.append(force(run), run.momenta / (run.times[-1] - run.times[0]))

    return _order_gap(view, x, xi, force, change)


# Bookkeeping: the same numbers, whatever is saved.


_bits = partial(_law, tolerance=1e-300, reason="the same operations give the same bits")
_FEW_STEPS = 7


@_bits("two equal calls give equal nodes, and leave start and parameters alone", "runs",
       "a run is a function of what it is given")
def equal_calls_give_equal_bits(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Nothing of a run is left over for the next one."""
    begin = start(view.system, x, xi)

    def given() -> FloatArray:
        parts = (begin.base, begin.velocity, begin.momentum, view.system.parameter_vector)
        return np.concatenate(parts)

    before = given()
    once, again = (_bits_of(view.run(begin, _FEW_STEPS)) for _ in range(2))
    return gap(np.append(again, given()), np.append(once, before), 1.0)


def _bits_of(run: Trajectory) -> FloatArray:
    """All that is stored of the nodes; the arrow that led to the first one is not a number."""
    return np.nan_to_num(run.rows, nan=0.0)


@_bits("nodes of a run with save_every = 3 are every third node, and the last one", "runs",
       "conventions: save_every keeps every n-th node")
def saving_less_changes_nothing(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """What is not saved is still done."""
    full = kept_run(view, x, xi, _FEW_STEPS)
    thin = view.run(start(view.system, x, xi), _FEW_STEPS, save_every=3)
    chosen = [0, 3, 6, _FEW_STEPS]
    # the last node is saved without the arrow that led there
    left, right = _bits_of(thin), _bits_of(full)[chosen]
    left[-1, full.layout.size : -1] = right[-1, full.layout.size : -1]
    return gap(
        np.column_stack([thin.node_steps, left]), np.column_stack([chosen, right]), 1.0
    )


@_bits("advance(2) advance(5) = advance(7)", "the runner of a method",
       "runs are done in chunks, and interrupted ones can go on")
def pieces_make_the_run(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A run may be cut anywhere."""
    run = kept_run(view, x, xi, _FEW_STEPS)
    runner, parameters = _ready(view, view.system, x, run.active_rows)
    here, rows = runner.begin(parameters, run.rows[0, : run.layout.size]), []
    stages = runner.program.stages
    for count in (2 * stages + stages // 2, _FEW_STEPS * stages - 2 * stages - stages // 2):
        here, piece, _ = runner.advance(parameters, here, count, stages)
        rows.append(piece)
    return gap(np.concatenate(rows), run.rows[1:], 1.0)


def _pose_at(space: LieGroupoid, x: FloatArray) -> Any:
    """What an arrow that ends at x and is no identity shows."""
    away = 0.3 * np.sin(1.0 + 2.4 * np.arange(space.rank))
    return space.pose(np.asarray(space.inverse(space.retract(x, away)), dtype=float))


@_bits("integrate(..., reconstruct=W_0) has the nodes of integrate(...)", "runs", "Remark 7.2")
def reconstruction_changes_nothing(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Poses ride along."""
    pose = _pose_at(view.system.space, x)
    bare = kept_run(view, x, xi, _FEW_STEPS)
    carrying = view.run(start(view.system, x, xi), _FEW_STEPS, reconstruct=pose)
    left, right = (
        np.concatenate([run.base, run.momenta_before, run.momenta_after], axis=1)
        for run in (carrying, bare)
    )
    return gap(left, right, 1.0)


@_law("W_k+1 = W_k g_k, in the loop and afterwards", "runs, a pose W_0 that is not the identity; "
      "where arrows are not stored, against those of W_0 = epsilon",
      "Remark 7.2", tolerance=1e-12, reason="round-off of a few products")
def reconstruction_multiplies_the_arrows(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """Poses are the products of the arrows, in their order."""
    space, pose = view.system.space, _pose_at(view.system.space, x)
    plain = kept_run(view, x, xi, _FEW_STEPS, reconstruct=not view.shows_arrows)
    carrying = view.run(start(view.system, x, xi), _FEW_STEPS, reconstruct=pose)
    whole = np.asarray(space.arrow_to(x, pose), dtype=float)
    products = [whole]
    for arrow in arrows_of(view, plain):
        products.append(np.asarray(space.multiply(products[-1], arrow), dtype=float))
    expected = np.array([space.pose(product) for product in products], dtype=float)
    left = [carrying.reconstruct()]
    if view.shows_arrows:
        left.append(plain.reconstruct(pose))
    return gap(left, [expected] * len(left))


METHOD_RUN_LAWS = (
    free_step_is_a_poisson_map, momentum_in_space_is_kept, adjoint_undoes_the_free_flight,
    momentum_of_a_symmetry_is_kept, energy_of_a_biinvariant_metric_is_kept,
    energy_of_a_quadratic_potential_is_kept, adjoint_undoes_the_arrow, run_backwards_returns,
    turned_round_motion_returns, order_is_as_claimed, impulses_become_constraint_forces,
    equal_calls_give_equal_bits, saving_less_changes_nothing, pieces_make_the_run,
    reconstruction_changes_nothing, reconstruction_multiplies_the_arrows,
)
