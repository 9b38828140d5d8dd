"""Products of groupoids, factor by factor.

Base points, arrows and algebroid components are those of the factors, one after the other.
"""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import block_diagonal, block_structure, join, largest
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.lie_groupoid import LieGroupoid


class ProductGroupoid(LieGroupoid):
    """G_1 x ... x G_k => Q_1 x ... x Q_k.

    Its pose is that of its only Lie group, if there is exactly one (the reconstructed attitude of
    an Atiyah groupoid), and the arrow itself otherwise.

    Parameters
    ----------
    *factors : LieGroupoid
        At least one.
    """

    def __init__(self, *factors: LieGroupoid) -> None:
        for factor in factors:
            if not isinstance(factor, LieGroupoid):
                raise InputError(
                    f"ProductGroupoid needs groupoids, got {type(factor).__name__}: "
                    f"write ProductGroupoid(PairGroupoid(2), SO3())."
                )
        if not factors:
            raise InputError("ProductGroupoid() needs at least one factor.")
        self.factors = factors
        self.rank = sum(factor.rank for factor in factors)
        self.example_base_point = np.concatenate([f.example_base_point for f in factors])
        groups = [i for i, factor in enumerate(factors) if isinstance(factor, LieGroup)]
        self._posed_factor = groups[0] if len(groups) == 1 else None

    def source(self, g: Array) -> Array:
        """Give the sources of the factors."""
        return join(*(f.source(part) for f, part in self._arrows(g)))

    def target(self, g: Array) -> Array:
        """Give the targets of the factors."""
        return join(*(f.target(part) for f, part in self._arrows(g)))

    def identity(self, x: Array) -> Array:
        """Give the identities of the factors."""
        return join(*(f.identity(part) for f, part in self._bases(x)))

    def multiply(self, g: Array, h: Array) -> Array:
        """Compose factor by factor."""
        pairs = zip(self._arrows(g), self._arrows(h), strict=True)
        return join(*(f._multiply_unchecked(first, then) for (f, first), (_, then) in pairs))

    def inverse(self, g: Array) -> Array:
        """Invert factor by factor."""
        return join(*(f.inverse(part) for f, part in self._arrows(g)))

    def retract(self, x: Array, xi: Array) -> Array:
        """Retract factor by factor."""
        return join(*(f.retract(part, part_xi) for f, part, part_xi in self._fibres(x, xi)))

    def lift(self, g: Array) -> Array:
        """Lift factor by factor."""
        return join(*(f.lift(part) for f, part in self._arrows(g)))

    def anchor(self, x: Array) -> Array:
        """Give the block-diagonal anchor."""
        return block_diagonal(*(f.anchor(part) for f, part in self._bases(x)))

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give the block-diagonal B+."""
        blocks = (f.trivialised_tangent_plus(part, vel) for f, part, vel in self._fibres(x, xi))
        return block_diagonal(*blocks)

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give the block-diagonal B-."""
        blocks = (f.trivialised_tangent_minus(part, vel) for f, part, vel in self._fibres(x, xi))
        return block_diagonal(*blocks)

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give the block-diagonal coadjoint action."""
        return block_diagonal(*(f.coadjoint(part, vel) for f, part, vel in self._fibres(x, xi)))

    def bracket(self, x: Array) -> Array:
        """Give the brackets of the factors; elements of different factors commute."""
        return block_structure(*(f.bracket(part) for f, part in self._bases(x)))

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give it factor by factor."""
        parts = zip(self._fibres(x, xi), self._fibres(x, p), strict=True)
        return join(*(f.ad_star(part, vel, q) for (f, part, vel), (_, _, q) in parts))

    def half(self, x: Array, xi: Array) -> Array:
        """Halve factor by factor."""
        return join(*(f.half(part, part_xi) for f, part, part_xi in self._fibres(x, xi)))

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the largest reach of the factors."""
        return largest([f.reach(part, part_xi) for f, part, part_xi in self._fibres(x, xi)])

    def base_defect(self, x: Array) -> Array:
        """Give the largest defect of the factors."""
        return largest([f.base_defect(part) for f, part in self._bases(x)])

    def restore_base(self, x: Array) -> Array:
        """Restore factor by factor."""
        return join(*(f.restore_base(part) for f, part in self._bases(x)))

    def restore_arrow(self, g: Array) -> Array:
        """Restore factor by factor."""
        return join(*(f.restore_arrow(part) for f, part in self._arrows(g)))

    def pose(self, arrow: Array) -> Array:
        """Give the pose of the only Lie group, or the arrow if there is not exactly one."""
        if self._posed_factor is None:
            return arrow
        factor, part = self._arrows(arrow)[self._posed_factor]
        return factor.pose(part)

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give (base_point, base_point, pose): identities except for the factor with the pose."""
        if pose is None or self._posed_factor is None:
            return super().arrow_to(base_point, pose)
        parts = [
            f.arrow_to(part, pose if i == self._posed_factor else None)
            for i, (f, part) in enumerate(self._bases(base_point))
        ]
        return join(*parts)

    def split(self, x: Array) -> list[Array]:
        """Split into the parts of the factors' bases, leaving out points."""
        return [p for f, part in self._bases(x) if f.base_size for p in f.split(part)]

    def _bases(self, x: Array) -> list[tuple[LieGroupoid, Array]]:
        sizes = [f.base_size for f in self.factors]
        return list(zip(self.factors, _cut(x, sizes), strict=True))

    def _arrows(self, g: Array) -> list[tuple[LieGroupoid, Array]]:
        sizes = [f.arrow_size for f in self.factors]
        return list(zip(self.factors, _cut(g, sizes), strict=True))

    def _fibres(self, x: Array, xi: Array) -> list[tuple[LieGroupoid, Array, Array]]:
        velocities = _cut(xi, [f.rank for f in self.factors])
        return [(f, part, vel) for (f, part), vel in zip(self._bases(x), velocities, strict=True)]

    def __repr__(self) -> str:
        return f"ProductGroupoid({', '.join(map(repr, self.factors))})"


def _cut(vector: Array, sizes: list[int]) -> list[Array]:
    """Cut a vector (..., sum of sizes) into consecutive parts (..., size)."""
    stops = accumulate(sizes, initial=0)
    return [vector[..., a:b] for a, b in pairwise(stops)]
