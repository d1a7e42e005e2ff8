"""The report of a fit: one HTML page with its figures, which needs no network."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from html import escape
from typing import Any

from ..discrepancy.misfit.residuals_figure import plot_residuals
from ..errors import DataError, OptionError
from ..figures import fit as plot
from ..figures.convergence import plot_convergence
from ..figures.correlation import plot_correlation
from ..figures.parameters import plot_parameters
from ..fit_result import FitResult
from ..match import match
from ..pages.markup import bullets, details, document, image, section, table
from ..pages.mathml import equation
from ..pages.provenance import facts, files_table, records_table, steps_of
from ..parameters import Estimate, Estimates
from ..summary import corrected
from ..writing import check_folder, write
from .remarks import remarks
from .validation import validation_section

__all__ = ["report"]

_FIGURES = 6  # records shown; of more, the first
_LARGE = 60  # parameters: a matrix of more is no figure


def report(
    fit: FitResult,
    path: str | os.PathLike[str],
    *,
    validation: Any = None,
    files: Sequence[str | os.PathLike[str]] = (),
    command: str = "",
) -> None:
    """Writes a fit as one HTML page: images inside, no script, no link; for screen, phone and print.

    How it ended, what to beware of, parameters with standard errors, the match of each output in numbers and figures,
    residuals, validation, equations, the solver's way, and which data and versions it comes from.

    fit         a `Fit`.
    validation  a `Validation` of it on other experiments, or None.
    files       that it was made from, such as data and model: their names, sizes and SHA-256 are listed.
    command     that made it.

    What was done to the data before (`Experiment.history`) is told as long as ``fit.experiments`` are there, which a
    saved fit does not keep. Raises OptionError for a validation of another model, DataError for a file that cannot be
    read.
    """
    check_folder(path)
    if validation is not None and getattr(validation, "matches", None) is None:
        raise OptionError(f"report: validation is what Fit.validate gives back, not a {type(validation).__name__}")
    if validation is not None and validation.model.name != fit.model.name:
        raise OptionError(
            f"report: the validation is of '{validation.model.name}', but the fit of '{fit.model.name}': "
            "give fit.validate(...)"
        )
    if isinstance(files, (str, os.PathLike)):
        files = [files]
    found = remarks(fit)
    sections = [
        *([section("What to beware of", bullets(found))] if found else []),
        _parameters(fit),
        _match(fit),
        _residuals(fit),
        *([validation_section(validation)] if validation is not None else []),
        _equations(fit),
        *([_solver(fit)] if fit.history else []),
        _provenance(fit, files, command),
    ]
    # Colours as of a diagnosis: green where all is well.
    kind = "nothing" if fit.converged and not fit.warnings else "unexplained"
    headline = f"{fit.status[:1].upper()}{fit.status[1:]}" + (f": {fit.message}." if fit.message else ".")
    page = document(f"Fit: {fit.model.name}", "Parameters from data", fit.model.name, headline, kind, sections)
    write(path, page, "the page")


def _parameters(fit: FitResult) -> str:
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
    first = [[n, e.name, *_cells(e)] for n, group in fit.initial_states.items() for e in group.values()]
    heads = ["experiment", "state", "estimate ± std error", "unit", "in %", ""]
    body += details("Initial states", table(heads, first, "llrlrl"))
    return section("Parameters", body + _intervals(fit))


def _intervals(fit: FitResult) -> str:
    """Figures of intervals and correlations, where there are any."""
    shown = ""
    try:
        caption = "Estimates with 95 % intervals, ±1.96 standard errors; one that reaches 100 % holds zero."
        shown = details("95 % intervals", image(plot_parameters([fit])[0], "95 % intervals of the parameters", caption))
    except DataError:  # no standard errors
        return ""
    estimated = [e for e in fit.parameters.values() if e.name not in fit.noise_parameters and e.std_error > 0.0]
    if 2 <= len(estimated) <= _LARGE:
        caption = "Correlation of the estimates; those near ±1 the data hardly tell apart."
        matrix = image(plot_correlation(fit)[0], "Correlation matrix of the estimates", caption)
        shown += details("Correlation of the estimates", matrix)
    return shown


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
    return [value, e.unit, _percent(relative), e.remark]


def _percent(relative: float) -> str:
    if relative != relative:
        return ""
    return f"{relative:.3g}" if relative < 999.5 else "> 1000"


def _match(fit: FitResult) -> str:
    rows = []
    for name in fit.model.output_names:
        m = match(fit.records, name)
        numbers = [f"{m.rms:.4g}", f"{m.r_squared:.4f}", f"{m.theil:.4f}", f"{m.lag_one:.2f}"]
        rows.append([name, m.unit, *("" if n == "nan" else n for n in numbers), str(m.samples)])
    filtered = any(record.innovations for record in fit.records)
    against = "what is predicted from the samples before (innovations)" if filtered else "model"
    text = (
        f"<p>Residuals are measured minus {against}. R² and Theil's U are 1 and 0 for a perfect match; lag-1 is the "
        "correlation of a residual with the next, 0 where they are white.</p>"
    )
    heads = ["output", "unit", "RMS innovation" if filtered else "RMS residual", "R²", "Theil's U", "lag-1", "samples"]
    shown = ""
    for i, record in enumerate(fit.records[:_FIGURES]):
        figure, _ = plot.plot_fit(fit, i)
        caption = f"{record.name}: measured points, the model's line, residuals beneath with ±2σ, inputs."
        shown += image(figure, f"Proof of match of {record.name}", caption)
    if len(fit.records) > _FIGURES:
        shown += f"<p>The first {_FIGURES} of {len(fit.records)} records are shown.</p>"
    return section("Match", text + table(heads, rows, "llrrrrr") + shown)


def _residuals(fit: FitResult) -> str:
    text = (
        "<p>If the model is right and the noise white, residuals stay within ±2σ 95 % of the time, follow neither from "
        "their own past nor from anything else, and have the same power at all frequencies.</p>"
    )
    shown = ""
    for i, record in enumerate(fit.records[:_FIGURES]):
        try:
            figure, _ = plot_residuals(fit, i)
        except DataError:  # nothing was measured
            continue
        caption = (
            f"{record.name}: residuals, their autocorrelation and their power spectrum; grey, 95 % of white noise."
        )
        drawn = image(figure, f"Residuals of {record.name} over time, their autocorrelation and spectrum", caption)
        shown += details(record.name, drawn) if shown else drawn
    return section("Residuals", text + shown) if shown else ""


_GROUPS = {"quantities": "Quantities", "dynamics": "Dynamics", "outputs": "Measured outputs y"}


def _equations(fit: FitResult) -> str:
    groups: dict[str, list[str]] = {title: [] for title in _GROUPS.values()}
    for name, e in fit.model.equations.items():
        rate, measured = name.endswith("'"), name.startswith("y:")
        left = name.removeprefix("y:").removesuffix("'")
        title = _GROUPS["dynamics" if rate else "outputs" if measured else "quantities"]
        shown = equation(f"y_{left}" if measured else left, e, rate=rate)
        groups[title].append(f"<div class='equation'>{shown}</div>\n")
    delays = fit.model.delays
    late = [f"{name}(t) = {of}(t − {tau})" for name, (of, tau) in delays.inputs.items()]
    late += [f"{output} is measured late, by {tau}" for output, tau in delays.outputs.items()]
    late += [f"{state} at the {end} sample = {e}" for end, state, e, _ in fit.model._core.conditions]
    groups["Delays and conditions"] = [f"<div class='equation'><code>{escape(text)}</code></div>\n" for text in late]
    return section("Equations", "".join(f"<h3>{title}</h3>{''.join(each)}" for title, each in groups.items() if each))


def _solver(fit: FitResult) -> str:
    caption = (
        "How the solver came to its end. Hollow points have a greater log-likelihood, but do not meet the equations "
        "yet."
    )
    drawn = image(plot_convergence(fit)[0], "Log-likelihood, defects, distance from the optimum and steps", caption)
    rows = [
        [
            str(line.number),
            f"{line.log_likelihood:.6f}",
            f"{line.defect:.2e}",
            f"{line.dual:.2e}",
            f"{line.step:.3g}",
            str(line.trials),
        ]
        for line in fit.history
    ]
    heads = ["iteration", "log-likelihood", "largest defect", "distance", "step", "trials"]
    return section("The solver", drawn + details("All iterations", table(heads, rows, "rrrrrr")))


def _provenance(fit: FitResult, files: Sequence[str | os.PathLike[str]], command: str) -> str:
    more = {
        "fit": f"{fit.status}; log-likelihood {fit.log_likelihood:.3f}; {fit.iterations} iterations, {fit.time:.2f} s",
        "transcription": str(fit.transcription),
        "noise": getattr(fit.noise, "description", "") or "Gaussian, independent",
        **({"command": command} if command else {}),
    }
    body = records_table(fit.records) + steps_of(fit.experiments) + facts(more) + files_table(files)
    return section("Data and versions", body)
