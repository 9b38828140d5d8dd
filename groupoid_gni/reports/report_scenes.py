"""The scenes of the report, with the time to which they are compared and the methods tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from groupoid_gni import scenes
from groupoid_gni.discretization import EnergyPreserving, Rattle, Splitting
from groupoid_gni.errors import GNIError
from groupoid_gni.integrators import (
    GNI,
    DiscreteLagrangeDAlembert,
    McLachlanPerlmutter,
    Method,
    ReferenceFlow,
    integrate,
)
from groupoid_gni.scenes import Scene


@dataclass(frozen=True)
class ReportScene:
    """A scene by the name that files and peers know it by.

    t_end : of the comparison.  coarsest : the smallest number of steps to it.
    """

    name: str
    make: Callable[[], Scene]
    t_end: float = 10.0
    coarsest: int = 10

    def steps(self, quick: bool) -> list[float]:
        """Step sizes: the coarsest, halved again and again; at length also two thirds of each."""
        counts = [self.coarsest << k for k in range(7 if quick else 12)]
        if not quick:
            counts += [3 * n // 2 for n in counts[:-1]]
        return [self.t_end / n for n in sorted(counts)]


SCENES = (
    ReportScene("rolling_ball", scenes.rolling_ball),
    ReportScene("inhomogeneous_ball", scenes.inhomogeneous_ball),
    ReportScene("chaplygin_sleigh", scenes.chaplygin_sleigh),
    ReportScene("suslov", scenes.suslov),
    ReportScene(
        "veselova",
        lambda: scenes.veselova(
            rate=0.3, weight=(0.3, 0.2, 1.1), vertical=(0.0, 0.0, 1.0), spin=(0.5, 0.4, 0.3)
        ),
    ),
    ReportScene("constrained_particle", lambda: scenes.constrained_particle(1.3, 0.9, 0.7)),
    ReportScene("two_wheeled_robot", lambda: scenes.two_wheeled_robot(detent=0.6)),
    ReportScene(
        "variable_transmission",
        lambda: scenes.variable_transmission(gearing=(0.3, 1.0, 0.4, 0.5)),
    ),
)
COLD = ("chaplygin_sleigh", "rolling_ball", "inhomogeneous_ball")


def methods_for(scene: Scene, quick: bool) -> dict[str, Method]:
    """The methods that can step a scene; ReferenceFlow is not among them."""
    tried: dict[str, Method] = {"Rattle": Rattle(), "GNI 2": GNI()}
    if not quick:
        tried["Lagrange-d'Alembert"] = DiscreteLagrangeDAlembert()
        tried["McLachlan-Perlmutter"] = McLachlanPerlmutter()
        tried["GNI 2, exact energy"] = GNI(flow=EnergyPreserving())
    tried["GNI 4"] = GNI(order=4)
    if not quick:
        tried["GNI 4, exact energy"] = GNI(order=4, flow=EnergyPreserving())
        tried["GNI 6"] = GNI(order=6)
    tried["GNI 6, splitting"] = GNI(order=6, flow=Splitting())
    tried["GNI 8"] = GNI(order=8)
    if not quick:
        tried["GNI 8, splitting"] = GNI(order=8, flow=Splitting())
        tried["GNI 8, bare"] = GNI(order=8, flow=Splitting(), projection=None)
    return {name: method for name, method in tried.items() if _can_step(scene, method)}


def _can_step(scene: Scene, method: Any) -> bool:
    try:
        integrate(scene.system, scene.start, step=1e-3, n_steps=1, method=method)
    except GNIError:
        return False
    return True


def flows(quick: bool) -> list[ReferenceFlow]:
    """The equations of motion at tolerances from loose to strict."""
    powers = (2, 5, 8, 11, 13) if quick else range(2, 14)
    return [ReferenceFlow(rtol=10.0**-k) for k in powers]
