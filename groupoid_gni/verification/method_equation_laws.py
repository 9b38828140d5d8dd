"""Discrete mechanics, part I: the equations (48), (49), (6), and what must make no difference.

The left side is what the library computes; the right side the definition, from L_d in plain NumPy,
or a run of another system that is the same mechanics (``method_variants``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np
from hypothesis import strategies as st

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.discretization import DiscreteLagrangian, FreeFlight, SystemExpressions
from groupoid_gni.expressions import record
from groupoid_gni.integrators import GNI, next_arrow
from groupoid_gni.trajectory import Trajectory
from groupoid_gni.verification import method_variants as variants
from groupoid_gni.verification.differences import central_difference
from groupoid_gni.verification.gaps import Gap, gap
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.method_run_laws import motions, needs_rows
from groupoid_gni.verification.method_variants import Variant
from groupoid_gni.verification.method_view import ArrowMethod, MethodView
from groupoid_gni.verification.strategies import algebroid_vectors
from groupoid_gni.verification.system_view import DenseNode, SystemView

_STEPS = 12
_FINE = 2.0**-10  # of differences: truncation is round-off where L_d varies over lengths of 0.1

Transform = Callable[[FloatArray, FloatArray, float], FloatArray]


# What is made from a view, once.


class _Workshop:
    """The plain twin of the system, its variants, and the runs of the last start."""

    def __init__(self, view: MethodView) -> None:
        self.view = view
        self.plain = SystemView(view.system)
        self._definitions: dict[DiscreteLagrangian, tuple[Transform, Transform]] = {}
        self._runs: dict[str, Trajectory] = {}
        self._start = b""

    @cached_property
    def legendre(self) -> ca.Function:
        """(x, xi, h, theta) -> (FL-, FL+) as the library writes them."""
        e = SystemExpressions(self.view.system, ())
        x, xi, h = ca.SX.sym("x", e.base_size), ca.SX.sym("xi", e.rank), ca.SX.sym("h")
        theta = ca.SX.sym("theta", e.parameter_size)
        flight = FreeFlight(e, self.view.rule)
        both = [flight.legendre_minus(x, xi, h, theta), flight.legendre_plus(x, xi, h, theta)]
        return ca.Function("legendre", [x, xi, h, theta], [ca.densify(side) for side in both])

    def definition(self, rule: DiscreteLagrangian) -> tuple[Transform, Transform]:
        """FL- and FL+ of (48) at the arrow ``retract(x, h xi)``, as functions of (x, xi, h).

        With the impulses of the external force: ``FL- - f-`` and ``FL+ + f+``.
        """
        if rule not in self._definitions:
            self._definitions[rule] = _recorded_definition(self, rule)
        return self._definitions[rule]

    def push(self, x: FloatArray, xi: FloatArray, step: float) -> FloatArray:
        """The impulse ``step * f(x, xi)`` of the external force; zero without one."""
        system = self.view.system
        if not system.has("force"):
            return np.zeros(system.space.rank)
        force = system.recorded("force")(x, xi, system.parameter_vector, np.zeros(0))
        return step * np.asarray(force, dtype=float)

    def impulses(
        self, rule: DiscreteLagrangian, x: FloatArray, xi: FloatArray, step: float
    ) -> tuple[FloatArray, FloatArray]:
        """What the external force gives at the source and at the target of an arrow."""
        space = self.view.system.space
        end = np.asarray(space.target(space.retract(x, step * xi)), dtype=float)
        first, second = rule.force_weights
        return first * self.push(x, xi, step), second * self.push(end, xi, step)

    free = cached_property(lambda self: variants.without_constraints(self.view.system))
    recombined = cached_property(lambda self: variants.recombined(self.view.system))
    reframed = cached_property(lambda self: variants.reframed(self.view.system))
    opposite = cached_property(lambda self: variants.opposite(self.view.system))
    unreduced = cached_property(lambda self: variants.unreduced(self.view.system))
    regauged = cached_property(lambda self: variants.regauged(self.view.system))

    def run(self, x: FloatArray, xi: FloatArray, compile: bool = False) -> Trajectory:
        """The run from a start, made once however many laws look at it."""
        # poses are accumulated in the loop where arrows are not stored
        options: dict[str, Any] = {
            "compile": compile, "reconstruct": None if self.view.shows_arrows else True
        }
        return self._kept(x, xi, f"itself, {compile}", lambda: self.view.run(
            variants.start(self.view.system, x, xi), _STEPS, **options
        ))

    def run_of(self, name: str, x: FloatArray, xi: FloatArray) -> tuple[Variant, Trajectory]:
        """A variant and its run from the start that belongs to (x, xi)."""
        variant: Variant = getattr(self, name)
        return variant, self._kept(x, xi, name, lambda: self.view.run(
            variant.state(x, xi), _STEPS, system=variant.system
        ))

    def _kept(
        self, x: FloatArray, xi: FloatArray, name: str, make: Callable[[], Trajectory]
    ) -> Trajectory:
        start = x.tobytes() + xi.tobytes()
        if start != self._start:
            self._start, self._runs = start, {}
        if name not in self._runs:
            self._runs[name] = make()
        return self._runs[name]


@lru_cache(maxsize=2)
def _workshop(view: MethodView) -> _Workshop:
    return _Workshop(view)


# The definition (48).


def _moved_actions(
    plain: SystemView, rule: DiscreteLagrangian
) -> tuple[Callable[..., Array], Callable[..., Array]]:
    """L_d(retract(alpha(g), e)^-1 g) and L_d(g retract(beta(g), e)), g = retract(x, h xi)."""
    space = plain.system.space

    def action(g: Array, step: Array) -> Array:
        ends, xi = (space.source(g), space.target(g)), space.lift(g) / step
        return step * rule.average(plain.plain_lagrangian, space, *ends, xi, step)

    def shorter(x: Array, xi: Array, step: Array, e: Array) -> Array:
        g = space.retract(x, step * xi)
        moved = space.multiply(space.inverse(space.retract(space.source(g), e)), g)
        return action(moved, step)

    def longer(x: Array, xi: Array, step: Array, e: Array) -> Array:
        g = space.retract(x, step * xi)
        moved = space.multiply(g, space.retract(space.target(g), e))
        return action(moved, step)

    return shorter, longer


def _recorded_definition(
    shop: _Workshop, rule: DiscreteLagrangian
) -> tuple[Transform, Transform]:
    plain, space = shop.plain, shop.plain.system.space
    still = np.zeros(space.rank)
    inputs = {"x": (space.base_size,), "xi": (space.rank,), "step": (), "e": (space.rank,)}
    slopes = [
        record(moved, inputs, (), name="L_d").derivative(3)
        for moved in _moved_actions(plain, rule)
    ]

    def minus(x: FloatArray, xi: FloatArray, step: float) -> FloatArray:
        slope = np.asarray(slopes[0](x, xi, np.asarray(step), still), dtype=float)
        return np.asarray(-slope - shop.impulses(rule, x, xi, step)[0])

    def plus(x: FloatArray, xi: FloatArray, step: float) -> FloatArray:
        slope = np.asarray(slopes[1](x, xi, np.asarray(step), still), dtype=float)
        return np.asarray(slope + shop.impulses(rule, x, xi, step)[1])

    return minus, plus


def _momentum_gap(
    plain: SystemView, x: FloatArray, left: ArrayLike, right: ArrayLike
) -> Gap:
    """The gap in units of the momenta, and of those of unit velocities at least."""
    sizes = [float(np.max(np.abs(side), initial=0.0)) for side in (left, right)]
    return gap(left, right, max(*sizes, float(np.max(np.abs(plain.node(x).metric)))))


def _arrow_gap(view: MethodView, x: FloatArray, left: ArrayLike, right: ArrayLike) -> Gap:
    """The gap of momenta of which one side is made from arrows, by definition."""
    made = _momentum_gap(_workshop(view).plain, x, left, right)
    # the ends of a short arrow tell its velocity up to round-off / h
    return gap(left, right, made.scale * max(1.0, 0.01 / view.step))


def _side_by_side(*gaps: Gap) -> Gap:
    """Several gaps as one, each in its own units."""
    return gap(
        np.concatenate([np.ravel(g.left) / g.scale for g in gaps]),
        np.concatenate([np.ravel(g.right) / g.scale for g in gaps]),
        1.0,
    )


@st.composite
def _velocities(draw: Callable[[Any], Any], view: MethodView) -> dict[str, FloatArray]:
    space = view.system.space
    sample: dict[str, FloatArray] = draw(motions(view))
    off = 0.4 * np.cos(1.0 + np.arange(space.rank))  # never on the constraint by chance
    xi = sample["xi"] + off + draw(algebroid_vectors(space, sample["x"], largest_reach=0.5))
    return {"x": sample["x"], "xi": xi * _shortening(view, sample["x"], view.step * xi)}


def _shortening(view: MethodView, x: FloatArray, xi: FloatArray) -> float:
    """What makes an arrow short enough for everything to be smooth around it."""
    return min(1.0, 0.5 / max(float(np.asarray(view.system.space.reach(x, xi))), 1e-3))


def velocities(view: MethodView) -> st.SearchStrategy[dict[str, FloatArray]]:
    """Samples {x, xi}: a velocity in A_x G, off the constraint, not small."""
    return _velocities(view)


_on_arrows = partial(law, "method", draw=velocities, share=0.2)
_on_runs = partial(law, "method", draw=motions, share=0.2)
_by_differences = partial(
    _on_arrows, tolerance=1e-10,
    reason="differences lose three digits, more where L_d is large or varies over short lengths",
)


# What methods show.


def _needs_arrows(view: MethodView) -> str | None:
    return None if view.two_step else "only discrete Lagrangians go by (49) from arrow to arrow"


def _needs_rule(view: MethodView) -> str | None:
    return None if view.variational else "its flights are not those of a discrete Lagrangian"


def _needs_shown_flights(view: MethodView) -> str | None:
    if len(view.fractions) > 1:
        return "the arrows of a composition are not stored"
    return _needs_rule(view)


def _free_flights_are_shown(view: MethodView) -> str | None:
    return _needs_shown_flights(replace(view, system=_workshop(view).free))


def _needs_arrow_momenta(view: MethodView) -> str | None:
    if isinstance(view.method, ArrowMethod):
        return None
    return "momentum is the same before and after a node: impacts lie between them"


def _arrow_momenta_and_rows(view: MethodView) -> str | None:
    return _needs_arrow_momenta(view) or needs_rows(view)


def _needs_stored_arrows(view: MethodView) -> str | None:
    return None if view.shows_arrows else "the arrows of its steps are not stored"


def _nodes_on_constraint(view: MethodView) -> str | None:
    if view.bare:
        return "a bare step leaves the constraint by the order of the method"
    return needs_rows(view)


def _legendre_gap(view: MethodView, x: FloatArray, xi: FloatArray, side: int) -> Gap:
    """FL- or FL+ of the library against differences of plain numbers, nothing recorded.

    At the step size of the view, and at one where no term is small.
    """
    shop, gaps = _workshop(view), []
    moved = _moved_actions(shop.plain, view.rule)[side]
    for step in (view.step, _shortening(view, x, xi)):
        library = np.array(
            shop.legendre(x, xi, step, view.system.parameter_vector)[side], dtype=float
        ).ravel()
        slope = central_difference(partial(moved, x, xi, step), np.zeros(len(xi)), step=_FINE)
        sign, push = (2 * side - 1), shop.impulses(view.rule, x, xi, step)[side]
        gaps.append(_momentum_gap(shop.plain, x, library, sign * (slope + push)))
    return _side_by_side(*gaps)


@_by_differences("h rho^T dl/dx1 + B+^T dl/dxi = d/de L_d(g retract(beta(g), e))",
                 "g = retract(x, h xi), L_d = h l(x0, x1, xi)", "equation (48), FL+",
                 applies=_needs_rule)
def legendre_plus_by_definition(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The trivialised FL+ is the derivative of L_d along left translations."""
    return _legendre_gap(view, x, xi, 1)


@_by_differences("-(h rho^T dl/dx0 + B-^T dl/dxi) = -d/de L_d(retract(alpha(g), e)^-1 g)",
                 "g = retract(x, h xi), L_d = h l(x0, x1, xi)", "equation (48), FL-",
                 applies=_needs_rule)
def legendre_minus_by_definition(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The trivialised FL- is minus the derivative of L_d along right translations."""
    return _legendre_gap(view, x, xi, 0)


# Equation (49), for one arrow.


def _arrows_and_rows(view: MethodView) -> str | None:
    return _needs_arrows(view) or needs_rows(view)


def _projected_with_rows(view: MethodView) -> str | None:
    if not isinstance(view.method, GNI):
        return "the step is not projected"
    shown = needs_rows(view) or _needs_shown_flights(view)
    return shown or (None if view.projected else "the step is not projected")


def _meeting_momenta(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """q, alpha(h), FL-(h), FL+(g) for an arrow g and the next one."""
    space, step = view.system.space, view.step
    minus, plus = _workshop(view).definition(view.rule)
    g = np.asarray(space.retract(x, step * xi), dtype=float)
    with variants.dependent_rows_are_fine():
        h = next_arrow(view.system, view.rule, g, step=step)
    q, source = (np.asarray(end, dtype=float) for end in (space.target(g), space.source(h)))
    after = minus(source, np.asarray(space.lift(h), dtype=float) / step, step)
    return q, source, after, plus(x, xi, step)


_solved = partial(
    _on_arrows, tolerance=1e-12, reason="the next arrow is solved for to round-off"
)


@_solved("P* (FL-(h) - FL+(g)) = 0, alpha(h) = beta(g)", "h = next_arrow(g), two-step methods",
         "equation (49a); (6) without constraints", applies=_needs_arrows)
def tangential_equation(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Along D momentum goes through the node unchanged."""
    plain = _workshop(view).plain
    q, source, after, before = _meeting_momenta(view, x, xi)
    along = plain.node(q).along
    return _side_by_side(_arrow_gap(view, q, along @ after, along @ before), gap(source, q))


@_solved("Q* (FL-(h) + FL+(g)) = 2 Q* Pi", "h = next_arrow(g), two-step methods",
         "equations (49b) and (38b), the sign of its affine term mended", applies=_arrows_and_rows)
def normal_equation(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Across D the mean of the two momenta satisfies the constraint."""
    plain = _workshop(view).plain
    q, _, after, before = _meeting_momenta(view, x, xi)
    node = plain.node(q)
    left, right = node.across @ (after + before), 2.0 * node.across @ node.offset
    return _arrow_gap(view, q, left, right)


# The same equations along runs.


@dataclass(frozen=True, eq=False)
class _Flight:
    """A free flight of a run: FL- at its source, where it ends, FL+ there."""

    target: FloatArray
    minus: FloatArray
    plus: FloatArray


_FEW_STEPS = 4


def _flights(view: MethodView, run: Trajectory) -> Iterator[_Flight]:
    """The flights of the first steps, one after the other."""
    space, r = run.system.space, run.system.space.rank
    rules = [view.rule] if run.flights == 1 else [view.rule, view.rule.adjoint()]
    h = view.step / run.flights
    for k in range(_FEW_STEPS):
        x, velocities = run.base[k], run.rows[k + 1, run.layout.size : -1].reshape(-1, r)
        for rule, xi in zip(rules, velocities, strict=True):
            end = np.asarray(space.target(space.retract(x, h * xi)), dtype=float)
            minus, plus = _workshop(view).definition(rule)
            yield _Flight(end, minus(x, xi, h), plus(x, xi, h))
            x = end


_along_runs = partial(_on_runs, tolerance=1e-12, reason="steps are solved to round-off")


@_along_runs("p_0 = FL-(g_0), FL+(g_k) = FL-(g_k+1)",
             "the free flights of runs without constraints", "equation (6); section 8.2",
             applies=_free_flights_are_shown)
def discrete_euler_lagrange(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Without constraints momenta match at every point between two flights."""
    shop = _workshop(view)
    start = variants.start(shop.free, x, xi)
    run = view.run(start, _FEW_STEPS, system=shop.free)
    flights = list(_flights(view, run))
    left = [*(flight.minus for flight in flights), run.momenta_before[-1]]
    right = [start.momentum, *(flight.plus for flight in flights)]
    return _arrow_gap(view, x, left, right)


@_along_runs("p+_k+1 = FL+(g_k), p-_k = FL-(g_k)", "runs from arrow to arrow",
             "section 4, pre- and post-momenta; section 8.2", applies=_needs_arrow_momenta)
def momenta_belong_to_their_nodes(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Before a node comes the flight that arrives there, after it the one that leaves."""
    shop = _workshop(view)
    run = shop.run(x, xi)
    left, right = [], []
    for k, flight in enumerate(_flights(view, run)):
        left += [run.momenta_after[k], run.momenta_before[k + 1]]
        right += [flight.minus, flight.plus]
    return _arrow_gap(view, x, left, right)


@_along_runs("FL-(g_b) = (P* - Q*) FL+(g_a) + 2 Q* Pi",
             "the two flights g_a, g_b of every projected step", "equations (49), (38)",
             applies=_projected_with_rows)
def impact_in_the_middle(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A projected step is reflected between its two flights."""
    shop = _workshop(view)
    flights = list(_flights(view, shop.run(x, xi)))
    left, right = [homeward.minus for homeward in flights[1::2]], []
    for outward in flights[::2]:
        node = shop.plain.node(outward.target)
        reflection = node.along - node.across
        right.append(reflection @ outward.plus + 2.0 * node.across @ node.offset)
    return _arrow_gap(view, x, left, right)


@_along_runs("p_k + N_k nu = FL-(g_a), p_k+1 + N_k+1 W nu = FL+(g_b)",
             "projected steps; N N^T = Q* G, W the isometry nearest to N_k+1^T S N_k, "
             "S the mean of the two G^-1", "design 2.2", applies=_projected_with_rows,
             tolerance=1e-8, reason="a step leaves out its last correction of nu, up to 1e-9")
def what_is_lent_is_taken_back(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The normal momentum put in before a projected step is the one taken out after it."""
    shop = _workshop(view)
    run = shop.run(x, xi)
    flights = list(_flights(view, run))
    left, right = [], []
    for k, (outward, homeward) in enumerate(zip(flights[::2], flights[1::2], strict=True)):
        here, there = (shop.plain.node(run.base[i]) for i in (k, k + 1))
        normal, next_normal = _normal_basis(here), _normal_basis(there)
        nu = normal.T @ here.inverse @ (outward.minus - run.momenta[k])
        u, _, v = np.linalg.svd(next_normal.T @ (here.inverse + there.inverse) / 2.0 @ normal)
        left += [run.momenta[k] + normal @ nu, run.momenta[k + 1] + next_normal @ (u @ v @ nu)]
        right += [outward.minus, homeward.plus]
    return _arrow_gap(view, x, left, right)


def _normal_basis(node: DenseNode) -> FloatArray:
    """N = mu^T L^-T with L L^T = mu G^-1 mu^T."""
    return np.asarray(np.linalg.solve(np.linalg.cholesky(node.gram), node.mu).T, dtype=float)


# What holds at the nodes.

def _momenta_at_nodes(run: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Two momenta whose mean is that of the node: [28] lifts the common part of both on D."""
    if "momentum" in run.layout.slices:
        return run.momenta, run.momenta
    return run.momenta_before, run.momenta_after


_ROUND_OFF = "round-off at one node"
_at_nodes = partial(_on_runs, tolerance=1e-12, reason=_ROUND_OFF)


@_at_nodes("mu (G^-1 ((p- + p+)/2 - A) - Y) = 0", "every node of runs",
           "equation (9b) and below; end of section 8.2", applies=_nodes_on_constraint)
def nodes_satisfy_the_constraints(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The mean momentum of every node lies on the constraint, linear or affine."""
    shop = _workshop(view)
    plain, run, defects = shop.plain, shop.run(x, xi), []
    for point, *momenta in zip(run.base, *_momenta_at_nodes(run), strict=True):
        node, mu = plain.node(point), plain.term("constraints", point)
        before, after = (plain.plain_velocity(point, p) for p in momenta)
        speed = node.speed(before, after, node.drift, node.inverse @ node.gyroscopic)
        defect = mu @ ((before + after) / 2.0 - node.drift)
        size = speed * np.sqrt(np.diag(mu @ node.inverse @ mu.T))
        defects.append(defect / np.where(size > 0.0, size, 1.0))
    return gap(defects, np.zeros_like(defects), 1.0)


@_at_nodes("P* (p-_k - p+_k) = 0", "every node of runs from arrow to arrow",
           "equation (49a): the nonholonomic momentum equation", applies=_needs_arrow_momenta)
def impulses_annihilate_d(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The constraints push along the rows of mu only."""
    shop = _workshop(view)
    run, left, right = shop.run(x, xi), [], []
    for point, before, after in zip(run.base, run.momenta_before, run.momenta_after, strict=True):
        along = shop.plain.node(point).along
        left.append(along @ after)
        right.append(along @ before)
    return _momentum_gap(shop.plain, x, left, right)


@_at_nodes("p-_k - p+_k = h mu^T lambda_k", "every node of runs from arrow to arrow",
           "equation (9a); conventions 6", applies=_arrow_momenta_and_rows)
def multipliers_are_impulses_per_time(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The reported multipliers are what the impacts did."""
    shop = _workshop(view)
    run = shop.run(x, xi)
    pushes = [
        view.step * shop.plain.term("constraints", point).T @ force
        for point, force in zip(run.base, run.multipliers, strict=True)
    ]
    jumps = run.momenta_after - run.momenta_before
    # in units of the momenta: the jumps are differences of them
    return gap(pushes, jumps, _momentum_gap(shop.plain, x, run.momenta_before, jumps).scale)


@_at_nodes("xi_k = G^-1 (p_k - A)", "every node of runs", "section 2, the Legendre transform")
def velocities_belong_to_momenta(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """The velocities of a run are those of its mean momenta."""
    shop = _workshop(view)
    run = shop.run(x, xi)
    before, after = _momenta_at_nodes(run)
    means = (before + after) / 2.0
    expected = [shop.plain.plain_velocity(*node) for node in zip(run.base, means, strict=True)]
    return gap(run.velocities, expected)


@_at_nodes("alpha(g_k) = x_k, beta(g_k) = x_k+1, t_k = k h", "runs that store their arrows",
           "Definition 8.1: consecutive arrows compose", applies=_needs_stored_arrows)
def arrows_join_the_nodes(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Arrows lead from node to node, one step each."""
    run, space = _workshop(view).run(x, xi), view.system.space
    ends = [[space.source(g), space.target(g)] for g in run.arrows]
    nodes = np.stack([run.base[:-1], run.base[1:]], axis=1)
    times = view.step * np.arange(_STEPS + 1.0)
    return _side_by_side(
        gap(np.reshape(ends, nodes.shape), nodes), gap(run.times, times, abs(times[-1]))
    )


# What must make no difference.

_TWO_RUNS = "round-off of two runs; h times the last correction of nu where steps are projected"
_no_difference = partial(_on_runs, tolerance=1e-10, reason=_TWO_RUNS)


def _needs_no_frame(view: MethodView) -> str | None:
    return "which terms are split depends on the frame" if view.splitting else None


def _same_motion(view: MethodView, name: str, x: FloatArray, xi: FloatArray) -> Gap:
    """Base points, velocities and momenta of a variant against those of the system."""
    shop = _workshop(view)
    variant, other = shop.run_of(name, x, xi)
    run = shop.run(x, xi)
    base, velocities, momenta = variant.original(other)
    return _side_by_side(
        gap(np.reshape(base, run.base.shape), run.base),
        gap(velocities, run.velocities),
        _momentum_gap(
            shop.plain, x, momenta, np.stack([run.momenta_before, run.momenta_after])
        ),
    )


@_no_difference("the run with rows A mu and w A mu is the run with rows mu",
                "invertible A; one dependent row w A mu", "D is the span, not the rows",
                applies=needs_rows)
def choice_of_rows_does_not_matter(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Only the subspace matters, not how rows span it, nor a row too many."""
    return _same_motion(view, "recombined", x, xi)


@_no_difference("xi = F xi', p' = F^T p, same base points",
                "the frame e'_a = F e_a of AG; rules that see the velocity through L only",
                "section 8: nothing depends on the basis of sections",
                applies=_needs_no_frame)
def frames_do_not_matter(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """In another constant frame the motion is the same."""
    return _same_motion(view, "reframed", x, xi)


@_no_difference("xi' = -xi, p' = -p, same base points",
                "the opposite groupoid with -Y, -A; on a group, the other side; rules as above",
                "inversion is an isomorphism G -> G^op; conventions 2")
def sides_do_not_matter(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """With the order of products turned round the motion is the same."""
    return _same_motion(view, "opposite", x, xi)


@_no_difference("xi' = xi, p' = p, beta(W_k) = x_k",
                "pairs of arrows (W, W') -> W^-1 W'; on a group, its framed pair groupoid",
                "section 7.2: reduction is a morphism of groupoids")
def unreduced_systems_move_alike(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Before the reduction by a symmetry the velocities are the same."""
    return _same_motion(view, "unreduced", x, xi)


@_no_difference("pose(W_k) of the unreduced run = reconstruct() of the reduced one",
                "W_0 = epsilon(x_0)", "Remark 7.2: W_k+1 = W_k g_k")
def reconstruction_is_the_unreduced_motion(
    view: MethodView, x: FloatArray, xi: FloatArray
) -> Gap:
    """The reduction can be taken back."""
    shop, space = _workshop(view), view.system.space
    _, other = shop.run_of("unreduced", x, xi)
    poses = [np.asarray(space.pose(w), dtype=float) for w in other.base]
    return gap(shop.run(x, xi).reconstruct(), poses)


def _needs_coordinates(view: MethodView) -> str | None:
    if view.splitting:
        return "Splitting() takes no gyroscopic term"
    if not np.any(variants.coordinate_velocities(view.system.space)):
        return "no velocity is a difference of coordinates; elsewhere only up to the order"
    return None


@_no_difference("x' = x, xi' = xi, p' = p + c", "L + <c, xi>, c constant along coordinates of Q",
                "a total derivative changes no motion; Pi = G Y + A",
                applies=_needs_coordinates)
def gauge_terms_do_not_matter(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """A constant closed one-form moves the momenta and nothing else."""
    return _same_motion(view, "regauged", x, xi)


@_no_difference("integrate(compile=True) = integrate(compile=False)", "runs",
                "two evaluators of the same expressions")
def machine_code_is_the_expressions(view: MethodView, x: FloatArray, xi: FloatArray) -> Gap:
    """Compiling changes round-off at most."""
    shop = _workshop(view)
    fast, slow = shop.run(x, xi, compile=True), shop.run(x, xi)
    moments = [np.stack([run.momenta_before, run.momenta_after]) for run in (fast, slow)]
    return _side_by_side(
        gap(fast.base, slow.base),
        gap(fast.reconstruct(), slow.reconstruct()),
        _momentum_gap(shop.plain, x, *moments),
    )


METHOD_EQUATION_LAWS = (
    legendre_plus_by_definition, legendre_minus_by_definition, tangential_equation,
    normal_equation, discrete_euler_lagrange, momenta_belong_to_their_nodes, impact_in_the_middle,
    what_is_lent_is_taken_back, nodes_satisfy_the_constraints, impulses_annihilate_d,
    multipliers_are_impulses_per_time, velocities_belong_to_momenta, arrows_join_the_nodes,
    choice_of_rows_does_not_matter, frames_do_not_matter, sides_do_not_matter,
    unreduced_systems_move_alike, reconstruction_is_the_unreduced_motion,
    gauge_terms_do_not_matter, machine_code_is_the_expressions,
)
