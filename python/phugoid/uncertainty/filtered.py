"""The marginal likelihood of a fit with process noise, at its estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..data.experiment import Experiment
from ..discrepancy.search.linearised import dataset
from ..fit_result import FitResult
from ..modelling.model import Model
from ..process_noise.separate import Separated
from ..transcription.filter_error import FilterError

__all__ = ["Filtered", "of_fit"]

_Array: TypeAlias = NDArray[np.float64]

# By how much of its standard error a parameter is moved to see what follows it.
_PART = 0.1


class Filtered:
    """The likelihood of a model in experiments, with numbers for all that it depends on.

    names   of the model's parameters, the sigmas that are not known, and the intensities.
    values  of these, (n,).
    """

    def __init__(
        self,
        model: Model,
        experiments: Sequence[Experiment],
        options: FilterError,
        values: Mapping[str, float],
        known: Mapping[str, float],
        states: Sequence[_Array],
    ) -> None:
        """``values`` by name, ``known`` sigmas by output; ``states`` of each experiment, (n_x, N), to start from."""
        self.model, self.experiments, self.options = model, list(experiments), options
        sigmas = [
            (name in known, known.get(name, values.get(f"sigma_{name}", math.nan)), 0.0, math.inf)
            for name in model.output_names
        ]
        self.problem: _core.Filter = options.problem(model, self.experiments, sigmas)
        self.names = tuple(self.problem.parameters)
        self.values = np.array([values[name] for name in self.names])
        self.path = self.problem.start(np.concatenate([x.T.ravel() for x in states]))

    def theta(self, values: _Array) -> _Array:
        """Numbers as the core takes them: of sigmas their inverses."""
        theta = values.copy()
        for i in range(len(self.model.parameter_names), theta.size - len(self.options.states)):
            theta[i] = 1.0 / theta[i]
        return theta

    def outputs(self, values: _Array) -> list[tuple[_Array, _Array]]:
        """Of the smoothed path of each experiment, with the standard deviations that they have for numbers known: each
        (n_y, N); nothing where there is no path."""
        found = self.problem.smooth(self.theta(values), self.path)
        return [] if found is None else [pairs[1] for pairs, *_ in found]

    def errors(self, covariance: _Array, e: int) -> _Array:
        """(n_y, N) standard errors of the outputs in one experiment: what the smoother leaves open, and what comes of
        the numbers' errors with that ``covariance`` (n, n), to first order. NaN where there is no path."""
        path = self.outputs(self.values)
        shape = (len(self.model.output_names), self.experiments[e].n)
        if not path:
            return np.full(shape, np.nan)
        slopes = np.zeros((self.values.size, *shape))
        for i, error in enumerate(np.sqrt(np.maximum(np.diag(covariance), 0.0))):
            if error > 0.0:
                slopes[i] = self._slope(i, _PART * error, e)
        variance = path[e][1] ** 2 + np.einsum("iyt,ij,jyt->yt", slopes, covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def _slope(self, i: int, size: float, e: int) -> _Array:
        """Central differences of the outputs."""
        if i >= len(self.model.parameter_names):  # noise is positive
            size = min(size, 0.5 * abs(self.values[i]))
        ends = []
        for sign in (1, -1):
            there = self.values.copy()
            there[i] += sign * size
            ends.append(self.outputs(there))
        if not (ends[0] and ends[1]):
            return np.full((len(self.model.output_names), self.experiments[e].n), np.nan)
        return (ends[0][e][0] - ends[1][e][0]) / (2.0 * size)


def of_fit(fit: FitResult) -> tuple[Filtered, _Array]:
    """That of a fit itself, and the covariance of its numbers: 0 for those that are known or at a bound."""
    model, experiments, covariance = fit.model, list(dataset(fit)), np.nan_to_num(fit.covariance)
    states = [np.array([r.states[name] for name in model.state_names]) for r in fit.records]
    if len(experiments) > 1 and any(p.per_experiment for p in model.declared_parameters.values()):
        apart = Separated(model, experiments)
        model, experiments, fit = apart.model, apart.experiments, apart.fit(fit)
    options = fit.transcription
    assert isinstance(options, FilterError)
    known = fit.noise.known_sigmas(model.output_names)
    found = Filtered(model, experiments, options, fit.parameters.to_dict(), known, states)
    at = [list(fit.parameters).index(name) for name in found.names]
    return found, covariance[np.ix_(at, at)]
