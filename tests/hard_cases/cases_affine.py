"""Affine constraints with a strong drift, and constraints that are integrable by mistake."""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np
from hard_case import HardCase, Verdict, quietly, shared, verdict, violation

import groupoid_gni as gni
from groupoid_gni.diagnostics import moving_energy

TABLE, HOLONOMIC = "FIELD 4 #20", "FIELD 4 #21"


def turning(x: Any, p: Any) -> Any:
    """The symmetry of the table, in space velocities."""
    return p.Theta * gni.array([-x[1], x[0], 0.0, 0.0, 1.0])


def turning_in_the_body(x: Any, p: Any) -> Any:
    """The same for a ball in its body frame: R^T e3."""
    return p.Theta * gni.array([-x[1], x[0], x[8], x[9], x[10]])


def table(
    theta: float, place: tuple[float, float], h: float, order: int, homogeneous: bool
) -> Verdict:
    """Energy, moving energy and, for the homogeneous ball, the exact motion."""
    options: dict[str, Any] = {"table": theta, "position": place, "velocity": (0.3, -0.4)}
    if homogeneous:
        scene = shared(gni.scenes.rolling_ball(mass=1.7, radius=0.8, inertia=0.61, **options))
    else:
        scene = shared(gni.scenes.inhomogeneous_ball(mass=1.7, radius=0.8, **options))
    run = quietly(scene.system, scene.start, step=h, t_end=5.0, method=gni.GNI(order),
                  save_every=round(0.01 / h))  # fmt: skip
    energy = run.energy()
    kept = moving_energy(run, turning if homogeneous else turning_in_the_body)
    size = float(np.max(np.abs(energy)))
    moving = float(np.ptp(kept.values)) / size
    told = (f"energy changes by {float(np.ptp(energy)) / size:.0e} of its size, the moving energy "
            f"by {moving:.0e}; constraint {violation(run):.0e}")  # fmt: skip
    conditions = [kept.symmetry.holds, moving < (1e-11 if homogeneous else 1e-5),
                  violation(run) < 1e-13]  # fmt: skip
    if scene.exact is not None:
        exact = scene.exact(run.times)[0]
        error = float(np.max(np.abs(run.base - exact)) / np.max(np.abs(exact)))
        told += f"; error {error:.0e} of the way"
        conditions.append(error < 2e-4)
    return verdict(told, *conditions)


def far_out(theta: float, place: tuple[float, float], h: float) -> Verdict:
    """So far out that the ball turns by many radians a step: refused, with a step."""
    scene = shared(gni.scenes.rolling_ball(table=theta, position=place))
    run = quietly(scene.system, scene.start, step=h, t_end=10.0, on_failure="return")
    turn = h * float(np.max(np.abs(scene.start.velocity[2:])))
    return verdict(
        f"{turn:.0f} radians a step: {run.outcome.name}, {run.message.rsplit(': ', 1)[-1]}",
        run.outcome is gni.Outcome.LEFT_DOMAIN, "use a step below" in run.message,
    )  # fmt: skip


def integrable(n: int, scale: float, steps: int) -> Verdict:
    """x' + sum z_i z_i' = 0 is d(x + |z|^2/2) = 0: told by check_system; drift off the leaf."""

    def constraint(q: Any, p: Any) -> Any:
        return gni.array([[1.0, *np.zeros(n), *q[n + 1 :]]])

    system = gni.MechanicalSystem(
        gni.PairGroupoid(2 * n + 1),
        metric=np.eye(2 * n + 1),
        constraints=constraint,
        potential=lambda q, p: (q @ q + (q[1 : n + 1] ** 2) @ (q[n + 1 :] ** 2)) / 2,
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gni.verification.check_system(system, examples=5)
    told = [str(w.message) for w in caught if "integrable" in str(w.message)]
    rng = np.random.default_rng(21)
    q, v = scale * rng.normal(size=(2, 2 * n + 1))
    start = system.state(q, v, project_start=True)
    drifts = []
    for h in (0.1, 0.05):
        run = quietly(system, start, step=h, n_steps=round(steps * 0.1 / h))
        leaf = run.base[:, 0] + np.sum(run.base[:, n + 1 :] ** 2, axis=1) / 2
        drifts.append(float(np.max(np.abs(leaf - leaf[0]))))
    return verdict(
        f"check_system warns: {bool(told)}; off the leaf by {drifts[0]:.1e}, {drifts[1]:.1e} at "
        f"h = 0.1, 0.05 (t = {steps * 0.1:g}); constraint {violation(run):.0e}",
        bool(told), violation(run) < 1e-13, drifts[0] < 0.05, drifts[1] < 0.5 * drifts[0],
    )  # fmt: skip


def not_integrable(n: int) -> Verdict:
    """The counterpart with y_i in place of z_i: no such warning."""

    system = gni.MechanicalSystem(
        gni.PairGroupoid(2 * n + 1),
        metric=np.eye(2 * n + 1),
        constraints=lambda q, p: gni.array([[1.0, *np.zeros(n), *q[1 : n + 1]]]),
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gni.verification.check_system(system, examples=5)
    told = [str(w.message) for w in caught if "integrable" in str(w.message)]
    return verdict(f"{len(told)} warnings", not told)


STRONG = "the affine term dominates, the energy is not kept"
CASES = [
    *(
        HardCase(
            f"table at Theta = {theta:g}, start {place}, h = {h:g}, order {order}", STRONG, TABLE,
            "moving energy to 1e-11 of the energy; the exact motion to 2e-4",
            partial(table, theta, place, h, order, True),
        )
        for theta, place, h, order in (
            (30.0, (1.0, 1.0), 0.001, 2), (30.0, (1.0, 1.0), 0.01, 6),
            (-30.0, (20.0, -10.0), 0.0005, 2), (0.7, (1e3, 0.0), 0.0005, 2),
        )
    ),
    *(
        HardCase(
            f"table at Theta = {theta:g}, start {place}, h = {h:g}", STRONG, TABLE,
            "LEFT_DOMAIN, with the step to use", partial(far_out, theta, place, h),
        )
        for theta, place, h in ((-30.0, (1e3, -2e3), 0.001), (0.7, (1e6, 0.0), 0.0005))
    ),
    *(
        HardCase(
            f"inhomogeneous ball, Theta = {theta:g}, start {place}, h = {h:g}, order 6", STRONG,
            TABLE, "moving energy to 1e-5 of the energy, constraint at round-off",
            partial(table, theta, place, h, 6, False),
        )
        for theta, place, h in ((30.0, (0.5, 0.2), 0.002), (-8.0, (5.0, -3.0), 0.005))
    ),
    *(
        HardCase(
            f"integrable constraint, n = {n}, scale {scale:g}",
            "holonomic by mistake: nothing says so, and the leaf is left", HOLONOMIC,
            "check_system warns; the leaf is kept to order 2 only",
            partial(integrable, n, scale, steps),
        )
        for n, scale, steps in ((1, 0.5, 1000), (3, 0.4, 1000))
    ),
    HardCase("the same with y_i: not integrable, n = 3", "the negative control", HOLONOMIC,
             "no warning", partial(not_integrable, 3)),
]  # fmt: skip
