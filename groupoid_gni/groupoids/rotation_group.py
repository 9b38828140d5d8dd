"""What SO(2) and SO(3) share: inverse, defect and restoration of orthogonal matrices."""

from __future__ import annotations

from groupoid_gni.array_types import Array
from groupoid_gni.groupoids.components import transpose
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.orthogonality import orthogonality_defect, orthogonality_step


class RotationGroup(LieGroup):
    """SO(n) as n x n matrices."""

    def inverse_element(self, element: Array) -> Array:
        """Give the transpose."""
        return transpose(element)

    def element_defect(self, element: Array) -> Array:
        """Give the largest of |R^T R - 1| and |det R - 1|."""
        return orthogonality_defect(element)

    def restore_element(self, element: Array) -> Array:
        """Give R - R (R^T R - 1) / 2, a Newton step of the polar projection."""
        return orthogonality_step(element)
