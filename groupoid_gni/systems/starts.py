"""From what a user passes to a consistent start, or to a message that says what is wrong."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.errors import DependentConstraintsWarning, InputError
from groupoid_gni.expressions import verify
from groupoid_gni.expressions.explanation import location
from groupoid_gni.systems.input_checks import finite_vector, place

if TYPE_CHECKING:
    from groupoid_gni.systems.mechanical_system import MechanicalSystem

_RANK_TOLERANCE = 1e-10
# the step gives up when a row is within 3e-7 of the span of the others
_NEARLY_DEPENDENT = 1e-5
_EPSILON = float(np.finfo(float).eps)
_CONSTRAINT_TOLERANCE = 1e-9
_GROUP_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class State:
    """A consistent start: base point, velocity in the frame of AG, momentum; read-only.

    active_rows : the constraint rows kept at this state (dependent ones are left out).
    checked_by : the system that it was checked by, and needs not be checked by again.
    """

    base: FloatArray
    velocity: FloatArray
    momentum: FloatArray
    active_rows: tuple[int, ...]
    checked_by: MechanicalSystem | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("base", "velocity", "momentum"):
            own = np.array(getattr(self, name))
            own.setflags(write=False)
            object.__setattr__(self, name, own)

    def __reduce__(self) -> Any:
        # a system cannot be pickled; in the other process the start is checked again
        return State, (self.base, self.velocity, self.momentum, self.active_rows)


@dataclass(frozen=True)
class IndependentRows:
    """Which constraint rows are independent at a point, and what is wrong with the others."""

    kept: tuple[int, ...]
    zero: tuple[int, ...]
    dependent: tuple[int, ...]
    nearly: tuple[int, ...]

    def warn(self, stacklevel: int) -> None:
        """Warn of rows that are left out, and of rows that soon may be."""
        parts = []
        if self.dependent:
            parts.append(f"row(s) {list(self.dependent)} depend on the rows {list(self.kept)}")
        if self.zero:
            parts.append(f"row(s) {list(self.zero)} are zero")
        if parts:
            text = (
                f"constraint {' and '.join(parts)} at the start: left out of the step; the motion "
                "is checked against them"
            )
            warnings.warn(text, DependentConstraintsWarning, stacklevel=stacklevel + 1)
        if self.nearly:
            text = (
                f"constraint row(s) {list(self.nearly)} nearly depend on the rows before them at "
                "the start: digits are lost, and the run fails where they become dependent. Leave "
                "the redundant row out, or start away from that point"
            )
            warnings.warn(text, DependentConstraintsWarning, stacklevel=stacklevel + 1)


def checked_state(
    system: MechanicalSystem,
    base: ArrayLike | None,
    velocity: ArrayLike | None,
    project: bool,
    verified: bool = False,
) -> tuple[State, IndependentRows]:
    """The start, and which constraint rows hold it; refuses with the violation and the mend.

    verified : the recordings have been compared with plain calls there before.
    """
    x = _checked_base(system, base, velocity, project)
    v = finite_vector("velocity", velocity, system.space.rank)
    # what is not finite is refused by name below, whatever NumPy was told to do about it
    with np.errstate(all="ignore"):
        if not verified:
            _verify_recordings(system, x)
        metric = checked_metric(system, x)
        _check_finite_terms(system, x)
        rows = independent_rows(system, x, metric)
        v = _on_constraints(system, x, v, metric, rows.kept, project)
        momentum = metric @ v + system.evaluate("gyroscopic", x)
    if not np.all(np.isfinite(momentum)):
        raise InputError(f"the momentum G xi + A overflows {place(x)}: {momentum}")
    return State(x, v, momentum, rows.kept, system), rows


def _checked_base(
    system: MechanicalSystem, base: ArrayLike | None, velocity: ArrayLike | None, project: bool
) -> FloatArray:
    size = system.space.base_size
    if size == 0 and velocity is None and base is not None:
        raise InputError(
            f"velocity is missing: the base of {type(system.space).__name__} is a point, so "
            "call state(velocity=...)"
        )
    if base is None:
        if size:
            raise InputError(
                f"base is missing: a base point of {type(system.space).__name__} has {size} "
                f"components, for example {np.asarray(system.space.example_base_point)}"
            )
        return np.zeros(0)
    x = finite_vector("base", base, size)
    defect = float(np.max(system.space.base_defect(x), initial=0.0)) if size else 0.0
    if project:
        for _ in range(50):
            if not _GROUP_TOLERANCE / 1e4 < defect < 1.0:
                break
            x = np.asarray(system.space.restore_base(x))
            defect = float(np.max(system.space.base_defect(x)))
    if defect > _GROUP_TOLERANCE:
        raise InputError(
            f"base lies off the base manifold of {type(system.space).__name__} by {defect:.3g} "
            f"(allowed {_GROUP_TOLERANCE:.0e}), for example because a rotation block is not "
            "orthogonal, or has determinant -1. Mend the point, or pass project_start=True if it "
            "is only slightly off; a groupoid of your own brings points back by restore_base"
        )
    return x


def _verify_recordings(system: MechanicalSystem, x: FloatArray) -> None:
    points = [x]
    rng = np.random.default_rng(20150225)
    for size in (0.01, 0.05):
        xi = size * rng.uniform(-1.0, 1.0, system.space.rank)
        points.append(np.asarray(system.space.target(system.space.retract(x, xi)), dtype=float))
    arguments = [(point, system.parameter_vector) for point in points]
    for name in system.plain:
        verify(system.recorded(name), system.with_flat_parameters(name), arguments)


def _check_finite_terms(system: MechanicalSystem, x: FloatArray) -> None:
    """The terms of the Lagrangian and of the constraints must be finite at the start."""
    for name in system.plain:
        value = system.evaluate(name, x)
        if not np.all(np.isfinite(value)):
            raise InputError(
                f"{name} ({location(system.plain[name])}) is not finite {place(x)}: {value}; "
                "start inside its domain"
            )
    if "potential" not in system.plain:
        return
    slope = np.asarray(system.recorded("potential").derivative(0)(x, system.parameter_vector))
    if not np.all(np.isfinite(slope)):
        raise InputError(
            f"potential ({location(system.plain['potential'])}) has no finite derivative "
            f"{place(x)}: {slope}; start elsewhere, or smooth it (a norm has none at zero)"
        )


def checked_metric(system: MechanicalSystem, x: FloatArray) -> FloatArray:
    """The metric at x, if it is finite, symmetric and positive definite."""
    metric = system.evaluate("metric", x)
    if not np.all(np.isfinite(metric)):
        raise InputError(f"metric is not finite {place(x)}:\n{metric}")
    asymmetry = float(np.max(np.abs(metric - metric.T)))
    if asymmetry > 1e-12 * float(np.max(np.abs(metric))):
        i, j = np.unravel_index(np.argmax(np.abs(metric - metric.T)), metric.shape)
        raise InputError(
            f"metric is not symmetric {place(x)}: entry [{i},{j}] is {metric[i, j]:.6g} but "
            f"[{j},{i}] is {metric[j, i]:.6g}; return (G + G.T) / 2 if that is what you mean"
        )
    scale = np.sqrt(np.abs(np.diag(metric)))
    scale[scale == 0.0] = 1.0
    smallest = float(np.min(np.linalg.eigvalsh(metric / np.outer(scale, scale))))
    if smallest <= len(scale) * _EPSILON:
        raise InputError(
            f"metric is not positive definite {place(x)}: its smallest eigenvalue is "
            f"{float(np.min(np.linalg.eigvalsh(metric))):.3g}; every direction needs inertia "
            "(leave a massless direction out of the model, or give it a small mass)"
        )
    return metric


def independent_rows(
    system: MechanicalSystem, x: FloatArray, metric: FloatArray
) -> IndependentRows:
    """Gram-Schmidt, twice, in the inverse metric."""
    mu = system.evaluate("constraints", x)
    if not np.all(np.isfinite(mu)):
        raise InputError(f"constraints are not finite {place(x)}: {mu}")
    orthonormal: list[FloatArray] = []
    kept, zero, dependent, nearly = [], [], [], []
    for a, row in enumerate(np.linalg.solve(np.linalg.cholesky(metric), mu.T).T):
        size = float(np.linalg.norm(row))
        if size == 0.0:
            zero.append(a)
            continue
        rest = row / size
        for q in orthonormal * 2:
            rest = rest - q * (q @ rest)
        left = float(np.linalg.norm(rest))
        if left <= _RANK_TOLERANCE:
            dependent.append(a)
            continue
        if left <= _NEARLY_DEPENDENT:
            nearly.append(a)
        kept.append(a)
        orthonormal.append(rest / left)
    return IndependentRows(tuple(kept), tuple(zero), tuple(dependent), tuple(nearly))


def _on_constraints(
    system: MechanicalSystem,
    x: FloatArray,
    v: FloatArray,
    metric: FloatArray,
    rows: tuple[int, ...],
    project: bool,
) -> FloatArray:
    """The velocity, moved onto the kept rows: round-off when accepted, any way on request."""
    mu = system.evaluate("constraints", x)
    drift = system.evaluate("drift", x)
    violation = mu @ (v - drift)
    speed = metric_norm(metric[None], v[None])
    size = largest_violations(mu[None], metric[None], speed, drift[None])[0] + 1e-300
    nearest = _nearest_velocity(v, metric, mu[list(rows)], violation[list(rows)])
    if not project and np.max(np.abs(violation) / size, initial=0.0) > _CONSTRAINT_TOLERANCE:
        raise InputError(
            f"the start violates the constraints {place(x)}: mu (xi - Y) = {violation}, row "
            f"by row. Give a velocity that satisfies them; the nearest one, which "
            f"project_start=True takes, is {nearest}"
        )
    return nearest


def solve_each(matrices: FloatArray, columns: FloatArray) -> FloatArray:
    """Solve (..., n, n) against (..., n, k); NaN where a matrix is exactly singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, columns))
    except np.linalg.LinAlgError:
        if matrices.ndim == 2:
            return np.full(columns.shape, np.nan)
        return np.stack([solve_each(a, b) for a, b in zip(matrices, columns, strict=True)])


def largest_violations(
    mu: FloatArray, metric: FloatArray, speeds: FloatArray, drift: FloatArray
) -> FloatArray:
    """``|mu^a| (speed + |Y|)`` in the norms of the metric, (n, m): no violation can be larger."""
    raised = solve_each(metric, np.swapaxes(mu, 1, 2))
    rows = np.sqrt(np.einsum("nar,nra->na", mu, raised))
    return np.asarray(rows * (speeds + metric_norm(metric, drift))[:, None])


def metric_norm(metric: FloatArray, vectors: FloatArray) -> FloatArray:
    """``|v|`` at many nodes, (n,)."""
    return np.sqrt(np.einsum("nr,nrs,ns->n", vectors, metric, vectors))


def _nearest_velocity(
    v: FloatArray, metric: FloatArray, mu: FloatArray, violation: FloatArray
) -> FloatArray:
    """The velocity nearest to v in the metric with ``mu (nearest - v) = -violation``."""
    if not len(mu):
        return v
    lower = np.linalg.cholesky(metric)
    change = np.linalg.lstsq(np.linalg.solve(lower, mu.T).T, violation, rcond=None)[0]
    return np.asarray(v - np.linalg.solve(lower.T, change))
