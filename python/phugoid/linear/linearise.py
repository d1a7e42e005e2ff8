"""Models made linear: state-space matrices at a point, and frequency responses with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import ModelError, listing
from ..fit_result import FitResult
from ..modelling.model import Model
from .gauge import Uncertainty
from .jacobians import Jacobians
from .response import FrequencyResponse
from .state_space import StateSpace, only, response_of

__all__ = ["labels_of", "linearise", "model_response", "numbers_of"]

_Array: TypeAlias = NDArray[np.float64]


def linearise(
    fit: FitResult | Model,
    parameters: Mapping[str, Any] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> StateSpace:
    """A model about a point: x' = A x + B u, y = C x + D u of the differences from it. Derivatives are exact.

    ``parameters``  values by name of a model; of a fit instead of its own.
    ``at``          states, inputs and time at the point, by name: of a model that is not linear all that its
                    derivatives depend on. That the point is an equilibrium is up to you: `trim` finds one.
    ``experiment``  whose parameters to take, where experiments have their own.

    Raises ModelError for names that are not there, values that are missing, and models with delays, which no state
    space holds; EvaluationError where a derivative is not finite.
    """
    model, values = numbers_of("linearise", fit, parameters, experiment)
    if model.delays:
        raise ModelError(
            "linearise: the model has delays, which no finite state space holds; its frequency response and modes exist"
        )
    jacobians = Jacobians(model, "linearise")
    numbers = jacobians.point(values, at)
    A, B, C, D = (jacobians.matrix(block, numbers) for block in "ABCD")
    return StateSpace(A, B, C, D, inputs=jacobians.inputs, outputs=jacobians.outputs, states=jacobians.states)


def model_response(
    fit: FitResult | Model | StateSpace,
    frequencies_hz: ArrayLike,
    input: str | None = None,
    output: str | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> FrequencyResponse:
    """The frequency response of a fit, a model or a `StateSpace`: C (j 2 pi f - A)^-1 B + D, with its delays.

    ``frequencies_hz``  (F,) in Hz.
    ``input``, ``output``  names; may be left out where there is only one.
    ``parameters``, ``at``, ``experiment``  as in `linearise`.

    Of a fit with its own parameters ``std_error`` is that of the magnitude, to first order from the covariance of the
    parameters (the delta method); NaN where the data do not determine the response.

    Raises ModelError and EvaluationError as `linearise` does, and where a frequency meets an undamped mode.
    """
    if isinstance(fit, StateSpace):
        return fit.frequency_response(frequencies_hz, input, output)
    model, values = numbers_of("frequency_response", fit, parameters, experiment)
    u = only("frequency_response", "input", input, model.input_names)
    y = only("frequency_response", "output", output, model.output_names)
    frequencies = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    found = FrequencyResponse(frequencies, np.zeros(frequencies.size, dtype=np.complex128), u, y)  # checks frequencies
    jacobians = Jacobians(model, "frequency_response")
    numbers = jacobians.point(values, at)
    transfer = _Transfer(jacobians, numbers, frequencies, u, y)
    error = None
    if isinstance(fit, FitResult) and parameters is None:
        uncertainty = Uncertainty(fit)
        labels = labels_of("frequency_response", fit, experiment)
        gradients = np.zeros((frequencies.size, len(uncertainty.names)))
        size = np.abs(transfer.response)
        away = np.where(size > 0.0, size, 1.0)
        for name in {*jacobians.parameters, *model.delays.parameters}:
            d = transfer.slope(name)
            gradients[:, uncertainty.names.index(labels[name])] = (transfer.response.conj() * d).real / away
        variance = np.array([uncertainty.covariance(g[None])[0, 0] for g in gradients])
        error = np.sqrt(variance)
    units = model.units
    unit = f"{units[y]}/{units[u]}" if y in units and u in units else ""
    return FrequencyResponse(found.frequencies_hz, transfer.response, u, y, model.name, None, error, unit)


class _Transfer:
    """The response of an output to an input, late ones among them, and its derivatives by parameters; each (F,)."""

    def __init__(
        self, jacobians: Jacobians, numbers: Mapping[str, float], frequencies_hz: _Array, input: str, output: str
    ) -> None:
        self.jacobians, self.numbers = jacobians, numbers
        self.i = jacobians.outputs.index(output)
        delays = jacobians.model.delays
        s = 2j * np.pi * frequencies_hz
        # (F, m): by how much each input, that asked for and those that are it late, moves with it.
        self.push = np.zeros((s.size, len(jacobians.inputs)), dtype=np.complex128)
        self.push_slopes: dict[str, Any] = {}
        for k, name in enumerate(jacobians.inputs):
            if name == input:
                self.push[:, k] = 1.0
            elif delays.inputs.get(name, ("", ""))[0] == input:
                tau = delays.inputs[name][1]
                self.push[:, k] = np.exp(-s * numbers[tau])
                self.push_slopes.setdefault(tau, np.zeros_like(self.push))[:, k] = -s * self.push[:, k]
        self.late = np.exp(-s * numbers[delays.outputs[output]]) if output in delays.outputs else np.ones_like(s)
        self.sensor = delays.outputs.get(output)
        A, B, C, D = (jacobians.matrix(block, numbers) for block in "ABCD")
        n = A.shape[0]
        c, self.d = C[self.i : self.i + 1], D[self.i]
        b = self.push @ B.T  # (F, n)
        self.s = s
        # x = (s - A)^-1 b, and of the output y = c (s - A)^-1.
        self.x = response_of(A, b[:, :, None], np.eye(n), 0.0, frequencies_hz)[:, :, 0]
        self.y = response_of(A.T, c.T, np.eye(n), 0.0, frequencies_hz)[:, :, 0]
        self.B = B
        self.now = self.x @ c[0] + self.push @ self.d
        self.response = self.late * self.now

    def slope(self, parameter: str) -> NDArray[np.complex128]:
        """d response / d parameter: y dA x + dc x + y dB + dD, and what a delay does."""
        found = np.zeros_like(self.s)
        slopes = self.jacobians.slopes(parameter, self.numbers)
        for (i, j), value in slopes["A"]:
            found += value * self.y[:, i] * self.x[:, j]
        for (i, j), value in slopes["B"]:
            found += value * self.y[:, i] * self.push[:, j]
        for (i, j), value in slopes["C"]:
            found += value * self.x[:, j] * (i == self.i)
        for (i, j), value in slopes["D"]:
            found += value * self.push[:, j] * (i == self.i)
        if parameter in self.push_slopes:
            moved = self.push_slopes[parameter]
            found += np.sum(self.y * (moved @ self.B.T), axis=1) + moved @ self.d
        if parameter == self.sensor:
            found -= self.s * self.now
        return np.asarray(self.late * found)


def numbers_of(
    caller: str, fit: Any, parameters: Mapping[str, Any] | None, experiment: str | None
) -> tuple[Model, dict[str, float]]:
    """The model, and values of its parameters. ModelError where one is missing or unknown."""
    if isinstance(fit, FitResult):
        model = fit.model
        estimates = fit.parameters.to_dict()
        values = {name: estimates[label] for name, label in labels_of(caller, fit, experiment).items()}
    elif isinstance(fit, Model):
        model, values = fit, {}
        model.check()
        if parameters is None and model.parameter_names:
            raise ModelError(f"{caller}: a model needs parameters={{...}}, values by name; or give a fit")
    else:
        raise ModelError(f"{caller}: the first argument is a Fit or a Model, not a {type(fit).__name__}")
    for name, value in (parameters or {}).items():
        label = str(name)
        if label not in model.parameter_names:
            if label.startswith("sigma_"):  # of the noise, as Estimates.to_dict() has it
                continue
            raise ModelError(f"{caller}: '{name}' is no parameter.{listing(label, model.parameter_names)}")
        try:
            values[label] = float(value)
        except (TypeError, ValueError):
            values[label] = float("nan")
        if not np.isfinite(values[label]):
            raise ModelError(f"{caller}: parameter '{name}' is {value!r}, not a finite number")
    missing = [name for name in model.parameter_names if name not in values]
    if missing:
        raise ModelError(f"{caller}: no value was given for {', '.join(missing)}")
    return model, values


def labels_of(caller: str, fit: FitResult, experiment: str | None) -> dict[str, str]:
    """Of each parameter of the model its name among the estimates."""
    there = [record.name for record in fit.records]
    if experiment is not None and experiment not in there:
        raise ModelError(f"{caller}: '{experiment}' is no experiment of the fit.{listing(experiment, there)}")
    found = {}
    for name in fit.model.parameter_names:
        label = f"{name}[{experiment or there[0]}]"
        found[name] = label if label in fit.parameters else name
        if experiment is None and len(there) > 1 and label in fit.parameters and _matters(fit, name):
            raise ModelError(f"{caller}: each experiment has its own {name}: say which, experiment='{there[0]}'")
    return found


def _matters(fit: FitResult, parameter: str) -> bool:
    """Whether derivatives by states or inputs depend on a parameter: a bias does not matter."""
    return parameter in {*Jacobians(fit.model, "").parameters, *fit.model.delays.parameters}
