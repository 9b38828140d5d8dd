"""The smallest model of a scene against the same scene without reduction: motion, cost, memory.

    python tests/benchmarks/reductions.py [--quick]

The unreduced models are those of ``tests/scenes/full_models.py``: ``framed`` on all of Q in the
frame that the symmetry moves along, ``in coordinates`` those of a textbook.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "scenes"), str(HERE.parents[1])]

import full_models  # noqa: E402

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports import cost  # noqa: E402
from groupoid_gni.reports.markdown import markdown_table  # noqa: E402
from groupoid_gni.reports.timing import interleaved  # noqa: E402

STEP, NODES = 0.02, 200
METHODS = {"GNI 2": gni.GNI(), "GNI 4": gni.GNI(order=4)}


@dataclass(frozen=True)
class Reduction:
    """A scene, what its model leaves out, and the models that leave nothing out."""

    name: str
    scene: gni.scenes.Scene
    removed: str
    fulls: dict[str, Callable[[gni.scenes.Scene], full_models.FullModel]]


def reductions() -> list[Reduction]:
    """The four of them."""
    scenes, full = gni.scenes, full_models
    return [
        Reduction("ball", scenes.rolling_ball(1.7, 0.8, 0.6, 0.9, (0.7, -0.2), (0.3, 0.6)),
                  "attitude (SO(3))", {"framed": full.ball}),
        Reduction("sleigh", scenes.chaplygin_sleigh(), "place and heading (SE(2))",
                  {"framed": full.sleigh, "in coordinates": full.sleigh_in_coordinates}),
        Reduction("Suslov", scenes.suslov(), "attitude (SO(3))", {"framed": full.suslov}),
        Reduction("robot", scenes.two_wheeled_robot(), "place, heading, both wheel angles",
                  {"framed": full.robot, "in coordinates": full.robot_in_coordinates}),
    ]  # fmt: skip


def difference(reduction: Reduction, model: full_models.FullModel, method: Any) -> float:
    """Largest difference of base and velocities over 200 steps, in the variables of the scene."""
    small = _run(reduction.scene, method, NODES, 1)
    base, velocities = model.motion(_run(model, method, NODES, 1))
    return max(
        float(np.max(np.abs(base - small.base), initial=0.0)),
        float(np.max(np.abs(velocities - small.velocities))),
    )


def _run(model: Any, method: Any, steps: int, every: int) -> gni.Trajectory:
    return gni.integrate(
        model.system, model.start, step=STEP, n_steps=steps, method=method, save_every=every
    )


def rows(reduction: Reduction, name: str, steps: int, repeats: int) -> list[list[str]]:
    """One line for the scene and one for every full model."""
    method = METHODS[name]
    models: dict[str, Any] = {"smallest": reduction.scene}
    models.update({kind: make(reduction.scene) for kind, make in reduction.fulls.items()})
    timed = interleaved(
        [lambda model=model: _run(model, method, steps, steps).seconds
         for model in models.values()], repeats,
    )  # fmt: skip
    found, first = [], timed[0].smallest
    for (kind, model), times in zip(models.items(), timed, strict=True):
        counted = cost((model.system, model.start), method, step=STEP, n_steps=steps, repeats=1)
        run = _run(model, method, 1, 1)
        small = kind == "smallest"
        found.append([
            f"{reduction.name}, {name}, {kind}",
            f"{reduction.removed} left out" if small else "nothing left out",
            "-" if small else f"{difference(reduction, model, method):.0e}",
            f"{1e9 * times.smallest / steps:.0f}", f"{times.smallest / first:.2f}",
            f"{counted.per_step():.0f}", str(run.rows.shape[1]),
            f"{counted.build.total:.2f}",
        ])  # fmt: skip
    return found


def section(quick: bool) -> str:
    """The table with what it says."""
    steps, repeats = (500, 3) if quick else (1000, 40)
    names = ["GNI 2"] if quick else list(METHODS)
    body = [line for r in reductions() for name in names for line in rows(r, name, steps, repeats)]
    heading = ["model", "", "motion differs by", "ns per step", "times smallest", "operations",
               "numbers per node", "build s"]  # fmt: skip
    return (
        f"Steps of {STEP}; differences over {NODES} steps. In the frame that the symmetry moves "
        "along, the unreduced model makes the same motion to round-off; coordinates are another "
        "discretization, the same to its order.\n\n" + markdown_table(heading, body)
    )


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few repeats, one method")
    print(section(parser.parse_args(arguments).quick))


if __name__ == "__main__":
    main()
