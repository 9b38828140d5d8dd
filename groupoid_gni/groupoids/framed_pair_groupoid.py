"""The pair groupoid of a product of Lie groups, in its body or space frame: no chart needed.

Full, unreduced configuration spaces such as R^2 x SO(3) (section 7.4.2 of the paper), without the
singularities of the exponential chart used there.
"""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import Array
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import block_diagonal, block_structure, join, largest
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.pair_of_points import PairOfPoints


class FramedPairGroupoid(PairOfPoints):
    """Q x Q => Q for Q = G_1 x ... x G_k, retract(x, xi) = (x, x tau(xi)) group by group.

    Base points are the flattened elements of the groups, one after the other; arrows are (x0, x1).
    On a group with side="right" the frame is the space frame, retract(x, xi) = (x, tau(xi) x).

    Parameters
    ----------
    *groups : LieGroup
        At least one, for example ``FramedPairGroupoid(VectorGroup(2), SO3())``.
    """

    def __init__(self, *groups: LieGroup) -> None:
        for group in groups:
            if not isinstance(group, LieGroup):
                raise InputError(
                    f"FramedPairGroupoid needs Lie groups, got {type(group).__name__}: "
                    f"write FramedPairGroupoid(VectorGroup(2), SO3())."
                )
        if not groups:
            raise InputError("FramedPairGroupoid() needs at least one group.")
        self.groups = groups
        self.rank = sum(group.dimension for group in groups)
        self.example_base_point = np.concatenate(
            [group.flatten(group.identity_element) for group in groups]
        )
        self._point = np.zeros(0)

    def retract(self, x: Array, xi: Array) -> Array:
        """Give (x, x tau(xi)), or (x, tau(xi) x) on right groups."""
        moved = [
            group.multiply(element, group.retract(self._point, velocity))
            for group, element, velocity in self._fibres(x, xi)
        ]
        return join(x, *moved)

    def lift(self, g: Array) -> Array:
        """Give tau^{-1}(x0^{-1} x1), or tau^{-1}(x1 x0^{-1}) on right groups."""
        starts, ends = self._elements(self.source(g)), self._elements(self.target(g))
        steps = [
            group.lift(group.multiply(group.inverse(start), end))
            for (group, start), (_, end) in zip(starts, ends, strict=True)
        ]
        return join(*steps)

    def anchor(self, x: Array) -> Array:
        """Give the block-diagonal matrix with columns x E_a, or E_a x on right groups."""
        blocks = (
            group.translated_basis(group.unflatten(element)) for group, element in self._elements(x)
        )
        return block_diagonal(*blocks)

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give the groups' B+, independent of x."""
        blocks = (
            group.trivialised_tangent_plus(self._point, velocity)
            for group, velocity in self._velocities(xi)
        )
        return block_diagonal(*blocks)

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give the groups' B-, independent of x."""
        blocks = (
            group.trivialised_tangent_minus(self._point, velocity)
            for group, velocity in self._velocities(xi)
        )
        return block_diagonal(*blocks)

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give the groups' coadjoint actions, independent of x."""
        blocks = (
            group.coadjoint(self._point, velocity) for group, velocity in self._velocities(xi)
        )
        return block_diagonal(*blocks)

    def bracket(self, x: Array) -> Array:
        """Give the groups' brackets; elements of different groups commute."""
        points = x[..., :0]
        return block_structure(*(group.bracket(points) for group in self.groups))

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give it group by group."""
        parts = zip(self._velocities(xi), self._velocities(p), strict=True)
        return join(*(group.ad_star(self._point, vel, q) for (group, vel), (_, q) in parts))

    def half(self, x: Array, xi: Array) -> Array:
        """Halve group by group."""
        return join(*(group.half_vector(velocity) for group, velocity in self._velocities(xi)))

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the largest reach of the groups."""
        reaches = [group.reach(self._point, velocity) for group, velocity in self._velocities(xi)]
        return largest(reaches)

    def base_defect(self, x: Array) -> Array:
        """Give the largest distance of the elements from their groups."""
        parts = zip(self.groups, self.split(x), strict=True)
        return largest([group.element_defect(element) for group, element in parts])

    def restore_base(self, x: Array) -> Array:
        """Restore the elements, group by group."""
        parts = zip(self.groups, self.split(x), strict=True)
        return join(*(group.flatten(group.restore_element(element)) for group, element in parts))

    def restore_arrow(self, g: Array) -> Array:
        """Restore both ends."""
        return join(self.restore_base(self.source(g)), self.restore_base(self.target(g)))

    def split(self, x: Array) -> list[Array]:
        """Give the group elements in their natural shapes."""
        return [group.unflatten(element) for group, element in self._elements(x)]

    def _elements(self, x: Array) -> list[tuple[LieGroup, Array]]:
        return _portions(self.groups, x, [group.arrow_size for group in self.groups])

    def _velocities(self, xi: Array) -> list[tuple[LieGroup, Array]]:
        return _portions(self.groups, xi, [group.dimension for group in self.groups])

    def _fibres(self, x: Array, xi: Array) -> list[tuple[LieGroup, Array, Array]]:
        pairs = zip(self._elements(x), self._velocities(xi), strict=True)
        return [(group, element, velocity) for (group, element), (_, velocity) in pairs]

    def __repr__(self) -> str:
        return f"FramedPairGroupoid({', '.join(map(repr, self.groups))})"


def _portions(
    groups: tuple[LieGroup, ...], vector: Array, sizes: list[int]
) -> list[tuple[LieGroup, Array]]:
    stops = np.cumsum(sizes).tolist()
    return [
        (group, vector[..., stop - size : stop])
        for group, size, stop in zip(groups, sizes, stops, strict=True)
    ]
