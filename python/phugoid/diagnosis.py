"""Diagnoses, extensions and improvements with the functions on them as methods: what `diagnose` and `improve` return.

Their fits are of the class that the caller has: `Fit`, which stands above this module.
"""

from __future__ import annotations

import os
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic, TypeVar

from .discrepancy.improve import ImprovementResult
from .discrepancy.page import diagnosis_summary, headline
from .discrepancy.page import report as diagnosis_report
from .discrepancy.page.figures import diagnosis_figures
from .discrepancy.saved import save_diagnosis
from .discrepancy.search.finding import DiagnosisResult, ExtensionResult
from .fit_result import FitResult
from .notebook import Html, bullets, notebook_page, paragraph, table
from .summary import fit_html

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "Extension", "Improvement"]

_F = TypeVar("_F", bound=FitResult)


class Extension(ExtensionResult, Generic[_F]):
    """The result of `Diagnosis.extend`: the extended ``model``, its ``fit`` to the same data, the names of the causes
    ``added`` (canonical, ``where:what``), and the ``gain``."""

    fit: _F

    def _repr_html_(self) -> str:
        title = f"{self.model.name}, extended by {', '.join(self.added) or 'nothing'}"
        return notebook_page(title, Html(self.gain._repr_html_()), Html(fit_html(self.fit)))


class Diagnosis(DiagnosisResult, Generic[_F]):
    """The result of `diagnose`.

    fit         that was diagnosed; with inputs between samples as the data indicate where ``notes`` say that straight
                lines are wrong there.
    misfit      what it gets wrong: per channel, when, in which regime, at which frequencies.
    findings    what is missing, in the order in which it was found.
    verdict     "named", "unexplained", "surrogate", "minor", "nothing" or "interrupted": the conclusion.
    ranking     all candidates of the first scan with their statistics, in the order of `Scored.ranking`.
    threshold   that twice the gain in log-likelihood of a candidate with one coefficient has to pass; findings have
                theirs, in log-likelihood itself.
    notes       what was done, in words.
    interrupted whether the search was ended by Ctrl-C or its time limit: what is here was found until then.
    seconds     that it took.
    """

    fit: _F

    @classmethod
    def _of(cls, result: DiagnosisResult, fits: type[_F]) -> Diagnosis[_F]:
        """Return a diagnosis with the data of a result, its fit one of the class ``fits``."""
        return cls(**{f.name: getattr(result, f.name) for f in fields(result)} | {"fit": fits._of(result.fit)})

    def extend(self, *, minor: bool = False) -> Extension[_F]:
        """Return the model with all named causes, its fit, and the gain over the base model; with ``minor`` minor
        findings, surrogates, and unknown functions as tables, too. With nothing to add it is the unchanged model, and
        ``added`` is empty."""
        return self._extended_full if minor else self._extended

    @cached_property
    def _extended(self) -> Extension[_F]:
        found = super().extend()
        return Extension(found.model, type(self.fit)._of(found.fit), found.added, found.gain)

    @cached_property
    def _extended_full(self) -> Extension[_F]:
        found = super().extend(minor=True)
        return Extension(found.model, type(self.fit)._of(found.fit), found.added, found.gain)

    def summary(self) -> str:
        """Return the findings in plain words."""
        return diagnosis_summary(self)

    def plot(self) -> list[Figure]:
        """Plot the misfit and the ranking of candidates; before them the parts explained by findings, and after them
        the changes and gains of the extension, where there are any. Return the figures."""
        return diagnosis_figures(self)

    def report(self, path: str | os.PathLike[str]) -> None:
        """Write one HTML page that a colleague understands: what was wrong, the evidence, the cause and its rivals, the
        new equation, the gain."""
        diagnosis_report(self, path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the diagnosis, for `load`: fit, findings, ranking, misfit in words, extended model with fit and gain.

        HDF5 where the suffix is ``.h5`` or ``.hdf5``, else JSON; raises as `Fit.save` does.
        `load` returns all of this, with ``summary``, ``plot`` and ``report``; the misfit is computed again from the
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


class Improvement(ImprovementResult, Generic[_F]):
    """The result of `improve`.

    fit      of the last model.
    steps    diagnoses, one after the other, each with what was ``added``, ``rejected`` and why,
             and the ``gain``.
    added    names of all added causes, in order.
    verdict  conclusion of the last diagnosis.
    """

    fit: _F

    @classmethod
    def _of(cls, result: ImprovementResult, fits: type[_F]) -> Improvement[_F]:
        """Return an improvement with the data of a result, its fits of the class ``fits``."""
        steps = tuple(replace(step, diagnosis=Diagnosis._of(step.diagnosis, fits)) for step in result.steps)
        return cls(fits._of(result.fit), steps)
