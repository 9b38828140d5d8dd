"""Lie groupoids and Lie groups: where a mechanical system moves.

Takes nothing but NumPy arrays (or recorded ones); knows no mechanics. Sections 7 and 8 and the
appendix of the paper.
"""

from groupoid_gni.groupoids.action_groupoid import ActionGroupoid
from groupoid_gni.groupoids.atiyah_groupoid import AtiyahGroupoid
from groupoid_gni.groupoids.framed_pair_groupoid import FramedPairGroupoid
from groupoid_gni.groupoids.lie_group import LieGroup
from groupoid_gni.groupoids.lie_groupoid import DerivedGroupoid, LieGroupoid
from groupoid_gni.groupoids.matrix_group import MatrixGroup
from groupoid_gni.groupoids.pair_groupoid import PairGroupoid
from groupoid_gni.groupoids.product_groupoid import ProductGroupoid
from groupoid_gni.groupoids.quadratic_group import QuadraticGroup
from groupoid_gni.groupoids.retractions import Cayley, Exponential, Retraction
from groupoid_gni.groupoids.se2 import SE2
from groupoid_gni.groupoids.se3 import SE3
from groupoid_gni.groupoids.so2 import SO2
from groupoid_gni.groupoids.so3 import SO3
from groupoid_gni.groupoids.spot_checks import broken_law
from groupoid_gni.groupoids.vector_group import VectorGroup

__all__ = [
    "SE2",
    "SE3",
    "SO2",
    "SO3",
    "ActionGroupoid",
    "AtiyahGroupoid",
    "Cayley",
    "DerivedGroupoid",
    "Exponential",
    "FramedPairGroupoid",
    "LieGroup",
    "LieGroupoid",
    "MatrixGroup",
    "PairGroupoid",
    "ProductGroupoid",
    "QuadraticGroup",
    "Retraction",
    "VectorGroup",
    "broken_law",
]
