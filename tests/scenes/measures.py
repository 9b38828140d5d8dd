"""How the tests of this folder measure: solutions by hand, orders, energy, agreement of models."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from full_models import FullModel
from scipy.integrate import solve_ivp

import groupoid_gni as gni

PRECISE = gni.ReferenceFlow(rtol=1e-12)


def hat(w: Any) -> Any:
    """The matrix of w x."""
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def quarter_turn(v: Any) -> Any:
    """J v in the plane."""
    return np.array([-v[1], v[0]])


def by_hand(rate: Callable[[float, Any], Any], start: Any, times: Any) -> Any:
    """Equations written in a test, solved by DOP853 and read at ``times``, (n, size)."""
    done = solve_ivp(
        rate, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=3e-14, atol=1e-14
    )
    assert done.success
    return done.y.T


def quietly(system: Any, start: Any, **options: Any) -> gni.Trajectory:
    """``integrate`` without the warning of the parasitic mode, which has tests of its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", gni.ParasiticModeWarning)
        return gni.integrate(system, start, **options)


def end_errors(
    scene: gni.scenes.Scene, method: Any, end: float, counts: list[int], truth: Any
) -> Any:
    """Largest errors of base and velocity at ``end``; truth : (base, velocity) there."""
    errors = []
    for n in counts:
        run = quietly(
            scene.system, scene.start, step=end / n, n_steps=n, method=method, save_every=n
        )
        gaps = [run.base[-1] - truth[0], run.velocities[-1] - truth[1]]
        errors.append(np.max(np.abs(np.concatenate(gaps))))
    return np.array(errors)


def slope(counts: Any, errors: Any) -> float:
    """Order: minus the slope of log error over log count, by least squares."""
    return -float(np.polyfit(np.log(counts), np.log(errors), 1)[0])


def change(values: Any) -> float:
    """Largest change since the first value, relative to its size."""
    return float(np.max(np.abs(values - values[0])) / np.abs(values[0]))


def gap_to_full(scene: gni.scenes.Scene, full: FullModel, **options: Any) -> float:
    """Largest difference of a run of the scene and one of its full model, node by node."""
    run = quietly(scene.system, scene.start, **options)
    base, velocities = full.motion(quietly(full.system, full.start, **options))
    return max(
        np.max(np.abs(base - run.base), initial=0.0), np.max(np.abs(velocities - run.velocities))
    )
