"""Ready systems: the smallest model of each scene, a start, and its exact solution where known.

Takes physical numbers, gives a Scene.
"""

from groupoid_gni.scenes.chaplygin_sleigh import chaplygin_sleigh
from groupoid_gni.scenes.inhomogeneous_ball import inhomogeneous_ball
from groupoid_gni.scenes.rolling_ball import rolling_ball
from groupoid_gni.scenes.scene import Scene

__all__ = ["Scene", "chaplygin_sleigh", "inhomogeneous_ball", "rolling_ball"]
