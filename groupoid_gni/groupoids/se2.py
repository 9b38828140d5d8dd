"""SE(2), rigid motions of the plane, as 3 x 3 homogeneous matrices.

Algebra components (w, v1, v2): rotation first. J = [[0, -1], [1, 0]].
"""

from __future__ import annotations

from math import pi

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.expressions import (
    half_cotangent_defect_of_square,
    sinc_of_square,
    sine_defect_of_square,
    versine_of_square,
)
from groupoid_gni.groupoids.components import entries, matrix_of, vector_of
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction
from groupoid_gni.groupoids.rigid_motion import RigidMotionGroup
from groupoid_gni.groupoids.so2 import cayley_cos_sin


class SE2(RigidMotionGroup):
    """Rigid motions of the plane, [(w, v), (a, u)] = (0, w J u - a J v).

    Parameters
    ----------
    side : {"left", "right"}
        Body or space velocities.
    retraction : Retraction
    """

    def __init__(
        self,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> None:
        super().__init__(3, (3, 3), side=side, retraction=retraction)

    def hat(self, xi: Array) -> Array:
        """Give [[w J, v], [0, 0]]."""
        w, x, y = entries(xi)
        return matrix_of((0.0, -w, x), (w, 0.0, y), (0.0, 0.0, 0.0))

    def vee(self, matrix: Array) -> Array:
        """Give (w, v1, v2)."""
        return vector_of(matrix[..., 1, 0], matrix[..., 0, 2], matrix[..., 1, 2])

    def ad(self, xi: Array) -> Array:
        """Give the matrix of (a, u) -> (0, w J u - a J v)."""
        w, x, y = entries(xi)
        return matrix_of((0.0, 0.0, 0.0), (y, 0.0, -w), (-x, w, 0.0))

    def Ad(self, element: Array) -> Array:
        """Give [[1, 0], [-J t, R]]."""
        c, s = element[..., 0, 0], element[..., 1, 0]
        x, y = element[..., 0, 2], element[..., 1, 2]
        return matrix_of((1.0, 0.0, 0.0), (y, c, -s), (-x, s, c))

    def compose(self, first: Array, second: Array) -> Array:
        """Add the angles and give R1 t2 + t1; two entries determine a rotation of the plane."""
        c, s, x, y = _cos_sin_shift(first)
        d, t, u, v = _cos_sin_shift(second)
        return _motion(c * d - s * t, s * d + c * t, c * u - s * v + x, s * u + c * v + y)

    def inverse_element(self, element: Array) -> Array:
        """Give [[R^T, -R^T t], [0, 1]]."""
        c, s, x, y = _cos_sin_shift(element)
        return _motion(c, -s, -(c * x + s * y), s * x - c * y)

    largest_angle = pi

    def rotation_size(self, xi: Array) -> Array:
        """Give |w|."""
        return np.abs(xi[..., 0])

    def exp(self, xi: Array) -> Array:
        """Give the rotation by w and the translation (sin(w)/w + (1 - cos w)/w J) v."""
        w, x, y = entries(xi)
        a, b = sinc_of_square(w * w), w * versine_of_square(w * w)
        return _motion(np.cos(w), np.sin(w), a * x - b * y, b * x + a * y)

    def log(self, element: Array) -> Array:
        """Give w in (-pi, pi] and v = (1 - w^2 H - w J/2) t, the inverse of the above."""
        c, s, x, y = _cos_sin_shift(element)
        w = np.arctan2(s, c)
        a, b = 1 - w * w * half_cotangent_defect_of_square(w * w), w / 2
        return vector_of(w, a * x + b * y, a * y - b * x)

    def dexp(self, xi: Array) -> Array:
        """Give 1 + C ad + D ad^2, C = (1 - cos w)/w^2, D = (w - sin w)/w^3."""
        s = xi[..., 0] * xi[..., 0]
        return _quadratic_in_ad(xi, versine_of_square(s), sine_defect_of_square(s))

    def dexp_inverse(self, xi: Array) -> Array:
        """Give 1 - ad/2 + H ad^2."""
        s = xi[..., 0] * xi[..., 0]
        return _quadratic_in_ad(xi, -0.5, half_cotangent_defect_of_square(s))

    def cay(self, xi: Array) -> Array:
        """Give the Cayley rotation of w and the translation (1 - w J/2)^{-1} v."""
        w, x, y = entries(xi)
        factor = 1 / (1 + w * w / 4)
        shift = factor * (x - w * y / 2), factor * (y + w * x / 2)
        return _motion(*cayley_cos_sin(w), *shift)

    def cay_inverse(self, element: Array) -> Array:
        """Give w = 2 sin / (1 + cos), v = (1 - w J/2) t."""
        c, s, x, y = _cos_sin_shift(element)
        half = s / (1 + c)
        return vector_of(2 * half, x + half * y, y - half * x)

    def dcay(self, xi: Array) -> Array:
        """Give (a, u) -> (a, u + (w J u - a J v)/2) / (1 + w^2/4)."""
        w, x, y = entries(xi)
        one = 1 / (1 + w * w / 4)
        half = one / 2
        turn = w * half
        return matrix_of((one, 0.0, 0.0), (y * half, one, -turn), (-x * half, turn, one))

    def dcay_inverse(self, xi: Array) -> Array:
        """Give (a, u) -> ((1 + w^2/4) a, u - w J u/2 + a J v/2 + w a v/4)."""
        w, x, y = entries(xi)
        half = w / 2
        return matrix_of(
            (1 + half * half, 0.0, 0.0),
            ((half * x - y) / 2, 1.0, half),
            ((x + half * y) / 2, -half, 1.0),
        )

    def cay_half(self, xi: Array) -> Array:
        """Give w' = w / (1 + sqrt(1 + w^2/4)), v' = (1 - w'^2/4) v / 2."""
        w, x, y = entries(xi)
        half = w / (1 + np.sqrt(1 + w * w / 4))
        factor = (1 - half * half / 4) / 2
        return vector_of(half, factor * x, factor * y)


def _quadratic_in_ad(xi: Array, b: Array | float, c: Array) -> Array:
    """Give 1 + b ad + c ad^2 by components; ad^2 (a, u) = (0, -w^2 u + w a v)."""
    w, x, y = entries(xi)
    turn, stretch = b * w, c * w
    diagonal = 1 - stretch * w
    return matrix_of(
        (1.0, 0.0, 0.0),
        (b * y + stretch * x, diagonal, -turn),
        (stretch * y - b * x, turn, diagonal),
    )


def _cos_sin_shift(element: Array) -> tuple[Array, Array, Array, Array]:
    return element[..., 0, 0], element[..., 1, 0], element[..., 0, 2], element[..., 1, 2]


def _motion(cosine: Array, sine: Array, x: Array, y: Array) -> Array:
    return matrix_of((cosine, -sine, x), (sine, cosine, y), (0.0, 0.0, 1.0))
