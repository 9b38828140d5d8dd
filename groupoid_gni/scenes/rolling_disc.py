"""The heavy disc that rolls on a horizontal plane, free to lean."""

from __future__ import annotations

from typing import Any

import numpy as np

from groupoid_gni.array_types import Array, ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import Cayley, Retraction
from groupoid_gni.scenes.rolling_on_a_plane import rolling_body, rolling_velocity
from groupoid_gni.scenes.scene import Scene, checked_numbers
from groupoid_gni.systems import Parameters


def rolling_disc(
    mass: float = 15.0,
    radius: float = 1.0,
    inertia: ArrayLike = (3.75, 7.5),
    gravity: float = 9.81,
    tilt: float = 15.0,
    spin: ArrayLike = (0.0, 15.0, 5.0),
    retraction: Retraction | None = None,
) -> Scene:
    """Thin disc that rolls without slipping on a plane, reduced by all motions of the plane.

    inertia : about a diameter and about the axis of the disc, which is the third body axis.
    tilt : degrees from upright at the start; 90 would be flat on the plane. The second body axis
        points uphill in the plane of the disc.
    spin : Omega at the start, body frame.

    Kept: the energy. Base gamma, velocity (Omega, V), see ``rolling_on_a_plane``. Left out: place
    and heading; ``reconstruct`` gives them back.

    The contact point is not defined for a disc that lies flat, gamma_3 = +-1, and runs round the
    rim the faster the flatter the disc is: steps must be small there. Falling flat without turning
    ends the run, with a message; a disc that turns at all gets up again.

    Raises InputError for a disc that lies flat at the start.
    """
    moments = checked_numbers("inertia", inertia, (2,))
    omega = checked_numbers("spin", spin, (3,))
    if not abs(tilt) < 90.0:
        raise InputError(f"tilt must lie between -90 and 90 degrees from upright, got {tilt}")
    across, along = moments
    parameters = {"m": mass, "g": gravity, "I": np.diag([across, across, along]), "r": radius}
    system = rolling_body(_lowest_point, parameters, Cayley() if retraction is None else retraction)
    lean = np.radians(tilt)
    vertical = np.array([0.0, np.cos(lean), np.sin(lean)])
    arm = _lowest_point(vertical, Parameters(system.parameters))
    return Scene(
        system,
        system.state(vertical, rolling_velocity(omega, arm)),
        "rolling disc as vertical and body velocities; place and heading left out",
    )


def _lowest_point(gamma: Array, p: Parameters) -> Any:
    """The lowest point of the rim, from the centre."""
    return -p.r / np.sqrt(gamma[0] ** 2 + gamma[1] ** 2) * gamma * np.array([1.0, 1.0, 0.0])
