"""All systems by name."""

from __future__ import annotations

from .duffing import DUFFING
from .hfb320 import HFB320
from .system import System

__all__ = ["SYSTEMS"]

SYSTEMS: dict[str, System] = {s.name: s for s in (HFB320, DUFFING)}
