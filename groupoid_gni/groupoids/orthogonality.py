"""How far a matrix is from a rotation, and the Newton step back.

Shared by SO(2), SO(3) and the rotation blocks of SE(2) and SE(3).
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import largest, transpose


def orthogonality_defect(matrix: Array) -> Array:
    """Give the largest of |R^T R - 1| (entrywise) and |det R - 1|, shape (...,).

    R^T R alone would accept reflections.
    """
    n = np.shape(matrix)[-1]
    gram = transpose(matrix) @ matrix - np.eye(n)
    sizes = [np.abs(gram[..., i, j]) for i in range(n) for j in range(i + 1)]
    return largest([*sizes, np.abs(_determinant(matrix) - 1)])


def orthogonality_step(matrix: Array) -> Array:
    """Give R - R (R^T R - 1) / 2: a defect d becomes 3 d^2 / 4."""
    gram = transpose(matrix) @ matrix - np.eye(np.shape(matrix)[-1])
    return matrix - matrix @ gram / 2


def _determinant(matrix: Array) -> Array:
    """Expand the determinant of a 2 x 2 or 3 x 3 matrix."""
    if np.shape(matrix)[-1] == 2:
        return matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    x, y, z = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    return (
        x[..., 0] * (y[..., 1] * z[..., 2] - y[..., 2] * z[..., 1])
        + x[..., 1] * (y[..., 2] * z[..., 0] - y[..., 0] * z[..., 2])
        + x[..., 2] * (y[..., 0] * z[..., 1] - y[..., 1] * z[..., 0])
    )
