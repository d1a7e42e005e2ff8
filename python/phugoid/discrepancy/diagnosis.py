"""What a fit says of its model: the misfit, its causes, and the model that has them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import OptionError
from ..result import Fit
from .misfit.misfit import Misfit
from .page.figures import findings_figure, gain_figure, misfit_figure, ranking_figure
from .page.page import report
from .page.words import diagnosis_summary
from .search.extension import Extension, Gain
from .search.finding import Finding, Scored
from .search.refit import Refit
from .search.search import Search

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis"]


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What `diagnose` finds.

    fit         that was diagnosed.
    misfit      what it gets wrong: per channel, when, in which regime, at which frequencies.
    findings    what is missing, in the order in which it was found.
    ranking     all candidates of the first scan with their statistics, in the order of `Scored.ranking`.
    threshold   that twice the gain in log-likelihood of a candidate with one coefficient has to pass; findings have
                theirs, in log-likelihood itself.
    notes       what was done, in words.
    interrupted whether the search was ended by Ctrl-C or its time limit: what is here was found until then.
    seconds     that it took.
    """

    fit: Fit
    misfit: Misfit
    findings: tuple[Finding, ...]
    ranking: tuple[Scored, ...]
    threshold: float
    notes: tuple[str, ...]
    interrupted: bool
    seconds: float
    _search: Search | None = None
    _final: Refit | None = None
    _saved: Extension | None = None  # where it comes from a file

    @property
    def found(self) -> bool:
        """Whether anything significant is missing."""
        return bool(self.findings)

    def extend(self) -> Extension:
        """The model with all terms that were found, its fit, and the gain over the base model."""
        return self._extension

    @cached_property
    def _extension(self) -> Extension:
        if self._saved is not None:
            return self._saved
        if self._search is None or self._final is None:
            raise OptionError("extend: nothing was named when this diagnosis was saved, so there is no extended model")
        base, final, search = self._search.base, self._final, self._search
        n = base.linear.n_rows
        more = len(final.fit.model.parameter_names) - len(base.fit.model.parameter_names)
        white = final.fit.log_likelihood - base.fit.log_likelihood
        names = base.fit.model.output_names
        gain = Gain(
            log_likelihood=white,
            log_likelihood_whitened=search.gain(base, final) / 2,
            bic=-2.0 * white + more * float(np.log(n)),
            held_out=search.held_out(base, final)[0] if final.candidates else 0.0,
            rms_before=_rms(base.fit.records, names),
            rms_after=_rms(final.fit.records, names),
            held_out_rms_before=search.held_out_rms(base),
            held_out_rms_after=search.held_out_rms(final),
        )
        return Extension(final.fit.model, final.fit, final.names, gain)

    def summary(self) -> str:
        """What was found, in plain words."""
        return diagnosis_summary(self)

    def plot(self) -> list[Figure]:
        """Figures: the misfit, the ranking of candidates; where something was found, what it explains and gains."""
        figures = [misfit_figure(self.misfit, self.fit)[0]]
        if self.ranking:
            figures.append(ranking_figure(self.ranking, self.threshold)[0])
        if self._saved is not None or (self._final is not None and self._final.candidates):
            extension = self.extend()
            figures.append(findings_figure(self.fit, extension)[0])
            figures.append(gain_figure(extension.gain, self.fit.model.units)[0])
        return figures

    def report(self, path: str | os.PathLike[str]) -> None:
        """Writes one HTML page that a colleague understands: what was wrong, the evidence, the cause and its rivals,
        the new equation, the gain."""
        report(self, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the diagnosis, for `load`: fit, findings, ranking, misfit in words, extended model with fit and gain.

        HDF5 where the suffix is ``.h5`` or ``.hdf5``, else JSON; raises as `Fit.save` does.
        What `load` gives has all of this, ``summary``, ``plot`` and ``report`` too; the misfit is told anew from the
        fit's residuals.
        """
        from .saved import save_diagnosis

        save_diagnosis(self, path)

    def __repr__(self) -> str:
        what = ", ".join(f.cause or f.status for f in self.findings) or "nothing"
        return f"<Diagnosis of '{self.fit.model.name}': {what}>"

    def __str__(self) -> str:
        return self.summary()


def _rms(records: Any, names: Sequence[str]) -> dict[str, float]:
    """Over all records."""
    found = {}
    for name in names:
        r = np.concatenate([record.residuals[name] for record in records])
        found[name] = float(np.sqrt(np.nanmean(r**2)))
    return found
