"""Record a user's NumPy function once, as a CasADi expression graph.

Takes plain NumPy functions, gives frozen RecordedFunctions (evaluate, inline, differentiate), and
the few functions a model needs that NumPy does not have: where, array, and the entire functions
of a squared angle.
"""

from groupoid_gni.expressions.array import RecordedArray, is_recorded
from groupoid_gni.expressions.conversion import from_sx, symbols, to_sx, to_sx_matrix
from groupoid_gni.expressions.differences import discrete_gradient, has_exact_differences
from groupoid_gni.expressions.entire_functions import (
    arctan_ratio,
    cos_of_square,
    half_cotangent_defect_derivative,
    half_cotangent_defect_of_square,
    sinc_of_square,
    sine_defect_derivative,
    sine_defect_of_square,
    versine_derivative,
    versine_of_square,
)
from groupoid_gni.expressions.functions import array, series_guarded, where
from groupoid_gni.expressions.recording import RecordedFunction, record, verify
from groupoid_gni.expressions.scalar import Scalar

__all__ = [
    "RecordedArray",
    "RecordedFunction",
    "Scalar",
    "arctan_ratio",
    "array",
    "cos_of_square",
    "discrete_gradient",
    "from_sx",
    "half_cotangent_defect_derivative",
    "half_cotangent_defect_of_square",
    "has_exact_differences",
    "is_recorded",
    "record",
    "series_guarded",
    "sinc_of_square",
    "sine_defect_derivative",
    "sine_defect_of_square",
    "symbols",
    "to_sx",
    "to_sx_matrix",
    "verify",
    "versine_derivative",
    "versine_of_square",
    "where",
]
