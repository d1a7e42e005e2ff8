"""The part of a fit or a model that is exported, and the rules for names in C."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..data.interpolation import kind_of
from ..errors import ModelError, OptionError
from ..fit_result import FitResult
from ..linear.linearise import labels_of, numbers_of
from ..modelling.model import Model

__all__ = ["Contents", "checked_name", "contents_of", "identifier"]

# Words that are no names in C or C++.
_RESERVED = {
    "auto", "bool", "break", "case", "catch", "char", "class", "const", "continue", "default", "delete", "do",
    "double", "else", "enum", "extern", "float", "for", "friend", "goto", "if", "inline", "int", "long", "main",
    "namespace", "new", "operator", "private", "protected", "public", "register", "restrict", "return", "short",
    "signed", "sizeof", "static", "struct", "switch", "template", "this", "throw", "try", "typedef", "union",
    "unsigned", "using", "virtual", "void", "volatile", "while",
}  # fmt: skip


@dataclass(frozen=True)
class Contents:
    """What is exported: a model, values of its parameters, initial states and inputs, and facts on the origin."""

    model: Model
    values: Mapping[str, float]
    states: Mapping[str, float]
    inputs: Mapping[str, float]
    held: frozenset[str]  # inputs that are held between their samples in the experiment
    facts: tuple[str, ...]


def contents_of(
    caller: str,
    fit: FitResult | Model,
    parameters: Mapping[str, Any] | None,
    experiment: str | None,
    late_inputs: bool = False,
) -> Contents:
    """Return what to export of a fit or a model; raise ModelError where values or choices are missing."""
    model, values = numbers_of(caller, fit, parameters, experiment)
    if model.delays and not late_inputs:
        late = ", ".join([*model.delays.inputs, *model.delays.outputs])
        raise ModelError(
            f"{caller}: the model has delays ({late}), which functions of the present state cannot represent; with "
            f"{caller}(..., late_inputs=True) each late input is one of its own, which the caller delays"
        )
    states = dict.fromkeys(model.state_names, 0.0)
    inputs = dict.fromkeys(model.declared_inputs, 0.0)
    held: list[str] = []
    facts = [f"model: {model.name}"]
    if isinstance(fit, FitResult):
        labels = labels_of(caller, fit, experiment)
        record = next(r for r in fit.records if experiment in (None, r.name))
        own = [n for n, label in labels.items() if label != n and n not in (parameters or {})]
        if own and experiment is None and len(fit.records) > 1:
            raise ModelError(
                f"{caller}: each experiment has its own {own[0]}: say which, experiment='{record.name}', or give its "
                f"value, parameters={{'{own[0]}': ...}}"
            )
        states = {n: float(fit.initial_states[record.name][n]) for n in model.state_names}
        first = {n: float(v[0]) for n, v in record.inputs.items()}
        of_late = {name: of for name, (of, _) in model.delays.inputs.items()}
        inputs = {n: first[of_late.get(n, n)] for n in inputs}
        held = [n for n in inputs if kind_of(record.interpolation, of_late.get(n, n)) == "hold"]
        facts.append(f"fit: {fit.status}, log-likelihood {fit.log_likelihood:.10g}, experiment '{record.name}'")
    if held:
        facts.append(f"inputs held between samples: {', '.join(held)}")
    return Contents(model, values, states, inputs, frozenset(held), tuple(facts))


def identifier(text: str) -> str:
    """Return a name in C made of any text.

    >>> identifier("HFB-320 longitudinal"), identifier("1st try"), identifier("int")
    ('hfb_320_longitudinal', 'm_1st_try', 'int_')
    """
    found = re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_") or "model"
    found = f"m_{found}" if found[0].isdigit() else found
    return f"{found}_" if found in _RESERVED else found


def checked_name(name: str) -> str:
    """Return a name that is valid in C; raise OptionError for any other."""
    if not (isinstance(name, str) and re.fullmatch(r"[A-Za-z]\w*", name, flags=re.ASCII)) or name in _RESERVED:
        raise OptionError(f"export: {name!r} is no name in C: letters, digits and underscores, a letter first")
    return name
