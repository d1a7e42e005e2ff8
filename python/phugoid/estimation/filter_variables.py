"""Variables of an estimation with process noise, and parameters of single experiments replaced by shared ones.

A parameter p of which each experiment has its own becomes the quantity p = s1 p1 + s2 p2 + ..., with an input s_i that
is 1 in experiment i and 0 elsewhere. The fit is the same; it costs derivatives that are zero, so transcriptions that
can do without do so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..data.interpolation import kinds_for
from ..errors import ModelError, OptionError
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..modelling.model import Model
from ..parameters import Estimates
from ..solvers.solution import Deadline, TimeUp

__all__ = ["Objective", "Separated", "intensity_start", "split"]


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
        diagonal = np.diag(metric)[:p]
        # A parameter without influence here, or collinear with others, must not make the metric singular.
        floor = np.where(diagonal > 0, 1e-9 * diagonal, 1 / np.where(z[:p] == 0, 1.0, z[:p]) ** 2)
        metric[range(p), range(p)] += floor
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
