"""What was found to be missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

__all__ = ["Finding", "Scored"]


@dataclass(frozen=True)
class Scored:
    """A candidate in the first scan: what one linearisation about the fit says of it, before anything is refitted.

    name            canonical, ``where:what``.
    explanation     in plain words.
    estimate        one-step estimates of its coefficients and shape by name, in the model's units; empty where the
                    parameters already there can do all that it does.
    statistic       expected gain in TWICE the log-likelihood, noise as coloured as the residuals of the fit are. Below
                    `Diagnosis.threshold` it may well be chance.
    ranking         the same, noise as coloured as the residuals are without the best few terms: what
                    `Diagnosis.ranking` is sorted by. (A strong effect colours the residuals, and so hides in the
                    first noise.)
    white           the same, noise taken as white: too much, wherever residuals are coloured.
    distinct        part of its effect on the outputs that the parameters there cannot imitate, 0 to 1. Where it is
                    small, they would change much with this candidate added.
    remark          what to beware of, in words, or "".
    """

    name: str
    explanation: str
    estimate: Mapping[str, float]
    statistic: float
    ranking: float
    white: float
    distinct: float
    remark: str = ""


@dataclass(frozen=True)
class Finding:
    """One thing that the model misses.

    cause          canonical name, ``where:what`` (`candidates`); "" where the cause is not established.
    aliases        other causes that the data do not tell from it, the likeliest first, three at most: read the finding
                   as "one of cause and aliases".
    status         "named"; "surrogate": it fits, but a parameter is outside of what is physical, so it stands in for
                   something else; "unexplained": the residuals hold more than noise, and no candidate predicts it.
    coefficient, std_error, interval   of its first parameter, in ``unit``; the interval is of 95 %. NaN where
                   unexplained. Standard errors are those for noise as coloured as the residuals.
    parameters     all its parameters: name in the extended model -> (value, standard error).
    gain           in log-likelihood (once, not twice), noise as coloured as the residuals, over the model with all
                   other findings but this.
    held_out_gain  the same on data held out: the validation records, else blocks of the fit's own, predicted from the
                   others. Below zero the finding is not to be relied on. NaN where the search was interrupted.
    threshold      that ``gain`` had to pass: with none there, chance reaches it once in a hundred diagnoses.
    explanation    of the cause, in plain words.
    advice         which manoeuvre would tell it from its aliases, or that none of those tried would; "" without
                   aliases, or where no manoeuvre stays within the envelope of the records.
    rivals         alias -> gain in log-likelihood that it would have in place of the cause.
    units          parameter -> unit, for words.
    ringing        Hz, of lightly damped modes of the model at which the residuals ring, where the misfit is that and is
                   unexplained; ``gain`` is then by noise that does not ring.
    """

    cause: str
    aliases: tuple[str, ...]
    status: Literal["named", "surrogate", "unexplained"]
    coefficient: float
    std_error: float
    interval: tuple[float, float]
    unit: str
    parameters: Mapping[str, tuple[float, float]]
    gain: float
    held_out_gain: float
    threshold: float
    explanation: str
    advice: str = ""
    rivals: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    ringing: tuple[float, ...] = ()
