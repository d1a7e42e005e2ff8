"""Flight-path reconstruction: instrument errors from the kinematics, and the positions of flow vanes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .api import estimate
from .data.experiment import Experiment, as_experiments
from .data.filtering import kinds_for
from .errors import ModelError, OptionError, PhugoidError
from .fit_result import ENDED_WELL
from .modelling.compiled import CompiledExpressions
from .modelling.model import Model
from .modelling.noise import Gaussian
from .models.flight_path import flight_path
from .notebook import Rows, overview, sparkline
from .parameters import Estimate, plus_minus, text_table
from .records import Record
from .regression.least_squares import SmoothingSpline
from .renamed import Renamed
from .result import Fit
from .solvers import limited
from .summary import corrected as with_coloured_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Reconstruction", "VanePositions", "compare_positions", "reconstruct"]


_Array = NDArray[np.float64]

# Parts of each record whose gains are treated as independent, since residuals are coloured.
_BLOCKS = 10
# Standard deviations from which on a gain is significant.
_CLEAR = 2.0
# Standard errors from which on a vane is off the centre of gravity.
_OFF = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class VanePositions:
    """A fit with the positions of vanes estimated, in place of the delays of these channels that were asked for.

    channels   those of ``alpha`` and ``beta`` whose vane was given no position.
    delayed    those of them that are delayed in the other fit.
    fit        with ``x_alpha_vane``, ``x_beta_vane`` (m ahead of the centre of gravity).
    gain       in log-likelihood over the other fit, on the samples that both have: a delayed sensor has none at first.
    deviation  its standard deviation, from the scatter between parts of the records, since residuals are coloured.
    """

    channels: tuple[str, ...]
    delayed: tuple[str, ...]
    fit: Fit
    gain: float
    deviation: float

    @property
    def preferred(self) -> bool | None:
        """Return whether the data prefer positions (True) or the other fit (False) by two standard deviations, or None.
        A position that is preferred also differs from the centre of gravity by more than three standard errors."""
        if abs(self.gain) <= _CLEAR * self.deviation:
            return None
        if self.gain < 0.0:
            return False
        errors = self._errors
        off = any(abs(self.fit.parameters[n].value) > _OFF * errors[n] for n in map(_name, self.channels))
        return True if off else None

    @cached_property
    def _errors(self) -> dict[str, float]:
        """Standard errors, corrected for coloured residuals where that can be."""
        plain = {n: e.std_error for n, e in self.fit.parameters.items()}
        try:
            found = {n: e.std_error for n, e in self.fit.robust().parameters.items()}
        except PhugoidError:
            return plain
        return plain | {n: v for n, v in found.items() if np.isfinite(v)}

    def summary(self) -> str:
        """Return what was found, and what follows of it."""
        fit = self.fit
        shown = [_name(c) for c in self.channels]
        shown += [f"K_{c}" for c in self.channels if f"K_{c}" in fit.parameters]
        found = []
        for n in shown:
            e = fit.parameters[n]
            found.append(repr(Estimate(n, e.value, self._errors[n], e.unit)))
        instead = f" instead of delays of {' and '.join(self.delayed)}" if self.delayed else ""
        without = "delays" if self.delayed else "vanes at the centre of gravity"
        gain = f"log-likelihood {self.gain:+.0f} ± {self.deviation:.0f} on the same samples"
        verdict = {
            True: f"the data prefer positions to {without}",
            False: f"the data prefer {without}",
            None: f"the data do not distinguish positions from {without}",
        }[self.preferred]
        text = f"Positions of vanes estimated{instead}: {', '.join(found)}; {gain}: {verdict}."
        if self.preferred is False or (self.preferred is None and not self.delayed):
            return text
        given = ", ".join(f"{c}_vane=(x, y, z)" for c in self.channels)
        return (
            f"{text} A vane ahead of the centre of gravity by x looks like one that is delayed by x/V: give the "
            f"positions as measured on the aircraft, {given}, before any delay."
        )

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Positions of vanes of {', '.join(self.channels)}: {self.gain:+.1f} ± {self.deviation:.1f}>"


def compare_positions(fit: Fit, positions: Fit, channels: Sequence[str]) -> VanePositions | None:
    """Compare a fit with another of the same records that estimates positions; None where they do not compare."""
    usable = ENDED_WELL
    if fit.status not in usable or positions.status not in usable:
        return None
    one, other = _log_densities(fit), _log_densities(positions)
    if one is None or other is None:
        return None
    gains = np.array(
        [part.sum() for a, b in zip(one, other, strict=True) for part in np.array_split(np.nansum(b - a, 0), _BLOCKS)]
    )
    delayed = tuple(c for c in channels if c in fit.model.delays.outputs)
    deviation = float(np.sqrt(gains.size) * np.std(gains, ddof=1))
    return VanePositions(tuple(channels), delayed, positions, float(gains.sum()), deviation)


def _log_densities(fit: Fit) -> list[_Array] | None:
    """Return the log-density of each value (n_y, N) of each record, without the constant, NaN where missing; None for
    other than independent Gaussian noise."""
    outputs = fit.model.output_names
    known = fit.noise.known_sigmas(outputs)
    values = {n: fit.parameters[f"sigma_{n}"].value for n in outputs if f"sigma_{n}" in fit.parameters}
    sigma = {**known, **values}
    if not isinstance(fit.noise, Gaussian) or fit.noise.correlated or any(n not in sigma for n in outputs):
        return None
    return [
        np.array([-0.5 * (r.residuals[n] / sigma[n]) ** 2 - np.log(sigma[n]) for n in outputs]) for r in fit.records
    ]


def _name(channel: str) -> str:
    return f"x_{channel}_vane"


_SUFFIX = "_true"


def corrected(fit: Fit, record: Record, run: Experiment) -> Experiment:
    """Return a record with inertial channels at the centre of gravity and without bias, and states in place of their
    measurements; other channels are unchanged. All are channels, which serve as inputs or as outputs."""
    model = fit.model
    quantities = {n.removesuffix(_SUFFIX): n for n in model.quantity_names if n.endswith(_SUFFIX)}
    if "V" not in model.state_names or "q" not in quantities:
        raise ModelError(f"'{model.name}' is not a flight-path model: make one with models.flight_path")
    known, own = model.quantity_expressions(), fit._own(record.name)
    compiled = CompiledExpressions(
        [known[n] for n in quantities.values()], model.parameter_names, model.input_names, model.state_names
    )
    theta = np.array([own[n] for n in model.parameter_names])
    states = [record.states[n] for n in model.state_names]
    columns = np.vstack([record.t, *(record.inputs[n] for n in model.input_names), *states])
    found = dict(zip(quantities, compiled(theta, columns), strict=True))
    found |= {n: np.asarray(v) for n, v in record.states.items()}
    channels = {**run.channels, **run.outputs, **run.inputs, **found}
    units = {**run.units, **{n: model.units[n] for n in found if n in model.units}}
    made = Experiment(
        run.t, name=run.name, interpolation=kinds_for(run.interpolation, channels), channels=channels, units=units
    )
    # Inputs with samples of their own, such as controls, keep them; those of the inertial sensors are used up.
    kept = {n: s for n, s in run._signals.items() if n not in found}
    return made._sampled(kept, run.mesh_times)._after(run, f"flight path reconstructed: {', '.join(found)}")


_TURNING = {"pdot": "p", "qdot": "q", "rdot": "r"}
_VANES = ("alpha", "beta")
# Samples that differ by more than half a turn have jumped.
_JUMP = np.pi


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """The result of `reconstruct`: sensor errors, and records without them.

    fit             of the model of the flight path: biases, scale factors, delays; states are the path.
    runs            the records that it was fitted to.
    vane_positions  the fit with positions of vanes estimated in place of their delays, and which of the two the data
                    prefer; None where all positions were given or none is estimated (see `reconstruct`).
    corrected       the records, corrected: specific forces at the centre of gravity and rates without bias, and V,
                    alpha, beta, phi, theta, ... as reconstructed; all other channels unchanged. They are the data of
                    the next step, in which forces and moments are functions of these.
    """

    fit: Fit
    runs: tuple[Experiment, ...]
    vane_positions: VanePositions | None = None

    places = Renamed("vane_positions")

    @cached_property
    def corrected(self) -> tuple[Experiment, ...]:
        """The corrected records; see the class."""
        return tuple(corrected(self.fit, r, run) for r, run in zip(self.fit.records, self.runs, strict=True))

    @cached_property
    def coloured_errors(self) -> Mapping[str, float]:
        """Standard errors corrected for autocorrelated residuals, by parameter, as `Fit.robust` gives them. Noise of
        the gyros and accelerometers is integrated, so residuals are never white and the plain standard errors are too
        small. Where residuals drift over the whole record, the corrected ones are too small as well."""
        return {n: e.std_error for n, e in self.fit.robust().parameters.items()}

    def summary(self) -> str:
        """Return a table of sensor errors with both standard errors, and the goodness of fit of each output."""
        lines = [f"Flight path of {self._names()}: {self._status()}"]
        lines += ["", text_table(*self._error_rows(again=True)), "", text_table(*self._match_rows())]
        lines += [f"Warning: {w}" for w in self.fit.warnings]
        lines += ["", self.vane_positions.summary()] if self.vane_positions is not None else []
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        first = self.fit.records[0]
        remarks = [*self.fit.warnings]
        if (other := self.vane_positions) is not None:  # its summary takes too long for a notebook
            gain = f"log-likelihood {other.gain:+.0f} ± {other.deviation:.0f} on the same samples"
            remarks.append(f"with positions of vanes estimated, as in vane_positions: {gain}")
        return overview(
            f"Flight path of {self._names()}",
            self._error_rows(again=False),
            self._match_rows(),
            remarks=remarks,
            pictures={n: sparkline(z, first.outputs[n], first.t) for n, z in first.measured.items()},
            note=self._status(),
        )

    def _names(self) -> str:
        return ", ".join(repr(r.name) for r in self.runs)

    def _status(self) -> str:
        return self.fit.status if self.fit.converged else f"{self.fit.status}, {self.fit.message}"

    def _error_rows(self, again: bool) -> Rows:
        rows = []
        noise = self.fit.noise_parameters
        coloured: Mapping[str, Estimate] = with_coloured_errors(self.fit, again) or {}
        for n, e in self.fit.parameters.items():
            if n in noise:
                continue
            error = coloured[n].std_error if n in coloured else np.nan
            text, _, shown = plus_minus(e.value, error if np.isfinite(error) else e.std_error).partition(" ± ")
            rows.append([n, text, f"{e.std_error:.2g}", shown if np.isfinite(error) else "", e.unit, e.remark])
        return ["sensor error", "estimate", "std error", "corrected", "unit", "remark"], rows, "srrrll"

    def _match_rows(self) -> Rows:
        units, match = self.fit.model.units, []
        for r in self.fit.records:
            for n, v in r.residuals.items():
                size = float(np.sqrt(np.nanmean(v**2)))
                match.append([n, f"{size:.3g}", units.get(n, ""), f"{_lag_one(v):.2f}", r.name])
        return ["output", "RMS residual", "unit", "autocorrelation at lag 1", "record"], match, "lrlrl"

    def plot(self, record: int | str = 0) -> tuple[Figure, dict[str, Axes]]:
        """Plot measured outputs and the reconstructed path."""
        return self.fit.plot(record)

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        return f"<Reconstruction of {', '.join(repr(r.name) for r in self.runs)}: {self.fit.status}>"


def reconstruct(
    data: Experiment | Sequence[Experiment],
    model: Model | str | Sequence[str] | None = None,
    *,
    start: Mapping[str, Any] | None = None,
    noise: Any = None,
    time_limit: float | None = None,
    **options: Any,
) -> Reconstruction:
    """Estimate biases, scale factors and delays of the sensors from the kinematic equations alone, and correct the
    record.

    It needs no model of the aerodynamics, and should precede one: an angle of attack that is delayed or scaled wrongly
    shows here, and not as a derivative.

    data     with the channels of `models.flight_path`: ax, ay, az (m/s²), p, q, r (rad/s), and outputs such as V (m/s),
             alpha, beta, phi, theta, psi (rad), h (m). Several records share scale factors, delays and biases, but
             those in the option ``per_experiment``.
    model    a model of the flight path; or the names of its outputs, which is then made with ``options``, those of
             `models.flight_path`. None takes the outputs that all records have.
    start    values of parameters by name, as for `estimate`; None for the defaults.
    noise    as for `estimate`.
    time_limit  in seconds, of the whole; the best point so far is the result, as for `estimate`.

    A vane ahead of the centre of gravity looks like a delayed one, and its position is usually known. So where the
    model is made here, and positions of vanes for alpha or beta among the outputs are not given (``alpha_vane``,
    ``beta_vane``), these are estimated as well, in a second fit without their delays: ``vane_positions`` of the result
    holds this fit and which of the two fits better. The corrected records are those of the fit that was asked for.

    psi is unwrapped where it jumps by a whole turn. With the accelerometers off the centre of gravity, angular
    accelerations that are not in the record are those of smoothing splines through p, q and r.

    Raises DataError, ModelError or OptionError for invalid arguments.
    """
    deadline = limited("reconstruct", time_limit)
    runs = as_experiments(data, "reconstruct")
    if isinstance(model, Model):
        if options:
            raise OptionError(f"reconstruct: {', '.join(options)}: options make a model, but one was given")
        made = model
    else:
        names = model if model is not None else _outputs(runs, bool(options.get("longitudinal")))
        made = flight_path(names, **options)
    if "V" not in made.state_names or "q_true" not in made.quantity_names:
        raise ModelError(f"reconstruct: '{made.name}' is not a flight-path model: make one with models.flight_path")
    ready = [_turning(_unwrapped(run, made), made) for run in runs]
    begin = dict(start or {})
    if "V" in made.delays.outputs:
        # A delayed output measures no state, and unmeasured states start at 0: there is no angle of attack at rest.
        begin.setdefault("V", float(np.nanmedian(np.concatenate([run.output("V") for run in ready]))))
    with deadline.in_force():
        fit = estimate(made, ready, start=begin, noise=noise)
        placed = None if isinstance(model, Model) else _with_vane_positions(fit, ready, begin, noise, options)
    return Reconstruction(fit, tuple(ready), placed)


def _with_vane_positions(
    fit: Fit, runs: Sequence[Experiment], start: Mapping[str, Any], noise: Any, options: Mapping[str, Any]
) -> VanePositions | None:
    """Return the positions of the vanes that were not given, estimated in place of delays."""
    outputs = fit.model.output_names
    channels = [c for c in _VANES if c in outputs and options.get(f"{c}_vane") is None]
    if not channels or fit.status not in ENDED_WELL:
        return None
    delayed = [n for n in fit.model.delays.outputs if n not in channels]
    other = flight_path(outputs, **{**options, "delayed": delayed, **{f"{c}_vane": (None, 0.0, 0.0) for c in channels}})
    known = {*other.parameter_names, *other.state_names}
    begin = {n: v for n, v in start.items() if n.partition("[")[0] in known}
    for n in delayed:  # delays take most of the time
        begin.setdefault(f"tau_{n}", fit.parameters[f"tau_{n}"].value)
    try:
        found = estimate(other, runs, start=begin, noise=noise)
    except PhugoidError:  # the fit that was asked for exists
        return None
    return compare_positions(fit, found, channels)


def _outputs(runs: Sequence[Experiment], longitudinal: bool) -> list[str]:
    usual = ("V", "alpha", "theta", "h") if longitudinal else ("V", "alpha", "beta", "phi", "theta", "psi", "h")
    return [n for n in usual if all(n in {*r.outputs, *r.channels} for r in runs)]


def _unwrapped(run: Experiment, model: Model) -> Experiment:
    for n in ("psi", "phi"):
        if n not in model.output_names:
            continue
        values = run.output(n)
        there = np.isfinite(values)
        if there.any() and np.abs(np.diff(values[there])).max(initial=0.0) > _JUMP:
            whole = values.copy()
            whole[there] = np.unwrap(values[there])
            run = _with_channels(run, {n: whole}, f"{n} unwrapped")
    return run


def _turning(run: Experiment, model: Model) -> Experiment:
    """Add angular accelerations, where the model needs them and the record has none."""
    lacking = [n for n in _TURNING if n in model.input_names and n not in {*run.inputs, *run.channels}]
    if not lacking:
        return run
    slopes = {n: SmoothingSpline().smooth(run.t, run.input(_TURNING[n]))[1] for n in lacking}
    return _with_channels(run, slopes, f"{', '.join(lacking)} from smoothing splines")


def _with_channels(run: Experiment, channels: Mapping[str, Any], step: str) -> Experiment:
    """Return the record with channels added or replaced."""
    outputs = {n: v for n, v in run.outputs.items() if n not in channels}
    other = Experiment(
        run.t,
        run.inputs,
        outputs,
        run.name,
        run.interpolation,
        channels={**run.channels, **channels},
        units=run._units_of(run.inputs, outputs, run.channels, channels),
    )
    return other._sampled(run._signals, run.mesh_times)._after(run, step)


def _lag_one(residuals: Any) -> float:
    e = residuals[np.isfinite(residuals)]
    return float(e[1:] @ e[:-1] / (e @ e)) if e.size > 1 and e.any() else np.nan
