"""The report of a diagnosis, in plain words and as one HTML page with all its figures, which needs no network."""

from __future__ import annotations

import math
import os
import textwrap
from collections.abc import Sequence
from functools import partial
from typing import Any, Literal

from ...figures.fit import sigmas_of
from ...modelling.constant import constants_table
from ...modelling.model import Model
from ...notebook import equation
from ...pages import PageTable, histories, picture_in_widths, render, sources
from ...parameters import Estimate
from ...time_unit import SECONDS, TimeUnit
from ...writing import PAGES, check_folder, check_suffix, write
from ..misfit.misfit import Misfit, misfit, misfit_figure
from ..misfit.phrases import number, percent, what_stands_out, with_unit
from ..search.evidence import AssessmentSettings
from ..search.finding import DiagnosisResult, ExtensionResult, Finding
from .figures import curve_figure, explained_figure, findings_figure, gain_figure, ranking_figure

__all__ = [
    "Outcome",
    "alias_set",
    "diagnosis_summary",
    "finding_lines",
    "headline",
    "outcome",
    "report",
    "value_of",
    "with_sign",
]


Outcome = Literal["named", "nothing", "unexplained"]

_WIDTH = 110
# Of the residuals' power, what can be predicted and is most of it.
_MOSTLY = 0.9
# Ratio of residuals to their noise, from which on what named causes leave is worth a word.
_FAR = 1.5
# Part of the misfit of data held out of which a cause leaves next to nothing.
_NEARLY_ALL = 0.97


def outcome(diagnosis: DiagnosisResult) -> Outcome:
    """Return the conclusion of a diagnosis, one of three; with surrogates and minor findings alone it is "nothing"."""
    verdict = diagnosis.verdict
    return verdict if verdict in ("named", "unexplained") else "nothing"


def headline(diagnosis: DiagnosisResult) -> str:
    """Return the outcome in one sentence."""
    findings, verdict = diagnosis.findings, diagnosis.verdict
    named = [f for f in findings if f.status == "named"]
    if not findings and diagnosis.interrupted:
        return "The search was interrupted before it had a result: nothing can be concluded about the model."
    if named:
        *first, last = (alias_set(f) for f in named)
        text = f"The model misses {', '.join(first)}{' and ' if first else ''}{last}."
    elif any(f.status == "unexplained" for f in findings):
        text = "The misfit is significant, but its cause is not established."
    elif verdict == "unexplained":
        channels = [diagnosis.misfit.channels[name] for name in diagnosis.structured_outputs]
        most = max(channels, key=lambda c: c.predictable)
        text = (
            f"No cause was found, but the residuals are not white: {percent(most.predictable)} of their power in "
            f"{most.name} can be predicted from preceding samples. No candidate explains them better than coloured "
            "noise does: they are such noise, a disturbance, or an effect that is not among the candidates."
        )
        if most.predictable > _MOSTLY and most.ratio > 1.0:
            text += f" The residual of {most.name} is {number(most.ratio, 2)} times its noise."
    else:
        text = "No effect that these data and candidates could show is missing from the model."
    text += _minor([f for f in findings if f.status == "minor"])
    surrogates = [f.cause for f in findings if f.status == "surrogate"]
    if surrogates:
        what = "are surrogates, which fit" if len(surrogates) > 1 else "is a surrogate, which fits"
        text += f" {', '.join(surrogates)} {what} but may represent another cause."
    if named:
        text += _remaining(diagnosis)
    return text


def _minor(findings: Sequence[Finding]) -> str:
    """Return sentences on minor findings: they explain little, may explain by chance, or are doubtful."""
    little = [f.cause for f in findings if not f.explained > AssessmentSettings.minor]
    more = [f for f in findings if f.explained > AssessmentSettings.minor]
    open_ = [f.cause for f in more if not f.explained_interval[0] > 0.0]
    doubtful = [f.cause for f in more if f.explained_interval[0] > 0.0]
    text = ""
    if little:
        least = percent(AssessmentSettings.minor)
        text += f" Minor: {', '.join(little)}, significant, but less than {least} of the misfit."
    if open_:
        what = "is significant, but what it explains" if len(open_) == 1 else "are significant, but what they explain"
        text += f" {', '.join(open_)} {what} of held-out data may be chance."
    if doubtful:
        what = "explains" if len(doubtful) == 1 else "explain"
        text += f" {', '.join(doubtful)} {what} a part of the misfit of held-out data, but not as an established cause."
    return text


def _remaining(diagnosis: DiagnosisResult) -> str:
    """Return a sentence on the misfit that the named causes leave; "" where there is none to speak of."""
    left = diagnosis.remaining.channels.values() if diagnosis.is_extended else ()
    channels = [c for c in left if c.structured and c.predictable > _MOSTLY and c.ratio > _FAR]
    if not channels and not any(f.status == "unexplained" for f in diagnosis.findings):
        return ""
    most = max((f.explained for f in diagnosis.findings if f.status == "named"), default=0.0)
    if not channels and most > _NEARLY_ALL:
        return " The remaining misfit is small but significant, and its cause is not established."
    text = " A part of the misfit has no established cause"
    if channels:
        worst = max(channels, key=lambda c: c.ratio)
        text += f": with what is named, the residual of {worst.name} is {number(worst.ratio, 2)} times its noise"
    return f"{text}."


def alias_set(finding: Finding) -> str:
    """Return the cause, or what it is one of."""
    if not finding.cause:
        return "a cause not established"
    if not finding.aliases:
        return finding.cause
    return f"one of {{{', '.join([finding.cause, *finding.aliases])}}}"


def value_of(finding: Finding) -> str:
    """Coefficient with its standard error, unit and interval; "" where there is none."""
    if not math.isfinite(finding.coefficient):
        return ""
    error = finding.std_error if finding.std_error > 0.0 else math.nan  # there is none at the edge of a range
    text = repr(Estimate("", finding.coefficient, error, finding.unit)).removeprefix(" = ")
    low, high = finding.interval
    if not math.isfinite(error):
        return f"{text}, at the limit of its range, therefore without a standard error"
    if math.isfinite(low) and math.isfinite(high):
        text += f" (95 %: {' to '.join(_ends(low, high))})"
    return text


def _ends(low: float, high: float) -> tuple[str, str]:
    """Return both ends with as many digits as distinguish them."""
    largest = max(abs(low), abs(high))
    digits = 3
    if high > low:
        digits = max(digits, 2 + math.floor(math.log10(largest)) - math.floor(math.log10(high - low)))
    return number(low, digits), number(high, digits)


def _estimated(finding: Finding) -> list[str]:
    """Return what its parameters were estimated to be."""
    value, values = value_of(finding), [value for value, _ in finding.parameters.values()]
    if not value:  # those of each record are listed before
        return []
    if len(values) == 3 and finding.cause.endswith(":periodic"):
        time = TimeUnit([SECONDS, *finding.units.values()][-1].removeprefix("rad/"))
        return [f"Amplitude: {value}, at {time.per(number(abs(values[2]) / (2.0 * math.pi), 3))}."]
    if len(values) == 3 and ":periodic_" in finding.cause:
        return [f"Amplitude: {value}, period {number(2.0 * math.pi / abs(values[2]), 4)}."]
    if "," in finding.cause:  # of several parameters that change at one time each is named
        value = f"{next(iter(finding.parameters))} = {value}"
    lines = [f"Estimated: {value}."]
    others = [
        repr(Estimate(name, value, error if error > 0.0 else math.nan, finding.units.get(name, "")))
        for name, (value, error) in list(finding.parameters.items())[1:]
    ]
    return [*lines, f"With {', '.join(others)}."] if others else lines


def with_sign(value: float) -> str:
    """Return a gain to the digits that are known; "-" where there is none."""
    return f"{value:+.1f}" if math.isfinite(value) else "-"


def finding_lines(finding: Finding) -> list[str]:
    """Sentences on one finding, without its name."""
    lines = []
    if finding.explanation:
        # Names begin with small letters as they please: no capital is put on one.
        said = (
            f"That is, {finding.explanation}"
            if finding.cause
            else finding.explanation[:1].upper() + finding.explanation[1:]
        )
        lines.append(f"{said.rstrip('.')}.")
    if finding.cause:
        lines += _estimated(finding)
    if finding.status == "surrogate":
        lines.append("A surrogate: it fits the data, but may represent another cause.")
    if math.isfinite(finding.explained):
        lines.append(_explained_in_words(finding))
    gain = f"Gain in log-likelihood, each model with its own coloured noise: {with_sign(finding.gain)}"
    gain += f" (threshold {finding.threshold:.1f})"
    if math.isfinite(finding.held_out_gain):
        gain += f"; on held-out data, both with the noise of the extended model: {with_sign(finding.held_out_gain)}"
    if math.isfinite(finding.gain):
        lines.append(f"{gain}.")
    if finding.cause and finding.held_out_gain <= 0.0:
        lines.append(
            "Together with the other causes it does not improve the prediction of held-out data; it is doubtful."
        )
    if finding.aliases:
        others = [
            f"{name} (gain {with_sign(finding.alternatives[name])})" if name in finding.alternatives else name
            for name in finding.aliases
        ]
        predicted = "simulate held-out data better" if finding.held_out_gain > 0.0 else "predict held-out data"
        doubted = "is not proved" if finding.ringing else f"does not {predicted}"
        label = "The data do not distinguish it from" if finding.cause else f"What fits, but {doubted}"
        if finding.is_drawn and not finding.cause:
            label = "Name of this candidate"
        lines.append(f"{label}: {', '.join(others)}.")
    if finding.advice:
        lines.append(finding.advice)
    return lines


def _explained_in_words(finding: Finding) -> str:
    """Return what a finding explains in free simulation."""
    low, high = finding.explained_interval
    text = f"Explains {_share(finding.explained)} of the misfit in free simulation of {finding.explained_in}"
    if math.isfinite(low) and math.isfinite(high):
        text += f" (95 %: {_share(low)} to {_share(high)}"
        low, high = finding.explained_another
        known = math.isfinite(low) and math.isfinite(high)
        text += f"; on another record of this kind: {_share(max(low, 0.0))} to {_share(high)})" if known else ")"
    best = max(finding.explained_outputs, key=lambda n: finding.explained_outputs[n], default="")
    if len(finding.explained_outputs) > 1 and finding.explained_outputs[best] > 0.0:
        text += f", most in {best}"
    if math.isfinite(finding.explained_of_the_rest):
        text += f"; of the misfit that the other findings leave {_share(finding.explained_of_the_rest)}"
    return f"{text}."


def _share(part: float) -> str:
    """Return a part in words. It may be negative or next to nothing, or exceed 1: the noise that is left out is an
    estimate."""
    return percent(min(part, 1.0)) if part >= 0.995 else f"{number(100.0 * part, 2)} %"


def diagnosis_summary(diagnosis: DiagnosisResult) -> str:
    """Return what was found, the evidence, and what is left open, for the terminal."""
    parts = [f"{diagnosis.fit.model.name}: diagnosis ({diagnosis.seconds:.1f} s)", _filled(headline(diagnosis), "")]
    for i, finding in enumerate(diagnosis.findings, start=1):
        head = f"{i}. {alias_set(finding)}"
        parts.append("\n".join([head, *(_filled(line, "   ") for line in finding_lines(finding))]))
    if any(f.status == "named" for f in diagnosis.findings) and (gained := _gained(diagnosis)):
        parts.append(_filled(gained, "", "  "))
    if not diagnosis.ranking:
        parts.append("No candidates were tried.")
    elif not diagnosis.findings:
        parts.append(_filled(_nearest(diagnosis), ""))
    residuals = [_filled(line, "  ", "    ") for line in diagnosis.misfit.summary().split("\n")]
    parts.append("\n".join(["Residuals of the model as it was:", *residuals]))
    if diagnosis.notes:
        parts.append("\n".join(["Notes:", *(_filled(note, "  ", "    ") for note in diagnosis.notes)]))
    return "\n\n".join(parts)


def _gained(diagnosis: DiagnosisResult) -> str:
    """Return the errors of the model as it was and with all that is named, on data held out where there are any; ""
    where nothing was added."""
    if not diagnosis.is_extended:
        return ""
    gain, units = diagnosis.extend().gain, diagnosis.fit.model.units
    held_out = bool(gain.held_out_rms_after)
    before = gain.held_out_rms_before if held_out else gain.rms_before
    after = gain.held_out_rms_after if held_out else gain.rms_after
    changes = [
        f"{name} {number(before[name], 3)} and {number(after[name], 3)} {units.get(name, '')}".rstrip()
        for name in before
        if name in after
    ]
    where = "on held-out data" if held_out else "in these records"
    return f"RMS error {where} without and with the named causes: {', '.join(changes)}."


def _nearest(diagnosis: DiagnosisResult) -> str:
    """Return how near the best candidate came."""
    best = max(diagnosis.ranking, key=lambda s: s.statistic)
    text = (
        f"The best candidate is {best.name}, with a gain of {best.statistic / 2:.1f} in log-likelihood (threshold "
        f"{diagnosis.threshold / 2:.1f})"
    )
    if best.statistic <= diagnosis.threshold:
        return f"{text}."
    return f"{text} to first order. It was rejected when it was estimated with the model, or by held-out data."


def _filled(text: str, first: str, rest: str | None = None) -> str:
    indent = first if rest is None else rest
    return textwrap.fill(text, _WIDTH, initial_indent=first, subsequent_indent=indent, break_long_words=False)


_SHOWN = 3  # channels with a figure
_RANKED = 20  # candidates in the table
_GROWN = 0.05  # of the RMS, by which residuals on held-out data may grow without being reported


def report(diagnosis: DiagnosisResult, path: str | os.PathLike[str], *, minor: bool = False) -> None:
    """Write a diagnosis as one HTML page: for screen, phone and print, which needs no network.

    Residuals of the model, the cause and other candidates for it, the evidence, the new equations, the gain, open
    questions, and which data and versions it comes from. The new equations have the named causes; with ``minor`` what
    ``extend(minor=True)`` adds, too.
    """
    check_folder(path)
    check_suffix(path, PAGES, "a report")
    fit = diagnosis.fit
    extension = diagnosis.extend(minor=minor) if diagnosis.found or minor else None
    extension = extension if extension is not None and (extension.added or diagnosis.found) else None
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
        named=[(f.cause, f.explanation.rstrip(".")) for f in diagnosis.findings if f.status == "named" and f.cause],
        explained=_explained(diagnosis),
        wrong=_wrong(diagnosis),
        causes=[_cause(f, fit.model) for f in diagnosis.findings if f.cause or f.is_drawn],
        tried=len(diagnosis.ranking),
        threshold=diagnosis.threshold,
        evidence=_evidence(diagnosis) if diagnosis.ranking else None,
        extended=extension is not None,
        open=_open(diagnosis),
        notes=list(diagnosis.notes),
        sources=sources(fit.records, known),
        **more,
    )
    write(path, page, "the page")


def _explained(diagnosis: DiagnosisResult) -> Any:
    """Return the figure that shows the verdict; None where no finding has a part of the misfit that it explains."""
    if not any(f.explained == f.explained for f in diagnosis.findings):
        return None
    return picture_in_widths(partial(explained_figure, diagnosis.findings))


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
            picture_in_widths(partial(misfit_figure, found, [n])),
        )
        for n in found.worst[:_SHOWN]
    ]
    heads = ["channel", "what stands out", "RMS", "noise", "ratio", "predictable"]
    notes = list(dict.fromkeys(n for c in found.channels.values() for n in c.notes))
    record = diagnosis.fit.records[0]
    return {
        "table": PageTable(heads, rows, "ltrrrr"),
        "notes": notes,
        "pictures": pictures,
        "history": histories(record, sigmas_of(diagnosis.fit, record), *found.worst[:1]),
    }


def _cause(finding: Finding, model: Model) -> dict[str, Any]:
    gains = {finding.cause: finding.gain, **{n: finding.alternatives.get(n, float("nan")) for n in finding.aliases}}
    rows = [[name, with_sign(gain)] for name, gain in gains.items()] if finding.cause and finding.aliases else []
    return {
        "name": alias_set(finding),
        "status": finding.status,
        "lines": finding_lines(finding),
        "alternatives": PageTable(["candidate", "gain in log-likelihood"], rows, "lr"),
        "curve": picture_in_widths(partial(curve_figure, finding, model)) if finding.is_drawn else None,
    }


def _evidence(diagnosis: DiagnosisResult) -> dict[str, Any]:
    ranking = sorted(diagnosis.ranking, key=lambda s: s.ranking, reverse=True)
    rows = []
    for s in ranking[:_RANKED]:
        gains = [f"{g / 2:.1f}" for g in (s.statistic, s.ranking, s.white)]
        rows.append([s.name, *gains, f"{s.distinct:.2g}", s.explanation, s.remark])
    heads = ["candidate", "gain", "ranked by", "white noise", "distinct", "explanation", "remark"]
    return {
        "picture": picture_in_widths(partial(ranking_figure, ranking, diagnosis.threshold)),
        "table": PageTable(heads, rows, "lrrrrtt"),
    }


def _equations(diagnosis: DiagnosisResult, extension: ExtensionResult) -> dict[str, Any]:
    """Return the equations that changed, as HTML, each with whether it is measured; their constants, what is late, and
    parameters."""
    base, model = diagnosis.fit.model, extension.model
    new = [name for name in (*model.parameter_names, *model.state_names) if not _has(base, name)]
    new += [late for late in model.delays.inputs if late not in base.delays.inputs]
    before = base.equations
    changed, used = [], set()
    for name, e in model.equations.items():
        if name not in before or str(before[name]) != str(e):
            left = name.removeprefix("y:").removesuffix("'")
            changed.append((equation(left, e, new, rate=name.endswith("'")), name.startswith("y:")))
            used |= {constant for constant, _ in e.constants}
    inputs = [(n, late) for n, late in model.delays.inputs.items() if n not in base.delays.inputs]
    outputs = [(n, tau) for n, tau in model.delays.outputs.items() if n not in base.delays.outputs]
    rows = []
    for name, now in extension.fit.parameters.items():
        old = diagnosis.fit.parameters.get(name)
        rows.append([name, "" if old is None else _estimate(old), _estimate(now), now.unit, now.remark])
    added = [[r[0], *r[2:]] for r in rows if not r[1]]
    return {
        "changed": changed,
        "constants": PageTable(*constants_table({n: c for n, c in model.declared_constants.items() if n in used})),
        "late": [f"{n}(t) = {of}(t − {tau})" for n, (of, tau) in inputs]
        + [f"{n} is measured with the delay {tau}" for n, tau in outputs],
        "parameters": PageTable(["parameter", "before", "after", "unit", ""], rows, "srrll"),
        "added": PageTable(["new parameter", "estimate ± std error", "unit", ""], added, "srll"),
    }


def _gain(diagnosis: DiagnosisResult, extension: ExtensionResult) -> dict[str, Any]:
    gain = extension.gain
    held_out = bool(gain.held_out_rms_before)
    totals = [
        ["log-likelihood, white noise", with_sign(gain.log_likelihood)],
        ["log-likelihood, coloured noise", with_sign(gain.log_likelihood_whitened)],
        ["log-likelihood on held-out data, coloured noise", with_sign(gain.held_out)],
        ["change of BIC (negative: better)", with_sign(gain.bic)],
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
        "overview": picture_in_widths(partial(gain_figure, gain, diagnosis.fit.model.units)),
        "histories": picture_in_widths(partial(findings_figure, diagnosis.fit, extension, None)),
    }


def _open(diagnosis: Any) -> list[str]:
    """Return what these data leave open, in sentences, without what the page says of the causes."""
    findings = diagnosis.findings
    texts = [line for f in findings if not (f.cause or f.is_drawn) for line in finding_lines(f)]
    surrogates = [f.cause for f in findings if f.status == "surrogate" and f.cause]
    if surrogates:
        texts.append(f"{', '.join(surrogates)} may represent a cause that is not among the candidates.")
    for f in findings:
        if f.cause and f.aliases:
            texts.append(f"These data do not show which of {', '.join([f.cause, *f.aliases])} is the cause.")
    if not texts and outcome(diagnosis) == "unexplained":
        texts.append("What causes the structure of the residuals is not established.")
    return list(dict.fromkeys(texts))


def _tried(diagnosis: DiagnosisResult) -> str:
    n = len(diagnosis.ranking)
    return f"{n} candidates ranked, threshold {diagnosis.threshold / 2:.1f} in log-likelihood" if n else "no candidates"


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
