"""Pieces of an HTML page: all text is escaped here."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

from .style import STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["bullets", "details", "document", "image", "section", "table"]

_DPI = 200  # sharp on a page of paper, and on a phone held close
_COLOURS = 128  # a palette of so many shades takes a third of the bytes, and looks the same
_PIXELS = 96.0  # of a screen in an inch
_SMALL = 6.0  # inches; what is narrower is not drawn out to the width of the page


def document(title: str, kind: str, name: str, headline: str, outcome: str, sections: Iterable[str]) -> str:
    """A page: kind of report, of what, its result in a sentence coloured by ``outcome``; ``sections`` are markup."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header>
<p class="kind">{escape(kind)}</p>
<h1>{escape(name)}</h1>
<p class="headline {outcome}">{escape(headline)}</p>
</header>
<main>
{"".join(sections)}</main>
</body>
</html>
"""


def section(title: str, body: str) -> str:
    """A section; ``body`` is markup."""
    return f"<section>\n<h2>{escape(title)}</h2>\n{body}\n</section>\n"


def bullets(texts: Iterable[str]) -> str:
    """A list; nothing for no texts."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>" if items else ""


def details(summary: str, body: str) -> str:
    """What is shown when it is asked for, and in print; ``body`` is markup."""
    return f"<details><summary>{escape(summary)}</summary>{body}</details>\n"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], align: str) -> str:
    """A table of texts; ``align`` holds l or r for each column, t for one of sentences.

    Columns without any text are left out. Wide tables scroll by themselves on a phone.
    """
    kept = [j for j in range(len(heads)) if not rows or any(row[j] for row in rows)]
    side = {j: "" if align[j] == "l" else f" class='{align[j]}'" for j in kept}
    head = "".join(f"<th{side[j]}>{escape(heads[j])}</th>" for j in kept)
    body = "".join("<tr>" + "".join(f"<td{side[j]}>{escape(row[j])}</td>" for j in kept) + "</tr>\n" for row in rows)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table>"
    return f"<div class='wide' tabindex='0'>{table}</div>\n"


def image(figure: Figure, alt: str, caption: str = "") -> str:
    """A figure as data within the page; it is closed."""
    from matplotlib import pyplot as plt
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, dpi=_DPI, format="png")
    inches = figure.get_size_inches()
    plt.close(figure)
    drawn.seek(0)
    picture = Image.open(drawn).convert("RGB")
    picture.quantize(_COLOURS, dither=Image.Dither.NONE).save(small, "PNG", dpi=(_DPI, _DPI))
    data = base64.b64encode(small.getvalue()).decode("ascii")
    # With its size known the page does not jump while it loads.
    width, height = (round(_PIXELS * float(size)) for size in inches)
    kind = " class='small'" if inches[0] < _SMALL else ""
    under = f"<figcaption>{escape(caption)}</figcaption>" if caption else ""
    return (
        f"<figure><div class='shot' tabindex='0'><img{kind} width='{width}' height='{height}' "
        f"alt='{escape(alt, quote=True)}' src='data:image/png;base64,{data}'></div>{under}</figure>\n"
    )
