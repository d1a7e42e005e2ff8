"""A random disturbance at a place of a model by the filter-error method, white or through a shaping filter.

A random time history about a fit is linear in what it does. Where gusts move the vehicle far from the path that the
model simulates without them, and bias its parameters, that is no approximation: the filter-error method follows the
measured path. Gusts are not white: w' = -w / tau + q n with white noise n is added to an equation, to an input, or to a
state as the forces have it (Jategaonkar 2015, ch. 5; Dryden's spectra begin so).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._core import Expr
from ...data.experiment import Experiment
from ...errors import PhugoidError
from ...estimation import estimate
from ...filter_error import FilterError
from ...fit_result import FitResult, dataset
from ...frozen_model import freeze_model, freeze_noise
from ...modelling.model import Model
from ...parameters import Parameter
from ...sensitivities.trajectory import Place
from ...solvers.solution import Deadline, check_time
from ..candidates.candidate import unused
from .disturbance import Disturbance
from .refit import Refit

__all__ = ["FilterErrorRefit", "filtered", "filtered_elsewhere", "through_shaping_filter"]

# Correlation times from the start value on, in times of it; white noise is begun as noise of so many knots.
_SHORTER, _LONGER, _BEGUN = 0.1, 30.0, 2.0
# Log-likelihood by which the filter-error method is beyond a linearisation, and by which that is far behind.
_BETTER, _FAR = 8.0, 200.0


@dataclass(frozen=True, eq=False)
class FilterErrorRefit:
    """A fit by the filter-error method.

    fit       its parameters have the intensity of the noise, ``q_<state>``.
    state     that white noise drives: one of the model, or that of the shaping filter.
    tau       name of the correlation time; "" without a shaping filter.
    """

    fit: FitResult
    state: str
    tau: str = ""

    @property
    def merit(self) -> float:
        """Log-likelihood less the number of parameters of the disturbance (Akaike)."""
        return self.fit.log_likelihood - (2.0 if self.tau else 1.0)

    @property
    def intensity(self) -> tuple[float, float]:
        """Standard deviation of what is added, or q of white noise; and its standard error."""
        q = self.fit.parameters[f"q_{self.state}"]
        if not self.tau:
            return q.value, q.std_error
        tau = self.fit.parameters[self.tau]
        size = q.value * float(np.sqrt(tau.value / 2.0))
        # A size that is q sqrt(tau / 2) is known better than either: their estimates go together.
        names = list(self.fit.parameters)
        at = [names.index(e.name) for e in (q, tau)]
        slopes = size * np.array([1.0 / q.value, 0.5 / tau.value])
        return size, float(np.sqrt(slopes @ self.fit.covariance[np.ix_(at, at)] @ slopes))

    @property
    def correlation(self) -> float:
        """Correlation time, s; 0 of white noise."""
        return self.fit.parameters[self.tau].value if self.tau else 0.0


def through_shaping_filter(model: Model, place: Place, tau: float) -> tuple[Model, str, str]:
    """Return the model with a first-order shaping filter whose state is added to a place; the names of that state and
    of its correlation time, which starts at ``tau``, s."""
    taken = {*model.state_names, *model.declared_inputs, *model.parameter_names, *model.quantity_names}
    state, time = unused(f"{place.name}_gust", taken), unused(f"tau_{place.name}_gust", taken)
    equations, x, w = model._right_hand_sides(), Expr.symbol(place.name), Expr.symbol(state)
    if place.kind == "equation":
        equations["equation", place.name] = Expr(equations["equation", place.name] + w)
    else:
        of_forces = any(kind == "quantity" and place.name in e.symbols for (kind, _), e in equations.items())
        for key, e in list(equations.items()):
            acts = place.kind == "input" or key[0] == "quantity" or (key[0] == "equation" and not of_forces and e != x)
            if acts and place.name in e.symbols:
                equations[key] = Expr(e.substitute({place.name: x + w}))
    declared = Parameter(tau, bounds=(_SHORTER * tau, _LONGER * tau), unit="s", transform="log")
    shaped = model._changed(
        parameters={time: declared},
        equations=equations,
        states={state: ("", Expr(-w / Expr.symbol(time)), None)},
    )
    return shaped, state, time


def filtered(at: Refit, of: Disturbance, seconds: float) -> FilterErrorRefit | None:
    """Return the fit by the filter-error method with a disturbance at the place of one; None where it fails.

    White noise of an equation is tried where the disturbance is white, and a shaping filter where that is not likelier
    than coloured noise of the sensors. First states are parameters, so that without noise the likelihood is that of
    output error.
    """
    check_time()
    model, fit = at.fit.model, at.fit
    if model.delays or any(p.per_experiment for p in model.declared_parameters.values()):
        return None
    initial: dict[str, tuple[float, float] | None] = dict.fromkeys(model.state_names)
    white: FilterErrorRefit | None = None
    if of.place.kind == "equation" and not of.correlation:
        method = FilterError(of.place.name, initial=initial, time_limit=seconds)
        found = _estimated(model, dataset(fit), method, fit, fit, seconds)
        white = FilterErrorRefit(found, of.place.name) if found is not None else None
        # Far behind, and no likelier than the linearisation: that has tried coloured histories as well.
        hopeless = white is not None and white.merit < of.merit + _BETTER and of.merit < at.merit - _FAR
        if white is not None and (white.merit > at.merit or hopeless):
            return white
    tau = of.correlation or _BEGUN * of.step
    size = float(np.sqrt(np.mean(of.values**2)))
    shaped, state, time = through_shaping_filter(model, of.place, tau)
    if not size > 0.0:
        return white
    method = FilterError(state, initial={**initial, state: (0.0, size)}, time_limit=seconds)
    start = {**fit.as_start(fit.noise), f"q_{state}": size * float(np.sqrt(2.0 / tau))}
    found = _estimated(shaped, dataset(fit), method, fit, start, seconds)
    coloured = FilterErrorRefit(found, state, time) if found is not None else None
    return max((f for f in (white, coloured) if f is not None), key=lambda f: f.merit, default=None)


def filtered_elsewhere(of: FilterErrorRefit, data: Sequence[Experiment], free: Sequence[str], seconds: float) -> float:
    """Return the log-likelihood of other records with the model and the disturbance as fitted, but for first states and
    ``free`` parameters; NaN where there is no such fit."""
    fit, name = of.fit, f"q_{of.state}"
    values = {n: e.value for n, e in fit.parameters.items()}
    model, known = freeze_model(fit.model, values, free), {of.state: values[name]}
    initial: dict[str, tuple[float, float] | None] = dict.fromkeys(model.state_names)
    if of.tau:
        initial[of.state] = (0.0, of.intensity[0])
    method = FilterError(of.state, initial=initial, intensities=known, time_limit=seconds)
    found = _estimated(model, data, method, fit, None, seconds)
    return found.log_likelihood if found is not None else float("nan")


def _estimated(
    model: Model,
    data: Sequence[Experiment],
    method: FilterError,
    of: FitResult,
    start: FitResult | dict[str, float] | None,
    seconds: float,
) -> FitResult | None:
    """Return an estimation that converged; None else. Of other records than those of a fit its noise is known."""
    noise = of.noise if start is not None else freeze_noise(of)[0]
    try:
        with Deadline(seconds).in_force():
            found = estimate(model, list(data), transcription=method, noise=noise, start=start)
    except (PhugoidError, np.linalg.LinAlgError):
        return None
    return found if found.status == "converged" else None
