"""The trivial Atiyah groupoid M x M x G: base motion and group motion side by side.

Sections 7.2 to 7.4 of the paper: reduced systems with shape in R^n and symmetry group G.
"""

from __future__ import annotations

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.pair_groupoid import PairGroupoid
from groupoid_gni.groupoids.product_groupoid import ProductGroupoid


class AtiyahGroupoid(ProductGroupoid):
    """R^n x R^n x G => R^n, retract(x, (v, eta)) = (x, x + v, tau(eta)).

    Components: base part v, then group part eta. Its pose is the group element, so that
    W_{k+1} = W_k tau(eta) (left) or tau(eta) W_k (right) reconstructs the motion on P.

    Parameters
    ----------
    base_dim : int
        n.
    group : LieGroup
    """

    def __init__(self, base_dim: int, group: LieGroup) -> None:
        if not isinstance(group, LieGroup):
            raise InputError(
                f"AtiyahGroupoid(base_dim, group): group must be a LieGroup such as SO3(), "
                f"got {type(group).__name__}."
            )
        super().__init__(PairGroupoid(base_dim), group)
        self.base_dim = base_dim
        self.group = group

    def __repr__(self) -> str:
        return f"AtiyahGroupoid(base_dim={self.base_dim}, group={self.group!r})"
