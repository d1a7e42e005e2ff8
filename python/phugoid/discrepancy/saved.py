"""Diagnoses saved and loaded, as fits are (`saving`), with the fits that they are about."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

from ..errors import DataError
from ..saving import damage, fit_from, fit_payload, fit_unit
from ..saving import files as io
from .search.finding import DiagnosisResult, ExtensionResult, Finding, Gain, Scored

__all__ = ["load_diagnosis", "save_diagnosis"]

_T = TypeVar("_T", Finding, Scored, Gain)

# Version 1 of the format holds fits as they are in version 2 of theirs.
_FITS = {1: 2}


def save_diagnosis(d: DiagnosisResult, path: str | os.PathLike[str]) -> None:
    """Write a diagnosis; see `Diagnosis.save`."""
    extension = d.extend() if d.found else None
    payload = {
        "fit": fit_payload(d.fit),
        "misfit": d.misfit.summary(),  # for those who read the file; computed again from the fit
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


def load_diagnosis(path: str | os.PathLike[str]) -> DiagnosisResult:
    """Read what `Diagnosis.save` wrote, in this version or an older one. Raises as `load` does."""
    saved, version = io.load_fit_dict(path, io.DIAGNOSIS)
    with damage(path):
        fit, more = fit_from(saved["fit"], _FITS[version]), saved["extension"]
        extension = None
        if more is not None:
            extended = fit_from(more["fit"], _FITS[version])
            extension = ExtensionResult(extended.model, extended, _texts(more["added"]), _made(Gain, more["gain"]))
        findings = tuple(_made(Finding, f) for f in saved["findings"])
        if extension is None and any(f.status == "named" for f in findings):
            raise DataError("extension: is missing, although a cause is named")
        found = DiagnosisResult(
            fit=fit,
            findings=findings,
            ranking=tuple(_made(Scored, s) for s in saved["ranking"]),
            threshold=io.to_float(saved["threshold"]),
            notes=_texts(saved["notes"]),
            interrupted=bool(saved["interrupted"]),
            seconds=io.to_float(saved["seconds"]),
            _extension=extension,
        )
        _ = found.misfit  # what is damaged shows now
        return found


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


# Fields of files of earlier versions, and their present names.
_FORMER = {"rivals": "alternatives", "rivals_explained": "alternatives_explained"}
# How what is neither text nor a single number is read back.
_READ: Mapping[str, Callable[[Any], Any]] = {
    "aliases": _texts,
    "interval": _pair,
    "explained_interval": _pair,
    "explained_another": _pair,
    "ringing": lambda each: tuple(map(io.to_float, each)),
    **dict.fromkeys(
        ("curve", "surface"),
        lambda each: {name: tuple(map(io.to_float, values)) for name, values in each.items()},
    ),
    "parameters": lambda each: {name: _pair(pair) for name, pair in each.items()},
    "units": lambda each: dict(zip(each, _texts(each.values()), strict=True)),
    **dict.fromkeys(
        (
            "alternatives",
            "estimate",
            "explained_outputs",
            "alternatives_explained",
            "rms_before",
            "rms_after",
            "held_out_rms_before",
            "held_out_rms_after",
        ),
        lambda each: {name: io.to_float(value) for name, value in each.items()},
    ),
}


def _made(kind: type[_T], saved: Mapping[str, Any]) -> _T:
    """Return an object from its fields; what a later version may add to them is no reason to fail."""
    saved = {_FORMER.get(name, name): value for name, value in saved.items()}
    read: dict[str, Callable[[Any], Any]] = {
        f.name: _READ.get(f.name, io.to_float if f.type == "float" else _text) for f in fields(kind)
    }
    return kind(**{name: read[name](value) for name, value in saved.items() if name in read})
