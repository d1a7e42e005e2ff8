"""All systems by name."""

from __future__ import annotations

from .duffing import DUFFING
from .hfb320 import HFB320
from .lateral import LATERAL
from .servo import SERVO
from .system import System
from .uav import UAV

__all__ = ["SYSTEMS"]

SYSTEMS: dict[str, System] = {s.name: s for s in (HFB320, DUFFING, SERVO, LATERAL, UAV)}
