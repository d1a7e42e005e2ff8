"""Standard errors of what the data determine although they do not determine the parameters that it is made of."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import EvaluationError
from ..fit_result import FitResult
from ..guess import spread
from ..modelling.model import Model
from ..modelling.rebuilt import rebuilt
from ..transcription.filter_error import FilterError

__all__ = ["Uncertainty"]

_Array: TypeAlias = NDArray[np.float64]

# Two variances are the same when they differ by less than this part.
_SAME = 0.01
# Standard deviations of the priors that settle trades, in sizes of the parameters; a parameter near 0 has at least this
# part of the size of all.
_WIDTHS, _LEAST = (1.0, 10.0), 0.1


class Uncertainty:
    """Covariances of functions of a fit's parameters, by the delta method.

    Where some parameters trade off (a scale that may go into b or c), the fit has no covariance of them, and yet what
    does not depend on how they trade (the transfer function) has one. Such parameters get wide priors about their
    estimates: these settle the trade, and add next to nothing to what the data say. Whether a function depends on the
    trade shows when the priors are made wider: its variance grows too, and is reported as NaN.
    """

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        noise = fit.noise_parameters
        self.names = [name for name in fit.parameters if name not in noise]
        self._places = [k for k, name in enumerate(fit.parameters) if name not in noise]
        # What is held has no error of its own.
        self._held = np.array([fit.parameters[n].fixed or bool(fit.parameters[n].bounds_active) for n in self.names])
        self._settled: list[_Array] | None = None

    def covariance(self, gradients: _Array) -> _Array:
        """(k, k) of k functions with these derivatives (k, n) by the parameters ``names``; NaN where not determined."""
        g = np.where(self._held, 0.0, gradients)
        own = self.fit.covariance[np.ix_(self._places, self._places)]
        used = np.any(g != 0.0, axis=0)
        if np.isfinite(own[np.ix_(used, used)]).all():
            return np.asarray(g[:, used] @ own[np.ix_(used, used)] @ g[:, used].T)
        if self._settled is None:
            self._settled = self._settle()
        if not self._settled:
            return np.full((len(g), len(g)), np.nan)
        narrow, wide = (g @ covariance @ g.T for covariance in self._settled)
        same = np.abs(np.diag(wide) - np.diag(narrow)) <= _SAME * np.diag(wide)
        return np.where(np.outer(same, same), wide, np.nan)

    def _settle(self) -> list[_Array]:
        """Covariances (n, n) with narrower and wider priors where there are none; [] where that cannot be done."""
        fit = self.fit
        if isinstance(fit.transcription, FilterError) or fit.solution is None or not fit.experiments or fit._moved:
            return []
        names = fit.model.output_names
        spreads = {name: spread(fit.experiments, name) for name in names}
        noise = fit.noise.resolve(names, spreads, fit.as_start(fit.noise))
        xi, multipliers = fit.solution.xi, fit.solution.multipliers
        found = []
        for width in _WIDTHS:
            problem = fit.transcription.problem(self._with_priors(width), fit.experiments, noise)
            if (xi.size, multipliers.size) != (problem.n, problem.m):
                return []
            labels = [name for name, *_ in problem.estimands]
            free = [i for i, label in enumerate(labels) if not self._held[self.names.index(label)]]
            held = [i for i in range(len(labels)) if i not in free]
            try:
                answer = _core.information(problem, xi, multipliers, free, held)
            except EvaluationError:
                return []
            slopes = np.array([slope for _, slope in problem.values(xi[: len(labels)].tolist())])[free]
            places = [self.names.index(labels[i]) for i in free]
            covariance = np.zeros((len(self.names), len(self.names)))
            covariance[np.ix_(places, places)] = np.asarray(answer[0]) * np.outer(slopes, slopes)
            found.append(covariance)
        return found

    def _with_priors(self, width: float) -> Model:
        """The model with priors on parameters that the data leave open, so many times as wide as these are large."""
        fit = self.fit
        variance = np.diag(fit.covariance)[self._places]
        without = [n for n, v, h in zip(self.names, variance, self._held, strict=True) if not h and not v > 0.0]
        loose = {label.partition("[")[0]: fit.parameters[label].value for label in without}
        typical = float(np.sqrt(np.mean(np.square(list(loose.values())))))

        def declare(core: _core.Model, declared: Any) -> None:
            name, unit, start, low, high, prior, *others = declared
            if name in loose and prior is None:
                prior = (loose[name], width * (abs(loose[name]) + _LEAST * typical or 1.0))
            core.parameter(name, unit, start, low, high, prior, *others)

        return fit.model._around(rebuilt(fit.model._core, fit.model._core.inputs, declare), fit.model.delays)
