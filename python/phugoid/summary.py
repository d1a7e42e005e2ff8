"""The fit in plain text: status, parameters, noise, and the goodness of fit of each output."""

from __future__ import annotations

import math

import numpy as np

from .errors import PhugoidError
from .fit_result import FitResult
from .goodness_of_fit import match
from .notebook import bullets, notebook_page, sparkline, table
from .parameters import Estimate, Estimates, estimates_html, estimates_table, facts_text, text_table
from .sensitivities.tangents import cheap
from .uncertainty.coloured import coloured
from .uncertainty.correlation import correlation

__all__ = ["corrected", "fit_html", "fit_summary"]


def fit_summary(fit: FitResult) -> str:
    """Return aligned tables for the terminal, and the warnings; see `Fit.summary`."""
    outputs = _outputs(fit)
    physical, noise = _groups(fit)
    parts = [facts_text(str(fit.model.name), _entries(fit))]
    errors = corrected(fit) if fit.experiments else None
    if physical:
        parts.append(estimates_table(physical, coloured=errors))
    if noise:
        parts.append(estimates_table(noise, title="noise", coloured=errors))
    if errors:
        parts.append("std error: Cramér-Rao, for white residuals; corrected: for residual autocorrelation")
    parts += correlation(fit).notes
    if any(record.residuals for record in fit.records):
        parts.append(text_table(*_match_rows(fit, outputs), _MATCH))
    parts += (each.summary() for each in (fit.refinement, fit.smoothing) if each)
    parts += (f"Warning: {w}" for w in fit.warnings)
    return "\n\n".join(parts)


def fit_html(fit: FitResult) -> str:
    """Return the fit as a notebook shows it: how it ended, parameters, how each output matches, and the warnings."""
    physical, _ = _groups(fit)
    errors = corrected(fit) if fit.experiments else None
    entries = _entries(fit)
    ended = f"{entries['iterations']} ({entries['transcription']}), {entries['data']}"
    heads, rows = _match_rows(fit, _outputs(fit))
    pictured = [[*row, _picture(fit, row[0])] for row in rows]
    return notebook_page(
        str(fit.model.name),
        bullets([f"iterations: {ended}", f"log-likelihood {entries['log-likelihood']}"]),
        estimates_html(physical, coloured=errors),
        table([*heads, "measured and model"], pictured, _MATCH + "l"),
        bullets(fit.warnings),
        note=entries["status"],
    )


def _picture(fit: FitResult, name: str) -> str:
    """Return the picture of the output in the first record that measured it."""
    record = next((r for r in fit.records if name in r.measured), None)
    return "" if record is None else sparkline(record.measured[name], record.outputs[name], record.t)


def _outputs(fit: FitResult) -> list[str]:
    return list(dict.fromkeys(name for record in fit.records for name in record.outputs))


def _groups(fit: FitResult) -> tuple[list[Estimate], list[Estimate]]:
    """Return the estimates of the model, and of the noise."""
    of_noise = fit.noise_parameters - fit._intensities
    noise = [e for e in fit.parameters.values() if e.name in of_noise]
    return [e for e in fit.parameters.values() if e.name not in of_noise], noise


def corrected(fit: FitResult, again: bool = False) -> Estimates | None:
    """Return the estimates with standard errors for coloured residuals; None where a fit has none, or where they take
    much more time than the fit. ``again``: also where they need another estimation."""
    if not cheap(fit, again):
        return None
    try:
        found = coloured(fit).parameters
    except PhugoidError:  # no correction for this fit
        return None
    return found if np.isfinite(found.std_errors_array).any() else None


def _entries(fit: FitResult) -> dict[str, str]:
    """Return the facts of the run, by heading."""
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
    if fit.noise.description:
        entries["noise"] = fit.noise.description
    return entries


_MATCH = "lrrlrr"


def _match_rows(fit: FitResult, outputs: list[str]) -> tuple[list[str], list[list[str]]]:
    """Return heads, and for each output over all experiments: σ, RMS of residuals or innovations, R², samples."""
    rows = []
    for name in outputs:
        m = match([r for r in fit.records if name in r.residuals], name)
        sigma = fit.parameters.get(f"sigma_{name}")
        rms, r_squared = (f"{m.rms:.4g}", f"{m.r_squared:.4f}")
        known = (rms if math.isfinite(m.rms) else "", r_squared if math.isfinite(m.r_squared) else "")
        rows.append([name, "" if sigma is None else f"{sigma.value:.4g}", known[0], m.unit, known[1], str(m.samples)])
    size = "RMS innovation" if any(record.innovations for record in fit.records) else "RMS residual"
    return ["output", "σ", size, "unit", "R²", "samples"], rows


def _duration(seconds: float) -> str:
    if seconds < 1.0:
        return f"{1e3 * seconds:.0f} ms"
    return f"{seconds:.1f} s" if seconds < 120.0 else f"{seconds / 60.0:.1f} min"
