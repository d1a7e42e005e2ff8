"""The record that a flight-path reconstruction leaves for the next step."""

from __future__ import annotations

import numpy as np

from .. import _core
from ..data.experiment import Experiment
from ..data.interpolation import kinds_for
from ..errors import ModelError
from ..modelling.model import Model
from ..records import Record
from ..result import Fit

__all__ = ["corrected"]

_SUFFIX = "_true"


def corrected(fit: Fit, record: Record, run: Experiment) -> Experiment:
    """A record with inertial channels at the centre of gravity and without bias, and states in place of what measured
    them; its other channels as they were. All are channels, which serve as inputs or as outputs."""
    model = fit.model
    quantities = {n.removesuffix(_SUFFIX): n for n, *_ in model._core.quantities if n.endswith(_SUFFIX)}
    if "V" not in model.state_names or "q" not in quantities:
        raise ModelError(f"'{model.name}' is no model of a flight path: make one with models.flight_path")
    known: dict[str, _core.Expr] = {}
    for n, e, *_ in model._core.quantities:
        known[n] = e.substitute(known)
    only = Model(model.name)
    only.states(*model.state_names)
    only.inputs(*model.input_names)
    used = {symbol for n in quantities.values() for symbol in known[n].symbols}
    parameters = [n for n in model.parameter_names if n in used]
    if parameters:
        only.parameters(*parameters)
    only.dynamics(**dict.fromkeys(model.state_names, 0.0))
    only.outputs(**{n: known[n] for n in quantities.values()})
    own = fit._own(record.name)
    theta = np.array([own[n] for n in parameters])
    states = [record.states[n] for n in model.state_names]
    columns = np.vstack([record.t, *(record.inputs[n] for n in model.input_names), *states])
    found = dict(zip(quantities, _core.Evaluator(only._core).outputs(theta, columns), strict=True))
    found |= {n: np.asarray(v) for n, v in record.states.items()}
    channels = {**run.channels, **run.outputs, **run.inputs, **found}
    units = {**run.units, **{n: model.units[n] for n in found if n in model.units}}
    made = Experiment(
        run.t, name=run.name, interpolation=kinds_for(run.interpolation, channels), channels=channels, units=units
    )
    # Inputs with samples of their own, such as controls, keep them; those of the inertial sensors are used up.
    kept = {n: s for n, s in run._signals.items() if n not in found}
    return made._sampled(kept, run.mesh_times)._after(run, f"flight path reconstructed: {', '.join(found)}")
