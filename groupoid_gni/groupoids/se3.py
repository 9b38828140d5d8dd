"""SE(3), rigid motions of space, as 4 x 4 homogeneous matrices.

Algebra components (w, v): rotation first. Closed forms exact at 0 and near pi.
"""

from __future__ import annotations

from math import pi

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.expressions import (
    half_cotangent_defect_derivative,
    half_cotangent_defect_of_square,
    sine_defect_derivative,
    sine_defect_of_square,
    versine_derivative,
    versine_of_square,
)
from groupoid_gni.groupoids.components import (
    apply,
    block_lower_triangular,
    dot,
    entries,
    join,
    matrix_of,
    vector_of,
)
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction
from groupoid_gni.groupoids.rigid_motion import RigidMotionGroup, homogeneous, parts
from groupoid_gni.groupoids.so3 import (
    SO3,
    cross_matrix,
    rotation_cay,
    rotation_cay_inverse,
    rotation_dcay,
    rotation_dcay_inverse,
    rotation_dexp,
    rotation_dexp_inverse,
)

_ROTATIONS = SO3()


class SE3(RigidMotionGroup):
    """Rigid motions of space, [(w, v), (a, u)] = (w x a, w x u + v x a).

    se(3) is so(3) with dual numbers, w + epsilon v, so every power series in ad is
    [[f(w), 0], [df(w) v, f(w)]]: that gives dexp and its inverse without 6 x 6 products.

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
        super().__init__(6, (4, 4), side=side, retraction=retraction)

    def hat(self, xi: Array) -> Array:
        """Give [[w^, v], [0, 0]]."""
        a, b, c, x, y, z = entries(xi)
        return matrix_of((0.0, -c, b, x), (c, 0.0, -a, y), (-b, a, 0.0, z), (0.0,) * 4)

    def vee(self, matrix: Array) -> Array:
        """Give (w, v)."""
        turn = matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0]
        return vector_of(*turn, *entries(matrix[..., :3, 3]))

    def ad(self, xi: Array) -> Array:
        """Give [[w^, 0], [v^, w^]]."""
        turn = cross_matrix(xi[..., :3])
        return block_lower_triangular(turn, cross_matrix(xi[..., 3:]), turn)

    def Ad(self, element: Array) -> Array:
        """Give [[R, 0], [t^ R, R]]."""
        rotation, translation = parts(element)
        return block_lower_triangular(rotation, cross_matrix(translation) @ rotation, rotation)

    largest_angle = pi

    def rotation_size(self, xi: Array) -> Array:
        """Give |w|."""
        return np.sqrt(dot(xi[..., :3], xi[..., :3]))

    def exp(self, xi: Array) -> Array:
        """Give R = exp(w), t = dexp_w v."""
        w, v = xi[..., :3], xi[..., 3:]
        return homogeneous(_ROTATIONS.exp(w), apply(rotation_dexp(w), v))

    def log(self, element: Array) -> Array:
        """Give w = log R, |w| <= pi, and v = dexp_w^{-1} t."""
        rotation, translation = parts(element)
        w = _ROTATIONS.log(rotation)
        return join(w, apply(rotation_dexp_inverse(w), translation))

    def dexp(self, xi: Array) -> Array:
        """Give dexp_xi: 1 + C w^ + D w^ w^ and its derivative along v."""
        w, v = xi[..., :3], xi[..., 3:]
        s = dot(w, w)
        diagonal = rotation_dexp(w)
        b = versine_of_square(s), versine_derivative(s)
        c = sine_defect_of_square(s), sine_defect_derivative(s)
        below = _quadratic_change(w, v, b, c)
        return block_lower_triangular(diagonal, below, diagonal)

    def dexp_inverse(self, xi: Array) -> Array:
        """Give dexp_xi^{-1}: 1 - w^/2 + H w^ w^ and its derivative along v."""
        w, v = xi[..., :3], xi[..., 3:]
        s = dot(w, w)
        diagonal = rotation_dexp_inverse(w)
        c = half_cotangent_defect_of_square(s), half_cotangent_defect_derivative(s)
        below = _quadratic_change(w, v, (-0.5, 0.0), c)
        return block_lower_triangular(diagonal, below, diagonal)

    def cay(self, xi: Array) -> Array:
        """Give R = cay(w), t = (1 + R) v / 2."""
        v = xi[..., 3:]
        rotation = rotation_cay(xi[..., :3])
        return homogeneous(rotation, (v + apply(rotation, v)) / 2)

    def cay_inverse(self, element: Array) -> Array:
        """Give w = cay^{-1}(R), v = (1 - w^/2) t."""
        rotation, translation = parts(element)
        w = rotation_cay_inverse(rotation)
        return join(w, translation - apply(cross_matrix(w), translation) / 2)

    def dcay(self, xi: Array) -> Array:
        """Give [[dcay_w, 0], [v^ dcay_w / 2, (1 - w^/2)^{-1}]], the inverse of ``dcay_inverse``."""
        w, v = xi[..., :3], xi[..., 3:]
        turn = rotation_dcay(w)
        shift = (np.eye(3) + rotation_cay(w)) / 2
        return block_lower_triangular(turn, cross_matrix(v) @ turn / 2, shift)

    def dcay_inverse(self, xi: Array) -> Array:
        """Give (a, u) -> (dcay_w^{-1} a, u - (w x u + v x a)/2 + w x (v x a)/4)."""
        w, v = xi[..., :3], xi[..., 3:]
        below = _cross_product_matrix(w, v) / 4 - cross_matrix(v) / 2
        lower = np.eye(3) - cross_matrix(w) / 2
        return block_lower_triangular(rotation_dcay_inverse(w), below, lower)

    def cay_half(self, xi: Array) -> Array:
        """Give w' = w/(1 + sqrt(1 + |w|^2/4)), v' = ((1 - |w'|^2/4) v + w'(w'.v)/4) / 2."""
        v = xi[..., 3:]
        w = _ROTATIONS.cay_half(xi[..., :3])
        along, size = dot(w, v, keepdims=True), dot(w, w, keepdims=True)
        return join(w, ((1 - size / 4) * v + w * (along / 4)) / 2)


def _quadratic_change(
    w: Array, v: Array, b: tuple[Array | float, Array | float], c: tuple[Array, Array]
) -> Array:
    """Differentiate 1 + b w^ + c w^ w^ along v; b and c come with their slopes in s = |w|^2.

    w^ v^ + v^ w^ = w v^T + v w^T - 2 w.v, so with u = c v + c' (w.v) w the result is
    w u^T + u w^T - 2 (w.u) 1 + (b v + 2 b' (w.v) w)^.
    """
    along = dot(w, v)
    u = [c[0] * v_i + c[1] * along * w_i for v_i, w_i in zip(entries(v), entries(w), strict=True)]
    x, y, z = entries(w)
    turn = 2 * b[1] * along
    p, q, r = (b[0] * v_i + turn * w_i for v_i, w_i in zip(entries(v), entries(w), strict=True))
    xx, yy, zz = 2 * x * u[0], 2 * y * u[1], 2 * z * u[2]
    xy, xz, yz = x * u[1] + y * u[0], x * u[2] + z * u[0], y * u[2] + z * u[1]
    return matrix_of(
        (-yy - zz, xy - r, xz + q), (xy + r, -xx - zz, yz - p), (xz - q, yz + p, -xx - yy)
    )


def _cross_product_matrix(w: Array, v: Array) -> Array:
    """Give w^ v^ = v w^T - w.v by components."""
    (a, b, c), (x, y, z) = entries(w), entries(v)
    ax, by, cz = a * x, b * y, c * z
    return matrix_of(
        (-by - cz, x * b, x * c), (y * a, -ax - cz, y * c), (z * a, z * b, -ax - by)
    )
