"""Estimation while the data arrive: states, parameters and noise after each sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import DataError, ModelError, OptionError, did_you_mean, finite, is_whole, positive
from ..modelling.model import Model
from ..modelling.noise import Gaussian
from .estimate import OnlineEstimate, estimate_of
from .history import OnlineHistory

__all__ = ["Detect", "Online"]

_Array = NDArray[np.float64]
_INTEGRATORS = ("euler", "heun", "kutta", "rk4", "dopri5")


@dataclass(frozen=True)
class Detect:
    """A running test whether the model still holds, and what has changed where it does not.

    It is the Shiryaev-Roberts test of the normalised innovations, for shifts of the mean and larger variances of each
    output, and for steps of the watched parameters (likelihood ratios after Willsky and Jones, 1976).

    ``mean_samples``: mean number of samples between two false alarms, at least; at f Hz an hour has 3600 f.
    ``after``: time from the first sample until the test begins, in s; choose it so that the estimates have left their
    start values. ``watch``: parameters that may change. ``onsets``: possible onsets of a change that are followed
    side by side, ``spacing``: samples between two of them.
    ``change``: standard deviation of a change, relative to the parameter.
    """

    mean_samples: float
    after: float = 0.0
    watch: Sequence[str] = ()
    onsets: int = 20
    spacing: int = 5
    change: float = 0.5


class Online:
    """An estimator that takes one sample after the other.

    It estimates the states and all free parameters of a model. With ``window=1`` it is the iterated extended Kalman
    filter with the parameters as further unknowns (Jategaonkar, Flight Vehicle System Identification, chapter 7),
    with a longer window estimation on a moving horizon (Rao, Rawlings and Mayne, 2003), both in square-root
    information form (Bierman, 1977).

    ``window``: samples whose states are estimated together. ``first_window``: samples at the beginning that are kept
    until there are so many, and estimated together, so that they are not linearised about start values.
    ``iterations``: Gauss-Newton iterations after a sample, at most;
    ``tolerance``: a step that changes the cost by less than its square is the last one. ``sigma``: standard
    deviations of the measurement noise by output, where the model does not declare them; ``estimate_noise``: whether
    they are estimated from there on, as if they came from ``noise_weight`` samples. ``parameter_errors``: standard
    deviations of the start values of parameters; others have that of their prior, or else 10 times the larger of 1
    and their size. ``initial``: initial states, each with its standard deviation; others start at the first sample of
    the output that measures them. ``process_noise``: by state, the standard deviation that a random walk has after 1
    s, in the unit of the state. ``forgetting``: None, or ("exponential", time constant in s) for all old information,
    or ("directional", time constant) in the directions alone in which samples bring new information (Cao and
    Schwartz, 2000). ``interpolation``: inputs between samples, "linear" or "hold". ``integrator``, ``substeps``: the
    Runge-Kutta method and its steps between two samples. ``max_gap``: longest time without a sample, in s; a longer
    one is an error. ``deadline``: time for a sample, in s: no further iteration begins that would take longer.
    ``detect``: a test whether the model still holds.

    Raises OptionError for an option that is out of range or names what the model does not have, ModelError for a
    model that is incomplete.
    """

    def __init__(
        self,
        model: Model,
        *,
        window: int = 1,
        first_window: int = 0,
        iterations: int = 3,
        tolerance: float = 1e-3,
        sigma: Mapping[str, float] | None = None,
        estimate_noise: bool = False,
        noise_weight: float = 20.0,
        parameter_errors: Mapping[str, float] | None = None,
        initial: Mapping[str, tuple[float, float]] | None = None,
        process_noise: Mapping[str, float] | None = None,
        forgetting: tuple[str, float] | None = None,
        interpolation: str = "linear",
        integrator: str = "rk4",
        substeps: int = 1,
        max_gap: float = float("inf"),
        deadline: float | None = None,
        detect: Detect | None = None,
    ) -> None:
        if not isinstance(model, Model):
            raise ModelError(f"Online: the first argument is a Model, not a {type(model).__name__}")
        model.check()
        for name, count in {"window": window, "iterations": iterations, "substeps": substeps}.items():
            if not is_whole(count) or count < 1:
                raise OptionError(f"Online: {name} is a whole number from 1, not {count!r}")
        if forgetting is not None and forgetting[0] not in ("exponential", "directional"):
            raise OptionError(f'Online: forgetting is "exponential" or "directional", not {forgetting[0]!r}')
        if interpolation not in ("linear", "hold"):
            raise OptionError(f'Online: interpolation is "linear" or "hold", not {interpolation!r}')
        if integrator not in _INTEGRATORS:
            raise OptionError(f"Online: integrator is one of {', '.join(_INTEGRATORS)}, not {integrator!r}")
        self._model = model
        self._inputs, self._outputs = list(model.input_names), list(model.output_names)
        self._core = _core.Online(
            model._core,
            model.delays.spec,
            (window, int(first_window), iterations, substeps),
            (float(tolerance), float(noise_weight), float(max_gap)),
            list(_sigmas(model, sigma or {}).items()),
            bool(estimate_noise),
            [
                (n, finite(f"Online: parameter_errors of '{n}'", v, OptionError))
                for n, v in (parameter_errors or {}).items()
            ],
            [(n, float(value), float(error)) for n, (value, error) in (initial or {}).items()],
            [(n, finite(f"Online: process_noise of '{n}'", v, OptionError)) for n, v in (process_noise or {}).items()],
            None if forgetting is None else (forgetting[0], float(forgetting[1])),
            (interpolation, integrator),
            None if deadline is None else positive("Online: deadline", deadline),
            None
            if detect is None
            else (
                float(detect.mean_samples),
                float(detect.after),
                list(detect.watch),
                int(detect.onsets),
                int(detect.spacing),
                float(detect.change),
            ),
        )

    @property
    def estimate(self) -> OnlineEstimate:
        """The estimate after the last sample; start values before the first."""
        states, parameters = list(self._model.state_names), list(self._model.parameter_names)
        return estimate_of(self._core.estimate(), states, parameters, self._outputs)

    def push(self, t: float, inputs: Mapping[str, float] | ArrayLike, outputs: Mapping[str, float] | ArrayLike) -> None:
        """Take a sample: its time in s, inputs and measured outputs.

        ``inputs`` and ``outputs`` are values by name, or arrays (n_u,) and (n_y,) in the order of the model, which
        take less time. An output that is NaN, or not among the names, is missing. A sample that is older than the
        latest one and within the window is put in there; its inputs may be NaN. An older one is not used:
        ``estimate.arrival`` then is "too late".

        Raises DataError for wrong names or numbers of values, for values that are not finite, for a time that
        repeats, jumps back or comes after a gap longer than ``max_gap``, EvaluationError where the equations are not
        finite at the estimates. The estimator then is as it was before.
        """
        self._core.push(float(t), self._row(inputs, self._inputs, "input"), self._row(outputs, self._outputs, "output"))

    def run(self, data: Experiment) -> OnlineHistory:
        """Take all samples of a record; return the estimates after each of them.

        Raises as `push`.
        """
        if not isinstance(data, Experiment):
            raise DataError(f"Online.run: data is one Experiment, not a {type(data).__name__}")
        data.check_for(self._model.input_names, self._model.output_names, conditions=self._model.condition_names)
        inputs = [data.input(name) for name in self._inputs]
        u = np.ascontiguousarray(np.stack(inputs, axis=1) if inputs else np.empty((data.n, 0)))
        y = np.ascontiguousarray(np.stack([data.output(name) for name in self._outputs], axis=1))
        found: dict[str, Any] = self._core.run(np.ascontiguousarray(data.t), u, y)

        def named(key: str, names: Sequence[str]) -> dict[str, _Array]:
            return {name: found[key][:, k] for k, name in enumerate(names)}

        states, parameters = self._model.state_names, self._model.parameter_names
        return OnlineHistory(
            name=data.name,
            t=data.t,
            states=named("states", states),
            state_errors=named("state_errors", states),
            parameters=named("parameters", parameters),
            parameter_errors=named("parameter_errors", parameters),
            sigma=named("sigma", self._outputs),
            innovations=named("innovations", self._outputs),
            innovation_errors=named("innovation_errors", self._outputs),
            normalised=named("normalised", self._outputs),
            iterations=found["iterations"],
            alarm=self.estimate.alarm,
        )

    def restart(self) -> None:
        """End the record: what follows is a new one, with new states and the same parameters, on which all
        information is kept."""
        self._core.restart()

    def acknowledge(self) -> None:
        """Forget the evidence of the detector, and its alarm."""
        self._core.acknowledge()

    @property
    def work(self) -> int:
        """Floating-point operations of `push`, at most."""
        return self._core.work()

    def _row(self, values: Mapping[str, float] | ArrayLike, names: list[str], kind: str) -> _Array:
        if isinstance(values, Mapping):
            for name in values:
                if name not in names:
                    raise DataError(f"Online: the model has no {kind} '{name}'.{did_you_mean(str(name), names)}")
            missing = [name for name in names if name not in values]
            if kind == "input" and missing:
                raise DataError(f"Online: there is no value of input '{missing[0]}'")
            values = [values.get(name, float("nan")) for name in names]
        row = np.ascontiguousarray(values, dtype=np.float64)
        if row.shape != (len(names),):
            raise DataError(
                f"Online: {kind}s have the shape {row.shape}, the model has {len(names)}: {', '.join(names)}"
            )
        return row


def _sigmas(model: Model, given: Mapping[str, float]) -> dict[str, float]:
    """Return standard deviations of the noise: those given, and those that the model declares."""
    noise = model.noise_model
    if not isinstance(noise, Gaussian) or noise.correlated:
        raise OptionError("Online: the noise of the model must be Gaussian and independent")
    for name in given:
        if name not in model.output_names:
            raise OptionError(
                f"Online: sigma: the model has no output '{name}'.{did_you_mean(name, model.output_names)}"
            )
    found: dict[str, float] = {}
    for name in model.output_names:
        value: Any = given[name] if name in given else noise.sigma.get(name)
        value = getattr(value, "start", value)
        if value is None:
            raise OptionError(
                f"Online: give the standard deviation of the noise of output '{name}': sigma={{{name!r}: ...}}"
            )
        found[name] = positive(f"Online: sigma of '{name}'", value)
    return found
