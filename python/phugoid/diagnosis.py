"""Diagnoses, extensions and improvements with the functions on them as methods: what `diagnose` and `improve` return.

Their fits are of the class that the caller has: `Fit`, which stands above this module.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Generic, TypeVar

from .discrepancy.improve import ImprovementResult
from .discrepancy.page import diagnosis_summary, headline
from .discrepancy.page import report as diagnosis_report
from .discrepancy.page.figures import (
    diagnosis_figure,
    diagnosis_figures,
    explained_figure,
    findings_figure,
    gain_figure,
    ranking_figure,
)
from .discrepancy.saved import save_diagnosis
from .discrepancy.search.finding import DiagnosisResult, ExtensionResult, Findings
from .errors import DataError
from .fit_result import FitResult
from .notebook import Html, bullets, notebook_page, paragraph
from .summary import fit_html

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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

    def plot(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot the result in one figure: what each finding explains of the misfit (`plot_explained`); where no finding
        has such a part, the ranking of the candidates (`plot_ranking`), and without candidates the misfit
        (`plot_misfit`). Return the figure and its axes by name; `figures` draws all figures."""
        return diagnosis_figure(self)

    def plot_explained(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot which part of the misfit each finding explains in free simulation of held-out data, with 95 % intervals,
        and by how much the mean square of each output falls.

        Returns the figure and the axes by ``"explained"`` and ``"outputs"``. Raises DataError where no finding has such
        a part.
        """
        return explained_figure(self.findings)

    def plot_misfit(self, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the residuals of the fit that was diagnosed, as `Misfit.plot` does."""
        return self.misfit.plot(channels)

    def plot_ranking(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot by how much each of the best candidates would raise the log-likelihood, to first order.

        Returns the figure and the axes by ``"ranking"``. Raises DataError where no candidates were ranked.
        """
        return ranking_figure(self.ranking, self.threshold)

    def plot_extension(self, channels: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the residuals before and after the extension, and by how much it changes the outputs of the model.

        channels  names; None: the three whose RMS falls most.

        Returns the figure and the axes by ``"<channel>"`` and ``"<channel> change"``. Raises UnknownName for a channel
        that is not there, DataError where the diagnosis named nothing to add.
        """
        return findings_figure(self.fit, self._with_additions("plot_extension"), channels)

    def plot_gain(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot the RMS of the residuals with the extension, in per cent of that without it, for each channel.

        Returns the figure and the axes by ``"gain"``. Raises DataError where the diagnosis named nothing to add.
        """
        return gain_figure(self._with_additions("plot_gain").gain, self.fit.model.units)

    def _with_additions(self, function: str) -> Extension[_F]:
        if not self.found:
            raise DataError(f"{function}: the diagnosis named no cause, so there is no extended model to compare with")
        return self.extend()

    def figures(self) -> list[Figure]:
        """Draw all figures of the diagnosis and return them: what findings explain, the misfit, curves of disturbances
        and unknown functions, the ranking of candidates, and what the extension changes, as far as there are such."""
        return diagnosis_figures(self)

    def report(self, path: str | os.PathLike[str], *, minor: bool = False) -> None:
        """Write one HTML page that a colleague understands: the misfit, the cause and other candidates for it, the
        evidence, the new equations, the gain. These are of the named causes; with ``minor`` they are those of
        ``extend(minor=True)``."""
        diagnosis_report(self, path, minor=minor)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the diagnosis, for `load`: fit, findings, ranking, misfit in words, extended model with fit and gain.

        HDF5 where the suffix is ``.h5`` or ``.hdf5``, else JSON; raises as `Fit.save` does.
        `load` returns all of this, with ``summary``, ``plot``, ``figures`` and ``report``; the misfit is computed again
        from the residuals of the fit.
        """
        save_diagnosis(self, path)

    def _repr_html_(self) -> str:
        worst = self.misfit.table_html(most=3)
        return notebook_page(
            f"{self.fit.model.name}: diagnosis",
            paragraph(headline(self)),
            Findings(self.findings).table_html(),
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
