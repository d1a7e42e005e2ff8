"""The report of a diagnosis: one HTML page with all its figures, which needs no network."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from typing import Any

from ...modelling.model import Model
from ...pages.markup import bullets, details, document, image, section, table
from ...pages.mathml import equation
from ...pages.provenance import facts, records_table
from ...parameters import Estimate
from ...writing import check_folder, write
from ..diagnosis_result import DiagnosisResult
from ..misfit.misfit import Misfit, misfit
from ..misfit.phrases import number, percent, what_stands_out, with_unit
from ..search.extension import ExtensionResult
from ..search.finding import Finding
from .figures import findings_figure, gain_figure, misfit_figure, ranking_figure
from .words import alias_set, finding_lines, headline, outcome, with_sign

__all__ = ["report"]

_SHOWN = 3  # channels with a figure
_RANKED = 20  # candidates in the table
_GROWN = 0.05  # of the RMS, by which residuals on held-out data may grow without being told of


def report(diagnosis: DiagnosisResult, path: str | os.PathLike[str]) -> None:
    """Writes a diagnosis as one HTML page: images inside, no script, no link; for screen, phone and print.

    What was wrong, the cause and its rivals, the evidence, the new equation, the gain, what is left open, and which
    data and versions it comes from.
    """
    check_folder(path)
    extension = diagnosis.extend() if outcome(diagnosis.findings) == "named" else None
    sections = [
        _wrong(diagnosis),
        _causes(diagnosis),
        _candidates(diagnosis),
        *([_equations(diagnosis, extension), _gain(diagnosis, extension)] if extension is not None else []),
        _open(diagnosis, extension),
        _provenance(diagnosis, extension),
    ]
    name = diagnosis.fit.model.name
    page = document(
        f"Diagnosis: {name}",
        "What the model misses",
        name,
        headline(diagnosis),
        outcome(diagnosis.findings),
        sections,
    )
    write(path, page, "the page")


def _wrong(diagnosis: DiagnosisResult) -> str:
    found: Misfit = diagnosis.misfit
    rows = []
    for name in found.worst:
        c = found.channels[name]
        share = percent(c.predictable) if c.predictable == c.predictable else ""
        sizes = [with_unit(c.rms, c.unit), _number(c.noise), _number(c.ratio), share]
        rows.append([name, what_stands_out(c), *sizes])
    heads = ["channel", "what stands out", "RMS", "noise", "ratio", "predictable"]
    explained = (
        "Residuals are measured minus model. Noise is what in them cannot be predicted from their own past "
        "(innovations of an autoregressive model); a ratio of 1, and nothing predictable, is a perfect match. Claims "
        "take into account that residuals are coloured: each has a chance of about 1 in 1000 of being false."
    )
    # One figure a channel, so that pages break between them.
    worst = found.worst[:_SHOWN]
    pictures = [
        image(
            misfit_figure(found, diagnosis.fit, [name])[0],
            f"Residuals of {name}: {what_stands_out(found.channels[name])}",
        )
        for name in worst
    ]
    shown = "".join(pictures) + (
        "<p class='quiet'>The worst channels. Grey in the time histories: ±2 times the noise; orange spans stand out. "
        "Autocorrelation and its 95 % band for white noise. Spectrum: dashed, white noise of the same power; shaded, "
        "bands above it. Last, the mean residual over the variable that it depends on most; grey, ±2 standard errors; "
        "orange, bins that stand out.</p>"
    )
    notes = bullets(list(dict.fromkeys(n for c in found.channels.values() for n in c.notes)))
    return section("What was wrong", f"<p>{escape(explained)}</p>{table(heads, rows, 'ltrrrr')}{notes}{shown}")


def _causes(diagnosis: DiagnosisResult) -> str:
    findings: Sequence[Finding] = diagnosis.findings
    if not findings:
        return section("The cause", f"<p>{escape(headline(diagnosis))}</p>")
    cards = []
    for finding in findings:
        lines = "".join(f"<p>{escape(line)}</p>" for line in finding_lines(finding))
        gains = {finding.cause: finding.gain, **{n: finding.rivals.get(n, float("nan")) for n in finding.aliases}}
        rivals = ""
        if finding.cause and finding.aliases:
            rows = [[name, with_sign(gain)] for name, gain in gains.items()]
            rivals = table(["cause or rival", "gain in log-likelihood"], rows, "lr")
        status = escape(finding.status)
        cards.append(
            f"<article><h3>{escape(alias_set(finding))} <span class='status {status}'>{status}</span></h3>"
            f"{lines}{rivals}</article>\n"
        )
    return section("The cause and its rivals" if len(findings) == 1 else "The causes and their rivals", "".join(cards))


def _candidates(diagnosis: DiagnosisResult) -> str:
    ranking = sorted(diagnosis.ranking, key=lambda s: s.ranking, reverse=True)
    if not ranking:
        return section("The evidence", "<p>No candidates were tried.</p>")
    text = (
        f"<p>{len(ranking)} candidates were tried. Bars show by how much each would raise twice the log-likelihood, to "
        f"first order; what is below the threshold of {diagnosis.threshold:.1f} (that is {diagnosis.threshold / 2:.1f} "
        "in log-likelihood, as gains are given elsewhere on this page) may well be chance among so many.</p>"
    )
    shown = image(
        ranking_figure(ranking, diagnosis.threshold)[0],
        "The best candidates",
        "The best candidates of the first scan. Bars: residuals whitened, so that slow noise is no evidence; ticks: "
        "noise without the best few terms, which is what they are ranked by; circles: residuals taken as white, which "
        "misleads. Candidates that explain the same residual all rise together.",
    )
    rows = [
        [
            s.name,
            f"{s.statistic:.1f}",
            f"{s.ranking:.1f}",
            f"{s.white:.1f}",
            f"{s.distinct:.2g}",
            s.explanation,
            s.remark,
        ]
        for s in ranking[:_RANKED]
    ]
    heads = ["candidate", "statistic", "ranking", "white", "distinct", "explanation", "remark"]
    more = details(f"The best {len(rows)} in figures", table(heads, rows, "lrrrrtt"))
    return section("The evidence", text + shown + more)


def _equations(diagnosis: DiagnosisResult, extension: ExtensionResult) -> str:
    base, model = diagnosis.fit.model, extension.model
    new = [name for name in (*model.parameter_names, *model.state_names) if not _has(base, name)]
    new += [late for late in model.delays.inputs if late not in base.delays.inputs]
    before = base.equations
    shown = []
    for name, e in model.equations.items():
        if name in before and str(before[name]) == str(e):
            continue
        left = name.removeprefix("y:").removesuffix("'")
        measured = " <span class='quiet'>(measured)</span>" if name.startswith("y:") else ""
        shown.append(f"<div class='equation'>{equation(left, e, new, rate=name.endswith(chr(39)))}{measured}</div>\n")
    late = [
        f"{late}(t) = {of}(t − {tau})"
        for late, (of, tau) in model.delays.inputs.items()
        if late not in base.delays.inputs
    ]
    late += [
        f"{output} is measured late, by {tau}"
        for output, tau in model.delays.outputs.items()
        if output not in base.delays.outputs
    ]
    shown += [f"<div class='equation'><code>{escape(text)}</code></div>\n" for text in late]
    intro = "<p>Equations that changed; what is new in them is marked.</p>" if shown else "<p>No equation changed.</p>"
    rows = []
    for name, now in extension.fit.parameters.items():
        old = diagnosis.fit.parameters.get(name)
        rows.append([name, "" if old is None else _estimate(old), _estimate(now), now.unit, now.remark])
    heads = ["parameter", "before", "after", "unit", ""]
    added = [row for row in rows if not row[1]]
    news = table(["new parameter", "estimate ± std error", "unit", ""], [[r[0], *r[2:]] for r in added], "lrll")
    every = details("All parameters, before and after", table(heads, rows, "lrrll"))
    return section("The new equations", intro + "".join(shown) + (news if added else "") + every)


def _gain(diagnosis: DiagnosisResult, extension: ExtensionResult) -> str:
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
    told = f"<p>By adding {escape(', '.join(extension.added))} and fitting all parameters again.</p>"
    if gain.held_out != gain.held_out:
        told += "<p>No data were held out, so nothing shows that the extended model predicts better.</p>"
    grown = [name for name in gain.channels if gain.change(name, held_out=True) > _GROWN]
    if grown:
        told += (
            f"<p>On the data held out the residuals of {escape(', '.join(grown))} grow: the likelihood may gain all "
            "the same, where their colour counts, but a simulation does not.</p>"
        )
    images = image(
        gain_figure(gain, diagnosis.fit.model.units)[0],
        "RMS of residuals after, over before",
        "RMS of the residuals of each channel after, in per cent of before.",
    )
    images += image(
        findings_figure(diagnosis.fit, extension)[0],
        "Residuals before and after",
        "The channels that gain most: residuals before and after, and what the extension changes in the model's "
        "output: the added effect with what the other parameters make of it.",
    )
    return section("The gain", told + table(["total", "gain"], totals, "lr") + table(heads, rows, "llrrrrrr") + images)


def _open(diagnosis: DiagnosisResult, extension: ExtensionResult | None) -> str:
    parts = []
    unexplained = [f for f in diagnosis.findings if not f.cause]
    if unexplained:
        parts += [escape(line) for f in unexplained for line in finding_lines(f)]
    surrogates = [f.cause for f in diagnosis.findings if f.status == "surrogate" and f.cause]
    if surrogates:
        parts.append(escape(f"{', '.join(surrogates)} may stand for a cause that is not among the candidates."))
    for f in diagnosis.findings:
        if f.cause and f.aliases:
            parts.append(
                escape(f"Which of {', '.join([f.cause, *f.aliases])} it is, these data do not tell. {f.advice}")
            )
    parts += [escape(note) for note in diagnosis.notes]
    body = "".join(f"<p>{part}</p>" for part in parts)
    if extension is not None:
        left = misfit(extension.fit)
        body += "<p>Residuals of the extended model:</p>" + bullets(
            [left.channels[name].summary() for name in left.worst]
        )
    return section("What it leaves open", body or "<p>Nothing that these data tell of.</p>")


def _provenance(diagnosis: DiagnosisResult, extension: ExtensionResult | None) -> str:
    fit = diagnosis.fit
    known = {
        "model": f"{fit.model.name}; {len(fit.model.parameter_names)} parameters",
        "fit": f"{fit.status}; log-likelihood {fit.log_likelihood:.1f}; {fit.iterations} iterations",
        "transcription": str(fit.transcription),
        "noise": getattr(fit.noise, "description", "") or "Gaussian, independent",
        "diagnosis": f"{_tried(diagnosis)}, {diagnosis.seconds:.1f} s",
    }
    if extension is not None:
        known["extended fit"] = f"{extension.fit.status}; log-likelihood {extension.fit.log_likelihood:.1f}"
    return section("Data and versions", records_table(fit.records) + facts(known))


def _tried(diagnosis: DiagnosisResult) -> str:
    n = len(diagnosis.ranking)
    return f"{n} candidates, threshold {diagnosis.threshold:.1f} in twice the log-likelihood" if n else "no candidates"


def _has(model: Model, name: str) -> bool:
    return name in model.parameter_names or name in model.state_names


def _estimate(e: Any) -> str:
    """With as many digits as its error tells of."""
    return repr(Estimate("", e.value, e.std_error)).removeprefix(" = ")


def _number(value: float, digits: int = 2) -> str:
    return number(value, digits) if value == value else ""


def _before_after(before: Any, after: Any, name: str) -> list[str]:
    return [_number(group.get(name, float("nan")), 3) for group in (before, after)]


def _change(change: float) -> str:
    return f"{round(100.0 * change):+d} %" if change == change else ""
