"""The four checks: one line, and a user knows which law an object breaks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis.errors import Unsatisfiable

from groupoid_gni.errors import InputError
from groupoid_gni.groupoids import SE3, SO3, LieGroup, LieGroupoid, QuadraticGroup, Retraction
from groupoid_gni.integrators import Method, compiled_step
from groupoid_gni.integrators.methods import SteppingMethod
from groupoid_gni.integrators.requests import checked_method, checked_step
from groupoid_gni.systems import MechanicalSystem
from groupoid_gni.verification.algebroid_laws import ALGEBROID_LAWS
from groupoid_gni.verification.algebroid_view import Algebroid
from groupoid_gni.verification.appendix_laws import APPENDIX_LAWS
from groupoid_gni.verification.convention_laws import CONVENTION_LAWS
from groupoid_gni.verification.group_view import GroupView
from groupoid_gni.verification.groupoid_laws import GROUPOID_LAWS
from groupoid_gni.verification.judging import OnFail, check_laws, require_on_fail, speak
from groupoid_gni.verification.laws import Law
from groupoid_gni.verification.method_equation_laws import METHOD_EQUATION_LAWS
from groupoid_gni.verification.method_flow_laws import METHOD_FLOW_LAWS
from groupoid_gni.verification.method_run_laws import METHOD_RUN_LAWS
from groupoid_gni.verification.method_view import MethodView, Section
from groupoid_gni.verification.report import Finding, LawReport, Verdict, merged
from groupoid_gni.verification.retraction_laws import RETRACTION_LAWS
from groupoid_gni.verification.search import Trial
from groupoid_gni.verification.system_laws import SYSTEM_LAWS
from groupoid_gni.verification.system_view import SystemView


def check_groupoid(
    space: LieGroupoid,
    *,
    on_fail: OnFail = "raise",
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> LawReport:
    """Check definition 8.1, the algebroid of section 8.1, and the conventions of this library.

    on_fail : "raise" BrokenLawError, "warn" BrokenLawWarning, or only "return" the report.
    expected_failures : {law: reason} for laws known to fail.
    examples : samples per law; those of the active Hypothesis profile when left out (100 unless
        changed).
    seed : of the search; None searches afresh every time.
    Raises InputError for arguments that make no sense, BrokenLawError see ``on_fail``.
    """
    if not isinstance(space, LieGroupoid):
        raise InputError(f"check_groupoid takes a LieGroupoid, not {type(space).__name__}")
    return check_laws(
        repr(space),
        {"groupoid": space, "algebroid": Algebroid(space), "convention": space},
        (*GROUPOID_LAWS, *ALGEBROID_LAWS, *CONVENTION_LAWS),
        on_fail=on_fail, expected_failures=expected_failures, examples=examples, seed=seed,
    )


def check_system(
    system: MechanicalSystem,
    *,
    on_fail: OnFail = "raise",
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> LawReport:
    """Check metric, projectors, reflection, the one Lagrangian, its equations and its starts.

    Two laws only warn: constraints that are integrable, wholly or in part, may be meant.
    The arguments, and what is raised, as for ``check_groupoid``.
    """
    if not isinstance(system, MechanicalSystem):
        raise InputError(f"check_system takes a MechanicalSystem, not {type(system).__name__}")
    try:
        return check_laws(
            f"the system on {system.space!r}", {"system": SystemView(system)}, SYSTEM_LAWS,
            on_fail=on_fail, expected_failures=expected_failures, examples=examples, seed=seed,
        )
    except Unsatisfiable as error:
        raise InputError(
            "no point was found where all terms of the system are finite and its constraints "
            "are clearly independent; set example_base_point of the space to such a point, and "
            "leave out redundant rows"
        ) from error


def check_method(
    method: Method,
    system: MechanicalSystem,
    *,
    step: float = 0.05,
    symmetries: Iterable[Section] = (),
    on_fail: OnFail = "raise",
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> LawReport:
    """Check the discrete equations of a method on a system, and what its runs keep.

    method : any method that steps: a discrete Lagrangian, one of your own too; ``GNI(...)`` of
        every order and flow, with projection or without; ``McLachlanPerlmutter(...)``,
        ``DiscreteLagrangeDAlembert(...)``. Laws that say nothing about it tell why.
    system : with an external force too, but without control inputs.
    step : the step size, > 0; small enough for the system's velocities of about one.
    symmetries : sections ``x -> (rank,)`` of AG, with values in D, under which L is invariant.
    The other arguments, and what is raised, as for ``check_groupoid``; each law takes a part of
    the examples only.
    """
    if not isinstance(system, MechanicalSystem):
        raise InputError(
            f"check_method takes a method and a MechanicalSystem, not {type(system).__name__}"
        )
    stepping = None if method is None else checked_method(method)
    if not isinstance(stepping, SteppingMethod):
        raise InputError(
            f"check_method takes GNI() or a discrete Lagrangian such as Rattle(), not {method!r}: "
            "its laws are those of discrete mechanics, equation (49) and what follows from it"
        )
    if system.control_size:
        raise InputError(
            f"check_method takes systems without control inputs, this one has "
            f"{system.control_size}; write numbers for them into the force"
        )
    # a method that does not fit the system says so here, once, and not in every law
    compiled_step(system, stepping, (), compile=False)
    h = checked_step(step)
    if h < 0.0:
        raise InputError(f"step must be positive, got {step!r}; the laws step back by themselves")
    view = MethodView(method, system, h, _checked_sections(symmetries, system.space))
    try:
        return check_laws(
            f"{method} on {system.space!r}, step {h:g}", {"method": view},
            (*METHOD_EQUATION_LAWS, *METHOD_RUN_LAWS, *METHOD_FLOW_LAWS),
            on_fail=on_fail, expected_failures=expected_failures, examples=examples, seed=seed,
        )
    except Unsatisfiable as error:
        raise InputError(
            "no start was found where the system can be run; check_system(system) says more"
        ) from error


def _checked_sections(
    symmetries: Iterable[Section], space: LieGroupoid
) -> tuple[Section, ...]:
    """Sections with a value of the right shape at the example point."""
    wanted = f"functions x -> ({space.rank},), such as lambda x: np.array([...])"
    if callable(symmetries) or not isinstance(symmetries, Iterable):
        raise InputError(f"symmetries must be a list of {wanted}, got {symmetries!r}")
    sections = tuple(symmetries)
    x = np.array(space.example_base_point, dtype=np.float64)
    for number, section in enumerate(sections):
        if not callable(section):
            raise InputError(f"symmetries must be {wanted}; number {number} is {section!r}")
        try:
            value = np.asarray(section(x), dtype=np.float64)
        except Exception as error:
            raise InputError(
                f"symmetry number {number} failed at the example base point {x}: "
                f"{type(error).__name__}: {error}"
            ) from error
        if value.shape != (space.rank,) or not np.all(np.isfinite(value)):
            raise InputError(
                f"symmetries must be {wanted}; number {number} gave {value} at {x}"
            )
    return sections


def check_retraction(
    subject: LieGroupoid | Retraction,
    *,
    on_fail: OnFail = "raise",
    expected_failures: Mapping[str, str] | None = None,
    examples: int | None = None,
    seed: int | None = 0,
) -> LawReport:
    """Check a retraction, its trivialised tangents, and for a Lie group the paper's appendix.

    subject : a groupoid, or a retraction such as ``Cayley()``, which must then work on SO(3),
        SE(3) and SO(4) on both sides; the report shows the worst of them.
    The other arguments, and what is raised, as for ``check_groupoid``.
    """
    options: dict[str, Any] = {"examples": examples, "seed": seed}
    if isinstance(subject, Retraction):
        return _check_on_groups(subject, on_fail, dict(expected_failures or {}), options)
    if not isinstance(subject, LieGroupoid):
        raise InputError(
            f"check_retraction takes a LieGroupoid or a Retraction, not {type(subject).__name__}"
        )
    views: dict[str, Any] = {"retraction": subject}
    laws: tuple[Law, ...] = RETRACTION_LAWS
    if isinstance(subject, LieGroup):
        views["appendix"] = GroupView(subject)
        laws += APPENDIX_LAWS
    return check_laws(
        repr(subject), views, laws, on_fail=on_fail, expected_failures=expected_failures, **options
    )


def _check_on_groups(
    retraction: Retraction, on_fail: OnFail, expected: dict[str, str], options: Mapping[str, Any]
) -> LawReport:
    """The laws of the appendix know no sides, so right groups are only seen as groupoids."""
    require_on_fail(on_fail)
    known = {law.name for law in RETRACTION_LAWS}
    reports = {}
    for make in (SO3, SE3, _rotations_of_four_space):
        group = make(retraction=retraction)
        reports[repr(group)] = check_retraction(
            group, on_fail="return", expected_failures=expected, **options
        )
        group = make(side="right", retraction=retraction)
        reports[repr(group)] = check_laws(
            repr(group), {"retraction": group}, RETRACTION_LAWS, on_fail="return",
            expected_failures={name: expected[name] for name in expected if name in known},
            **options,
        )
    findings = tuple(_worst(found) for found in merged(reports).values())
    report = LawReport(repr(retraction), findings)
    speak(report, on_fail)
    return report


def _rotations_of_four_space(**options: Any) -> LieGroup:
    return QuadraticGroup(np.eye(4), **options)


_FROM_BAD_TO_GOOD = (
    Verdict.FAILED, Verdict.WARNED, Verdict.EXPECTED, Verdict.PASSED, Verdict.NOT_APPLICABLE,
)


def _worst(findings: Mapping[str, Finding]) -> Finding:
    """One law on several subjects: the worst verdict, its counterexample with the subject."""
    name, found = min(findings.items(), key=lambda item: _FROM_BAD_TO_GOOD.index(item[1].verdict))
    trial = found.counterexample
    if trial is not None:
        trial = Trial({"subject": name, **trial.sample}, trial.gap, trial.error)
    residuals = [other.worst for other in findings.values() if other.worst is not None]
    return replace(
        found, counterexample=trial, worst=max(residuals, default=None),
        evaluations=sum(other.evaluations for other in findings.values()),
    )
