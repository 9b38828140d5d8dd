"""groupoid_gni: geometric nonholonomic integrators on Lie groupoids.

Say where it moves (a Lie groupoid), say what moves (one mechanical system, as plain NumPy
functions), integrate, look. ``gni.verification`` holds the laws all of them obey.
"""

from importlib import import_module
from typing import Any

from groupoid_gni import scenes
from groupoid_gni.discretization import (
    ConstraintAtBothEnds,
    ConstraintAtMidpoint,
    ConstraintAtSource,
    ConstraintAtTarget,
    DiscreteLagrangian,
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
)
from groupoid_gni.errors import (
    DependentConstraintsWarning,
    GNIError,
    GNIWarning,
    InputError,
    MetricMismatchError,
    NotComposableError,
    ParasiticModeWarning,
    RecordingError,
    StepFailure,
    TrajectoryFileError,
)
from groupoid_gni.expressions import array, where
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
    Retraction,
    VectorGroup,
)
from groupoid_gni.integrators import (
    GNI,
    DiscreteLagrangeDAlembert,
    ReferenceFlow,
    Variational,
    integrate,
    next_arrow,
)
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

__version__ = "0.1.0"

__all__ = [
    "GNI",
    "SE2",
    "SE3",
    "SO2",
    "SO3",
    "ActionGroupoid",
    "AtiyahGroupoid",
    "Cayley",
    "ConstraintAtBothEnds",
    "ConstraintAtMidpoint",
    "ConstraintAtSource",
    "ConstraintAtTarget",
    "DependentConstraintsWarning",
    "DerivedGroupoid",
    "DiscreteLagrangeDAlembert",
    "DiscreteLagrangian",
    "EulerA",
    "EulerB",
    "Exponential",
    "FramedPairGroupoid",
    "GNIError",
    "GNIWarning",
    "InputError",
    "LieGroup",
    "LieGroupoid",
    "MatrixGroup",
    "MechanicalSystem",
    "MetricMismatchError",
    "Midpoint",
    "NotComposableError",
    "Outcome",
    "PairGroupoid",
    "ParasiticModeWarning",
    "ProductGroupoid",
    "QuadraticGroup",
    "Rattle",
    "RecordingError",
    "ReferenceFlow",
    "Retraction",
    "State",
    "StepFailure",
    "Trajectory",
    "TrajectoryFileError",
    "Variational",
    "VectorGroup",
    "array",
    "integrate",
    "next_arrow",
    "scenes",
    "where",
]


def __getattr__(name: str) -> Any:
    """Import the verification suite when it is asked for: it needs Hypothesis."""
    if name == "verification":
        return import_module("groupoid_gni.verification")
    raise AttributeError(f"module 'groupoid_gni' has no attribute {name!r}")
