"""What moves: mechanical systems, their parameters and their starts."""

from groupoid_gni.systems.input_checks import real_array
from groupoid_gni.systems.mechanical_system import MechanicalSystem
from groupoid_gni.systems.parameters import ParameterLayout, Parameters
from groupoid_gni.systems.starts import State

__all__ = ["MechanicalSystem", "ParameterLayout", "Parameters", "State", "real_array"]
