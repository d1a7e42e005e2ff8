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
from .api import diagnose, estimate, improve, load
from .data.experiment import Experiment
from .data.multirate import multirate
from .data.read import read
from .discrepancy.candidates.library import candidates
from .discrepancy.misfit.misfit import misfit
from .errors import (
    DataError,
    EvaluationError,
    MissingDependency,
    ModelError,
    OptionError,
    PhugoidError,
)
from .export import export_c, export_fmu
from .linear.frequency import frequency_response
from .linear.linear_fit import fit_linear
from .linear.linearise import linearise, modes
from .linear.state_space import StateSpace
from .linear.subspace import subspace
from .linear.trim import trim
from .match import match
from .modelling.declared import State
from .modelling.model import Model
from .multistart.multistart import multistart
from .noise.densities import Density, Huber, Laplace, StudentT
from .noise.kinds import PerExperiment, PerOutput
from .noise.noise import Gaussian, Sigma
from .parameters import Parameter
from .petab.problem import read_petab
from .planning.design_evaluation import plan, plans
from .planning.optimum import optimal_plan
from .reconstruction.reconstruct import reconstruct
from .regression.differentiate import FourierSmoothing, SavitzkyGolay, SmoothingSpline
from .regression.equation_error import equation_error
from .result import Fit
from .simulate import simulate
from .solvers import Ipopt, Newton
from .symbols import (
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
from .tolerance import Tolerance
from .transcription.collocation import Collocation
from .transcription.filter_error import FilterError
from .transcription.shooting import MultipleShooting, SingleShooting


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
    "State",
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
    "expm1",
    "export_c",
    "export_fmu",
    "fit_linear",
    "frequency_response",
    "from_sympy",
    "hypot",
    "improve",
    "inputs",
    "linearise",
    "load",
    "log",
    "log1p",
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
    "subspace",
    "tan",
    "tanh",
    "trim",
    "where",
]
