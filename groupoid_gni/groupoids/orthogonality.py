"""How far a matrix is from a rotation, and the Newton step back.

Shared by SO(2), SO(3) and the rotation blocks of SE(2) and SE(3).
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import dot, largest, matrix_of, transpose


def orthogonality_defect(matrix: Array) -> Array:
    """Give the largest of |R^T R - 1| (entrywise) and |det R - 1|, shape (...,).

    R^T R alone would accept reflections.
    """
    n = np.shape(matrix)[-1]
    gram = transpose(matrix) @ matrix - np.eye(n)
    sizes = [np.abs(gram[..., i, j]) for i in range(n) for j in range(i + 1)]
    return largest([*sizes, np.abs(_determinant(matrix) - 1)])


def orthogonality_step(matrix: Array) -> Array:
    """Give R + R (1 - R^T R) / 2: a defect d becomes 3 d^2 / 4.

    Written out: a recording does not see that R^T R is symmetric.
    """
    n = np.shape(matrix)[-1]
    columns = [matrix[..., i] for i in range(n)]
    half = {
        (i, j): 0.5 * (i == j) - 0.5 * dot(columns[i], columns[j])
        for i in range(n)
        for j in range(i + 1)
    }
    rows = [[half[max(i, j), min(i, j)] for j in range(n)] for i in range(n)]
    return matrix + matrix @ matrix_of(*rows)


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
