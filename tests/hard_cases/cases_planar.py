"""Sleighs, skates and Suslov bodies: exact motions, forward and backward in time."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from hard_case import (
    EXACT,
    HardCase,
    Verdict,
    distance,
    energy_error,
    numbers,
    orders,
    quietly,
    shared,
    verdict,
    violation,
    warned,
)

import groupoid_gni as gni

METHODS = (gni.GNI(), gni.GNI(6), gni.GNI(2, EXACT))


def settled(scene: gni.scenes.Scene, t_end: float, h: float) -> Verdict:
    """Long after settling: energy, no overshoot, and the exact end."""
    scene = shared(scene)
    told, fine = [], []
    for method in METHODS:
        run = quietly(scene.system, scene.start, step=h, t_end=t_end, method=method)
        exact = scene.exact(run.times)[1]
        gap = float(np.max(np.abs(run.velocities - exact)))
        end = float(np.max(np.abs(run.velocities[-1] - exact[-1])))
        told.append(f"{method}: energy {energy_error(run):.0e}, error {gap:.0e}, at the end "
                    f"{end:.0e}")  # fmt: skip
        fine.append(gap < (1e-9 if method == gni.GNI(6) else 20.0 * h**2))
        fine += [energy_error(run) < 1e-11, end < 1e-9, violation(run) < 1e-14]
    return verdict("; ".join(told), *fine)


def two_step_reverses(scene: gni.scenes.Scene, t_end: float, h: float) -> Verdict:
    """The parasitic mode of the two-step method turns the sleigh round, with an alarm."""
    scene = shared(scene)
    run, names = warned(scene.system, scene.start, step=h, t_end=t_end, method=gni.Rattle())
    exact = scene.exact(run.times)[1]
    gap = float(np.max(np.abs(run.velocities - exact)))
    amplitude = float(run.parasitic_maximum[-1])
    return verdict(f"error {gap:.1f}, parasitic amplitude {amplitude:.1g}; {', '.join(names)}",
                   gap > 0.5, names == ["ParasiticModeWarning"])  # fmt: skip


def backward(scene: gni.scenes.Scene, t_end: float, h: float, method: Any) -> Verdict:
    """From the settled end back to the start, where what is left of the turning grows again."""
    scene = shared(scene)
    there = quietly(scene.system, scene.start, step=h, t_end=t_end, method=method)
    turned = scene.system.state(*there.final_state)
    back = quietly(scene.system, turned, step=-h, n_steps=round(t_end / h), method=method)
    start, exact = scene.start.velocity, scene.exact(there.times)[1]
    turning = np.abs(exact[:, 0])
    amplified = float(turning.max() / turning[-1])
    gap = float(np.max(np.abs(back.velocities[-1] - start)))
    return verdict(
        f"back at the start to {gap:.0e}, the turning grown by {amplified:.0e}; energy "
        f"{energy_error(back):.0e}",
        gap < 1e-11, amplified > 1e5, energy_error(back) < 1e-11,
    )  # fmt: skip


def skate(framed: bool, slope: float, spin: float, speed: float) -> tuple[Any, Any, Any]:
    """A skate on an incline, g sin(alpha) = slope along x; system, start, exact (x, y, heading).

    With heading ``phi = w t`` the speed along the blade is ``u = u0 + (s/w) sin phi``, so
    ``x = u0 sin(phi)/w + s sin^2(phi)/(2 w^2)``,
    ``y = u0 (1 - cos phi)/w + s (phi - sin phi cos phi)/(2 w^2)``: a cycloid.
    """
    inertia, mass = 0.7, 1.3
    if framed:
        system = gni.MechanicalSystem(
            gni.FramedPairGroupoid(gni.SE2()),
            metric=np.diag([inertia, mass, mass]),
            constraints=[[0.0, 0.0, 1.0]],
            potential=lambda x, p: -p.m * p.s * x[2],
            parameters={"m": mass, "s": slope},
        )
        start = system.state(np.eye(3).ravel(), [spin, speed, 0.0])

        def place(run: gni.Trajectory) -> Any:
            return run.base[:, [2, 5]]
    else:
        system = gni.MechanicalSystem(
            gni.PairGroupoid(3),
            metric=np.diag([mass, mass, inertia]),
            constraints=lambda q, p: np.array([[-np.sin(q[2]), np.cos(q[2]), 0.0]]),
            potential=lambda q, p: -p.m * p.s * q[0],
            parameters={"m": mass, "s": slope},
        )
        start = system.state([0.0, 0.0, 0.0], [speed, 0.0, spin])

        def place(run: gni.Trajectory) -> Any:
            return run.base[:, :2]

    def exact(t: Any) -> Any:
        phi = spin * t
        x = speed * np.sin(phi) / spin + slope * np.sin(phi) ** 2 / (2 * spin**2)
        y = speed * (1 - np.cos(phi)) / spin
        return np.stack([x, y + slope * (phi - np.sin(phi) * np.cos(phi)) / (2 * spin**2)], 1)

    return system, start, (place, exact)


def cycloid(framed: bool, slope: float, spin: float, speed: float) -> Verdict:
    """Order on the cycloid, and a blade that turns by one radian a step."""
    system, start, (place, exact) = skate(framed, slope, spin, speed)
    t_end, errors, sixth = 8.0 / spin, [], []
    for n in (40, 80, 160):
        run = quietly(system, start, step=t_end / n, n_steps=n)
        errors.append(float(np.max(np.abs(place(run) - exact(run.times)))))
        run = quietly(system, start, step=t_end / n, n_steps=n, method=gni.GNI(6))
        sixth.append(float(np.max(np.abs(place(run) - exact(run.times)))))
    fast = quietly(system, start, step=1.0 / spin, n_steps=1000, method=gni.GNI(6))
    far = float(np.max(np.abs(place(fast) - exact(fast.times))))
    reach = float(np.max(np.abs(exact(fast.times))))
    return verdict(
        f"order 2 {numbers(errors)} ({orders(errors)[-1]:.2f}), order 6 {numbers(sixth)} "
        f"({orders(sixth)[0]:.2f}); one radian a step, 1000 steps: {far / reach:.0e} of the way",
        abs(orders(errors)[-1] - 2.0) < 0.1, orders(sixth)[0] > 5.5, far < 1e-4 * reach,
    )  # fmt: skip


def suslov_body(inertia: Any, axis: Any, spin: Any, h: float) -> Verdict:
    """Order 2 and 6 against the exact heteroclinic motion."""
    scene = shared(gni.scenes.suslov(inertia, axis, spin))
    truth, errors = None, {2: [], 6: []}
    for order, found in errors.items():
        for step in (h, h / 2):
            run = quietly(scene.system, scene.start, step=step, t_end=8.0,
                          method=gni.GNI(order))  # fmt: skip
            truth = scene.exact(run.times)
            found.append(distance(run, *truth))
    turned = float(np.max(np.abs(truth[1][-1] - truth[1][0])))
    exact = quietly(scene.system, scene.start, step=h, t_end=200.0, method=gni.GNI(2, EXACT))
    return verdict(
        f"errors {numbers(errors[2])} (order {orders(errors[2])[0]:.2f}), {numbers(errors[6])} "
        f"(order {orders(errors[6])[0]:.2f}); EnergyPreserving, t = 200: "
        f"{energy_error(exact):.0e}",
        abs(orders(errors[2])[0] - 2.0) < 0.2, errors[6][1] < 1e-3 * errors[2][1], turned > 0.3,
        energy_error(exact) < 1e-12,
    )  # fmt: skip


SLEIGHS = {
    "a = 0.3, pulled backwards": (gni.scenes.chaplygin_sleigh(), 60.0, 0.05),
    "a = 1, m = 2, J = 0.5": (gni.scenes.chaplygin_sleigh(2.0, 0.5, 1.0, 2.0, -0.7), 40.0, 0.02),
    "a = 0.1, fast spin": (gni.scenes.chaplygin_sleigh(1.3, 0.7, 0.1, 3.0, 0.2), 200.0, 0.05),
}
BACK = {
    "a = 0.3": (gni.scenes.chaplygin_sleigh(), 30.0, 0.05),
    "a = 1, m = 2": (gni.scenes.chaplygin_sleigh(2.0, 0.5, 1.0, 2.0, -0.7), 8.0, 0.02),
}
TILTED = ((1.4, 0.0, 0.3), (0.0, 1.0, 0.2), (0.3, 0.2, 0.9))
CASES = [
    *(
        HardCase(
            f"sleigh that settles, {label}", "a stable direction, yet the energy is kept",
            "FIELD 4 #14",
            "energy to 1e-11, the exact motion (order 6: to 1e-9), no overshoot at the end",
            partial(settled, *numbers_),
        )
        for label, numbers_ in SLEIGHS.items()
    ),
    *(
        HardCase(
            f"sleigh by a two-step method, {label}", "the parasitic mode grows as it settles",
            "FIELD 4 #14; theory.md 3", "wrong by more than 0.5, and ParasiticModeWarning says so",
            partial(two_step_reverses, *numbers_),
        )
        for label, numbers_ in SLEIGHS.items() if label != "a = 0.1, fast spin"
    ),
    *(
        HardCase(
            f"sleigh backward, {label}, {method}", "the settled direction is unstable backward",
            "FIELD 4 #14",
            "back at the start to 1e-11, the turning grown by 1e5 and more; energy to 1e-11",
            partial(backward, *numbers_, method),
        )
        for label, numbers_ in BACK.items() for method in (gni.GNI(), gni.GNI(6))
    ),
    *(
        HardCase(
            f"skate on an incline, {'SE(2)' if framed else 'coordinates'}, spin {spin:g}",
            "the mirror turns with the blade", "FIELD 4 #15; Jay, Hilden",
            "the cycloid: orders 2 and 6, and within 1e-4 at one radian a step by order 6",
            partial(cycloid, framed, slope, spin, speed),
        )
        for framed, slope, spin, speed in (
            (True, 1.7, 2.0, 0.0), (True, 4.9, 20.0, 0.3), (False, 1.7, 2.0, 0.0),
            (False, 4.9, 20.0, -0.5),
        )
    ),
    *(
        HardCase(
            f"Suslov, {label}", "heteroclinic relaxation, not an equilibrium", "FIELD 4 #16",
            "exact motion: order 2, and order 6 a thousand times nearer; energy to 1e-12 by "
            "EnergyPreserving", partial(suslov_body, *numbers_),
        )
        for label, numbers_ in {
            "axis e3": (TILTED, (0.0, 0.0, 1.0), (1.0, -0.5, 0.0), 0.1),
            "slanted axis": (TILTED, (0.3, -0.5, 1.0), (1.0, 0.6, 0.0), 0.1),
            "strong products": (
                ((2.0, 0.7, -0.9), (0.7, 1.5, 0.4), (-0.9, 0.4, 1.1)), (0.0, 1.0, 0.0),
                (0.8, 0.0, 0.9), 0.05,
            ),
        }.items()
    ),
]  # fmt: skip
