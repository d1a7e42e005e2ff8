"""What a fit says of its model: the misfit, its causes, and the model that has them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ..errors import DataError, OptionError
from ..result import Fit
from ..saving import fit_file as saving
from ..saving import json_file as io
from ..saving.fit_file import damage, fit_from, fit_payload, fit_unit
from .misfit.misfit import Misfit, misfit
from .page.figures import findings_figure, gain_figure, misfit_figure, ranking_figure
from .page.page import report
from .page.words import diagnosis_summary
from .search.finding import Extension, Finding, Gain, Scored
from .search.refit import Refit
from .search.search import Search

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Diagnosis", "load"]


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
    interrupted whether the search was ended by Ctrl-C: what is here was found until then.
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


_T = TypeVar("_T", Finding, Scored, Gain)

# Version 1 of the format holds fits as they are in version 2 of theirs.
_FITS = {1: 2}


def save_diagnosis(d: Diagnosis, path: str | os.PathLike[str]) -> None:
    """What `Diagnosis.save` does; see there."""
    extension = d.extend() if any(f.cause for f in d.findings) else None
    payload = {
        "fit": fit_payload(d.fit),
        "misfit": d.misfit.summary(),  # for whoever reads the file: it is told anew from the fit
        "findings": [vars(f) for f in d.findings],
        "ranking": [vars(s) for s in d.ranking],
        "threshold": d.threshold,
        "notes": list(d.notes),
        "interrupted": d.interrupted,
        "seconds": d.seconds,
        "extension": extension
        and {"fit": fit_payload(extension.fit), "added": list(extension.added), "gain": vars(extension.gain)},
    }

    def unit(place: tuple[str | int, ...]) -> str:
        if place[0] == "fit":
            return fit_unit(d.fit, place[1:])
        if place[:2] == ("extension", "fit") and extension is not None:
            return fit_unit(extension.fit, place[2:])
        return ""

    io.save_fit_dict(path, payload, unit, io.DIAGNOSIS)


def load_diagnosis(path: str | os.PathLike[str]) -> Diagnosis:
    """Reads what `Diagnosis.save` wrote, in this version or an older one. Raises as `load` does."""
    saved, version = io.load_fit_dict(path, io.DIAGNOSIS)
    with damage(path):
        fit, more = fit_from(saved["fit"], _FITS[version]), saved["extension"]
        extension = None
        if more is not None:
            extended = fit_from(more["fit"], _FITS[version])
            extension = Extension(extended.model, extended, _texts(more["added"]), _made(Gain, more["gain"]))
        findings = tuple(_made(Finding, f) for f in saved["findings"])
        if extension is None and any(f.cause for f in findings):
            raise DataError("extension: is missing, although a cause is named")
        return Diagnosis(
            fit=fit,
            misfit=misfit(fit),
            findings=findings,
            ranking=tuple(_made(Scored, s) for s in saved["ranking"]),
            threshold=io.to_float(saved["threshold"]),
            notes=_texts(saved["notes"]),
            interrupted=bool(saved["interrupted"]),
            seconds=io.to_float(saved["seconds"]),
            _saved=extension,
        )


def _texts(values: Iterable[Any]) -> tuple[str, ...]:
    found = tuple(values)
    if isinstance(values, str) or not all(isinstance(text, str) for text in found):
        raise TypeError(f"texts are asked for, not {values!r:.60}")
    return found


def _pair(values: Any) -> tuple[float, float]:
    first, second = values
    return io.to_float(first), io.to_float(second)


def _text(value: Any) -> str:
    return _texts((value,))[0]


# How what is neither text nor a single number is read back.
_READ: Mapping[str, Callable[[Any], Any]] = {
    "aliases": _texts,
    "interval": _pair,
    "ringing": lambda each: tuple(map(io.to_float, each)),
    "parameters": lambda each: {name: _pair(pair) for name, pair in each.items()},
    "units": lambda each: dict(zip(each, _texts(each.values()), strict=True)),
    **dict.fromkeys(
        ("rivals", "estimate", "rms_before", "rms_after", "held_out_rms_before", "held_out_rms_after"),
        lambda each: {name: io.to_float(value) for name, value in each.items()},
    ),
}


def _made(kind: type[_T], saved: Mapping[str, Any]) -> _T:
    """From its fields; what a later version may add to them is no reason to fail."""
    read: dict[str, Callable[[Any], Any]] = {
        f.name: _READ.get(f.name, io.to_float if f.type == "float" else _text) for f in fields(kind)
    }
    return kind(**{name: read[name](value) for name, value in saved.items() if name in read})


def load(path: str | os.PathLike[str]) -> Any:
    """Reads what `Fit.save` or `Diagnosis.save` wrote, of this version or an older one: a `Fit` or a `Diagnosis`.

    What the file is shows from its content, not from its name.

    Raises DataError for a missing, damaged or newer file, MissingDependency for HDF5 without h5py.
    """
    return load_diagnosis(path) if io.format_of(path) == io.DIAGNOSIS else saving.load(path)
