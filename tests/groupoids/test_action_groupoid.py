"""Directions moved by rotations: sources, targets, anchor, restoration, refused actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SO3, ActionGroupoid, PairGroupoid


def seen_from_the_body(q: Any, rotation: Any) -> Any:
    return q @ rotation


def length_defect(q: Any) -> Any:
    return np.abs((q * q).sum(axis=-1) - 1)


def one_newton_step(q: Any) -> Any:
    return q * (3 - (q * q).sum(axis=-1, keepdims=True)) / 2


def test_the_heavy_top_groupoid() -> None:
    space = ActionGroupoid(
        SO3(), seen_from_the_body, [0.0, 0.0, 1.0],
        base_defect=length_defect, restore_base=one_newton_step,
    )
    x, w = np.array([0.48, -0.6, 0.64]), np.array([0.3, 0.2, -0.5])
    np.testing.assert_allclose(space.anchor(x) @ w, np.cross(x, w), atol=1e-16)
    g = space.retract(x, w)
    np.testing.assert_allclose(space.target(g), SO3().cay(w).T @ x, atol=1e-16)
    assert space.base_defect(1.001 * x) > 1e-3
    assert space.base_defect(space.restore_base(1.001 * x)) < 1e-5
    np.testing.assert_allclose(space.restore_arrow(g), g, atol=1e-15)
    assert repr(space).endswith("base_size=3)")


def test_refused_definitions() -> None:
    with pytest.raises(InputError, match="needs a LieGroup"):
        ActionGroupoid(PairGroupoid(1), seen_from_the_body, [1.0])
    with pytest.raises(InputError, match=r"has shape \(2,\)"):
        ActionGroupoid(SO3(), lambda q, rotation: q[:2], [0.0, 0.0, 1.0])
