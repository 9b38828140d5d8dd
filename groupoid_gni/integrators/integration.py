"""``integrate``: check the request, choose the road, report how it ended."""

from __future__ import annotations

from typing import Literal

from groupoid_gni.array_types import ArrayLike
from groupoid_gni.errors import InputError, StepFailure
from groupoid_gni.integrators.marching import run_steps
from groupoid_gni.integrators.methods import Method, ReferenceFlow
from groupoid_gni.integrators.requests import (
    checked_controls,
    checked_count,
    checked_method,
    checked_pose,
    checked_start,
    checked_step,
    checked_whole,
)
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory


def integrate(
    system: MechanicalSystem,
    start: State,
    *,
    step: float,
    t_end: float | None = None,
    n_steps: int | None = None,
    method: Method | None = None,
    save_every: int = 1,
    reconstruct: ArrayLike | bool | None = None,
    controls: ArrayLike | None = None,
    compile: bool = True,
    progress: bool = False,
    on_failure: Literal["raise", "return"] = "raise",
) -> Trajectory:
    """Integrate a system from a start.

    Parameters
    ----------
    system, start : the system and a ``system.state(base, velocity)``.
    step : step size h; negative runs backwards.
    t_end or n_steps : one of the two; ``t_end`` must be a whole number of steps.
    method : ``GNI()`` (default), a discrete Lagrangian such as ``Rattle()``,
        ``DiscreteLagrangeDAlembert()``, ``ReferenceFlow()``.
    save_every : keep every n-th node (and the last).
    reconstruct : a pose W_0 (or True for the identity): accumulate ``W_{k+1} = W_k g_k`` in the
        loop and store it with the nodes.
    controls : (steps, inputs) control inputs of a system with ``controls``, constant over each
        step; one row is used for every step.
    compile : False runs the same expressions through CasADi's evaluator.
    progress : show a progress bar.
    on_failure : "raise" raises StepFailure with the part computed so far as ``.result``;
        "return" returns that part with ``success == False``.

    Returns
    -------
    Trajectory. Ctrl-C also returns the part computed so far, with outcome INTERRUPTED.

    Raises
    ------
    InputError : before anything is run.  StepFailure : see ``on_failure``.
    """
    method = checked_method(method)
    if on_failure not in ("raise", "return"):
        raise InputError(f'on_failure must be "raise" or "return", not {on_failure!r}')
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"system must be a MechanicalSystem, not {type(system).__name__}")
    h = checked_step(step)
    n = checked_count(h, t_end, n_steps)
    every = checked_whole("save_every", save_every, 1)
    state = checked_start(system, start)
    pose = checked_pose(system, state, reconstruct)
    inputs = checked_controls(system, controls, n)
    if isinstance(method, ReferenceFlow):
        from groupoid_gni.integrators.reference_flow import integrate_reference

        run = integrate_reference(
            system, state, h, n, method, every, pose, inputs, compile, progress
        )
    else:
        run = run_steps(system, state, h, n, method, every, pose, inputs, compile, progress)
    if run.outcome < 0 and on_failure == "raise":
        raise StepFailure(run.message, run)
    return run
