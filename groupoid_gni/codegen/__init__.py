"""From the expressions of a step to something that runs: machine code, or CasADi's evaluator.

Takes a StepProgram, gives StepRunners; takes a vector field, gives FlowRunners; knows no mechanics.
"""

from groupoid_gni.codegen.adaptive_runners import CompiledFlow, FlowRunner, InterpretedFlow
from groupoid_gni.codegen.lanes import LaneJob, LaneResult, run_lane_job, widest_lanes
from groupoid_gni.codegen.machine import MachineCode, machine_has_fused_products
from groupoid_gni.codegen.runners import CompiledStep, InterpretedStep, StepRunner
from groupoid_gni.codegen.step_kernel import field_ir, operations_by_place, step_kernel_ir

__all__ = [
    "CompiledFlow",
    "CompiledStep",
    "FlowRunner",
    "InterpretedFlow",
    "InterpretedStep",
    "LaneJob",
    "LaneResult",
    "MachineCode",
    "StepRunner",
    "field_ir",
    "machine_has_fused_products",
    "operations_by_place",
    "run_lane_job",
    "step_kernel_ir",
    "widest_lanes",
]
