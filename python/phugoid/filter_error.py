"""The options of the filter-error method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import phugoid._core as _core

from .data.experiment import Experiment
from .errors import OptionError, check_time_limit, did_you_mean, whole
from .modelling.model import Model
from .transcription import records_of

__all__ = [
    "FEWEST",
    "FilterError",
]


# Runge-Kutta steps between samples, and terms of the noise there, to begin with.
FEWEST = (1, 2)
# Number of pairs of these to choose from.
_MESHES = 4


@dataclass(frozen=True)
class FilterError:
    """The filter-error method: output error with process noise, such as turbulence.

    White noise drives the ``states`` (one name or several), independently and with unknown intensity:
    dx = f dt + q dW, so that ``q_<state>`` has the state's unit over √s. The others obey their equations exactly. The
    marginal likelihood of all parameters is maximised, with the states integrated out: as by a Kalman filter where the
    model is linear in its states, by the Laplace approximation elsewhere.

    Between two samples the noise is a sum of ``terms`` orthonormal polynomials for each state; two of them already
    describe its effect on the other states over the interval. The equations are integrated with it in ``substeps``
    Runge-Kutta steps (order 4). None: 2 terms and 1 step at first, then more until a further refinement would move no
    estimate by a tenth of its standard error; `Fit.transcription` holds the final numbers. Given numbers are kept.

    ``output_error``: True starts from the fit of an ordinary `estimate` (``start=fit`` does so with an existing one).
    False does so only where the estimation from the start values does not converge.

    ``initial``: prior knowledge of initial states, by state: (mean, standard deviation). A state that is not named has
    a flat prior of density 1. Initial states with either prior are integrated out. None: the initial state is a
    parameter, as in the output-error method, and the likelihood with q = 0 is that of output error; but where process
    noise can explain an output by itself, this likelihood grows without bound as its sigma goes to 0. Likelihoods with
    different ``initial`` cannot be compared.

    ``time_limit``: in seconds, for the whole estimation; the best point so far is the result, with status "time limit".
    Results that were not computed are missing, with a warning: standard errors, innovations and deviations of states
    are NaN; where not even the start was evaluated, the log-likelihood is NaN as well, and the fit is not ``feasible``.

    ``intensities``: known intensities by state, q in the unit above; 0 is not noise. Those not named are estimated.

    R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd edition (AIAA, 2015), chapter 5.

    Raises OptionError for invalid arguments.
    """

    states: Sequence[str]
    substeps: int | None = None
    terms: int | None = None
    initial: Mapping[str, tuple[float, float] | None] | None = None
    output_error: bool = False
    max_iterations: int = 200
    intensities: Mapping[str, float] | None = None
    time_limit: float | None = None

    def __post_init__(self) -> None:
        names = (self.states,) if isinstance(self.states, str) else self.states
        if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) for n in names):
            raise OptionError(f"FilterError: states names the states with process noise, not {self.states!r}")
        for name, chosen in (("substeps", True), ("terms", True), ("max_iterations", False)):
            value = getattr(self, name)
            if chosen and value is None:
                continue
            whole(f"FilterError: {name}", value, 1)
        check_time_limit("FilterError", self.time_limit)
        if not isinstance(self.output_error, bool):
            raise OptionError(f"FilterError: output_error is True or False, not {self.output_error!r}")
        if self.initial is not None and not isinstance(self.initial, Mapping):
            raise OptionError(f"FilterError: initial maps states to (mean, std), not {self.initial!r}")
        initial = {name: _prior(name, value) for name, value in (self.initial or {}).items()}
        if self.intensities is not None and not isinstance(self.intensities, Mapping):
            raise OptionError(f"FilterError: intensities are given by state, not as {self.intensities!r}")
        known = {name: _known(name, value, names) for name, value in (self.intensities or {}).items()}
        object.__setattr__(self, "states", tuple(names))
        object.__setattr__(self, "intensities", known or None)
        object.__setattr__(self, "initial", initial)

    def problem(
        self, model: Model, experiments: Sequence[Experiment], sigmas: list[tuple[bool, float, float, float]]
    ) -> _core.Filter:
        """Return the marginal likelihood. Raises OptionError for names that are not states."""
        initial = self.initial or {}
        for name in (*self.states, *initial):
            if name not in model.state_names:
                raise OptionError(f"FilterError: '{name}' is not a state.{did_you_mean(name, model.state_names)}")
        for name in self.states:
            if f"q_{name}" in model.parameter_names:
                raise OptionError(
                    f"FilterError: the intensity of state '{name}' is called 'q_{name}', as is a parameter of the "
                    "model: rename the parameter"
                )
        records = records_of(model, experiments)
        priors = [initial.get(name, (0.0, math.inf)) for name in model.state_names]
        steps, terms = self.mesh
        return _core.Filter(model._core, records, sigmas, list(self.states), steps, terms, priors)

    @property
    def mesh(self) -> tuple[int, int]:
        """Numbers of steps and terms; the fewest where they are to be chosen."""
        return int(self.substeps or FEWEST[0]), int(self.terms or FEWEST[1])

    def meshes(self) -> list[FilterError]:
        """Return the options with increasing numbers of steps and terms; only one where both are given."""
        steps, terms = self.mesh
        found = [replace(self, substeps=steps, terms=terms)]
        while (self.substeps is None or self.terms is None) and len(found) < _MESHES:
            steps, terms = steps * (1 + (self.substeps is None)), terms + (self.terms is None)
            found.append(replace(self, substeps=steps, terms=terms))
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the options as JSON takes them."""
        initial = {name: list(pair) if pair else None for name, pair in (self.initial or {}).items()}
        saved = {name: value for name, value in vars(self).items() if name != "time_limit"}
        return {**saved, "states": list(self.states), "initial": initial}

    def __str__(self) -> str:
        steps, terms = self.mesh
        text = f"filter error, process noise in {', '.join(self.states)}"
        if (steps, terms) != FEWEST:
            text += f", of {terms} term{'s' * (terms > 1)} and {steps} step{'s' * (steps > 1)} between samples"
        return text


def _prior(name: str, value: Any) -> tuple[float, float] | None:
    if value is None:
        return None
    try:
        mean, std = map(float, value)
    except (TypeError, ValueError):
        mean = std = math.nan
    if not (math.isfinite(mean) and 0 < std < math.inf):
        raise OptionError(
            f"FilterError: initial '{name}' is a mean and a positive standard deviation, or None, not {value!r}"
        )
    return mean, std


def _known(name: str, value: Any, states: Sequence[str]) -> float:
    if name not in states:
        raise OptionError(f"FilterError: intensity of '{name}', which is none of states={tuple(states)!r}")
    try:
        q = float(value)
    except (TypeError, ValueError):
        q = math.nan
    if not 0 <= q < math.inf:
        raise OptionError(f"FilterError: the intensity of '{name}' is a number from 0, not {value!r}")
    return q
