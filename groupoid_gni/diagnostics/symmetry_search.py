"""Moving energies and conserved momenta by linear algebra.

For sections ``X(x) = c + B x`` the conditions ``mu X = mu Y`` and ``X^c L = 0`` are linear in c and
B, since ``X^c L = X_a f_a + p_a B_ai (rho v)_i`` with f the unconstrained force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from groupoid_gni.array_types import ArrayLike, FloatArray
from groupoid_gni.diagnostics.moving_energy import SymmetryReport, symmetry_report
from groupoid_gni.diagnostics.sections import Samples, checked_points, samples_around
from groupoid_gni.discretization import SystemExpressions
from groupoid_gni.errors import InputError
from groupoid_gni.expressions import RecordedFunction
from groupoid_gni.systems import MechanicalSystem

_SINGULAR = 1e-9
_MOST_UNKNOWNS = 1500


@dataclass(frozen=True, eq=False)
class LinearSection:
    """The section ``x -> constant + slope x``; constant (rank,), slope (rank, base_size).

    Made for one set of parameter values; the parameters it is called with are not read.
    """

    constant: FloatArray
    slope: FloatArray

    def __call__(self, x: Any, p: Any) -> Any:
        """Its components at a base point, (rank,)."""
        return self.constant + self.slope @ x if self.slope.size else self.constant


@dataclass(frozen=True, eq=False)
class SymmetrySearch:
    """What a linear ansatz finds.

    moving : Y' with E - <p, Y'> conserved, of least coefficients; zero without drift; None when
        there is none in the ansatz.
    report : the conditions tried for ``moving`` at fresh points; None with it.
    residual : what least squares leaves of the conditions, relative to the drift.
    horizontal : sections X of D with X^c L = 0; each gives a conserved momentum <p, X>, and may be
        added to ``moving``.
    """

    moving: LinearSection | None
    report: SymmetryReport | None
    residual: float
    horizontal: tuple[LinearSection, ...]


def find_moving_energy(
    system: MechanicalSystem, points: ArrayLike | None = None
) -> SymmetrySearch:
    """Search symmetry generators with constant and linear components, at the current parameters.

    points : base points (k, base_size) around which to sample; the space's example when left out.
    What is found is tried again at fresh points; what is not found may still exist with components
    that are not linear in the coordinates of the base.
    Raises InputError when the ansatz has more than 1500 coefficients.
    """
    r, n = system.space.rank, system.space.base_size
    unknowns = r * (1 + n)
    if unknowns > _MOST_UNKNOWNS:
        raise InputError(
            f"a linear section has {unknowns} coefficients here, more than {_MOST_UNKNOWNS}"
        )
    centres = checked_points(system, points)
    samples = samples_around(system, centres, 2 * unknowns + 20)
    rows, wanted = _conditions(system, samples)
    _, singular, right = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.sum(singular > _SINGULAR * singular[0])) if len(singular) else 0
    solution = np.asarray(np.linalg.lstsq(rows, wanted, rcond=_SINGULAR)[0], dtype=np.float64)
    size = float(np.linalg.norm(wanted))
    residual = float(np.linalg.norm(rows @ solution - wanted)) / (size or 1.0)
    moving, report = _section(solution, r, n), None
    if residual < 1e-7:
        report = symmetry_report(system, moving, samples.base[-4:])
    found = report is not None and report.holds
    return SymmetrySearch(
        moving=moving if found else None,
        report=report if found else None,
        residual=residual,
        horizontal=_independent(system, samples, right[rank:].T),
    )


def _monomials(x: FloatArray) -> FloatArray:
    """(1, x) at every point, (k, 1 + n)."""
    return np.concatenate([np.ones((len(x), 1)), x], axis=1)


def _conditions(system: MechanicalSystem, samples: Samples) -> tuple[FloatArray, FloatArray]:
    """Rows and right-hand sides of ``mu X = mu Y`` and ``X^c L = 0`` for the coefficients (c, B).

    Coefficients are ordered component by component, the constant first.
    """
    x, v = samples.base, samples.velocities
    momenta, along, force = _field(system)(x, v, system.parameter_vector)
    monomials = _monomials(x)
    changes = np.concatenate([np.zeros((len(x), 1)), along], axis=1)
    lie = np.einsum("ka,ki->kai", force, monomials) + np.einsum("ka,ki->kai", momenta, changes)
    blocks, sides = [lie.reshape(len(x), -1)], [np.zeros(len(x))]
    if system.constraint_count:
        mu, drift = system.evaluate("constraints", x), system.evaluate("drift", x)
        inside = np.einsum("kma,ki->kmai", mu, monomials)
        blocks.append(inside.reshape(len(x) * system.constraint_count, -1))
        sides.append(np.einsum("kma,ka->km", mu, drift).ravel())
    sizes = [float(np.linalg.norm(block)) / np.sqrt(len(block)) or 1.0 for block in blocks]
    rows = np.concatenate([b / s for b, s in zip(blocks, sizes, strict=True)])
    return rows, np.concatenate([b / s for b, s in zip(sides, sizes, strict=True)])


def _field(system: MechanicalSystem) -> Any:
    """(x, v, parameters) -> (p, rho v, force) at many points."""
    e = SystemExpressions(system, ())
    x, v = ca.SX.sym("x", e.base_size), ca.SX.sym("v", e.rank)
    theta = ca.SX.sym("theta", e.parameter_size)
    p = e.momentum(x, v, theta)
    value = ca.densify(ca.cse(ca.vertcat(p, *e.unconstrained_field(x, p, theta))))
    shapes = ((e.base_size,), (e.rank,), (e.parameter_size,))
    size = 2 * e.rank + e.base_size
    function = RecordedFunction(
        "field", ca.Function("field", [x, v, theta], [value]), shapes, (size,)
    )

    def parts(*arguments: FloatArray) -> list[FloatArray]:
        return np.split(function(*arguments), [e.rank, e.rank + e.base_size], axis=1)

    return parts


def _section(coefficients: FloatArray, r: int, n: int) -> LinearSection:
    # what least squares leaves in place of a zero is round-off
    small = np.abs(coefficients) <= 1e-12 * np.max(np.abs(coefficients))
    table = np.where(small, 0.0, coefficients).reshape(r, 1 + n)
    return LinearSection(table[:, 0].copy(), table[:, 1:].copy())


def _independent(
    system: MechanicalSystem, samples: Samples, kernel: FloatArray
) -> tuple[LinearSection, ...]:
    """Sections of the kernel that differ on the base manifold: coordinates may be redundant."""
    r, n = system.space.rank, system.space.base_size
    if not kernel.shape[1]:
        return ()
    tables = kernel.T.reshape(-1, r, 1 + n)
    values = np.einsum("sai,ki->kas", tables, _monomials(samples.base)).reshape(-1, len(tables))
    _, sizes, mixes = np.linalg.svd(values, full_matrices=False)
    kept = mixes[sizes > 1e-8 * np.sqrt(len(values))]
    return tuple(_section(kernel @ mix, r, n) for mix in kept)
