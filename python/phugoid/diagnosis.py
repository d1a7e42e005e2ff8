"""A diagnosis with all that can be asked of it: what `diagnose` returns."""

from __future__ import annotations

import os
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING

from .discrepancy.improve import ImprovementResult
from .discrepancy.page.figures import diagnosis_figures
from .discrepancy.page.page import report
from .discrepancy.page.words import diagnosis_summary, headline
from .discrepancy.saved import save_diagnosis
from .discrepancy.search.finding import DiagnosisResult, ExtensionResult
from .notebook import Html, bullets, notebook_page, paragraph, table
from .result import Fit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "Extension", "Improvement"]


class Extension(ExtensionResult):
    """What `Diagnosis.extend` gives: the extended ``model``, its ``fit`` to the same data, names of what was ``added``
    (canonical, ``where:what``), and the ``gain``."""

    fit: Fit

    def _repr_html_(self) -> str:
        title = f"{self.model.name}, extended by {', '.join(self.added) or 'nothing'}"
        return notebook_page(title, Html(self.gain._repr_html_()), Html(self.fit._repr_html_()))


class Diagnosis(DiagnosisResult):
    """What `diagnose` finds.

    fit         that was diagnosed; with inputs between samples as the data tell where ``notes`` say that straight lines
                are wrong there.
    misfit      what it gets wrong: per channel, when, in which regime, at which frequencies.
    findings    what is missing, in the order in which it was found.
    verdict     "named", "unexplained", "surrogate", "minor" or "nothing": what it comes to.
    ranking     all candidates of the first scan with their statistics, in the order of `Scored.ranking`.
    threshold   that twice the gain in log-likelihood of a candidate with one coefficient has to pass; findings have
                theirs, in log-likelihood itself.
    notes       what was done, in words.
    interrupted whether the search was ended by Ctrl-C or its time limit: what is here was found until then.
    seconds     that it took.
    """

    fit: Fit

    @classmethod
    def _of(cls, result: DiagnosisResult) -> Diagnosis:
        """Return a diagnosis with the data of a result."""
        return cls(**{f.name: getattr(result, f.name) for f in fields(result)} | {"fit": Fit._of(result.fit)})

    def extend(self, *, minor: bool = False) -> Extension:
        """The model with all causes that are named, its fit, and the gain over the base model; with ``minor`` minor
        findings, surrogates, and unknown functions as tables, too. With nothing to add it is the model as it was, and
        ``added`` is empty."""
        return self._extended_full if minor else self._extended

    @cached_property
    def _extended(self) -> Extension:
        found = super().extend()
        return Extension(found.model, Fit._of(found.fit), found.added, found.gain)

    @cached_property
    def _extended_full(self) -> Extension:
        found = super().extend(minor=True)
        return Extension(found.model, Fit._of(found.fit), found.added, found.gain)

    def summary(self) -> str:
        """What was found, in plain words."""
        return diagnosis_summary(self)

    def plot(self) -> list[Figure]:
        """Figures: the misfit and the ranking of candidates; before them what findings explain, and after them what the
        extension changes and gains, where there are any."""
        return diagnosis_figures(self)

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
        save_diagnosis(self, path)

    def _repr_html_(self) -> str:
        rows = [f.cells() for f in self.findings]
        heads = list(rows[0]) if rows else []
        found = table(heads, [list(row.values()) for row in rows], "llllrrr")
        worst = self.misfit.table_html(most=3)
        return notebook_page(
            f"{self.fit.model.name}: diagnosis",
            paragraph(headline(self)),
            found,
            worst,
            bullets(self.notes),
            note=self.verdict,
        )

    def __str__(self) -> str:
        return self.summary()


class Improvement(ImprovementResult):
    """What `improve` came to.

    fit      of the last model.
    steps    diagnoses, one after the other, each with what was ``added``, ``rejected`` and why,
             and the ``gain``.
    added    names of all that was added, in order.
    verdict  what the last diagnosis came to.
    """

    fit: Fit

    @classmethod
    def _of(cls, result: ImprovementResult) -> Improvement:
        """Return an improvement with the data of a result."""
        steps = tuple(replace(step, diagnosis=Diagnosis._of(step.diagnosis)) for step in result.steps)
        return cls(Fit._of(result.fit), steps)
