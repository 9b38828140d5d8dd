"""geomstats at the boundary: its import, and its metrics as bundle metrics.

Takes names of modules and metric objects, gives modules and plain matrices; nothing of geomstats
runs in a step. Groups: ``LieGroup.from_geomstats``. See docs/decisions/0010.
"""

from groupoid_gni.geomstats_bridge.loading import geomstats_module
from groupoid_gni.geomstats_bridge.metrics import bundle_metric

__all__ = ["bundle_metric", "geomstats_module"]
