"""A Lie group as matrices, as the appendix of the paper sees it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, FloatArray
from groupoid_gni.expressions import record
from groupoid_gni.groupoids import LieGroup, VectorGroup


@dataclass(frozen=True, eq=False)
class GroupView:
    """What the laws of the appendix take.

    Vectors of R^n are shown as the matrices [[1, v], [0, 1]], so that no law is an exception.
    """

    group: LieGroup

    @property
    def has_matrices(self) -> bool:
        """Whether elements are matrices, or vectors that can be shown as such."""
        shape = self.group.element_shape
        return isinstance(self.group, VectorGroup) or (len(shape) == 2 and shape[0] == shape[1])

    @cached_property
    def one(self) -> FloatArray:
        """The unit matrix of the size of the elements."""
        n = self.group.element_shape[0]
        return np.eye(n + 1 if isinstance(self.group, VectorGroup) else n)

    @cached_property
    def basis(self) -> FloatArray:
        """The matrices E_a, shape (d, n, n)."""
        return np.stack([self.hat(unit) for unit in np.eye(self.group.dimension)])

    def hat(self, xi: FloatArray) -> FloatArray:
        """The matrix of an algebra vector."""
        return self._shown(self.group.hat(xi), 0.0)

    def hats(self, columns: FloatArray) -> FloatArray:
        """The matrices of the columns of a (d, k) matrix, shape (k, n, n)."""
        return np.stack([self.hat(column) for column in np.asarray(columns).T])

    def matrix(self, element: Array) -> FloatArray:
        """The matrix of an element."""
        return self._shown(element, 1.0)

    def tau(self, xi: FloatArray) -> FloatArray:
        """The matrix of tau(xi)."""
        return self.matrix(self.group.tau(xi))

    def tau_change(self, xi: FloatArray) -> FloatArray:
        """The derivative of tau along each E_a, recorded and exact: shape (d, n, n)."""
        changes = np.moveaxis(self._recorded_change(xi), -1, 0)
        return np.stack([self._shown(change, 0.0) for change in changes])

    @cached_property
    def _recorded_change(self) -> Callable[..., Any]:
        shape = self.group.element_shape
        inputs = {"xi": (self.group.dimension,)}
        return record(self.group.tau, inputs, shape, name="tau").derivative(0)

    def _shown(self, value: Any, corner: float) -> FloatArray:
        array = np.asarray(value, dtype=np.float64)
        if not isinstance(self.group, VectorGroup):
            return array
        shown = corner * self.one
        shown[:-1, -1] = array
        return shown
