"""SO(3), rotations of space, as 3 x 3 matrices, with closed forms exact at 0 and near pi.

Appendix of the paper: cay, dcay and dcay^{-1} on SO(3); equation (39) for hat.
"""

from __future__ import annotations

from math import pi

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.expressions import (
    arctan_ratio,
    half_cotangent_defect_of_square,
    sinc_of_square,
    sine_defect_of_square,
    versine_of_square,
    where,
)
from groupoid_gni.groupoids.components import dot, entries, matrix_of, vector_of
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction
from groupoid_gni.groupoids.rotation_group import RotationGroup


class SO3(RotationGroup):
    """Rotations of space; xi = w, hat(w) y = w x y, so ad_w = hat(w) and Ad_R = R.

    Parameters
    ----------
    side : {"left", "right"}
        Body or space angular velocity.
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
        """Give the matrix of y -> w x y, equation (39)."""
        return cross_matrix(xi)

    def vee(self, matrix: Array) -> Array:
        """Give the entries (3,2), (1,3), (2,1)."""
        return vector_of(matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0])

    def ad(self, xi: Array) -> Array:
        """Give hat(w)."""
        return cross_matrix(xi)

    def Ad(self, element: Array) -> Array:
        """Give R itself."""
        return element

    largest_angle = pi

    def rotation_size(self, xi: Array) -> Array:
        """Give |w|."""
        return np.sqrt(dot(xi, xi))

    def exp(self, xi: Array) -> Array:
        """Give 1 + sin(t)/t w^ + (1 - cos t)/t^2 w^ w^ (Rodrigues), t = |w|."""
        s = dot(xi, xi)
        return quadratic_in_hat(xi, 1.0, sinc_of_square(s), versine_of_square(s))

    def log(self, element: Array) -> Array:
        """Give the rotation vector, |w| <= pi, through the unit quaternion.

        4 arctan(|v| / (q0 + |q|)) is twice the arctangent of the half angle with an argument that
        stays below 1, so nothing is singular at pi; at pi one of the two signs is taken.
        """
        q0, v = half_angle_quaternion(element)
        quarter_tangent = v / (q0 + np.sqrt(q0 * q0 + dot(v, v, keepdims=True)))
        return quarter_tangent * (4 * arctan_ratio(dot(quarter_tangent, quarter_tangent, True)))

    def dexp(self, xi: Array) -> Array:
        """Give 1 + (1 - cos t)/t^2 w^ + (t - sin t)/t^3 w^ w^."""
        return rotation_dexp(xi)

    def dexp_inverse(self, xi: Array) -> Array:
        """Give 1 - w^/2 + H w^ w^, H = (1 - (t/2) cot(t/2)) / t^2."""
        return rotation_dexp_inverse(xi)

    def cay(self, xi: Array) -> Array:
        """Give 1 + 4/(4 + |w|^2) (w^ + w^ w^/2) (appendix of the paper)."""
        return rotation_cay(xi)

    def cay_inverse(self, element: Array) -> Array:
        """Give w = 2 vee(R - R^T) / (1 + tr R)."""
        return rotation_cay_inverse(element)

    def dcay(self, xi: Array) -> Array:
        """Give 2/(4 + |w|^2) (2 + w^) (appendix of the paper)."""
        return rotation_dcay(xi)

    def dcay_inverse(self, xi: Array) -> Array:
        """Give 1 - w^/2 + w w^T/4 (appendix of the paper)."""
        return rotation_dcay_inverse(xi)

    def cay_half(self, xi: Array) -> Array:
        """Give w / (1 + sqrt(1 + |w|^2/4))."""
        return xi / (1 + np.sqrt(1 + dot(xi, xi, keepdims=True) / 4))


# The same formulas for the rotation blocks of SE(3).


def cross_matrix(vector: Array) -> Array:
    """Give the matrix of y -> vector x y, shape (..., 3, 3)."""
    x, y, z = entries(vector)
    return matrix_of((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))


def quadratic_in_hat(
    w: Array, one: Array | float, b: Array | float, c: Array | float
) -> Array:
    """Give one + b w^ + c w^ w^ by components, using w^ w^ = w w^T - |w|^2.

    The diagonal is written so that a turn about an axis leaves that axis alone exactly.
    """
    x, y, z = entries(w)
    cx, cy, cz = c * x, c * y, c * z
    bx, by, bz = b * x, b * y, b * z
    xx, yy, zz = cx * x, cy * y, cz * z
    xy, xz, yz = cx * y, cx * z, cy * z
    return matrix_of(
        (one - (yy + zz), xy - bz, xz + by),
        (xy + bz, one - (xx + zz), yz - bx),
        (xz - by, yz + bx, one - (xx + yy)),
    )


def rotation_dexp(w: Array) -> Array:
    """Give dexp_w on so(3)."""
    s = dot(w, w)
    return quadratic_in_hat(w, 1.0, versine_of_square(s), sine_defect_of_square(s))


def rotation_dexp_inverse(w: Array) -> Array:
    """Give dexp_w^{-1} on so(3), for |w| < 2 pi."""
    s = dot(w, w)
    return quadratic_in_hat(w, 1.0, -0.5, half_cotangent_defect_of_square(s))


def rotation_cay(w: Array) -> Array:
    """Give cay(w) in SO(3)."""
    s = dot(w, w)
    factor = 4 / (4 + s)
    return quadratic_in_hat(w, 1.0, factor, factor / 2)


def rotation_cay_inverse(rotation: Array) -> Array:
    """Give 2 vee(R - R^T) / (1 + tr R), for rotations by less than pi."""
    r = rotation
    factor = 2 / (1 + r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2])
    return vector_of(
        factor * (r[..., 2, 1] - r[..., 1, 2]),
        factor * (r[..., 0, 2] - r[..., 2, 0]),
        factor * (r[..., 1, 0] - r[..., 0, 1]),
    )


def rotation_dcay(w: Array) -> Array:
    """Give dcay_w on so(3)."""
    s = dot(w, w)
    factor = 2 / (4 + s)
    return quadratic_in_hat(w, 2 * factor, factor, 0.0)


def rotation_dcay_inverse(w: Array) -> Array:
    """Give dcay_w^{-1} on so(3): 1 - w^/2 + w w^T/4.

    Written out: through |w|^2 the diagonal would carry terms that cancel, and so would its
    derivatives in every Newton iteration.
    """
    x, y, z = entries(w / 2)
    xy, xz, yz = x * y, x * z, y * z
    return matrix_of(
        (1 + x * x, xy + z, xz - y), (xy - z, 1 + y * y, yz + x), (xz + y, yz - x, 1 + z * z)
    )


def half_angle_quaternion(rotation: Array) -> tuple[Array, Array]:
    """Give 4 q_i (q0, v) of a rotation, shapes (..., 1), (..., 3); q_i the largest, q0 >= 0.

    Each case is linear in R, so unused cases stay finite and so do their derivatives; the used one
    has length at least 2, also at a half turn, where formulas with the trace alone break down.
    """
    (r11, r12, r13), (r21, r22, r23), (r31, r32, r33) = (
        entries(rotation[..., i, :]) for i in range(3)
    )
    trace = r11 + r22 + r33
    x, y, z = r32 - r23, r13 - r31, r21 - r12
    xy, xz, yz = r12 + r21, r13 + r31, r23 + r32
    by_trace = (1 + trace, x, y, z)
    by_x = (x, 1 - trace + 2 * r11, xy, xz)
    by_y = (y, xy, 1 - trace + 2 * r22, yz)
    by_z = (z, xz, yz, 1 - trace + 2 * r33)
    use_x = (r11 >= r22) & (r11 >= r33)
    use_y = r22 >= r33
    chosen = []
    for a, b, c, d in zip(by_trace, by_x, by_y, by_z, strict=True):
        turned = where(use_x, b, where(use_y, c, d))
        chosen.append(where((trace >= r11) & (trace >= r22) & (trace >= r33), a, turned))
    sign = where(chosen[0] < 0, -1.0, 1.0)
    return vector_of(sign * chosen[0]), vector_of(*(sign * entry for entry in chosen[1:]))
