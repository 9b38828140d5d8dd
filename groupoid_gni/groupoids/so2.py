"""SO(2), rotations of the plane, as 2 x 2 matrices.

The algebra is one angle; commutative, so dtau is a scalar.
"""

from __future__ import annotations

from math import pi

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import batch_shape, matrix_of, repeated
from groupoid_gni.groupoids.lie_group import Side
from groupoid_gni.groupoids.retractions import Cayley, Retraction
from groupoid_gni.groupoids.rotation_group import RotationGroup


class SO2(RotationGroup):
    """Rotations of the plane; xi = (angle,), hat(xi) = angle J, J = [[0, -1], [1, 0]].

    Parameters
    ----------
    side : {"left", "right"}
        Without effect: the group is commutative.
    retraction : Retraction
    """

    def __init__(
        self,
        *,
        side: Side = "left",
        retraction: Retraction = Cayley(),  # noqa: B008 - frozen
    ) -> None:
        super().__init__(1, (2, 2), side=side, retraction=retraction)

    def hat(self, xi: Array) -> Array:
        """Give angle J."""
        angle = xi[..., 0]
        return matrix_of((0.0, -angle), (angle, 0.0))

    def vee(self, matrix: Array) -> Array:
        """Give the lower left entry, shape (..., 1)."""
        return matrix[..., 1, :1]

    def ad(self, xi: Array) -> Array:
        """Give zero, shape (..., 1, 1)."""
        return repeated(np.zeros((1, 1)), batch_shape(xi))

    def Ad(self, element: Array) -> Array:
        """Give one, shape (..., 1, 1)."""
        return repeated(np.eye(1), batch_shape(element, 2))

    def compose(self, first: Array, second: Array) -> Array:
        """Add the angles: two entries of the product determine the other two."""
        c, s = first[..., 0, 0], first[..., 1, 0]
        d, t = second[..., 0, 0], second[..., 1, 0]
        return _rotation(c * d - s * t, s * d + c * t)

    largest_angle = pi

    def rotation_size(self, xi: Array) -> Array:
        """Give |angle|."""
        return np.abs(xi[..., 0])

    def exp(self, xi: Array) -> Array:
        """Give the rotation by the angle."""
        return _rotation(np.cos(xi[..., 0]), np.sin(xi[..., 0]))

    def log(self, element: Array) -> Array:
        """Give the angle in (-pi, pi]."""
        return np.arctan2(element[..., 1, :1], element[..., 0, :1])

    def dexp(self, xi: Array) -> Array:
        """Give one, shape (..., 1, 1)."""
        return repeated(np.eye(1), batch_shape(xi))

    def dexp_inverse(self, xi: Array) -> Array:
        """Give one, shape (..., 1, 1)."""
        return repeated(np.eye(1), batch_shape(xi))

    def cay(self, xi: Array) -> Array:
        """Give the rotation by 2 arctan(angle / 2)."""
        return _rotation(*cayley_cos_sin(xi[..., 0]))

    def cay_inverse(self, element: Array) -> Array:
        """Give 2 sin / (1 + cos)."""
        return 2 * element[..., 1, :1] / (1 + element[..., 0, :1])

    def dcay(self, xi: Array) -> Array:
        """Give 1 / (1 + angle^2/4), shape (..., 1, 1)."""
        return 1 / self.dcay_inverse(xi)

    def dcay_inverse(self, xi: Array) -> Array:
        """Give 1 + angle^2/4, shape (..., 1, 1)."""
        return (1 + xi * xi / 4)[..., None]

    def cay_half(self, xi: Array) -> Array:
        """Give angle / (1 + sqrt(1 + angle^2/4))."""
        return xi / (1 + np.sqrt(1 + xi * xi / 4))


def cayley_cos_sin(angle: Array) -> tuple[Array, Array]:
    """Give cosine and sine of 2 arctan(angle / 2), the angle of the Cayley rotation."""
    quarter = angle * angle / 4
    return (1 - quarter) / (1 + quarter), angle / (1 + quarter)


def _rotation(cosine: Array, sine: Array) -> Array:
    return matrix_of((cosine, -sine), (sine, cosine))
