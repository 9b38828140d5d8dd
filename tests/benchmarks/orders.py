"""Observed orders on every kind of groupoid: slopes of the error at the end of a short run.

    python tests/benchmarks/orders.py [--details]

Prints the tables of docs/how_to_choose.md. The error is the largest one of base point and
velocity at the end, against the equations of motion at 1e-13. Step sizes form a ladder on which a
method of the nominal order divides its error by 4 from rung to rung; the slope is that of the last
four rungs above the plateau: 30 times the reference run's estimate of its own error, and 3e-12
(order 6: 3e-13). Order 8 has so little room that it takes the last three, above 1e-13. Cells off
by more than 0.15 are listed, with the slope of their last two rungs and, for order 8, the slope of
the same flow with a table of larger errors: where that one is right, the flow is not to blame.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
TESTS = HERE.parent
sys.path[:0] = [str(HERE), str(TESTS / "scenes"), str(TESTS / "discretization"), str(TESTS.parent)]

import measures  # noqa: E402
import zoo  # noqa: E402
from six_systems import print_table  # noqa: E402

import groupoid_gni as gni  # noqa: E402

ORDERS = (2, 4, 6, 8)
_HALF = (
    0.13020248308889008088, 0.56116298177510838456, -0.38947496264484728641,
    0.1588419065551556009, -0.39590389413323757734, 0.18453964097831570709,
    0.25837438768632204729, 0.29501172360931029887,
)  # fmt: skip
SEVENTEEN_STAGES = gni.CompositionTable(
    "Kahan-Li s17odr8a", 8, (*_HALF, 1.0 - 2.0 * sum(_HALF), *_HALF[::-1]),
    "W. Kahan and R.-C. Li 1997, Math. Comp. 66, 1089-1099, s17odr8a", projected=True,
)  # fmt: skip
"""Of larger errors than the default of order 8, and so with more rungs above the plateau."""
SEVENTEEN_TWICE = gni.CompositionTable(
    "s17odr8a, doubled", 8, tuple(g / 2.0 for g in SEVENTEEN_STAGES.stages for _ in range(2)),
    SEVENTEEN_STAGES.source, projected=False,
)  # fmt: skip
RUNGS, LEAST_RUNGS, PER_RUNG = {2: 4, 4: 4, 6: 4, 8: 3}, 3, 4.0
COARSEST, MOST_STEPS = {2: 32, 4: 4, 6: 2, 8: 1}, 20_000
"""Steps on the first rung for each order, and where a ladder ends at the latest."""
ABOVE_ESTIMATE, ABOVE_ROUND_OFF, ROUND_OFF = 30.0, {2: 30.0, 4: 30.0, 6: 3.0, 8: 1.0}, 1e-13
AGREES = 0.15

Columns = dict[str, dict[str, Any]]
FLOWS: Columns = {
    title: {str(order): gni.GNI(order, flow) for order in ORDERS}
    for title, flow in (
        ("Variational", gni.Variational()),
        ("Splitting", gni.Splitting()),
        ("EnergyPreserving", gni.EnergyPreserving()),
    )
}
OTHERS: Columns = {
    "projection=None": {str(order): gni.GNI(order, projection=None) for order in ORDERS},
    "s17odr8a": {"8": gni.GNI(8, table=SEVENTEEN_STAGES)},
    "McLachlanPerlmutter": {str(order): gni.McLachlanPerlmutter(order) for order in (2, 4)},
}


@dataclass(frozen=True)
class Row:
    """A system with a start, run from 0 to t_end; ``scene`` only carries the two."""

    name: str
    scene: Any
    t_end: float

    @cached_property
    def reference(self) -> tuple[tuple[Any, Any], float]:
        """(base, velocity) at the end, and the estimate of their error."""
        run = gni.integrate(
            self.scene.system, self.scene.start, step=self.t_end, n_steps=1,
            method=gni.ReferenceFlow(rtol=1e-13),
        )  # fmt: skip
        return run.final_state, float(run.error_estimate()[-1])

    def plateau(self, order: int) -> float:
        """Below it errors are not trusted."""
        _, estimate = self.reference
        return max(ABOVE_ESTIMATE * estimate, ABOVE_ROUND_OFF[order] * ROUND_OFF)

    def error(self, method: Any, count: int) -> float:
        """Largest error at the end after ``count`` steps; infinite where a step needed rescue."""
        truth, _ = self.reference
        with warnings.catch_warnings():
            warnings.simplefilter("error", gni.RescuedStepsWarning)
            try:
                return float(measures.end_errors(self.scene, method, self.t_end, [count], truth)[0])
            except (gni.StepFailure, gni.RescuedStepsWarning):
                return np.inf


@dataclass(frozen=True)
class Observation:
    """Rungs above the plateau, (k,) steps and (k,) errors; none where the flow does not apply."""

    order: int
    counts: Any
    errors: Any
    refused: str = ""

    @property
    def slope(self) -> float:
        """Of the last rungs; NaN where they are too few."""
        if len(self.counts) < LEAST_RUNGS:
            return float("nan")
        last = RUNGS[self.order]
        return measures.slope(self.counts[-last:], self.errors[-last:])

    @property
    def final_slope(self) -> float:
        """Of the last two rungs."""
        return measures.slope(self.counts[-2:], self.errors[-2:])

    @property
    def cell(self) -> str:
        """What the table shows."""
        if self.refused:
            return "-"
        if len(self.counts) == 0:
            return "exact"
        return "few" if np.isnan(self.slope) else f"{self.slope:.2f}"

    def __str__(self) -> str:
        if self.refused or len(self.counts) < 2:
            return self.cell
        rungs = zip(self.counts, self.errors, strict=True)
        listed = ", ".join(f"{n}: {error:.1e}" for n, error in rungs)
        return f"{self.cell}, last two rungs {self.final_slope:.2f} ({listed})"

    @property
    def agrees(self) -> bool:
        """Whether the slope is the order, or there is none to have."""
        return self.cell in ("-", "exact") or abs(self.slope - self.order) <= AGREES


def observe(row: Row, method: Any) -> Observation:
    """Climb the ladder until the error is on the plateau."""
    order = method.order
    counts: list[int] = []
    errors: list[float] = []
    plateau = row.plateau(order)
    count = float(COARSEST[order])
    while count < MOST_STEPS:
        n = round(count)
        count *= PER_RUNG ** (1.0 / order)
        if n in counts:
            continue
        try:
            error = row.error(method, n)
        except gni.InputError as refusal:
            return Observation(order, [], [], str(refusal))
        if error < plateau:
            break
        counts.append(n)
        errors.append(error)
    known = np.isfinite(errors)
    return Observation(order, np.array(counts)[known], np.array(errors)[known])


# The systems.


def loaded(path: Path) -> ModuleType:
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def with_force(scene: Any, force: Callable[..., Any], **constants: float) -> gni.scenes.Scene:
    """The same system with a force; (x, xi, p) -> (r,)."""
    given = scene.system
    system = gni.MechanicalSystem(
        given.space, force=force, parameters={**given.parameters, **constants}, **given.plain
    )
    return gni.scenes.Scene(
        system, system.state(scene.start.base, scene.start.velocity), "with a force"
    )


def drag(x: Any, xi: Any, p: Any) -> Any:
    """Friction that grows with the square of the speed."""
    return -p.friction * (0.4 + xi @ xi) * xi


def hopf_top() -> gni.scenes.Scene:
    """The driven Veselova top of examples/hopf_gauge_groupoid.py, all terms switched on."""
    hopf = loaded(TESTS.parent / "examples" / "hopf_gauge_groupoid.py")
    top = hopf.veselova_top(hopf.HopfGaugeGroupoid()).with_parameters(Omega=0.6)
    start = top.state(hopf.BASE, hopf.VELOCITY, project_start=True)
    return gni.scenes.Scene(top, start, "top on the Hopf gauge groupoid")


def rows() -> list[Row]:
    """Systems on every kind of groupoid; 1, 2 and 3 constraints."""
    scenes, animal = gni.scenes, zoo.animal
    bent = animal("pair 3", 1)
    heavy = scenes.veselova(rate=0.3, weight=(0.3, 0.2, 1.1), vertical=(0, 0, 1),
                            spin=(0.5, 0.4, 0.3))  # fmt: skip
    sleigh = scenes.chaplygin_sleigh(1.4, 0.7, 0.35)
    turned = {"affine": True, "seed": 1, "speed": 4.0}
    return [
        Row("pair R^3, m = 1", bent, 2.0),
        Row("pair R^3, m = 2, drift, gyroscopic",
            animal("pair 3", 2, affine=True, gyroscopic=True, seed=1, speed=2.0), 3.0),
        Row("pair R^3, m = 1, friction", with_force(bent, drag, friction=0.2), 2.0),
        Row("SO(3) left, Cayley, m = 1", animal("SO3 left cay", 1, speed=6.0), 3.0),
        Row("SO(3) right, exponential, m = 1, drift", animal("SO3 right exp", 1, **turned), 3.0),
        Row("SE(2) left, Cayley: sleigh, m = 1", sleigh, 2.0),
        Row("SE(2) right, exponential, m = 1, drift", animal("SE2 right exp", 1, **turned), 3.0),
        Row("SE(3) left, exponential, m = 2, drift", animal("SE3 left exp", 2, affine=True), 2.0),
        Row("SE(3) right, Cayley, m = 3", animal("SE3 right cay", 3, speed=4.0), 3.0),
        Row("Atiyah R^2 x SO(3) right, m = 2, drift",
            animal("atiyah right cay", 2, affine=True, speed=2.0), 2.0),
        Row("framed pair: inhomogeneous ball, m = 2, drift", scenes.inhomogeneous_ball(), 2.0),
        Row("framed pair: variable transmission, m = 1", scenes.variable_transmission(), 2.0),
        Row("action groupoid: driven heavy Veselova body, m = 1", heavy, 2.0),
        Row("product SE(2)^2 x R^2 x SO(3), m = 3, gyroscopic",
            animal("product cay", 3, gyroscopic=True), 2.0),
        Row("product R^2 x SE(2): robot over a detent, friction, m = 3",
            with_force(scenes.two_wheeled_robot(detent=0.6), drag, friction=0.01), 1.0),
        Row("Hopf gauge groupoid, m = 1, drift, gyroscopic", hopf_top(), 2.0),
    ]  # fmt: skip


# What is printed.


Cells = list[tuple[Row, Any, Observation]]


def table(systems: list[Row], columns: Columns) -> Cells:
    """(system, method, observation), row by row."""
    return [
        (row, method, observe(row, method))
        for row in systems
        for methods in columns.values()
        for method in methods.values()
    ]


def with_seventeen_stages(method: Any) -> Any:
    """The same flow and projection with the other table of order 8."""
    own = SEVENTEEN_STAGES if method.projection else SEVENTEEN_TWICE
    return gni.GNI(8, method.flow, projection=method.projection, table=own)


def show(systems: list[Row], columns: Columns) -> Cells:
    """Print one table; returns its cells."""
    cells = table(systems, columns)
    heading = [f"{title} {order}" for title, methods in columns.items() for order in methods]
    width = len(heading)
    body = [
        [row.name, *(seen.cell for _, _, seen in cells[width * i : width * (i + 1)])]
        for i, row in enumerate(systems)
    ]
    print_table(["", *heading], body)
    return cells


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--details", action="store_true", help="steps and errors of every cell")
    details = parser.parse_args(arguments).details
    systems = rows()
    print("Observed orders of GNI by flow, symmetric projection")
    cells = show(systems, FLOWS)
    print("\nObserved orders without projection, and of McLachlan and Perlmutter's method")
    cells += show(systems, OTHERS)
    slopes = [seen for _, _, seen in cells if np.isfinite(seen.slope)]
    agree = sum(seen.agrees for seen in slopes)
    print(f"\n{agree} of {len(slopes)} slopes within {AGREES} of the order. The others:")
    for row, method, seen in cells:
        if details or not seen.agrees:
            print(f"- {row.name}, {method}: {seen}")
        if not seen.agrees and method.order == 8 and method.table is None:
            print(f"  with 17 stages: {observe(row, with_seventeen_stages(method))}")



if __name__ == "__main__":
    main()
