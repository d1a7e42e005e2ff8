"""Short HTML that notebooks show for an object: a title, sentences, tables, and time histories as small pictures.

All text is escaped, but for what these functions made themselves (`Html`). Text has the colours of the notebook, so
that dark themes work; tables are cut off after `MOST` rows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Html", "Rows", "bullets", "channels_table", "notebook_page", "overview", "paragraph", "sparkline", "table"]

MOST = 25
"""Rows of a table; a note says how many more there are."""

_WIDTH, _HEIGHT = 120, 22  # pixels of a picture
_MEASURED, _MODEL = "#0072B2", "#D55E00"  # as in the figures
_CELL = "padding:1px 8px;border:0;vertical-align:middle"


class Html(str):
    """Text that is HTML already, and is not escaped again."""


_Cell: TypeAlias = "str | Html"

Rows: TypeAlias = "tuple[Sequence[str], Sequence[Sequence[str]], str]"
"""Heads, rows and alignment of a table: what `table` and `parameters.text_table` take."""


def _escaped(text: str) -> str:
    return text if isinstance(text, Html) else escape(text)


def notebook_page(title: str, *parts: Html, note: str = "") -> str:
    """Return the HTML of an object: a title in bold, a note beside it, and the parts below."""
    beside = f" <span style='opacity:.7'>{escape(note)}</span>" if note else ""
    body = "".join(parts)
    return f"<div class='phugoid' style='overflow-x:auto'><div><b>{escape(title)}</b>{beside}</div>{body}</div>"


def overview(
    title: str, *parts: Rows | Html, remarks: Iterable[str] = (), pictures: Mapping[str, Html] = {}, note: str = ""
) -> str:
    """Return the HTML of a result from the tables of its summary and remarks.

    ``pictures``: first cell of a row -> the picture at its end.
    """
    shown = [part if isinstance(part, Html) else _pictured(part, pictures) for part in parts]
    return notebook_page(title, *shown, bullets(remarks), note=note)


def _pictured(rows: Rows, pictures: Mapping[str, Html]) -> Html:
    heads, cells, align = rows
    return table([*heads, ""], [[*row, pictures.get(row[0], "")] for row in cells], f"{align}l")


def paragraph(text: str) -> Html:
    """Return a paragraph; nothing for an empty text."""
    return Html(f"<p style='margin:.3em 0;max-width:60em'>{_escaped(text)}</p>" if text else "")


def bullets(texts: Iterable[str]) -> Html:
    """Return a list; nothing for no texts."""
    items = "".join(f"<li>{_escaped(text)}</li>" for text in texts)
    return Html(f"<ul style='margin:.3em 0;max-width:60em'>{items}</ul>" if items else "")


def table(heads: Sequence[str], rows: Sequence[Sequence[_Cell]], align: str) -> Html:
    """Return a table; ``align`` holds l or r for each column. Columns without any text are left out.

    >>> table(["name", "value"], [["a<b", "1"]], "lr").count("<td")
    2
    """
    kept = [j for j in range(len(heads)) if any(row[j] for row in rows)]
    if not kept:
        return Html("")
    side = {j: f"style='{_CELL};text-align:{'right' if align[j] == 'r' else 'left'}'" for j in kept}
    head = "".join(f"<th {side[j]}>{_escaped(heads[j])}</th>" for j in kept)
    body = "".join(
        "<tr>" + "".join(f"<td {side[j]}>{_escaped(row[j])}</td>" for j in kept) + "</tr>" for row in rows[:MOST]
    )
    more = paragraph(f"and {len(rows) - MOST} more" if len(rows) > MOST else "")
    return Html(f"<table style='margin:.3em 0'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{more}")


def channels_table(
    groups: Mapping[str, Mapping[str, NDArray[np.float64]]], units: Mapping[str, str], t: NDArray[np.float64]
) -> Html:
    """Return a row for each channel of the groups (kind -> name -> values): unit, range, missing samples, picture."""
    rows = []
    for kind, channels in groups.items():
        for name, values in channels.items():
            there = values[np.isfinite(values)]
            low, high = (f"{there.min():.4g}", f"{there.max():.4g}") if there.size else ("", "")
            missing = str(values.size - there.size) if there.size < values.size else ""
            rows.append([name, kind, units.get(name, ""), low, high, missing, sparkline(values, t=t)])
    return table(["channel", "", "unit", "least", "greatest", "missing", ""], rows, "lllrrrl")


def sparkline(values: ArrayLike, model: ArrayLike | None = None, t: ArrayLike | None = None) -> Html:
    """Return a time history as a small picture (SVG), with that of a model over it; gaps stay open, peaks are kept.

    ``t``: (N,) times; None: evenly spaced. Nothing is drawn of fewer than two finite values.

    >>> sparkline([0.0, 1.0, float("nan"), 0.5, 2.0]).count("<polyline")
    2
    """
    lines = [(np.asarray(values, dtype=float), _MEASURED)]
    if model is not None:
        lines.append((np.asarray(model, dtype=float), _MODEL))
    n = lines[0][0].size
    times = np.arange(n, dtype=float) if t is None else np.asarray(t, dtype=float)
    finite = np.concatenate([v[np.isfinite(v)] for v, _ in lines])
    if finite.size < 2 or not times[-1] > times[0]:
        return Html("")
    low, span = float(finite.min()), float(np.ptp(finite)) or 1.0
    x = 1.0 + (_WIDTH - 2.0) * (times - times[0]) / (times[-1] - times[0])
    drawn = "".join(
        f"<polyline points='{piece}' fill='none' stroke='{color}' stroke-width='1'/>"
        for v, color in lines
        for piece in _pieces(x, _HEIGHT - 2.0 - (_HEIGHT - 4.0) * (v - low) / span)
    )
    text = escape(f"{low:.4g} to {low + span:.4g}")
    return Html(
        f"<svg width='{_WIDTH}' height='{_HEIGHT}' viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img' "
        f"style='vertical-align:middle'><title>{text}</title>{drawn}</svg>"
    )


def _pieces(x: NDArray[np.float64], y: NDArray[np.float64]) -> list[str]:
    """Return the points of the lines between gaps: the least and the greatest value of each column of pixels, in time
    order."""
    there = np.isfinite(y)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        column = np.floor(x[begin:end]).astype(int)
        kept: list[int] = []  # no more than two a column, whatever the length of the record
        for part in np.split(np.arange(begin, end), np.flatnonzero(np.diff(column)) + 1):
            kept += sorted({int(part[np.argmin(y[part])]), int(part[np.argmax(y[part])])})
        found.append(" ".join(f"{x[k]:.1f},{y[k]:.1f}" for k in kept))
    return found
