"""The (-1)^k part of a two-step run, node by node."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.errors import InputError
from groupoid_gni.trajectory import Trajectory


def parasitic_component(run: Trajectory) -> FloatArray:
    """Momentum u_k with ``Q*(p+ - Pi) = (smooth) + (-1)^k u_k``, (n, rank), its sign included.

    The half jump ``(p+ - p-) / 2`` is that normal part; a quarter of its second difference is
    (-1)^k u_k up to O(h^3) (``run.parasitic_amplitude`` is its size relative to |p|). The sign
    makes u_k smooth, so that ``u' = -div(X) u`` can be read off. Zero for methods that have no
    impact at the nodes; NaN at the first and last node, where there is no second difference.
    Raises InputError when not every node was saved.
    """
    if np.any(np.diff(run.node_steps) != 1):
        raise InputError(
            "the parasitic component needs consecutive nodes; integrate with save_every=1 "
            "(run.parasitic_maximum includes unsaved nodes)"
        )
    normal = (run.momenta_before - run.momenta_after) / 2.0
    found = np.full(normal.shape, np.nan)
    second = (normal[2:] - 2.0 * normal[1:-1] + normal[:-2]) / -4.0
    signs = np.where(run.node_steps[1:-1] % 2, -1.0, 1.0)
    found[1:-1] = signs[:, None] * second
    return found
