"""The laws of mechanical systems, tried by ``check_system`` on a SystemView."""

from groupoid_gni.verification.impact_laws import IMPACT_LAWS
from groupoid_gni.verification.motion_laws import MOTION_LAWS

SYSTEM_LAWS = (*IMPACT_LAWS, *MOTION_LAWS)
