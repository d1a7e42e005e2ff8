"""Evaluation of an experiment design: Fisher information and excursions, from a model and planned inputs; and the
optimisation of a manoeuvre within a family.

The record that a planned manoeuvre is predicted to give, with measured conditions that it does not state, is fitted,
without noise, from the very parameters that it was made with; there the Hessian of the log-likelihood is the Fisher
information, which `parameter_sensitivities` gives with the initial states free.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..errors import DataError, EvaluationError, ModelError, OptionError, listing, positive, whole
from ..estimation import estimate
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Gaussian
from ..parameters import Estimate, Estimates
from ..records import Record, record_of
from ..sensitivities.linearised import Linearised
from ..sensitivities.tangents import parameter_sensitivities
from ..simulation import first_values, simulate
from ..solvers import check_time, limited
from ..solvers.newton import Newton
from ..transcription import Collocation, SingleShooting
from .plan import Criterion, Information, Limits, Plan, Plans, criterion_of, excursions_of
from .steps import number

__all__ = [
    "condition_warnings",
    "first_states",
    "optimal_plan",
    "own_values",
    "plan",
    "plans",
    "predicted",
    "sigmas_of",
    "source_of",
    "value_of",
    "values_of",
    "with_conditions",
]

_Array = NDArray[np.float64]


# A condition that changes by less than this part of its size is constant.
_CONSTANT = 1e-9


def with_conditions(model: Model, fit: FitResult | None, runs: Sequence[Experiment]) -> list[Experiment]:
    """Return the manoeuvres with the conditions that they do not give: constant, at their mean in the records of the
    fit. Without a fit the manoeuvres are returned as they are."""
    if fit is None:
        return list(runs)
    return [_completed(model, fit, run) for run in runs]


def _completed(model: Model, fit: FitResult, run: Experiment) -> Experiment:
    lacking = [n for n in model.condition_names if n not in run.inputs and n not in run.channels]
    if not lacking:
        return run
    means = {n: float(np.mean(np.concatenate([r.inputs[n] for r in fit.records]))) for n in lacking}
    columns = run._columns_of()
    held = {n: np.full(run.n, mean) for n, mean in means.items()}
    said = ", ".join(f"{n} = {mean:.6g}" for n, mean in means.items())
    return run._stepped(
        f"conditions as in the records: {said}",
        {**columns, "input": {**columns["input"], **held}},
        run._signals_of(),
    )


def condition_warnings(model: Model, runs: Sequence[Experiment]) -> tuple[str, ...]:
    """Return a warning for each condition that a manoeuvre is planned to change."""
    found = []
    for run in runs:
        for name in model.condition_names:
            u = run.input(name)
            if np.ptp(u) > _CONSTANT * float(np.abs(u).max()):
                found.append(
                    f"'{name}' is a measured condition, not a control, and changes from {u.min():.4g} to "
                    f"{u.max():.4g} in '{run.name}': the plan holds only where it does so in flight"
                )
    return tuple(found)


# The fit must lie on the simulation, in units of the noise: else the mesh is too coarse for this manoeuvre.
_ON_PATH = 0.05
# Steps in an interval between samples.
_STEPS = 2


def predicted(
    model: Model,
    run: Experiment,
    values: Mapping[str, float],
    initial: Mapping[str, float],
    sigmas: Mapping[str, float],
    mesh: Collocation,
) -> tuple[Record, FitResult]:
    """Return the record that the model predicts for the inputs of ``run``, and the fit to it at these parameters.

    Raises EvaluationError where there is no solution, or where the fit does not lie on it.
    """
    noise = Gaussian(sigmas)
    # Steps of fixed length are a hundred times as fast; where they do not do, the careful way does, or says why not.
    for simulator in (simulate,) if model.delays else (_stepped, simulate):
        try:
            record = simulator(model, values, run, initial=initial)
            return record, _fitted(model, record, run, values, noise, mesh)
        except EvaluationError:
            if simulator is simulate:
                raise
    raise AssertionError


def _stepped(model: Model, values: Mapping[str, float], run: Experiment, *, initial: Mapping[str, float]) -> Record:
    """Simulate by Runge-Kutta steps of fixed length, in the core; arguments as of `simulate`."""
    run.check_for(model.input_names, [], conditions=model.condition_names)
    silent = run.with_outputs({n: np.zeros(run.n) for n in model.output_names})
    noise = Gaussian(dict.fromkeys(model.output_names, 1.0)).resolve(model.output_names, {}, {})
    problem = SingleShooting("dopri5", substeps=_STEPS, threads=1).problem(model, [silent], noise)
    first = first_values(model, values, values, run, initial)
    xi = np.array([*problem.variables([values[model.parameter_names[p]] for _, p, _ in problem.estimands]), *first])
    outputs, states = problem.outputs(xi, 0), problem.states(xi, 0)
    if not all(np.isfinite(v).all() for v in (*outputs, *states)):
        raise EvaluationError(f"plan: the solution of '{run.name}' is not finite")
    return record_of(model, run, outputs, states)


def _fitted(
    model: Model, record: Record, run: Experiment, values: Mapping[str, float], noise: Gaussian, mesh: Collocation
) -> FitResult:
    outputs = {}
    for name in model.output_names:
        outputs[name] = record.outputs[name].copy()
        if name in {*run.outputs, *run.channels}:  # sampled as there
            outputs[name][~np.isfinite(run.output(name))] = np.nan
    start = {n: v for n, v in values.items() if n in model.parameter_names} | dict(record.states)
    fit = estimate(
        model, run.with_outputs(outputs), transcription=mesh, noise=noise, start=start, solver=Newton(regression=False)
    )
    for name in model.output_names:
        residual = fit.records[0].residuals[name] / noise.known[name]
        off = float(np.sqrt(np.nanmean(residual**2))) if np.isfinite(residual).any() else 0.0
        if not off < _ON_PATH:
            raise EvaluationError(
                f"plan: manoeuvre '{run.name}': the fit of '{name}' to its own prediction is off by {off:.2g} sigma: "
                "give a finer mesh, transcription=Collocation(substeps=4), or smaller inputs"
            )
    return fit


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

    They are the Cramér-Rao bounds at the assumed values: of the information of the samples, with the initial states of
    each record free. For a right model, `estimate` gives the same after the flight.

    source     a model, with its ``values``; or a fit, whose values and noise are taken where not given.
    manoeuvre  inputs over the times of the samples, ``Experiment(t, inputs={...})``, see `phugoid.design`; those of a
               list follow one another. Where it has a channel of an output, that output is missing where the channel
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
        excursions={r.name: excursions_of(r, limits or {}) for r in records},
        records=records,
        sizes=measure,
        criteria=information.criteria(measure, of),
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
            raise ModelError(f"plan: sizes: '{n}' is not a parameter.{listing(str(n), list(estimates))}")
        positive(f"plan: the size of '{n}'", s)
    found = np.array([(sizes or {}).get(n, abs(estimates[n].value)) for n in names])
    return np.where(found > 0.0, found, np.nan)


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
            raise ModelError(f"plan: '{n}' is not a parameter.{listing(str(n), list(found))}")
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
            raise ModelError(f"plan: initial '{n}' is not a state.{listing(str(n), model.state_names)}")
        found[n] = float(v)
    return found


# Members of the population for each number that is chosen, and at least; steps of the search that follows it, and where
# it ends (of the logarithm of the criterion).
_MEMBERS, _FEWEST, _STEPS, _CLOSE = 6, 8, 25, 1e-3
# Penalty for leaving limits by their size; cost of a manoeuvre that cannot be simulated.
_BEYOND, _NEVER = 10.0, 1e3


def optimal_plan(
    source: Model | FitResult,
    make: Callable[..., Experiment | Sequence[Experiment]],
    bounds: Mapping[str, tuple[float, float]],
    *,
    criterion: Criterion = "D",
    generations: int = 12,
    seed: int = 0,
    time_limit: float | None = None,
    **options: Any,
) -> Plan:
    """Return the most informative manoeuvre of a family that keeps its limits.

    make         function that returns the manoeuvre for numbers by name: ``make(width=0.5, amplitude=0.03)``. Measured
                 conditions need not be in it: they are constant, as in `plan`.
    bounds       name -> (lower, upper) of these numbers.
    criterion    the criterion to minimise: "D", "A" or "worst" (`Plan.criteria`), of the parameters in the option
                 ``of``.
    generations  of differential evolution (Storn and Price, J. Global Optim. 11, 1997), which works with widths that
                 jump from sample to sample; a simplex search (Nelder and Mead) ends it. About (generations + 1) times 6
                 plans for each number, and 25. ``seed``: of its random numbers.
    time_limit   in seconds, of the whole. It ends the search as Ctrl-C does: the best plan so far is the result, with a
                 warning.
    options      those of `plan`: values, noise, limits, after, ...

    Returns the best plan that was found; ``plan.choice`` holds the numbers. It is near the optimum, but not at it to
    many digits. Raises OptionError where no manoeuvre that was tried keeps its limits. Manoeuvres that cannot be made
    or simulated (OptionError, EvaluationError) are skipped.
    """
    from scipy.optimize import differential_evolution, minimize

    deadline = limited("optimal_plan", time_limit)
    kind = criterion_of("optimal_plan", criterion)
    names = list(bounds)
    if not names:
        raise OptionError("optimal_plan: bounds gives the range of each variable, as in {'width': (0.2, 1.0)}")
    whole("optimal_plan: generations", generations, 1)
    for n, pair in bounds.items():
        low, high = (number("optimal_plan", f"a bound of {n}", b) for b in pair)
        if not low < high:
            raise OptionError(f"optimal_plan: bounds of {n} are (lower, upper), not {pair!r}")
    ends = np.array([bounds[n] for n in names], dtype=np.float64)
    # Sizes that span decades are searched in their logarithm.
    log = ends[:, 0] > 0.0
    ends[log] = np.log(ends[log])
    best: Plan | None = None
    nearest = (np.inf, "nothing could be made")

    def cost(point: NDArray[np.float64]) -> float:
        nonlocal best, nearest
        inside = np.clip(point, ends[:, 0], ends[:, 1])
        values = np.where(log, np.exp(np.where(log, inside, 0.0)), inside)
        check_time()
        choice = dict(zip(names, values.tolist(), strict=True))
        try:
            made = plan(source, make(**choice), **options)
        except (OptionError, EvaluationError) as error:
            nearest = min(nearest, (_NEVER, str(error)), key=lambda pair: pair[0])
            return _NEVER
        value = made.criteria[kind]
        excess = max(e.excess for channels in made.excursions.values() for e in channels.values())
        if made.within_limits:
            if best is None or value < best.criteria[kind]:
                best = replace(made, choice=choice)
        elif excess < nearest[0]:
            nearest = excess, "; ".join(made.violations)
        outside = float(np.abs(point - inside).max())
        return (float(np.log(value)) if np.isfinite(value) else 0.5 * _NEVER) + _BEYOND * (excess + outside)

    members = max(_MEMBERS * len(names), _FEWEST)
    rng = np.random.default_rng(seed)
    # One of each row and column of a grid: a Latin hypercube.
    parts = np.array([(rng.permutation(members) + rng.uniform(size=members)) / members for _ in names]).T
    first = ends[:, 0] + parts * (ends[:, 1] - ends[:, 0])
    cost(first[0])  # mistakes in the call show themselves here, as they are
    evolution = {"init": first, "maxiter": generations, "seed": rng, "polish": False, "tol": 0.0}
    ended = ""
    try:
        with deadline.in_force():
            found = differential_evolution(cost, ends.tolist(), **evolution)
            small = 0.05 * (ends[:, 1] - ends[:, 0])
            corners = np.vstack([found.x, found.x + np.diag(np.where(found.x + small > ends[:, 1], -small, small))])
            settings = {"initial_simplex": corners, "maxfev": _STEPS * len(names), "xatol": np.inf, "fatol": _CLOSE}
            minimize(cost, found.x, method="Nelder-Mead", options=settings)
    except KeyboardInterrupt:
        ended = deadline.ended()
    if best is None:
        early = f" before the end ({ended})" if ended else ""
        raise OptionError(
            f"optimal_plan: no manoeuvre that was tried{early} stays within its limits. The nearest: {nearest[1]}"
        )
    return replace(best, warnings=(*best.warnings, f"{ended}: this is the best plan so far")) if ended else best
