"""Import of the package cyipopt, as little of it as is needed."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from typing import Any

from ..errors import MissingDependency

__all__ = ["load_cyipopt"]


def load_cyipopt() -> Any:
    """Return cyipopt's extension module alone; the full package also imports scipy.optimize, which takes ten times as
    long.

    Raises MissingDependency where cyipopt is not installed or its Ipopt cannot be loaded.
    """
    try:
        return _extension()
    except ImportError as error:
        raise MissingDependency(
            f'the solver Ipopt needs cyipopt ({error}): pip install "phugoid[ipopt]", or see README'
        ) from error


def _extension() -> Any:
    if "cyipopt" in sys.modules:
        return importlib.import_module("cyipopt.ipopt_wrapper")
    spec = importlib.util.find_spec("cyipopt")
    if spec is None:
        raise ModuleNotFoundError("No module named 'cyipopt'")
    # The bare package: a path, with nothing executed. A later `import cyipopt` is the full one.
    sys.modules["cyipopt"] = importlib.util.module_from_spec(spec)
    try:
        return importlib.import_module("cyipopt.ipopt_wrapper")
    except ModuleNotFoundError:
        return importlib.import_module("ipopt_wrapper")  # before 1.7
    finally:
        del sys.modules["cyipopt"]
