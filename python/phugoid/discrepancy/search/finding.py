"""Findings of a diagnosis, the model extended by them, its gain, and the diagnosis that contains them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

from ...data.experiment import Experiment
from ...errors import OptionError, counted
from ...fit_result import FitResult
from ...modelling.model import Model
from ...notebook import Html, notebook_page, paragraph, sparkline, table
from ...parameters import plus_minus, text_table
from ...renamed import Renamed
from ..misfit import ChannelMisfit
from ..misfit.misfit import Misfit, misfit

__all__ = ["DiagnosisResult", "ExtensionResult", "Finding", "Findings", "Gain", "Scored"]

# Part of the residuals' power that their past predicts, from which on they are reported to have structure.
_STRUCTURE = 0.05


def _tells(channel: ChannelMisfit) -> bool:
    return channel.structured and channel.predictable >= _STRUCTURE and not channel.within_resolution


@dataclass(frozen=True)
class Scored:
    """A candidate in the first scan: what one linearisation about the fit says of it, before anything is refitted.

    name            canonical, ``where:what``.
    explanation     in plain words.
    estimate        one-step estimates of its coefficients and shape by name, in the model's units; empty where the
                    parameters already there can do all that it does.
    statistic       expected gain in TWICE the log-likelihood, for noise with the autocorrelation of the fit's
                    residuals. Below `Diagnosis.threshold` it may well be chance.
    ranking         the same, for the autocorrelation of the residuals without the best few terms: what
                    `Diagnosis.ranking` is sorted by. (A strong effect colours the residuals, and so hides in the
                    first noise.)
    white           the same, noise taken as white: too much, wherever residuals are coloured.
    distinct        part of its effect on the outputs that the parameters there cannot imitate, 0 to 1. Where it is
                    small, they would change much with this candidate added.
    remark          a caution, in words, or "".
    """

    name: str
    explanation: str
    estimate: Mapping[str, float]
    statistic: float
    ranking: float
    white: float
    distinct: float
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A finding of a diagnosis: an effect that the model misses, with its evidence.

    cause          canonical name, ``where:what`` (`candidates`); "" where the cause is not established.
    aliases        other causes that the data do not distinguish from it, the likeliest first, three at most: one of
                   the cause and its aliases is present.
    status         "named"; "minor": significant, but it explains less of the misfit than 5 %, or no more than chance
                   does, in free simulation; "surrogate": it fits, but represents another cause, since a parameter
                   is outside its physical range, the remaining misfit is not noise and exceeds what it explains, or
                   data held out ask for another shape or size of it; "unexplained": the residuals hold more than
                   noise, and no candidate predicts it.
    coefficient, std_error, interval   of its first parameter, or the amplitude of what is periodic, in ``unit``; the
                   interval is of 95 %. NaN where unexplained. Standard errors are those for noise with the
                   autocorrelation of the residuals.
    parameters     all its parameters: name in the extended model -> (value, standard error).
    gain           in log-likelihood (once, not twice), for that noise, over the model with all
                   other findings but this.
    held_out_gain  the same on data held out: the validation records, else blocks of the fit's own, predicted from the
                   others. Below zero the finding is not to be relied on. NaN where the search was interrupted.
    threshold      that ``gain`` had to pass: with none there, chance reaches it once in a hundred diagnoses.
    explanation    of the cause, in plain words.
    advice         which manoeuvre would distinguish it from its aliases, or that none of those tried would; "" without
                   aliases, or where no manoeuvre stays within the envelope of the records.
    alternatives   candidate -> gain in log-likelihood that it would have in place of the cause.
    units          parameter -> unit, for words.
    ringing        Hz, of lightly damped modes of the model at which the residuals ring, where the misfit is that and is
                   unexplained; ``gain`` is then by noise that does not ring.
    explained      the part of the misfit that it explains beside the other findings, 1 for all, in free simulation of
                   data held out: only initial states and biases are estimated there. The misfit is the mean square of
                   the residuals of the model diagnosed, less that of their innovations. NaN where unexplained.
    explained_in   the data of which ``explained`` is a part. What differs from record to record is estimated in each,
                   and so explains a part of the misfit of the fitted records; all else is simulated in data held out.
    explained_interval   of 95 %, by a block bootstrap over time.
    explained_another    95 % prediction interval of that part on another record of the same kind and length.
    explained_outputs    output -> by how much its mean square falls, in parts of that of the model diagnosed.
    explained_of_the_rest    where ``explained`` is less than 5 %: the part that it explains of the misfit that the
                   other findings leave; it is named where that is most of it and more than 0.25 % of all, and
                   where only noise is left with it. NaN else.
    alternatives_explained   candidate -> part of the misfit that it would explain in place of the cause.
    curve          of a disturbance or an unknown function: what is added to its place, ``"value"``, with standard
                   deviations, ``"error"``, at times (s) or values of the variable, ``"at"``; of a function the number
                   of samples nearest to each value, ``"samples"``, too; all (k,). Else empty.
    surface        the same of an unknown function of two variables: ``"value"``, ``"error"`` and ``"samples"``,
                   (k m,), at values ``"first"`` (k,) of the first and ``"second"`` (m,) of the second, which varies
                   quickest. Else empty.
    """

    cause: str
    aliases: tuple[str, ...] = ()
    status: Literal["named", "minor", "surrogate", "unexplained"]
    coefficient: float = math.nan
    std_error: float = math.nan
    interval: tuple[float, float] = (math.nan, math.nan)
    unit: str = ""
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    gain: float = math.nan
    held_out_gain: float = math.nan
    threshold: float = math.nan
    explanation: str
    advice: str = ""
    alternatives: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    ringing: tuple[float, ...] = ()
    explained: float = math.nan
    explained_in: Literal["data held out", "the fitted records"] = "data held out"
    explained_interval: tuple[float, float] = (math.nan, math.nan)
    explained_another: tuple[float, float] = (math.nan, math.nan)
    explained_outputs: Mapping[str, float] = field(default_factory=dict)
    explained_of_the_rest: float = math.nan
    alternatives_explained: Mapping[str, float] = field(default_factory=dict)
    curve: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)
    surface: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)

    rivals = Renamed("alternatives")
    rivals_explained = Renamed("alternatives_explained")

    @property
    def is_drawn(self) -> bool:
        """Return whether there is a curve or a surface to draw."""
        return bool(self.curve or self.surface)

    def cells(self) -> dict[str, str]:
        """Return what tables in notebooks show of it: a short text by heading, "" where there is none."""
        known = {"explains": 100.0 * self.explained, "gain": self.gain, "held out": self.held_out_gain}
        cells = {name: f"{value:.3g}" if math.isfinite(value) else "" for name, value in known.items()}
        estimate = f"{plus_minus(self.coefficient, self.std_error)} {self.unit}".strip()
        return {
            "cause": self.cause or "not established",
            "status": self.status,
            "not distinguished from": ", ".join(self.aliases),
            "estimate": estimate if math.isfinite(self.coefficient) else "",
            "explains": f"{cells['explains']} %" if cells["explains"] else "",
            "gain": cells["gain"],
            "held out": cells["held out"],
        }

    def _repr_html_(self) -> str:
        rows = [[name, text] for name, text in self.cells().items() if name != "cause" and text]
        if self.curve:
            rows.append(["curve", sparkline(self.curve["value"], t=self.curve["at"])])
        parts = paragraph(self.explanation), table(["", ""], rows, "ll"), paragraph(self.advice)
        return notebook_page(self.cells()["cause"], *parts)


@dataclass(frozen=True)
class Gain:
    """Extended model minus base model.

    log_likelihood           of the measurements, as fitted.
    log_likelihood_whitened  the same where each has the coloured noise (autoregressive) that is likeliest for it, so
                             that slow residuals do not count for more evidence than they are; the figure to go by.
    bic                      Schwarz's criterion, -2 log L + k log n: below zero is better.
    held_out                 in log-likelihood, whitened, on data that no parameter was fitted to; NaN without any.
    rms_before, rms_after    channel -> RMS of the residuals, in its unit.
    held_out_rms_before, held_out_rms_after   the same on the data held out; empty where there are none.
    """

    log_likelihood: float
    log_likelihood_whitened: float
    bic: float
    held_out: float
    rms_before: Mapping[str, float]
    rms_after: Mapping[str, float]
    held_out_rms_before: Mapping[str, float] = field(default_factory=dict)
    held_out_rms_after: Mapping[str, float] = field(default_factory=dict)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(self.rms_before)

    def as_fitted(self, before: FitResult, after: FitResult, n_rows: int) -> Gain:
        """Return the same with the likelihood and the criterion of two other fits to the same ``n_rows``
        measurements."""
        white = after.log_likelihood - before.log_likelihood
        more = len(after.parameters) - len(before.parameters)
        return replace(self, log_likelihood=white, bic=-2.0 * white + more * math.log(n_rows))

    def change(self, channel: str, *, held_out: bool = False) -> float:
        """RMS after over RMS before, minus 1: -0.2 is a fifth less. NaN where there is none."""
        before, after = (
            (self.held_out_rms_before, self.held_out_rms_after) if held_out else (self.rms_before, self.rms_after)
        )
        if not before.get(channel, 0.0) > 0.0 or channel not in after:
            return float("nan")
        return after[channel] / before[channel] - 1.0

    def summary(self) -> str:
        """Return a table for the terminal."""
        heads, rows = self._table()
        lines = [
            f"log-likelihood  {self.log_likelihood:+.1f} (white noise)",
            f"                {self.log_likelihood_whitened:+.1f} (coloured noise)",
        ]
        if self.held_out == self.held_out:
            lines.append(f"                {self.held_out:+.1f} (held-out data, coloured noise)")
        lines.append(f"BIC             {self.bic:+.1f} (negative: better)")
        return "\n".join(lines) + "\n\n" + text_table(heads, rows, "l" + "r" * (len(heads) - 1))

    def _repr_html_(self) -> str:
        heads, rows = self._table()
        note = f"in log-likelihood {self.log_likelihood_whitened:+.1f} with coloured noise"
        if self.held_out == self.held_out:
            note += f"; {self.held_out:+.1f} on data held out"
        return notebook_page("Gain", table(heads, rows, "l" + "r" * (len(heads) - 1)), note=note)

    def _table(self) -> tuple[list[str], list[list[str]]]:
        held_out = bool(self.held_out_rms_before)
        rows = []
        for name in self.channels:
            row = [name, *map(_number, (self.rms_before[name], self.rms_after[name])), _percent(self.change(name))]
            if held_out:
                before, after = self.held_out_rms_before.get(name), self.held_out_rms_after.get(name)
                row += [_number(before), _number(after)]
                row.append(_percent(self.change(name, held_out=True)))
            rows.append(row)
        heads = ["channel", "RMS before", "after", "change"]
        return heads + (["held out before", "after", "change"] if held_out else []), rows


@dataclass(frozen=True, eq=False, repr=False)
class ExtensionResult:
    """The data of an extension: the extended ``model``, its ``fit`` to the same data, names of what was ``added``
    (canonical, ``where:what``), and the ``gain``."""

    model: Model
    fit: FitResult
    added: tuple[str, ...]
    gain: Gain

    def __repr__(self) -> str:
        return f"<Extension of '{self.model.name}' by {', '.join(self.added) or 'nothing'}>"


def _number(value: float | None) -> str:
    return "" if value is None or value != value else f"{value:.4g}"


def _percent(change: float) -> str:
    return "" if change != change else f"{round(100.0 * change):+d} %"


class Findings(tuple[Finding, ...]):
    """The findings of a diagnosis in their order: a tuple, which notebooks show as a table."""

    def table_html(self) -> Html:
        """Return a row for each finding, as HTML; nothing without any."""
        rows = [f.cells() for f in self]
        return table(list(rows[0]), [list(row.values()) for row in rows], "llllrrr") if rows else Html("")

    def _repr_html_(self) -> str:
        return notebook_page(counted(len(self), "finding"), self.table_html())


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult:
    """The data of a `Diagnosis`, which says what each attribute is."""

    fit: FitResult
    findings: tuple[Finding, ...]
    ranking: tuple[Scored, ...]
    threshold: float
    notes: tuple[str, ...]
    interrupted: bool
    seconds: float
    _extension: ExtensionResult | None = None  # None where it comes from a file, and nothing was named
    # With minor findings, surrogates, unknown functions; None where it is the same.
    _full: ExtensionResult | None = None
    # Causes of inputs that act otherwise than they are recorded, and the validation records with these as they act.
    _inputs: tuple[str, ...] = ()
    _validation: tuple[Experiment, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "findings", Findings(self.findings))

    @cached_property
    def misfit(self) -> Misfit:
        """The misfit of the diagnosed model, computed when it is first asked for: a diagnosis that ends at
        its time limit has no time for it."""
        return misfit(self.fit)

    @property
    def found(self) -> bool:
        """Return whether a cause is named."""
        return any(f.status == "named" for f in self.findings)

    @property
    def verdict(self) -> Literal["named", "minor", "surrogate", "unexplained", "nothing", "interrupted"]:
        """What the diagnosis comes to: the first of these that there is.

        "named"        a cause that is significant both by the likelihood and in free simulation.
        "unexplained"  residuals with structure, and no cause that is named: at least a finding that says so, or an
                       output of which 5 % of the residuals' power, or more, is more than white noise.
        "surrogate", "minor"   findings of that status only, and residuals without more structure than that.
        "nothing"      residuals that are not significantly coloured, as far as these data show.
        "interrupted"  nothing was found by the time the search was ended, which is not a statement about the model.
        """
        statuses = {f.status for f in self.findings}
        if "named" in statuses:
            return "named"
        if self.interrupted and not statuses:
            return "interrupted"
        if "unexplained" in statuses or self.structured_outputs:
            return "unexplained"
        if statuses:
            return "surrogate" if "surrogate" in statuses else "minor"
        return "nothing"

    @cached_property
    def remaining(self) -> Misfit:
        """The misfit of the model with all named causes, computed when it is first asked for."""
        return self.misfit if self._extension is None else misfit(self._extension.fit)

    @property
    def is_extended(self) -> bool:
        """Return whether the extended model has all named causes; disturbances and faults of the data have no term."""
        added = () if self._extension is None else self._extension.added
        return self.found and all(f.cause in added for f in self.findings if f.status == "named")

    @property
    def structured_outputs(self) -> tuple[str, ...]:
        """Outputs whose residuals, in the model that was diagnosed, have structure worth a word; the worst first."""
        channels = self.misfit.channels
        return tuple(n for n in self.misfit.worst if _tells(channels[n]))

    def extend(self, *, minor: bool = False) -> ExtensionResult:
        """Return the model with all causes that are named, its fit, and the gain over the base model; with ``minor``
        minor findings, surrogates, and unknown functions as tables, too."""
        found = self._full or self._extension if minor else self._extension
        if found is None:
            raise OptionError("extend: nothing was named when this diagnosis was saved, so there is no extended model")
        return found

    def __repr__(self) -> str:
        what = ", ".join(f.cause or f.status for f in self.findings) or "nothing"
        return f"<Diagnosis of '{self.fit.model.name}': {what}>"
