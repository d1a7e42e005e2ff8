"""Public functions that return a `Fit`: those of the engine, whose results get their methods here."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, overload

from .estimation import estimate_from_afar
from .result import Fit

if TYPE_CHECKING:
    from .data.experiment import Experiment
    from .filter_error import FilterError
    from .fit_result import FitResult
    from .fleet.result import FleetFit
    from .modelling.model import Model
    from .modelling.noise import Noise
    from .regression.equation_error import EquationError
    from .solvers import Iteration
    from .solvers.ipopt import Ipopt
    from .solvers.newton import Newton
    from .transcription import Collocation, Transcription

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


@overload
def estimate(
    model: Model,
    data: Experiment | Sequence[Experiment],
    *,
    transcription: Transcription | FilterError | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | EquationError | None = None,
    solver: Newton | Ipopt | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    executor: None = None,
) -> Fit: ...


@overload
def estimate(
    model: Model,
    data: Sequence[Any],
    *,
    transcription: Collocation | None = None,
    noise: Noise | None = None,
    start: Mapping[str, Any] | FitResult | None = None,
    solver: Newton | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    executor: Any,
    leave_out: bool = False,
    first: int = 8,
    memory: float = 1e9,
    populations: Sequence[str] = (),
) -> FleetFit: ...


def estimate(
    model: Model,
    data: Any,
    *,
    transcription: Any = None,
    noise: Noise | None = None,
    start: Any = None,
    solver: Any = None,
    progress: bool | Callable[[Iteration], None] = False,
    executor: Any = None,
    leave_out: bool = False,
    first: int = 8,
    memory: float = 1e9,
    populations: Sequence[str] = (),
) -> Fit | FleetFit:
    """Estimate the parameters of a model from measured data by maximum likelihood: the output-error method.

    ``data``: one experiment or several with shared parameters. Initial states are free.
    ``start``: values by name of parameters, of ``sigma_<output>`` (and what else the noise has) and of states (a number
    or one value a sample), or a fit to go on from, or the result of `equation_error`. Parameters not named start as
    declared, standard deviations at the spread of the measurements, states as measured where an output measures them,
    else as declared (`State`, `Model.initial`), else at 0, or at 1 where the model has no finite derivative at 0.
    ``transcription``: `Collocation`, `MultipleShooting` or `SingleShooting`, or `FilterError` where there is process
    noise, such as turbulence; the latter has a solver of its own.
    ``noise``: `Gaussian`, `StudentT`, `Huber`, `Laplace`, `Density` or `PerOutput`, or `PerExperiment` of these,
    instead of the model's own.
    ``solver``: `Newton` unless asked otherwise.
    ``progress``: True prints the iterations; a function is called with each.
    ``executor``: a `concurrent.futures` executor, a list of these, or a client of Dask: ``data`` are then the records
    of a fleet, also paths, URLs and `Run` objects that are read on the workers, and the result is a `FleetFit`. For
    each trial a worker returns sums over its records. ``leave_out`` leaves out records that cannot be used, ``first``
    is the number of records of the first estimate, ``memory`` the bytes of records that are kept on all workers
    together, and ``populations`` names parameters of each record's own that are drawn from a normal distribution, which
    is estimated, too.

    Where jumps or kinks of the state equations (`sign`, `abs`, `where`, ...) keep a fit by `Collocation` from
    converging, or are crossed where its mesh is too coarse for them, they are smoothed, over widths that are reduced
    from fit to fit until the error of smoothing is small compared with the standard errors. `Fit.smoothing` and the
    message say so.

    Where a run by `Collocation` with `Newton` ends without an optimum, or at one at which no output is matched well
    (R² below 0.5), other ways from the same start are tried in turn: where outputs are densely sampled and ``start`` is
    not a fit, estimates with output injection (states are driven towards the measurements, with a gain that falls to
    zero), a regression on the initial paths of the states, steps along paths that satisfy the equations, the exact
    Hessian, and the restarts that ``Newton(restarts=...)`` asks for. The message says which one led to the result.
    A fit without ``solver`` and ``start`` is first tried with the noise fixed at the spread of the measurements, too;
    a warning says where the likelihood was higher before. ``max_iterations`` below 200 leaves all this out.

    Ctrl-C ends the run and returns the best point so far, with status "interrupted". Pressed once more, while its
    standard errors are computed, it leaves these out (NaN, and a warning); a third time, it raises KeyboardInterrupt.

    Raises ModelError, DataError or OptionError for what cannot be right, EvaluationError where the model is not
    finite at the start. A fit that does not converge has a status that says so; this is no error.
    """
    if executor is None:
        found = estimate_from_afar(
            model, data, transcription=transcription, noise=noise, start=start, solver=solver, progress=progress
        )
        return Fit._of(found)
    from .fleet.estimation import estimate_fleet  # not at import: most have one machine

    return estimate_fleet(
        model,
        data,
        executor,
        transcription=transcription,
        noise=noise,
        start=start,
        solver=solver,
        progress=progress,
        leave_out=leave_out,
        first=first,
        memory=memory,
        populations=populations,
    )


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
