"""The six systems without reduction, as models of their own: what the scenes are measured against.

Each maker takes a scene and returns the system on the whole configuration space Q, its start, and
the map from its nodes to those of the scene. ``framed`` models use the frame that the symmetry
group moves along (body or space velocities), ``in_coordinates`` those of a textbook.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import groupoid_gni as gni


@dataclass(frozen=True)
class FullModel:
    """A system on Q, its start, and its nodes seen as nodes of the scene.

    down : (base (n, size), velocities (n, rank)) -> (base, velocities) of the scene.
    """

    system: gni.MechanicalSystem
    start: gni.State
    down: Callable[[Any, Any], tuple[Any, Any]]

    def motion(self, run: gni.Trajectory) -> tuple[Any, Any]:
        """A run of this model in the variables of the scene."""
        return self.down(run.base, run.velocities)


def _rotation_by(angle: float) -> Any:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _plane_motion(x: float, y: float, heading: float) -> Any:
    pose = np.eye(3)
    pose[:2, :2], pose[:2, 2] = _rotation_by(heading), (x, y)
    return pose


def particle(scene: gni.scenes.Scene, x: float = 0.4, z: float = -0.7) -> FullModel:
    """(x, y, z) on R^3 x R^3."""
    springs = scene.system.has("potential")
    kept = len(scene.start.base)
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda q, p: p.m * np.eye(3),
        constraints=lambda q, p: np.array([[-q[1], 0.0, 1.0]]),
        potential=(lambda q, p: (p.k_x * q[0] ** 2 + p.k_y * q[1] ** 2) / 2) if springs else None,
        parameters={"k_x": 0.0, **scene.system.parameters},
    )
    y, *known = scene.start.base
    vy, vx, vz = scene.start.velocity
    start = system.state([known[0] if known else x, y, z], [vx, vy, vz])
    return FullModel(system, start, lambda q, v: (q[:, [1, 0][:kept]], v[:, [1, 0, 2]]))


def suslov(scene: gni.scenes.Scene) -> FullModel:
    """Attitude R and body angular velocity on SO(3) x SO(3)."""
    group = gni.SO3(retraction=scene.system.space.retraction)
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(group),
        metric=lambda x, p: p.I,
        constraints=lambda x, p: p.a[None, :],
        parameters=scene.system.parameters,
    )
    attitude = group.exp(np.array([0.3, -0.8, 0.5]))
    start = system.state(attitude.ravel(), scene.start.velocity)
    return FullModel(system, start, lambda q, v: (q[:, :0], v))


def sleigh(scene: gni.scenes.Scene) -> FullModel:
    """Pose and body velocities on SE(2) x SE(2)."""
    group = gni.SE2(retraction=scene.system.space.retraction)
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(group),
        metric=lambda x, p: np.array(
            [[p.J + p.m * p.a**2, 0.0, p.m * p.a], [0.0, p.m, 0.0], [p.m * p.a, 0.0, p.m]]
        ),
        constraints=[[0.0, 0.0, 1.0]],
        parameters=scene.system.parameters,
    )
    start = system.state(_plane_motion(0.3, -0.2, 0.7).ravel(), scene.start.velocity)
    return FullModel(system, start, lambda q, v: (q[:, :0], v))


def sleigh_in_coordinates(scene: gni.scenes.Scene) -> FullModel:
    """Contact point and heading (x, y, theta) on R^3 x R^3."""
    system = gni.MechanicalSystem(
        gni.PairGroupoid(3),
        metric=lambda q, p: np.array(
            [
                [p.m, 0.0, -p.m * p.a * np.sin(q[2])],
                [0.0, p.m, p.m * p.a * np.cos(q[2])],
                [-p.m * p.a * np.sin(q[2]), p.m * p.a * np.cos(q[2]), p.J + p.m * p.a**2],
            ]
        ),
        constraints=lambda q, p: np.array([[-np.sin(q[2]), np.cos(q[2]), 0.0]]),
        parameters=scene.system.parameters,
    )
    omega, along, _ = scene.start.velocity
    heading = 0.7
    forward = _rotation_by(heading)[:, 0]
    start = system.state([0.3, -0.2, heading], [*(along * forward), omega])
    return FullModel(system, start, lambda q, v: (q[:, :0], _body_velocities(q[:, 2], v)))


def _body_velocities(heading: Any, v: Any) -> Any:
    """(x', y', theta') -> (theta', along, across)."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([v[:, 2], c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]], axis=1)


def veselova(scene: gni.scenes.Scene) -> FullModel:
    """Attitude R and body angular velocity on SO(3) x SO(3); the vertical is the last row of R."""
    group = gni.SO3(retraction=scene.system.space.group.retraction)
    weighted = scene.system.has("potential")
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(group),
        metric=lambda x, p: np.diag(p.I),
        constraints=lambda x, p: x[None, 6:9],
        drift=(lambda x, p: p.c * x[6:9]) if scene.system.has("drift") else None,
        potential=(lambda x, p: p.weight @ x[6:9]) if weighted else None,
        parameters=scene.system.parameters,
    )
    vertical = scene.start.base
    level = np.cross(vertical, [0.6, -0.3, 0.5])
    level /= np.linalg.norm(level)
    attitude = np.stack([level, np.cross(vertical, level), vertical])
    start = system.state(attitude.ravel(), scene.start.velocity)
    return FullModel(system, start, lambda q, v: (q[:, 6:9], v))


def ball(scene: gni.scenes.Scene) -> FullModel:
    """Position, attitude, space angular velocity on (R^2 x SO(3)) x (R^2 x SO(3))."""
    group = gni.SO3(side="right", retraction=scene.system.space.group.retraction)
    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(gni.VectorGroup(2), group),
        metric=lambda x, p: np.diag([p.m, p.m, p.I, p.I, p.I]),
        constraints=lambda x, p: np.array(
            [[1.0, 0.0, 0.0, -p.r, 0.0], [0.0, 1.0, p.r, 0.0, 0.0]]
        ),
        drift=lambda x, p: np.array([-p.Theta * x[1], p.Theta * x[0], 0.0, 0.0, 0.0]),
        parameters=scene.system.parameters,
    )
    attitude = group.exp(np.array([0.4, 0.9, -0.6]))
    start = system.state(np.concatenate([scene.start.base, attitude.ravel()]), scene.start.velocity)
    return FullModel(system, start, lambda q, v: (q[:, :2], v))


def _robot_parts(p: Any) -> tuple[Any, Any, Any]:
    """Whole mass, inertia about the middle of the axle, mass times offset of the body."""
    axle = 2 * p.m_1 * p.c**2 + p.J_2
    return p.m_0 + 2 * p.m_1, p.J_0 + p.m_0 * p.l**2 + axle, p.m_0 * p.l


def robot(scene: gni.scenes.Scene) -> FullModel:
    """Wheel angles, pose, wheel rates, body velocities on Q x Q, Q = R^2 x SE(2)."""
    tau = scene.system.space.factors[-1].retraction
    kept = len(scene.start.base)

    def metric(x: Any, p: Any) -> Any:
        m, J, b = _robot_parts(p)
        body = np.array([[J, 0.0, b], [0.0, m, 0.0], [b, 0.0, m]])
        wheels = np.array([[p.J_2, 0.0], [0.0, p.J_2]])
        nothing = np.zeros((2, 3))
        return np.block([[wheels, nothing], [nothing.T, body]])

    system = gni.MechanicalSystem(
        gni.FramedPairGroupoid(gni.VectorGroup(2), gni.SE2(retraction=tau)),
        metric=metric,
        constraints=lambda x, p: np.array(
            [[0.0, 0, 0, 0, 1], [-p.R, 0, -p.c, 1, 0], [0, -p.R, p.c, 1, 0]]
        ),
        potential=(lambda x, p: p.k * np.sin(x[0])) if kept else None,
        parameters=scene.system.parameters,
    )
    angle = scene.start.base[0] if kept else -0.4
    pose = _plane_motion(0.3, -0.2, 0.7)
    start = system.state([angle, 0.9, *pose.ravel()], scene.start.velocity)
    return FullModel(system, start, lambda q, v: (q[:, :kept], v))


def robot_in_coordinates(scene: gni.scenes.Scene) -> FullModel:
    """(psi_1, psi_2, x, y, theta) on R^5 x R^5."""
    kept = len(scene.start.base)

    def metric(q: Any, p: Any) -> Any:
        m, J, b = _robot_parts(p)
        s, c = np.sin(q[4]), np.cos(q[4])
        return np.array(
            [
                [p.J_2, 0.0, 0.0, 0.0, 0.0],
                [0.0, p.J_2, 0.0, 0.0, 0.0],
                [0.0, 0.0, m, 0.0, -b * s],
                [0.0, 0.0, 0.0, m, b * c],
                [0.0, 0.0, -b * s, b * c, J],
            ]
        )

    def constraints(q: Any, p: Any) -> Any:
        s, c = np.sin(q[4]), np.cos(q[4])
        return np.array(
            [
                [0.0, 0.0, -s, c, 0.0],
                [-p.R, 0.0, c, s, -p.c],
                [0.0, -p.R, c, s, p.c],
            ]
        )

    system = gni.MechanicalSystem(
        gni.PairGroupoid(5),
        metric=metric,
        constraints=constraints,
        potential=(lambda q, p: p.k * np.sin(q[0])) if kept else None,
        parameters=scene.system.parameters,
    )
    left, right, omega, along, _ = scene.start.velocity
    heading = 0.7
    forward = along * _rotation_by(heading)[:, 0]
    angle = scene.start.base[0] if kept else -0.4
    start = system.state([angle, 0.9, 0.3, -0.2, heading], [left, right, *forward, omega])

    def down(q: Any, v: Any) -> tuple[Any, Any]:
        body = _body_velocities(q[:, 4], v[:, 2:])
        return q[:, :kept], np.concatenate([v[:, :2], body], axis=1)

    return FullModel(system, start, down)
