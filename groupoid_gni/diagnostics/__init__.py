"""What a run tells: momenta and their equation, moving and modified energies, drift verdicts.

Takes Trajectories (or plain records), gives arrays and frozen results; prints nothing.
"""

from groupoid_gni.diagnostics.energy_drift import Drift, DriftReport, energy_drift
from groupoid_gni.diagnostics.modified_energy import Hypothesis, ModifiedEnergy, modified_energy
from groupoid_gni.diagnostics.moving_energy import (
    MovingEnergy,
    SymmetryReport,
    moving_energy,
    symmetry_report,
)
from groupoid_gni.diagnostics.nonholonomic_momentum import (
    NonholonomicMomentum,
    nonholonomic_momentum,
)
from groupoid_gni.diagnostics.parasitic import parasitic_component
from groupoid_gni.diagnostics.records import RunRecords, records
from groupoid_gni.diagnostics.roundoff_growth import RoundoffGrowth, roundoff_growth
from groupoid_gni.diagnostics.symmetry_search import (
    LinearSection,
    SymmetrySearch,
    find_moving_energy,
)

__all__ = [
    "Drift",
    "DriftReport",
    "Hypothesis",
    "LinearSection",
    "ModifiedEnergy",
    "MovingEnergy",
    "NonholonomicMomentum",
    "RoundoffGrowth",
    "RunRecords",
    "SymmetryReport",
    "SymmetrySearch",
    "energy_drift",
    "find_moving_energy",
    "modified_energy",
    "moving_energy",
    "nonholonomic_momentum",
    "parasitic_component",
    "records",
    "roundoff_growth",
    "symmetry_report",
]
