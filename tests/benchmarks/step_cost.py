"""What one step costs, against hand-written C; and what a process costs from start to end.

    python tests/benchmarks/step_cost.py [--steps N] [--repeats N] [--quick]

All contenders run in one process on one core, interleaved; ratios are of the smallest times. The C
(``c/*.c``) is the same scheme with the same stopping rule and the same warm start, without the
library's checks and without its monitor of the parasitic mode, and ends at the same state: the
difference is printed. Systems and methods are those of step_cases.py; the last table has them all.
The limit is for the three systems of the foundation, with the two methods of one stage.
No ``-ffast-math``: its start-up code changes the floating-point mode of the whole process.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE))
if __name__ == "__main__":  # also from a checkout that is not installed
    sys.path.insert(0, str(ROOT))

from step_cases import CASES, MAIN, SCENES, SCHEMES, Case, ball  # noqa: E402, F401

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.codegen import newton_rule as rule  # noqa: E402
from groupoid_gni.codegen.warm_start import extrapolation_weights  # noqa: E402
from groupoid_gni.discretization.broyden import LEAST_MOVE  # noqa: E402
from groupoid_gni.integrators import compiled_step  # noqa: E402

C_FLAGS = {"C -O2": ["-O2"], "C -O2 native": ["-O2", "-march=native"]}
METHODS = {name: SCHEMES[name].method for name in ("rattle", "projected")}
TITLES = {name: SCHEMES[name].title for name in METHODS}
AIM, MOST = 1.0, 1.5
COLD_LIMITS = {"empty cache": 0.6, "warm cache": 0.4}
AGREEMENT_STEPS = 1000


# Contenders: functions that go from the start over a number of steps.


@dataclass(frozen=True)
class Contender:
    """``run(steps)`` goes from the start and returns seconds, final base and momentum, iterations.

    Only the call of the compiled loop lies inside the measured seconds; nothing is saved but the
    last node.
    """

    name: str
    run: Callable[[int], tuple[float, np.ndarray, int]]


class Problem:
    """One case with one method: the start in numbers, shared by all contenders.

    stretch, stages_of_a_step : of the method.
    """

    stretch = 1
    stages_of_a_step = 1

    def __init__(self, case: Case, scheme: str) -> None:
        self.case, self.scheme, self.method = case, scheme, SCHEMES[scheme].method
        self.stretch = SCHEMES[scheme].stretch
        self.stages_of_a_step = len(SCHEMES[scheme].fractions)
        self.system = case.system()
        self.derived = case.system(derived=True) if case.foundation else None
        self.start = self.system.state(case.base, case.velocity, project_start=True)
        run = gni.integrate(self.system, self.start, step=self.step, n_steps=1, method=self.method)
        self.state = run.rows[0, : run.layout.size].copy()
        self.layout = run.layout

    @property
    def step(self) -> float:
        """The step of the case, longer for compositions."""
        return self.stretch * self.case.step

    @property
    def burst(self) -> int:
        """Steps from the start, over the same time for all methods."""
        return self.case.burst // self.stretch

    def library(self, name: str, system: gni.MechanicalSystem) -> Contender:
        """The library's machine code, called as the library calls it.

        ``system`` keeps the code loaded; it must be one that this problem holds.
        """
        runner = compiled_step(system, self.method, self.start.active_rows)
        scales = np.diag(_gram(system, self.start.base))
        parameters = np.concatenate([system.parameter_vector, [self.step], scales])
        begin = runner.begin(parameters, self.state)
        pointer, integer = ctypes.c_void_p, ctypes.c_int64
        kinds = [pointer] * 5 + [integer] * 3
        advance = runner.code.function("advance", *kinds, returns=integer)
        rows, status = np.empty((1, runner.program.row_size)), np.zeros(2, dtype=np.int64)

        def run(steps: int) -> tuple[float, np.ndarray, int]:
            state, memory = begin.state.copy(), begin.memory.copy()
            stages = self.stages_of_a_step * steps
            given = [a.ctypes.data for a in (parameters, state, memory, rows, status)]
            began = time.perf_counter()
            done = advance(*given, 0, stages, stages)
            seconds = time.perf_counter() - began
            if done != stages:
                raise RuntimeError(f"{name}: stopped after {done} stages, outcome {status[0]}")
            slices = self.layout.slices
            end = np.concatenate([state[slices["base"]], state[slices["after"]]])
            return seconds, end, int(memory[-1])

        return Contender(name, run)

    def integrate(self) -> Contender:
        """The public function's loop with its chunks: ``run.seconds``."""

        def run(steps: int) -> tuple[float, np.ndarray, int]:
            result = gni.integrate(
                self.system, self.start, step=self.step, n_steps=steps,
                method=self.method, save_every=steps,
            )
            end = np.concatenate([result.base[-1], result.momenta_after[-1]])
            return result.seconds, end, int(result.newton_iterations[-1])

        return Contender("integrate", run)

    def c(self, name: str, library: Path) -> Contender:
        """Hand-written C in a shared library."""
        function = getattr(ctypes.CDLL(str(library)), SCHEMES[self.scheme].function)
        function.restype = ctypes.c_int64
        function.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_int64]
        parameters = np.array(self.case.c_parameters)
        slices = self.layout.slices
        begin = np.concatenate([self.state[slices["base"]], self.state[slices["after"]]])

        def run(steps: int) -> tuple[float, np.ndarray, int]:
            state = begin.copy()
            given = parameters.ctypes.data, self.step, state.ctypes.data, steps
            began = time.perf_counter()
            iterations = function(*given)
            seconds = time.perf_counter() - began
            if iterations < 0:
                raise RuntimeError(f"{name}: Newton failed")
            return seconds, state, iterations

        return Contender(name, run)


def _gram(system: gni.MechanicalSystem, base: np.ndarray) -> np.ndarray:
    mu = system.evaluate("constraints", base)
    return mu @ np.linalg.solve(system.evaluate("metric", base), mu.T)


# Compiling the C.


def c_compiler() -> str | None:
    """The path of ``cc``, or None."""
    return shutil.which("cc")


def compile_c(
    source: str, flags: list[str], folder: Path, fractions: tuple[float, ...] = (1.0,)
) -> Path:
    """A shared library of ``c/source``; the numbers of the stopping rule are passed in.

    So are the fractions of a composition and the weights of its warm start.
    """
    names = (
        "AT_ROUND_OFF", "PREDICTED", "BEFORE_FIRST", "LEFT", "STAGNATION", "STAGNATION_LEVEL",
        "MAX_ITERATIONS", "TINY",
    )  # fmt: skip
    weights = extrapolation_weights(fractions)
    before = np.roll(fractions, 1)
    growth = [later / earlier for earlier, later in zip(before, fractions, strict=True)]
    macros = [f"-D{name}={getattr(rule, name)!r}" for name in names]
    macros += [f"-DLEAST_MOVE={LEAST_MOVE!r}"]
    macros += [f"-DSTAGES={len(fractions)}", f"-DHISTORY={len(weights[0])}"]
    macros += [f"-DFRACTIONS={_braced(fractions)}", f"-DGROWTH={_braced(growth)}"]
    macros += [f"-DEXTRAPOLATION={{{', '.join(_braced(row) for row in weights)}}}"]
    label = "_".join(flag.strip("-").replace("=", "-") for flag in flags)
    target = folder / f"{Path(source).stem}_{len(fractions)}_{label}.so"
    command = [str(c_compiler()), *flags, "-shared", "-fPIC", *macros]
    subprocess.run([*command, str(HERE / "c" / source), "-o", str(target), "-lm"], check=True)
    return target


def _braced(numbers: Iterable[float]) -> str:
    return "{" + ", ".join(repr(float(number)) for number in numbers) + "}"


def c_contenders(
    problem: Problem, folder: Path, flag_sets: tuple[str, ...] = tuple(C_FLAGS)
) -> list[Contender]:
    """The C of the problem's case in all flag sets, and its variants; none where unwritten."""
    case, fractions = problem.case, SCHEMES[problem.scheme].fractions
    if problem.scheme not in case.schemes:
        return []
    contenders = []
    for variant, extra in (("", ()), *case.variants):
        for name in flag_sets:
            library = compile_c(case.source, [*C_FLAGS[name], *extra], folder, fractions)
            contenders.append(problem.c(f"{name}, {variant}" if variant else name, library))
    return contenders


# Agreement and timing.


def relative_difference(first: np.ndarray, second: np.ndarray) -> float:
    """Largest difference of two end states, relative to the larger of 1 and their size."""
    return float(np.max(np.abs(first - second)) / max(1.0, np.max(np.abs(second))))


def agreement(problem: Problem, contenders: list[Contender]) -> dict[str, tuple[float, int]]:
    """Difference of every contender's end state from the library's, and its iterations.

    After ``AGREEMENT_STEPS`` steps of the case, which are fewer of a composition.
    """
    steps = AGREEMENT_STEPS // problem.stretch
    _, reference, iterations = problem.library("library", problem.system).run(steps)
    result = {"library": (0.0, iterations)}
    for contender in contenders:
        _, end, iterations = contender.run(steps)
        result[contender.name] = (relative_difference(end, reference), iterations)
    return result


@dataclass(frozen=True)
class Cost:
    """Nanoseconds per step over the repeats."""

    smallest: float
    median: float


def interleaved(
    contenders: list[Contender], steps: int, repeats: int, burst: int
) -> dict[str, Cost]:
    """Time the contenders in turns; each turn is ``steps`` steps in bursts from the start."""
    bursts = max(1, steps // burst)
    seconds: dict[str, list[float]] = {c.name: [] for c in contenders}
    for _ in range(repeats):
        for contender in contenders:
            spent = sum(contender.run(burst)[0] for _ in range(bursts))
            seconds[contender.name].append(spent / (bursts * burst))
    return {
        name: Cost(1e9 * min(values), 1e9 * statistics.median(values))
        for name, values in seconds.items()
    }


@contextmanager
def one_core() -> Iterator[str]:
    """Pin this process to the last core it may use; yields a description."""
    if not hasattr(os, "sched_setaffinity"):
        yield "not pinned: this system cannot"
        return
    allowed = os.sched_getaffinity(0)
    core = max(allowed)
    os.sched_setaffinity(0, {core})
    try:
        yield f"pinned to core {core}"
    finally:
        os.sched_setaffinity(0, allowed)


# Process start to 10^4 ball steps.

_CHILD = """
import json, time
began = time.perf_counter()
import groupoid_gni as gni
imported = time.perf_counter()
scene = gni.scenes.{scene}()
recorded = time.perf_counter()
code = scene.system.compiled()
compiled = time.perf_counter()
run = gni.integrate(scene.system, scene.start, step=0.01, n_steps=10_000)
ended = time.perf_counter()
assert run.success and len(run) == 10_001
print(json.dumps({{
    "import": imported - began, "scene": recorded - imported, "step, code": compiled - recorded,
    "run": ended - compiled, "from cache": code.from_cache,
}}))
"""


def timed_process(code: str, cache: Path | None = None) -> tuple[float, dict[str, Any]]:
    """Seconds of ``python -c code`` from start to end, and the JSON it printed."""
    environment = dict(os.environ, PYTHONPATH=str(ROOT))
    if cache is not None:
        environment["GROUPOID_GNI_CACHE"] = str(cache)
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    return time.perf_counter() - began, json.loads(done.stdout or "{}")


def cold_starts(scene: str, repeats: int) -> dict[str, list[tuple[float, dict[str, Any]]]]:
    """Processes with an empty cache and then with the one they left behind."""
    code = _CHILD.format(scene=scene)
    result: dict[str, list[tuple[float, dict[str, Any]]]] = {name: [] for name in COLD_LIMITS}
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            for name in COLD_LIMITS:
                result[name].append(timed_process(code, Path(folder)))
    return result


# What is printed.


def report_machine() -> None:
    """Processor, compilers, versions: what the numbers below belong to."""
    import casadi
    import llvmlite

    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text().splitlines()
        model = next((t.split(":")[1].strip() for t in lines if "model name" in t), model)
    print(f"{model}; Python {platform.python_version()}, numpy {np.__version__}, "
          f"casadi {casadi.__version__}, llvmlite {llvmlite.__version__}")
    if compiler := c_compiler():
        version = subprocess.run([compiler, "--version"], capture_output=True, text=True)
        print("cc:", version.stdout.splitlines()[0])
    else:
        print("cc: no C compiler found; the comparison with C is left out")


@dataclass(frozen=True)
class Ratio:
    """Smallest times of the library over those of C.

    main : of the C that steps the same unknowns; NaN without C.  variant : of the best of all C.
    limited : whether the library is held to the limit.
    """

    main: float
    variant: float
    limited: bool

    def __str__(self) -> str:
        if math.isnan(self.main):
            return "-"
        more = f" ({self.variant:.2f})" if self.variant > 1.1 * self.main else ""
        return f"{self.main:.2f}{'!' if self.limited and self.main > MOST else ''}{more}"


def ratio_of(problem: Problem, costs: dict[str, Cost]) -> Ratio:
    """Library over the better C, from what the contenders cost."""
    mine = costs["library"].smallest
    main = [cost.smallest for name, cost in costs.items() if name in C_FLAGS]
    every = [cost.smallest for name, cost in costs.items() if name.startswith("C ")]
    limited = problem.case.foundation and problem.scheme in METHODS
    if not main:
        return Ratio(math.nan, math.nan, limited)
    return Ratio(mine / min(main), mine / min(every), limited)


def everybody(problem: Problem, folder: Path, derived: bool = True) -> list[Contender]:
    """C, the library, and the library without closed forms where the case asks for that."""
    contenders = c_contenders(problem, folder) if c_compiler() else []
    contenders.append(problem.library("library", problem.system))
    if derived and problem.derived is not None:
        contenders.append(problem.library("purely derived", problem.derived))
    return contenders


def costs_of(
    problem: Problem, contenders: list[Contender], steps: int, repeats: int
) -> dict[str, Cost]:
    """Costs with ``steps`` stages a turn."""
    return interleaved(
        contenders, max(1, steps // problem.stages_of_a_step), repeats, problem.burst
    )


def report_problem(problem: Problem, folder: Path, steps: int, repeats: int) -> Ratio:
    """Agreement and cost of one system with one method."""
    contenders = everybody(problem, folder)
    reached = agreement(problem, contenders)
    costs = costs_of(problem, contenders, steps, repeats)
    ratio = ratio_of(problem, costs)
    main = [cost.smallest for name, cost in costs.items() if name in C_FLAGS]
    steps_compared = AGREEMENT_STEPS // problem.stretch
    print(f"\n{problem.case.name}, {SCHEMES[problem.scheme].title}, h = {problem.step:g}, "
          f"{problem.burst} steps from the start again and again")
    print(f"  {'':36s}{'min':>8s}{'median':>8s}  {'ratio':>6s}  "
          f"{'iterations':>10s}  differs after {steps_compared} steps by")
    for name, cost in costs.items():
        shown = f"{cost.smallest / min(main):6.2f}" if main else "     -"
        difference, iterations = reached[name]
        print(f"  {name:36s}{cost.smallest:8.1f}{cost.median:8.1f}  {shown}"
              f"  {iterations / steps_compared:10.3f}  {difference:.1e}")
    if main and ratio.limited:
        verdict = "within" if ratio.main <= MOST else "BEYOND"
        print(f"  library / better C = {ratio.main:.2f} (aim {AIM}, at most {MOST}: {verdict}); "
              f"purely derived / better C = "
              f"{costs['purely derived'].smallest / min(main):.2f}")
    return ratio


def report_steps(steps: int, repeats: int) -> None:
    """All systems and methods, ns per step; then the ratios of all."""
    table = {}
    with one_core() as where, tempfile.TemporaryDirectory() as folder:
        print(f"\nNanoseconds per step, {repeats} interleaved turns of {steps} stages, {where}")
        for make in CASES:
            for scheme in make().schemes:
                problem = Problem(make(), scheme)
                table[problem.case.name, scheme] = report_problem(
                    problem, Path(folder), steps, repeats
                )
    print_ratios(table)


def ratio_table(steps: int, repeats: int) -> dict[tuple[str, str], Ratio]:
    """(case, scheme) -> ratio, for all of them, without checking that both end at the same."""
    table = {}
    with one_core(), tempfile.TemporaryDirectory() as folder:
        for make in CASES:
            for scheme in make().schemes:
                problem = Problem(make(), scheme)
                contenders = everybody(problem, Path(folder), derived=False)
                costs = costs_of(problem, contenders, steps, repeats)
                table[problem.case.name, scheme] = ratio_of(problem, costs)
    return table


def ratio_rows(table: dict[tuple[str, str], Ratio]) -> list[list[str]]:
    """The table in words: a row for every case, a column for every scheme."""
    names = dict.fromkeys(name for name, _ in table)
    absent = Ratio(math.nan, math.nan, False)
    return [[name, *(str(table.get((name, scheme), absent)) for scheme in SCHEMES)]
            for name in names]  # fmt: skip


def print_ratios(table: dict[tuple[str, str], Ratio]) -> None:
    """Scene by method."""
    print("\nLibrary over better C. In brackets: over C that leaves out what it knows to be "
          "needless\n(variants above). !: a system of the foundation beyond its limit. -: no C.")
    heading = ["", *(scheme.short for scheme in SCHEMES.values())]
    for row in (heading, *ratio_rows(table)):
        print(f"  {row[0]:34s}" + "".join(f"{cell:>18s}" for cell in row[1:]))


def report_integrate(steps: int, repeats: int) -> None:
    """What the chunks of ``integrate`` add to the compiled loop, on one long run of the ball."""
    with one_core():
        print(f"\nNanoseconds per step of one run over {steps} steps of the ball")
        for scheme in METHODS:
            problem = Problem(ball(), scheme)
            contenders = [problem.library("loop", problem.system), problem.integrate()]
            costs = interleaved(contenders, steps, repeats, burst=steps)
            loop, whole = costs["loop"], costs["integrate"]
            print(f"  {TITLES[scheme]:20s} compiled loop {loop.smallest:.1f}  "
                  f"integrate().seconds {whole.smallest:.1f}  "
                  f"ratio {whole.smallest / loop.smallest:.3f}")


def report_cold_starts(repeats: int) -> None:
    """Process start to 10^4 finished ball steps, default method."""
    print(f"\nSeconds from process start to 10^4 finished steps, {repeats} processes each")
    imports = [timed_process("import numpy, casadi")[0] for _ in range(repeats)]
    label = 'python -c "import numpy, casadi"'
    print(f"  {label:40s} min {min(imports):.3f}  "
          f"median {statistics.median(imports):.3f}")
    for scene in ("rolling_ball", "inhomogeneous_ball"):
        for name, runs in cold_starts(scene, repeats).items():
            seconds = [total for total, _ in runs]
            total, parts = min(runs, key=lambda r: r[0])
            verdict = "within" if statistics.median(seconds) <= COLD_LIMITS[name] else "BEYOND"
            print(f"  {scene + ', ' + name:40s} min {total:.3f}  "
                  f"median {statistics.median(seconds):.3f}  "
                  f"(at most {COLD_LIMITS[name]}: {verdict})")
            print("      fastest: " + ", ".join(
                f"{key} {value:.3f}" if isinstance(value, float) else f"{key}: {value}"
                for key, value in parts.items()))


def main(arguments: list[str] | None = None) -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000, help="stages per turn")
    parser.add_argument("--repeats", type=int, default=40, help="turns, and processes / 4")
    parser.add_argument("--quick", action="store_true", help="few turns, for a look")
    options = parser.parse_args(arguments)
    steps, repeats = (2_000, 10) if options.quick else (options.steps, options.repeats)
    report_machine()
    report_steps(steps, repeats)
    report_integrate(10 * steps, max(3, repeats // 8))
    report_cold_starts(max(2, repeats // 4))


if __name__ == "__main__":
    main()
