"""Models linearised at a point: matrices, frequency responses and modes, with standard errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

import phugoid._core as _core

from ..errors import EvaluationError, ModelError, finite, listing
from ..filter_error import FilterError
from ..fit_result import FitResult
from ..initialisation import spread
from ..modelling.compiled import Jacobians
from ..modelling.model import Model
from .response import FrequencyResponse
from .state_space import Modes, StateSpace, only, response_of, table_of

__all__ = ["labels_of", "linearise", "model_response", "modes", "numbers_of"]

_Array: TypeAlias = NDArray[np.float64]

# Two variances are the same when they differ by less than this part.
_SAME = 0.01
# Standard deviations of the priors on confounded parameters, in sizes of these; a parameter near 0 has at least this
# part of the size of all.
_WIDTHS, _LEAST = (1.0, 10.0), 0.1


class Uncertainty:
    """Covariances of functions of a fit's parameters, by the delta method.

    Where some parameters are confounded (a scale that may go into b or c), the fit has no covariance of them, although
    functions that do not depend on the scale (the transfer function) have one. Such parameters get wide priors about
    their estimates, which make the information regular and add next to nothing to it. A function that does depend on
    the scale is recognised when the priors are made wider: its variance grows too, and is reported as NaN.
    """

    def __init__(self, fit: FitResult) -> None:
        self.fit = fit
        noise = fit.noise_parameters
        self.names = [name for name in fit.parameters if name not in noise]
        self._places = [k for k, name in enumerate(fit.parameters) if name not in noise]
        # Parameters that are fixed or at a bound have no error.
        self._held = np.array([fit.parameters[n].fixed or bool(fit.parameters[n].bounds_active) for n in self.names])
        self._regularised: list[_Array] | None = None

    def covariance(self, gradients: _Array) -> _Array:
        """Return (k, k) of k functions with these derivatives (k, n) by the parameters ``names``; NaN where not
        determined."""
        g = np.where(self._held, 0.0, gradients)
        own = self.fit.covariance[np.ix_(self._places, self._places)]
        used = np.any(g != 0.0, axis=0)
        if np.isfinite(own[np.ix_(used, used)]).all():
            return np.asarray(g[:, used] @ own[np.ix_(used, used)] @ g[:, used].T)
        if self._regularised is None:
            self._regularised = self._regularised_covariances()
        if not self._regularised:
            return np.full((len(g), len(g)), np.nan)
        narrow, wide = (g @ covariance @ g.T for covariance in self._regularised)
        same = np.abs(np.diag(wide) - np.diag(narrow)) <= _SAME * np.diag(wide)
        return np.where(np.outer(same, same), wide, np.nan)

    def _regularised_covariances(self) -> list[_Array]:
        """Return covariances (n, n) with narrower and wider priors on undetermined parameters; [] where that is
        impossible."""
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
        """Return the model with priors on undetermined parameters, ``width`` times as wide as these are large."""
        fit = self.fit
        variance = np.diag(fit.covariance)[self._places]
        without = [n for n, v, h in zip(self.names, variance, self._held, strict=True) if not h and not v > 0.0]
        loose = {label.partition("[")[0]: fit.parameters[label].value for label in without}
        typical = float(np.sqrt(np.mean(np.square(list(loose.values())))))
        declared = fit.model.declared_parameters
        return fit.model.with_parameters(
            {
                name: replace(declared[name], prior=(value, width * (abs(value) + _LEAST * typical or 1.0)))
                for name, value in loose.items()
                if declared[name].prior is None
            }
        )


def linearise(
    fit: FitResult | Model,
    parameters: Mapping[str, Any] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> StateSpace:
    """Linearise a model about a point: x' = A x + B u, y = C x + D u in the deviations from it, with exact derivatives.

    ``parameters``  values by name of a model; of a fit instead of its own.
    ``at``          states, inputs and time at the point, by name: of a model that is not linear all that its
                    derivatives depend on. The point need not be an equilibrium; `trim` finds one.
    ``experiment``  whose parameters to take, where experiments have their own.

    Raises ModelError for unknown names, values that are missing, and models with delays, which no state
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
    return StateSpace(
        A,
        B,
        C,
        D,
        inputs=jacobians.inputs,
        outputs=jacobians.outputs,
        states=jacobians.states,
        time_unit=model.time_unit,
    )


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
    """Return the frequency response of a fit, a model or a `StateSpace`: C (j 2 pi f - A)^-1 B + D, with its delays.

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
    return FrequencyResponse(
        found.frequencies_hz, transfer.response, u, y, model.name, None, error, unit, model.time_unit
    )


class _Transfer:
    """The response of an output to an input, delayed inputs included, and its derivatives by parameters; each (F,)."""

    def __init__(
        self, jacobians: Jacobians, numbers: Mapping[str, float], frequencies_hz: _Array, input: str, output: str
    ) -> None:
        self.jacobians, self.numbers = jacobians, numbers
        self.i = jacobians.outputs.index(output)
        delays = jacobians.model.delays
        s = 2j * np.pi * frequencies_hz
        # (F, m): the response of each input to the one asked for: 1 for itself, exp(-s tau) for its delayed copies.
        self.push = np.zeros((s.size, len(jacobians.inputs)), dtype=np.complex128)
        self.push_slopes: dict[str, Any] = {}
        for k, name in enumerate(jacobians.inputs):
            if name == input:
                self.push[:, k] = 1.0
            elif delays.inputs.get(name, ("", ""))[0] == input:
                tau = delays.inputs[name][1]
                self.push[:, k] = np.exp(-s * numbers[tau])
                self.push_slopes.setdefault(tau, np.zeros_like(self.push))[:, k] = -s * self.push[:, k]
        self.delay_factor = (
            np.exp(-s * numbers[delays.outputs[output]]) if output in delays.outputs else np.ones_like(s)
        )
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
        self.response = self.delay_factor * self.now

    def slope(self, parameter: str) -> NDArray[np.complex128]:
        """Return d response / d parameter: y dA x + dc x + y dB + dD, and the effect of a delay."""
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
        return np.asarray(self.delay_factor * found)


def numbers_of(
    caller: str, fit: FitResult | Model, parameters: Mapping[str, Any] | None, experiment: str | None
) -> tuple[Model, dict[str, float]]:
    """Return the model and the values of its parameters; raise ModelError where one is missing or unknown."""
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
            raise ModelError(f"{caller}: '{name}' is not a parameter.{listing(label, model.parameter_names)}")
        values[label] = finite(f"{caller}: parameter '{name}'", value, ModelError)
    missing = [name for name in model.parameter_names if name not in values]
    if missing:
        raise ModelError(f"{caller}: no value was given for {', '.join(missing)}")
    return model, values


def labels_of(caller: str, fit: FitResult, experiment: str | None) -> dict[str, str]:
    """Return for each parameter of the model its name among the estimates."""
    there = [record.name for record in fit.records]
    if experiment is not None and experiment not in there:
        raise ModelError(f"{caller}: '{experiment}' is not an experiment of the fit.{listing(experiment, there)}")
    found = {}
    for name in fit.model.parameter_names:
        label = f"{name}[{experiment or there[0]}]"
        found[name] = label if label in fit.parameters else name
        if experiment is None and len(there) > 1 and label in fit.parameters and _affects_derivatives(fit, name):
            raise ModelError(f"{caller}: each experiment has its own {name}: say which, experiment='{there[0]}'")
    return found


def _affects_derivatives(fit: FitResult, parameter: str) -> bool:
    """Return whether derivatives by states or inputs depend on a parameter; they do not depend on a bias."""
    return parameter in {*Jacobians(fit.model, "").parameters, *fit.model.delays.parameters}


_Complex: TypeAlias = NDArray[np.complex128]


def modes(
    fit: FitResult | Model | StateSpace,
    parameters: Mapping[str, Any] | None = None,
    *,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> Modes:
    """Return natural frequencies, damping ratios and time constants of the eigenvalues of A = df/dx.

    ``parameters``  values by name of a model; of a fit instead of its own.
    ``at``          of a model that is not linear, states, inputs (and time) about which it is linearised, by name. The
                    point is taken as it is: it does not move with the parameters.
    ``experiment``  whose parameters to take, where experiments have their own.

    A fit with its own parameters has standard errors, to first order (the delta method), from the covariance of the
    parameters and d lambda = w' dA v / (w' v), with v and w the right and left eigenvectors. They also hold where
    parameters are confounded, if the modes do not depend on the confounded direction: a scale between b and c, or a
    state space without canonical form. They are NaN where the data do not determine a mode, and where eigenvalues
    coincide (they have no derivative there). A real eigenvalue is assumed to stay real.

    Raises ModelError for unknown names, values that are missing, and a model that is not linear without
    ``at``.

    >>> m = Model("oscillator")
    >>> x, v = m.states("x v")
    >>> k, d = m.parameters("k d")
    >>> m.dynamics(x=v, v=-k*x - d*v)
    >>> m.outputs(x=x)
    >>> print(modes(m, {"k": 100.0, "d": 1.0}))
    frequency, Hz  damping ratio  time constant, s  eigenvalue, 1/s
    -------------  -------------  ----------------  ---------------
    1.59155        0.05           2                 -0.5 ± 9.98749j
    """
    if isinstance(fit, StateSpace):
        return fit.modes
    model, values = numbers_of("modes", fit, parameters, experiment)
    jacobians = Jacobians(model, "modes", blocks="A")
    numbers = jacobians.point(values, at)
    A = jacobians.matrix("A", numbers)
    if not isinstance(fit, FitResult) or parameters is not None:
        return table_of(np.linalg.eigvals(A).astype(np.complex128), time=model.time_unit)
    lam, right = np.linalg.eig(A)
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        return table_of(lam.astype(np.complex128), time=model.time_unit)
    uncertainty = Uncertainty(fit)
    labels = labels_of("modes", fit, experiment)
    slopes = np.zeros((lam.size, len(uncertainty.names)), dtype=np.complex128)
    for name in jacobians.parameters:
        column = uncertainty.names.index(labels[name])
        for (i, j), value in jacobians.slopes(name, numbers)["A"]:
            slopes[:, column] += left[:, i] * value * right[j, :]
    covariances = np.array([uncertainty.covariance(np.array([d.real, d.imag])) for d in slopes])
    # Digits that the eigenvectors have lost are lost to the derivatives.
    meet = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) > 1e7
    covariances[meet] = np.nan
    return table_of(lam.astype(np.complex128), covariances, model.time_unit)
