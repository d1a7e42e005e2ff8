"""Lets the pages of the gallery import the examples of the project, and nothing else after them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "examples"


def examples_on_path(_: dict[str, Any], __: str, when: str) -> None:
    """Put the folder on the path before a page is run; after it, take it off, and forget the modules in it, since other
    pages have an ``hfb320`` of their own."""
    if when == "before":
        sys.path.insert(0, str(FOLDER))
        return
    sys.path.remove(str(FOLDER))
    for name, module in [*sys.modules.items()]:
        if str(getattr(module, "__file__", "")).startswith(str(FOLDER)):
            del sys.modules[name]
