"""Methods, the driver ``integrate``, and equation (49) for one arrow.

Takes a system, a start and a method, gives a Trajectory, or a StepFailure that holds one.
"""

from groupoid_gni.integrators.ensemble_inputs import parameter_grid
from groupoid_gni.integrators.ensembles import Ensemble, integrate_ensemble
from groupoid_gni.integrators.integration import integrate
from groupoid_gni.integrators.marching import compiled_step, machine_code, step_program
from groupoid_gni.integrators.methods import (
    GNI,
    DiscreteLagrangeDAlembert,
    McLachlanPerlmutter,
    Method,
    ReferenceFlow,
    SymmetricProjection,
)
from groupoid_gni.integrators.one_arrow import next_arrow
from groupoid_gni.integrators.step_functions import step_function

__all__ = [
    "GNI",
    "DiscreteLagrangeDAlembert",
    "Ensemble",
    "McLachlanPerlmutter",
    "Method",
    "ReferenceFlow",
    "SymmetricProjection",
    "compiled_step",
    "integrate",
    "integrate_ensemble",
    "machine_code",
    "next_arrow",
    "parameter_grid",
    "step_function",
    "step_program",
]
