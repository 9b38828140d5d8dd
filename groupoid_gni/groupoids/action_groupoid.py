"""The action groupoid Q x| G: base points moved by a group, as advected directions are.

Heavy top, Veselova and Suslov systems: x is a direction seen from the body, g the rotation step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.components import batch_shape, join
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.lie_groupoid import LieGroupoid


class ActionGroupoid(LieGroupoid):
    """Arrows (q, g) from q to action(q, g); retract(q, xi) = (q, tau(xi)).

    Law of the action: ``action(action(q, g), h) = action(q, gh)``, where gh is the group's
    ``multiply``: g h on a left group (a right action, such as q -> R^T q), h g on a right one (a
    left action, such as q -> R q). B+, B-, bracket and half are those of the group.

    Parameters
    ----------
    group : LieGroup
    action : callable
        ``action(q, element)``: base point (..., base_size) and element in its natural shape ->
        the moved base point. It must accept recorded arrays.
    example_base_point : array_like, shape (base_size,)
    base_defect, restore_base : callable, optional
        See ``LieGroupoid``; for base points on a surface, such as unit vectors.
    """

    def __init__(
        self,
        group: LieGroup,
        action: Callable[[Array, Array], Array],
        example_base_point: ArrayLike,
        *,
        base_defect: Callable[[Array], Array] | None = None,
        restore_base: Callable[[Array], Array] | None = None,
    ) -> None:
        if not isinstance(group, LieGroup):
            raise InputError(f"ActionGroupoid needs a LieGroup, got {type(group).__name__}.")
        self.group = group
        self.action = action
        self.rank = group.dimension
        self.example_base_point = np.array(example_base_point, dtype=np.float64)
        self._base_defect = base_defect
        self._restore_base = restore_base
        moved = np.shape(action(self.example_base_point, group.identity_element))
        if moved != self.example_base_point.shape:
            raise InputError(
                f"ActionGroupoid: action(example_base_point, identity) has shape {moved}, but "
                f"example_base_point has shape {self.example_base_point.shape}."
            )

    def source(self, g: Array) -> Array:
        """Give q."""
        return g[..., : self.base_size]

    def target(self, g: Array) -> Array:
        """Give action(q, g)."""
        return self.action(self.source(g), self.pose(g))

    def identity(self, x: Array) -> Array:
        """Give (q, e)."""
        return join(x, self.group.identity(x[..., :0]))

    def multiply(self, g: Array, h: Array) -> Array:
        """Give (q, g)(q', h) = (q, gh)."""
        return join(self.source(g), self.group.multiply(self._element(g), self._element(h)))

    def inverse(self, g: Array) -> Array:
        """Give (action(q, g), g^{-1})."""
        return join(self.target(g), self.group.inverse(self._element(g)))

    def retract(self, x: Array, xi: Array) -> Array:
        """Give (q, tau(xi))."""
        return join(x, self.group.retract(x[..., :0], xi))

    def lift(self, g: Array) -> Array:
        """Give tau^{-1}(g)."""
        return self.group.lift(self._element(g))

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give the group's B+."""
        return self.group.trivialised_tangent_plus(x[..., :0], xi)

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give the group's B-."""
        return self.group.trivialised_tangent_minus(x[..., :0], xi)

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give the group's coadjoint action."""
        return self.group.coadjoint(x[..., :0], xi)

    def bracket(self, x: Array) -> Array:
        """Give the group's bracket: the frame e_a is constant along Q."""
        return self.group.bracket(x[..., :0])

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give the group's."""
        return self.group.ad_star(x[..., :0], xi, p)

    def half(self, x: Array, xi: Array) -> Array:
        """Give the group's half vector."""
        return self.group.half_vector(xi)

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the group's reach."""
        return self.group.reach(x[..., :0], xi)

    def base_defect(self, x: Array) -> Array:
        """Give the defect by the function handed in, or 0."""
        return np.zeros(batch_shape(x)) if self._base_defect is None else self._base_defect(x)

    def restore_base(self, x: Array) -> Array:
        """Restore by the function handed in, or leave x."""
        return x if self._restore_base is None else self._restore_base(x)

    def restore_arrow(self, g: Array) -> Array:
        """Restore the base point and the group element."""
        element = self.group.restore_arrow(self._element(g))
        return join(self.restore_base(self.source(g)), element)

    def pose(self, arrow: Array) -> Array:
        """Give the group element in its natural shape."""
        return self.group.unflatten(self._element(arrow))

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give the arrow with element ``pose`` that ends at ``base_point``."""
        if pose is None:
            return self.identity(base_point)
        element = self.group.arrow_to(base_point[..., :0], pose)
        return self.inverse(join(base_point, self.group.inverse(element)))

    def _element(self, arrow: Array) -> Array:
        return arrow[..., self.base_size :]

    def __repr__(self) -> str:
        return f"ActionGroupoid({self.group!r}, base_size={self.base_size})"
