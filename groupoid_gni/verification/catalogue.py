"""Everything the library ships, with awkward numbers, ready to be checked.

Each object has variants (sides, retractions, scenes); a table shows the worst of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni import scenes
from groupoid_gni.discretization import (
    EnergyPreserving,
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
    Splitting,
    Variational,
)
from groupoid_gni.groupoids import (
    SE2,
    SE3,
    SO2,
    SO3,
    ActionGroupoid,
    AtiyahGroupoid,
    Cayley,
    DerivedGroupoid,
    Exponential,
    FramedPairGroupoid,
    LieGroup,
    LieGroupoid,
    MatrixGroup,
    PairGroupoid,
    ProductGroupoid,
    QuadraticGroup,
    VectorGroup,
)
from groupoid_gni.integrators import (
    GNI,
    DiscreteLagrangeDAlembert,
    McLachlanPerlmutter,
    Method,
)
from groupoid_gni.scenes import Scene
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.verification.method_view import Section

Variants = dict[str, Any]

_DIRECTION = np.array([0.48, 0.6, 0.64])
_LORENTZ = np.diag([-1.0, 1.0, 1.0])
_SPECIAL_LINEAR = [[[1, 0], [0, -1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]]


def _turned_back(q: Any, rotation: Any) -> Any:
    return (q[..., None, :] @ rotation)[..., 0, :]


def _turned(q: Any, rotation: Any) -> Any:
    return (rotation @ q[..., None])[..., 0]


def groups() -> dict[str, dict[str, LieGroup]]:
    """Every Lie group on both sides with both retractions."""
    made: dict[str, dict[str, LieGroup]] = {}
    for side in ("left", "right"):
        for tau in (Cayley(), Exponential()):
            options: dict[str, Any] = {"side": side, "retraction": tau}
            name = f"{side}, {type(tau).__name__}"
            for label, group in {
                "R^3": VectorGroup(3, **options),
                "SO(2)": SO2(**options),
                "SO(3)": SO3(**options),
                "SE(2)": SE2(**options),
                "SE(3)": SE3(**options),
                "SO(4)": QuadraticGroup(np.eye(4), **options),
                "SO(1,2)": QuadraticGroup(_LORENTZ, **options),
            }.items():
                made.setdefault(label, {})[name] = group
        special = MatrixGroup(_SPECIAL_LINEAR, side=side, retraction=Exponential())
        made.setdefault("SL(2)", {})[f"{side}, Exponential"] = special
    return made


def groupoids() -> dict[str, dict[str, LieGroupoid]]:
    """Every groupoid that is not a group, and one with its closed forms forgotten."""
    exponential = Exponential()
    right = SO3(side="right")
    return {
        "pair": {"R^1": PairGroupoid(1), "R^3": PairGroupoid(3)},
        "Atiyah": {
            "R^2, SO(3) right": AtiyahGroupoid(2, right),
            "R^1, SE(2) exp": AtiyahGroupoid(1, SE2(retraction=exponential)),
        },
        "product": {
            "framed, pair, group": ProductGroupoid(
                FramedPairGroupoid(SE2()), PairGroupoid(1), SE3(side="right")
            ),
        },
        "framed pair": {
            "R^2 x SO(3)": FramedPairGroupoid(VectorGroup(2), SO3()),
            "SO(3) right, exp": FramedPairGroupoid(SO3(side="right", retraction=exponential)),
        },
        "action": {
            "left": ActionGroupoid(SO3(), _turned_back, _DIRECTION),
            "right, exp": ActionGroupoid(
                SO3(side="right", retraction=exponential), _turned, _DIRECTION
            ),
        },
        "derived": {"action": DerivedGroupoid(ActionGroupoid(SO3(), _turned_back, _DIRECTION))},
    }


def shipped_scenes() -> dict[str, Scene]:
    """The scenes, with numbers that are nowhere one."""
    return {
        "particle": scenes.constrained_particle(1.3, 0.8, 1.7),
        "Suslov": scenes.suslov(),
        "sleigh": scenes.chaplygin_sleigh(1.3, 0.6, 0.4, spin=1.1, speed=-0.7),
        "Veselova": scenes.veselova(weight=(0.1, -0.2, 0.7)),
        "rolling ball": scenes.rolling_ball(1.3, 0.8, 0.45, 0.9),
        "inhomogeneous ball": scenes.inhomogeneous_ball(
            1.7, 0.8, np.array([0.9, 0.5, 0.7]), 0.9, (0.7, -0.2), (0.3, 0.6), vertical_spin=0.4
        ),
        "robot": scenes.two_wheeled_robot(detent=0.4),
    }


def systems_for_methods() -> dict[str, tuple[MechanicalSystem, tuple[Section, ...]]]:
    """What methods run on, with symmetries: scenes, two with an exact energy, a charged body."""
    spins: dict[str, tuple[Section, ...]] = {
        "rolling ball": (lambda x: np.array([0.0, 0.0, 0.0, 0.0, 1.0]),)
    }
    made = {name: (scene.system, spins.get(name, ())) for name, scene in shipped_scenes().items()}
    sphere = MechanicalSystem(
        SO3(side="right"), metric=1.37 * np.eye(3), constraints=[[0.4, -0.9, 2.1]]
    )
    well = np.array([[1.1, 0.3, -0.2], [0.3, 1.7, 0.4], [-0.2, 0.4, 0.8]])
    springs = MechanicalSystem(
        PairGroupoid(3),
        metric=[[1.3, 0.2, 0.0], [0.2, 0.9, 0.1], [0.0, 0.1, 1.6]],
        potential=lambda x, p: 0.5 * x @ well @ x,
        constraints=lambda x, p: np.array([[-x[1], 0.3 * x[2], 1.0]]),
    )
    charge = MechanicalSystem(
        PairGroupoid(3),
        metric=lambda x, p: np.diag([0.7, 1.1 + 0.2 * x[0] ** 2, 1.3]),
        gyroscopic=lambda x, p: p.charge * np.array([-x[1], x[0] * x[2], 0.4]),
        constraints=lambda x, p: np.array([[0.3, -x[2], 1.2]]),
        drift=lambda x, p: np.array([0.1, 0.3 * np.cos(x[0]), -0.2]),
        parameters={"charge": 0.8},
    )
    exact = {"sphere, any D": (sphere, ()), "springs, any D": (springs, ())}
    return {**made, **exact, "charge, moving D": (charge, ())}


def methods() -> dict[str, Method]:
    """The methods that are tried on every system: (49), and the projected step of order 2."""
    return {
        "Euler A": EulerA(),
        "Euler B": EulerB(),
        "RATTLE": Rattle(),
        "midpoint": Midpoint(),
        "GNI": GNI(),
        "GNI, RATTLE": GNI(flow=Variational(Rattle())),
        "GNI, midpoint": GNI(flow=Variational(Midpoint())),
    }


def methods_on_few_systems() -> dict[str, tuple[Method, tuple[str, ...]]]:
    """Other flows, orders, bare stages, other authors; each with the systems it is tried on."""
    energy, splitting = EnergyPreserving(), Splitting()
    return {
        "GNI, splitting": (GNI(flow=splitting), ("Veselova", "springs, any D")),
        "GNI, energy": (GNI(flow=energy), ("Suslov", "charge, moving D")),
        "GNI 4": (GNI(4), ("sleigh",)),
        "GNI 6, energy": (GNI(6, energy), ("springs, any D",)),
        "GNI 8, splitting": (GNI(8, splitting), ("Suslov",)),
        "GNI, bare": (GNI(projection=None), ("springs, any D",)),
        "GNI 4, bare": (GNI(4, projection=None), ("rolling ball",)),
        "McLachlan, Perlmutter": (McLachlanPerlmutter(), ("sleigh",)),
        "[28]": (DiscreteLagrangeDAlembert(), ("sleigh",)),
    }
