"""Integrals over the nodes of a run, by polynomials through neighbouring nodes."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import FloatArray


def cumulative_integral(times: FloatArray, values: FloatArray, points: int = 6) -> FloatArray:
    """Integral from the first node to every node, (n,).

    times : (n,), evenly spaced, the last interval excepted (runs may end between saved nodes).
    points : each interval integrates the polynomial through that many nodes around it; the error
        is O(spacing^points), one order more in the interior for an even number.
    """
    n = len(times)
    parts = np.zeros(n)
    if n == 1:
        return parts
    points = min(points, n)
    intervals = np.arange(n - 1)
    first = np.clip(intervals - (points - 2) // 2, 0, n - points)
    spacing = times[1] - times[0]
    even = abs(times[-1] - times[-2] - spacing) <= 1e-9 * abs(spacing)
    regular = np.ones(n - 1, dtype=bool) if even else first + points < n
    for offset in range(points - 1):
        chosen = intervals[regular & (intervals - first == offset)]
        if len(chosen):
            weights = _weights(np.arange(points) * spacing, offset)
            window = first[chosen][:, None] + np.arange(points)
            parts[chosen + 1] = values[window] @ weights
    for k in intervals[~regular]:
        window = slice(first[k], first[k] + points)
        parts[k + 1] = values[window] @ _weights(times[window], k - first[k])
    return np.cumsum(parts)


def _weights(nodes: FloatArray, offset: int) -> FloatArray:
    """Weights of the integral from nodes[offset] to nodes[offset + 1], exact for polynomials."""
    begin, length = nodes[offset], nodes[offset + 1] - nodes[offset]
    scaled = (nodes - begin) / length
    powers = np.arange(len(nodes))
    return np.asarray(length * np.linalg.solve(scaled ** powers[:, None], 1.0 / (powers + 1.0)))
