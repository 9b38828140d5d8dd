"""The rattleback: an ellipsoid whose axes of inertia are turned against its axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.groupoids import Cayley, Retraction
from groupoid_gni.scenes.rolling_on_a_plane import rolling_body, rolling_velocity
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import Parameters


def rattleback(
    semiaxes: ArrayLike = (20.0, 3.0, 2.0),
    depth: float = 1.0,
    inertia: ArrayLike = (2.0, 16.0, 17.0),
    product: float = -0.2,
    mass: float = 1.0,
    gravity: float = 980.665,
    roll: float = 0.5,
    pitch: float = 0.5,
    spin: ArrayLike = (0.0, 0.0, -5.0),
    retraction: Retraction | None = None,
) -> Scene:
    """Ellipsoid that rolls without slipping on a plane, reduced by all motions of the plane.

    semiaxes : (a, b, c) of the ellipsoid, along the body axes.
    depth : the centre of mass lies on the third axis, this far below the centre.
    inertia, product : moments (A, B, C) about the centre of mass and the entry I_12.
    roll, pitch : the third axis at the start is the vertical turned about the first, then about
        the second axis, in degrees.
    spin : Omega at the start, body frame.

    Defaults: Kane and Levinson (Int. J. Non-Linear Mech. 17, 1982), in centimetres, grams and
    seconds. Spun the wrong way it starts to rattle and turns back, without any dissipation; there
    is no invariant volume. Kept: the energy. Base gamma, velocity (Omega, V), see
    ``rolling_on_a_plane``. Left out: place and heading; ``reconstruct`` gives them back.
    """
    lengths = checked_numbers("semiaxes", semiaxes, (3,))
    moments = checked_numbers("inertia", inertia, (3,))
    omega = checked_numbers("spin", spin, (3,))
    matrix = np.diag(moments)
    matrix[0, 1] = matrix[1, 0] = product
    parameters = {"m": mass, "g": gravity, "I": matrix, "axes": lengths, "depth": depth}
    system = rolling_body(_lowest_point, parameters, Cayley() if retraction is None else retraction)
    first, second = np.radians([roll, pitch])
    vertical = np.array(
        [-np.cos(first) * np.sin(second), np.sin(first), np.cos(first) * np.cos(second)]
    )
    arm = _lowest_point(vertical, Parameters(system.parameters))
    return Scene(
        system,
        system.state(vertical, rolling_velocity(omega, arm)),
        "rattleback as vertical and body velocities; place and heading left out",
    )


def _lowest_point(gamma: Array, p: Parameters) -> Any:
    """Where the tangent plane is horizontal, from the centre of mass."""
    squares = p.axes**2
    support = np.sqrt(squares @ gamma**2)
    return -squares * gamma / support + p.depth * np.array([0.0, 0.0, 1.0])
