"""Public functions that return a `Fit`: those of the engine, whose results get their methods here."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

from .estimation import estimate as _estimate
from .estimation import estimate_from_afar
from .result import Fit

__all__ = ["estimate", "load", "load_fit", "with_facade"]

_P = ParamSpec("_P")
_R = TypeVar("_R")
_F = TypeVar("_F")


def with_facade(facade: Callable[[_R], _F], name: str, function: Callable[_P, _R], module: str) -> Callable[_P, _F]:
    """Return a function of a module with the signature and the docstring of another, whose results ``facade`` gives
    methods."""

    @wraps(function, assigned=("__name__", "__qualname__", "__doc__"))
    def public(*args: _P.args, **options: _P.kwargs) -> _F:
        return facade(function(*args, **options))

    public.__module__ = module
    public.__signature__ = signature(function).replace(return_annotation=name)  # type: ignore[attr-defined]
    return public


estimate = with_facade(Fit._of, "Fit", wraps(_estimate)(estimate_from_afar), __name__)


def load(path: str | os.PathLike[str]) -> Any:
    """Read a file that `Fit.save` or `Diagnosis.save` wrote with this version or an older one; return the `Fit` or
    `Diagnosis`.

    The kind of the file is recognised by its content, not by its name.

    Raises DataError for a missing, damaged or newer file, MissingDependency for HDF5 without h5py.
    """
    from .saving import files as io

    if io.format_of(path) == io.DIAGNOSIS:
        from .diagnosis import Diagnosis
        from .discrepancy.saved import load_diagnosis

        return Diagnosis._of(load_diagnosis(path), Fit)
    return load_fit(path)


def load_fit(path: str | os.PathLike[str]) -> Fit:
    """Read a fit that `Fit.save` wrote; raises as `load` does, and for the file of a diagnosis."""
    from .saving import load

    return Fit._of(load(path))
