"""The section of a report on other experiments."""

from __future__ import annotations

from html import escape

from ..figures.fit import plot_validation
from ..match import Match
from ..pages.markup import bullets, image, section, table
from ..parameters import plus_minus
from ..validation.result import Validation

__all__ = ["validation_section"]

_FIGURES = 6  # records shown; of more, the first


def validation_section(v: Validation) -> str:
    """What was held and found anew, the match of each output in numbers, words and figures with tolerance bands."""
    names = ", ".join(f"'{r.name}'" for r in v.records)
    freed = [f"{e.name} = {plus_minus(e.value, e.std_error)} {e.unit}".rstrip() for e in v.freed.values()]
    text = (
        f"The fitted model on {names}, which {'was' if len(v.records) == 1 else 'were'} not fitted to, with parameters "
        f"and noise held; found anew: initial states{''.join(f', {each}' for each in freed)}. "
        f"Log-likelihood {v.log_likelihood:.3f} at the noise of the fit."
    )
    if set(v.fitted_to) & {r.name for r in v.records}:
        text = text.replace(f", which {'was' if len(v.records) == 1 else 'were'} not fitted to,", "")
    if not v.converged:
        text += f" {v.status[:1].upper()}{v.status[1:]}: {v.message}."
    said = bullets([*v.warnings, *v.in_words()])
    shown = ""
    for i, record in enumerate(v.records[:_FIGURES]):
        bands = "; yellow, tolerances about the measurements" if v.tolerances else ""
        caption = f"{record.name}: measured points, the model as fitted before, residuals beneath with ±2σ{bands}."
        shown += image(plot_validation(v, i)[0], f"Proof of match of {record.name}, validation", caption)
    if len(v.records) > _FIGURES:
        shown += f"<p>The first {_FIGURES} of {len(v.records)} records are shown.</p>"
    return section("Validation", f"<p>{escape(text)}</p>{_table(list(v.matches.values()))}{said}{shown}")


def _table(matches: list[Match]) -> str:
    rows = []
    for m in matches:
        parts = "/".join(_number(100.0 * part, ".0f") for part in (m.bias, m.variance, m.covariance))
        tolerance = "" if m.tolerance is None else m.tolerance.text()
        rows.append(
            [
                m.output,
                m.unit,
                _number(m.rms, ".4g"),
                _number(m.sigma, ".4g"),
                _number(m.theil, ".4f"),
                parts if m.bias == m.bias else "",
                _number(m.lag_one, ".2f"),
                tolerance,
                _number(100.0 * m.inside, ".1f"),
                str(m.samples),
            ]
        )
    heads = ["output", "unit", "RMS", "σ of fit", "Theil's U", "bias/var/cov, %", "lag-1", "tolerance", "inside, %"]
    return table([*heads, "samples"], rows, "llrrrrrrrr")


def _number(value: float, spec: str) -> str:
    return format(value, spec) if value == value else ""
