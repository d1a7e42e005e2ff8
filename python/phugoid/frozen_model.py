"""A fitted model frozen for other experiments: its parameters, its noise, its mesh, and which parameters are biases."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._core import Expr
from .data.experiment import Experiment
from .errors import OptionError
from .filter_error import FilterError
from .fit_result import FitResult
from .modelling.densities import Density, Huber, Laplace, PerExperiment, PerOutput, StudentT
from .modelling.model import Model
from .modelling.noise import Gaussian, Noise
from .parameters import Estimates, Parameter
from .transcription import Collocation, SingleShooting, Transcription

__all__ = [
    "biases",
    "estimates_of",
    "freed_by_default",
    "freeze_model",
    "freeze_noise",
    "mesh_for",
]


def biases(model: Model) -> tuple[str, ...]:
    """Return the parameters that enter outputs only, each as a term with a coefficient that is constant over a record.

    ``q + b_q`` has the bias b_q, and so has ``K*(alpha + b)`` with another parameter K. A parameter that enters a state
    equation or a condition at an end of the record (CL0, say) is not a bias, nor is a delay, nor one of two that
    multiply each other.
    """
    return _entering_outputs_only(model, _symbols_of_motion(model, with_initial=True))


def freed_by_default(model: Model) -> tuple[str, ...]:
    """Return the parameters that a validation re-estimates: biases, and initial values that each experiment has its own
    of."""
    declared = model.declared_parameters
    either = {*biases(model)}
    apart = _entering_outputs_only(model, _symbols_of_motion(model, with_initial=False))
    either |= {name for name in apart if declared[name].per_experiment}
    return tuple(name for name in declared if name in either and not declared[name].fixed)


def _symbols_of_motion(model: Model, with_initial: bool) -> set[str]:
    """Return the symbols in state equations and conditions, with quantities substituted."""
    found = [*model.state_expressions().values()]
    found += [e for end, _, e in model.end_conditions if with_initial or end != "initial"]
    return {symbol for e in found for symbol in e.simplify().symbols}


def _entering_outputs_only(model: Model, motion: set[str]) -> tuple[str, ...]:
    parameters = {*model.parameter_names}
    outputs = [Expr(e).simplify() for e in model.output_expressions().values()]
    initial = {s for end, _, e in model.end_conditions if end == "initial" for s in e.symbols}
    coefficients: dict[str, set[str]] = {}
    for name in model.parameter_names:
        if name in motion or name in model.delays.parameters:
            continue
        slopes = [e.diff(name).simplify() for e in outputs if name in e.symbols]
        symbols = {s for slope in slopes for s in slope.symbols}
        acts = any(slope.constant != 0.0 for slope in slopes) or name in initial
        if acts and symbols <= parameters - {name}:
            coefficients[name] = symbols
    return tuple(name for name, symbols in coefficients.items() if symbols.isdisjoint(coefficients))


_Array = NDArray[np.float64]


def freeze_model(model: Model, values: Mapping[str, float], free: Collection[str]) -> Model:
    """Return the model with all parameters fixed at ``values`` except those in ``free``, which stay as declared."""
    # Without bounds: a value at one may lie outside by rounding.
    return model.with_parameters(
        {
            name: replace(p, fixed=False) if name in free else Parameter(values[name], unit=p.unit, fixed=True)
            for name, p in model.declared_parameters.items()
        }
    )


def freeze_noise(fit: FitResult) -> tuple[Noise, tuple[str, ...]]:
    """Return the fit's noise with every number known, and remarks on it.

    Where each experiment of the fit has noise of its own, another experiment gets its mean: of variances and
    covariances, weighted by samples. Raises OptionError for other numbers of which there are several.
    """
    outputs = fit.model.output_names
    if not isinstance(fit.noise, PerExperiment):
        return _known(fit.noise, outputs, fit.parameters.to_dict()), ()
    inner, estimated = fit.noise.noise, fit.noise.noise.names(outputs)
    if len(fit.records) == 1 or not estimated:  # one experiment's are called as shared ones are
        return _known(inner, outputs, fit.parameters.to_dict()), ()
    each = [{name: fit.parameters[f"{name}[{r.name}]"].value for name in estimated} for r in fit.records]
    several = [name for name in estimated if not name.startswith(("sigma_", "corr_"))]
    if several:
        raise OptionError(
            f"validate: each experiment of the fit has its own {several[0]}, and which another one has is not known: "
            "fit with noise that is shared"
        )
    said = ("each experiment of the fit has its own noise: these have the mean of its variances, weighted by samples",)
    if isinstance(inner, Gaussian) and inner.correlated:
        weights = [r.n for r in fit.records]
        matrices = [np.array(_known(inner, outputs, values).covariance) for values in each]  # type: ignore[attr-defined]
        return Gaussian(covariance=np.average(matrices, axis=0, weights=weights)), said
    pooled = {}
    for name in estimated:
        output = name.removeprefix("sigma_")
        counts = [int(np.isfinite(r.measured[output]).sum()) for r in fit.records]
        pooled[name] = math.sqrt(float(np.average([values[name] ** 2 for values in each], weights=counts)))
    return _known(inner, outputs, pooled), said


def _known(noise: Noise, outputs: Sequence[str], values: Mapping[str, float]) -> Noise:
    """Return a noise model with ``values`` (``sigma_<output>``, ...) in place of what it estimates. Parameters in
    expressions are those of the model."""
    known: dict[str, Any] = {**noise.known_sigmas(outputs), **noise.expressions}
    sigma = {name: values.get(f"sigma_{name}", known.get(name, math.nan)) for name in outputs}
    if isinstance(noise, Gaussian):
        if noise.covariance is not None:
            return noise
        if not noise.correlated:
            return Gaussian(sigma)
        return Gaussian(covariance=noise.matrix(outputs, values))
    if isinstance(noise, StudentT):
        return replace(noise, sigma=sigma, dof={n: values.get(f"dof_{n}", noise._dof(n)) for n in outputs})
    if isinstance(noise, (Huber, Laplace)):
        return replace(noise, sigma=sigma)
    if isinstance(noise, PerOutput):
        own = {name: _known(noise.of(name), [name], {**values, f"sigma_{name}": sigma[name]}) for name in outputs}
        return PerOutput(own)
    assert isinstance(noise, Density)  # there is no other
    each: dict[str, Noise] = {}
    for name in outputs:
        start = {
            p: values.get(f"{p}_{name}", float(getattr(d, "start", math.nan))) for p, d in noise.parameters.items()
        }
        each[name] = Density(
            noise.log_density, {name: sigma[name]}, {p: Parameter(v, fixed=True) for p, v in start.items()}
        )
    return PerOutput(each)


def mesh_for(fit: FitResult, experiments: Sequence[Experiment]) -> Transcription | FilterError:
    """Return the fit's transcription for other experiments, with segments of the same length where it has its own.

    A mesh that was refined for the fit is refined again; process noise has the intensities of the fit.
    """
    t = fit.transcription
    if isinstance(t, FilterError):
        return replace(t, output_error=False, intensities={n: fit.parameters[f"q_{n}"].value for n in t.states})
    if isinstance(t, Collocation) and fit.refinement is not None:
        first = fit.refinement.steps[0].order
        return Collocation(first, threads=t.threads, refine=True, tolerance=fit.refinement.tolerance)
    lengths = [float(r.t[-1] - r.t[0]) for r in fit.records]
    longest, shortest = max(float(e.t[-1] - e.t[0]) for e in experiments), min(lengths)
    alike = np.allclose([*lengths, *(float(e.t[-1] - e.t[0]) for e in experiments)], shortest, rtol=1e-9, atol=0)
    interval = float(np.median(np.concatenate([np.diff(e.t) for e in experiments])))

    def number(size: float, of: float) -> int:
        return max(math.ceil(of / size - 1e-9), 1)

    if isinstance(t, SingleShooting):
        if t.steps is None or alike:
            return t
        step = shortest / t.steps
        if step > interval:
            return replace(t, steps=number(step, longest))
        return replace(t, steps=None, substeps=number(step, interval))
    if t.segments is None or (alike and isinstance(t.segments, int)):
        return t
    if isinstance(t.segments, int):
        length = shortest / t.segments
    else:
        ends: Any = t.segments if isinstance(t.segments[0], tuple) else (t.segments,)  # type: ignore[index]
        length = float(np.median(np.concatenate([np.diff(each) for each in ends])))
    if isinstance(t, Collocation) and length < 1.5 * interval:
        return replace(t, segments=None, substeps=number(length, interval))
    if fit.model.delays:  # which move the samples
        return replace(t, segments=number(length, longest))
    return replace(t, segments=[_at_samples(e.t, length) for e in experiments])


def _at_samples(t: _Array, length: float) -> _Array:
    """Return ends of segments of about a length, at samples, since inputs have corners there and segments should not
    straddle that."""
    count = math.ceil(float(t[-1] - t[0]) / length - 1e-9)
    ends = np.linspace(t[0], t[-1], count + 1)
    after = np.clip(np.searchsorted(t, ends), 1, t.size - 1)
    nearest = np.where(ends - t[after - 1] < t[after] - ends, after - 1, after)
    return np.asarray(t[np.unique(nearest)])


def estimates_of(estimates: Estimates, names: Collection[str]) -> Estimates:
    """Return the estimates of the named parameters, also where each experiment has its own."""
    return Estimates(e for e in estimates.values() if e.name in names or e.name.partition("[")[0] in names)
