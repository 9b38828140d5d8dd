"""The plane in a frame that stretches: arrows do not leave their velocity alone."""

from __future__ import annotations

from typing import Any

import numpy as np

import groupoid_gni as gni


class StretchedPlane(gni.LieGroupoid):
    """The pair groupoid of R^2 in the frame ``d/dx, exp(a x) d/dy``, written with seven functions.

    ``retract((x, y), xi)`` goes to x + xi_1 and y + exp(a (x + xi_1 / 2)) xi_2: symmetric, and
    ``B+ xi + B- xi`` is of third order in xi.
    """

    rank = 2
    example_base_point = (0.3, -0.4)

    def __init__(self, rate: float = 0.9) -> None:
        self.rate = rate

    def source(self, g: Any) -> Any:
        """Give the first point."""
        return g[..., :2]

    def target(self, g: Any) -> Any:
        """Give the second point."""
        return g[..., 2:]

    def identity(self, x: Any) -> Any:
        """Give (x, x)."""
        return np.concatenate([x, x])

    def multiply(self, g: Any, h: Any) -> Any:
        """Give (x, y)(y, z) = (x, z)."""
        return np.concatenate([g[:2], h[2:]])

    def inverse(self, g: Any) -> Any:
        """Give (y, x)."""
        return np.concatenate([g[2:], g[:2]])

    def _width(self, place: Any) -> Any:
        return np.exp(self.rate * place)

    def retract(self, x: Any, xi: Any) -> Any:
        """Go along the frame of the middle."""
        across = self._width(x[0] + xi[0] / 2) * xi[1]
        return np.concatenate([x, x + gni.array([xi[0], across])])

    def lift(self, g: Any) -> Any:
        """Take components in the frame of the middle."""
        along, across = g[2] - g[0], g[3] - g[1]
        return gni.array([along, across / self._width((g[0] + g[2]) / 2)])


def stretched(m: int = 1, **options: Any) -> Any:
    """An animal of the zoo on it."""
    import zoo

    return zoo.animal("stretched plane", m, space=StretchedPlane(), **options)
