"""groupoid_gni: geometric nonholonomic integrators on Lie groupoids.

Say where it moves (a Lie groupoid), say what moves (one mechanical system, as plain NumPy
functions), integrate, look. ``gni.verification`` holds the laws all of them obey.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from groupoid_gni import diagnostics, scenes
from groupoid_gni.discretization import (
    CompositionTable,
    ConstraintAtBothEnds,
    ConstraintAtMidpoint,
    ConstraintAtSource,
    ConstraintAtTarget,
    DiscreteLagrangian,
    EnergyPreserving,
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
    Splitting,
    Variational,
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
    RescuedStepsWarning,
    StepFailure,
    SurprisingStepWarning,
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
    Ensemble,
    McLachlanPerlmutter,
    ReferenceFlow,
    SymmetricProjection,
    integrate,
    integrate_ensemble,
    next_arrow,
    parameter_grid,
    step_function,
)
from groupoid_gni.outcomes import Outcome
from groupoid_gni.systems import MechanicalSystem, State
from groupoid_gni.trajectory import Trajectory

if TYPE_CHECKING:
    from groupoid_gni import reports
    from groupoid_gni.reports import WorkPrecision, work_precision

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
    "CompositionTable",
    "ConstraintAtBothEnds",
    "ConstraintAtMidpoint",
    "ConstraintAtSource",
    "ConstraintAtTarget",
    "DependentConstraintsWarning",
    "DerivedGroupoid",
    "DiscreteLagrangeDAlembert",
    "DiscreteLagrangian",
    "EnergyPreserving",
    "Ensemble",
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
    "McLachlanPerlmutter",
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
    "RescuedStepsWarning",
    "Retraction",
    "Splitting",
    "State",
    "StepFailure",
    "SurprisingStepWarning",
    "SymmetricProjection",
    "Trajectory",
    "TrajectoryFileError",
    "Variational",
    "VectorGroup",
    "WorkPrecision",
    "array",
    "diagnostics",
    "integrate",
    "integrate_ensemble",
    "next_arrow",
    "parameter_grid",
    "reports",
    "scenes",
    "step_function",
    "where",
    "work_precision",
]


def __getattr__(name: str) -> Any:
    """Import when asked for: the verification suite, which needs Hypothesis, and the reports."""
    if name in ("verification", "reports"):
        return import_module(f"groupoid_gni.{name}")
    if name in ("WorkPrecision", "work_precision"):
        return getattr(import_module("groupoid_gni.reports"), name)
    raise AttributeError(f"module 'groupoid_gni' has no attribute {name!r}")
