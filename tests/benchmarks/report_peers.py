"""The peers of ``python -m groupoid_gni.report``: who is installed, set up as well as they can be.

``comparisons()`` is what the report asks for. SciPy gets the right-hand side of somebody who
derives nothing by hand, in NumPy, mass matrix and multipliers solved in every call; IDA gets the
same as an implicit system. CyRK, heyoka, CVODE and diffrax get equations without multipliers,
derived by hand (``native_scenes``), compiled by whatever compiles for them.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

import native_scenes  # noqa: E402
from native_scenes import Derived, Native  # noqa: E402

import groupoid_gni as gni  # noqa: E402
from groupoid_gni.reports import Peer, PeerRun  # noqa: E402
from groupoid_gni.reports.markdown import markdown_table  # noqa: E402
from groupoid_gni.reports.sections import Comparisons  # noqa: E402

PACKAGES = ("heyoka", "CyRK", "numba", "scikit-sundae", "diffrax", "jax", "mujoco",
            "exudyn")  # fmt: skip
MODULES = {"heyoka": "heyoka", "CyRK": "CyRK", "scikit-sundae": "sksundae", "diffrax": "diffrax",
           "mujoco": "mujoco", "exudyn": "exudyn"}  # fmt: skip
MOST_STEPS = 1_000_000


@cache
def module(package: str) -> Any:
    """The module of a package, or None when it is not installed or does not import."""
    try:
        return importlib.import_module(MODULES[package])
    except Exception:  # a binary package may fail in its own way
        return None


def tolerances(last: int, quick: bool, first: int = 3) -> tuple[float, ...]:
    """10^-first ... 10^-last."""
    return tuple(10.0**-k for k in range(first, last + 1, 3 if quick else 1))


# SciPy and IDA: the system as it is stated.


def scipy_peer(native: Native, method: str, t_end: float, last: int, quick: bool) -> Peer:
    """``solve_ivp`` on the NumPy right-hand side."""
    from scipy.integrate import solve_ivp

    stated = native.stated

    def run(tolerance: float) -> PeerRun:
        began = time.perf_counter()
        solution = solve_ivp(
            stated.field, (0.0, t_end), stated.start, method=method, rtol=tolerance,
            atol=1e-2 * tolerance,
        )  # fmt: skip
        seconds = time.perf_counter() - began
        if not solution.success:
            raise RuntimeError(f"SciPy {method}: {solution.message}")
        counts = len(solution.t) - 1, int(solution.nfev)
        return PeerRun(seconds, *stated.node(solution.y[:, -1]), *counts)

    words = "NumPy right-hand side with mass matrix and multipliers, atol = rtol / 100"
    return Peer(f"SciPy {method}", tolerances(last, quick), run, words)


def ida_peer(native: Native, t_end: float, quick: bool) -> Peer | None:
    """SUNDIALS IDA on q' = ..., M v' = f + mu^T Lambda', mu v' = bias.

    Impulses Lambda in the place of multipliers make it an implicit system without algebraic
    variables (Gear's substitution). With multipliers (index 1) at the same tolerances 1e-4, 1e-6
    and 1e-8 the eight scenes took 0.7 to 26 times as long (half of them more than 1.8 times) with
    the multipliers in the error test, 0.6 to 1.6 times with them out of it (an atol of 1e8
    for them; the wrapper has no switch), mostly less exact where that was the faster.
    """
    if module("scikit-sundae") is None:
        return None
    from sksundae.ida import IDA

    stated = native.stated
    parts = stated.parts
    rate, _, mu, force, _ = parts(stated.start)
    n, r, m = len(rate), len(force), len(mu)

    def residual(t: float, z: np.ndarray, dz: np.ndarray, out: np.ndarray) -> None:
        rate, metric, mu, force, bias = parts(z[: n + r])
        out[:n] = dz[:n] - rate
        out[n : n + r] = metric @ dz[n : n + r] - force - mu.T @ dz[n + r :]
        out[n + r :] = mu @ dz[n : n + r] - bias

    y = stated.start
    rates = stated.field(0.0, y)
    metric = parts(y)[1]
    pushed = metric @ rates[n:] - force
    multipliers = np.linalg.lstsq(mu.T, pushed, rcond=None)[0]
    start = np.concatenate([y, np.zeros(m)])
    slope = np.concatenate([rates, multipliers])

    def run(tolerance: float) -> PeerRun:
        solver = IDA(
            residual, rtol=tolerance, atol=1e-2 * tolerance, max_num_steps=MOST_STEPS
        )
        began = time.perf_counter()
        solution = solver.solve(np.array([0.0, t_end]), start.copy(), slope.copy())
        seconds = time.perf_counter() - began
        if not solution.success:
            raise RuntimeError(f"IDA: {solution.message}")
        end = np.asarray(solution.y)[-1]
        return PeerRun(seconds, *stated.node(end[: n + r]), None, int(np.sum(solution.nfev)))

    words = "implicit form with impulses as unknowns, residual in NumPy, atol = rtol / 100"
    return Peer("SUNDIALS IDA", tolerances(6 if quick else 8, quick), run, words)


# The others: equations without multipliers.


class Traced:
    """A number that writes down, as Python source, what is done with it."""

    def __init__(self, name: str, lines: list[str]) -> None:
        self.name, self.lines = name, lines

    def _made(self, text: str) -> Traced:
        name = f"t{len(self.lines)}"
        self.lines.append(f"{name} = {text}")
        return Traced(name, self.lines)

    def _binary(self, sign: str, other: Any, swapped: bool = False) -> Traced:
        text = other.name if isinstance(other, Traced) else repr(float(other))
        pair = (text, self.name) if swapped else (self.name, text)
        return self._made(f"{pair[0]} {sign} {pair[1]}")

    def __add__(self, other: Any) -> Traced:
        return self._binary("+", other)

    def __radd__(self, other: Any) -> Traced:
        return self._binary("+", other, True)

    def __sub__(self, other: Any) -> Traced:
        return self._binary("-", other)

    def __rsub__(self, other: Any) -> Traced:
        return self._binary("-", other, True)

    def __mul__(self, other: Any) -> Traced:
        return self._binary("*", other)

    def __rmul__(self, other: Any) -> Traced:
        return self._binary("*", other, True)

    def __truediv__(self, other: Any) -> Traced:
        return self._binary("/", other)

    def __rtruediv__(self, other: Any) -> Traced:
        return self._binary("/", other, True)

    def __neg__(self) -> Traced:
        return self._made(f"-{self.name}")

    def __pow__(self, power: float) -> Traced:
        if power != 2.0:
            raise NotImplementedError(f"power {power}")
        return self._binary("*", self)


class Tracing:
    """``sin`` and ``cos`` of traced numbers."""

    @staticmethod
    def sin(x: Traced) -> Traced:
        """The line ``math.sin``."""
        return x._made(f"math.sin({x.name})")

    @staticmethod
    def cos(x: Traced) -> Traced:
        """The line ``math.cos``."""
        return x._made(f"math.cos({x.name})")


def straight_line_source(derived: Derived, head: str, result: str) -> str:
    """A Python function of straight-line code.

    result : the line that stores rate {i}, with {value}.
    """
    lines: list[str] = []
    variables = [Traced(f"y{i}", lines) for i in range(len(derived.start))]
    rates = derived.rates(Tracing, variables)
    body = [f"y{i} = y[{i}]" for i in range(len(variables))] + lines
    for i, rate in enumerate(rates):
        value = rate.name if isinstance(rate, Traced) else repr(float(rate))
        body.append(result.format(i=i, value=value))
    return "import math\n" + head + "\n" + "\n".join("    " + line for line in body) + "\n"


def _function(source: str, name: str) -> Callable[..., None]:
    space: dict[str, Any] = {}
    exec(source, space)
    return space[name]


def cyrk_peer(native: Native, t_end: float, quick: bool) -> Peer | None:
    """CyRK's C++ solver, the right-hand side a C function made by numba."""
    if module("CyRK") is None:
        return None
    from CyRK import nb_diffeq_addr, nbsolve2_ivp

    derived = native.derived
    head = "def rates(dy, t, y, args):"
    function = _function(straight_line_source(derived, head, "dy[{i}] = {value}"), "rates")
    address: list[int] = []
    start = derived.start.copy()

    def run(tolerance: float) -> PeerRun:
        if not address:
            address.append(nb_diffeq_addr(function))
        began = time.perf_counter()
        solution = nbsolve2_ivp(
            address[0], (0.0, t_end), start, method="DOP853", rtol=tolerance,
            atol=1e-2 * tolerance,
        )  # fmt: skip
        seconds = time.perf_counter() - began
        end, good, steps = np.array(solution.y)[:, -1], solution.success, solution.steps_taken
        message = "" if good else str(solution.message)
        solution.free()
        if not good:
            raise RuntimeError(f"CyRK: {message}")
        return PeerRun(seconds, *derived.node(end), int(steps))

    words = "DOP853 in C++, hand-derived right-hand side compiled by numba, atol = rtol / 100"
    return Peer("CyRK DOP853", tolerances(12, quick), run, words)


def heyoka_peer(native: Native, t_end: float, quick: bool) -> Peer | None:
    """heyoka's Taylor series, one integrator for each tolerance."""
    hy = module("heyoka")
    if hy is None:
        return None
    derived = native.derived
    variables = hy.make_vars(*(f"y{i}" for i in range(len(derived.start))))
    rates = [rate + hy.expression(0.0) for rate in derived.rates(hy, variables)]
    integrators: dict[float, Any] = {}

    def run(tolerance: float) -> PeerRun:
        if tolerance not in integrators:
            integrators[tolerance] = hy.taylor_adaptive(
                list(zip(variables, rates, strict=True)), list(derived.start), tol=tolerance,
                high_accuracy=False,
            )  # fmt: skip
        integrator = integrators[tolerance]
        integrator.time = 0.0
        integrator.state[:] = derived.start
        began = time.perf_counter()
        outcome, _, _, steps, *_ = integrator.propagate_until(t_end, max_steps=MOST_STEPS)
        seconds = time.perf_counter() - began
        if outcome != hy.taylor_outcome.time_limit:
            raise RuntimeError(f"heyoka: {outcome}")
        return PeerRun(seconds, *derived.node(np.array(integrator.state)), int(steps))

    words = "adaptive Taylor series, hand-derived equations, numbers compiled in"
    return Peer("heyoka Taylor", tolerances(15, quick), run, words)


def cvode_peer(native: Native, t_end: float, quick: bool) -> Peer | None:
    """SUNDIALS CVODE, Adams, the right-hand side compiled where numba is there."""
    if module("scikit-sundae") is None:
        return None
    from sksundae.cvode import CVODE

    derived = native.derived
    source = straight_line_source(derived, "def rates(t, y, dy):", "dy[{i}] = {value}")
    function = _function(source, "rates")
    try:
        from numba import njit

        function = njit(function)
    except ImportError:
        pass
    compiled = function
    start = derived.start.copy()

    def run(tolerance: float) -> PeerRun:
        solver = CVODE(
            lambda t, y, dy: compiled(t, y, dy), method="Adams", rtol=tolerance,
            atol=1e-2 * tolerance, max_num_steps=MOST_STEPS,
        )  # fmt: skip
        began = time.perf_counter()
        solution = solver.solve(np.array([0.0, t_end]), start.copy())
        seconds = time.perf_counter() - began
        if not solution.success:
            raise RuntimeError(f"CVODE: {solution.message}")
        evaluations = int(np.sum(solution.nfev))
        return PeerRun(seconds, *derived.node(np.asarray(solution.y)[-1]), None, evaluations)

    words = "Adams, hand-derived right-hand side compiled by numba, atol = rtol / 100"
    return Peer("SUNDIALS CVODE", tolerances(12, quick), run, words)


def diffrax_peer(native: Native, t_end: float, quick: bool) -> Peer | None:
    """diffrax's Dopri8 in float64, compiled once for all tolerances."""
    if module("diffrax") is None:
        return None
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    derived = native.derived
    term = diffrax.ODETerm(
        lambda t, y, args: jnp.stack(
            [jnp.asarray(rate) for rate in derived.rates(jnp, [y[i] for i in range(len(y))])]
        )
    )
    start = jnp.asarray(derived.start)

    @jax.jit
    def solve(tolerance: Any) -> Any:
        solution = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, t_end, None, start, throw=False, max_steps=100_000,
            saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=1e-2 * tolerance),
        )  # fmt: skip
        return solution.ys[-1], solution.stats["num_accepted_steps"], solution.result._value

    def run(tolerance: float) -> PeerRun:
        began = time.perf_counter()
        end, steps, result = solve(tolerance)
        end.block_until_ready()
        seconds = time.perf_counter() - began
        if int(result) != 0:
            raise RuntimeError("diffrax: the step limit was reached or the step underflowed")
        return PeerRun(seconds, *derived.node(np.array(end)), int(steps))

    words = "Dopri8, float64, jit, hand-derived right-hand side, atol = rtol / 100"
    return Peer("diffrax Dopri8", tolerances(12, quick), run, words)


def peers_of(name: str, scene: gni.scenes.Scene, t_end: float, quick: bool) -> Sequence[Peer]:
    """Everybody who is installed, for one scene of the report."""
    native = native_scenes.MAKERS[name](scene)
    found: list[Peer | None] = [
        scipy_peer(native, "DOP853", t_end, 12, quick),
        scipy_peer(native, "RK45", t_end, 6 if quick else 9, quick),
        scipy_peer(native, "Radau", t_end, 6 if quick else 8, quick),
        scipy_peer(native, "LSODA", t_end, 9 if quick else 12, quick),
        ida_peer(native, t_end, quick),
        cyrk_peer(native, t_end, quick),
        heyoka_peer(native, t_end, quick),
        cvode_peer(native, t_end, quick),
        diffrax_peer(native, t_end, quick),
    ]
    return [peer for peer in found if peer is not None]


def notes() -> tuple[str, ...]:
    """Who is absent, and what to do."""
    absent = [package for package in MODULES if module(package) is None]
    if not absent:
        return ()
    return (f"not installed: {', '.join(absent)} (pip install 'groupoid-gni[peers]')",)


# Further parts of the report.


def hand_written_c(quick: bool) -> str:
    """Time per step against C, scene by method, as in step_cost.py."""
    import step_cost

    if not step_cost.c_compiler():
        return "Skipped: no C compiler (cc)."
    steps, repeats = (2_000, 6) if quick else (20_000, 20)
    heading = ["", *(scheme.short for scheme in step_cost.SCHEMES.values())]
    rows = step_cost.ratio_rows(step_cost.ratio_table(steps, repeats))
    return (
        "Time per step, library over hand-written C of the same scheme with the same stopping rule "
        "and warm start (tests/benchmarks/step_cost.py), smallest times. In brackets: over C that "
        "leaves out what its author knows to be needless, such as an iteration whose equation has "
        "a closed form in that one system. A dash: no C was written.\n\n"
        + markdown_table(heading, rows)
    )


def ensemble_table(quick: bool) -> str:
    """Lanes and threads, methods, short runs and long ones."""
    import ensembles

    return ensembles.section(quick)


def sections(quick: bool) -> Sequence[tuple[str, str]]:
    """Hand-written C, reduction, lanes, and what rolls in general simulators."""
    import reductions
    import simulators

    return [
        ("Against hand-written C", hand_written_c(quick)),
        ("Only what a scene needs", reductions.section(quick)),
        ("Lanes and threads, method by method", ensemble_table(quick)),
        ("Rolling in general simulators", simulators.section(quick)),
    ]


def comparisons() -> Comparisons:
    """What the report asks for."""
    return Comparisons(peers_of, notes(), PACKAGES, sections)
