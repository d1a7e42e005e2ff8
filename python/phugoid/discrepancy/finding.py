"""What was found to be missing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

__all__ = ["Finding", "Scored"]


@dataclass(frozen=True)
class Scored:
    """A candidate in a scan: what one linearisation about the fit says of it.

    name            of the candidate.
    explanation     in plain words.
    estimate        one-step estimates of its coefficients and shape by name.
    statistic       twice the gain in log-likelihood expected of it, residuals whitened by the filter of the base fit.
    ranking         the same, by the filter of the residuals without the best few terms.
    white           the same, residuals taken as white.
    distinct        part of its effect on the outputs that the parameters there cannot imitate, 0 to 1.
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

    cause          canonical name; "" where the cause is not established.
    aliases        other causes that the data do not tell from it, the likeliest first (three at most).
    status         "named"; "surrogate": it fits, but its coefficient is outside what is physical; or "unexplained".
    coefficient, std_error, interval   of its first parameter, with unit ``unit``; the interval is of 95 %.
    parameters     all its parameters: name -> (value, standard error).
    gain           in log-likelihood, residuals whitened.
    held_out_gain  the same on data that the parameters were not fitted to.
    threshold      that the gain had to pass.
    explanation    of the cause, in plain words.
    advice         which manoeuvre would tell it from its aliases, or that none of those tried would; "" without
                   aliases, or where no manoeuvre stays within the envelope of the records.
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
    rivals: Mapping[str, float] = field(default_factory=dict)  # alias -> gain it would have instead
