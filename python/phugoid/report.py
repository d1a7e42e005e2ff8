"""The report of a fit: one HTML page with its figures, which needs no network."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Sequence
from typing import Any

from .discrepancy.misfit.residuals_figure import plot_residuals
from .errors import DataError, OptionError, joined
from .figures import fit as plot
from .figures.estimates import plot_convergence, plot_parameters
from .fit_result import FitResult
from .goodness_of_fit import Match, match
from .modelling.constant import constants_table
from .notebook import equation
from .pages import PageTable, Picture, histories, picture, render, sources
from .parameters import Estimate, Estimates, plus_minus
from .solvers import History
from .summary import corrected
from .uncertainty.correlation import correlation, plot_correlation
from .validation import Validation
from .writing import PAGES, check_folder, check_suffix, write

__all__ = ["remarks", "report"]

_WHITE = 0.01  # p-value below which residuals are not white
_MUCH = 0.3  # autocorrelation from one sample to the next that standard errors feel
_SIDE = 1.96  # standard errors of a 95 % interval
_TOGETHER = 0.95  # correlation of estimates
_MOST = 6  # names or pairs listed
_OFFSET = 0.5  # part of the mean square that is an offset


def remarks(fit: FitResult) -> list[str]:
    """Return the warnings of a `Fit`, and the reasons for doubt that its numbers give: one sentence each.

    A coarse mesh, parameters at a bound, outputs that a constant would match better or that are all matched poorly,
    coloured residuals (p < 0.01 in the test of Ljung and Box, lag-1 correlation beyond 0.3), residuals with an offset,
    parameters whose 95 % interval includes zero, pairs of estimates with a correlation beyond 0.95, combinations that
    are hardly determined.
    """
    weak = [f"Weakly identified: {direction}." for direction in correlation(fit).weak]
    warnings = [text if text.endswith((".", "!", "?")) else f"{text}." for text in fit.warnings]
    return [*warnings, *_of_residuals(fit), *_of_estimates(fit), *_of_pairs(fit), *weak]


def _of_residuals(fit: FitResult) -> list[str]:
    filtered = any(record.innovations for record in fit.records)
    found = []
    coloured, off = [], []
    matches = {name: match(fit.records, name) for name in fit.model.output_names}
    for name, m in matches.items():
        if m.whiteness < _WHITE and abs(m.lag_one) > _MUCH:
            coloured.append(f"{name} ({m.lag_one:.2f})")
        if m.bias > _OFFSET:
            off.append(name)
    if coloured and filtered:
        found.append(
            f"Innovations are not white: their correlations at lag 1 are {_listed(coloured)}. They would be white if "
            "the model and its process noise were right: ph.misfit shows where they are not."
        )
    elif coloured:
        found.append(
            f"Residuals are not white: their correlations at lag 1 are {_listed(coloured)}. The plain standard errors "
            "assume white residuals, and are too small. Either the model misses something (ph.diagnose shows what), or "
            "the noise is filtered."
        )
    if off:
        what = "Innovations" if filtered else "Residuals"
        found.append(
            f"{what} of {_listed(off)} are mostly a constant offset: the model has no bias there, or a wrong one."
        )
    return found


def _of_estimates(fit: FitResult) -> list[str]:
    found = []
    noise = fit.noise_parameters
    own = [e for e in fit.parameters.values() if e.name not in noise]
    weak = [e.name for e in own if e.std_error > 0.0 and abs(e.value) < _SIDE * e.std_error]
    if weak:
        include = "interval of {} includes" if len(weak) == 1 else "intervals of {} include"
        found.append(f"The 95 % {include.format(_listed(weak))} zero: these data do not determine the sign.")
    return found


def _of_pairs(fit: FitResult) -> list[str]:
    pairs = [f"{a} with {b} ({_signed(rho)})" for a, b, rho in correlation(fit).pairs(_TOGETHER)]
    if not pairs:
        return []
    return [
        f"Strongly correlated estimates: {_listed(pairs)}. The data determine a combination of them better than each."
    ]


def _signed(value: float) -> str:
    # Rounding must not make it ±1.
    digits = 2 if abs(value) < 0.995 else 4
    return f"{value:.{digits}f}".replace("-", "−")


def _listed(texts: Sequence[str]) -> str:
    shown = texts if len(texts) <= _MOST else [*texts[: _MOST - 1], f"{len(texts) - _MOST + 1} more"]
    return joined(shown)


_FIGURES = 6  # records shown; of more, the first
_LARGE = 60  # parameters: a matrix of more is not a figure


def report(
    fit: FitResult,
    path: str | os.PathLike[str],
    *,
    validation: Any = None,
    files: Sequence[str | os.PathLike[str]] = (),
    command: str = "",
) -> None:
    """Write a fit as one HTML page for screen, phone and print, which needs no network: pictures and script are inside.

    Status, warnings, parameters with standard errors, the match of each output in numbers and figures,
    residuals, validation, equations, convergence of the solver, data and versions.

    fit         a `Fit`.
    validation  a `Validation` of it on other experiments, or None.
    files       that it was made from, such as data and model: their names, sizes and SHA-256 are listed.
    command     that made it.

    The preprocessing of the data (`Experiment.history`) is reported where the fit has its ``experiments``, which a file
    of version 1 does not keep. Raises OptionError for a validation of another model, DataError for a file that cannot
    be read.
    """
    check_folder(path)
    check_suffix(path, PAGES, "a report")
    if validation is not None and getattr(validation, "matches", None) is None:
        raise OptionError(f"report: validation is what Fit.validate gives back, not a {type(validation).__name__}")
    if validation is not None and validation.model.name != fit.model.name:
        raise OptionError(
            f"report: the validation is of '{validation.model.name}', but the fit of '{fit.model.name}': "
            "give fit.validate(...)"
        )
    if isinstance(files, (str, os.PathLike)):
        files = [files]
    # Colours as of a diagnosis: green where all is well.
    outcome = "nothing" if fit.converged and not fit.warnings else "unexplained"
    known = {
        "fit": f"{fit.status}; log-likelihood {fit.log_likelihood:.3f}; {fit.iterations} iterations, {fit.time:.2f} s",
        "transcription": str(fit.transcription),
        "noise": getattr(fit.noise, "description", "") or "Gaussian, independent",
        **({"command": command} if command else {}),
    }
    equations, late = _equations(fit)
    filtered = any(record.innovations for record in fit.records)
    page = render(
        "fit.html",
        title=f"Fit: {fit.model.name}",
        kind="Parameters from data",
        name=fit.model.name,
        headline=f"{fit.status[:1].upper()}{fit.status[1:]}" + (f": {fit.message}." if fit.message else "."),
        outcome=outcome,
        remarks=remarks(fit),
        parameters=_parameters(fit),
        filtered=filtered,
        match=_match(fit, filtered),
        matches=[
            (record.name, picture(plot.plot_fit(fit, i)[0]), histories(record, plot.sigmas_of(fit, record)))
            for i, record in enumerate(fit.records[:_FIGURES])
        ],
        records=len(fit.records),
        residuals=_residuals(fit),
        validation=None if validation is None else _validation(validation),
        equations=equations,
        constants=PageTable(*constants_table(fit.model.declared_constants)),
        late=late,
        solver=_solver(fit) if fit.history else None,
        sources=sources(fit.records, known, fit.experiments, files),
    )
    write(path, page, "the page")


def _parameters(fit: FitResult) -> dict[str, Any]:
    """Return tables of the estimates, and figures of intervals and correlations, where there are any."""
    noise = fit.noise_parameters
    own = [e for e in fit.parameters.values() if e.name not in noise]
    of_noise = [e for e in fit.parameters.values() if e.name in noise]
    coloured = corrected(fit, again=True)
    first = [[n, e.name, *_cells(e)] for n, group in fit.initial_states.items() for e in group.values()]
    heads = ["experiment", "state", "estimate ± std error", "unit", "in %", ""]
    intervals = correlation = None
    try:
        intervals = picture(plot_parameters([fit])[0])
        estimated = [e for e in own if e.std_error > 0.0]
        correlation = picture(plot_correlation(fit)[0]) if 2 <= len(estimated) <= _LARGE else None
    except DataError:  # no standard errors
        pass
    return {
        "own": _estimates("parameter", own, coloured),
        "noise": _estimates("noise", of_noise, coloured),
        "initial": PageTable(heads, first, "lsrlrl"),
        "intervals": intervals,
        "correlation": correlation,
    }


def _estimates(head: str, estimates: list[Estimate], coloured: Estimates | None) -> PageTable:
    rows = []
    for e in estimates:
        error = coloured[e.name].std_error if coloured else math.nan
        rows.append([e.name, *_cells(e)[:3], f"{error:.2g}" if math.isfinite(error) else "", *_cells(e)[3:]])
    return PageTable([head, "estimate ± std error", "unit", "in %", "corrected", ""], rows, "srlrrl")


def _cells(e: Estimate) -> list[str]:
    """Return the estimate with the digits that its error justifies, unit, error in per cent, remark."""
    value = repr(Estimate("", e.value, e.std_error)).removeprefix(" = ")
    relative = 100.0 * e.relative_std_error
    return [value, e.unit, _percent(relative), e.remark]


def _percent(relative: float) -> str:
    if relative != relative:
        return ""
    return f"{relative:.3g}" if relative < 999.5 else "> 1000"


def _match(fit: FitResult, filtered: bool) -> PageTable:
    rows = []
    for name in fit.model.output_names:
        m = match(fit.records, name)
        numbers = [
            _number(m.rms, ".4g"),
            *(_number(x, ".4f") for x in (m.r_squared, m.theil)),
            _number(m.lag_one, ".2f"),
        ]
        rows.append([name, m.unit, *numbers, str(m.samples)])
    heads = ["output", "unit", "RMS innovation" if filtered else "RMS residual", "R²", "Theil's U", "lag-1", "samples"]
    return PageTable(heads, rows, "llrrrrr")


def _residuals(fit: FitResult) -> list[tuple[str, Picture]]:
    found = []
    for i, record in enumerate(fit.records[:_FIGURES]):
        with contextlib.suppress(DataError):  # nothing was measured
            figure, axes = plot_residuals(fit, i)
            rows = zip(*[iter(axes.values())] * 3, strict=True)
            found.append((record.name, picture(figure, tiles=[[[time], [*statistics]] for time, *statistics in rows])))
    return found


def _validation(v: Validation) -> dict[str, Any]:
    """Return what was fixed and re-estimated, and the goodness of fit of each output in numbers, words and figures."""
    names = ", ".join(f"'{r.name}'" for r in v.records)
    freed = [f"{e.name} = {plus_minus(e.value, e.std_error)} {e.unit}".rstrip() for e in v.re_estimated.values()]
    new = f", which {'was' if len(v.records) == 1 else 'were'} not fitted to,"
    text = (
        f"The fitted model on {names}{'' if set(v.fitted_to) & {r.name for r in v.records} else new} with parameters "
        f"and noise fixed; re-estimated: initial states{''.join(f', {each}' for each in freed)}. "
        f"Log-likelihood {v.log_likelihood:.3f} at the noise of the fit."
    )
    if not v.converged:
        text += f" {v.status[:1].upper()}{v.status[1:]}: {v.message}."
    rows = [_validated(m) for m in v.matches.values()]
    sigmas = {name: m.sigma for name, m in v.matches.items() if math.isfinite(m.sigma)}
    heads = ["output", "unit", "RMS", "σ of fit", "Theil's U", "bias/var/cov, %", "lag-1", "tolerance", "inside, %"]
    return {
        "text": text,
        "table": PageTable([*heads, "samples"], rows, "llrrrrrrrr"),
        "said": [*v.warnings, *v.in_words()],
        "pictures": [
            (r.name, picture(plot.plot_validation(v, i)[0]), histories(r, sigmas))
            for i, r in enumerate(v.records[:_FIGURES])
        ],
        "tolerances": v.tolerances,
        "records": len(v.records),
    }


def _validated(m: Match) -> list[str]:
    parts = "/".join(_number(100.0 * part, ".0f") for part in (m.bias, m.variance, m.covariance))
    return [
        m.output,
        m.unit,
        _number(m.rms, ".4g"),
        _number(m.sigma, ".4g"),
        _number(m.theil, ".4f"),
        parts if m.bias == m.bias else "",
        _number(m.lag_one, ".2f"),
        "" if m.tolerance is None else m.tolerance.text(),
        _number(100.0 * m.inside, ".1f"),
        str(m.samples),
    ]


def _number(value: float, spec: str) -> str:
    return format(value, spec) if value == value else ""


def _equations(fit: FitResult) -> tuple[dict[str, list[str]], list[str]]:
    """Return the equations in groups, as HTML; and, as text, delays, conditions, and end conditions."""
    groups: dict[str, list[str]] = {"Quantities": [], "Dynamics": [], "Measured outputs y": []}
    for name, e in fit.model.equations.items():
        rate, measured = name.endswith("'"), name.startswith("y:")
        left = name.removeprefix("y:").removesuffix("'")
        title = "Dynamics" if rate else "Measured outputs y" if measured else "Quantities"
        groups[title].append(equation(f"y_{left}" if measured else left, e, rate=rate))
    delays = fit.model.delays
    late = [f"{name}(t) = {of}(t − {tau})" for name, (of, tau) in delays.inputs.items()]
    late += [f"{output} is measured with the delay {tau}" for output, tau in delays.outputs.items()]
    late += [f"{name} is a measured condition" for name in fit.model.condition_names]
    late += [f"{state} at the {end} sample = {e}" for end, state, e in fit.model.end_conditions]
    return groups, late


def _solver(fit: FitResult) -> dict[str, Any]:
    figure, axes = plot_convergence(fit)
    upper_left, upper_right, lower_left, lower_right = ([axis] for axis in axes.values())
    return {
        "picture": picture(figure, tiles=[[upper_left, upper_right], [lower_left, lower_right]]),
        "table": PageTable(*History(fit.history).rows()),
    }
