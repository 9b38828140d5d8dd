"""The systems and methods of step_cost.py: what the library steps and what the C of ``c/`` steps.

Three systems are the foundation, on which the library is held to a limit: the rigid body, the
sleigh and the inhomogeneous ball, built here so that they can be built on a groupoid without closed
forms as well. The others are the scenes of the report as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import groupoid_gni as gni
from groupoid_gni.reports.report_scenes import SCENES


@dataclass(frozen=True)
class Scheme:
    """A method, and the C function that steps it.

    short : heading of a column.  stretch : its step over that of the case; compositions are there
        for longer steps.
    """

    title: str
    short: str
    method: Any
    function: str
    stretch: int = 1

    @property
    def fractions(self) -> tuple[float, ...]:
        """Sizes of the stages in units of the step."""
        return tuple(getattr(self.method, "fractions", (1.0,)))


_ENERGY, _SPLITTING = gni.GNI(flow=gni.EnergyPreserving()), gni.GNI(order=4, flow=gni.Splitting())
SCHEMES = {
    "rattle": Scheme("two-step Rattle()", "Rattle", gni.Rattle(), "rattle"),
    "projected": Scheme("projected GNI()", "GNI 2", gni.GNI(), "projected"),
    "order 4": Scheme("GNI(order=4)", "GNI 4", gni.GNI(order=4), "projected", 4),
    "order 6": Scheme("GNI(order=6)", "GNI 6", gni.GNI(order=6), "projected", 4),
    "order 8": Scheme("GNI(order=8)", "GNI 8", gni.GNI(order=8), "projected", 4),
    "energy": Scheme(f"{_ENERGY}", "GNI 2, energy", _ENERGY, "energy_preserving"),
    "splitting": Scheme(f"{_SPLITTING}", "GNI 4, splitting", _SPLITTING, "splitting", 4),
}
MAIN = ("rattle", "projected", "order 4", "order 6", "order 8")


@dataclass(frozen=True)
class Case:
    """One system, on its groupoid or on the same groupoid with its closed forms forgotten.

    source : file in ``c/``.  make : groupoid -> system.  start : base, velocity (projected).
    step, burst : step size, and steps from the start after which a run begins again; some systems
        settle, and a settled body would be timed with one iteration per step.
    c_parameters : what the C reads.  variants : further C, name -> flags: the same map with less
        work than the library's formulation asks for.
    scene : name in the report; empty where the case is none of its scenes.
    foundation : whether the library is held to the limit; ``make`` then heeds its argument.
    schemes : those written in C.
    """

    name: str
    source: str
    space: gni.LieGroupoid
    make: Callable[[gni.LieGroupoid], gni.MechanicalSystem]
    base: Any
    velocity: Any
    step: float
    burst: int
    c_parameters: tuple[float, ...]
    variants: tuple[tuple[str, tuple[str, ...]], ...] = ()
    scene: str = ""
    foundation: bool = False
    schemes: tuple[str, ...] = MAIN

    def system(self, derived: bool = False) -> gni.MechanicalSystem:
        """The system; ``derived`` without the closed forms of its groupoid."""
        return self.make(gni.DerivedGroupoid(self.space) if derived else self.space)


# The foundation.


def rigid_body() -> Case:
    """Rigid body on SO(3) with a full inertia matrix and one awkward constraint (Suslov)."""
    inertia = np.array([[1.7, 0.2, -0.1], [0.2, 2.3, 0.3], [-0.1, 0.3, 3.1]])
    mu = np.array([[0.3, -0.5, 1.0]])

    def make(space: gni.LieGroupoid) -> gni.MechanicalSystem:
        return gni.MechanicalSystem(
            space,
            metric=lambda x, p: p.J,
            constraints=lambda x, p: p.mu,
            parameters={"J": inertia, "mu": mu},
        )

    return Case(
        "rigid body, SO(3)", "rigid_body.c", gni.SO3(retraction=gni.Cayley()), make,
        None, [1.0, -0.7, 0.4], 0.02, 1000, (*_upper(inertia), *mu[0]), foundation=True,
    )  # fmt: skip


def _upper(matrix: np.ndarray) -> np.ndarray:
    return matrix[np.triu_indices(len(matrix))]


def sleigh() -> Case:
    """Chaplygin sleigh on SE(2), from a start near its unstable motion."""
    scene = _scene("chaplygin_sleigh")
    p = scene.system.parameters

    def make(space: gni.LieGroupoid) -> gni.MechanicalSystem:
        return gni.MechanicalSystem(
            space,
            metric=lambda x, p: np.array(
                [[p.J + p.m * p.a**2, 0.0, p.m * p.a], [0.0, p.m, 0.0], [p.m * p.a, 0.0, p.m]]
            ),
            constraints=[[0.0, 0.0, 1.0]],
            parameters=scene.system.parameters,
        )

    return Case(
        "sleigh, SE(2)", "sleigh.c", scene.system.space, make,
        None, scene.start.velocity, 0.02, 1000, (float(p["m"]), float(p["J"]), float(p["a"])),
        scene="chaplygin_sleigh", foundation=True,
    )  # fmt: skip


def ball() -> Case:
    """Inhomogeneous ball on a rotating table, R^2 x SO(3) in the body frame."""
    scene = _scene("inhomogeneous_ball")
    p = scene.system.parameters

    def make(space: gni.LieGroupoid) -> gni.MechanicalSystem:
        return gni.MechanicalSystem(
            space,
            metric=lambda x, p: np.diag([p.m, p.m, p.I[0], p.I[1], p.I[2]]),
            constraints=lambda x, p: np.array(
                [
                    [1.0, 0.0, -p.r * x[5], -p.r * x[6], -p.r * x[7]],
                    [0.0, 1.0, p.r * x[2], p.r * x[3], p.r * x[4]],
                ]
            ),
            drift=lambda x, p: np.array([-p.Theta * x[1], p.Theta * x[0], 0.0, 0.0, 0.0]),
            parameters=scene.system.parameters,
        )

    return Case(
        "inhomogeneous ball, R^2 x SO(3)", "ball.c", scene.system.space, make,
        scene.start.base, scene.start.velocity, 0.05, 1000,
        (float(p["m"]), float(p["r"]), *p["I"], float(p["Theta"])),
        (("two rows of R", ("-DTWO_ROWS",)),), scene="inhomogeneous_ball", foundation=True,
        schemes=(*MAIN, "splitting"),
    )  # fmt: skip


# The other scenes of the report.


def _scene(name: str) -> gni.scenes.Scene:
    return next(entry for entry in SCENES if entry.name == name).make()


def _as_it_is(
    name: str, title: str, source: str, step: float, read: tuple[str, ...], **more: Any
) -> Case:
    """A scene of the report; ``read``: the parameters that the C reads, in its order."""
    scene = _scene(name)
    numbers = [np.ravel(scene.system.parameters[key]) for key in read]
    start = scene.start
    return Case(
        title, source, scene.system.space, lambda space: scene.system,
        start.base if len(start.base) else None, start.velocity, step, 1000,
        tuple(float(v) for v in np.concatenate(numbers)), scene=name, **more,
    )  # fmt: skip


def rolling_ball() -> Case:
    """Homogeneous ball on a rotating table: in C one unknown in place of three, or none."""
    return _as_it_is(
        "rolling_ball", "rolling ball, R^2 x SO(3)", "rolling_ball.c", 0.05,
        ("m", "r", "I", "Theta"), variants=(("nothing solved", ("-DNO_ARROW",)),),
    )  # fmt: skip


def suslov() -> Case:
    """The Suslov scene with the C of the rigid body."""
    scene = _scene("suslov")
    p, start = scene.system.parameters, scene.start
    return Case(
        "Suslov, SO(3)", "rigid_body.c", scene.system.space, lambda space: scene.system,
        None, start.velocity, 0.02, 1000, (*_upper(p["I"]), *p["a"]), scene="suslov",
    )  # fmt: skip


def veselova() -> Case:
    """Veselova's body with weight and a prescribed turn about the vertical."""
    return _as_it_is(
        "veselova", "Veselova, SO(3) on S^2", "veselova.c", 0.02, ("I", "c", "weight")
    )


def particle() -> Case:
    """Constrained particle with springs: in C the search can be left out."""
    return _as_it_is(
        "constrained_particle", "particle, R^2 x R", "particle.c", 0.05,
        ("m", "k_x", "k_y"), variants=(("nu in closed form", ("-DCLOSED",)),),
        schemes=(*MAIN, "energy"),
    )  # fmt: skip


def robot() -> Case:
    """Two-wheeled robot with a detent on one wheel."""
    return _as_it_is(
        "two_wheeled_robot", "robot, R x R x SE(2)", "robot.c", 0.02,
        ("m_0", "J_0", "l", "m_1", "J_2", "R", "c", "k"),
    )  # fmt: skip


def transmission() -> Case:
    """Continuously variable transmission."""
    return _as_it_is(
        "variable_transmission", "transmission, R^2 x SO(2)", "transmission.c", 0.05,
        ("c", "k", "q", "e"), schemes=(*MAIN, "energy"),
    )  # fmt: skip


CASES = (
    rigid_body, sleigh, ball, rolling_ball, suslov, veselova, particle, robot, transmission,
)  # fmt: skip
