"""From a mechanical system and a discrete Lagrangian to the expressions of one step.

Everything here is symbolic: nothing is run. The equations are those of the paper, sections 4 to 8;
the room hands a ``StepProgram`` to ``codegen``.
"""

from groupoid_gni.discretization.discrete_constraints import (
    ConstraintAtBothEnds,
    ConstraintAtMidpoint,
    ConstraintAtSource,
    ConstraintAtTarget,
    DiscreteConstraint,
)
from groupoid_gni.discretization.discrete_lagrangians import (
    DiscreteLagrangian,
    EulerA,
    EulerB,
    Midpoint,
    Rattle,
)
from groupoid_gni.discretization.free_flight import FreeFlight
from groupoid_gni.discretization.lagrange_dalembert_step import (
    lagrange_dalembert_function,
    lagrange_dalembert_program,
)
from groupoid_gni.discretization.nonholonomic_step import (
    next_arrow_function,
    projected_program,
    two_step_program,
)
from groupoid_gni.discretization.reference_field import reference_field
from groupoid_gni.discretization.step_program import StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import SystemExpressions

__all__ = [
    "ConstraintAtBothEnds",
    "ConstraintAtMidpoint",
    "ConstraintAtSource",
    "ConstraintAtTarget",
    "DiscreteConstraint",
    "DiscreteLagrangian",
    "EulerA",
    "EulerB",
    "FreeFlight",
    "Midpoint",
    "Rattle",
    "StateLayout",
    "StepProgram",
    "SystemExpressions",
    "lagrange_dalembert_function",
    "lagrange_dalembert_program",
    "next_arrow_function",
    "projected_program",
    "reference_field",
    "two_step_program",
]
