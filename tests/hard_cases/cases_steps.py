"""Compositions in a wrong order, and steps and tolerances that make no sense."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
from hard_case import HardCase, Verdict, distance, energy_error, quietly, refusal, verdict

import groupoid_gni as gni
from groupoid_gni.discretization import default_table

SOURCE = "FIELD 4 #22"


@cache
def problems() -> dict[str, gni.scenes.Scene]:
    """Nonlinear problems to measure orders on."""
    return {
        "Veselova": gni.scenes.veselova(),
        "transmission": gni.scenes.variable_transmission(),
        "inhomogeneous ball": gni.scenes.inhomogeneous_ball(),
    }


def observed(scene: gni.scenes.Scene, method: Any, h: float) -> float:
    """Order from three step sizes, each half of the one before."""
    reference = {"step": h, "t_end": 16 * h, "method": gni.ReferenceFlow(1e-13)}
    truth = gni.integrate(scene.system, scene.start, **reference)
    errors = []
    for k in (1, 2, 4):
        run = quietly(scene.system, scene.start, step=h / k, t_end=16 * h, method=method,
                      save_every=k)  # fmt: skip
        errors.append(distance(run, truth.base, truth.velocities))
    return -float(np.polyfit(np.log([1, 2, 4]), np.log(errors), 1)[0])


def misordered(name: str, order: int, projected: bool, h: float) -> Verdict:
    """The same stages in another order: bare stages by a step, projected ones sorted by size."""
    table = default_table(order, projected)
    scene = problems()[name]
    stages = tuple(sorted(table.stages)) if projected else (*table.stages[1:], table.stages[0])
    wrong = gni.CompositionTable("misordered", order, stages, "this test", projected)
    projection = gni.SymmetricProjection() if projected else None
    right, found = (
        observed(scene, gni.GNI(order, projection=projection, table=t), h) for t in (table, wrong)
    )
    return verdict(f"order {right:.2f} as it should be, {found:.2f} in the wrong order",
                   abs(right - order) < 0.4, found < order - 0.8)  # fmt: skip


def told_by_check_method(name: str, order: int) -> Verdict:
    """Whether the verification suite sees that a table has not the order that it claims."""
    table, scene = default_table(order, False), problems()[name]
    stages = (*table.stages[1:], table.stages[0])
    wrong = gni.CompositionTable("misordered", order, stages, "this test", False)
    broken = []
    for given in (table, wrong):
        method = gni.GNI(order, projection=None, table=given)
        report = gni.verification.check_method(
            method, scene.system, on_fail="return", examples=10
        )
        broken.append([finding.law.name for finding in report.failures])
    return verdict(f"laws broken: {broken[0]} as it should be, {broken[1]} in the wrong order",
                   not broken[0], any("order" in law for law in broken[1]))  # fmt: skip


def tiny_steps(scene: gni.scenes.Scene, h: float) -> Verdict:
    """Steps far below the round-off of the state: nothing moves, nothing breaks."""
    told, fine = [], []
    for method in (gni.GNI(), gni.GNI(6), gni.Rattle(), gni.ReferenceFlow(1e-10)):
        run = quietly(scene.system, scene.start, step=h, n_steps=50, method=method,
                      on_failure="return")  # fmt: skip
        gap = distance(run, scene.start.base, scene.start.velocity)
        told.append(f"{method}: {run.outcome.name}, moved by {gap:.0e}")
        fine.append(run.success and gap < 1e-13 and energy_error(run) < 1e-13)
    return verdict("; ".join(told), *fine)


def huge_steps(scene: gni.scenes.Scene, h: float) -> Verdict:
    """Steps of many characteristic times: a failure, or bounded energy; never NaN in a success."""
    told, fine = [], []
    for method in (gni.GNI(), gni.GNI(2, gni.EnergyPreserving()), gni.Rattle()):
        run = quietly(scene.system, scene.start, step=h, n_steps=50, method=method,
                      on_failure="return")  # fmt: skip
        finite = bool(np.all(np.isfinite(run.rows[:, : run.layout.size])))
        told.append(f"{method}: {run.outcome.name} after {run.node_steps[-1]} steps")
        fine.append(finite)
        fine.append(not run.success or bool(np.all(np.isfinite(run.energy()))))
        if run.success and "EnergyPreserving" in str(method):
            told[-1] += f", energy {energy_error(run):.0e}"
            fine.append(energy_error(run) < 1e-10)
        if not run.success:
            fine.append("smaller step" in run.message or "use a step below" in run.message)
    return verdict("; ".join(told), *fine)


def absurd_requests() -> Verdict:
    """Requests that must be refused before anything is run."""
    scene = gni.scenes.veselova()

    def ask(**options: Any) -> str:
        return refusal(lambda: gni.integrate(scene.system, scene.start, **options))

    attempts = {
        "step = 0": ask(step=0.0, n_steps=10),
        "step = NaN": ask(step=np.nan, n_steps=10),
        "step = inf": ask(step=np.inf, n_steps=10),
        "1.5 steps": ask(step=0.1, t_end=0.15),
        "backward to a later time": ask(step=-0.1, t_end=1.0),
        "-1 steps": ask(step=0.1, n_steps=-1),
        "1e15 nodes": ask(step=0.1, n_steps=10**15),
        "rtol = 0": refusal(lambda: gni.ReferenceFlow(rtol=0.0)),
        "rtol = 1e-20": refusal(lambda: gni.ReferenceFlow(rtol=1e-20)),
        "rtol = 2": refusal(lambda: gni.ReferenceFlow(rtol=2.0)),
        "order 3": refusal(lambda: gni.GNI(3)),
    }
    passed = [name for name, message in attempts.items() if not message]
    told = f"{len(attempts) - len(passed)} of {len(attempts)} refused"
    return verdict(told + (f"; accepted: {', '.join(passed)}" if passed else ""), not passed)


def loose_reference(scene: gni.scenes.Scene, rtol: float) -> Verdict:
    """A loose tolerance: the error estimate says how wrong the run is."""
    run = gni.integrate(scene.system, scene.start, step=0.5, t_end=10.0,
                        method=gni.ReferenceFlow(rtol))  # fmt: skip
    truth = gni.integrate(scene.system, scene.start, step=0.5, t_end=10.0,
                          method=gni.ReferenceFlow(1e-13))  # fmt: skip
    error = distance(run, truth.base, truth.velocities)
    estimate = float(run.error_estimate()[-1])
    return verdict(f"error {error:.1e}, estimate {estimate:.1e}",
                   0.3 * error < estimate < 10.0 * error + 1e-12)  # fmt: skip


CASES = [
    *(
        HardCase(
            f"check_method on misordered stages, order 4, {name}", "the order falls without a word",
            SOURCE, "no law broken by the right table, the order law by the wrong one",
            partial(told_by_check_method, name, 4), slow=True,
        )
        for name in ("Veselova", "transmission")
    ),
    *(
        HardCase(
            f"stages in the wrong order, order {order}, {'projected' if projected else 'bare'}, "
            f"{name}",
            "the order falls without a word", SOURCE,
            "the right table has its order, the misordered one loses one or more",
            partial(misordered, name, order, projected, h),
        )
        for name, order, projected, h in (
            ("Veselova", 4, False, 0.1), ("transmission", 4, False, 0.1),
            ("inhomogeneous ball", 4, True, 0.1), ("Veselova", 6, True, 0.2),
        )
    ),
    *(
        HardCase(f"steps of {h:g}, {name}", "differences below round-off", "issue",
                 "success, nothing moves by more than 1e-13",
                 lambda name=name, h=h: tiny_steps(problems()[name], h))
        for name, h in (("Veselova", 1e-20), ("transmission", 1e-200),
                        ("inhomogeneous ball", -1e-16))
    ),
    *(
        HardCase(f"steps of {h:g}, {name}", "many roots, or none", "issue",
                 "a failure that advises a smaller step, or finite numbers and (EnergyPreserving) "
                 "the energy to 1e-10", lambda name=name, h=h: huge_steps(problems()[name], h))
        for name, h in (("Veselova", 3.0), ("transmission", 3.0), ("inhomogeneous ball", 50.0),
                        ("Veselova", 1e8), ("transmission", -1e8))
    ),
    HardCase("absurd requests", "a hang, or NaN called success", "issue",
             "all refused before anything is run", absurd_requests),
    *(
        HardCase(f"reference flow at rtol = {rtol:g}, {name}", "a wrong oracle", "issue",
                 "the error estimate is right within a factor of 0.3 to 10",
                 lambda name=name, rtol=rtol: loose_reference(problems()[name], rtol))
        for name, rtol in (("Veselova", 1e-3), ("transmission", 1e-3), ("inhomogeneous ball", 1e-6))
    ),
]
