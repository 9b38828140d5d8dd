"""Definition 8.1: the axioms of a Lie groupoid, and what this library asks of its coordinates."""

from __future__ import annotations

from functools import partial

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import NotComposableError
from groupoid_gni.expressions import record
from groupoid_gni.groupoids import LieGroupoid
from groupoid_gni.verification.gaps import Gap, arrow_gap, gap, holds
from groupoid_gni.verification.laws import law
from groupoid_gni.verification.strategies import chain, pairs, points, triples, vectors

_FEW = "round-off of a few products and one lift"
_axiom = partial(law, "groupoid", tolerance=1e-12, reason=_FEW)


def needs_a_base(space: LieGroupoid) -> str | None:
    """Why a law about base points does not apply."""
    return None if space.base_size else "the base is a point"


@_axiom("alpha(epsilon(x)) = x", "x in Q", "Definition 8.1 (3)", draw=points,
        applies=needs_a_base)
def source_of_identity(space: LieGroupoid, x: FloatArray) -> Gap:
    """The identity arrow starts at its point."""
    return gap(space.source(space.identity(x)), x)


@_axiom("beta(epsilon(x)) = x", "x in Q", "Definition 8.1 (3)", draw=points,
        applies=needs_a_base)
def target_of_identity(space: LieGroupoid, x: FloatArray) -> Gap:
    """The identity arrow ends at its point."""
    return gap(space.target(space.identity(x)), x)


@_axiom("alpha(g h) = alpha(g)", "composable g, h", "Definition 8.1 (2)", draw=pairs,
        applies=needs_a_base)
def source_of_product(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """A product starts where its first factor does."""
    g, h = chain(space, *sample.values())
    return gap(space.source(space.multiply(g, h)), space.source(g))


@_axiom("beta(g h) = beta(h)", "composable g, h", "Definition 8.1 (2)", draw=pairs,
        applies=needs_a_base)
def target_of_product(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """A product ends where its last factor does."""
    g, h = chain(space, *sample.values())
    return gap(space.target(space.multiply(g, h)), space.target(h))


@_axiom("(g h) k = g (h k)", "composable g, h, k", "Definition 8.1 (2)", draw=triples)
def associativity(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """Brackets do not matter."""
    g, h, k = chain(space, *sample.values())
    multiply = space.multiply
    return arrow_gap(space, multiply(multiply(g, h), k), multiply(g, multiply(h, k)))


@_axiom("epsilon(alpha(g)) g = g", "g in G", "Definition 8.1 (3)", draw=vectors)
def left_unit(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """The identity at the source changes nothing."""
    (g,) = chain(space, *sample.values())
    return _gap_of_short_arrows(space, space.multiply(space.identity(space.source(g)), g), g)


@_axiom("g epsilon(beta(g)) = g", "g in G", "Definition 8.1 (3)", draw=vectors)
def right_unit(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """The identity at the target changes nothing."""
    (g,) = chain(space, *sample.values())
    return _gap_of_short_arrows(space, space.multiply(g, space.identity(space.target(g))), g)


def _gap_of_short_arrows(space: LieGroupoid, g: FloatArray, h: FloatArray) -> Gap:
    """``arrow_gap`` trusts the product and the inverse; the lifts of equal arrows agree as well."""
    same = arrow_gap(space, g, h)
    left = np.concatenate([same.left, space.lift(g)])
    return gap(left, np.concatenate([same.right, space.lift(h)]))


@_axiom("alpha(g^-1) = beta(g), beta(g^-1) = alpha(g)", "g in G", "Definition 8.1 (4)",
        draw=vectors, applies=needs_a_base)
def ends_of_inverse(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """The inverse runs backwards."""
    (g,) = chain(space, *sample.values())
    back = space.inverse(g)
    left = np.concatenate([space.source(back), space.target(back)])
    return gap(left, np.concatenate([space.target(g), space.source(g)]))


@_axiom("g g^-1 = epsilon(alpha(g))", "g in G", "Definition 8.1 (4)", draw=vectors)
def right_inverse(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """There and back is staying."""
    (g,) = chain(space, *sample.values())
    return arrow_gap(
        space, space.multiply(g, space.inverse(g)), space.identity(space.source(g))
    )


@_axiom("g^-1 g = epsilon(beta(g))", "g in G", "Definition 8.1 (4)", draw=vectors)
def left_inverse(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """Back and there is staying."""
    (g,) = chain(space, *sample.values())
    return arrow_gap(
        space, space.multiply(space.inverse(g), g), space.identity(space.target(g))
    )


@_axiom("(g h)^-1 = h^-1 g^-1", "composable g, h", "follows from Definition 8.1", draw=pairs)
def inverse_of_product(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """Inverses reverse the order."""
    g, h = chain(space, *sample.values())
    left = space.inverse(space.multiply(g, h))
    return arrow_gap(space, left, space.multiply(space.inverse(h), space.inverse(g)))


@_axiom("alpha(retract(y, xi)) = y and beta(inverse(retract(y, xi))) = y", "y in Q",
        "Definition 8.1 (1): local sections through every arrow make alpha, beta submersions",
        draw=vectors, applies=needs_a_base)
def ends_have_local_sections(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """A smooth section of alpha, and one of beta, passes through every arrow."""
    (g,) = chain(space, x, xi)
    left = np.concatenate([space.source(g), space.target(space.inverse(g))])
    return gap(left, np.concatenate([x, x]))


@law("groupoid", "multiply(g, h) raises NotComposableError", "g, h with beta(g) != alpha(h)",
     "Definition 8.1 (2): G_2", draw=pairs, tolerance=0.5, reason="true or not",
     applies=needs_a_base)
def strangers_are_refused(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """Arrows that do not meet are not multiplied."""
    g, h = chain(space, *sample.values())
    away = float(np.max(np.abs(space.target(h) - space.source(g)), initial=0.0))
    first, then = (h, g) if away > 1e-6 else (g, _started_elsewhere(space, h))
    try:
        space.multiply(first, then)
    except NotComposableError:
        return holds(True)
    return holds(False)


def _started_elsewhere(space: LieGroupoid, arrow: FloatArray) -> FloatArray:
    return np.asarray(space.retract(space.source(arrow) + 0.37, space.lift(arrow)), dtype=float)


@_axiom("recorded functions = plain NumPy functions", "composable g, h",
        "the machine code is made from the recording", draw=pairs, share=0.3)
def recorded_equals_plain(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """Recording changes no number."""
    x, xi = sample["x"], sample["xi"]
    g, h = chain(space, *sample.values())
    calls: dict[str, tuple[FloatArray, ...]] = {
        "source": (g,), "target": (g,), "identity": (x,), "multiply": (g, h), "inverse": (g,),
        "retract": (x, xi), "lift": (g,),
    }
    left, right = [], []
    for name, arguments in calls.items():
        function = getattr(space, name)
        plain = np.asarray(function(*arguments), dtype=float)
        inputs = {f"input_{i}": a.shape for i, a in enumerate(arguments)}
        recorded = record(function, inputs, plain.shape, name=name)(*arguments)
        left.append(np.ravel(recorded))
        right.append(np.ravel(plain))
    return gap(np.concatenate(left), np.concatenate(right))


@law("groupoid", "base_defect(beta(g)) = 0", "g in G with alpha(g) in Q", "Q is where arrows end",
     draw=vectors, tolerance=1e-12, reason=_FEW, applies=needs_a_base)
def arrows_end_on_the_base(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """No arrow leaves Q."""
    (g,) = chain(space, *sample.values())
    return gap(np.abs(space.base_defect(space.target(g))), 0.0)


@_axiom("restore_base(x) = x, restore_arrow(g) = g", "x in Q, g in G",
        "restoration removes round-off only", draw=vectors)
def restoration_moves_nothing(space: LieGroupoid, x: FloatArray, xi: FloatArray) -> Gap:
    """What is in place stays there."""
    (g,) = chain(space, x, xi)
    kept = arrow_gap(space, np.asarray(space.restore_arrow(g), dtype=float), g)
    return gap(
        np.concatenate([space.restore_base(x), kept.left]), np.concatenate([x, kept.right])
    )


@_axiom("target(arrow_to(x, pose(g))) = x, pose(arrow_to(x, pose(g))) = pose(g)",
        "x = beta(g)", "Remark 7.2: reconstruction W' = W g", draw=vectors)
def poses_make_arrows(space: LieGroupoid, **sample: FloatArray) -> Gap:
    """An arrow can be made that ends at x and shows a given pose."""
    (g,) = chain(space, *sample.values())
    pose, end = np.asarray(space.pose(g), dtype=float), np.asarray(space.target(g), dtype=float)
    arrow = np.asarray(space.arrow_to(end, pose), dtype=float)
    left = np.concatenate([space.target(arrow), np.ravel(space.pose(arrow))])
    return gap(left, np.concatenate([end, np.ravel(pose)]))


# Those that compare points only come first: equality of arrows rests on inverse and lift.
GROUPOID_LAWS = (
    source_of_identity, target_of_identity, source_of_product, target_of_product,
    ends_of_inverse, ends_have_local_sections, arrows_end_on_the_base, strangers_are_refused,
    left_inverse, right_inverse, left_unit, right_unit, associativity, inverse_of_product,
    recorded_equals_plain, restoration_moves_nothing, poses_make_arrows,
)
