"""What a failed run says: where it stopped, and the numbers that tell why."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.systems.starts import solve_each


def constraint_rows_lost(
    system: MechanicalSystem, active_rows: tuple[int, ...], base: FloatArray, momenta: FloatArray
) -> FloatArray:
    """(n,) whether a row that was left out as dependent at the start is violated at a node."""
    dropped = sorted(set(range(system.constraint_count)) - set(active_rows))
    if not dropped:
        return np.zeros(len(momenta), dtype=bool)
    with np.errstate(all="ignore"):
        velocities = _on_rows(system, active_rows, base, system.velocities(base, momenta))
        residuals = system.constraint_residuals(base, velocities, relative=True)[:, dropped]
    return np.asarray(np.any(np.abs(residuals) > 1e-8, axis=1))


def _on_rows(
    system: MechanicalSystem, rows: tuple[int, ...], base: FloatArray, velocities: FloatArray
) -> FloatArray:
    """The nearest velocities that satisfy the rows kept: a bare step leaves them by its order."""
    if not rows:
        return velocities
    mu = system.evaluate("constraints", base)[:, list(rows)]
    normal = solve_each(system.evaluate("metric", base), np.swapaxes(mu, 1, 2))
    violation = np.einsum("nar,nr->na", mu, velocities - system.evaluate("drift", base))
    return np.asarray(velocities - (normal @ solve_each(mu @ normal, violation[..., None]))[..., 0])


def failure_detail(
    system: MechanicalSystem,
    active_rows: tuple[int, ...],
    scales: FloatArray,
    h: float,
    where: tuple[int, int],
    node: tuple[FloatArray, FloatArray],
) -> str:
    """Step, time, base point, velocity, condition of C, eigenvalue of the metric, size of the step.

    where : (steps done, steps asked for).  node : base point and momentum of the last good node.
    """
    done, count = where
    x, p = node
    text = f"Failed in step {done + 1} of {count}, after t = {done * h:.6g}"
    if x.size:
        text += f", at the base point {_short(x)}"
    with np.errstate(all="ignore"):
        velocity = system.velocities(x[None], p[None])[0]
        text += f", velocity {_short(velocity)}"
        ahead = np.asarray(system.space.target(system.space.retract(x, h * velocity)), dtype=float)
        eigenvalue = min(_smallest_eigenvalue(system, point) for point in (x, ahead))
        if system.space.base_size and not eigenvalue > 1e-10:
            text += f"; smallest eigenvalue of the metric there or one step ahead {eigenvalue:.3g}"
        if active_rows:
            here, later = (_condition(system, active_rows, scales, q) for q in (x, ahead))
            text += f"; condition number of C there {here:.3g}, one step ahead {later:.3g}"
        reach = float(np.max(np.asarray(system.space.reach(x, h * velocity))))
    if reach > 0.5:
        text += (
            f"; one step covers {reach:.2f} of the retraction's domain: use a step below "
            f"{abs(h) * 0.5 / reach:.2g}"
        )
    return text + "."


def _short(vector: FloatArray) -> str:
    return np.array2string(vector, precision=6, threshold=12, max_line_width=200)


def _smallest_eigenvalue(system: MechanicalSystem, x: FloatArray) -> float:
    metric = system.evaluate("metric", x)
    return float(np.linalg.eigvalsh(metric)[0]) if np.all(np.isfinite(metric)) else -np.inf


def _condition(
    system: MechanicalSystem, active_rows: tuple[int, ...], scales: FloatArray, x: FloatArray
) -> float:
    """Condition number of C in units of its diagonal at the start; a vanishing row counts."""
    metric, mu = system.evaluate("metric", x), system.evaluate("constraints", x)[list(active_rows)]
    if not (np.all(np.isfinite(metric)) and np.all(np.isfinite(mu))):
        return np.inf
    try:
        gram = mu @ np.linalg.solve(metric, mu.T)
    except np.linalg.LinAlgError:
        return np.inf
    values = np.linalg.svd(gram / np.sqrt(np.outer(scales, scales)), compute_uv=False)
    return float(max(values[0], 1.0) / max(values[-1], 1e-300))
