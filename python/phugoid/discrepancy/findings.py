"""Findings and the ranking of candidates, from a search."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import PhugoidError
from .candidates.candidate import Candidate
from .search.finding import Finding, Scored
from .search.refit import Refit
from .search.scan import NEARLY, Scan
from .search.search import Found, Search, is_physical
from .telling.telling import telling_manoeuvre

__all__ = ["advice_of", "finding_of", "ranking_of"]


# Aliases that are named beside a cause.
_ALIASES = 3
_INTERVAL = 1.959963984540054  # 95 % of a normal distribution
_UNEXPLAINED = "the residuals hold more than noise, but no candidate predicts data that were held out"
_AGAIN = (
    "Repeat the same input: what repeats in the residuals is no noise. Then a smaller and a larger one: they tell what "
    "depends on amplitude."
)


def finding_of(search: Search, final: Refit, found: Found) -> Finding:
    """What a search found, as it is told: with the estimate in the final model, and how to tell it from its aliases."""
    aliases = tuple(found.rivals)[:_ALIASES]
    if found.candidate is None:
        nothing = float("nan")
        return Finding(
            cause="",
            aliases=aliases,
            status="unexplained",
            coefficient=nothing,
            std_error=nothing,
            interval=(nothing, nothing),
            unit="",
            parameters={},
            gain=found.gain,
            held_out_gain=found.held_out[0],
            threshold=found.threshold,
            explanation=_rings(found.ringing) if found.ringing else _UNEXPLAINED,
            advice=_AGAIN if found.ringing else "",
            rivals=dict(found.rivals),
            ringing=found.ringing,
        )
    c = found.candidate
    parameters = final.parameters(c)
    name = next(iter(parameters))
    value, error = parameters[name]
    return Finding(
        cause=c.name,
        aliases=aliases,
        status="named" if is_physical(final, c) else "surrogate",
        coefficient=value,
        std_error=error,
        interval=(value - _INTERVAL * error, value + _INTERVAL * error),
        unit=final.fit.parameters[name].unit,
        parameters=parameters,
        gain=found.gain,
        held_out_gain=found.held_out[0],
        threshold=found.threshold,
        explanation=c.explanation,
        units={n: final.fit.parameters[n].unit for n in parameters},
        rivals=dict(found.rivals),
    )


def _rings(frequencies: Sequence[float]) -> str:
    at = ", ".join(f"{f:.3g}" for f in frequencies)
    return (
        f"the residuals ring at {at} Hz, a lightly damped mode of the model: that is a term that it lacks, or "
        "disturbances that came through the vehicle. Candidates halve the mean square on data held out, but beside "
        "noise that rings so this is no proof of one"
    )


def advice_of(search: Search, final: Refit, candidate: Candidate | None, aliases: Sequence[str]) -> str:
    """Which manoeuvre would tell a candidate from its aliases; "" where there are none, and after Ctrl-C."""
    if candidate is None or not aliases:
        return ""
    try:
        return _advice(search, final, candidate, aliases)
    except (PhugoidError, np.linalg.LinAlgError, KeyboardInterrupt):
        return ""  # advice only: what was found stays


def _advice(search: Search, final: Refit, candidate: Candidate, aliases: Sequence[str]) -> str:
    others = [c for c in final.candidates if c is not candidate]
    named = {c.name: c for c in reversed(search.candidates)}
    refits = [search.refit([*others, named[name]], final.fit) for name in aliases]
    rivals = [r for r in refits if r is not None]
    if not rivals:
        return ""
    search.watch(f"looking for a manoeuvre that tells {candidate.name} from {', '.join(aliases)}")
    return telling_manoeuvre(final, rivals)


def ranking_of(search: Search, scan: Scan) -> list[Scored]:
    """All candidates, each at its best shape."""
    through = {"base": search.base.own.filter, "clean": scan.clean(), "white": scan.white.filter}
    values = {which: scan.through(filter) for which, filter in through.items()}
    best: dict[str, int] = {}
    for i in np.argsort(-values["clean"].values):
        best.setdefault(scan.effects[i][0].name, int(i))
    found = []
    for name, i in best.items():
        candidate, shape = scan.effects[i]
        distinct = float(scan.distinct[i])
        remark = "hardly to be told from the parameters already there" if distinct < NEARLY else ""
        amplitude = values["clean"].amplitudes[i].tolist()
        estimate = {**dict(zip(candidate.coefficients, amplitude, strict=False)), **shape}
        base, clean, white = (float(v.values[i]) for v in values.values())
        found.append(Scored(name, candidate.explanation, estimate, base, clean, white, distinct, remark))
    by_name = {c.name: c for c in search.candidates}
    for name in scan.lost:
        remark = "cannot be told from the parameters already there"
        found.append(Scored(name, by_name[name].explanation, {}, 0.0, 0.0, 0.0, 0.0, remark))
    return found
