"""What a plan assumes: the values of the parameters, the noise and the first states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..data.experiment import Experiment
from ..errors import ModelError, OptionError, listing
from ..fit_result import FitResult
from ..modelling.model import Model
from ..noise.noise import Gaussian

__all__ = ["first_states", "own_values", "sigmas_of", "source_of", "value_of", "values_of"]


def source_of(source: Any) -> tuple[Model, FitResult | None]:
    if isinstance(source, FitResult):
        return source.model, source
    if isinstance(source, Model):
        source.check()
        return source, None
    raise ModelError(f"plan: the first argument is a Model or a Fit, not a {type(source).__name__}")


def values_of(
    model: Model, fit: FitResult | None, runs: Sequence[Experiment], values: Mapping[str, Any] | None
) -> dict[str, float]:
    """Values for all parameters; those that each experiment has its own of also as name[experiment]."""
    found = {n: p.start for n, p in model.declared_parameters.items()}
    if fit is not None:
        # Of what differs from record to record, the first record's.
        own = {n: f"{n}[{fit.records[0].name}]" for n in found}
        found |= {n: fit.parameters[k].value for n in found for k in (own[n], n) if k in fit.parameters}
    local = {n for n, p in model.declared_parameters.items() if p.per_experiment}
    for n, v in (values or {}).items():
        base = str(n).partition("[")[0]
        if n not in found and not (base in local and n in {f"{base}[{run.name}]" for run in runs}):
            raise ModelError(f"plan: '{n}' is no parameter.{listing(str(n), list(found))}")
        try:
            found[str(n)] = float(v)
        except (TypeError, ValueError):
            raise ModelError(f"plan: the value of '{n}' is a number, not {v!r}") from None
    return found


def value_of(values: Mapping[str, float], name: str) -> float:
    return values[name] if name in values else values[name.partition("[")[0]]


def own_values(model: Model, values: Mapping[str, float], run: Experiment) -> dict[str, float]:
    return {n: values.get(f"{n}[{run.name}]", values[n]) for n in model.parameter_names}


def sigmas_of(model: Model, fit: FitResult | None, noise: Mapping[str, float] | None) -> dict[str, float]:
    names = model.output_names
    found: dict[str, float] = {}
    if isinstance(noise, Gaussian):
        noise = noise.known
    for n, s in (noise or {}).items():
        if n not in names:
            raise ModelError(f"plan: noise: '{n}' is not an output.{listing(str(n), names)}")
        if not isinstance(s, (int, float, np.number)) or not 0.0 < float(s) < np.inf:
            raise OptionError(f"plan: noise of '{n}' is a positive standard deviation, not {s!r}")
        found[n] = float(s)
    assumed = model.noise_model if fit is None else fit.noise
    plain = isinstance(assumed, Gaussian) and not assumed.correlated and assumed.covariance is None
    for n in [n for n in names if n not in found]:
        if plain and n in assumed.known_sigmas(names):
            found[n] = float(assumed.known_sigmas(names)[n])
        elif plain and fit is not None and f"sigma_{n}" in fit.parameters:
            found[n] = fit.parameters[f"sigma_{n}"].value
        else:
            raise OptionError(
                f"plan: the standard deviation of the noise of '{n}' is not known: give noise={{'{n}': ...}}"
                + ("" if plain else f" (that of the model is {assumed.description or assumed.kind})")
            )
    return {n: found[n] for n in names}


def first_states(model: Model, fit: FitResult | None, initial: Mapping[str, float] | None) -> dict[str, float]:
    found = {} if fit is None else {n: e.value for n, e in fit.initial_states[fit.records[0].name].items()}
    # What the model's conditions say follows from the values.
    held = {state for end, state, _ in model.conditions if end == "initial"}
    found = {n: v for n, v in found.items() if n not in held}
    for n, v in (initial or {}).items():
        if n not in model.state_names:
            raise ModelError(f"plan: initial '{n}' is no state.{listing(str(n), model.state_names)}")
        found[n] = float(v)
    return found
