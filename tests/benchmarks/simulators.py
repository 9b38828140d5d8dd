"""An inhomogeneous ball on a table at rest: this library against MuJoCo, which knows contacts only.

    python tests/benchmarks/simulators.py [--quick]

MuJoCo has no nonholonomic constraint: the ball is a free body on a plane with friction in a contact
that is soft in all directions. Its settings are those that bring it closest: an elliptic friction
cone, Newton's solver to 1e-12, a contact as stiff as the step allows, friction that never slides.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports.markdown import markdown_table  # noqa: E402

T = 2.0
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


def section(quick: bool) -> str:
    """Errors, slip and energy at T, and the time taken."""
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
        note = "MuJoCo is not installed (pip install 'groupoid-gni[peers]') and left out. "
    else:
        note = f"MuJoCo {mujoco.__version__}. "
        for h in (5e-3, 1e-3) if quick else (5e-3, 2e-3, 1e-3, 5e-4, 2e-4):
            place, rotation, v, seconds = mujoco_run(mujoco, scene, h)
            line(f"MuJoCo, h = {h}", np.concatenate([place, rotation]), v, float(seconds))
    heading = ["", "place", "attitude", "velocity", "slip", "energy", "microseconds"]
    return (
        f"Inhomogeneous ball on a table at rest, t = {T}: errors at the end. {note}Exudyn has a "
        "joint for rolling discs, and for balls contacts by penalty only: left out.\n\n"
        + markdown_table(heading, body)
    )


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few step sizes")
    print(section(parser.parse_args(arguments).quick))


if __name__ == "__main__":
    main()
