"""``work_precision``: how wrong methods are on a scene, and how long they take to be so."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from groupoid_gni.array_types import ArrayLike
from groupoid_gni.errors import InputError
from groupoid_gni.integrators import Method, ReferenceFlow
from groupoid_gni.integrators.requests import (
    checked_count,
    checked_method,
    checked_step,
    checked_whole,
)
from groupoid_gni.reports.cost_model import as_scene
from groupoid_gni.reports.fits import Slope, TimeTo, fitted_slope, seconds_text, time_to
from groupoid_gni.reports.markdown import markdown_table
from groupoid_gni.reports.measurements import Measurement
from groupoid_gni.reports.peers import Peer
from groupoid_gni.reports.state_parts import Quantity
from groupoid_gni.reports.subjects import PeerSubject, Problem, SteppingSubject, Subject
from groupoid_gni.reports.timing import interleaved
from groupoid_gni.scenes import Scene
from groupoid_gni.systems import MechanicalSystem, State, real_array


@dataclass(frozen=True, eq=False)
class WorkPrecision:
    """Errors and times of methods on one scene; ``print`` shows the table.

    scene : what was integrated.  t_end : up to when.  reference : what errors are measured against.
    estimate : the largest error of the reference, of base coordinates and velocities.
    size : largest base coordinate or velocity component of the motion.
    rows : one for each method and setting; of each method from loose to strict.
    peer_settings : name of a peer -> how it was set up.
    """

    scene: str
    t_end: float
    reference: str
    estimate: float
    size: float
    rows: tuple[Measurement, ...]
    peer_settings: Mapping[str, str]

    @property
    def lines(self) -> dict[str, tuple[Measurement, ...]]:
        """The rows by method."""
        names = dict.fromkeys(row.line for row in self.rows)
        return {name: tuple(r for r in self.rows if r.line == name) for name in names}

    def slopes(self, of: Quantity = Quantity.STATE) -> dict[str, Slope]:
        """Observed orders of the methods with steps, with 95 % confidence intervals.

        Least squares of log error at the end on log step, above the round-off plateau and above
        ten times the error of the reference. Methods with fewer than three such points are left
        out: their order was not measured.
        """
        found = {}
        for name, rows in self.lines.items():
            told = [row for row in rows if row.step is not None]
            errors = [row.accuracy[of].final if of in row.accuracy else None for row in told]
            slope = fitted_slope(
                [row.step for row in told if row.step is not None],
                [math.inf if error is None else error.value for error in errors],
                [error is not None and error.resolved for error in errors],
                math.pi if of is Quantity.ATTITUDE else self.size,
            )
            if slope is not None:
                found[name] = slope
        return found

    def time_to(
        self, errors: ArrayLike = (1e-3, 1e-6, 1e-9, 1e-11), of: Quantity = Quantity.STATE
    ) -> dict[str, tuple[TimeTo | None, ...]]:
        """The time each method needs to an error at the end; None where it was not reached.

        Smallest times of the repeats, interpolated between settings and never extrapolated: a
        method whose loosest setting reaches the error gets that time with ``at_most``. An error
        counts as reached when the next stricter setting reaches it too. Errors that the reference
        cannot tell are bounded by their estimate.

        Raises InputError for errors that are not positive.
        """
        wanted = real_array("errors", errors).ravel()
        if not all(0.0 < target < math.inf for target in wanted):
            raise InputError(f"errors must be positive and finite, got {wanted}")
        found = {}
        for name, rows in self.lines.items():
            bounds = [row.bound(of) for row in rows]
            seconds = [row.times.smallest if row.times else math.inf for row in rows]
            found[name] = tuple(time_to(float(target), bounds, seconds) for target in wanted)
        return found

    def table(self) -> str:
        """Every row, as Markdown."""
        quantities = [
            quantity
            for quantity in (Quantity.POSITION, Quantity.ATTITUDE, Quantity.VELOCITY)
            if any(quantity in row.accuracy for row in self.rows)
        ]
        heading = ["method", "setting"]
        for quantity in quantities:
            heading += [quantity.value, f"largest {quantity.value}"]
        heading += [
            "energy", "moving energy", "constraint", "steps", "stages", "Newton", "evaluations",
            "median", "min", "spread", "compile", "note",
        ]  # fmt: skip
        body = [[row.line, row.setting, *_cells(row, quantities)] for row in self.rows]
        kept = [
            i for i in range(len(heading)) if i < 2 or any(line[i] not in "-" for line in body)
        ]
        said = (
            f"{self.scene}; t = 0 ... {self.t_end:g}; errors against {self.reference}, itself "
            f"good to {self.estimate:.1e}"
        )
        return said + "\n\n" + markdown_table(
            [heading[i] for i in kept], [[line[i] for i in kept] for line in body]
        )

    __str__ = table

    def time_table(
        self, errors: Sequence[float] = (1e-3, 1e-6, 1e-9, 1e-11), of: Quantity = Quantity.STATE
    ) -> str:
        """``time_to`` as Markdown, with the observed orders."""
        slopes = self.slopes(of)
        rows = [
            [name, str(slopes.get(name, "-")), *("-" if t is None else str(t) for t in times)]
            for name, times in self.time_to(errors, of).items()
        ]
        return markdown_table(["method", "order", *(f"{e:.0e}" for e in errors)], rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, ready for JSON."""
        return {
            "scene": self.scene, "t_end": self.t_end, "reference": self.reference,
            "estimate": self.estimate, "size": self.size,
            "rows": [row.to_dict() for row in self.rows],
            "slopes": {
                name: {"order": s.order, "low": s.low, "high": s.high, "points": s.points}
                for name, s in self.slopes().items()
            },
            "peer_settings": dict(self.peer_settings),
        }  # fmt: skip

    def plot(self, axes: Any = None, of: Quantity = Quantity.STATE) -> Any:
        """Error against time and error against step, log-log, orders in the legend.

        axes : two axes objects; a new figure is made when left out. Returns the figure. Errors
        that the reference cannot tell are drawn hollow, at their bound.
        """
        from groupoid_gni.plotting import WorkCurve, plot_work_precision

        slopes = self.slopes(of)
        curves = []
        for name, rows in self.lines.items():
            told = [row for row in rows if row.times and math.isfinite(row.bound(of))]
            if not told:
                continue
            final = [row.accuracy[of].final for row in told]
            curves.append(
                WorkCurve(
                    name,
                    seconds=[row.times.smallest for row in told if row.times],
                    errors=[e.value if e.resolved else e.bound for e in final],
                    resolved=[e.resolved for e in final],
                    steps=[row.step for row in told if row.step is not None],
                    order=str(slopes[name]) if name in slopes else "",
                    is_peer=told[0].is_peer,
                )
            )
        return plot_work_precision(curves, self.scene, f"error at t = {self.t_end:g}", axes)


def _cells(row: Measurement, quantities: Iterable[Quantity]) -> list[str]:
    cells = []
    for quantity in quantities:
        found = row.accuracy.get(quantity)
        cells.append("-" if found is None else str(found.final))
        cells.append("-" if found is None or found.largest is None else str(found.largest))
    for value in (row.energy, row.moving_energy, row.constraint):
        cells.append("-" if value is None else f"{value:.1e}")
    for count in (row.steps, row.stages, row.newton, row.evaluations):
        cells.append("-" if count is None else str(count))
    if row.times is None:
        cells += ["-"] * 3
    else:
        cells += [seconds_text(row.times.median), seconds_text(row.times.smallest),
                  f"{row.times.spread:.0%}"]  # fmt: skip
    compiled = row.compile_seconds
    cells.append("-" if compiled is None else seconds_text(compiled))
    return [*cells, row.note or "-"]


def work_precision(
    scene: Scene | tuple[MechanicalSystem, State],
    methods: Sequence[Method] | Mapping[str, Method | Sequence[ReferenceFlow]],
    steps: ArrayLike,
    *,
    t_end: float,
    repeats: int = 5,
    reference: ReferenceFlow | None = None,
    attitude: bool = True,
    peers: Sequence[Peer] = (),
) -> WorkPrecision:
    """Run methods with step sizes and measure how wrong they are and how long they take.

    Parameters
    ----------
    scene : a ``gni.scenes.Scene`` or (system, start).
    methods : methods, or name -> method. Those with steps are run with every step size. Every
        ``ReferenceFlow(rtol=...)`` of a list is one tolerance of one curve of that name; in a dict
        a list of them makes the curve.
    steps : step sizes; ``t_end`` must be a whole number of each. May be empty when all methods are
        ReferenceFlow.
    t_end : the end, positive.
    repeats : warm runs of each, interleaved: every method and setting once in each turn (four
        times if below 1 ms). Settings of more than 20 ms take part in three turns only, those of
        more than 0.5 s in one.
    reference : what errors are measured against; when left out the scene's exact motion, else
        ``ReferenceFlow(rtol=1e-13)``. Its own error is estimated (``run.error_estimate()``; for a
        formula, what a change of the times by four units in the last place does), and a difference
        below ten times that estimate is reported as a bound and not as a number.
    attitude : also judge the reconstructed pose where the base itself does not turn; costs
        compiling every method once more.
    peers : other people's integrators.

    Returns
    -------
    WorkPrecision. Times are those of the loop (``run.seconds``), warm; compiling is apart. Errors
    are taken at the end and at up to 200 nodes. A run that fails gives a row that says how.

    Raises
    ------
    InputError : for a request that cannot be run, and where the reference does not arrive.
    """
    made = as_scene(scene)
    end = checked_step(t_end)
    if end < 0.0:
        raise InputError(f"t_end must be positive, got {end:g}")
    turns = checked_whole("repeats", repeats, 1)
    if not (reference is None or isinstance(reference, ReferenceFlow)):
        raise InputError(f"reference must be gni.ReferenceFlow(...), not {reference!r}")
    named = _named(methods)
    counts = _counts(steps, end)
    fixed = [name for name, method in named if not isinstance(method, ReferenceFlow)]
    if fixed and not counts:
        raise InputError(f"no step sizes were given for {', '.join(fixed)}")
    problem = Problem.of(made, end, reference, attitude)
    subjects = _subjects(problem, named, counts, peers)
    rows = _measure(subjects, turns)
    true = problem.truth.at(1)
    return WorkPrecision(
        scene=made.description,
        t_end=end,
        reference=problem.truth.source,
        estimate=float(true.estimates[Quantity.STATE][-1]),
        size=true.parts.size(),
        rows=tuple(rows),
        peer_settings={peer.name: peer.settings for peer in peers},
    )


def _named(methods: Any) -> list[tuple[str, Method]]:
    """(name, method); reference flows of the same absolute tolerance share a name."""
    if isinstance(methods, (Method, str)):
        raise InputError(f"methods must be a list of methods or a dict of them, not {methods!r}")
    if isinstance(methods, Mapping):
        return [(str(name), method) for name, given in methods.items() for method in _each(given)]
    named: dict[Method, str] = {}
    for given in methods:
        method = checked_method(given)
        name = str(method)
        if isinstance(method, ReferenceFlow):
            name = "ReferenceFlow" + ("" if method.atol is None else f"(atol={method.atol:g})")
        named[method] = name
    return [(name, method) for method, name in named.items()]


def _each(given: Any) -> list[Method]:
    if not isinstance(given, (list, tuple)):
        return [checked_method(given)]
    if not given or not all(isinstance(method, ReferenceFlow) for method in given):
        raise InputError(f"only ReferenceFlow(...) of several tolerances share a name: {given!r}")
    return list(given)


def _counts(steps: ArrayLike, end: float) -> list[int]:
    """Numbers of steps, from the largest step to the smallest."""
    sizes = real_array("steps", steps).ravel()
    counts = set()
    for size in sizes:
        if not size > 0.0:
            raise InputError(f"steps must be positive, got {size}")
        counts.add(checked_count(checked_step(float(size)), end, None))
    if 0 in counts:
        raise InputError(f"every step must be at most t_end = {end:g}, got {max(sizes):g}")
    return sorted(counts)


def _subjects(
    problem: Problem,
    named: list[tuple[str, Method]],
    counts: list[int],
    peers: Sequence[Peer],
) -> list[Subject]:
    subjects: list[Subject] = []
    flows = [(name, m) for name, m in named if isinstance(m, ReferenceFlow)]
    for name, method in named:
        if not isinstance(method, ReferenceFlow):
            subjects += [SteppingSubject(problem, name, method, count) for count in counts]
    for name, flow in sorted(flows, key=lambda pair: -pair[1].rtol):
        subjects.append(SteppingSubject(problem, name, flow, 1))
    for peer in peers:
        subjects += [PeerSubject(problem, peer.name, peer, tol) for tol in peer.tolerances]
    return subjects


def _measure(subjects: Sequence[Subject], repeats: int) -> list[Measurement]:
    """Errors first, which also warms everything; then times of what arrived."""
    rows = [subject.look() for subject in subjects]
    arrived = [k for k, row in enumerate(rows) if row.accuracy]
    for k, times in zip(
        arrived, interleaved([subjects[k].seconds for k in arrived], repeats), strict=True
    ):
        subject = subjects[k]
        rows[k] = replace(rows[k], times=times)
        if isinstance(subject, PeerSubject):
            rows[k] = replace(rows[k], compile_seconds=subject.compile_seconds(times))
    return rows
