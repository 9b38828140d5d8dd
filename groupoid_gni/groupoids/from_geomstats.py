"""Groups from the matrix Lie groups of geomstats.

Takes the object handed over, reads ``lie_algebra.basis``, ``identity``, ``belongs`` and
``compose``, imports nothing of geomstats; gives a MatrixGroup that computes on its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.matrix_group import MatrixGroup
from groupoid_gni.groupoids.quadratic_group import QuadraticGroup, invariant_form
from groupoid_gni.groupoids.retractions import Retraction

_READ = ("lie_algebra", "identity", "belongs", "compose")
_TOLERANCE = 1e-10


def group_from_geomstats(space: Any, side: Side, retraction: Retraction) -> MatrixGroup:
    """Give the group of ``space``; see ``LieGroup.from_geomstats``."""
    name = _checked_name(space)
    n = np.shape(space.identity)[0]
    basis = getattr(space.lie_algebra, "basis", None)
    if basis is None or np.ndim(basis) != 3:
        raise InputError(
            f"from_geomstats({name}): its lie_algebra has no basis of matrices. Hand the matrices "
            f"over yourself: MatrixGroup(basis), basis of shape (dimension, {n}, {n})."
        )
    group = MatrixGroup(basis, side=side, retraction=retraction)
    form = invariant_form(group.basis)
    if form is not None:
        group = QuadraticGroup(form, group.basis, side=side, retraction=retraction)
    _require_same_group(name, space, group)
    return group


def _checked_name(space: Any) -> str:
    """Refuse what is no group, and points that are no matrices; give a name for messages."""
    if isinstance(space, type):
        raise InputError(
            f"from_geomstats({space.__name__}): this is a class; pass an instance, such as "
            f"{space.__name__}(n=3)."
        )
    name = type(space).__name__
    missing = [attribute for attribute in _READ if getattr(space, attribute, None) is None]
    if missing:
        raise InputError(
            f"from_geomstats({name}): a geomstats matrix group is needed, this has no "
            f"{missing[0]}. Pass SpecialOrthogonal(n), SpecialEuclidean(n), GeneralLinear(n) ... "
            f"A manifold that is no group is a PairGroupoid of coordinates, or your own groupoid."
        )
    shape = np.shape(space.identity)
    if len(shape) != 2:
        raise InputError(
            f"from_geomstats({name}): its points have shape {shape}, they must be matrices. Build "
            f"the space with point_type='matrix'; where geomstats has none (Heisenberg), use "
            f"MatrixGroup(basis) with matrices of your own."
        )
    return name


def _require_same_group(name: str, space: Any, group: MatrixGroup) -> None:
    """Compare identity, elements and products at a few elements that are nothing special."""
    first, second = (group.tau(xi) for xi in _awkward_vectors(group.dimension))
    try:
        own = [np.asarray(value, dtype=float) for value in (
            space.identity, space.compose(first, second))]
        inside = [bool(np.all(space.belongs(element))) for element in (first, second)]
    except Exception as error:
        raise InputError(
            f"from_geomstats({name}): the space failed on NumPy arrays, {type(error).__name__}: "
            f"{error}. geomstats must run on its NumPy backend (GEOMSTATS_BACKEND=numpy)."
        ) from error
    for what, theirs, ours in (
        ("identity", own[0], group.identity_element),
        ("compose(g, h)", own[1], group.compose(first, second)),
    ):
        gap = np.abs(theirs - ours).max() if theirs.shape == ours.shape else np.inf
        if not gap <= _TOLERANCE:
            raise InputError(
                f"from_geomstats({name}): its {what} is not that of matrices, the gap is "
                f"{gap:.1e}. A group with another product needs a LieGroup of its own."
            )
    if not all(inside):
        raise InputError(
            f"from_geomstats({name}): the space says belongs(tau(xi)) is False for {group!r}: "
            f"lie_algebra.basis generates another group than the one it tests for, or the "
            f"retraction leaves it. MatrixGroup(basis) takes any basis."
        )


def _awkward_vectors(dimension: int) -> FloatArray:
    """Give two vectors (2, dimension) of no symmetry, entries up to 0.3."""
    return 0.3 * np.cos(1.7 * np.arange(2 * dimension).reshape(2, dimension) + 0.4)
