"""The report of a fit: one HTML page with its figures, which needs no network."""

from __future__ import annotations

import math
import os
from html import escape
from pathlib import Path
from typing import Any

from . import plot
from .discrepancy.markup import bullets, document, image, section, table
from .discrepancy.mathml import equation
from .discrepancy.provenance import facts, records_table
from .match import match
from .parameters import Estimate, Estimates
from .summary import corrected

__all__ = ["report"]

_FIGURES = 6  # records shown; of more, the first


def report(fit: Any, path: str | os.PathLike[str]) -> None:
    """Writes a fit as one HTML page: images inside, no script, no link; for screen, phone and print.

    How it ended, warnings, parameters with standard errors, the match of each output in numbers and figures, the
    equations, and which data and versions it comes from. ``fit`` is a `Fit`.
    """
    sections = [_parameters(fit), _match(fit), _equations(fit), _provenance(fit)]
    if fit.warnings:
        sections.insert(0, section("Warnings", bullets(fit.warnings)))
    # Colours as of a diagnosis: green where all is well.
    kind = "nothing" if fit.converged and not fit.warnings else "unexplained"
    headline = f"{fit.status[:1].upper()}{fit.status[1:]}" + (f": {fit.message}." if fit.message else ".")
    page = document(f"Fit: {fit.model.name}", "Parameters from data", fit.model.name, headline, kind, sections)
    Path(path).write_text(page, encoding="utf-8")


def _parameters(fit: Any) -> str:
    noise = fit.noise_parameters
    own = [e for e in fit.parameters.values() if e.name not in noise]
    text = (
        "<p>Standard errors (±) are Cramér-Rao bounds: the inverse of the information matrix. They take residuals for "
        "white; those under <i>coloured</i> allow for residuals as coloured as they are.</p>"
    )
    coloured = corrected(fit, again=True)
    body = text + _estimates("parameter", own, coloured) if own else ""
    of_noise = [e for e in fit.parameters.values() if e.name in noise]
    if of_noise:
        body += "<h3>Noise</h3>" + _estimates("noise", of_noise, coloured)
    body += bullets(fit.correlation.notes) if fit.correlation.notes else ""
    first = [[n, e.name, *_cells(e)] for n, group in fit.initial_states.items() for e in group.values()]
    heads = ["experiment", "state", "estimate ± std error", "unit", "in %", ""]
    body += f"<details><summary>Initial states</summary>{table(heads, first, 'llrlrl')}</details>"
    return section("Parameters", body)


def _estimates(head: str, estimates: list[Estimate], coloured: Estimates | None) -> str:
    rows = []
    for e in estimates:
        error = coloured[e.name].std_error if coloured else math.nan
        rows.append([e.name, *_cells(e)[:3], f"{error:.2g}" if math.isfinite(error) else "", *_cells(e)[3:]])
    return table([head, "estimate ± std error", "unit", "in %", "coloured", ""], rows, "lrlrrl")


def _cells(e: Estimate) -> list[str]:
    """The estimate with as many digits as its error tells of, unit, error in per cent, remark."""
    value = repr(Estimate("", e.value, e.std_error)).removeprefix(" = ")
    relative = 100.0 * e.relative_std_error
    return [value, e.unit, f"{relative:.3g}" if relative == relative else "", e.remark]


def _match(fit: Any) -> str:
    rows = []
    for name in fit.model.output_names:
        m = match(fit.records, name)
        numbers = [f"{m.rms:.4g}", f"{m.r_squared:.4f}", f"{m.theil:.4f}", f"{m.lag_one:.2f}"]
        rows.append([name, m.unit, *("" if n == "nan" else n for n in numbers), str(m.samples)])
    text = (
        "<p>Residuals are measured minus model. R² and Theil's U are 1 and 0 for a perfect match; lag-1 is the "
        "correlation of a residual with the next, 0 where they are white.</p>"
    )
    heads = ["output", "unit", "RMS residual", "R²", "Theil's U", "lag-1", "samples"]
    shown = ""
    for i, record in enumerate(fit.records[:_FIGURES]):
        figure, _ = plot.plot_fit(fit, i)
        caption = f"{record.name}: measured points, the model's line, residuals beneath with ±2σ, inputs."
        shown += image(figure, f"Proof of match of {record.name}", caption)
    if len(fit.records) > _FIGURES:
        shown += f"<p>The first {_FIGURES} of {len(fit.records)} records are shown.</p>"
    return section("Match", text + table(heads, rows, "llrrrrr") + shown)


def _equations(fit: Any) -> str:
    shown = []
    for name, e in fit.model.equations.items():
        left = name.removeprefix("y:").removesuffix("'")
        measured = " <span class='quiet'>(measured)</span>" if name.startswith("y:") else ""
        shown.append(f"<div class='equation'>{equation(left, e, rate=name.endswith(chr(39)))}{measured}</div>\n")
    delays = fit.model.delays
    late = [f"{name}(t) = {of}(t − {tau})" for name, (of, tau) in delays.inputs.items()]
    late += [f"{output} is measured late, by {tau}" for output, tau in delays.outputs.items()]
    late += [f"{state} at the {end} sample = {e}" for end, state, e, _ in fit.model._core.conditions]
    shown += [f"<div class='equation'><code>{escape(text)}</code></div>\n" for text in late]
    return section("Equations", "".join(shown))


def _provenance(fit: Any) -> str:
    more = {
        "fit": f"{fit.status}; log-likelihood {fit.log_likelihood:.3f}; {fit.iterations} iterations, {fit.time:.2f} s",
        "transcription": str(fit.transcription),
        "noise": getattr(fit.noise, "description", "") or "Gaussian, independent",
    }
    return section("Data and versions", records_table(fit.records) + facts(more))
