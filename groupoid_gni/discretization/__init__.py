"""From a mechanical system and a discrete Lagrangian to the expressions of one step.

Everything here is symbolic: nothing is run. The equations are those of the paper, sections 4 to 8;
the room hands a ``StepProgram`` to ``codegen``.
"""

from groupoid_gni.discretization.composition_tables import (
    CompositionTable,
    default_table,
    doubled,
    stages_of_splitting,
)
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
from groupoid_gni.discretization.flows import EnergyPreserving, Flow, Splitting, Variational
from groupoid_gni.discretization.free_flight import FreeFlight
from groupoid_gni.discretization.impulse_step import impulse_program
from groupoid_gni.discretization.lagrange_dalembert_step import (
    lagrange_dalembert_function,
    lagrange_dalembert_program,
)
from groupoid_gni.discretization.nonholonomic_step import (
    next_arrow_function,
    two_step_program,
)
from groupoid_gni.discretization.projected_step import bare_program, projected_program
from groupoid_gni.discretization.reference_field import reference_field, reference_flow
from groupoid_gni.discretization.step_program import StateLayout, StepProgram
from groupoid_gni.discretization.system_expressions import SystemExpressions

__all__ = [
    "CompositionTable",
    "ConstraintAtBothEnds",
    "ConstraintAtMidpoint",
    "ConstraintAtSource",
    "ConstraintAtTarget",
    "DiscreteConstraint",
    "DiscreteLagrangian",
    "EnergyPreserving",
    "EulerA",
    "EulerB",
    "Flow",
    "FreeFlight",
    "Midpoint",
    "Rattle",
    "Splitting",
    "StateLayout",
    "StepProgram",
    "SystemExpressions",
    "Variational",
    "bare_program",
    "default_table",
    "doubled",
    "impulse_program",
    "lagrange_dalembert_function",
    "lagrange_dalembert_program",
    "next_arrow_function",
    "projected_program",
    "reference_field",
    "reference_flow",
    "stages_of_splitting",
    "two_step_program",
]
