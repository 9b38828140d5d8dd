"""The energy that a method keeps in place of E, where one is known exactly.

For a constant mass, a quadratic potential and linear constraints, kick-drift-kick over the step h
keeps ``E - h^2/8 |dV|^2`` in G^-1, that is ``1/2 p M^-1 p + 1/2 q (K - h^2 K M^-1 K / 4) q``; the
reflection keeps its kinetic part, so the GNI of the mean L_d keeps it at p- and p+ for every
distribution. With a uniform force it holds as well. The projected step keeps the kinetic part too
(``|p0 + N0 nu|^2 = |p0|^2 + |nu|^2``), so what its half flight F_{h/2} keeps is kept: h^2/32 here.
With the midpoint L_d the flight keeps E itself.

For the flight of Euler B (drift, kick, drift around the impact) the invariant of the unprojected
step is ``E - h^2/8 v^T K v`` at its ends, and what projection adds to v spoils it, unless every
direction has the same frequency, ``K = w^2 M``; for Euler A (kick, drift, impact, drift, kick) even
the impact does. Then, and only then, these keep ``E - h^2/8 v^T K v`` and ``E - h^2/8 |dV|^2``.

On a groupoid that is not R^n x R^n this holds when the anchor is constant with straight targets,
``target(retract(x, xi)) = x + rho xi``; the metric is ad-invariant, so that transport along an
arrow keeps ``|p|``; and the force direction ``G^-1 rho^T dV`` commutes with everything. A product
of R^n with a group that carries a bi-invariant metric is of this kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.diagnostics.sections import Samples, nodes_of, samples_around
from groupoid_gni.discretization import (
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
    SystemExpressions,
    Variational,
)
from groupoid_gni.errors import InputError
from groupoid_gni.expressions import RecordedFunction
from groupoid_gni.integrators import GNI
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.trajectory import Trajectory

_TOLERANCE = 1e-10
_SAMPLES = 96


@dataclass(frozen=True)
class _Form:
    """``E - h^2/8 (by_force |dV|^2 + by_velocity v^T V'' v)``; ``isotropic``: needs K = w^2 M."""

    by_force: float = 0.0
    by_velocity: float = 0.0
    isotropic: bool = False


def _known_forms() -> dict[str, _Form]:
    """The forms by the name a run carries; compositions of other orders keep none of them."""
    return {
        str(Rattle()): _Form(by_force=1.0),
        str(Midpoint()): _Form(),
        str(GNI(flow=Variational(Rattle()))): _Form(by_force=0.25),
        str(GNI(flow=Variational(Midpoint()))): _Form(),
        str(GNI(flow=Variational(EulerB()))): _Form(by_velocity=1.0, isotropic=True),
        str(GNI(flow=Variational(EulerA()))): _Form(by_force=1.0, isotropic=True),
    }


@dataclass(frozen=True)
class Hypothesis:
    """A condition of the theorem and how far it is from holding (relative, zero when it holds)."""

    statement: str
    defect: float

    @property
    def holds(self) -> bool:
        """Whether the defect is below 1e-10."""
        return self.defect <= _TOLERANCE


@dataclass(frozen=True, eq=False)
class ModifiedEnergy:
    """What the method keeps exactly, at the nodes.

    values : (n,) at ``momenta_after``; the same at ``momenta_before`` up to round-off.
    formula : what was evaluated.
    hypotheses : what was checked for it.
    """

    values: FloatArray
    formula: str
    hypotheses: tuple[Hypothesis, ...]

    def __str__(self) -> str:
        scale = float(np.max(np.abs(self.values))) or 1.0
        change = float(np.max(np.abs(self.values - self.values[0]))) / scale
        return f"modified energy {self.formula}: largest relative change {change:.1e}"


def modified_energy(run: Trajectory) -> ModifiedEnergy:
    """The exact modified energy of a run, for the methods and problems that have one.

    Methods: ``Rattle()``, ``Midpoint()``, and ``GNI(order=2)`` with the flow of any of the four
    discrete Lagrangians. The hypotheses are measured at nodes of the run and around them.
    Raises InputError naming the method, or the hypothesis that fails and by how much.
    """
    form = _known_forms().get(run.method_name)
    if form is None:
        known = ", ".join(_known_forms())
        raise InputError(
            f"no exact modified energy is known for {run.method_name}; it is for {known}"
        )
    found = _hypotheses(run.system, nodes_of(run), form)
    for hypothesis in found:
        if not hypothesis.holds:
            raise InputError(
                f"{run.method_name} has no exact modified energy here: it needs "
                f"{hypothesis.statement}, which fails by {hypothesis.defect:.2g} (relative). "
                "Use gni.diagnostics.energy_drift(run) to see what the energy does"
            )
    h = run.step_size
    shares = np.array([form.by_force, form.by_velocity]) * h**2 / 8.0
    function = _energy_function(run.system)
    values = function(run.base, run.momenta_after, run.system.parameter_vector, shares)
    return ModifiedEnergy(np.asarray(values), _formula(form), found)


def _formula(form: _Form) -> str:
    if form.by_force:
        return f"E - h^2/{8 / form.by_force:g} |dV|^2"
    return "E - h^2/8 v^T V'' v" if form.by_velocity else "E"


def _energy_function(system: MechanicalSystem) -> RecordedFunction:
    """(x, p, parameters, shares) -> ``E - shares . (|dV|^2 in G^-1, v^T V'' v)``."""
    e = SystemExpressions(system, ())
    x, p = ca.SX.sym("x", e.base_size), ca.SX.sym("p", e.rank)
    theta, shares = ca.SX.sym("theta", e.parameter_size), ca.SX.sym("shares", 2)
    v, energy = e.velocity(x, p, theta), e.energy(x, p, theta)
    if e.base_size:
        potential, along = e.potential(x, theta), ca.mtimes(e.anchor(x), v)
        force = ca.mtimes(e.anchor(x).T, ca.gradient(potential, x))
        size = ca.dot(force, e.velocity(x, force, theta))
        energy -= shares[0] * size
        energy -= shares[1] * ca.dot(along, ca.mtimes(ca.hessian(potential, x)[0], along))
    value = ca.densify(ca.cse(energy))
    shapes = ((e.base_size,), (e.rank,), (e.parameter_size,), (2,))
    function = ca.Function("modified", [x, p, theta, shares], [value])
    return RecordedFunction("modified energy", function, shapes, ())


def _hypotheses(
    system: MechanicalSystem, nodes: FloatArray, form: _Form
) -> tuple[Hypothesis, ...]:
    samples = samples_around(system, nodes, _SAMPLES)
    x = samples.base
    metric = system.evaluate("metric", x)
    found = [
        Hypothesis("a constant metric", _spread(metric)),
        Hypothesis("no gyroscopic term", float(np.any(system.evaluate("gyroscopic", x)))),
        Hypothesis("linear constraints, mu Y = 0", _affinity(system, x)),
    ]
    space = system.space
    bracket = np.asarray(space.bracket(x)).reshape(len(x), *(space.rank,) * 3)
    lowered = np.einsum("kdc,kcba->kdba", metric, bracket)
    found.append(
        Hypothesis(
            "an ad-invariant metric, G(v, [v, w]) = 0",
            _relative(lowered + np.swapaxes(lowered, 1, 2), lowered),
        )
    )
    if not system.has("potential") or not space.base_size:
        return tuple(found)
    potential = system.recorded("potential")
    slope = np.asarray(potential.derivative(0)(x, system.parameter_vector))
    second = np.asarray(potential.derivative(0).derivative(0)(x, system.parameter_vector))
    anchor = np.asarray(space.anchor(x))
    direction = np.linalg.solve(metric, np.einsum("kia,ki->ka", anchor, slope)[..., None])[..., 0]
    pairs = np.abs(bracket).max() * np.abs(direction)
    found += [
        Hypothesis("a quadratic potential", _spread(second)),
        Hypothesis("straight targets, x + rho xi", _bend(system, samples, anchor)),
        Hypothesis(
            "a force that commutes with the group",
            _relative(np.einsum("kcab,ka->kcb", bracket, direction), pairs),
        ),
    ]
    if form.isotropic:
        stiffness = np.einsum("kia,kij,kjb->kab", anchor, second, anchor)
        share = np.trace(np.linalg.solve(metric, stiffness), axis1=1, axis2=2) / space.rank
        rest = stiffness - share[:, None, None] * metric
        found.append(
            Hypothesis("one frequency for all directions, K = w^2 M", _relative(rest, stiffness))
        )
    return tuple(found)


def _relative(defect: FloatArray, size: FloatArray) -> float:
    largest = float(np.max(np.abs(size), initial=0.0))
    return float(np.max(np.abs(defect), initial=0.0)) / (largest or 1.0)


def _spread(values: FloatArray) -> float:
    return _relative(values - values[0], values)


def _affinity(system: MechanicalSystem, x: FloatArray) -> float:
    if not system.has("drift"):
        return 0.0
    still = np.zeros((len(x), system.space.rank))
    return _relative(system.constraint_residuals(x, still, relative=True), np.ones(1))


def _bend(system: MechanicalSystem, samples: Samples, anchor: FloatArray) -> float:
    """How far targets are from ``x + rho(x0) xi``, relative to the way."""
    way, space = np.einsum("ia,ka->ki", anchor[0], samples.velocities), system.space
    pairs = zip(samples.base, samples.velocities, strict=True)
    ends = np.array([space.target(space.retract(x, v / 8.0)) for x, v in pairs])
    return _relative(ends - samples.base - way / 8.0, way)
