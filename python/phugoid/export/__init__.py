"""Models as programs elsewhere: C source, and functional mock-up units."""

from __future__ import annotations

from .fmu import export_fmu
from .writer import export_c

__all__ = ["export_c", "export_fmu"]
