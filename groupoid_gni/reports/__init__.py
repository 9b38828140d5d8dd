"""Speed against error: work-precision tables, a cost model, and the report made of them.

Takes scenes and methods, gives frozen tables; figures are drawn when asked for.
"""

from groupoid_gni.reports.cost_model import KINDS, BuildTimes, CostModel, cost
from groupoid_gni.reports.fits import Slope, TimeTo
from groupoid_gni.reports.measurements import Accuracy, MeasuredError, Measurement
from groupoid_gni.reports.peers import Peer, PeerRun
from groupoid_gni.reports.state_parts import Quantity
from groupoid_gni.reports.timing import RunTimes
from groupoid_gni.reports.work_precision import WorkPrecision, work_precision

__all__ = [
    "KINDS",
    "Accuracy",
    "BuildTimes",
    "CostModel",
    "MeasuredError",
    "Measurement",
    "Peer",
    "PeerRun",
    "Quantity",
    "RunTimes",
    "Slope",
    "TimeTo",
    "WorkPrecision",
    "cost",
    "work_precision",
]
