"""How far the two sides of a law are apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.groupoids import LieGroupoid


@dataclass(frozen=True, eq=False)
class Gap:
    """The two sides of a law at one sample.

    left, right : arrays of one shape.
    scale : what a difference is compared with, > 0; the residual is ``max |left - right| / scale``.
    """

    left: FloatArray
    right: FloatArray
    scale: float

    @property
    def residual(self) -> float:
        """``max |left - right| / scale``; infinite when the shapes differ, NaN stays NaN."""
        if self.left.shape != self.right.shape:
            return float("inf")
        return float(np.max(np.abs(self.left - self.right), initial=0.0)) / self.scale


def gap(left: ArrayLike, right: ArrayLike, scale: float | None = None) -> Gap:
    """The gap between two sides; the scale is 1 plus the larger side when left out."""
    one, other = np.array(left, dtype=np.float64), np.array(right, dtype=np.float64)
    if scale is None:
        scale = 1.0 + max(float(np.max(np.abs(side), initial=0.0)) for side in (one, other))
    return Gap(one, other, scale)


def holds(truth: bool) -> Gap:
    """A law that is either true or not."""
    return Gap(np.array(float(truth)), np.array(1.0), 1.0)


def arrow_gap(space: LieGroupoid, g: Array, h: Array) -> Gap:
    """Arrows agree when sources and targets do and ``lift(multiply(inverse(g), h)) = 0``.

    They may be classes with many coordinates, so coordinates are not compared.
    """
    ends_g = np.concatenate([space.source(g), space.target(g)])
    ends_h = np.concatenate([space.source(h), space.target(h)])
    apart = gap(ends_g, ends_h)
    if apart.residual > 1e-9:
        return apart
    between = space.lift(space.multiply(space.inverse(g), h))
    return gap(
        np.concatenate([ends_g, between]), np.concatenate([ends_h, np.zeros_like(between)])
    )


def relative_gap(left: Any, right: Any, floor: float = 0.0) -> Gap:
    """The gap in units of the right side alone (or of ``floor``): for quantities near zero."""
    size = float(np.max(np.abs(np.asarray(right, dtype=float)), initial=0.0))
    return gap(left, right, max(size, floor) or 1.0)
