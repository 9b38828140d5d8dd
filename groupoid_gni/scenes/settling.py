"""The motion that sleighs, robots and Suslov bodies share: they settle on a stable direction."""

from __future__ import annotations

import numpy as np

from groupoid_gni.array_types import FloatArray


def settling_motion(
    times: FloatArray, rate: float, rising: float, fading: float
) -> tuple[FloatArray, FloatArray]:
    """The solution of ``s' = k c^2, c' = -k s c`` through (s, c) at t = 0; k = rate > 0.

    times : (n,).  rising, fading : s and c at the start, c not zero.
    Returns s, c, each (n,): with ``r^2 = s^2 + c^2``, which is constant (energy),
    ``s = r tanh(k r t + a)``, ``c = +-r sech(k r t + a)``.
    """
    radius = np.hypot(rising, fading)
    # artanh(s / r) without the cancellation near s = r
    argument = rate * radius * np.asarray(times, dtype=float) + np.arcsinh(rising / abs(fading))
    # sech without the overflow of cosh
    decay = np.exp(-np.abs(argument))
    hyperbolic_secant = 2.0 * decay / (1.0 + decay * decay)
    return radius * np.tanh(argument), np.copysign(radius, fading) * hyperbolic_secant
