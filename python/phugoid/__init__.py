"""Phugoid estimates the parameters of flight vehicles, and of any system of ODEs, from measured data.

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

try:
    from ._core import Expr as Expr
    from ._core import __version__ as __version__
except ModuleNotFoundError as error:
    if error.name != f"{__name__}._core":
        raise
    raise ModuleNotFoundError(
        "phugoid is not built for this Python: it lacks its compiled module phugoid._core. Run `pip install .` in the "
        "checkout (`make develop` to edit the package), or leave the folder with its sources",
        name=error.name,
    ) from None

if TYPE_CHECKING:  # the same as in _NAMESPACES and _PLACES; a name imported `as` itself is public for type checkers
    from . import design as design
    from . import functions as functions
    from . import linear as linear
    from . import models as models
    from . import results as results
    from .api import estimate as estimate
    from .api import load as load
    from .data.experiment import Experiment as Experiment
    from .data.multirate import multirate as multirate
    from .data.read import read as read
    from .design.detection import manoeuvres as manoeuvres
    from .diagnosing import diagnose as diagnose
    from .diagnosing import improve as improve
    from .discrepancy.candidates.library import candidates as candidates
    from .discrepancy.misfit.misfit import misfit as misfit
    from .errors import DataError as DataError
    from .errors import EvaluationError as EvaluationError
    from .errors import MissingDependency as MissingDependency
    from .errors import ModelError as ModelError
    from .errors import OptionError as OptionError
    from .errors import PhugoidError as PhugoidError
    from .export import export_c as export_c
    from .export.fmu import export_fmu as export_fmu
    from .filter_error import FilterError as FilterError
    from .fleet.missing import missing_effects as missing_effects
    from .fleet.runs import Run as Run
    from .functions import *  # noqa: F403
    from .goodness_of_fit import Tolerance as Tolerance
    from .goodness_of_fit import match as match
    from .many_starts.multistart import multistart as multistart
    from .modelling.constant import Constant as Constant
    from .modelling.declared import State as State
    from .modelling.densities import Density as Density
    from .modelling.densities import Huber as Huber
    from .modelling.densities import Laplace as Laplace
    from .modelling.densities import PerExperiment as PerExperiment
    from .modelling.densities import PerOutput as PerOutput
    from .modelling.densities import StudentT as StudentT
    from .modelling.model import Model as Model
    from .modelling.noise import Gaussian as Gaussian
    from .modelling.noise import Sigma as Sigma
    from .online.estimator import Detect as Detect
    from .online.estimator import Online as Online
    from .parameters import Parameter as Parameter
    from .petab.problem import read_petab as read_petab
    from .reconstruction import reconstruct as reconstruct
    from .regression.equation_error import equation_error as equation_error
    from .regression.least_squares import FourierSmoothing as FourierSmoothing
    from .regression.least_squares import SavitzkyGolay as SavitzkyGolay
    from .regression.least_squares import SmoothingSpline as SmoothingSpline
    from .regression.term_selection import TermSelection as TermSelection
    from .regression.term_selection import monomials as monomials
    from .result import Fit as Fit
    from .simulation import simulate as simulate
    from .solvers.ipopt import Ipopt as Ipopt
    from .solvers.newton import Newton as Newton
    from .steady_state import from_steady_state as from_steady_state
    from .transcription import Collocation as Collocation
    from .transcription import MultipleShooting as MultipleShooting
    from .transcription import SingleShooting as SingleShooting

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
    "fleet.missing": "missing_effects",
    "fleet.runs": "Run",
    "functions": "Table acos asin atan atan2 cos cosh exp expm1 from_sympy hypot log log1p maximum minimum sign sin "
    "sinh smooth_abs smooth_max smooth_min smooth_sign smooth_step sqrt tan tanh where",
    "goodness_of_fit": "Tolerance match",
    "many_starts.multistart": "multistart",
    "modelling.constant": "Constant",
    "modelling.declared": "State",
    "modelling.densities": "Density Huber Laplace PerExperiment PerOutput StudentT",
    "modelling.model": "Model",
    "modelling.noise": "Gaussian Sigma",
    "online.estimator": "Detect Online",
    "parameters": "Parameter",
    "petab.problem": "read_petab",
    "reconstruction": "reconstruct",
    "regression.equation_error": "equation_error",
    "regression.least_squares": "FourierSmoothing SavitzkyGolay SmoothingSpline",
    "regression.term_selection": "TermSelection monomials",
    "result": "Fit",
    "simulation": "simulate",
    "solvers.ipopt": "Ipopt",
    "solvers.newton": "Newton",
    "steady_state": "from_steady_state",
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
    __all__ = sorted(["Expr", "__version__", *_NAMESPACES, *_MODULES])

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
