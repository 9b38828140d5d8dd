"""Lie groupoids: seven functions, and everything that follows from them by differentiation.

Takes a subclass's seven functions, gives anchor, trivialised tangents, bracket and half arrows.
Sections 8.1 and 8.2 of the paper; the trivialised tangents generalise definition 9.1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, wraps
from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike, FloatArray
from groupoid_gni.errors import InputError, NotComposableError
from groupoid_gni.expressions import is_recorded, record
from groupoid_gni.groupoids.components import batch_shape

COMPOSABLE_GAP = 1e-10
"""Relative gap allowed between target(first) and source(then)."""

HALF_ITERATIONS = 6
"""Corrections made by the derived half arrow; fixed, so that the iteration can be recorded."""


class LieGroupoid(ABC):
    """A Lie groupoid G => Q with a symmetric retraction of its algebroid AG.

    Arrows compose in diagrammatic order: ``multiply(g, h)`` is first g, then h, and exists when
    ``target(g) = source(h)``. Base points and arrows are flat arrays, ambient coordinates allowed;
    ``xi`` are the components of an element of A_x G in a frame e_a(x).

    Checklist for a new groupoid. Subclass, write the seven functions with plain NumPy, and set
    two attributes (in the class, in ``__init__`` or as properties; ``super().__init__()`` is not
    needed). Each function gets 1-d arrays; those that also take leading batch axes may be called
    on batches.

    1. ``source(g)``, ``target(g)`` : (arrow_size,) -> (base_size,)
    2. ``identity(x)`` : (base_size,) -> (arrow_size,)
    3. ``multiply(g, h)`` : two arrows -> the arrow from source(g) to target(h). Do not check
       ``target(g) = source(h)``: this class does, and raises NotComposableError.
    4. ``inverse(g)`` : the arrow from target(g) to source(g)
    5. ``retract(x, xi)`` : (base_size,), (rank,) -> an arrow with source x;
       ``retract(x, 0) = identity(x)`` and, with x' its target,
       ``inverse(retract(x, xi)) = retract(x', -xi)``
    6. ``lift(g)`` : the components xi with ``retract(source(g), xi) = g``; among all arrows,
       zero for identities only, as equality of arrows is judged by it
    7. ``rank`` (int) and ``example_base_point`` (1-d array, a point of Q)

    Closed forms can be compared with those of ``gni.DerivedGroupoid(MyGroupoid())``.

    Everything else below is derived by differentiating the seven functions, recorded once, and may
    be overridden by a closed form for speed; ``DerivedGroupoid`` ignores such closed forms.

    Attributes
    ----------
    rank : int
        Dimension of a fibre A_x G.
    example_base_point : ndarray, shape (base_size,)
        Any point of Q, used for sizes and for checks.
    """

    rank: int
    example_base_point: Any

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if "multiply" in cls.__dict__:
            cls._multiply_unchecked = cls.__dict__["multiply"]  # type: ignore[method-assign]
            cls.multiply = _with_composability_check(cls.multiply)  # type: ignore[method-assign]

    # The seven functions.

    @abstractmethod
    def source(self, g: Array) -> Array:
        """Give alpha(g): arrows (..., arrow_size) -> base points (..., base_size)."""

    @abstractmethod
    def target(self, g: Array) -> Array:
        """Give beta(g): arrows (..., arrow_size) -> base points (..., base_size)."""

    @abstractmethod
    def identity(self, x: Array) -> Array:
        """Give epsilon(x), the identity arrow at x: (..., base_size) -> (..., arrow_size)."""

    @abstractmethod
    def multiply(self, g: Array, h: Array) -> Array:
        """Compose two arrows that meet, first g and then h.

        g, h : ndarray, shape (..., arrow_size), with target(g) = source(h).
        Returns the arrow from source(g) to target(h), shape (..., arrow_size).
        Raises NotComposableError on floats when the arrows do not meet.
        """

    @abstractmethod
    def inverse(self, g: Array) -> Array:
        """Give the inverse arrow, from target(g) to source(g), shape (..., arrow_size)."""

    @abstractmethod
    def retract(self, x: Array, xi: Array) -> Array:
        """Map xi in A_x G, shape (..., rank), to an arrow with source x, shape (..., arrow_size).

        Laws: retract(x, 0) = identity(x); inverse(retract(x, xi)) = retract(target, -xi).
        """

    @abstractmethod
    def lift(self, g: Array) -> Array:
        """Invert ``retract`` near the identities: arrows (..., arrow_size) -> xi (..., rank)."""

    # Sizes.

    @property
    def base_size(self) -> int:
        """Number of (ambient) coordinates of a base point."""
        for fact in ("rank", "example_base_point"):
            if not hasattr(self, fact):
                raise InputError(
                    f"{self!r} has no {fact}: a LieGroupoid must set rank (an int) and "
                    f"example_base_point (a 1-d array), in the class or in __init__."
                )
        shape = np.shape(self.example_base_point)
        if len(shape) != 1:
            raise InputError(
                f"{self!r}: example_base_point has shape {shape}; it must be one base point, "
                f"a 1-d array such as np.zeros(3) (np.zeros(0) over a point)."
            )
        return shape[0]

    @cached_property
    def arrow_size(self) -> int:
        """Number of (ambient) coordinates of an arrow."""
        base_point = np.asarray(self.example_base_point, dtype=np.float64)
        return int(np.shape(self.identity(base_point))[-1])

    # Derived by differentiation; closed forms may override.

    def anchor(self, x: Array) -> Array:
        """Give rho(x) = d/dxi target(retract(x, xi)) at xi = 0, shape (..., base_size, rank).

        Source: section 8.1, rho(X)(x) = (T beta)(X(x)).
        """
        return self._recorded_anchor(x, np.zeros(self.rank))

    def trivialised_tangent_plus(self, x: Array, xi: Array) -> Array:
        """Give B+ = d/de lift(multiply(g, retract(target(g), e))) at e = 0, g = retract(x, xi).

        Shape (..., rank, rank). Left group: dtau^{-1}_{-xi}; right group: dtau^{-1}_{xi}
        (definition 9.1). Law: B+ = -B- Ad_g (lemma 9.5).
        """
        return self._recorded_plus(x, xi, np.zeros(self.rank))

    def trivialised_tangent_minus(self, x: Array, xi: Array) -> Array:
        """Give B- = d/de lift(multiply(inverse(retract(x, e)), g)) at e = 0, g = retract(x, xi).

        Shape (..., rank, rank). Left group: -dtau^{-1}_{xi}; right group: -dtau^{-1}_{-xi}.
        """
        return self._recorded_minus(x, xi, np.zeros(self.rank))

    def coadjoint(self, x: Array, xi: Array) -> Array:
        """Give T = -B+^T B-^{-T}, which carries momenta along g = retract(x, xi): p' = T p.

        Shape (..., rank, rank). T is dual to Ad of the bisection with the constant components xi,
        ``<T p, Ad_g e> = <p, e>``. Left group: Ad_tau(xi)^T; right group: Ad_tau(-xi)^T (lemma
        9.5).
        """
        minus = np.swapaxes(self.trivialised_tangent_minus(x, xi), -1, -2)
        plus = np.swapaxes(self.trivialised_tangent_plus(x, xi), -1, -2)
        return -plus @ np.linalg.inv(minus)

    def bracket(self, x: Array) -> Array:
        """Give the structure functions C, [e_a, e_b] = C[c, a, b] e_c, of the algebroid.

        Shape (..., rank, rank, rank), index order (result, a, b):
        [e_a, e_b] = D_xi(B+ e_b) e_a - D_xi(B+ e_a) e_b at xi = 0; minus the matrix bracket on a
        right group. Laws: antisymmetry, and the anchor maps it to the bracket of vector fields.
        """
        change = self._recorded_plus_change(x, np.zeros(self.rank))  # (..., c, b, a)
        return np.swapaxes(change, -1, -2) - change

    def ad_star(self, x: Array, xi: Array, p: Array) -> Array:
        """Give <p, [xi, e_a]>, the rate of the momentum p along xi, shape (..., rank).

        From ``bracket``, whose rank^3 entries large groupoids had better not write down.
        """
        return np.einsum("...c,...cab,...a->...b", p, self.bracket(x), xi)

    def half(self, x: Array, xi: Array) -> Array:
        """Give eta with multiply(retract(x, eta), retract(x', eta)) = retract(x, xi).

        x' is the target of the first half; shape (..., rank). See ``half_by_iteration``.
        """
        return self._recorded_half(x, xi)

    @cached_property
    def _recorded_anchor(self) -> Callable[..., Array]:
        def target_of(x: Array, xi: Array) -> Array:
            return self.target(self.retract(x, xi))

        inputs = {"x": (self.base_size,), "xi": (self.rank,)}
        return record(target_of, inputs, (self.base_size,), name="target_of").derivative(1)

    @cached_property
    def _recorded_plus(self) -> Callable[..., Array]:
        def lengthened(x: Array, xi: Array, e: Array) -> Array:
            g = self.retract(x, xi)
            return self.lift(self.multiply(g, self.retract(self.target(g), e)))

        return record(lengthened, self._perturbed, (self.rank,), name="lengthened").derivative(2)

    @cached_property
    def _recorded_minus(self) -> Callable[..., Array]:
        def shortened(x: Array, xi: Array, e: Array) -> Array:
            return self.lift(self.multiply(self.inverse(self.retract(x, e)), self.retract(x, xi)))

        return record(shortened, self._perturbed, (self.rank,), name="shortened").derivative(2)

    @cached_property
    def _recorded_plus_change(self) -> Callable[..., Array]:
        inputs = {"x": (self.base_size,), "xi": (self.rank,)}
        shape = (self.rank, self.rank)
        return record(self.trivialised_tangent_plus, inputs, shape, name="plus").derivative(1)

    @cached_property
    def _recorded_half(self) -> Callable[..., Array]:
        def half(x: Array, xi: Array) -> Array:
            g = self.retract(x, xi)
            structure = self.bracket(x)

            def remainder(eta: Array) -> Array:
                return self.lift(self.multiply(self.inverse(self.retract(x, eta)), g))

            def commutator(a: Array, b: Array) -> Array:
                return (structure @ b) @ a

            return half_by_iteration(xi, remainder, commutator)

        inputs = {"x": (self.base_size,), "xi": (self.rank,)}
        return record(half, inputs, (self.rank,), name="half")

    @property
    def _perturbed(self) -> dict[str, tuple[int, ...]]:
        return {"x": (self.base_size,), "xi": (self.rank,), "e": (self.rank,)}

    # Sizes of arrows, distance from the base manifold, and the way back to it.

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the dimensionless size of an arrow, shape (...,); steps with reach >= 1 are refused.

        Zero where the retraction is global, which is the default.
        """
        return np.zeros(np.broadcast_shapes(batch_shape(x), batch_shape(xi)))

    def base_defect(self, x: Array) -> Array:
        """Give how far the coordinates x are from the base manifold, shape (...,).

        Default: the largest entry of ``|source(identity(x)) - x|``, which is zero on Q.
        """
        if not self.base_size:
            return np.zeros(batch_shape(x))
        return np.max(np.abs(np.asarray(self.source(self.identity(x))) - x), axis=-1)

    def restore_base(self, x: Array) -> Array:
        """Move x towards the base manifold by one Newton step; default: leave it.

        Law: changes points of the manifold by round-off only.
        """
        return x

    def restore_arrow(self, g: Array) -> Array:
        """Move the coordinates g towards the arrow manifold by one Newton step; default: none."""
        return g

    # Poses: what the reconstruction W_{k+1} = W_k g_k accumulates.

    def pose(self, arrow: Array) -> Array:
        """Give the part of an arrow that a reconstruction shows, in its natural shape.

        A matrix for a Lie group, the target for a pair groupoid; by default the arrow itself.
        """
        return arrow

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give an arrow that ends at ``base_point`` and shows ``pose``; None: the identity."""
        if pose is None:
            return self.identity(base_point)
        return np.asarray(pose)

    def split(self, x: Array) -> list[Array]:
        """Split base coordinates into the parts of Q, each in its natural shape; default [x]."""
        return [x]

    def same_arrow(self, g: FloatArray, h: FloatArray, tolerance: float = 1e-9) -> Array:
        """Tell whether two float arrows are equal, shape (...,), bool.

        They are when sources and targets agree and lift(multiply(inverse(g), h)) = 0: arrows may
        be classes with many coordinates (design 1.1), so coordinates are not compared.
        """
        ends_g = np.concatenate([self.source(g), self.target(g)], axis=-1)
        ends_h = np.concatenate([self.source(h), self.target(h)], axis=-1)
        scale = 1.0 + np.abs(ends_g).max(axis=-1, initial=0.0)
        meet = np.abs(ends_g - ends_h).max(axis=-1, initial=0.0) <= tolerance * scale
        comparable = np.where(meet[..., None], h, g)
        difference = self.lift(self._multiply_unchecked(self.inverse(g), comparable))
        return meet & (np.abs(difference).max(axis=-1, initial=0.0) <= tolerance)

    def _multiply_unchecked(self, g: Array, h: Array) -> Array:
        """``multiply`` as the subclass wrote it; set by ``__init_subclass__``."""
        return self.multiply(g, h)

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"


def half_by_iteration(
    xi: Array,
    remainder: Callable[[Array], Array],
    commutator: Callable[[Array, Array], Array],
) -> Array:
    """Find the half eta of xi: remainder(eta) = eta, where remainder is lift(first^{-1} whole).

    The update eta + m/2 + [eta, m]/4, m = remainder(eta) - eta, removes the part of the error that
    the plain mean eta + m/2 leaves: for a rotation by |xi| the error shrinks by |xi|^3/192 per
    iteration instead of sin(|xi|/4); on a groupoid whose frame turns with x, by O(|xi|^2). Six
    fixed iterations reach round-off for |xi| <= 1.
    """
    eta = xi / 2
    for _ in range(HALF_ITERATIONS):
        mismatch = remainder(eta) - eta
        eta = eta + mismatch / 2 + commutator(eta, mismatch) / 4
    return eta


def _with_composability_check(multiply: Callable[..., Array]) -> Callable[..., Array]:
    @wraps(multiply)
    def checked(self: LieGroupoid, g: Array, h: Array) -> Array:
        if not is_recorded(g, h):
            _require_composable(self, g, h)
        return multiply(self, g, h)

    return checked


def _require_composable(groupoid: LieGroupoid, g: FloatArray, h: FloatArray) -> None:
    target, source = np.asarray(groupoid.target(g)), np.asarray(groupoid.source(h))
    if target.shape[-1] == 0:  # over a point all arrows meet
        return
    gap = np.abs(target - source).max(axis=-1)
    allowed = COMPOSABLE_GAP * (1.0 + np.abs(target).max(axis=-1))
    apart = ~(gap <= allowed)  # so that NaN counts as apart
    if not np.any(apart):
        return
    member = np.unravel_index(np.argmax(apart), apart.shape)
    end, start = (np.broadcast_to(a, (*apart.shape, a.shape[-1]))[member] for a in (target, source))
    where = f" (batch member {tuple(int(i) for i in member)})" if member else ""
    raise NotComposableError(
        f"multiply(first, then) on {groupoid!r}: the arrows do not meet{where}.\n"
        f"  target(first) = {end.tolist()}\n"
        f"  source(then)  = {start.tolist()}\n"
        f"  gap {gap[member]:.1e} (allowed {np.broadcast_to(allowed, apart.shape)[member]:.1e})\n"
        f"  Usual cause: swapped arguments. Try multiply(then, first); arrows compose in "
        f"diagrammatic order, target(first) = source(then)."
    )


class DerivedGroupoid(LieGroupoid):
    """Any groupoid, with its closed forms forgotten: the oracle of those closed forms.

    Only the seven functions and the facts are taken from ``space`` (and reach, restoration, poses
    and split, which are no mathematics of the step); anchor, B+, B-, bracket and half are derived.

    Parameters
    ----------
    space : LieGroupoid
    """

    def __init__(self, space: LieGroupoid) -> None:
        if not isinstance(space, LieGroupoid):
            raise InputError(f"DerivedGroupoid needs a LieGroupoid, got {type(space).__name__}.")
        self.space = space
        self.rank = space.rank
        self.example_base_point = space.example_base_point

    def source(self, g: Array) -> Array:
        """Give the source in ``space``."""
        return self.space.source(g)

    def target(self, g: Array) -> Array:
        """Give the target in ``space``."""
        return self.space.target(g)

    def identity(self, x: Array) -> Array:
        """Give the identity arrow of ``space``."""
        return self.space.identity(x)

    def multiply(self, g: Array, h: Array) -> Array:
        """Compose two arrows of ``space``."""
        return self.space.multiply(g, h)

    def inverse(self, g: Array) -> Array:
        """Invert an arrow of ``space``."""
        return self.space.inverse(g)

    def retract(self, x: Array, xi: Array) -> Array:
        """Retract in ``space``."""
        return self.space.retract(x, xi)

    def lift(self, g: Array) -> Array:
        """Lift in ``space``."""
        return self.space.lift(g)

    def reach(self, x: Array, xi: Array) -> Array:
        """Give the reach in ``space``."""
        return self.space.reach(x, xi)

    def base_defect(self, x: Array) -> Array:
        """Give the defect in ``space``."""
        return self.space.base_defect(x)

    def restore_base(self, x: Array) -> Array:
        """Restore as ``space`` does."""
        return self.space.restore_base(x)

    def restore_arrow(self, g: Array) -> Array:
        """Restore as ``space`` does."""
        return self.space.restore_arrow(g)

    def pose(self, arrow: Array) -> Array:
        """Give the pose in ``space``."""
        return self.space.pose(arrow)

    def arrow_to(self, base_point: Array, pose: ArrayLike | None = None) -> Array:
        """Give the arrow of ``space`` that shows ``pose``."""
        return self.space.arrow_to(base_point, pose)

    def split(self, x: Array) -> list[Array]:
        """Split as ``space`` does."""
        return self.space.split(x)

    def __repr__(self) -> str:
        return f"DerivedGroupoid({self.space!r})"
