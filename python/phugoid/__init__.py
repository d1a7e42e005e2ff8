"""Phugoid finds the parameters of flight vehicles, and of any system of ODEs, from measured data.

Output-error method (maximum likelihood) by Lobatto collocation, with Rust kernels:

    import phugoid as ph

    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    ...
    fit = ph.estimate(m, ph.read("run1.csv"))
    print(fit.summary())
"""

from ._core import Expr, __version__
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
from .filter_error import FilterError
from .model import Model
from .multistart import Multistart, multistart
from .noise import Gaussian, Sigma
from .optima import Optimum
from .outcome import Outcome
from .parameters import Estimate, Parameter
from .read import read
from .records import Record
from .result import Fit, load
from .simulate import simulate
from .solvers import Ipopt, Iteration, Newton
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

__all__ = [
    "Collocation",
    "DataError",
    "Estimate",
    "EvaluationError",
    "Experiment",
    "Expr",
    "FilterError",
    "Fit",
    "Gaussian",
    "Ipopt",
    "Iteration",
    "MissingDependency",
    "Model",
    "ModelError",
    "Multistart",
    "Newton",
    "Optimum",
    "OptionError",
    "Outcome",
    "Parameter",
    "PhugoidError",
    "Record",
    "Sigma",
    "Table",
    "__version__",
    "acos",
    "asin",
    "atan",
    "atan2",
    "cos",
    "cosh",
    "estimate",
    "exp",
    "from_sympy",
    "load",
    "log",
    "maximum",
    "minimum",
    "multistart",
    "read",
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
