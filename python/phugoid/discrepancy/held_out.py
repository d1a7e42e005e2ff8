"""The gain of an extension on data that its parameters were not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from .._core import Expr
from ..errors import DataError, PhugoidError
from ..estimate import estimate
from ..experiment import Experiment
from ..model import Model
from ..rebuilt import rebuilt
from ..result import Fit
from .least_squares import Whitened, row_runs
from .linearised import Linearised
from .refit import Refit
from .whitening import Whitening

__all__ = ["across_blocks", "held", "on_other_data", "sensor_biases"]

_Array = NDArray[np.float64]

# Blocks of each record that are left out in turn.
_BLOCKS = 4


def across_blocks(base: Refit, more: Refit) -> tuple[float, float]:
    """Gain in whitened log-likelihood of the blocks of the records, each predicted by what the others say, and its
    standard deviation.

    Parameters are fitted without the block (one step of least squares from the fit to all), the path runs through it.
    """
    filter = more.own.filter
    total = np.zeros(more.linear.n_measured)
    each = [_left_out(r, filter) for r in (base, more)]
    total = each[1] - each[0]
    there = np.isfinite(total)
    d = total[there]
    return float(d.sum()), float(np.sqrt(d.size) * d.std())


def _left_out(refit: Refit, filter: Whitening) -> _Array:
    """(n_measured,) log-likelihood of each sample when its block was left out."""
    linear = refit.linear
    filter = filter.on(row_runs(linear))
    outputs, _ = linear.moves
    columns = filter((outputs * linear.scale()[:, None]).T).T
    e = filter(linear.residuals)
    block = _blocks(linear)
    errors = np.empty_like(e)
    for b in range(_BLOCKS):
        inside = block == b
        u, values, vt = np.linalg.svd(columns[~inside], full_matrices=False)
        kept = values > 1e-9 * values[:1]
        part = vt[kept].T @ ((u[:, kept].T @ e[~inside]) / values[kept])
        errors[inside] = e[inside] - columns[inside] @ part
    out = np.full(linear.n_measured, np.nan)
    out[linear.measured_rows] = -0.5 * errors**2
    return out


def _blocks(linear: Linearised) -> NDArray[np.intp]:
    """The block of each row."""
    block = np.empty(linear.n_rows, dtype=np.intp)
    for line in linear.rows:
        for e, rows in enumerate(line):
            t = linear.experiments[e].t
            share = (linear.times[rows] - t[0]) / (t[-1] - t[0])
            block[rows] = np.minimum((share * _BLOCKS).astype(np.intp), _BLOCKS - 1)
    return block


def sensor_biases(model: Model) -> set[str]:
    """Parameters that do no more than shift an output."""
    outputs = {name: Expr(e) for name, e in model.output_expressions().items()}
    known: dict[str, Any] = {}
    for name, e, *_ in model._core.quantities:
        known[name] = e.substitute(known)
    inside: set[str] = set()
    for _, e, *_ in model._core.dynamics:
        inside |= set(e.substitute(known).symbols)
    found = set()
    for name in set(model.parameter_names) - inside:
        slopes = [e.diff(name).constant for e in outputs.values() if name in e.symbols]
        if slopes and all(s is not None for s in slopes):
            found.add(name)
    return found


def held(fit: Fit, data: Sequence[Experiment]) -> Model:
    """The model of a fit with all its parameters fixed but the biases of sensors."""
    model = fit.model
    free = sensor_biases(model)
    values = {n: fit.parameters[n].value for n in model.parameter_names if n in fit.parameters}
    own = [n for n in model.parameter_names if n not in values and n not in free]
    if own:
        raise DataError(
            f"diagnose: {', '.join(own)} has a value for each experiment of the fit, so none for the validation record: "
            "leave validation out"
        )

    def declare(core: _core.Model, declared: Any) -> None:
        name, unit, start, low, high, prior, fixed, local, log, scale = declared
        start = values.get(name, start)
        own = local and len(data) > 1
        core.parameter(name, unit, start, low, high, prior, fixed or name not in free, own and name in free, log, scale)

    return model._around(rebuilt(model._core, model._core.inputs, declare), model.delays)


def on_other_data(refit: Refit, data: Sequence[Experiment]) -> Linearised:
    """A refit's model on other data, linearised: first states and biases are free, all else is as fitted.

    Raises PhugoidError where there is no such fit.
    """
    fit = refit.fit
    starts: Mapping[str, float] = {n: v for n, v in fit.as_start().items() if n.startswith("sigma_")}
    found = estimate(held(fit, data), data, transcription=fit.transcription, noise=fit.noise, start=dict(starts))
    if found.status not in ("converged", "acceptable", "unidentifiable"):
        raise PhugoidError(f"diagnose: the model cannot be fitted to the validation record: {found.message}")
    return Linearised(found)


def gain_on_other_data(base: Linearised, more: Linearised) -> tuple[float, float]:
    """Gain in log-likelihood on other data and its standard deviation, through the likeliest filter of the richer one."""
    from .least_squares import own_whitening

    own = own_whitening(more)
    other = Whitened(base, own.filter.on(row_runs(base)))
    d = own.log_densities - other.log_densities
    d = d[np.isfinite(d)]
    return float(d.sum()), float(np.sqrt(d.size) * d.std())
