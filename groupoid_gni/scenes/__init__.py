"""Ready systems: the smallest model of each scene, a start, and its exact solution where known.

Takes physical numbers, gives a Scene.
"""

from groupoid_gni.scenes.chain_of_skates import chain_of_skates
from groupoid_gni.scenes.chaplygin_sleigh import chaplygin_sleigh
from groupoid_gni.scenes.constrained_particle import constrained_particle
from groupoid_gni.scenes.inhomogeneous_ball import inhomogeneous_ball
from groupoid_gni.scenes.inhomogeneous_ball_in_a_chart import inhomogeneous_ball_in_a_chart
from groupoid_gni.scenes.rattleback import rattleback
from groupoid_gni.scenes.rolling_ball import rolling_ball
from groupoid_gni.scenes.rolling_disc import rolling_disc
from groupoid_gni.scenes.scene import Scene
from groupoid_gni.scenes.suslov import suslov
from groupoid_gni.scenes.two_wheeled_robot import two_wheeled_robot
from groupoid_gni.scenes.variable_transmission import variable_transmission
from groupoid_gni.scenes.veselova import veselova

__all__ = [
    "Scene",
    "chain_of_skates",
    "chaplygin_sleigh",
    "constrained_particle",
    "inhomogeneous_ball",
    "inhomogeneous_ball_in_a_chart",
    "rattleback",
    "rolling_ball",
    "rolling_disc",
    "suslov",
    "two_wheeled_robot",
    "variable_transmission",
    "veselova",
]
