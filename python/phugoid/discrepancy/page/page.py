"""The report of a diagnosis: one HTML page with all its figures, which needs no network."""

from __future__ import annotations

import os
from typing import Any

from ...modelling.model import Model
from ...notebook import equation
from ...pages import PageTable, picture, render, sources
from ...parameters import Estimate
from ...writing import PAGES, check_folder, check_suffix, write
from ..misfit.misfit import Misfit, misfit
from ..misfit.phrases import number, percent, what_stands_out, with_unit
from ..search.finding import DiagnosisResult, ExtensionResult, Finding
from .figures import curve_figure, explained_figure, findings_figure, gain_figure, ranking_figure
from .words import alias_set, finding_lines, headline, outcome, with_sign

__all__ = ["report"]

_SHOWN = 3  # channels with a figure
_RANKED = 20  # candidates in the table
_GROWN = 0.05  # of the RMS, by which residuals on held-out data may grow without being reported


def report(diagnosis: DiagnosisResult, path: str | os.PathLike[str]) -> None:
    """Write a diagnosis as one HTML page: images inside, no script, no link; for screen, phone and print.

    What was wrong, the cause and its rivals, the evidence, the new equation, the gain, what is left open, and which
    data and versions it comes from.
    """
    check_folder(path)
    check_suffix(path, PAGES, "a report")
    fit = diagnosis.fit
    extension = diagnosis.extend() if diagnosis.found else None
    known = {
        "model": f"{fit.model.name}; {len(fit.model.parameter_names)} parameters",
        "fit": f"{fit.status}; log-likelihood {fit.log_likelihood:.1f}; {fit.iterations} iterations",
        "transcription": str(fit.transcription),
        "noise": getattr(fit.noise, "description", "") or "Gaussian, independent",
        "diagnosis": f"{_tried(diagnosis)}, {diagnosis.seconds:.1f} s",
    }
    more: dict[str, Any] = {}
    if extension is not None:
        left = misfit(extension.fit)
        known["extended fit"] = f"{extension.fit.status}; log-likelihood {extension.fit.log_likelihood:.1f}"
        more["equations"], more["gain"] = _equations(diagnosis, extension), _gain(diagnosis, extension)
        more["left"] = [left.channels[name].summary() for name in left.worst]
    page = render(
        "diagnosis.html",
        title=f"Diagnosis: {fit.model.name}",
        kind="What the model misses",
        name=fit.model.name,
        headline=headline(diagnosis),
        outcome=outcome(diagnosis),
        explained=_explained(diagnosis),
        wrong=_wrong(diagnosis),
        causes=[_cause(finding) for finding in diagnosis.findings],
        tried=len(diagnosis.ranking),
        threshold=diagnosis.threshold,
        evidence=_evidence(diagnosis) if diagnosis.ranking else None,
        extended=extension is not None,
        open=_open(diagnosis),
        sources=sources(fit.records, known),
        **more,
    )
    write(path, page, "the page")


def _explained(diagnosis: DiagnosisResult) -> Any:
    """Return the figure that tells the verdict; None where no finding has a part of the misfit that it explains."""
    if not any(f.explained == f.explained for f in diagnosis.findings):
        return None
    return picture(explained_figure(diagnosis.findings)[0])


def _wrong(diagnosis: DiagnosisResult) -> dict[str, Any]:
    found: Misfit = diagnosis.misfit
    rows = []
    for name in found.worst:
        c = found.channels[name]
        share = percent(c.predictable) if c.predictable == c.predictable else ""
        rows.append([name, what_stands_out(c), with_unit(c.rms, c.unit), _number(c.noise), _number(c.ratio), share])
    pictures = [
        (
            f"Residuals of {n}: {what_stands_out(found.channels[n])}",
            picture(found.plot([n])[0]),
        )
        for n in found.worst[:_SHOWN]
    ]
    heads = ["channel", "what stands out", "RMS", "noise", "ratio", "predictable"]
    notes = list(dict.fromkeys(n for c in found.channels.values() for n in c.notes))
    return {"table": PageTable(heads, rows, "ltrrrr"), "notes": notes, "pictures": pictures}


def _cause(finding: Finding) -> dict[str, Any]:
    gains = {finding.cause: finding.gain, **{n: finding.rivals.get(n, float("nan")) for n in finding.aliases}}
    rows = [[name, with_sign(gain)] for name, gain in gains.items()] if finding.cause and finding.aliases else []
    return {
        "name": alias_set(finding),
        "status": finding.status,
        "lines": finding_lines(finding),
        "rivals": PageTable(["cause or rival", "gain in log-likelihood"], rows, "lr"),
        "curve": picture(curve_figure(finding)[0]) if finding.curve else None,
    }


def _evidence(diagnosis: DiagnosisResult) -> dict[str, Any]:
    ranking = sorted(diagnosis.ranking, key=lambda s: s.ranking, reverse=True)
    rows = []
    for s in ranking[:_RANKED]:
        numbers = [f"{s.statistic:.1f}", f"{s.ranking:.1f}", f"{s.white:.1f}", f"{s.distinct:.2g}"]
        rows.append([s.name, *numbers, s.explanation, s.remark])
    heads = ["candidate", "statistic", "ranking", "white", "distinct", "explanation", "remark"]
    return {
        "picture": picture(ranking_figure(ranking, diagnosis.threshold)[0]),
        "table": PageTable(heads, rows, "lrrrrtt"),
    }


def _equations(diagnosis: DiagnosisResult, extension: ExtensionResult) -> dict[str, Any]:
    """Equations that changed, as HTML, each with whether it is measured; what is late, and parameters."""
    base, model = diagnosis.fit.model, extension.model
    new = [name for name in (*model.parameter_names, *model.state_names) if not _has(base, name)]
    new += [late for late in model.delays.inputs if late not in base.delays.inputs]
    before = base.equations
    changed = []
    for name, e in model.equations.items():
        if name not in before or str(before[name]) != str(e):
            left = name.removeprefix("y:").removesuffix("'")
            changed.append((equation(left, e, new, rate=name.endswith("'")), name.startswith("y:")))
    inputs = [(n, late) for n, late in model.delays.inputs.items() if n not in base.delays.inputs]
    outputs = [(n, tau) for n, tau in model.delays.outputs.items() if n not in base.delays.outputs]
    rows = []
    for name, now in extension.fit.parameters.items():
        old = diagnosis.fit.parameters.get(name)
        rows.append([name, "" if old is None else _estimate(old), _estimate(now), now.unit, now.remark])
    added = [[r[0], *r[2:]] for r in rows if not r[1]]
    return {
        "changed": changed,
        "late": [f"{n}(t) = {of}(t − {tau})" for n, (of, tau) in inputs]
        + [f"{n} is measured late, by {tau}" for n, tau in outputs],
        "parameters": PageTable(["parameter", "before", "after", "unit", ""], rows, "lrrll"),
        "added": PageTable(["new parameter", "estimate ± std error", "unit", ""], added, "lrll"),
    }


def _gain(diagnosis: DiagnosisResult, extension: ExtensionResult) -> dict[str, Any]:
    gain = extension.gain
    held_out = bool(gain.held_out_rms_before)
    totals = [
        ["log-likelihood, residuals taken as white", with_sign(gain.log_likelihood)],
        ["log-likelihood, residuals whitened", with_sign(gain.log_likelihood_whitened)],
        ["log-likelihood on data held out, whitened", with_sign(gain.held_out)],
        ["BIC (below zero is better)", with_sign(gain.bic)],
    ]
    rows = []
    for name in gain.channels:
        unit = diagnosis.fit.model.units.get(name, "")
        row = [name, unit, *_before_after(gain.rms_before, gain.rms_after, name), _change(gain.change(name))]
        if held_out:
            row += _before_after(gain.held_out_rms_before, gain.held_out_rms_after, name)
            row.append(_change(gain.change(name, held_out=True)))
        rows.append(row)
    heads = ["channel", "unit", "RMS before", "after", "change"]
    heads += ["held out before", "after", "change"] if held_out else []
    return {
        "added": ", ".join(extension.added),
        "held_out": gain.held_out == gain.held_out,
        "grown": ", ".join(name for name in gain.channels if gain.change(name, held_out=True) > _GROWN),
        "totals": PageTable(["total", "gain"], totals, "lr"),
        "channels": PageTable(heads, rows, "llrrrrrr"),
        "overview": picture(gain_figure(gain, diagnosis.fit.model.units)[0]),
        "histories": picture(findings_figure(diagnosis.fit, extension)[0]),
    }


def _open(diagnosis: Any) -> list[str]:
    """Return what these data do not tell, in sentences."""
    findings = diagnosis.findings
    texts = [line for f in findings if not f.cause for line in finding_lines(f)]
    surrogates = [f.cause for f in findings if f.status == "surrogate" and f.cause]
    if surrogates:
        texts.append(f"{', '.join(surrogates)} may stand for a cause that is not among the candidates.")
    for f in findings:
        if f.cause and f.aliases:
            texts.append(f"Which of {', '.join([f.cause, *f.aliases])} it is, these data do not tell. {f.advice}")
    return [*texts, *diagnosis.notes]


def _tried(diagnosis: DiagnosisResult) -> str:
    n = len(diagnosis.ranking)
    return f"{n} candidates, threshold {diagnosis.threshold:.1f} in twice the log-likelihood" if n else "no candidates"


def _has(model: Model, name: str) -> bool:
    return name in model.parameter_names or name in model.state_names


def _estimate(e: Any) -> str:
    """Return an estimate with as many digits as its error allows."""
    return repr(Estimate("", e.value, e.std_error)).removeprefix(" = ")


def _number(value: float, digits: int = 2) -> str:
    return number(value, digits) if value == value else ""


def _before_after(before: Any, after: Any, name: str) -> list[str]:
    return [_number(group.get(name, float("nan")), 3) for group in (before, after)]


def _change(change: float) -> str:
    return f"{round(100.0 * change):+d} %" if change == change else ""
