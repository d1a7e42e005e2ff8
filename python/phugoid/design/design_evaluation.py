"""Evaluation of an experiment design: Fisher information and excursions, from a model and planned inputs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..errors import DataError, ModelError, OptionError, listing, positive
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Gaussian
from ..parameters import Estimate, Estimates
from ..records import Record
from ..sensitivities.linearised import Linearised
from ..sensitivities.tangents import parameter_sensitivities
from ..transcription import Collocation
from .plan import Criterion, Excursion, Information, Plan, Plans
from .predicted_record import condition_warnings, predicted, with_conditions

__all__ = ["first_states", "own_values", "plan", "plans", "sigmas_of", "source_of", "value_of", "values_of"]

_Array = NDArray[np.float64]
Limits = Mapping[str, float | tuple[float, float]]


def plan(
    source: Model | FitResult,
    manoeuvre: Experiment | Sequence[Experiment],
    *,
    values: Mapping[str, Any] | None = None,
    noise: Mapping[str, float] | None = None,
    initial: Mapping[str, float] | None = None,
    limits: Limits | None = None,
    after: FitResult | None = None,
    of: Collection[str] | None = None,
    sizes: Mapping[str, float] | None = None,
    transcription: Collocation | None = None,
    name: str | None = None,
) -> Plan:
    """Return the standard errors to expect from a planned manoeuvre.

    They are the Cramér-Rao bounds at the assumed values: of the information of the samples, with the first states of
    each record free. For a right model, `estimate` gives the same after the flight.

    source     a model, with its ``values``; or a fit, whose values and noise are taken where not given.
    manoeuvre  inputs over the times of the samples, ``Experiment(t, inputs={...})``, see `phugoid.design`; a list is
               flown one after the other. Where it has a channel of an output, that output is missing where the channel
               is NaN, which describes sensors of lower rates. Measured conditions (`Model.conditions`) that it does not
               give are constant at their mean in the records of the fit; a warning names a condition that it changes.
    values     of parameters, by name; of those not named the model's starts, or the fit's.
    noise      output -> standard deviation, in its unit. Flight records have coloured residuals: take three to five
               times the sensor's noise, or expect errors larger than planned by that factor.
    initial    states at the beginning; else the fit's for its first record, else 0 (as `simulate`).
    limits     channel (input, state or output) -> greatest size, or (lower, upper).
    after      a fit of existing records: its information is added. Parameters of single experiments are excluded.
    of         the parameters that the criteria refer to; all estimated ones unless given. The others are estimated too.
    sizes      parameter -> typical size, in whose units the criteria measure its error; the size of its value unless
               given.

    Parameters that are fixed, and those at a bound, are taken as known; priors of the model count. Raises ModelError,
    DataError or OptionError for invalid arguments, EvaluationError where the model cannot be simulated.

    >>> m = Model("roll")
    >>> p, = m.states(p="rad/s")
    >>> da, = m.inputs(da="rad")
    >>> Lp, Lda = m.parameters(Lp=-2.0, Lda=10.0)
    >>> m.dynamics(p=Lp*p + Lda*da)
    >>> m.outputs(p=(p, "rad/s"))
    >>> t = np.arange(0.0, 6.0, 0.05)
    >>> from phugoid import design
    >>> run = Experiment(t, {"da": design.doublet(t, 0.05, width=1.0, start=1.0)}, name="doublet")
    >>> planned = plan(m, run, noise={"p": 0.01}, limits={"p": 0.3})
    >>> planned.parameters["Lp"]
    Lp = -2.00 ± 0.04
    >>> planned.within_limits
    True
    """
    runs = as_experiments(manoeuvre, "plan")
    model, fit = source_of(source)
    runs = with_conditions(model, fit, runs)
    given = values_of(model, fit, runs, values)
    sigmas = sigmas_of(model, fit, noise)
    first = first_states(model, fit, initial)
    if transcription is not None and not isinstance(transcription, Collocation):
        raise OptionError(f"plan: transcription is a Collocation, not {transcription!r}")
    mesh = transcription or Collocation()
    predictions = [predicted(model, run, own_values(model, given, run), first, sigmas, mesh) for run in runs]
    records, fits = [r for r, _ in predictions], [f for _, f in predictions]
    names, matrix = _pooled_information(model, fits)
    added = ""
    if after is not None:
        matrix = matrix + _information_of_fit(model, names, after)
        added = "after " + ", ".join(f"'{r.name}'" for r in after.records)
    matrix = matrix + _priors(model, names, () if after is None else after.parameters)
    information = Information(names, matrix)
    # Parameters that are fixed, or at a bound in each record, are known.
    first_fit = fits[0].parameters
    errors = dict(zip(names, information.std_errors.tolist(), strict=True))
    known = {n: p for n, p in model.declared_parameters.items() if n not in {x.partition("[")[0] for x in names}}
    estimates = Estimates(
        [
            *(_estimate(model, n, value_of(given, n), errors[n]) for n in names),
            *(
                Estimate(n, value_of(given, n), unit=p.unit, fixed=p.fixed, bounds_active=first_fit[n].bounds_active)
                for n, p in known.items()
            ),
        ]
    )
    measure = _sizes(estimates, names, sizes)
    return Plan(
        name=name or " + ".join(run.name for run in runs),
        parameters=estimates,
        information=information,
        excursions={r.name: _excursions(r, limits or {}) for r in records},
        records=records,
        sizes=measure,
        criteria=_criteria(information, measure, of),
        sigmas=sigmas,
        added=added,
        warnings=condition_warnings(model, runs),
    )


def plans(
    source: Model | FitResult, manoeuvres: Mapping[str, Experiment | Sequence[Experiment]], **options: Any
) -> Plans:
    """Evaluate `plan` for several manoeuvres, by name, with the same options; return them side by side."""
    if not isinstance(manoeuvres, Mapping) or not manoeuvres:
        raise DataError(f"plans: give the manoeuvres by name, as in {{'doublet': run1}}, not {manoeuvres!r}")
    return Plans({str(n): plan(source, m, name=str(n), **options) for n, m in manoeuvres.items()})


def _pooled_information(model: Model, fits: Sequence[FitResult]) -> tuple[list[str], _Array]:
    """Return names and information of all records, each of which may have its own parameters."""
    local = {n for n, p in model.declared_parameters.items() if p.per_experiment}
    parts = []
    for fit in fits:
        names, J = parameter_sensitivities(Linearised(fit))
        run = fit.records[0].name
        several = len(fits) > 1
        parts.append(([f"{n}[{run}]" if several and n in local else n for n in names], J.T @ J))
    names = list(dict.fromkeys(n for found, _ in parts for n in found))
    matrix = np.zeros((len(names), len(names)))
    for found, own in parts:
        at = [names.index(n) for n in found]
        matrix[np.ix_(at, at)] += own
    return names, matrix


def _information_of_fit(model: Model, names: Sequence[str], after: Any) -> _Array:
    """Return the information of a fit about these parameters; its other estimates are marginalised."""
    if not isinstance(after, FitResult):
        raise OptionError(f"plan: after is a fit of records that are there, not a {type(after).__name__}")
    theirs = list(after.parameters)
    cov = after.covariance
    # Parameters of single experiments carry no information on other experiments.
    local = {n for n, p in model.declared_parameters.items() if p.per_experiment}
    shared = [n for n in names if n in theirs and n not in local and np.isfinite(cov[theirs.index(n), theirs.index(n)])]
    shared = [n for n in shared if cov[theirs.index(n), theirs.index(n)] > 0.0]
    if not shared:
        raise OptionError("plan: after: the fit shares no parameter that has a standard error with this model")
    at = [theirs.index(n) for n in shared]
    block = cov[np.ix_(at, at)]
    scale = np.sqrt(np.diag(block))
    matrix = np.zeros((len(names), len(names)))
    own = [names.index(n) for n in shared]
    matrix[np.ix_(own, own)] = np.linalg.pinv(block / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    return matrix


def _priors(model: Model, names: Sequence[str], counted: Collection[str]) -> _Array:
    """Return the information of Gaussian priors, except of those that a fit has counted."""
    declared = model.declared_parameters
    each = [declared[n.partition("[")[0]].prior if n not in counted else None for n in names]
    return np.diag([0.0 if prior is None else prior[1] ** -2 for prior in each])


def _estimate(model: Model, name: str, value: float, error: float) -> Estimate:
    p = model.declared_parameters[name.partition("[")[0]]
    return Estimate(name, value, error, p.unit, p.start, p.bounds)


def _sizes(estimates: Estimates, names: Sequence[str], sizes: Mapping[str, float] | None) -> _Array:
    for n, s in (sizes or {}).items():
        if n not in estimates:
            raise ModelError(f"plan: sizes: '{n}' is no parameter.{listing(str(n), list(estimates))}")
        positive(f"plan: the size of '{n}'", s)
    found = np.array([(sizes or {}).get(n, abs(estimates[n].value)) for n in names])
    return np.where(found > 0.0, found, np.nan)


def _criteria(information: Information, sizes: _Array, of: Collection[str] | None) -> dict[Criterion, float]:
    names = list(information.names)
    for n in of or ():
        if n not in names:
            raise ModelError(f"plan: of: '{n}' is no parameter that is estimated.{listing(n, names)}")
    chosen = [i for i, n in enumerate(names) if (of is None or n in of) and np.isfinite(sizes[i])]
    if not chosen:
        raise OptionError("plan: no parameter has a size in which its error counts: give sizes={'name': ...}")
    block = information.covariance[np.ix_(chosen, chosen)] / np.outer(sizes[chosen], sizes[chosen])
    if not np.isfinite(block).all():
        return {"D": np.inf, "A": np.inf, "worst": np.inf}
    variance = np.diag(block)
    scale = np.sqrt(variance)
    _, log_det = np.linalg.slogdet(block / np.outer(scale, scale))
    log_det += 2.0 * np.log(scale).sum()
    return {
        "D": float(np.exp(0.5 * log_det / len(chosen))),
        "A": float(np.sqrt(variance.mean())),
        "worst": float(scale.max()),
    }


def _excursions(record: Record, limits: Limits) -> dict[str, Excursion]:
    channels = {**record.inputs, **record.states, **record.outputs}
    for n in limits:
        if n not in channels:
            raise ModelError(f"plan: limits: '{n}' is no input, state or output.{listing(str(n), list(channels))}")
    found = {}
    for n, v in channels.items():
        bound = limits.get(n)
        limit: tuple[float, float] | None = None
        if bound is not None:
            low, high = (-bound, bound) if isinstance(bound, (int, float)) else bound
            if not low < high:
                raise OptionError(f"plan: limits of '{n}' are a size, or (lower, upper), not {bound!r}")
            limit = float(low), float(high)
        # A limit that is an amplitude is reached, not left.
        slack = 1e-9 * max((abs(b) for b in limit or () if np.isfinite(b)), default=0.0)
        beyond = np.zeros(v.size, dtype=bool) if limit is None else (v < limit[0] - slack) | (v > limit[1] + slack)
        when = float(record.t[np.argmax(beyond)]) if beyond.any() else None
        found[n] = Excursion(float(v.min()), float(v.max()), record.units.get(n, ""), limit, when)
    return found


def source_of(source: Any) -> tuple[Model, FitResult | None]:
    if isinstance(source, FitResult):
        return source.model, source
    if isinstance(source, Model):
        source.check()
        return source, None
    raise ModelError(f"plan: the first argument is a Model or a Fit, not a {type(source).__name__}")


def values_of(
    model: Model, fit: FitResult | None, runs: Sequence[Experiment], values: Mapping[str, Any] | None
) -> dict[str, float]:
    """Return values for all parameters; those that each experiment has its own of also as name[experiment]."""
    found = {n: p.start for n, p in model.declared_parameters.items()}
    if fit is not None:
        # Parameters of single experiments have the values of the first record.
        own = {n: f"{n}[{fit.records[0].name}]" for n in found}
        found |= {n: fit.parameters[k].value for n in found for k in (own[n], n) if k in fit.parameters}
    local = {n for n, p in model.declared_parameters.items() if p.per_experiment}
    for n, v in (values or {}).items():
        base = str(n).partition("[")[0]
        if n not in found and not (base in local and n in {f"{base}[{run.name}]" for run in runs}):
            raise ModelError(f"plan: '{n}' is no parameter.{listing(str(n), list(found))}")
        try:
            found[str(n)] = float(v)
        except (TypeError, ValueError):
            raise ModelError(f"plan: the value of '{n}' is a number, not {v!r}") from None
    return found


def value_of(values: Mapping[str, float], name: str) -> float:
    return values[name] if name in values else values[name.partition("[")[0]]


def own_values(model: Model, values: Mapping[str, float], run: Experiment) -> dict[str, float]:
    return {n: values.get(f"{n}[{run.name}]", values[n]) for n in model.parameter_names}


def sigmas_of(model: Model, fit: FitResult | None, noise: Mapping[str, float] | None) -> dict[str, float]:
    names = model.output_names
    found: dict[str, float] = {}
    if isinstance(noise, Gaussian):
        noise = noise.known
    for n, s in (noise or {}).items():
        if n not in names:
            raise ModelError(f"plan: noise: '{n}' is not an output.{listing(str(n), names)}")
        if not isinstance(s, (int, float, np.number)) or not 0.0 < float(s) < np.inf:
            raise OptionError(f"plan: noise of '{n}' is a positive standard deviation, not {s!r}")
        found[n] = float(s)
    assumed = model.noise_model if fit is None else fit.noise
    plain = isinstance(assumed, Gaussian) and not assumed.correlated and assumed.covariance is None
    for n in [n for n in names if n not in found]:
        if plain and n in assumed.known_sigmas(names):
            found[n] = float(assumed.known_sigmas(names)[n])
        elif plain and fit is not None and f"sigma_{n}" in fit.parameters:
            found[n] = fit.parameters[f"sigma_{n}"].value
        else:
            raise OptionError(
                f"plan: the standard deviation of the noise of '{n}' is not known: give noise={{'{n}': ...}}"
                + ("" if plain else f" (that of the model is {assumed.description or assumed.kind})")
            )
    return {n: found[n] for n in names}


def first_states(model: Model, fit: FitResult | None, initial: Mapping[str, float] | None) -> dict[str, float]:
    found = {} if fit is None else {n: e.value for n, e in fit.initial_states[fit.records[0].name].items()}
    # States given by the model's initial conditions follow from the values.
    held = {state for end, state, _ in model.end_conditions if end == "initial"}
    found = {n: v for n, v in found.items() if n not in held}
    for n, v in (initial or {}).items():
        if n not in model.state_names:
            raise ModelError(f"plan: initial '{n}' is no state.{listing(str(n), model.state_names)}")
        found[n] = float(v)
    return found
