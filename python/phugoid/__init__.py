"""Phugoid finds the parameters of flight vehicles, and of any system of ODEs, from measured data.

Output-error method (maximum likelihood) by Lobatto collocation, with Rust kernels:

    import phugoid as ph

    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    ...
    fit = ph.estimate(m, ph.read("run1.csv"))
    print(fit.summary())
"""

import sys
import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._core import Expr, __version__

if TYPE_CHECKING:  # the same as in _NAMESPACES and _PLACES
    from . import design, functions, linear, models, results
    from .api import estimate, load
    from .data.experiment import Experiment
    from .data.multirate import multirate
    from .data.read import read
    from .design.detection import manoeuvres
    from .diagnosing import diagnose, improve
    from .discrepancy.candidates.library import candidates
    from .discrepancy.misfit.misfit import misfit
    from .errors import DataError, EvaluationError, MissingDependency, ModelError, OptionError, PhugoidError
    from .export import export_c
    from .export.fmu import export_fmu
    from .filter_error import FilterError
    from .functions import (
        Table,
        acos,
        asin,
        atan,
        atan2,
        cos,
        cosh,
        exp,
        expm1,
        from_sympy,
        hypot,
        log,
        log1p,
        maximum,
        minimum,
        sign,
        sin,
        sinh,
        smooth_abs,
        smooth_max,
        smooth_min,
        smooth_sign,
        smooth_step,
        sqrt,
        tan,
        tanh,
        where,
    )
    from .goodness_of_fit import Tolerance, match
    from .many_starts.multistart import multistart
    from .modelling.declared import State
    from .modelling.densities import Density, Huber, Laplace, PerExperiment, PerOutput, StudentT
    from .modelling.model import Model
    from .modelling.noise import Gaussian, Sigma
    from .parameters import Parameter
    from .petab.problem import read_petab
    from .reconstruction import reconstruct
    from .regression.equation_error import equation_error
    from .regression.least_squares import FourierSmoothing, SavitzkyGolay, SmoothingSpline
    from .regression.selected_terms import TermSelection
    from .regression.term_selection import monomials
    from .result import Fit
    from .simulation import simulate
    from .solvers.ipopt import Ipopt
    from .solvers.newton import Newton
    from .transcription import Collocation, MultipleShooting, SingleShooting

_NAMESPACES = ("design", "functions", "linear", "models", "results")
# Module -> public names in it. They are imported when they are first asked for: all of the package takes half a second.
_PLACES = {
    "api": "estimate load",
    "data.experiment": "Experiment",
    "data.multirate": "multirate",
    "data.read": "read",
    "design.detection": "manoeuvres",
    "diagnosing": "diagnose improve",
    "discrepancy.candidates.library": "candidates",
    "discrepancy.misfit.misfit": "misfit",
    "errors": "DataError EvaluationError MissingDependency ModelError OptionError PhugoidError",
    "export": "export_c",
    "export.fmu": "export_fmu",
    "filter_error": "FilterError",
    "functions": "Table acos asin atan atan2 cos cosh exp expm1 from_sympy hypot log log1p maximum minimum sign sin "
    "sinh smooth_abs smooth_max smooth_min smooth_sign smooth_step sqrt tan tanh where",
    "goodness_of_fit": "Tolerance match",
    "many_starts.multistart": "multistart",
    "modelling.declared": "State",
    "modelling.densities": "Density Huber Laplace PerExperiment PerOutput StudentT",
    "modelling.model": "Model",
    "modelling.noise": "Gaussian Sigma",
    "parameters": "Parameter",
    "petab.problem": "read_petab",
    "reconstruction": "reconstruct",
    "regression.equation_error": "equation_error",
    "regression.least_squares": "FourierSmoothing SavitzkyGolay SmoothingSpline",
    "regression.selected_terms": "TermSelection",
    "regression.term_selection": "monomials",
    "result": "Fit",
    "simulation": "simulate",
    "solvers.ipopt": "Ipopt",
    "solvers.newton": "Newton",
    "transcription": "Collocation MultipleShooting SingleShooting",
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names.split()}

# Names that were public here, and where they are now. They go with the next release.
_MOVED = {
    "inputs": "design",
    **{name: f"design.{name}" for name in ("optimal_plan", "plan", "plans")},
    **{
        name: f"linear.{name}"
        for name in ("StateSpace", "fit_linear", "frequency_response", "linearise", "modes", "subspace", "trim")
    },
}

if not TYPE_CHECKING:  # for type checkers, a name that is not imported above is an error

    def __getattr__(name: str) -> Any:
        """Return a public name, imported now, or one that has moved, with a DeprecationWarning that gives its place."""
        if name in _MODULES:
            found = getattr(import_module(f".{_MODULES[name]}", __name__), name)
            globals()[name] = found  # from now on it is found without this function
            return found
        if name in _NAMESPACES:
            return import_module(f".{name}", __name__)
        if name not in _MOVED:
            raise AttributeError(f"module 'phugoid' has no attribute '{name}'", name=name, obj=sys.modules[__name__])
        where, _, attribute = _MOVED[name].partition(".")
        warnings.warn(f"phugoid.{name} is now phugoid.{_MOVED[name]}", DeprecationWarning, stacklevel=2)
        module = import_module(f".{where}", __name__)
        return getattr(module, attribute) if attribute else module


def __dir__() -> list[str]:
    """Return the public names, without the modules that hold them, for completion."""
    return list(__all__)


__all__ = [
    "Collocation",
    "DataError",
    "Density",
    "EvaluationError",
    "Experiment",
    "Expr",
    "FilterError",
    "Fit",
    "FourierSmoothing",
    "Gaussian",
    "Huber",
    "Ipopt",
    "Laplace",
    "MissingDependency",
    "Model",
    "ModelError",
    "MultipleShooting",
    "Newton",
    "OptionError",
    "Parameter",
    "PerExperiment",
    "PerOutput",
    "PhugoidError",
    "SavitzkyGolay",
    "Sigma",
    "SingleShooting",
    "SmoothingSpline",
    "State",
    "StudentT",
    "Table",
    "TermSelection",
    "Tolerance",
    "__version__",
    "acos",
    "asin",
    "atan",
    "atan2",
    "candidates",
    "cos",
    "cosh",
    "design",
    "diagnose",
    "equation_error",
    "estimate",
    "exp",
    "expm1",
    "export_c",
    "export_fmu",
    "from_sympy",
    "functions",
    "hypot",
    "improve",
    "linear",
    "load",
    "log",
    "log1p",
    "manoeuvres",
    "match",
    "maximum",
    "minimum",
    "misfit",
    "models",
    "monomials",
    "multirate",
    "multistart",
    "read",
    "read_petab",
    "reconstruct",
    "results",
    "sign",
    "simulate",
    "sin",
    "sinh",
    "smooth_abs",
    "smooth_max",
    "smooth_min",
    "smooth_sign",
    "smooth_step",
    "sqrt",
    "tan",
    "tanh",
    "where",
]
