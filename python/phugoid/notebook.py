"""Short HTML that notebooks show for an object: a title, sentences, tables, time histories as small pictures; and
equations as HTML with MathML Core, which every current browser draws by itself.

All text is escaped, but for what these functions made themselves (`Html`). Text has the colours of the notebook, so
that dark themes work; tables are cut off after `MOST` rows.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._core import Expr, symbol_parts

__all__ = [
    "Html",
    "Rows",
    "bullets",
    "channels_table",
    "equation",
    "notebook_page",
    "overview",
    "paragraph",
    "readable",
    "readable_latex",
    "sparkline",
    "symbol",
    "table",
]

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


def escape(text: str) -> str:
    """Return a text in which the characters that HTML takes for its own are escaped."""
    from html import escape  # not at import: it brings a table of all characters that have a name

    return escape(text)


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
    """Return a table; ``align`` holds l or r for each column, s for one of the names of symbols. Columns without any
    text are left out.

    >>> table(["name", "value"], [["a<b", "1"]], "lr").count("<td")
    2
    """
    kept = [j for j in range(len(heads)) if any(row[j] for row in rows)]
    if not kept:
        return Html("")
    side = {j: f"style='{_CELL};text-align:{'right' if align[j] == 'r' else 'left'}'" for j in kept}
    head = "".join(f"<th {side[j]}>{_escaped(heads[j])}</th>" for j in kept)
    write = {j: symbol if align[j] == "s" else _escaped for j in kept}
    body = "".join(
        "<tr>" + "".join(f"<td {side[j]}>{write[j](row[j])}</td>" for j in kept) + "</tr>" for row in rows[:MOST]
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


_SUM, _PRODUCT, _POWER, _ATOM = 1, 2, 3, 4

# A name with more underscores is written as it is.
_INDICES = 2
_RELATIONS = {"lt": "&lt;", "le": "≤", "gt": "&gt;", "ge": "≥", "eq": "=", "ne": "≠"}
# Smooth forms of a saturation, u limited to ±s, and of a dead-band, u less that.
_CLIP = re.compile(
    r"0\.5\*\(sqrt\(\((\w+) \+ (\w+)\)\*\(\1 \+ \2\) \+ [\d.e+-]+\) - sqrt\(\(\1 - \2\)\*\(\1 - \2\) \+ [\d.e+-]+\)\)"
)
# The same in LaTeX.
_LATEX_CLIP = re.compile(
    r"0\.5 \\, \\left\(\\sqrt\{\\left\(([^()]+?) \+ ([^()]+?)\\right\) \\, \\left\(\1 \+ \2\\right\) \+ [^()]+?\} - "
    r"\\sqrt\{\\left\(\1 - \2\\right\) \\, \\left\(\1 - \2\\right\) \+ [\d.]+(?: \\cdot 10\^\{-?\d+\})?\}\\right\)"
)
_LATEX_CLIPPED = r"\\operatorname\{clip\}\\left\([^()]+, \\pm [^()]+\\right\)"
_LIMITED = re.compile(r"(\w+ - )?clip\((\w+), ±(\w+)\)")
# Other fonts have no place for subscripts, and browsers do not choose one of these by themselves.
_FONTS = "Latin Modern Math, STIX Two Math, Cambria Math, DejaVu Math TeX Gyre, math"
_MATH = f"<math displaystyle='true' style='font-family: {_FONTS}'>"
_D = "<mi mathvariant='normal'>d</mi>"  # a dot above is lost in many fonts
_SIGNED = ("constant", "neg", "mul")  # a sign in front of these is that of the whole
_LONGEST = 600  # characters of the plain text; longer equations are shown as that


def readable(text: str) -> str:
    """Return the text of an expression with smooth saturations and dead-bands as what they are.

    >>> readable("b*(u + (-(0.5*(sqrt((u + s)*(u + s) + 9e-6) - sqrt((u - s)*(u - s) + 9e-6)))))")
    'b*(u - clip(u, ±s))'
    """
    text = _CLIP.sub(r"clip(\1, ±\2)", text)
    text = re.sub(r"(\w+) \+ \(-\((clip\(\1, ±\w+\))\)\)", r"\1 - \2", text)
    text = re.sub(r"(\w+) \+ (clip\(\1, ±\w+\)) - \1(?!\w)", r"\2", text)
    return re.sub(r"(?<!\w)\((clip\(\w+, ±\w+\))\)", r"\1", text)  # parentheses that what went had needed


def readable_latex(text: str) -> str:
    r"""Return LaTeX of an expression with smooth saturations and dead-bands as what they are; see `readable`.

    >>> u, s = Expr.symbol("u"), Expr.symbol("s")
    >>> e = u - 0.5 * (((u + s) * (u + s) + 9e-6).sqrt() - ((u - s) * (u - s) + 9e-6).sqrt())
    >>> print(readable_latex(e.latex()))
    u - \operatorname{clip}\left(u, \pm s\right)
    """
    text = _LATEX_CLIP.sub(r"\\operatorname{clip}\\left(\1, \\pm \2\\right)", text)
    text = re.sub(rf"\+ \\left\(-\\left\(({_LATEX_CLIPPED})\\right\)\\right\)", r"- \1", text)
    u = r"(?<![\w}])([^()]{1,99}?)"
    text = re.sub(rf"{u} \+ (\\operatorname\{{clip\}}\\left\(\1, \\pm [^()]+\\right\)) - \1(?![\w_])", r"\2", text)
    return re.sub(rf"\\left\(({_LATEX_CLIPPED})\\right\)", r"\1", text)


def equation(left: str, right: Expr, new: Collection[str] = (), *, rate: bool = False, cut: int | None = None) -> Html:
    """Return HTML of ``left = right``, with the symbols ``new`` marked; ``rate`` makes the left side a derivative.

    ``cut``: greatest number of characters of an equation as plain text; a longer one ends with an ellipsis.
    """
    plain = readable(str(right))
    if len(plain) > (_LONGEST if cut is None else min(cut, _LONGEST)):
        prime = "'" if rate else ""
        shown = plain if cut is None or len(plain) <= cut else f"{plain[:cut]}…"
        return Html(f"<code>{escape(left)}{prime} = {escape(shown)}</code>")
    name = _symbol(left, new)
    head = f"<mfrac><mrow>{_D}{name}</mrow><mrow>{_D}<mi>t</mi></mrow></mfrac>" if rate else name
    first, *others = _terms(right)
    pieces = [f"<mrow>{head}<mo>=</mo>{_markup(first[1], new)[0]}</mrow>"]
    for operation, term in others:
        sign, text = _joined(operation, term, _markup(term, new))
        pieces.append(f"<mrow><mo form='infix'>{sign}</mo>{text}</mrow>")
    # A formula does not break; a line of several, one for each term, does where the page is narrow.
    return Html(f"<span class='formula'>{'<wbr/>'.join(f'{_MATH}{piece}</math>' for piece in pieces)}</span>")


def _terms(e: Expr) -> list[tuple[str, Expr]]:
    """Return the terms of a sum in order, each with the operation that joins it to those before."""
    joined: list[tuple[str, Expr]] = []
    while e.operation[0] in ("add", "sub"):
        operation, (e, last) = e.operation
        joined.append((operation, last))
    return [("add", e), *reversed(joined)]


def _markup(e: Expr, new: Collection[str]) -> tuple[str, int]:
    """Return the markup of an expression, and the precedence of its outermost operation."""
    operation, arguments = e.operation
    if operation in ("mul", "add", "sub") and (m := _LIMITED.fullmatch(readable(str(e)))):
        within, limit = _symbol(m[2], new), _symbol(m[3], new)
        clip = f"<mi>clip</mi><mo>(</mo>{within}<mo>,</mo><mo>±</mo>{limit}<mo>)</mo>"
        return (f"<mrow>{within}<mo>−</mo>{clip}</mrow>", _SUM) if m[1] else (f"<mrow>{clip}</mrow>", _ATOM)
    if operation == "symbol":
        return _symbol(e.name or str(e), new), _ATOM
    if operation == "constant":
        if e.constants:
            return _symbol(e.constants[0][0], new), _ATOM
        return _constant(e.constant if e.constant is not None else float("nan"))
    of = [_markup(a, new) for a in arguments]
    if operation in ("add", "sub"):
        return _sum(operation, arguments[1], of), _SUM
    if operation == "mul":
        # A dot before a number, which would else run together with what is before it.
        number = of[1][0].replace("<mrow>", "").startswith(("<mn>", "<mfrac><mrow><mn>", "<mfrac><mn>"))
        between = "<mo>·</mo>" if number else "<mspace width='0.17em'/>"
        # A sign in front is that of the whole product.
        signed = _leads(of[0]) and arguments[0].operation[0] in _SIGNED
        left = of[0][0] if signed else _fenced(of[0], _PRODUCT)
        return f"<mrow>{left}{between}{_fenced(of[1], _PRODUCT, _leads(of[1]))}</mrow>", _SUM if signed else _PRODUCT
    if operation == "div":
        return f"<mfrac><mrow>{of[0][0]}</mrow><mrow>{of[1][0]}</mrow></mfrac>", _ATOM
    if operation == "recip":
        return f"<mfrac><mn>1</mn><mrow>{of[0][0]}</mrow></mfrac>", _ATOM
    if operation == "neg":
        return f"<mrow><mo>−</mo>{_fenced(of[0], _PRODUCT)}</mrow>", _SUM
    if operation == "pow":
        return f"<msup><mrow>{_fenced(of[0], _ATOM)}</mrow><mrow>{of[1][0]}</mrow></msup>", _POWER
    if operation == "sqrt":
        return f"<msqrt>{of[0][0]}</msqrt>", _ATOM
    if operation == "abs":
        return f"<mrow><mo>|</mo>{of[0][0]}<mo>|</mo></mrow>", _ATOM
    if operation in _RELATIONS:
        return f"<mrow>{of[0][0]}<mo>{_RELATIONS[operation]}</mo>{of[1][0]}</mrow>", 0
    inside = "<mo>,</mo>".join(text for text, _ in of)
    name = escape(str(e).partition("(")[0] if operation == "lookup" else operation)
    # Brackets grow with fractions alone: without a font for formulas those around a Greek letter would.
    fixed = "" if "<mfrac>" in inside else " stretchy='false'"
    return f"<mrow><mi>{name}</mi><mo{fixed}>(</mo>{inside}<mo{fixed}>)</mo></mrow>", _ATOM


def _sum(operation: str, term: Expr, of: list[tuple[str, int]]) -> str:
    sign, right = _joined(operation, term, of[1])
    return f"<mrow>{of[0][0]}<mo>{sign}</mo>{right}</mrow>"


def _joined(operation: str, term: Expr, part: tuple[str, int]) -> tuple[str, str]:
    """Return the sign before a term, and the term, in brackets where they are needed."""
    text, tightness = part
    if operation == "add" and _leads(part) and term.operation[0] in _SIGNED:
        return "−", text.replace("<mo>−</mo>", "", 1)  # a + (−b) is a − b
    if tightness == _SUM and (operation == "sub" or _leads(part)):
        text = f"<mrow><mo>(</mo>{text}<mo>)</mo></mrow>"
    return "+" if operation == "add" else "−", text


def _leads(part: tuple[str, int]) -> bool:
    """Return whether the markup begins with a sign, which must not follow another operator."""
    return part[0].replace("<mrow>", "").startswith("<mo>−")


def _fenced(part: tuple[str, int], least: int, always: bool = False) -> str:
    text, tightness = part
    return f"<mrow><mo>(</mo>{text}<mo>)</mo></mrow>" if always or tightness < least else text


def symbol(name: str) -> Html:
    """Return the name of a symbol typeset, and the name itself where a pointer rests: of `Cma` C with the index mα.

    >>> symbol("Cma")
    "<span title='Cma'>C<sub>mα</sub></span>"
    >>> symbol("mass")
    'mass'
    """
    base, bracket, experiment = name.partition("[")  # a local parameter has the name of its experiment
    head, index = _parts(base)
    shown = escape(head) + (f"<sub>{escape(index)}</sub>" if index else "") + escape(bracket + experiment)
    return Html(shown if shown == escape(name) else f"<span title='{escape(name)}'>{shown}</span>")


def _parts(name: str) -> tuple[str, str]:
    """Return the head of a symbol and its index, "" for none; a name that is no symbol is all head."""
    head, *indices = symbol_parts(name)
    # Neither is a name such as q_dot_q_abs_q a symbol with indices, nor a text.
    if len(indices) > _INDICES or not all((head, *indices)) or not name.isidentifier():
        return name, ""
    return head, ",".join(indices)


def _symbol(name: str, new: Collection[str]) -> str:
    head, index = _parts(name)
    text = f"<mi>{escape(head)}</mi>"
    if index:
        text = f"<msub>{text}<mtext>{escape(index)}</mtext></msub>"
    return f"<mrow class='new'>{text}</mrow>" if name in new else text


def _constant(value: float) -> tuple[str, int]:
    digits, _, power = f"{abs(value):.6g}".partition("e")
    text = f"<mn>{digits}</mn>"
    if power:
        ten = f"<msup><mn>10</mn><mn>{'−' if power.startswith('-') else ''}{power.lstrip('+-0')}</mn></msup>"
        text = f"<mrow>{text}<mo>·</mo>{ten}</mrow>"
    if value < 0.0:
        return f"<mrow><mo>−</mo>{text}</mrow>", _SUM
    return text, _PRODUCT if power else _ATOM
