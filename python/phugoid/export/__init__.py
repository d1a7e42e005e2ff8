"""Models as programs elsewhere: C source."""

from __future__ import annotations

from .source import export_c

__all__ = ["export_c"]
