"""Phugoid finds the parameters of flight vehicles, and of any system of ODEs, from measured data.

Output-error method (maximum likelihood) by Lobatto collocation, with Rust kernels:

    import phugoid as ph

    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    ...
    fit = ph.estimate(m, ph.read("run1.csv"))
    print(fit.summary())
"""

from . import inputs, models
from ._core import Expr, __version__
from .densities import Density, Huber, Laplace, StudentT
from .differentiate import FourierSmoothing, SavitzkyGolay, SmoothingSpline
from .discrepancy.candidate import Candidate, Place
from .discrepancy.candidates import candidates
from .discrepancy.collection import Candidates
from .discrepancy.diagnose import diagnose
from .discrepancy.diagnosis import Diagnosis
from .discrepancy.extension import Extension, Gain
from .discrepancy.finding import Finding, Scored
from .discrepancy.misfit import Misfit, misfit
from .discrepancy.points import Points
from .equation_error import EquationError, equation_error
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
from .integration import IntegrationError
from .linear import linearise
from .linear_fit import fit_linear
from .match import Match, match
from .mode_table import Mode, Modes
from .model import Model
from .modes import modes
from .multirate import multirate
from .multistart import Multistart, multistart
from .noise import Gaussian, Sigma
from .noise_kinds import PerExperiment, PerOutput
from .optima import Optimum
from .outcome import Outcome
from .parameters import Estimate, Parameter
from .planning.optimum import optimal_plan
from .planning.plan import Excursion, Plan, Plans
from .planning.planned import plan, plans
from .read import read
from .reconstruction.reconstruct import Reconstruction, reconstruct
from .records import Record
from .refinement import Refinement
from .response import FrequencyResponse
from .result import Fit
from .saving import load
from .shooting import MultipleShooting, SingleShooting
from .simulate import simulate
from .solvers import Ipopt, Iteration, Newton
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
from .transcription import Collocation
from .trim import Trim, trim
from .validation import Validation

__all__ = [
    "Candidate",
    "Candidates",
    "Collocation",
    "DataError",
    "Density",
    "Diagnosis",
    "EquationError",
    "Estimate",
    "EvaluationError",
    "Excursion",
    "Experiment",
    "Expr",
    "Extension",
    "FilterError",
    "Finding",
    "Fit",
    "FourierSmoothing",
    "FrequencyResponse",
    "Gain",
    "Gaussian",
    "Huber",
    "IntegrationError",
    "Ipopt",
    "Iteration",
    "Laplace",
    "Match",
    "Misfit",
    "MissingDependency",
    "Mode",
    "Model",
    "ModelError",
    "Modes",
    "MultipleShooting",
    "Multistart",
    "Newton",
    "Optimum",
    "OptionError",
    "Outcome",
    "Parameter",
    "PerExperiment",
    "PerOutput",
    "PhugoidError",
    "Place",
    "Plan",
    "Plans",
    "Points",
    "Reconstruction",
    "Record",
    "Refinement",
    "SavitzkyGolay",
    "Scored",
    "Sigma",
    "SingleShooting",
    "SmoothingSpline",
    "StateSpace",
    "StudentT",
    "Table",
    "Trim",
    "Validation",
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
