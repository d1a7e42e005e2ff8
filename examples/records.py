"""Where the examples look for flight records. None ships with the project: README says where to get them."""

from __future__ import annotations

import os
from pathlib import Path


def find(name: str) -> Path | None:
    """Path of a record in the folder named by PHUGOID_DATA, else in shared/data beside the checkout; None if absent."""
    folders = [Path(__file__).resolve().parents[2] / "shared" / "data"]
    if "PHUGOID_DATA" in os.environ:
        folders.insert(0, Path(os.environ["PHUGOID_DATA"]))
    return next((folder / name for folder in folders if (folder / name).is_file()), None)
