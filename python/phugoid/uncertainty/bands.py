"""Prediction bands about the outputs of a fit: for the model, and for another measurement."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from ..data.experiment import Experiment
from ..errors import DataError, OptionError, UnknownName, check_progress, did_you_mean, part
from ..estimation.filter_variables import Objective, Separated
from ..figures import BAND, MEASURED, MODEL, SPAN, WIDTH, Panels, labelled, plain, styled
from ..filter_error import FilterError
from ..fit_result import ENDED_WELL, FitResult, dataset
from ..initialisation import spread
from ..modelling.model import Model
from ..notebook import overview, sparkline
from ..parameters import Estimates
from ..records import Record
from ..sensitivities.linearised import Linearised
from ..sensitivities.tangents import Tangents, collocated
from ..solvers import Iteration
from ..time_unit import time_unit_of
from ..transcription import Collocation
from ..validation import ReEstimated, re_estimated
from .coloured import Colouring
from .coloured import coloured as corrected
from .resample import Parametric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Bands", "of_fit", "prediction_bands"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Bands:
    """The result of `Fit.prediction_bands`, for one experiment of N samples.

    record       time, inputs, model outputs, measurements.
    level        of the bands, at each sample by itself.
    std_errors   output -> (N,) of what the model says: by parameters and initial states; with process noise of its most
                 probable path, which the measurements pin down.
    model        output -> (low, high), each (N,), in which the true model's output lies.
    measurement  output -> (low, high), each (N,), in which a new measurement lies, with noise of its own.
    coloured     whether the errors are those for coloured residuals.
    """

    record: Record
    level: float
    std_errors: Mapping[str, _Array]
    model: Mapping[str, tuple[_Array, _Array]]
    measurement: Mapping[str, tuple[_Array, _Array]]
    coloured: bool
    _title: str = field(default="", repr=False)

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot each output with both bands. Return the figure and its axes by name."""
        return plot_bands(self, self._title)

    def _repr_html_(self) -> str:
        rows, record = [], self.record
        for name in self.model:
            widths = [0.5 * _mean(high - low) for low, high in (self.model[name], self.measurement[name])]
            low, high = self.measurement[name]
            z = record.measured.get(name, np.full(record.n, np.nan))
            there = np.isfinite(z)
            inside = f"{100.0 * np.mean((z >= low)[there] & (z <= high)[there]):.1f}" if there.any() else ""
            size = [f"{w:.3g}" if math.isfinite(w) else "" for w in (_mean(self.std_errors[name]), *widths)]
            rows.append([name, record.units.get(name, ""), *size, inside])
        heads = ["output", "unit", "std error", "± model", "± measurement", "measured inside, %"]
        return overview(
            f"Prediction bands of {record.name}",
            (heads, rows, "llrrrr"),
            remarks=["means over the record of standard error and half widths"],
            pictures={n: sparkline(record.measured.get(n, y), y, record.t) for n, y in record.outputs.items()},
            note=f"{100 * self.level:g} % for {'coloured' if self.coloured else 'white'} noise",
        )

    def __repr__(self) -> str:
        return f"<Bands of '{self.record.name}': {100 * self.level:g} %, {', '.join(self.model)}>"


def _mean(values: _Array) -> float:
    there = values[np.isfinite(values)]
    return float(there.mean()) if there.size else math.nan


def prediction_bands(
    fit: FitResult,
    experiment: str | int | Experiment | None = None,
    *,
    level: float = 0.95,
    coloured: bool = True,
    biases: Sequence[str] | None = None,
    values: Mapping[str, float] | None = None,
    progress: bool | Callable[[Iteration], None] = False,
) -> Bands:
    """Compute prediction bands; see `Fit.prediction_bands`."""
    part("prediction_bands: level", level, "0.95")
    check_progress("prediction_bands", progress)
    filtered = isinstance(fit.transcription, FilterError)
    if filtered:
        coloured = False  # innovations are white where the model is right
        _check_ended(fit)
    if isinstance(experiment, Experiment):
        anew = re_estimated(fit, [experiment], biases, values or {}, progress)
        _check_found(anew.fit, experiment)
        if filtered:
            record, errors = _filtered_elsewhere(fit, experiment, anew, values or {})
        else:
            record, errors = _elsewhere(fit, anew, coloured)
        noise, e = Parametric.of(anew.fit), 0
    else:
        if biases is not None or values is not None:
            raise OptionError("prediction_bands: biases and values are for an Experiment that the fit was not made on")
        e = _which(fit, experiment)
        record, noise = fit.records[e], Parametric.of(fit)
        if filtered:
            errors = _within(fit, e)
        else:
            tangents = Tangents.of(fit, "prediction_bands")
            covariance = Colouring(tangents).covariance if coloured else tangents.inverse
            errors = _errors(fit, tangents, covariance, e, record)
    z = NormalDist().inv_cdf(0.5 + 0.5 * level)
    model, measurement = {}, {}
    for name, error in errors.items():
        y, low, high = record.outputs[name], *noise.quantiles(e, name, 0.5 - 0.5 * level)
        model[name] = (y - z * error, y + z * error)
        # This is exact for Gaussian noise.
        measurement[name] = (y - np.hypot(z * error, low), y + np.hypot(z * error, high))
    return Bands(record, float(level), errors, model, measurement, coloured, f"{fit.model.name}: {record.name}")


def _which(fit: FitResult, experiment: str | int | None) -> int:
    names = [r.name for r in fit.records]
    if experiment is None:
        if len(names) > 1:
            listed = ", ".join(f"'{n}'" for n in names)
            raise DataError(f"prediction_bands: the fit has {len(names)} experiments ({listed}): say which")
        return 0
    if isinstance(experiment, str):
        if experiment not in names:
            raise UnknownName(f"there is no experiment '{experiment}'.{did_you_mean(experiment, names)}")
        return names.index(experiment)
    if not isinstance(experiment, (int, np.integer)) or not -len(names) <= experiment < len(names):
        raise OptionError(
            f"prediction_bands: experiment is a name, a number below {len(names)} or an Experiment, not {experiment!r}"
        )
    return int(experiment) % len(names)


def _errors(fit: FitResult, tangents: Tangents, covariance: _Array, e: int, record: Record) -> dict[str, _Array]:
    """Return output -> (N,) standard errors over a record."""
    changes = tangents.outputs()[e]
    variance = np.einsum("ytk,kl,ytl->yt", changes, covariance, changes)
    times = tangents.linear.inner.records[e].t
    found = {}
    for name, line in zip(fit.model.output_names, np.sqrt(np.maximum(variance, 0.0)), strict=True):
        late = fit.parameters[fit.model.delays.outputs[name]].value if name in fit.model.delays.outputs else 0.0
        found[name] = np.where(np.isfinite(record.outputs[name]), np.interp(record.t - late, times, line), np.nan)
    return found


def _check_found(found: FitResult, other: Experiment) -> None:
    """Raise DataError unless initial states and biases were found; KeyboardInterrupt after Ctrl-C, since there are no
    bands without them."""
    if found.status == "interrupted":
        raise KeyboardInterrupt
    if not found.converged:
        raise DataError(
            f"prediction_bands: initial states and biases of '{other.name}' were not found ({found.status}): "
            f"{found.message}"
        )


def _elsewhere(fit: FitResult, anew: ReEstimated, coloured: bool) -> tuple[Record, dict[str, _Array]]:
    """Return the record and standard errors of an experiment that the fit was not made on: its initial states and
    biases are re-estimated with the fitted parameters, so their errors depend on those of the parameters."""
    found, free, held, _ = anew
    linear = Linearised(_opened(fit, collocated(found), held))
    t = Tangents(linear)
    own = [i for i, name in enumerate(t.names) if name.partition("[")[0] not in free]
    labels = [t.names[i].partition("[")[0] for i in own]
    moves = t.slopes[own, None] * t.moves[own, : t.k]
    used = [
        i for i, name in enumerate(labels) if name in fit.parameters and np.isfinite(fit.parameters[name].std_error)
    ]
    moves, labels = moves[used], [labels[i] for i in used]
    names = list(fit.parameters)
    at = [names.index(name) for name in labels]
    given = (corrected(fit).covariance if coloured else fit.covariance)[np.ix_(at, at)]
    # Coordinates are orthonormal in the outputs: the least change with given parameters is the refit of the
    # rest, and directions without a change of parameters are moved by the noise of the new record.
    back = np.linalg.pinv(moves, rcond=1e-9)
    rest = np.eye(t.k) - back @ moves
    noise = Colouring(t).spread if coloured else np.eye(t.k)
    covariance = np.zeros((len(t.inverse), len(t.inverse)))
    covariance[: t.k, : t.k] = back @ given @ back.T + rest @ noise @ rest.T
    record = found.records[0]
    return record, _errors(fit, t, covariance, 0, record)


def _opened(fit: FitResult, found: FitResult, held: Mapping[str, float]) -> FitResult:
    """Return a fit of initial states and biases alone as one of the whole model at that point, with free parameters."""
    inner, before = found._moved or found, fit._moved or fit
    assert inner.solution is not None
    model = before.model
    spreads = {name: spread(inner.experiments, name) for name in model.output_names}
    noise = inner.noise.resolve(model.output_names, spreads, inner.as_start(inner.noise))
    assert isinstance(inner.transcription, Collocation)
    problem = inner.transcription.problem(model, inner.experiments, noise)
    by_name = {e.name.partition("[")[0]: e.value for e in inner.parameters.values()} | dict(held)
    labels = [name for name, *_ in problem.estimands]
    values = [by_name[label.partition("[")[0]] for label in labels]
    xi = inner._solution_of(problem).xi.copy()
    xi[: len(values)] = problem.variables(values)
    estimates = []
    for label, value in zip(labels, values, strict=True):
        base = label.partition("[")[0]
        like = inner.parameters[base if base in inner.parameters else label]
        fixed = base in fit.parameters and fit.parameters[base].fixed
        active = fit.parameters[base].bounds_active if base in fit.parameters else None
        estimates.append(replace(like, name=label, value=value, fixed=fixed, bounds_active=active, std_error=math.nan))
    return replace(
        inner, model=model, parameters=Estimates(estimates), solution=replace(inner.solution, xi=xi), _moved=None
    )


# Columns of panels, and the height of each in inches.
_BAND_COLUMNS, _BAND_HEIGHT = 2, 1.8


def plot_bands(bands: Any, title: str) -> tuple[Figure, dict[str, Axes]]:
    """Plot one panel for each output: measured points, the model's line, and both bands."""
    names, time = list(bands.model), time_unit_of(bands.record.units)
    columns = min(_BAND_COLUMNS, len(names)) if len(names) > 2 else 1
    rows = math.ceil(len(names) / columns)
    with styled() as plt:
        figure, grid = plt.subplots(
            rows, columns, figsize=(WIDTH, _BAND_HEIGHT * rows + 0.7), squeeze=False, sharex=True
        )
        panels = list(grid.T.ravel())
        for axis in panels[len(names) :]:
            axis.set_visible(False)
        axes: dict[str, Axes] = dict(zip(names, panels, strict=False))
        for name, axis in axes.items():
            _draw_bands(axis, bands, name)
        for axis in grid[-1]:
            axis.set_xlabel(plain(time.axis()))
        if len(names) < len(panels):  # the panel above an empty one has the axis of time
            last = axes[names[-1]]
            last.tick_params(labelbottom=True)
            last.set_xlabel(plain(time.axis()))
        handles, labels = axes[names[0]].get_legend_handles_labels()
        height = figure.get_figheight()
        figure.legend(handles, labels, loc="upper right", ncols=4, frameon=False, fontsize=8, columnspacing=1.2)
        what = "coloured" if bands.coloured else "white"
        figure.suptitle(
            plain(f"{title}, {100 * bands.level:g} % for {what} noise"),
            x=0.01,
            y=1 - 0.3 / height,
            ha="left",
            fontsize=9,
        )
        figure.tight_layout(rect=(0, 0, 1, 1 - 0.42 / height), h_pad=0.4)
        figure.align_ylabels()
    return figure, Panels(axes)


def _draw_bands(axis: Any, bands: Any, name: str) -> None:
    record = bands.record
    t = record.t
    axis.fill_between(t, *bands.measurement[name], color=BAND, linewidth=0, label="measurement")
    axis.fill_between(t, *bands.model[name], color=SPAN, linewidth=0, label="model")
    axis.plot(t, record.outputs[name], color=MODEL, linewidth=0.9, label="estimate")
    if name in record.measured:
        there = np.isfinite(record.measured[name])
        size = 2.0 if t.size <= 1000 else 1.0
        axis.plot(
            t[there], record.measured[name][there], ".", color=MEASURED, markersize=size, label="measured", zorder=1.5
        )
    axis.set_ylabel(plain(labelled(name, record.units)))
    axis.margins(x=0.01)


# Step of a parameter for differences of the outputs, in standard errors.
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
        """Take ``values`` by name, ``known`` sigmas by output, and the ``states`` of each experiment to start from,
        (n_x, N)."""
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
        """Return numbers as the core takes them: inverses of sigmas."""
        theta = values.copy()
        for i in range(len(self.model.parameter_names), theta.size - len(self.options.states)):
            theta[i] = 1.0 / theta[i]
        return theta

    def outputs(self, values: _Array) -> list[tuple[_Array, _Array]]:
        """Return the outputs of the smoothed path of each experiment, and their standard deviations for known numbers:
        each (n_y, N); [] where there is no path."""
        found = self.problem.smooth(self.theta(values), self.path)
        return [] if found is None else [pairs[1] for pairs, *_ in found]

    def errors(self, covariance: _Array, e: int) -> _Array:
        """Return (n_y, N) standard errors of the outputs in one experiment: those of the smoother, and those due to the
        errors of the numbers with this ``covariance`` (n, n), to first order. NaN where there is no path."""
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
        """Return central differences of the outputs."""
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
    """Return the likelihood of a fit, and the covariance of its numbers: 0 for those that are known or at a bound."""
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


def _within(fit: FitResult, e: int) -> dict[str, _Array]:
    """Return output -> (N,) standard errors of the outputs in an experiment of the fit."""
    likelihood, covariance = of_fit(fit)
    return dict(zip(fit.model.output_names, likelihood.errors(covariance, e), strict=True))


def _filtered_elsewhere(
    fit: FitResult, other: Experiment, anew: ReEstimated, values: Mapping[str, float]
) -> tuple[Record, dict[str, _Array]]:
    """Return, for an experiment that the fit was not made on and whose states and biases were re-estimated, its record
    and the standard errors. Errors of biases follow from those of the parameters and from the new record."""
    found, free, held, _ = anew
    record, model, options = found.records[0], fit.model, found.transcription
    assert isinstance(options, FilterError)
    shared = {n: e.value for n, e in fit.parameters.items() if n in fit.noise_parameters}
    numbers = {**shared, **held, **{n.partition("[")[0]: e.value for n, e in found.parameters.items() if n in free}}
    known = fit.noise.known_sigmas(model.output_names)
    states = np.array([record.states[name] for name in model.state_names])
    likelihood = Filtered(model, [other], options, numbers, known, [states])

    own = np.array([i for i, n in enumerate(likelihood.names) if n in free], dtype=np.intp)
    given = [i for i, n in enumerate(likelihood.names) if n not in free and n in fit.parameters and n not in values]
    at = [list(fit.parameters).index(likelihood.names[i]) for i in given]
    covariance = np.zeros((likelihood.values.size,) * 2)
    covariance[np.ix_(given, given)] = np.nan_to_num(fit.covariance[np.ix_(at, at)])
    if own.size:
        _add_biases(likelihood, covariance, own)
    return record, dict(zip(model.output_names, likelihood.errors(covariance, 0), strict=True))


def _check_ended(fit: FitResult) -> None:
    """Raise OptionError for a fit that has not converged."""
    if fit.status not in ENDED_WELL:
        raise OptionError(
            f"prediction_bands: the fit has not converged ({fit.status}): {fit.message or 'see its summary'}"
        )


def _add_biases(likelihood: Filtered, covariance: _Array, own: NDArray[np.intp]) -> None:
    """Add biases to a covariance: the best biases depend on the other numbers."""
    z = likelihood.values.copy()
    sigmas = slice(len(likelihood.model.parameter_names), z.size - len(likelihood.options.states))
    jacobian = np.ones(z.size)
    jacobian[sigmas] = 1.0 / z[sigmas]
    z[sigmas] = np.log(z[sigmas])
    infinite = np.full(z.size, np.inf)
    objective = Objective(
        likelihood.model, likelihood.problem, likelihood.path, (-infinite, infinite), len(likelihood.options.states)
    )
    samples = [int(np.isfinite(likelihood.experiments[0].output(n)).sum()) for n in likelihood.model.output_names]
    counts = samples[: objective.n_sigma]
    metric = objective.metric(z, counts, likelihood.experiments[0].n - 1)
    held = np.zeros(z.size, dtype=np.bool_)
    held[[i for i in range(z.size) if i not in own and covariance[i, i] == 0.0]] = True
    hessian = objective.hessian(z, metric, held)
    if hessian is None:
        raise DataError("prediction_bands: the likelihood of the new record has no curvature")
    hessian *= np.outer(jacobian, jacobian)
    own_inverse = np.linalg.inv(hessian[np.ix_(own, own)])
    slopes = -own_inverse @ hessian[own]
    slopes[:, own] = 0.0
    across = slopes @ covariance
    covariance[own] += across
    covariance[:, own] += across.T
    covariance[np.ix_(own, own)] += across @ slopes.T + own_inverse
