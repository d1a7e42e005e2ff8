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
from typing import Any

from . import design, functions, linear, models, results
from ._core import Expr, __version__
from .api import diagnose, estimate, improve, load
from .data.experiment import Experiment
from .data.multirate import multirate
from .data.read import read
from .design.detection import manoeuvres
from .discrepancy.candidates.library import candidates
from .discrepancy.misfit.misfit import misfit
from .errors import DataError, EvaluationError, MissingDependency, ModelError, OptionError, PhugoidError
from .export import export_c, export_fmu
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
from .match import Tolerance, match
from .modelling.declared import State
from .modelling.densities import Density, Huber, Laplace, PerExperiment, PerOutput, StudentT
from .modelling.model import Model
from .modelling.noise import Gaussian, Sigma
from .multistart.multistart import multistart
from .parameters import Parameter
from .petab.problem import read_petab
from .reconstruction import reconstruct
from .regression.differentiate import FourierSmoothing, SavitzkyGolay, SmoothingSpline
from .regression.equation_error import equation_error
from .regression.selected_terms import TermSelection
from .regression.terms import monomials
from .result import Fit
from .simulate import simulate
from .solvers import Ipopt, Newton
from .transcription.collocation import Collocation
from .transcription.filter_error import FilterError
from .transcription.shooting import MultipleShooting, SingleShooting

# Names that were public here, and where they are now. They go with the next release.
_MOVED = {
    "inputs": "design",
    **{name: f"design.{name}" for name in ("optimal_plan", "plan", "plans")},
    **{name: f"linear.{name}" for name in linear.__all__},
}


def __getattr__(name: str) -> Any:
    """Return a name that has moved, with a DeprecationWarning that gives its new place."""
    if name not in _MOVED:
        raise AttributeError(f"module 'phugoid' has no attribute '{name}'", name=name, obj=sys.modules[__name__])
    where, _, attribute = _MOVED[name].partition(".")
    warnings.warn(f"phugoid.{name} is now phugoid.{_MOVED[name]}", DeprecationWarning, stacklevel=2)
    module = {"design": design, "linear": linear}[where]
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
