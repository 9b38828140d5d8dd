"""What is known to fall short, why, and what to do about it; printed at the end of the report."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Deficiency:
    """One of them, in three sentences or so each."""

    what: str
    cause: str
    remedy: str


KNOWN = (
    Deficiency(
        "Over short times the projected methods are slower than an adaptive Runge-Kutta method of "
        "order 8 on nearly every scene and at nearly every accuracy.",
        "A stage solves for velocities and for the closing momentum by an iteration of several "
        "rounds; DOP853 evaluates explicit equations twelve times a step and chooses its step.",
        "Use gni.ReferenceFlow() for short runs. The methods with structure are for runs in which "
        "energy, constraint or reversibility have to last.",
    ),
    Deficiency(
        "On the smaller scenes heyoka's Taylor series reaches most errors sooner than anything "
        "here, by up to about four times.",
        "Its order follows the tolerance, and it is given equations without multipliers, derived "
        "by hand, numbers compiled in; ReferenceFlow integrates all coordinates of the system as "
        "it was stated, with parameters free.",
        "Leave out of the model what nothing depends on; nothing else is planned.",
    ),
    Deficiency(
        "Where a body is so symmetric that a step has a closed form, hand-written C that uses it "
        "is 3 to 20 times faster (the rolling ball, the particle; table of hand-written C).",
        "The equations are recorded for any inertia and any potential, and elimination does not "
        "see that a cubic or nothing at all is left of them. Elsewhere the ratio is 1.2 to 1.8.",
        "Nothing is planned; a step of these scenes takes a fifth of a microsecond.",
    ),
    Deficiency(
        "Step sizes are fixed.",
        "Changing the step in the middle of a run destroys time symmetry, and with it the "
        "behaviour of the energy.",
        "Choose the step from a short work-precision table (gni.work_precision) before a long run.",
    ),
    Deficiency(
        "A coarse step of a body that turns fast stops with left_domain.",
        "Within a flight the arrow must stay where the retraction is invertible: less than half a "
        "turn for the Cayley map and the exponential alike.",
        "Halve the step, or take a higher order, whose flights are shorter.",
    ),
    Deficiency(
        "With very small steps the error of orders 6 and 8 grows again: on the rolling ball to "
        "1e-11 at h = 0.001 with variational flights, 5e-13 with the other two.",
        "A bias of about one rounding per stage in the implicit flight. Tighter stopping rules do "
        "not change it, and the fractions of the tables add up to one.",
        "Stop refining where the table shows the plateau, or take another flow.",
    ),
    Deficiency(
        "Variational and splitting flights let the energy of motions that are not reversible drift "
        "in proportion to time.",
        "No modified energy is known to exist where the motion is not reversible (docs/theory.md).",
        "Use flow=gni.EnergyPreserving(), exact to round-off with linear constraints.",
    ),
    Deficiency(
        "The two-step methods of the paper carry a mode of alternating sign that grows wherever "
        "the motion contracts volume.",
        "It belongs to the scheme, whatever the step (decision 8).",
        "Use gni.GNI(), which has no such mode; two-step runs warn.",
    ),
    Deficiency(
        "Every method of a system is compiled by itself, some tenths of a second each.",
        "Derivatives, elimination order and code are particular to system and method.",
        "The object code is cached on disk, and parameters can be changed without compiling.",
    ),
    Deficiency(
        "A system of some hundred bodies takes a second or two to its first step (table of the "
        "chain).",
        "Differentiating and sorting forty thousand operations in Python; compiling is a tenth of "
        "it, where bodies are alike.",
        "Nothing is asked of the user. Bodies that are not alike are compiled one by one, and take "
        "longer.",
    ),
    Deficiency(
        "Near the singularity of a chart runs may be wrong by a tenth and not be warned of "
        "(inhomogeneous_ball_in_a_chart, about one start in ten).",
        "They are coarse there and nothing more: half the step divides the error by four. Steps "
        "that miss their extrapolation by far are told of (decision 18).",
        "Use a groupoid without a chart (inhomogeneous_ball has no such place), or compare with "
        "half the step.",
    ),
    Deficiency(
        "At order 8 the observed slope of the default tables settles late, on some systems only at "
        "round-off (docs/how_to_choose.md).",
        "The tables have small leading coefficients, so that later terms are seen first.",
        "For a clean slope give the 17 stages of Kahan and Li as the table, and larger errors "
        "with them.",
    ),
    Deficiency(
        "The attitude of scenes whose base does not turn cannot be judged below 1e-11.",
        "It is accumulated along the motion, and its reference is only compared with a run of ten "
        "times the tolerance.",
        "Errors below that are printed as bounds.",
    ),
)


def numbered() -> str:
    """The list as Markdown."""
    return "\n".join(
        f"{k}. **{d.what}** Cause: {d.cause} Remedy: {d.remedy}"
        for k, d in enumerate(KNOWN, start=1)
    )
