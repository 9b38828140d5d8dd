"""Metrics of geomstats as the matrices of bundle metrics.

Takes a metric with ``inner_product``, gives its (d, d) matrix in the frame of a group. What a
metric computes with is believed only where it agrees with what it states.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import InputError, MetricMismatchError
from groupoid_gni.groupoids import LieGroup

_TOLERANCE = 1e-9


def bundle_metric(
    metric: Any, group: LieGroup, *, on_mismatch: Literal["raise", "computed"] = "raise"
) -> FloatArray:
    """Give the matrix G_ab = <E_a, E_b> of an invariant metric, for ``MechanicalSystem(metric=)``.

    G is found by calling ``inner_product`` on the basis of ``group`` at the identity. That it is
    invariant, <g E_a, g E_b>_g = G_ab on a left group and <E_a g, E_b g>_g = G_ab on a right one,
    is checked at elements that are nothing special. Where the metric states a matrix
    (``metric_mat_at_identity``) the two must agree: geomstats 2.8 ignores a matrix that is not
    diagonal, and counts each rotation twice.

    Parameters
    ----------
    metric : geomstats metric of a matrix group
        Such as ``InvariantMetric(space, matrix)`` or ``space.metric``.
    group : LieGroup of matrices
        The group of the metric, or a subgroup, in any basis.
    on_mismatch : {"raise", "computed"}
        "computed": take the inner products, whatever the metric states.

    Returns
    -------
    ndarray, shape (d, d)
        Symmetric; that it is positive definite is checked by ``MechanicalSystem``.

    Raises
    ------
    MetricMismatchError
        When stated and computed matrices differ; it carries both.
    InputError
        When the metric is of another space, or not invariant on the side of the group.
    """
    _check_arguments(metric, group, on_mismatch)
    one = np.asarray(group.identity_element)
    computed = _inner_products(metric, group.basis, one)
    _require_symmetric(metric, computed)
    _require_invariance(metric, group, computed)
    stated = _stated(metric, group)
    if stated is not None and on_mismatch == "raise" and _difference(stated, computed) > _TOLERANCE:
        raise MetricMismatchError(
            f"bundle_metric({type(metric).__name__}): in the basis of {group!r} the metric states\n"
            f"{_printed(stated)}\nbut its inner_product computes with\n{_printed(computed)}\n"
            f"geomstats 2.8 ignores a matrix that is not diagonal (its issue 1884) and multiplies "
            f"matrices entry by entry, which counts each rotation twice. Give MechanicalSystem the "
            f"matrix you mean, metric=np.array(...), or take what geomstats computes with: "
            f"bundle_metric(metric, group, on_mismatch='computed').",
            stated,
            computed,
        )
    return computed


def _check_arguments(metric: Any, group: LieGroup, on_mismatch: str) -> None:
    if on_mismatch not in ("raise", "computed"):
        raise InputError(
            f"bundle_metric(on_mismatch={on_mismatch!r}): it must be 'raise' or 'computed'."
        )
    if not isinstance(group, LieGroup) or len(group.element_shape) != 2:
        raise InputError(
            f"bundle_metric: group must be a Lie group of matrices, such as SO3() or "
            f"LieGroup.from_geomstats(space), not {group!r}."
        )
    if isinstance(metric, type) or not callable(getattr(metric, "inner_product", None)):
        raise InputError(
            f"bundle_metric: metric must be a geomstats metric object, with inner_product, not "
            f"{metric!r}. A space has one as space.metric."
        )
    shape = getattr(_space_of(metric), "shape", group.element_shape)
    if len(shape) != 2:
        raise InputError(
            f"bundle_metric({type(metric).__name__}): the points of its space have shape {shape}. "
            f"Build the space with point_type='matrix' (on vectors, geomstats 2.8 ignores the "
            f"matrix of an InvariantMetric altogether)."
        )
    if tuple(shape) != group.element_shape:
        raise InputError(
            f"bundle_metric({type(metric).__name__}): the points of its space have shape {shape}, "
            f"the elements of {group!r} {group.element_shape}."
        )


def _space_of(metric: Any) -> Any:
    """The space a metric was built on; geomstats 2.8 has no public name for it. None: unknown."""
    return getattr(metric, "_space", None)


def _inner_products(metric: Any, vectors: FloatArray, point: FloatArray) -> FloatArray:
    """Give the inner products of tangent vectors (d, n, n) at a point (n, n), shape (d, d)."""
    try:
        products = [[metric.inner_product(a, b, point) for b in vectors] for a in vectors]
        matrix = np.array(products, dtype=np.float64)
    except Exception as error:
        raise InputError(
            f"bundle_metric({type(metric).__name__}): inner_product failed on matrices of shape "
            f"{point.shape}: {type(error).__name__}: {error}."
        ) from error
    if matrix.shape != (len(vectors),) * 2 or not np.isfinite(matrix).all():
        raise InputError(
            f"bundle_metric({type(metric).__name__}): inner_product of two tangent vectors must be "
            f"a finite number; the {len(vectors)} x {len(vectors)} products gave\n{matrix}"
        )
    return matrix


def _require_symmetric(metric: Any, computed: FloatArray) -> None:
    if _difference(computed, computed.T) > _TOLERANCE:
        raise InputError(
            f"bundle_metric({type(metric).__name__}): its inner products are not symmetric:\n"
            f"{computed}"
        )


def _require_invariance(metric: Any, group: LieGroup, computed: FloatArray) -> None:
    changes = {"left": 0.0, "right": 0.0}
    for xi in 0.3 * np.cos(1.7 * np.arange(2 * group.dimension).reshape(2, -1) + 0.4):
        g = np.asarray(group.tau(xi))
        for side, moved in (("left", g @ group.basis), ("right", group.basis @ g)):
            change = _difference(_inner_products(metric, moved, g), computed)
            changes[side] = max(changes[side], change)
    if changes[group.side] <= _TOLERANCE:
        return
    other = "right" if group.side == "left" else "left"
    mend = (
        f"It is {other} invariant: build the group with side={other!r}."
        if changes[other] <= _TOLERANCE
        else "It is not right or left invariant, so in this frame it depends on the point. Write "
        "it as a function of the point, on a groupoid that has the points as its base."
    )
    raise InputError(
        f"bundle_metric({type(metric).__name__}): the metric is not {group.side} invariant, as "
        f"the velocities of {group!r} need: its inner products change by "
        f"{changes[group.side]:.1e} (relatively) from the identity to another element. {mend}"
    )


def _stated(metric: Any, group: LieGroup) -> FloatArray | None:
    """Give ``metric_mat_at_identity`` in the basis of the group; None where nothing is stated."""
    given = getattr(metric, "metric_mat_at_identity", None)
    if given is None:
        return None
    matrix = np.asarray(given, dtype=np.float64)
    algebra = getattr(_space_of(metric), "lie_algebra", None)
    basis = np.asarray(getattr(algebra, "basis", group.basis), dtype=np.float64)
    flat = basis.reshape(len(basis), -1)
    own = group.basis.reshape(group.dimension, -1)
    components, *_ = np.linalg.lstsq(flat.T, own.T, rcond=None)
    outside = np.linalg.norm(flat.T @ components - own.T, axis=0)
    if np.any(outside > _TOLERANCE * np.linalg.norm(own, axis=1)):
        raise InputError(
            f"bundle_metric({type(metric).__name__}): {group!r} is not a subgroup of the space of "
            f"the metric, its basis lies outside that of the lie_algebra."
        )
    if matrix.shape != (len(basis),) * 2:
        raise InputError(
            f"bundle_metric({type(metric).__name__}): metric_mat_at_identity has shape "
            f"{matrix.shape}, the lie_algebra has dimension {len(basis)}."
        )
    return np.asarray(components.T @ matrix @ components)


def _printed(matrix: FloatArray) -> str:
    """Round-off entries would make NumPy print all others with exponents."""
    return np.array2string(matrix, precision=6, suppress_small=True)


def _difference(first: FloatArray, second: FloatArray) -> float:
    """Give the largest difference of two metrics, relative to the sizes of the two directions.

    Relative to the largest entry, a wrong inertia would pass beside a large mass.
    """
    sizes = np.sqrt(np.maximum(np.abs(first), np.abs(second)).max(axis=0))
    scale = np.where(sizes > 0.0, sizes, 1.0)
    return float(np.abs((first - second) / (scale[:, None] * scale)).max())
