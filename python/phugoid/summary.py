"""The fit in plain text: how the run went, the parameters, the noise, and how well each output is matched."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .errors import PhugoidError
from .match import match
from .parameters import Estimates, estimates_table, text_table

__all__ = ["corrected", "fit_summary"]


def fit_summary(fit: Any) -> str:
    """An aligned table for the terminal.

    ``fit`` needs the attributes model (with .name), parameters (`Estimates`; noise as ``sigma_<output>``),
    status, message, iterations, log_likelihood, records (of `Record`), time (s) and transcription (a text).
    """
    outputs = list(dict.fromkeys(name for record in fit.records for name in record.outputs))
    noise_names = {f"sigma_{name}" for name in outputs}
    if getattr(fit, "noise", None) is not None:
        noise_names.update(fit.noise.names(tuple(outputs)))

    def of_noise(name: str) -> bool:  # also of a single experiment, as in sigma_q[run 1]
        return name in noise_names or (name.endswith("]") and name.partition("[")[0] in noise_names)

    noise = [e for e in fit.parameters.values() if of_noise(e.name)]
    physical = [e for e in fit.parameters.values() if not of_noise(e.name)]
    parts = [_header(fit)]
    coloured = corrected(fit) if getattr(fit, "experiments", ()) else None
    if physical:
        parts.append(estimates_table(physical, coloured=coloured))
    if noise:
        parts.append(estimates_table(noise, title="noise", coloured=coloured))
    if coloured:
        parts.append("std error: Cramér-Rao, for white residuals; coloured: for residuals as coloured as they are")
    parts += getattr(getattr(fit, "correlation", None), "notes", ())
    if any(record.residuals for record in fit.records):
        parts.append(_match_table(fit, outputs))
    return "\n\n".join(parts)


def corrected(fit: Any, again: bool = False) -> Estimates | None:
    """The estimates with standard errors for coloured residuals; None where a fit has none, or where they take much
    more time than the fit. ``again``: also where they need another estimation."""
    from .uncertainty.tangents import cheap

    if not cheap(fit, again):
        return None
    try:
        found: Estimates = fit.coloured.parameters
    except PhugoidError:  # what the page is of has its reasons
        return None
    return found if np.isfinite(found.std_errors_array).any() else None


def _header(fit: Any) -> str:
    samples = sum(record.n for record in fit.records)
    mesh = sum(record.mesh_t.size for record in fit.records)
    runs = f"{len(fit.records)} experiments, " if len(fit.records) > 1 else ""
    entries = {
        "status": f"{fit.status}: {fit.message}" if fit.message else str(fit.status),
        "iterations": f"{fit.iterations} in {_duration(fit.time)}",
        "log-likelihood": f"{fit.log_likelihood:.3f}",
        "data": f"{runs}{samples} samples" + (f", {mesh} mesh points" if mesh else ""),
        "transcription": str(fit.transcription),
    }
    noise = getattr(getattr(fit, "noise", None), "description", "")
    if noise:
        entries["noise"] = noise
    width = max(map(len, entries))
    lines = [f"  {key.ljust(width)}  {text}" for key, text in entries.items()]
    return "\n".join([str(fit.model.name), *lines])


def _match_table(fit: Any, outputs: list[str]) -> str:
    """Per output, over all experiments: σ, RMS of residuals or innovations, R² about the mean of each, samples."""
    rows = []
    for name in outputs:
        m = match([r for r in fit.records if name in r.residuals], name)
        sigma = fit.parameters.get(f"sigma_{name}")
        rms, r_squared = (f"{m.rms:.4g}", f"{m.r_squared:.4f}")
        known = (rms if math.isfinite(m.rms) else "", r_squared if math.isfinite(m.r_squared) else "")
        rows.append([name, "" if sigma is None else f"{sigma.value:.4g}", known[0], m.unit, known[1], str(m.samples)])
    size = "RMS innovation" if any(record.innovations for record in fit.records) else "RMS residual"
    return text_table(["output", "σ", size, "unit", "R²", "samples"], rows, "lrrlrr")


def _duration(seconds: float) -> str:
    if seconds < 1.0:
        return f"{1e3 * seconds:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 120.0 else f"{seconds / 60.0:.1f} min"
