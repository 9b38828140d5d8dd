"""What SE(2) and SE(3) share: homogeneous matrices with a constant last row.

Products and inverses touch the rotation and the translation only; zeros are never multiplied.
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import apply, largest, matrix_of, transpose
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.orthogonality import orthogonality_defect, orthogonality_step


class RigidMotionGroup(LieGroup):
    """SE(n) as matrices [[R, t], [0, 1]]; components of the algebra: rotation, then translation."""

    def compose(self, first: Array, second: Array) -> Array:
        """Give [[R1 R2, R1 t2 + t1], [0, 1]]."""
        turn, shift = parts(first)
        then_turn, then_shift = parts(second)
        return homogeneous(turn @ then_turn, apply(turn, then_shift) + shift)

    def inverse_element(self, element: Array) -> Array:
        """Give [[R^T, -R^T t], [0, 1]]."""
        rotation, translation = parts(element)
        back = transpose(rotation)
        return homogeneous(back, -apply(back, translation))

    def element_defect(self, element: Array) -> Array:
        """Give the defect of the rotation block and of the constant last row."""
        n = np.shape(element)[-1] - 1
        row = [np.abs(element[..., n, j] - (1.0 if j == n else 0.0)) for j in range(n + 1)]
        return largest([orthogonality_defect(element[..., :n, :n]), *row])

    def restore_element(self, element: Array) -> Array:
        """Restore the rotation block and the last row."""
        rotation, translation = parts(element)
        return homogeneous(orthogonality_step(rotation), translation)


def parts(element: Array) -> tuple[Array, Array]:
    """Give the rotation (..., n, n) and the translation (..., n)."""
    return element[..., :-1, :-1], element[..., :-1, -1]


def homogeneous(rotation: Array, translation: Array) -> Array:
    """Give the matrix [[R, t], [0, 1]], shape (..., n+1, n+1)."""
    n = np.shape(rotation)[-1]
    rows = [
        [*(rotation[..., i, j] for j in range(n)), translation[..., i]] for i in range(n)
    ]
    return matrix_of(*rows, [*(0.0 for _ in range(n)), 1.0])
