"""What was saved, read back."""

from __future__ import annotations

import os
from typing import Any

from .discrepancy.saved import load_diagnosis
from .saving import fit_file as saving
from .saving import json_file as io

__all__ = ["load"]


def load(path: str | os.PathLike[str]) -> Any:
    """Reads what `Fit.save` or `Diagnosis.save` wrote, of this version or an older one: a `Fit` or a `Diagnosis`.

    What the file is shows from its content, not from its name.

    Raises DataError for a missing, damaged or newer file, MissingDependency for HDF5 without h5py.
    """
    return load_diagnosis(path) if io.format_of(path) == io.DIAGNOSIS else saving.load(path)
