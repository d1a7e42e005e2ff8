"""Options that several commands have, each declared once, and how their texts are read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from ..errors import OptionError
from ..tolerance import Tolerance

__all__ = [
    "DataArgument",
    "JsonOption",
    "ModelArgument",
    "PlotOption",
    "ReportOption",
    "fixes",
    "names",
    "numbers",
    "pairs",
    "span",
    "tolerances",
]

ModelArgument: TypeAlias = Annotated[
    str, typer.Argument(help="model.py, model.py:name, or a saved model or fit (.json, .h5).", metavar="MODEL")
]
DataArgument: TypeAlias = Annotated[list[Path], typer.Argument(help="Data files, one record each.", metavar="DATA...")]
PlotOption: TypeAlias = Annotated[
    Path | None,
    typer.Option("--plot", help="Writes the proof of match (.png, .pdf, .svg); several records, several files."),
]
ReportOption: TypeAlias = Annotated[Path | None, typer.Option("--report", help="Writes one HTML page with it all.")]
JsonOption: TypeAlias = Annotated[bool, typer.Option("--json", help="Results on stdout as JSON.")]


def pairs(option: str, texts: Sequence[str] | None) -> dict[str, str]:
    """``A=B`` of a repeated option, or several apart by commas.

    >>> pairs("--rename", ["a=b,c=d"])
    {'a': 'b', 'c': 'd'}
    """
    found: dict[str, str] = {}
    for text in (part for given in texts or () for part in given.split(",")):
        left, equals, right = (part.strip() for part in text.partition("="))
        if not (left and equals and right):
            raise OptionError(f"{option}: '{text}' is not of the form A=B")
        if left in found:
            raise OptionError(f"{option}: '{left}' is given twice")
        found[left] = right
    return found


def numbers(option: str, texts: Sequence[str] | None) -> dict[str, float]:
    """``NAME=VALUE`` with finite numbers.

    >>> numbers("--start", ["Mw=0.2", "Mq=-1e-3"])
    {'Mw': 0.2, 'Mq': -0.001}
    """
    return {name: _number(option, f"{name}={text}", text) for name, text in pairs(option, texts).items()}


def tolerances(texts: Sequence[str] | None) -> dict[str, Tolerance]:
    """``OUTPUT=VALUE``, ``OUTPUT=PART%`` or ``OUTPUT=VALUE/PART%``, whichever is greater.

    >>> tolerances(["V=1.5/5%", "q=0.01"])
    {'V': Tolerance(absolute=1.5, relative=0.05), 'q': Tolerance(absolute=0.01, relative=0.0)}
    """
    found = {}
    for name, text in pairs("--tolerance", texts).items():
        whole, parts = f"--tolerance {name}={text}", [part.strip() for part in text.split("/")]
        kinds = ["relative" if part.endswith("%") else "absolute" for part in parts]
        if len(set(kinds)) < len(kinds) or kinds[0] != min(kinds):
            raise OptionError(f"{whole}: is not of the form OUTPUT=VALUE, OUTPUT=PART% or OUTPUT=VALUE/PART%")
        numbers_of = {
            kind: _number("--tolerance", f"{name}={text}", part.rstrip("%")) / (100.0 if kind == "relative" else 1.0)
            for kind, part in zip(kinds, parts, strict=True)
        }
        try:
            found[name] = Tolerance(**numbers_of)
        except OptionError as error:
            raise OptionError(f"{whole}: {error}") from None
    return found


def fixes(texts: Sequence[str] | None, start: Mapping[str, float]) -> dict[str, float | None]:
    """``NAME`` or ``NAME=VALUE``; a name alone is held where it starts, None where that is as declared."""
    found: dict[str, float | None] = {}
    for text in (part.strip() for given in texts or () for part in given.split(",")):
        if "=" in text:
            found |= numbers("--fix", [text])
        else:
            found[text] = start.get(text)
    return found


def names(text: str | None) -> list[str] | None:
    """``A,B`` as a list."""
    return None if text is None else [name.strip() for name in text.split(",") if name.strip()]


def span(text: str | None) -> tuple[float, float] | None:
    """``T0,T1`` in s.

    >>> span("2,10.5")
    (2.0, 10.5)
    """
    if text is None:
        return None
    parts = text.split(",") if "," in text else text.split(":")
    if len(parts) != 2:
        raise OptionError(f"--window: '{text}' is not of the form T0,T1")
    return _number("--window", text, parts[0]), _number("--window", text, parts[1])


def _number(option: str, text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise OptionError(f"{option} {text}: '{number}' is not a finite number")
    return value
