"""Phugoid finds the parameters of flight vehicles, and of any system of ODEs, from measured data.

Output-error method (maximum likelihood) by Lobatto collocation, with Rust kernels:

    import phugoid as ph

    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    ...
    fit = ph.estimate(m, ph.read("run1.csv"))
    print(fit.summary())
"""

from . import inputs, models, results
from ._core import Expr, __version__
from .densities import Density, Huber, Laplace, StudentT
from .differentiate import FourierSmoothing, SavitzkyGolay, SmoothingSpline
from .discrepancy.candidates import candidates
from .discrepancy.diagnose import diagnose
from .discrepancy.misfit import misfit
from .equation_error import equation_error
from .errors import (
    DataError,
    EvaluationError,
    MissingDependency,
    ModelError,
    OptionError,
    PhugoidError,
)
from .estimate import estimate
from .experiment import Experiment
from .export import export_c, export_fmu
from .filter_error import FilterError
from .frequency import frequency_response
from .linear import linearise
from .linear_fit import fit_linear
from .loading import load
from .match import match
from .model import Model
from .modes import modes
from .multirate import multirate
from .multistart import multistart
from .noise import Gaussian, Sigma
from .noise_kinds import PerExperiment, PerOutput
from .parameters import Parameter
from .planning.optimum import optimal_plan
from .planning.planned import plan, plans
from .read import read
from .reconstruction.reconstruct import reconstruct
from .result import Fit
from .shooting import MultipleShooting, SingleShooting
from .simulate import simulate
from .solvers import Ipopt, Newton
from .state_space import StateSpace
from .subspace import subspace
from .symbols import (
    Table,
    acos,
    asin,
    atan,
    atan2,
    cos,
    cosh,
    exp,
    from_sympy,
    log,
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
from .tolerance import Tolerance
from .transcription import Collocation
from .trim import trim


def __dir__() -> list[str]:
    """What is offered, without the modules that it lies in: for completion."""
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
    "StateSpace",
    "StudentT",
    "Table",
    "Tolerance",
    "__version__",
    "acos",
    "asin",
    "atan",
    "atan2",
    "candidates",
    "cos",
    "cosh",
    "diagnose",
    "equation_error",
    "estimate",
    "exp",
    "export_c",
    "export_fmu",
    "fit_linear",
    "frequency_response",
    "from_sympy",
    "inputs",
    "linearise",
    "load",
    "log",
    "match",
    "maximum",
    "minimum",
    "misfit",
    "models",
    "modes",
    "multirate",
    "multistart",
    "optimal_plan",
    "plan",
    "plans",
    "read",
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
    "subspace",
    "tan",
    "tanh",
    "trim",
    "where",
]
