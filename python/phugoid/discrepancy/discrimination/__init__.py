"""Manoeuvres that would distinguish a cause from its aliases.

Planned manoeuvres are simulated with the model that has the cause, and with one that has an alias in its place, each as
estimated. Let e be the difference of their outputs, in the metric of the fitted noise, less what a change of the
alias's parameters and initial states can produce. Then e'e/2 is the expected gain in log-likelihood of the cause over
this alias from data of that manoeuvre alone. (The Kullback-Leibler distance of the two models there, as in designs of
experiments that discriminate between models: Atkinson and Fedorov, Biometrika 62, 1975.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...data.experiment import Experiment
from ...errors import PhugoidError, joined
from ...time_unit import SECONDS, TimeUnit
from ..candidates.candidate import Candidate
from ..misfit.phrases import number
from ..search import Search, SearchResult
from ..search.refit import Refit
from .candidate_manoeuvres import GREATEST, KINDS, CandidateManoeuvre, CandidateManoeuvres

__all__ = [
    "DISCRIMINATES",
    "Advice",
    "DiscriminatingManoeuvre",
    "advice_of",
    "advised",
    "discrimination_advice",
]


# An expected gain in log-likelihood that distinguishes two models almost certainly.
DISCRIMINATES = 6.0


@dataclass(frozen=True)
class DiscriminatingManoeuvre:
    """A manoeuvre that distinguishes a cause from alternatives.

    manoeuvre  what to fly.
    record     its times and inputs, from the state in which the first record begins.
    gains      alternative -> expected gain in log-likelihood of the cause over it.
    here       gain over the likeliest of these in the records at hand.
    """

    manoeuvre: CandidateManoeuvre
    record: Experiment
    gains: dict[str, float]
    here: float

    def __str__(self) -> str:
        length = f"{number(float(self.record.t[-1] - self.record.t[0]))} {self.manoeuvre.time_unit}"
        return (
            f"A {self.manoeuvre}, recorded for {length}, is expected to distinguish it from "
            f"{joined(tuple(self.gains), 'and')} (expected gain in log-likelihood {number(min(self.gains.values()))}, "
            f"{_so_far(self.here)})."
        )


def _so_far(gain: float) -> str:
    """Return what the records at hand say of a cause against its likeliest alternative."""
    if gain < -0.05:
        return f"the present records are {-gain:.1f} in favour of the likeliest of these"
    return f"the present records give {gain:.1f}"


@dataclass(frozen=True)
class Advice:
    """Say what to fly.

    manoeuvres  each for the aliases that the preceding ones do not distinguish from the cause.
    alike       aliases that none distinguishes from it.
    tried       inputs that were moved; none where there was no admissible manoeuvre.
    length      of a manoeuvre and what follows at most, in ``time_unit``.
    """

    manoeuvres: tuple[DiscriminatingManoeuvre, ...]
    alike: tuple[str, ...]
    tried: tuple[str, ...]
    length: float
    time_unit: TimeUnit = SECONDS

    def __str__(self) -> str:
        """Return the advice in words; "" where there was no admissible manoeuvre."""
        sentences = [str(t) for t in self.manoeuvres]
        if self.alike and self.tried:
            sentences.append(
                f"No manoeuvre of {joined(self.tried, 'or')} tried here ({KINDS}; {number(self.length)} "
                f"{self.time_unit}, up to {GREATEST:g} times the amplitude of this record) is expected to distinguish "
                f"it from {joined(self.alike, 'or')}."
            )
        return " ".join(sentences)


def discrimination_advice(final: Refit, alternatives: Sequence[Refit]) -> str:
    """Return `advised` in words; "" where there was no admissible manoeuvre."""
    return str(advised(final, alternatives))


def advised(final: Refit, alternatives: Sequence[Refit]) -> Advice:
    """Return the manoeuvre that would best distinguish the cause in ``final`` from another one in its place, in each of
    ``alternatives``.

    Manoeuvres of each control that moved in the records are tried, the other inputs constant, from the state in which
    the first record begins. Those that leave the envelope of the records are not considered: the models are not known
    to be valid there. The one chosen distinguishes the cause from most of ``alternatives``; among equals it has the
    greatest smallest gain. There is no advice on a disturbance, since that differs from record to record.
    """
    names = [next(n for n in r.names if n not in final.names) for r in alternatives]
    nothing = Advice((), tuple(names), (), 0.0)
    if any(not c.transferable for r in alternatives for c in final.candidates if c.name not in r.names):
        return nothing
    flyable = CandidateManoeuvres(final)
    if not flyable.manoeuvres:
        return nothing
    with np.errstate(over="ignore", invalid="ignore"):  # manoeuvres that ran away
        found = np.array([flyable.gains(r, DISCRIMINATES) for r in alternatives]).reshape(
            len(alternatives), -1
        )  # (alternatives, manoeuvres)
    gains = np.nan_to_num(found)
    here = [final.own.log_likelihood - r.own.log_likelihood for r in alternatives]
    open_ = [k for k in range(len(alternatives)) if gains[k].max() >= DISCRIMINATES]
    # Of an alternative that has no solution anywhere there is nothing to say.
    alike = tuple(n for k, n in enumerate(names) if k not in open_ and np.isfinite(found[k]).any())
    chosen = []
    while open_:
        decided = gains[open_] >= DISCRIMINATES
        least = np.where(decided, gains[open_], np.inf).min(axis=0)
        best = int(np.lexsort((least, decided.sum(axis=0)))[-1])
        mine = [k for k in open_ if gains[k, best] >= DISCRIMINATES]
        over = {names[k]: float(gains[k, best]) for k in mine}
        chosen.append(
            DiscriminatingManoeuvre(flyable.manoeuvres[best], flyable.record(best), over, min(here[k] for k in mine))
        )
        open_ = [k for k in open_ if k not in mine]
    tried = tuple(dict.fromkeys(m.input for m in flyable.manoeuvres))
    return Advice(tuple(chosen), alike, tried, float(flyable.t[-1] - flyable.t[0]), final.fit.model.time_unit)


def advice_of(search: Search, result: SearchResult, candidate: Candidate | None, aliases: Sequence[str]) -> str:
    """Return which manoeuvre would distinguish a candidate from its aliases; "" without aliases, and after Ctrl-C."""
    if candidate is None or not aliases:
        return ""
    try:
        return _advice(search, result.of(candidate), candidate, aliases)
    except (PhugoidError, np.linalg.LinAlgError, KeyboardInterrupt):
        return ""  # advice only: what was found stays


def _advice(search: Search, final: Refit, candidate: Candidate, aliases: Sequence[str]) -> str:
    others = [c for c in final.candidates if c is not candidate]
    named = search.cache.by_name
    refits = [search.cache.refit([*others, named[name]], final.fit) for name in aliases]
    # Another finding may have an alias of this one for its cause.
    alternatives = [r for r in refits if r is not None and not {*r.names} <= {*final.names}]
    if not alternatives:
        return ""
    search.cache.watch(f"looking for a manoeuvre that distinguishes {candidate.name} from {', '.join(aliases)}")
    return discrimination_advice(final, alternatives)
