"""Variables of an estimation with process noise, and the result as a `FitResult`; parameters of single experiments
replaced by shared ones.

A parameter p of which each experiment has its own becomes the quantity p = s1 p1 + s2 p2 + ..., with an input s_i that
is 1 in experiment i and 0 elsewhere. The fit is the same; it costs derivatives that are zero, so transcriptions that
can do without do so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..data.filtering import kinds_for
from ..errors import ModelError, OptionError
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Noise
from ..parameters import Estimate, Estimates
from ..records import Record, record_of, repeated_outputs
from ..solvers import HINTS, Deadline, TimeUp
from ..solvers.newton import Minimum
from ..transcription import records_of

__all__ = [
    "Objective",
    "Separated",
    "intensity_start",
    "make_filter_fit",
    "split",
]


class Separated:
    """A model and experiments with shared parameters only, and the conversion of results back."""

    def __init__(self, model: Model, experiments: Sequence[Experiment]) -> None:
        self.original, self.records = model, list(experiments)
        local = [name for name, p in model.declared_parameters.items() if p.per_experiment]
        numbers = range(len(experiments))
        self.names = {f"{name}__{i}": f"{name}[{experiments[i].name}]" for name in local for i in numbers}
        self.model = model._separated(local, len(experiments))
        self.experiments = [self._experiment(e, i) for i, e in enumerate(experiments)]

    def _experiment(self, e: Experiment, number: int) -> Experiment:
        switches = {f"experiment__{i}": np.full(e.n, float(i == number)) for i in range(len(self.records))}
        inputs = {name: e.input(name) for name in self.original.input_names}
        outputs = {name: e.output(name) for name in self.original.output_names}
        kinds = kinds_for(e.interpolation, inputs)
        other = Experiment(e.t, {**inputs, **switches}, outputs, e.name, kinds, units=e._units_of(inputs, outputs))
        signals = {name: s for name in inputs if (s := e.signal(name)) is not None}
        return other._sampled(signals, e.mesh_times)

    def start(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return start values by the new names."""
        found = {name: value for name, value in given.items() if name in self.model.parameter_names}
        for new, old in self.names.items():
            base = old.partition("[")[0]
            if old in given or base in given:
                found[new] = given.get(old, given.get(base))
        taken = {*self.names.values(), *(old.partition("[")[0] for old in self.names.values())}
        return {**{name: value for name, value in given.items() if name not in taken}, **found}

    def fit(self, fit: FitResult) -> FitResult:
        """Return a fit of the original model as one of this model, to start from."""
        new = {old: name for name, old in self.names.items()}
        estimates = Estimates(replace(e, name=new.get(e.name, e.name)) for e in fit.parameters.values())
        return replace(fit, parameters=estimates, model=self.model)

    def restored(self, fit: FitResult) -> FitResult:
        """Return a fit of this model as one of the original."""
        estimates = Estimates(replace(e, name=self.names.get(e.name, e.name)) for e in fit.parameters.values())
        records = [
            replace(r, inputs={name: u for name, u in r.inputs.items() if name in self.original.input_names})
            for r in fit.records
        ]
        return replace(fit, parameters=estimates, model=self.original, records=records)


_Array = NDArray[np.float64]


class Objective:
    """Minus the marginal log-likelihood and the parameters' priors, by the variables z: the model's parameters, the
    logarithm of each unknown sigma, and the intensities q, of which the sign means nothing.

    In q, and not its logarithm, the likelihood is smooth where there is no process noise: a maximum at q = 0 is one
    like any other.
    """

    def __init__(
        self, model: Model, problem: _core.Filter, path: _Array, bounds: tuple[_Array, _Array], n_q: int
    ) -> None:
        self.model, self.problem, self.path, self.bounds, self.n_q = model, problem, path, bounds, n_q
        self.n_model = len(model.parameter_names)
        self.n_sigma = len(problem.parameters) - self.n_model - n_q
        self.priors = [(i, *p.prior) for i, p in enumerate(model.declared_parameters.values()) if p.prior]
        self.reason = ""
        # The least value so far, with its path.
        self.best: tuple[float, _Array] | None = None

    def on(self, problem: _core.Filter) -> Objective:
        """Return the objective with another treatment of the noise between samples, starting from the path of
        this one."""
        path = problem.start(self.problem.states(self.path))
        return Objective(self.model, problem, path, self.bounds, self.n_q)

    @property
    def sigmas(self) -> slice:
        """The logarithms of sigma among z."""
        return slice(self.n_model, self.n_model + self.n_sigma)

    @property
    def intensities(self) -> slice:
        """The intensities among z."""
        return slice(self.n_model + self.n_sigma, None)

    def theta(self, z: _Array) -> _Array:
        """Return the parameters as the core takes them."""
        theta = z.copy()
        theta[self.sigmas] = np.exp(-z[self.sigmas])
        return theta

    def prior(self, z: _Array) -> float:
        """Return minus the logarithm of the parameters' priors, without constants."""
        return float(sum(0.5 * ((z[i] - mean) / std) ** 2 for i, mean, std in self.priors))

    def __call__(self, z: _Array) -> tuple[float, _Array] | None:
        """Return value and gradient; None where they do not exist, with the cause in ``reason``.

        Raises TimeUp at the limit in force.
        """
        theta = self.theta(z)
        try:
            found = self.problem.evaluate(theta, self.path, True, Deadline(None).left())
        except TimeoutError:
            raise TimeUp from None
        if isinstance(found, str):
            self.reason = found
            return None
        likelihood, gradient, self.path, _ = found
        gradient = -gradient
        gradient[self.sigmas] *= -theta[self.sigmas]
        value = float(self.prior(z) - likelihood)
        for i, mean, std in self.priors:
            gradient[i] += (z[i] - mean) / std**2
        if self.best is None or value <= self.best[0]:
            self.best = value, self.path
        return value, gradient

    def metric(self, z: _Array, measured: Sequence[int], intervals: int) -> _Array:
        """Return an approximation of the Hessian: the expected information of the model's parameters, and for noise
        levels that of their number of samples. Raises TimeUp at the limit in force."""
        n = z.size
        metric = np.zeros((n, n))
        p = self.n_model
        try:
            information = self.problem.information(self.theta(z), self.path, Deadline(None).left())
        except TimeoutError:
            raise TimeUp from None
        if information is not None:
            metric[:p, :p] = information.reshape(p, p)
        for i, _, std in self.priors:
            metric[i, i] += 1 / std**2
        diagonal = np.maximum(np.diag(metric)[:p], 0.0)  # rounding may leave less
        # A parameter without influence here, or collinear with others, must not make the metric singular.
        floor = np.where(diagonal > 0, 1e-9 * diagonal, 1 / np.where(z[:p] == 0, 1.0, z[:p]) ** 2)
        metric[range(p), range(p)] = diagonal + floor
        noise = [2.0 * count for count in measured]
        noise += [2.0 * intervals / max(q * q, 1e-300) for q in z[self.intensities]]
        metric[range(p, n), range(p, n)] = noise
        return metric

    def hessian(self, z: _Array, metric: _Array, held: NDArray[np.bool_]) -> _Array | None:
        """Return the Hessian by central differences of the gradient, with steps of a hundredth of a standard error;
        rows and columns of ``held`` variables are zero. None where the likelihood does not exist nearby."""
        path = self.path
        hessian = np.zeros((z.size, z.size))
        size = 0.01 / np.sqrt(np.diag(metric))
        for i in np.flatnonzero(~held):
            ends = []
            for sign in (1, -1):
                there = z.copy()
                there[i] += sign * size[i]
                ends.append(self(there))
                self.path = path
            if ends[0] is None or ends[1] is None:
                return None
            hessian[i] = (ends[0][1] - ends[1][1]) / (2 * size[i])
        hessian[:, held] = 0.0
        return 0.5 * (hessian + hessian.T)


def intensity_start(
    options: FilterError, model: Model, times: Sequence[_Array], states: Sequence[_Array], given: Any
) -> list[float]:
    """Return the start values of intensities: as given (``q_<state>``), else half of the value that would explain all
    motion of the state as a random walk, from which they decrease fast.

    ``times`` and ``states``, (n_x, points): one array an experiment. Raises OptionError where a state stands still at
    the start.
    """
    starts = []
    for name in options.states:
        if name in (options.intensities or {}):
            if f"q_{name}" in given:
                raise ModelError(f"start: q_{name} is known (intensities) and cannot be given a start as well")
            starts.append((options.intensities or {})[name])
            continue
        if f"q_{name}" in given:
            starts.append(_positive(f"q_{name}", given[f"q_{name}"]))
            continue
        row = model.state_names.index(name)
        squares = [np.diff(x[row]) ** 2 / np.diff(t) for x, t in zip(states, times, strict=True)]
        q = 0.5 * float(np.sqrt(np.concatenate(squares).mean()))
        if not q > 0:
            raise OptionError(
                f"FilterError: state '{name}' is not measured by itself, so there is nothing to start 'q_{name}' from: "
                f"give start={{'q_{name}': ...}}, or output_error=True"
            )
        starts.append(q)
    return starts


def _positive(name: str, value: Any) -> float:
    try:
        number = abs(float(value))
    except (TypeError, ValueError):
        number = math.nan
    if not 0 < number < math.inf:
        raise ModelError(f"the start of {name} is a positive number, not {value!r}")
    return number


def split(options: FilterError, start: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the start values of intensities, and all others."""
    names = {f"q_{name}" for name in options.states}
    return {n: v for n, v in start.items() if n in names}, {n: v for n, v in start.items() if n not in names}


# An intensity this small a part of its standard error is none.
_NONE = 0.05


def make_filter_fit(
    model: Model,
    experiments: Sequence[Experiment],
    noise: Noise,
    options: FilterError,
    objective: Objective,
    end: Minimum,
    hessian: _Array | None,
    seconds: float,
) -> FitResult:
    """Return the fit at a maximum of the marginal likelihood.

    Standard errors are from the curvature there (``hessian``, of minus the likelihood in the variables of
    `Objective`); those of initial states add to the smoother's variance what the parameters' uncertainty brings.
    """
    z, names = end.x, objective.problem.parameters
    lower, upper = objective.bounds
    sides: list[Literal["lower", "upper"] | None] = [
        None if lo == up else "lower" if v <= lo else "upper" if v >= up else None
        for v, lo, up in zip(z, lower, upper, strict=True)
    ]
    fixed = lower == upper
    warnings: list[str] = []
    status = end.status
    covariance = np.full((z.size, z.size), np.nan)
    free = np.flatnonzero([not f and s is None for f, s in zip(fixed, sides, strict=True)])
    stopped = status in ("interrupted", "time limit")
    if objective.best is None:
        warnings.append(
            "time limit: nothing was evaluated; the states are those of the start and do not satisfy the equations: "
            "there is no log-likelihood and no standard error"
        )
    elif hessian is None and stopped:
        warnings.append(f"{status}: there are no standard errors; go on with start=fit")
    elif hessian is None:
        warnings.append("there are no standard errors: the curvature of the likelihood was not computed")
    else:
        status = _invert(hessian, free, names, covariance, warnings, status)

    values = z.copy()
    values[objective.sigmas] = np.exp(z[objective.sigmas])
    values[objective.intensities] = np.abs(z[objective.intensities])
    slope = np.ones(z.size)
    slope[objective.sigmas] = values[objective.sigmas]
    slope[objective.intensities] = np.where(z[objective.intensities] < 0, -1.0, 1.0)
    covariance *= np.outer(slope, slope)
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diag(covariance))
    declared = list(model.declared_parameters.items())
    estimates = [
        Estimate(n, values[i], errors[i], p.unit, p.start, p.bounds, p.fixed, sides[i])
        for i, (n, p) in enumerate(declared)
    ]
    units = model.units
    for i in range(len(declared), z.size):
        name = names[i]
        if i in range(z.size)[objective.sigmas]:
            bounds = (float(np.exp(lower[i])), float(np.exp(upper[i])))
            unit = units.get(name.removeprefix("sigma_"), "")
            if sides[i] == "lower":
                warnings.append(f"{name} sits at its lower bound {values[i]:.3g}: this output is fitted exactly")
            estimates.append(Estimate(name, values[i], errors[i], unit, bounds=bounds, bounds_active=sides[i]))
            continue
        state = name.removeprefix("q_")
        unit = f"{units[state]}/√{model.time_unit}" if state in units else ""
        if fixed[i]:
            estimates.append(Estimate(name, values[i], errors[i], unit, values[i], (0.0, np.inf), fixed=True))
            continue
        none = bool(values[i] < _NONE * errors[i])
        if none:
            warnings.append(
                f"{name} is 0: the data show no process noise in {state} (its standard error there is {errors[i]:.2g})"
            )
        active: Literal["lower"] | None = "lower" if none else None
        estimates.append(Estimate(name, values[i], errors[i], unit, bounds=(0.0, np.inf), bounds_active=active))

    warnings += _core.gap_warnings(model.input_names, records_of(model, experiments))
    smoothed, missing = _smoothed(objective, z)
    warnings += missing
    records, initial = _records(model, experiments, smoothed, covariance, feasible=objective.best is not None)
    warnings += repeated_outputs(records, model.output_names)
    message = HINTS.get(status, "")
    return FitResult(
        model=model,
        noise=noise,
        transcription=options,
        parameters=Estimates(estimates),
        initial_states=initial,
        covariance=covariance,
        log_likelihood=objective.prior(z) - end.value,
        records=records,
        status=status,
        message=message,
        iterations=end.iterations,
        time=seconds,
        warnings=tuple(warnings),
        history=end.history,
    )


def _invert(
    hessian: _Array, free: NDArray[np.intp], names: Sequence[str], out: _Array, warnings: list[str], status: str
) -> str:
    """Fill in the covariance of the free variables; return the status, which singular curvature changes."""
    block = hessian[np.ix_(free, free)]
    scale = np.sqrt(np.abs(np.diag(block)))
    none = scale == 0
    scale[none] = 1.0
    values, vectors = np.linalg.eigh(block / np.outer(scale, scale))
    weak = values < 1e-10
    if weak.any():
        involved = np.abs(vectors[:, weak]).max(axis=1) > 0.1
        listed = ", ".join(names[int(free[k])] for k in np.flatnonzero(involved))
        if (values < -1e-4).any():
            warnings.append(f"not a proper maximum: the likelihood grows from here in some direction of {listed}")
        else:
            warnings.append(f"{listed} cannot be distinguished with these data: fix one of them, or give it a prior")
            status = "unidentifiable"
        keep = ~involved
        free, block = free[keep], block[np.ix_(keep, keep)]
    if free.size:
        scale = np.sqrt(np.abs(np.diag(block)))
        out[np.ix_(free, free)] = np.linalg.inv(block / np.outer(scale, scale)) / np.outer(scale, scale)
    return status


def _smoothed(objective: Objective, z: _Array) -> tuple[list[_core._Smoothed], list[str]]:
    """Return the smoothed records, and a sentence where there is no time for them: the most probable path is then what
    the last evaluation found, and what the smoother says of it is NaN."""
    problem, theta = objective.problem, objective.theta(z)
    if objective.best is None:
        return problem.unsmoothed(theta, objective.path), []
    try:
        found = problem.smooth(theta, objective.path, Deadline(None).with_grace())
        why = "not found"
    except TimeoutError:
        found, why = None, "time limit"
    except KeyboardInterrupt:
        found, why = None, "interrupted"
    if found is not None:
        return found, []
    text = f"{why}: there are no innovations, and no standard deviations of states; go on with start=fit"
    return problem.unsmoothed(theta, objective.best[1]), [text]


def _records(
    model: Model,
    experiments: Sequence[Experiment],
    smoothed: Sequence[_core._Smoothed],
    covariance: _Array,
    feasible: bool,
) -> tuple[list[Record], dict[str, Estimates]]:
    """Return the smoothed time histories, and the initial states with their standard errors."""
    n, p = len(model.state_names), len(model.parameter_names)
    of_model = np.nan_to_num(covariance[:p, :p])
    records, initial = [], {}
    for e, (pairs, first, follows) in zip(experiments, smoothed, strict=True):
        (states, deviations), (outputs, _), (innovations, spreads), (predicted, _) = pairs
        measured = {name: e.output(name) for name in model.output_names}
        by_output = dict(zip(model.output_names, outputs, strict=True))
        by_state = dict(zip(model.state_names, states, strict=True))
        records.append(
            record_of(
                model,
                e,
                outputs,
                states,
                measured=measured,
                residuals={name: z - by_output[name] for name, z in measured.items()},
                mesh_t=e.t,
                mesh_states=by_state,
                feasible=feasible,
                state_std=dict(zip(model.state_names, deviations, strict=True)),
                innovations=dict(zip(model.output_names, innovations, strict=True)),
                innovation_std=dict(zip(model.output_names, spreads, strict=True)),
                predicted_states=dict(zip(model.state_names, predicted, strict=True)),
            )
        )
        moves = follows.reshape(n, p)
        variance = np.diag(first.reshape(n, n) + moves @ of_model @ moves.T)
        initial[e.name] = Estimates(
            Estimate(name, by_state[name][0], np.sqrt(np.maximum(variance[i], 0.0)), model.units.get(name, ""))
            for i, name in enumerate(model.state_names)
        )
    return records, initial
