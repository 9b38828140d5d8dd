"""A knife edge on the plane of awkward masses, and the words tests need to build its relatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from groupoid_gni import MechanicalSystem, PairGroupoid

MASSES = (1.3, 0.7, 2.1)
BASE = (0.3, -0.2, 0.5)


@pytest.fixture
def particle() -> Callable[..., MechanicalSystem]:
    """Build a particle in R^3 with a constant metric; keywords replace or add terms."""

    def build(**terms: Any) -> MechanicalSystem:
        space = terms.pop("space", PairGroupoid(3))
        return MechanicalSystem(space, **{"metric": np.diag(MASSES), **terms})

    return build


@pytest.fixture
def knife_edge(particle: Callable[..., MechanicalSystem]) -> MechanicalSystem:
    """One constraint that turns with y, and a spring."""
    return particle(
        constraints=lambda x, p: np.array([[1.0, 0.4 * x[1], -0.3]]),
        potential=lambda x, p: 0.5 * p.k * (x @ x),
        parameters={"k": 1.4},
    )


@pytest.fixture
def allowed_velocity() -> tuple[float, float, float]:
    """Satisfies the knife edge at BASE."""
    return (0.3 * 0.9 + 0.08 * 0.6, 0.6, 0.9)
