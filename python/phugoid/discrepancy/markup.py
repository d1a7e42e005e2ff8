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

__all__ = ["bullets", "document", "image", "section", "table"]

_DPI = 160


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


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], align: str) -> str:
    """A table of texts; ``align`` holds l or r for each column. Wide tables scroll by themselves on a phone."""
    side = [" class='r'" if a == "r" else "" for a in align]
    head = "".join(f"<th{side[j]}>{escape(text)}</th>" for j, text in enumerate(heads))
    body = "".join(
        "<tr>" + "".join(f"<td{side[j]}>{escape(text)}</td>" for j, text in enumerate(row)) + "</tr>\n" for row in rows
    )
    return f"<div class='wide'><table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>\n"


def image(figure: Figure, alt: str, caption: str) -> str:
    """A figure as data within the page; it is closed."""
    from matplotlib import pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=_DPI, format="png")
    plt.close(figure)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return (
        f"<figure><img alt='{escape(alt, quote=True)}' src='data:image/png;base64,{data}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
    )
