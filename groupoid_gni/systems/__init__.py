"""What moves: mechanical systems, their parameters and their starts.

Takes a groupoid and a user's functions, gives a frozen MechanicalSystem and checked starts.
"""

from groupoid_gni.systems.input_checks import real_array
from groupoid_gni.systems.mechanical_system import MechanicalSystem
from groupoid_gni.systems.parameters import ParameterLayout, Parameters
from groupoid_gni.systems.starts import State

__all__ = ["MechanicalSystem", "ParameterLayout", "Parameters", "State", "real_array"]
