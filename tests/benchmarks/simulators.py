"""Rolling in general simulators: a ball in MuJoCo, a disc in Exudyn, and both in this library.

    python tests/benchmarks/simulators.py [--quick]

MuJoCo has no nonholonomic constraint: the ball is a free body on a plane with friction in a contact
that is soft in all directions. Its settings are those that bring it closest: an elliptic friction
cone, Newton's solver to 1e-12, a contact as stiff as the step allows, friction that never slides.

Exudyn has one joint that rolls ideally, ``ObjectJointRollingDisc``: three constraints on the
velocity of the disc's lowest point, with multipliers. Its spheres (ObjectContactSphereSphere,
ObjectContactConvexRoll) touch by penalty, so the disc is compared. Two formulations come out best
of those tried (three kinds of nodes, spectral radii 0.6 to 1, full and modified Newton, tolerances
1e-6 to 1e-10): the rotation vector on the Lie group with the trapezoidal rule of index 2, the most
exact, and Euler parameters with generalized alpha, spectral radius 0.9, the cheapest step. Both are
given the fast build (no range checks), one thread, modified Newton and the tolerances that Exudyn
has by default (1e-8 relative, 1e-10 absolute; with 1e-6 for both the errors of the pose are the
same and it took 9 to 16 % less time), no files, no sensors, no output. The time is that of
``SolveDynamic`` (0.05 ms of it prepare the solver), and of the loop for this library (``integrate``
prepares for 0.3 ms); building and compiling are apart. The smallest of several repeats counts.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports.markdown import markdown_table  # noqa: E402

T = DISC_T = 2.0
WORLD = """
<mujoco>
  <option timestep="{h}" gravity="0 0 -9.81" integrator="implicitfast" cone="elliptic"
          impratio="1000" solver="Newton" tolerance="1e-12" iterations="100">
    <flag energy="enable"/>
  </option>
  <worldbody>
    <geom type="plane" size="100 100 1" condim="3" friction="10 0 0" solref="{soft} 1"
          solimp="0.9999 0.9999 0.001"/>
    <body pos="{x} {y} {r}" quat="{quat}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{m}" diaginertia="{inertia}"/>
      <geom type="sphere" size="{r}" condim="3" friction="10 0 0" solref="{soft} 1"
            solimp="0.9999 0.9999 0.001"/>
    </body>
  </worldbody>
</mujoco>
"""


def mujoco_run(mujoco: Any, scene: gni.scenes.Scene, h: float) -> tuple[np.ndarray, ...]:
    """Place, rotation and velocity (v, Omega) at T, and seconds."""
    p, base = scene.system.parameters, scene.start.base
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, base[2:])
    words = {
        "h": h, "soft": 2.0 * h, "x": base[0], "y": base[1], "r": float(p["r"]),
        "quat": " ".join(map(repr, quat.tolist())), "m": float(p["m"]),
        "inertia": " ".join(repr(float(i)) for i in p["I"]),
    }  # fmt: skip
    model = mujoco.MjModel.from_xml_string(WORLD.format(**words))
    data = mujoco.MjData(model)
    data.qvel[:2], data.qvel[3:] = scene.start.velocity[:2], scene.start.velocity[2:]
    steps = round(T / h)
    began = time.perf_counter()
    mujoco.mj_step(model, data, steps)
    seconds = time.perf_counter() - began
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:])
    velocity = np.concatenate([data.qvel[:2], data.qvel[3:]])
    return data.qpos[:2].copy(), rotation, velocity, np.array(seconds)


def mujoco_module() -> Any:
    """The module, or None when it is not installed."""
    try:
        import mujoco
    except ImportError:
        return None
    return mujoco


def ball_section(quick: bool) -> str:
    """The ball: errors, slip and energy at T, and the time taken."""
    scene = gni.scenes.inhomogeneous_ball(table=0.0)
    reference = gni.integrate(scene.system, scene.start, step=T, n_steps=1,
                              method=gni.ReferenceFlow(rtol=1e-13))  # fmt: skip
    base, velocity = reference.final_state
    body = []

    def line(name: str, b: np.ndarray, v: np.ndarray, seconds: float) -> None:
        slip = np.max(np.abs(scene.system.constraint_residuals(b[None], v[None])))
        energy = 0.5 * v @ scene.system.evaluate("metric", base) @ v
        before = 0.5 * scene.start.velocity @ scene.start.momentum
        body.append([
            name, f"{np.max(np.abs(b[:2] - base[:2])):.1e}",
            f"{np.max(np.abs(b[2:] - base[2:])):.1e}", f"{np.max(np.abs(v - velocity)):.1e}",
            f"{slip:.1e}", f"{abs(energy / before - 1.0):.1e}", f"{1e6 * seconds:.0f}",
        ])  # fmt: skip

    for h in (0.02, 0.005) if quick else (0.05, 0.02, 0.01, 0.005, 0.002):
        for order in (2, 4):
            run = gni.integrate(scene.system, scene.start, step=h, t_end=T,
                                method=gni.GNI(order=order))  # fmt: skip
            line(f"GNI {order}, h = {h}", run.base[-1], run.velocities[-1], run.seconds)
    mujoco = mujoco_module()
    if mujoco is None:
        note = "MuJoCo is not installed (pip install 'groupoid-gni[peers]') and left out."
    else:
        note = f"MuJoCo {mujoco.__version__}."
        for h in (5e-3, 1e-3) if quick else (5e-3, 2e-3, 1e-3, 5e-4, 2e-4):
            place, rotation, v, seconds = mujoco_run(mujoco, scene, h)
            line(f"MuJoCo, h = {h}", np.concatenate([place, rotation]), v, float(seconds))
    heading = ["", "place", "attitude", "velocity", "slip", "energy", "microseconds"]
    return (
        f"Inhomogeneous ball on a table at rest, t = {T}: errors at the end. {note}\n\n"
        + markdown_table(heading, body)
    )


# The disc.


@dataclass(frozen=True)
class DiscEnd:
    """A disc at T: pose (4, 4), velocity (Omega, V) in the body frame, height of the centre, s."""

    pose: np.ndarray
    velocity: np.ndarray
    height: float
    seconds: float


def upright_pose(gamma: np.ndarray, radius: float) -> np.ndarray:
    """A pose (4, 4) above the origin that sees the vertical as gamma, touching the plane."""
    across = np.cross(gamma, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    pose = np.eye(4)
    pose[:3, :3] = across, np.cross(gamma, across), gamma
    pose[2, 3] = radius * np.hypot(gamma[0], gamma[1])
    return pose


def our_disc(scene: gni.scenes.Scene, h: float, method: Any, steps: int | None = None) -> DiscEnd:
    """The library's run of ``steps`` steps of h, to DISC_T when left out; NaN where it fails."""
    radius = float(scene.system.parameters["r"])
    count = round(DISC_T / h) if steps is None else steps
    run = gni.integrate(
        scene.system, scene.start, step=h, n_steps=count, method=method, save_every=count,
        reconstruct=upright_pose(scene.start.base, radius), on_failure="return",
    )  # fmt: skip
    if not run.success:
        return DiscEnd(np.full((4, 4), np.nan), np.full(6, np.nan), np.nan, run.seconds)
    height = radius * float(np.hypot(*run.base[-1, :2]))
    return DiscEnd(run.reconstruct()[-1], run.velocities[-1], height, run.seconds)


@cache
def exudyn_module() -> Any:
    """The module in its fast build, or None when it is not installed."""
    sys.exudynFast = True  # type: ignore[attr-defined]  # has to be said before the import
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            import exudyn
            import exudyn.itemInterface
            import exudyn.utilities
        except ImportError:
            return None
    return exudyn


FORMULATIONS = {
    "Lie group": "RotationRotationVector",
    "Euler parameters": "RotationEulerParameters",
}


def exudyn_disc(exudyn: Any, scene: gni.scenes.Scene, h: float, formulation: str) -> DiscEnd:
    """The same disc in Exudyn, in one of FORMULATIONS. Raises RuntimeError where it fails."""
    p, items = scene.system.parameters, exudyn.itemInterface
    pose = upright_pose(scene.start.base, float(p["r"]))
    rotation, (spin, speed) = pose[:3, :3], scene.start.velocity.reshape(2, 3)
    system = exudyn.SystemContainer().AddSystem()
    ground = system.AddObject(items.ObjectGround())
    disc = system.CreateRigidBody(
        inertia=exudyn.utilities.RigidBodyInertia(mass=float(p["m"]), inertiaTensor=p["I"]),
        referencePosition=pose[:3, 3].tolist(), referenceRotationMatrix=rotation,
        initialVelocity=(rotation @ speed).tolist(),
        initialAngularVelocity=(rotation @ spin).tolist(), gravity=[0.0, 0.0, -float(p["g"])],
        nodeType=getattr(exudyn.NodeType, FORMULATIONS[formulation]),
    )  # fmt: skip
    markers = [system.AddMarker(items.MarkerBodyRigid(bodyNumber=body)) for body in (ground, disc)]
    system.AddObject(items.ObjectJointRollingDisc(
        markerNumbers=markers, discRadius=float(p["r"]), discAxis=[0.0, 0.0, 1.0],
        planeNormal=[0.0, 0.0, 1.0],
    ))  # fmt: skip
    system.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.endTime = DISC_T
    settings.timeIntegration.numberOfSteps = round(DISC_T / h)
    settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
    settings.solution.file.write = False
    solver = exudyn.DynamicSolverType.GeneralizedAlpha
    if formulation == "Lie group":
        solver = exudyn.DynamicSolverType.TrapezoidalIndex2
    began = time.perf_counter()
    solved = system.SolveDynamic(settings, solverType=solver)
    seconds = time.perf_counter() - began
    if not solved:
        raise RuntimeError(f"Exudyn, {formulation}: no solution with steps of {h}")

    def value(kind: str) -> np.ndarray:
        wanted = getattr(exudyn.OutputVariableType, kind)
        return np.array(system.GetObjectOutputBody(disc, wanted, localPosition=[0.0, 0.0, 0.0]))

    end = np.eye(4)
    end[:3, :3], end[:3, 3] = value("RotationMatrix").reshape(3, 3), value("Position")
    velocity = np.concatenate([value("AngularVelocityLocal"), end[:3, :3].T @ value("Velocity")])
    return DiscEnd(end, velocity, float(end[2, 3]), seconds)


def quickest(run: Callable[[], DiscEnd], repeats: int) -> DiscEnd:
    """The repeat that took the least time."""
    return min((run() for _ in range(repeats)), key=lambda end: end.seconds)


@dataclass(frozen=True)
class DiscErrors:
    """Place and attitude (largest entries), energy (relative), slip, and height above touching."""

    place: float
    attitude: float
    energy: float
    slip: float
    lift: float

    @property
    def pose(self) -> float:
        """The larger of place and attitude; not a number for a failed run."""
        return float(np.maximum(self.place, self.attitude))


def disc_errors(scene: gni.scenes.Scene, end: DiscEnd, wanted: np.ndarray) -> DiscErrors:
    """Against the pose (4, 4) that is wanted; energy with the height that the integrator has."""
    p, gamma = scene.system.parameters, end.pose[2, :3]

    def energy(velocity: np.ndarray, height: float) -> float:
        metric = scene.system.evaluate("metric", scene.start.base)
        return float(0.5 * velocity @ metric @ velocity + p["m"] * p["g"] * height)

    before = energy(scene.start.velocity, upright_pose(scene.start.base, float(p["r"]))[2, 3])
    gap = np.abs(end.pose - wanted)[:3]
    slip = scene.system.constraint_residuals(gamma[None], end.velocity[None])
    touching = float(p["r"]) * np.hypot(gamma[0], gamma[1])
    return DiscErrors(
        float(np.max(gap[:, 3])), float(np.max(gap[:, :3])),
        abs(energy(end.velocity, end.height) / before - 1.0), float(np.max(np.abs(slip))),
        abs(end.pose[2, 3] - touching),
    )  # fmt: skip


def as_exact(
    scene: gni.scenes.Scene, method: Any, error: float, wanted: np.ndarray, repeats: int
) -> tuple[float, float] | None:
    """The largest step of a ladder (factor 2^(1/4)) from which on the error of the pose is reached,
    and the seconds it takes; None when none reaches it. A run that warns does not count.
    """

    def reached(count: int) -> bool:
        with warnings.catch_warnings():
            warnings.simplefilter("error", gni.GNIWarning)
            try:
                end = our_disc(scene, DISC_T / count, method)
            except gni.GNIWarning:
                return False
        return disc_errors(scene, end, wanted).pose <= error

    before = 0
    for count in (round(20 * 2.0 ** (k / 4)) for k in range(41)):
        # two in a row, so that an error that happens to pass through zero does not count
        here = reached(count)
        if here and before:
            h = DISC_T / before
            fastest = quickest(partial(our_disc, scene, h, method), repeats)
            return h, fastest.seconds
        before = count if here else 0
    return None


DISC_METHODS = {"GNI 2": gni.GNI(), "GNI 4": gni.GNI(order=4)}


def disc_section(quick: bool) -> str:
    """The disc: errors of all at the same steps, and the time of ours at the error of Exudyn."""
    scene = gni.scenes.rolling_disc()
    repeats = 3 if quick else 9
    wanted = our_disc(scene, DISC_T, gni.ReferenceFlow(rtol=1e-13), steps=1).pose
    steps = (0.01, 0.0025) if quick else (0.01, 0.005, 0.0025, 0.001, 0.0005)
    exudyn = exudyn_module()
    body, faster = [], []

    def line(name: str, h: float, run: Callable[[], DiscEnd]) -> tuple[DiscEnd, DiscErrors]:
        end = quickest(run, repeats)
        errors = disc_errors(scene, end, wanted)
        shown = (errors.place, errors.attitude, errors.energy, errors.slip, errors.lift)
        body.append([
            f"{name}, h = {h}", *(f"{value:.1e}" for value in shown),
            f"{1e6 * end.seconds * h / DISC_T:.2f}", f"{1e3 * end.seconds:.3f}",
        ])  # fmt: skip
        return end, errors

    for h, name, method in ((h, *pair) for h in steps for pair in DISC_METHODS.items()):
        line(name, h, partial(our_disc, scene, h, method))
    for name, h in exudyn_lines(exudyn, steps):
        end, errors = line(f"Exudyn, {name}", h, partial(exudyn_disc, exudyn, scene, h, name))
        row = [f"Exudyn, {name}, h = {h}", f"{errors.pose:.1e}", f"{1e3 * end.seconds:.3f}"]
        for method in DISC_METHODS.values():
            found = as_exact(scene, method, errors.pose, wanted, repeats)
            cells = ["-"] * 3
            if found is not None:
                times = (f"{1e3 * found[1]:.3f}", f"{end.seconds / found[1]:.1f}")
                cells = [f"{found[0]:.2g}", *times]
            row += cells
        faster.append(row)
    return _disc_text(exudyn, body, faster)


def exudyn_lines(exudyn: Any, steps: tuple[float, ...]) -> Iterator[tuple[str, float]]:
    """Formulations and steps; none where Exudyn is not installed."""
    if exudyn is not None:
        yield from ((name, h) for name in FORMULATIONS for h in steps)


def _disc_text(exudyn: Any, body: list[list[str]], faster: list[list[str]]) -> str:
    note = (
        "Exudyn is not installed (pip install 'groupoid-gni[peers]') and left out."
        if exudyn is None
        else f"Exudyn {exudyn.__version__}: its joint for rolling discs, in two formulations, fast "
        "build. For balls it has contacts by penalty only."
    )
    heading = ["", "place", "attitude", "energy", "slip", "lift", "us per step", "ms"]
    text = [
        f"Heavy disc on a plane, t = {DISC_T}: errors at the end; lift is the distance of the "
        f"lowest point from the plane. {note}",
        markdown_table(heading, body),
    ]
    if faster:
        columns = ["", "error", "ms"]
        for name in DISC_METHODS:
            columns += [f"{name}, h", "ms", "times faster"]
        text += [
            "At the same error (the larger of place and attitude), with the largest step that "
            "reaches it:",
            markdown_table(columns, faster),
        ]
    return "\n\n".join(text)


def section(quick: bool) -> str:
    """The ball and the disc."""
    return ball_section(quick) + "\n\n" + disc_section(quick)


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few step sizes")
    print(section(parser.parse_args(arguments).quick))


if __name__ == "__main__":
    main()
