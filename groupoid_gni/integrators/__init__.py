"""Methods, the driver ``integrate``, and equation (49) for one arrow.

Takes a system, a start and a method, gives a Trajectory, or a StepFailure that holds one.
"""

from groupoid_gni.integrators.integration import integrate
from groupoid_gni.integrators.marching import compiled_step, machine_code
from groupoid_gni.integrators.methods import (
    GNI,
    DiscreteLagrangeDAlembert,
    Method,
    ReferenceFlow,
    Variational,
)
from groupoid_gni.integrators.one_arrow import next_arrow

__all__ = [
    "GNI",
    "DiscreteLagrangeDAlembert",
    "Method",
    "ReferenceFlow",
    "Variational",
    "compiled_step",
    "integrate",
    "machine_code",
    "next_arrow",
]
