"""The options of the filter-error method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _core
from .errors import OptionError, did_you_mean
from .experiment import Experiment, Signal
from .model import Model

__all__ = ["FilterError"]


@dataclass(frozen=True)
class FilterError:
    """The filter-error method: output error with process noise, such as turbulence.

    White noise drives the ``states`` (one name or several), independently and with unknown intensity:
    x(k+1) = Phi(x(k)) + w(k), w ~ N(0, q**2 h) over the interval h between two samples, so that ``q_<state>`` has the
    state's unit over √s. The others obey their equations exactly. The marginal likelihood of all parameters is
    maximised, with the states integrated out: as by a Kalman filter where the model is linear in its states, by the
    Laplace approximation elsewhere.

    ``substeps``: Runge-Kutta steps (order 4) between samples. ``parts``: 0 has the noise enter at the samples, as in
    the formula; n from 1 has it enter in the middle of each of n equal parts of every interval, which comes closer to
    noise that never stops, at 2n times the cost: take 1 where states move much between two samples (``substeps`` then
    divide half a part). ``output_error``: True starts from the fit of an ordinary `estimate` (``start=fit`` does so
    with one that is there already).

    ``initial``: what is known of first states. (mean, standard deviation): that. Not named: nothing, a flat prior of
    density 1. Either is integrated out. None: it is a parameter, as in the output-error method, and the likelihood with
    q = 0 is that of output error; but where process noise can explain an output by itself, this likelihood grows
    without bound as its sigma goes to 0. Likelihoods with different ``initial`` cannot be compared.

    ``intensities``: known ones by state, q in the unit above; 0 is no noise. Those not named are estimated.

    R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd edition (AIAA, 2015), chapter 5.

    Raises OptionError for what cannot be right.
    """

    states: Sequence[str]
    substeps: int = 1
    parts: int = 0
    initial: Mapping[str, tuple[float, float] | None] | None = None
    output_error: bool = False
    max_iterations: int = 200
    intensities: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        names = (self.states,) if isinstance(self.states, str) else self.states
        if not isinstance(names, Sequence) or not names or not all(isinstance(n, str) for n in names):
            raise OptionError(f"FilterError: states names the states with process noise, not {self.states!r}")
        for name, least in (("substeps", 1), ("parts", 0), ("max_iterations", 1)):
            value = getattr(self, name)
            if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
                raise OptionError(f"FilterError: {name} is a whole number from {least}, not {value!r}")
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
        """The marginal likelihood. Raises OptionError for names that are no states."""
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
        records = [self._record(model, e) for e in experiments]
        priors = [initial.get(name, (0.0, math.inf)) for name in model.state_names]
        return _core.Filter(model._core, records, sigmas, list(self.states), int(self.substeps), self.parts > 0, priors)

    @property
    def stride(self) -> int:
        """Intervals between the points of the path that the core takes for each between samples."""
        return max(2 * self.parts, 1)

    def times(self, experiment: Experiment) -> NDArray[np.float64]:
        """The points of the path: the samples, and ends and middles of the parts between them."""
        t, n = experiment.t, self.stride
        shares = np.arange(n) / n
        return np.append((t[:-1, None] + np.diff(t)[:, None] * shares).ravel(), t[-1])

    def _record(self, model: Model, e: Experiment) -> tuple[str, Any, list[Any], list[Any], str, list[Signal | None]]:
        """A record with points between samples, where nothing is measured."""
        t = self.times(e)
        inputs, outputs = (
            [group(n) for n in names] for group, names in ((e.input, model.input_names), (e.output, model.output_names))
        )
        if self.stride > 1:
            inputs = [
                np.array(_core.interpolate(e.interpolation, e.t.tolist(), u.tolist(), t.tolist())) for u in inputs
            ]
            there = [np.full(t.size, np.nan) for _ in outputs]
            for sparse, z in zip(there, outputs, strict=True):
                sparse[:: self.stride] = z
            outputs = there
        return e.name, t, inputs, outputs, e.interpolation, [e.signal(n) for n in model.input_names]

    def to_dict(self) -> dict[str, Any]:
        """As JSON takes it."""
        initial = {name: list(pair) if pair else None for name, pair in (self.initial or {}).items()}
        return {**vars(self), "states": list(self.states), "initial": initial}

    def __str__(self) -> str:
        steps = "" if self.substeps == 1 else f", {self.substeps} steps between samples"
        where = f", in the middle of {self.parts} parts" if self.parts > 1 else ", in the middle" if self.parts else ""
        return f"filter error, process noise in {', '.join(self.states)}{where}{steps}"


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
