"""Validation of a fit on other experiments: `Fit.validate`."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .data.experiment import Experiment, as_experiments
from .data.units import check_units
from .errors import ByName, DataError, ModelError, OptionError, check_progress, counted, did_you_mean, finite, whole
from .estimation import estimate
from .figures import fit as plot
from .filter_error import FilterError
from .fit_result import FitResult
from .frozen_model import estimates_of, freed_by_default, freeze_model, freeze_noise, mesh_for
from .goodness_of_fit import Match, Tolerance, chi_square, chi_square_warning, match, match_rows, tolerances_by_output
from .initialisation import measured_states
from .modelling.model import Model
from .modelling.noise import Noise
from .notebook import bullets, overview, sparkline
from .parameters import Estimates, estimates_html, estimates_table, facts_text, text_table
from .records import Record, only
from .renamed import Renamed
from .solvers import Iteration, limited
from .solvers.newton import Newton

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "ReEstimated",
    "Validation",
    "re_estimated",
    "shared",
    "validate",
]


_Array = NDArray[np.float64]

# Residuals are called coloured below this p-value, and their error an offset above this part of their mean square.
_WHITE, _MOSTLY = 0.01, 0.5
_WIDTH = 120  # of lines of text
# Below the table of outputs.
_COLUMNS = (
    "Theil U: 0 for a perfect match; about mean: the same without the mean of the output. bias/var/cov: parts of the "
    "mean square error from an offset, from the amplitude, and the rest. lag-1: correlation of a residual with the "
    "next. p white: p-value of the test that residuals are white. inside: within the tolerance, where one is given."
)


@dataclass(frozen=True, eq=False, repr=False)
class Validation:
    """The result of `Fit.validate`: the model as fitted, with only initial states and biases re-estimated.

    model           as fitted.
    noise           that of the fit, every number known.
    fitted_to       names of the experiments that the fit was made on.
    records         one an experiment: measured, outputs, residuals, states.
    fixed           parameter -> fixed value.
    re_estimated    estimates of the biases (and what else was named), with standard errors.
    initial_states  experiment -> state -> estimate of the state at the first sample. Standard errors, here and of
                    ``re_estimated``, take fixed parameters for exact and the noise for that of the fit.
    log_likelihood  of these measurements, at the noise of the fit: as `Fit.log_likelihood`, without the constant
                    -N n_y/2 ln 2 pi. On the same experiments it compares models, the greater the better.
                    With process noise it is the marginal one.
    chi_square      sum of squared residuals over the fit's variances (r' R^-1 r where noise is correlated); NaN where
                    noise is not Gaussian or there is process noise. Where model and parameters are exact its
                    expectation is ``degrees_of_freedom``: the number of measured values minus what was estimated.
    matches         output -> `Match` over all experiments: Theil's coefficient and more. ``sigma`` in it is that of
                    the fit's noise.
    by_experiment   experiment -> output -> `Match`.
    status          "converged", or what else happened; ``message`` says what to do then.
    warnings        in words.
    tolerances      output -> `Tolerance`, as given.
    initial_samples  the number of samples at the beginning of each experiment that initial states and biases were
                    estimated from; None: all. ``log_likelihood`` is that of these samples. ``chi_square`` and
                    ``matches`` are of all samples: the error of the initial states, which the simulation carries on,
                    adds to them.

    With process noise (`FilterError`) intensities are fixed too, initial states are integrated out, and outputs and
    residuals are those of predictions from the samples before, since the most probable path follows any measurements;
    ``sigma`` of a `Match` is what the root mean square of these residuals should be.
    """

    model: Model
    noise: Noise
    fitted_to: tuple[str, ...]
    records: Sequence[Record]
    fixed: Mapping[str, float]
    re_estimated: Estimates
    initial_states: Mapping[str, Estimates]
    log_likelihood: float
    chi_square: float
    degrees_of_freedom: int
    matches: Mapping[str, Match]
    by_experiment: Mapping[str, Mapping[str, Match]]
    status: str
    message: str
    warnings: tuple[str, ...] = ()
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)
    initial_samples: int | None = None

    held = Renamed("fixed")
    freed = Renamed("re_estimated")

    @property
    def converged(self) -> bool:
        """Whether the initial states and biases were found."""
        return self.status == "converged"

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Output -> (N,) measured minus model, NaN where missing, of the only experiment; those of several are in
        ``records``.

        Raises DataError where there are several experiments.
        """
        return only(self.records, "validation", "residuals").residuals

    @property
    def _predicted(self) -> bool:
        return any(r.innovations for r in self.records)

    def summary(self) -> str:
        """Return the validation in plain text: fixed and re-estimated values, goodness of fit of each output, and its
        meaning."""
        parts = [facts_text(f"{self.model.name}: validation", self._entries())]
        if self.re_estimated:
            parts.append(estimates_table(self.re_estimated.values(), title="re-estimated"))
        parts.append(text_table(*match_rows(self.matches.values())))
        if len(self.records) > 1:
            parts += [
                f"{name} alone\n{text_table(*match_rows(each.values()))}" for name, each in self.by_experiment.items()
            ]
        parts.append(textwrap.fill(_COLUMNS, _WIDTH))
        parts.append("\n".join(textwrap.fill(line, _WIDTH, subsequent_indent="  ") for line in self.in_words()))
        return "\n\n".join(parts) + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def plot(self, record: int | str = 0, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the proof of match of an experiment: measured points with their tolerance bands, model, residuals,
        inputs. Return the figure and the axes by name, as `Fit.plot` does."""
        return plot.plot_validation(self, record, channels)

    def _repr_html_(self) -> str:
        entries, first = self._entries(), self.records[0]
        shown = [n for n in ("validated on", "log-likelihood", "chi-square") if n in entries]
        return overview(
            f"{self.model.name}: validation",
            bullets(f"{name}: {entries[name]}" for name in shown),
            estimates_html(self.re_estimated.values()),
            match_rows(self.matches.values()),
            remarks=[*self.in_words(), *self.warnings],
            pictures={n: sparkline(z, first.outputs[n], first.t) for n, z in first.measured.items()},
            note=self.status,
        )

    def _entries(self) -> dict[str, str]:
        """Return the facts of the validation, by heading."""
        names = ", ".join(f"'{r.name}'" for r in self.records)
        samples = sum(m.samples for m in self.matches.values())
        first = sum(map(len, self.initial_states.values()))
        entries = {
            "validated on": f"{names}: {samples} measured values",
            "fitted to": ", ".join(f"'{name}'" for name in self.fitted_to),
            "status": f"{self.status}: {self.message}" if self.message else self.status,
            "fixed": ", ".join(self.fixed) or "nothing",
            "re-estimated": ", ".join([counted(first, "initial state"), *self.re_estimated]),
            "log-likelihood": f"{self.log_likelihood:.3f} at the noise of the fit",
        }
        if self.initial_samples is not None:
            first_ones = counted(self.initial_samples, "sample") + " of each experiment"
            entries["re-estimated"] += f"; from the first {first_ones}, simulated from there on"
            entries["log-likelihood"] += ", of these samples"
        if self._predicted:
            entries["residuals"] = "of predictions from the samples before"
        if math.isfinite(self.chi_square):
            entries["chi-square"] = f"{self.chi_square:.1f} on {self.degrees_of_freedom} degrees of freedom"
        if self.noise.description:
            entries["noise"] = self.noise.description
        return entries

    def in_words(self) -> list[str]:
        """Return the meaning of the numbers, one sentence for each output."""
        lines = []
        for m in self.matches.values():
            if not m.samples:
                lines.append(f"{m.output}: there are no measurements to compare the model with.")
                continue
            if not math.isfinite(m.rms):
                lines.append(f"{m.output}: no solution of the model was found to compare with the measurements.")
                continue
            said = []
            if math.isfinite(m.sigma):
                what = "the value that the fit predicts" if self._predicted else "the fit's noise"
                said.append(f"RMS is {m.rms / m.sigma:.2g} times {what}")
            if m.tolerance is not None:
                said.append(f"{100 * m.inside:.1f} % of the samples lie within {m.tolerance.text(m.unit)}")
            parts = {"a constant offset": m.bias, "a difference in amplitude": m.variance}
            said += [f"the error is mostly {what}" for what, part in parts.items() if part > _MOSTLY]
            if m.whiteness < _WHITE:
                said.append(f"its residuals are coloured (lag-1 correlation {m.lag_one:.2f})")
            elif math.isfinite(m.whiteness):
                said.append("its residuals are not significantly coloured")
            lines.append(f"{m.output}: {'; '.join(said)}.")
        return lines

    def __repr__(self) -> str:
        names = ", ".join(f"'{r.name}'" for r in self.records)
        return (
            f"<Validation of '{self.model.name}' on {names}: {self.status}, log-likelihood {self.log_likelihood:.6g}>"
        )

    def __str__(self) -> str:
        return self.summary()


class ReEstimated(NamedTuple):
    """Hold a fit of initial states and biases alone to other experiments.

    fit       of the model with all other parameters fixed.
    free      names of the biases.
    held      values of the other parameters.
    warnings  about the fit and the experiments.
    """

    fit: FitResult
    free: tuple[str, ...]
    held: dict[str, float]
    warnings: tuple[str, ...]


# Records share samples where as many as this agree to the bit.
_SHARED = 3


def validate(
    fit: FitResult,
    other: Experiment | Sequence[Experiment],
    *,
    biases: Sequence[str] | None = None,
    values: Mapping[str, float] | None = None,
    tolerances: Mapping[str, float | Tolerance] | None = None,
    initial_samples: int | None = None,
    progress: bool | Callable[[Iteration], None] = False,
    time_limit: float | None = None,
) -> Validation:
    """Validate a fit; see `Fit.validate`."""
    model, experiments = fit.model, as_experiments(other, "validate")
    limits = tolerances_by_output("validate", model.output_names, tolerances)
    check_progress("validate", progress)
    fitted = experiments if initial_samples is None else _first_samples(fit, experiments, initial_samples)
    with limited("validate", time_limit).in_force():
        given = {} if values is None else values
        found, free, held, warnings = re_estimated(fit, fitted, biases, given, progress)
    noise, filtered = found.noise, isinstance(found.transcription, FilterError)
    records = [_predicted(r) for r in found.records] if filtered else found.records
    if initial_samples is not None:
        records = [_with_all_samples(r, e) for r, e in zip(records, experiments, strict=True)]
    if not found.feasible:
        warnings += (
            f"no motion of the model was found for these data ({found.status}): how well it matches is not known",
        )
    elif not found.converged:
        warnings += (f"the initial states and biases were not found ({found.status}): {found.message}",)
    known = noise.known_sigmas(model.output_names)

    total = math.nan if filtered else chi_square(noise, model.output_names, records)[0]
    estimated = _estimated(model, free, found)
    # The noise is that of the fit, not one that was given: the validation itself reports how they compare.
    known_warning = chi_square_warning(noise, model.output_names, found.records, estimated)

    def matches(records: Sequence[Record]) -> Mapping[str, Match]:
        sizes = {n: _predicted_std(records, n) if filtered else known.get(n, math.nan) for n in model.output_names}
        return ByName("output", {n: match(records, n, sizes[n], limits.get(n)) for n in model.output_names})

    of_outputs = matches(records)
    return Validation(
        model=model,
        noise=noise,
        fitted_to=tuple(r.name for r in fit.records),
        records=records,
        fixed=held | {n: e.value for n, e in found.parameters.items() if filtered and n in found.noise_parameters},
        re_estimated=estimates_of(found.parameters, free),
        initial_states=found.initial_states,
        log_likelihood=found.log_likelihood,
        chi_square=total,
        degrees_of_freedom=sum(m.samples for m in of_outputs.values()) - estimated,
        matches=of_outputs,
        by_experiment=ByName("experiment", {r.name: matches([r]) for r in records}),
        status=found.status,
        message="" if found.converged else found.message,
        warnings=(*warnings, *(w for w in found.warnings if w != known_warning)),
        tolerances=limits,
        initial_samples=initial_samples,
    )


def re_estimated(
    fit: FitResult,
    experiments: Sequence[Experiment],
    biases: Any,
    values: Any,
    progress: bool | Callable[[Iteration], None] = False,
) -> ReEstimated:
    """Fit initial states and biases alone to other experiments; raises as `Fit.validate` does."""
    free = _free(fit, biases, values)
    held = _held(fit, free, values)
    mesh = mesh_for(fit, experiments)
    noise, warnings = freeze_noise(fit)
    if not fit.converged:
        warnings = (f"the fit itself has not converged ({fit.status}): {fit.message or 'see its summary'}", *warnings)
    for e in experiments:
        warnings += _check(fit, e, free)

    slim = freeze_model(fit.model, held, free)
    # A regression on measured states is for parameters, and these are fixed.
    solver = None if isinstance(mesh, FilterError) else Newton(regression=False)
    begin = _start(fit, slim, held, free)
    found = estimate(slim, experiments, transcription=mesh, noise=noise, start=begin, solver=solver, progress=progress)
    return ReEstimated(found, free, held, warnings)


def _first_samples(fit: FitResult, experiments: Sequence[Experiment], count: int) -> list[Experiment]:
    """Return the experiments with outputs at their first samples alone."""
    whole("validate: initial_samples", count, 1)
    if isinstance(fit.transcription, FilterError):
        raise OptionError(
            "validate: initial_samples is for fits without process noise, whose path no later sample moves"
        )
    names = fit.model.output_names
    return [
        e.with_outputs({n: np.where(np.arange(e.t.size) < count, e.output(n), np.nan) for n in names}, name=e.name)
        for e in experiments
    ]


def _with_all_samples(record: Record, experiment: Experiment) -> Record:
    """Return a record whose measurements are all those of its experiment; its path is that of the first samples."""
    measured = {name: experiment.output(name) for name in record.measured}
    return replace(record, measured=measured, residuals={n: z - record.outputs[n] for n, z in measured.items()})


def _predicted(record: Record) -> Record:
    """Return a record of the filter-error method with outputs predicted from the preceding samples: its most probable
    path follows any measurements."""
    outputs = {name: record.measured[name] - r for name, r in record.innovations.items()}
    return replace(record, outputs=outputs, residuals=record.innovations)


def _predicted_std(records: Sequence[Record], output: str) -> float:
    """Return the expected root mean square of the innovations of an output."""
    expected = np.concatenate([r.innovation_std[output][np.isfinite(r.innovations[output])] for r in records])
    return float(np.sqrt(np.mean(expected**2))) if expected.size else math.nan


def _free(fit: FitResult, named: Any, values: Any) -> tuple[str, ...]:
    """Return the parameters to re-estimate."""
    model = fit.model
    if not isinstance(values, Mapping):
        raise OptionError(f"validate: values are given by parameter, such as {{'wind': 3.0}}, not as {values!r}")
    for name in values:
        _known_parameter(fit, str(name), "values")
    if named is None:
        return tuple(name for name in freed_by_default(model) if name not in values)
    if isinstance(named, str) or not np.iterable(named):
        raise OptionError(f"validate: biases is a list of names, such as ['b_q'], or () for none, not {named!r}")
    names = [str(name) for name in named]
    for name in names:
        _known_parameter(fit, name, "biases")
        if name in values:
            raise OptionError(f"validate: '{name}' is to be estimated (biases) and given (values): leave one out")
    return tuple(name for name in model.parameter_names if name in names)


def _known_parameter(fit: FitResult, name: str, where: str) -> None:
    names = fit.model.parameter_names
    if name in fit.noise_parameters:
        raise ModelError(f"validate: {where}: '{name}' belongs to the noise, which is fixed as in the fit")
    if name not in names:
        base = name.partition("[")[0]
        hint = f" Say '{base}', for all experiments." if base in names else did_you_mean(name, names)
        raise ModelError(f"validate: {where}: '{name}' is not a parameter of the model.{hint}")


def _held(fit: FitResult, free: Sequence[str], values: Mapping[str, Any]) -> dict[str, float]:
    """Return the values of the parameters that are not free."""
    held: dict[str, float] = {}
    own = []
    for name, declared in fit.model.declared_parameters.items():
        if name in free:
            continue
        if name in values:
            held[name] = finite(f"validate: the value of '{name}'", values[name], OptionError)
        elif declared.fixed:
            held[name] = declared.start
        elif declared.per_experiment:  # also of a fit to a single one: its value is that experiment's
            own.append(name)
        else:
            held[name] = fit.parameters[name].value
    if own:
        listed, one = ", ".join(f"'{name}'" for name in own), own[0]
        # Those that are estimated again are no longer found by themselves where some are named.
        named = ", ".join(f"'{name}'" for name in [*free, *own])
        raise ModelError(
            f"validate: each experiment of the fit has its own {listed}, and which value another one has is not known: "
            f"give it in values={{'{one}': ...}}, or name what is to be estimated again: biases=[{named}]"
        )
    return held


def _check(fit: FitResult, e: Experiment, free: Sequence[str]) -> tuple[str, ...]:
    """Return warnings on an experiment; raise DataError for one that cannot serve."""
    model = fit.model
    check_units(model, [e], "validate")
    there = {*e.channels}
    role = {n: "condition" if model.is_condition(n) else "input" for n in model.input_names}
    lacking = [f"{role[n]} '{n}'" for n in model.input_names if n not in there | {*e.inputs}]
    lacking += [f"output '{n}'" for n in model.output_names if n not in there | {*e.outputs}]
    if lacking:
        names = [*dict.fromkeys([*e.inputs, *e.outputs, *e.channels])]
        raise DataError(
            f"validate: experiment '{e.name}' lacks what the model has: {', '.join(lacking)}. "
            f"There are: {', '.join(names) or 'none'}. Use .rename({{...}}) where names differ."
        )
    measured = np.isfinite(np.array([e.output(n) for n in model.output_names]))
    samples, unknown = int(measured.any(axis=0).sum()), len(model.state_names) + len(free)
    if samples < unknown:
        raise DataError(
            f"validate: experiment '{e.name}' is too short: it has {samples} samples, and "
            f"{len(model.state_names)} initial states and {len(free)} biases are to be found from them"
        )
    for record in fit.records:
        same = shared(model, record, e)
        if same:
            what = f"shares {same} samples with" if same < e.n else "is" if e.n == record.n else "is part of"
            return (
                f"experiment '{e.name}' {what} the record '{record.name}' that the fit was made on: "
                "its goodness of fit does not show how the model predicts other manoeuvres",
            )
    return ()


def shared(model: Model, record: Record, e: Experiment) -> int:
    """Return the number of samples that are the same in both, at the same times; 0 where any common one differs."""
    _, i, j = np.intersect1d(record.t, e.t, return_indices=True)
    if i.size < _SHARED:
        return 0
    pairs = [(record.measured[n][i], e.output(n)[j]) for n in model.output_names]
    pairs += [(record.inputs[n][i], e.input(n)[j]) for n in model.input_names]
    return int(i.size) if all(np.array_equal(a, b, equal_nan=True) for a, b in pairs) else 0


def _start(fit: FitResult, slim: Model, held: Mapping[str, float], free: Sequence[str]) -> dict[str, float]:
    """Return start values: freed parameters at the fit's mean; states that no output measures at their mean over the
    fit."""
    start = {}
    for name in free:
        found = [e.value for e in estimates_of(fit.parameters, [name]).values()]
        if found:
            start[name] = float(np.mean(found))
    measured = measured_states(slim, {**held, **start})
    for name in slim.state_names:
        if name not in measured:
            start[name] = float(np.mean(np.concatenate([r.states[name] for r in fit.records])))
    return start


def _estimated(model: Model, free: Sequence[str], found: FitResult) -> int:
    """Return the number of initial states and parameters that were estimated."""
    conditions = len({(end, state) for end, state, _ in model.end_conditions})
    states = max(len(model.state_names) - conditions, 0) * len(found.records)
    return states + len(estimates_of(found.parameters, free))
