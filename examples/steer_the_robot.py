"""Park the two-wheeled robot sideways: optimal control through steps of the integrator.

Run: python examples/steer_the_robot.py [figure.png]

Two wheel torques, constant over each step, take the robot from rest to rest, 1.5 to its left, with
the least sum of squared torques while its heading stays within half a radian. It cannot move
sideways, so it has to back in. Direct multiple shooting: each step is ``gni.step_function``, its
ends are unknowns of a nonlinear program, and IPOPT makes them meet. ``gni.integrate`` then replays
the torques found; methods of higher order show what the robot would really do.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import groupoid_gni as gni
from groupoid_gni.plotting import style

STEPS, T_END = 40, 4.0
STEP = T_END / STEPS
PARKED = np.array([0.0, 1.5, 0.0])
LARGEST_HEADING = 0.5
X, Y, SINE, COSINE = 2, 5, 3, 0
BLUE, DARK, PALE, RED = "#2b6ca3", "#22303c", "#c9d3da", "#c8553d"


def robot() -> gni.MechanicalSystem:
    """The robot on its poses, SE(2) x SE(2), in body velocities (omega, u, v), v to the left.

    The rolling wheels turn at ``(u -+ c omega) / R``. Their angles matter to nobody, so they are
    left out and their inertia is added to that of the body, which is exact (see
    ``gni.scenes.two_wheeled_robot``): left are the pose and one constraint, v = 0. A torque on a
    wheel does the work ``torque (u -+ c omega) / R``.
    """

    def metric(x: Any, p: Any) -> Any:
        mass = p.m_0 + 2 * p.m_1
        turning = p.J_0 + p.m_0 * p.l**2 + 2 * p.m_1 * p.c**2 + p.J_2 + 2 * p.J_2 * (p.c / p.R) ** 2
        coupling = p.m_0 * p.l
        return np.array(
            [
                [turning, 0.0, coupling],
                [0.0, mass + 2 * p.J_2 / p.R**2, 0.0],
                [coupling, 0.0, mass],
            ]
        )

    return gni.MechanicalSystem(
        gni.FramedPairGroupoid(gni.SE2()),
        metric,
        constraints=[[0.0, 0.0, 1.0]],
        force=lambda x, xi, p, u: np.array(
            [p.c * (u[1] - u[0]) / p.R, (u[0] + u[1]) / p.R, 0.0]
        ),
        controls=2,
        parameters={"m_0": 2.0, "J_0": 0.5, "l": 0.3, "m_1": 0.2, "J_2": 0.05, "R": 0.4, "c": 0.6},
    )


class Plan(NamedTuple):
    """Poses (n, 9) and momenta (n, 3) of the nodes, torques (steps, 2)."""

    base: np.ndarray
    momenta: np.ndarray
    torques: np.ndarray
    iterations: int

    @property
    def effort(self) -> float:
        """Integral of the squared torques."""
        return float(STEP * np.sum(self.torques**2))


def sideways_guess() -> Plan:
    """Poses along the straight line to the goal, at rest: no motion of the robot at all.

    The heading swings to the left and back; were it 0 throughout, no small change of the torques
    would move the robot sideways and the optimiser would not know where to go.
    """
    fraction = np.linspace(0.0, 1.0, STEPS + 1)
    heading = 0.3 * np.sin(np.pi * fraction)
    c, s, none, one = np.cos(heading), np.sin(heading), 0 * fraction, 1 + 0 * fraction
    shift = fraction[:, None] * PARKED
    base = np.stack([c, -s, shift[:, 0], s, c, shift[:, 1], none, none, one], axis=1)
    return Plan(base, np.zeros((STEPS + 1, 3)), np.zeros((STEPS, 2)), 0)


def plan(system: gni.MechanicalSystem, method: gni.GNI, guess: Plan) -> Plan:
    """Least effort from rest to rest by direct multiple shooting."""
    step = gni.step_function(system, method)
    opti = ca.Opti()
    base, momenta = opti.variable(9, STEPS + 1), opti.variable(3, STEPS + 1)
    torques = opti.variable(2, STEPS)
    parameters = ca.repmat(ca.DM(system.parameter_vector), 1, STEPS)
    sizes = ca.repmat(STEP, 1, STEPS)
    ends = step.map(STEPS)(base[:, :-1], momenta[:, :-1], torques, parameters, sizes)
    opti.subject_to(base[:, 1:] == ends[0])
    opti.subject_to(momenta[:, 1:] == ends[1])
    opti.subject_to(base[:, 0] == np.eye(3).ravel())
    opti.subject_to(momenta[:, 0] == 0)
    # three numbers for the pose and two for the velocity: as many as there are to choose
    opti.subject_to(base[[X, Y, SINE], -1] == PARKED)
    opti.subject_to(momenta[:2, -1] == 0)
    widest = np.sin(LARGEST_HEADING)
    opti.subject_to(opti.bounded(-widest, base[SINE, 1:-1], widest))
    opti.minimize(STEP * ca.sumsqr(torques))
    for variable, value in (
        (base, guess.base), (momenta, guess.momenta), (torques, guess.torques)
    ):  # fmt: skip
        opti.set_initial(variable, value.T)
    quiet = {"print_level": 0, "sb": "yes", "tol": 1e-10}
    opti.solver("ipopt", {"print_time": False}, quiet)
    found = opti.solve()
    values = [np.array(found.value(variable)).T for variable in (base, momenta, torques)]
    return Plan(*values, found.stats()["iter_count"])


def replay(system: gni.MechanicalSystem, method: gni.Method, torques: np.ndarray) -> gni.Trajectory:
    """The same torques through ``integrate``."""
    start = system.state(np.eye(3).ravel(), [0.0, 0.0, 0.0])
    return gni.integrate(
        system, start, step=STEP, n_steps=STEPS, method=method, controls=torques
    )


def pose(base: np.ndarray) -> np.ndarray:
    """(x, y, heading)."""
    heading = np.arctan2(base[..., SINE], base[..., COSINE])
    return np.stack([base[..., X], base[..., Y], heading], axis=-1)


def compare(system: gni.MechanicalSystem, method: gni.GNI, found: Plan) -> dict[str, float]:
    """Print and return how well the plan and its replays agree."""
    run = replay(system, method, found.torques)
    truth = replay(system, gni.ReferenceFlow(rtol=1e-12), found.torques)
    finer = replay(system, gni.GNI(order=6), found.torques)
    gaps = np.abs(run.base - found.base), np.abs(run.momenta - found.momenta)
    numbers = {
        "effort": found.effort,
        "replay": float(max(np.max(gap) for gap in gaps)),
        "pose": float(np.max(np.abs(pose(run.base[-1]) - PARKED))),
        "constraint": float(np.max(np.abs(run.constraint_residuals()))),
        "end energy": float(run.energy()[-1]),
        "true miss": float(np.max(np.abs(pose(truth.base[-1]) - PARKED))),
        "order 6": float(np.max(np.abs(finer.base - truth.base))),
    }
    print(f"{method}: {found.iterations} iterations of IPOPT, effort {numbers['effort']:.6f}")
    print(f"  replayed by integrate: nodes differ by {numbers['replay']:.1e}, the end misses the "
          f"goal by {numbers['pose']:.1e}")
    print(f"  constraint along the replay {numbers['constraint']:.1e}, energy left at the end "
          f"{numbers['end energy']:.1e}")
    print(f"  equations of motion with these torques: the end misses the goal by "
          f"{numbers['true miss']:.1e}; GNI(order=6) follows them to {numbers['order 6']:.1e}")
    return numbers


def draw(system: gni.MechanicalSystem, found: Plan) -> Figure:
    """The path with the robot at some instants, and the torques."""
    track, (x, y, heading) = float(system.parameters["c"]), pose(found.base).T
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    middle = np.stack([x, y], axis=1)
    with style():
        figure = Figure(figsize=(10, 4.6), layout="constrained")
        FigureCanvasAgg(figure)
        road, inputs = figure.subplots(1, 2, width_ratios=(1.35, 1))
        for k in range(0, STEPS + 1, 5):
            shade = RED if k in (0, STEPS) else PALE
            ends = middle[k] + track * np.outer([-1.0, 1.0], left[k])
            road.plot(*ends.T, color=shade, linewidth=1.2, zorder=1)
            for end in ends:
                wheel = end + 0.4 * np.outer([-0.5, 0.5], forward[k])
                road.plot(*wheel.T, color=shade, linewidth=3.0, solid_capstyle="butt", zorder=1)
            nose = middle[k] + 0.3 * np.outer([0.0, 1.0], forward[k])
            road.plot(*nose.T, color=shade, linewidth=1.2, zorder=1)
        road.plot(x, y, ".-", color=DARK, markersize=3, linewidth=1.0, zorder=2)
        for k, text in ((0, "start"), (STEPS, "parked")):
            road.annotate(text, middle[k] + [0.45, -0.04], color=RED)
        road.set_aspect("equal", adjustable="datalim")
        road.set(xlabel="x", ylabel="y", title="middle of the axle every 0.1, robot every 0.5")
        times = STEP * np.arange(STEPS + 1)
        for torque, name, colour in zip(
            found.torques.T, ("left wheel", "right wheel"), (BLUE, RED), strict=True
        ):
            inputs.stairs(torque, times, label=name, color=colour, baseline=None)
        inputs.plot(times, heading, color=DARK, linewidth=1.0, label="heading")
        for bound in (-LARGEST_HEADING, LARGEST_HEADING):
            inputs.axhline(bound, color=DARK, linewidth=0.6, linestyle=":")
        inputs.set(xlabel="t", title=f"torques, effort {found.effort:.3f}; heading, bounds dotted")
        inputs.legend()
    return figure


def main(target: str | Path = "output/steer_the_robot.png") -> dict[str, dict[str, float]]:
    """Plan with steps of order 2, and from there of order 4; replay, compare, draw."""
    system = robot()
    coarse, fine = gni.GNI(flow=gni.Splitting()), gni.GNI(order=4, flow=gni.Splitting())
    first = plan(system, coarse, sideways_guess())
    numbers = {"order 2": compare(system, coarse, first)}
    second = plan(system, fine, first)
    numbers["order 4"] = compare(system, fine, second)
    target = Path(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    draw(system, second).savefig(target)
    print(f"Figure written to {target}")
    return numbers


if __name__ == "__main__":
    main(*sys.argv[1:2])
