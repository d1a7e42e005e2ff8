"""Notes on a search, in words."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from ..data.experiment import Experiment
from ..errors import some
from ..modelling.model import Model
from .candidates.candidate import Candidate
from .search.refit import Refit
from .search.scan import Scan

__all__ = ["notes_of_shared_terms", "search_notes"]

# How a search ended before its end, in words.
_EARLY = {"interrupted": "The search was interrupted", "time limit": "The search reached its time limit"}
# Candidates without a direction of their own that a note names.
_LOST_NAMED, _RECORDS_NAMED = 12, 4


def notes_of_shared_terms(model: Model, declared: Collection[str]) -> list[str]:
    """Return what the quantities stand for that were declared for the search."""
    added = [f"{n} = {e}" for n, e in model.quantity_expressions().items() if n not in declared]
    return [f"Quantities were declared for what equations share: {'; '.join(added)}."] if added else []


def _shares(model: Model) -> bool:
    """Return whether several state equations have a parameter in common."""
    right = model._right_hand_sides()
    within = [{*e.symbols} for (kind, _), e in right.items() if kind == "equation"]
    return any(sum(n in symbols for symbols in within) > 1 for n in model.parameter_names)


def search_notes(
    scan: Scan | None,
    final: Refit,
    listed: Sequence[Candidate],
    others: Sequence[Experiment],
    free: Sequence[str] | None,
    ended: str,
    most: int,
) -> tuple[str, ...]:
    """Return notes on a search: how many candidates were ``listed``, and what the first ``scan`` left of them (None
    where it was not reached); on which data held out, the ``others``, gains were computed, with what ``free``; and how
    the search ``ended`` before its end ("" where it did not), or after the ``most`` findings that it may have."""
    if scan is None:
        return (f"{_EARLY[ended]} before the {len(listed)} candidates were scanned: only the misfit is reported.",)
    notes = [f"{len(listed)} candidates were scanned, with {len(scan.effects)} values of their shape parameters."]
    if scan.lost:
        notes.append(f"Indistinguishable from parameters of the model: {some(scan.lost, _LOST_NAMED)}.")
    if others:
        what = "sensor biases" if free is None else ", ".join(free) or "nothing else"
        notes.append(
            f"Gains were computed on {some([e.name for e in others], _RECORDS_NAMED)}, with initial states and {what} "
            "re-estimated."
        )
    else:
        notes.append(
            "Gains were computed by cross-validation: each quarter of the record was predicted from the others."
        )
    if len(final.candidates) >= most:
        notes.append(f"The search ends after {most} findings: diagnose the extended fit to continue.")
    if not final.fit.model.quantity_names and _shares(final.fit.model):
        notes.append(
            "The model declares no quantities. Of a force, a flow or a rate that several equations share, candidates "
            "act on all of them at once where it is declared by m.quantities(...)."
        )
    if ended:
        notes.append(f"{_EARLY[ended]}: the results up to then are given.")
    return tuple(notes)
