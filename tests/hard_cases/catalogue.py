"""All hard cases, family by family."""

from __future__ import annotations

import cases_affine
import cases_ball
import cases_inertia
import cases_long
import cases_oscillators
import cases_planar
import cases_rank
import cases_rolling
import cases_rotations
import cases_starts
import cases_steps
import cases_stiff
import cases_transmission
from hard_case import HardCase

FAMILIES: dict[str, list[HardCase]] = {
    "Transmissions": cases_transmission.CASES,
    "Oscillators": cases_oscillators.CASES,
    "Inertia": cases_inertia.CASES,
    "Rotations": cases_rotations.CASES,
    "Ranks": cases_rank.CASES,
    "Stiffness": cases_stiff.CASES,
    "Balls": cases_ball.CASES,
    "Rolling bodies": cases_rolling.CASES,
    "Sleighs, skates, Suslov": cases_planar.CASES,
    "Starts": cases_starts.CASES,
    "Drift and integrability": cases_affine.CASES,
    "Steps, tables, tolerances": cases_steps.CASES,
    "Long runs": cases_long.CASES,
}
