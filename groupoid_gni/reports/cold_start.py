"""From the start of a process to the end of ten thousand steps, piece by piece."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

STEPS = 10_000

_WHOLE = """
import groupoid_gni as gni
scene = gni.scenes.{scene}()
run = gni.integrate(scene.system, scene.start, step={step}, n_steps={steps})
if not run.success:
    raise SystemExit(run.message)
"""
_PARTS = """
import json, time
began = time.perf_counter()
import groupoid_gni as gni
imported = time.perf_counter()
scene = gni.scenes.{scene}()
terms = ("metric", "constraints", "drift", "gyroscopic", "potential")
for name in terms:
    if scene.system.has(name):
        scene.system.recorded(name)
recorded = time.perf_counter()
from groupoid_gni.reports.cost_model import built
_, times, _ = built(scene.system, gni.GNI(), scene.start.active_rows)
run = gni.integrate(scene.system, scene.start, step={step}, n_steps={steps})
print(json.dumps([imported - began, recorded - imported, times.derive, times.emit, times.compile,
                  run.seconds]))
"""


@dataclass(frozen=True)
class ColdStart:
    """Seconds, the smallest of the repeats of each.

    whole : a process of its own, from start to end, object cache off.  imports ... run : the parts,
    measured in another process; interpreter start and CasADi's evaluation of the start are in
    ``whole`` only.
    """

    scene: str
    whole: float
    imports: float
    record: float
    differentiate: float
    emit: float
    compile: float
    run: float


def cold_start(scene: str, step: float = 0.01, repeats: int = 3) -> ColdStart:
    """Start processes that make a scene of ``gni.scenes`` and do 10^4 steps of ``GNI()``."""
    filled = {"scene": scene, "step": step, "steps": STEPS}
    whole, parts = [], []
    for _ in range(repeats):
        began = time.perf_counter()
        _process(_WHOLE.format(**filled))
        whole.append(time.perf_counter() - began)
        parts.append(json.loads(_process(_PARTS.format(**filled))))
    return ColdStart(scene, min(whole), *(min(column) for column in zip(*parts, strict=True)))


def _process(code: str) -> str:
    package_parent = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [package_parent, os.environ.get("PYTHONPATH", "")]))
    environment = dict(os.environ, GROUPOID_GNI_CACHE="", PYTHONPATH=path)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout
