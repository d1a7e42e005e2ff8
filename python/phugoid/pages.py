"""HTML pages from templates, which escape all text: their tables, pictures, equations (MathML Core) and sources."""

from __future__ import annotations

import base64
import datetime
import hashlib
import io
import os
import platform
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import phugoid._core as _core

from ._core import Expr
from .data.experiment import Experiment
from .errors import DataError
from .records import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PageTable", "Picture", "equation", "picture", "render", "sources"]

_DPI = 200  # sharp on a page of paper, and on a phone held close
_COLOURS = 128  # a palette of so many shades takes a third of the bytes, and looks the same
_PIXELS = 96.0  # of a screen in an inch
_SMALL = 6.0  # inches; what is narrower is not drawn out to the width of the page


def render(template: str, **names: Any) -> str:
    """Return the page of a template; a name that it needs and is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = PackageLoader("phugoid", "templates")
    pages = Environment(
        loader=templates, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return pages.get_template(template).render(**names)


@dataclass(frozen=True)
class PageTable:
    """A table of texts; ``align`` holds l or r for each column, t for one of sentences."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    align: str

    @property
    def columns(self) -> list[tuple[int, str, str]]:
        """Number, class and head of each column that is shown: columns without any text are left out."""
        kept = [j for j in range(len(self.heads)) if not self.rows or any(row[j] for row in self.rows)]
        return [(j, "" if self.align[j] == "l" else self.align[j], self.heads[j]) for j in kept]


@dataclass(frozen=True)
class Picture:
    """A figure as data within the page, with its size in pixels of a screen."""

    data: str
    width: int
    height: int
    small: bool


def picture(figure: Figure) -> Picture:
    """Return a figure as data within the page, and close it."""
    from matplotlib import pyplot as plt
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, dpi=_DPI, format="png")
    inches = figure.get_size_inches()
    plt.close(figure)
    drawn.seek(0)
    shown = Image.open(drawn).convert("RGB")
    shown.quantize(_COLOURS, dither=Image.Dither.NONE).save(small, "PNG", dpi=(_DPI, _DPI))
    width, height = (round(_PIXELS * float(size)) for size in inches)
    data = base64.b64encode(small.getvalue()).decode("ascii")
    return Picture(data, width, height, bool(inches[0] < _SMALL))


def sources(
    records: Sequence[Record],
    known: Mapping[str, str],
    experiments: Sequence[Experiment] = (),
    files: Sequence[str | os.PathLike[str]] = (),
) -> dict[str, Any]:
    """Return which data and versions a page comes from: records, what was done to them, facts, files with SHA-256.

    Raises DataError for a file that cannot be read.
    """
    import matplotlib
    import numpy
    import scipy

    rows = []
    for r in records:
        missing = sum(int((z != z).sum()) for z in r.measured.values())
        span = f"{r.t[0]:g} to {r.t[-1]:g} s"
        rows.append([r.name, str(r.n), span, str(missing), ", ".join(r.inputs), ", ".join(r.outputs)])
    versions = f"phugoid {_core.__version__}, Python {platform.python_version()}, numpy {numpy.__version__}, "
    versions += f"scipy {scipy.__version__}, matplotlib {matplotlib.__version__}"
    return {
        "records": PageTable(["experiment", "samples", "time", "missing values", "inputs", "outputs"], rows, "lrrrlt"),
        "steps": [f"{e.name}: {'; '.join(e.history)}" for e in experiments if e.history],
        "facts": {**known, "versions": versions, "written": datetime.date.today().isoformat()},
        "files": [_file(Path(path)) for path in files],
    }


def _file(path: Path) -> tuple[str, str, str]:
    """Return name, size and SHA-256 of a file."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read for the report ({error.strerror or error})") from error
    return path.name, f"{len(content):,}".replace(",", " "), hashlib.sha256(content).hexdigest()


_SUM, _PRODUCT, _POWER, _ATOM = 1, 2, 3, 4

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ", "tau": "τ",
    "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω",
}  # fmt: skip
_RELATIONS = {"lt": "&lt;", "le": "≤", "gt": "&gt;", "ge": "≥", "eq": "=", "ne": "≠"}
_MATH = "<math displaystyle='true'>"
_D = "<mi mathvariant='normal'>d</mi>"  # a dot above is lost in many fonts
_SIGNED = ("constant", "neg", "mul")  # a sign in front of these is that of the whole
_LONGEST = 600  # characters of the plain text; longer equations are shown as that


def equation(left: str, right: Expr, new: Collection[str] = (), *, rate: bool = False) -> str:
    """Return HTML of ``left = right``, with the symbols ``new`` marked; ``rate`` makes the left side a derivative."""
    plain = str(right)
    if len(plain) > _LONGEST:
        prime = "'" if rate else ""
        return f"<code>{escape(left)}{prime} = {escape(plain)}</code>"
    name = _symbol(left, new)
    head = f"<mfrac><mrow>{_D}{name}</mrow><mrow>{_D}<mi>t</mi></mrow></mfrac>" if rate else name
    first, *others = _terms(right)
    pieces = [f"<mrow>{head}<mo>=</mo>{_markup(first[1], new)[0]}</mrow>"]
    for operation, term in others:
        sign, text = _joined(operation, term, _markup(term, new))
        pieces.append(f"<mrow><mo form='infix'>{sign}</mo>{text}</mrow>")
    # A formula does not break; a line of several, one for each term, does where the page is narrow.
    return f"<span class='formula'>{'<wbr/>'.join(f'{_MATH}{piece}</math>' for piece in pieces)}</span>"


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
    if operation == "symbol":
        return _symbol(e.name or str(e), new), _ATOM
    if operation == "constant":
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
    return f"<mrow><mi>{name}</mi><mo>(</mo>{inside}<mo>)</mo></mrow>", _ATOM


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


def _symbol(name: str, new: Collection[str]) -> str:
    head, _, index = name.partition("_")
    text = f"<mi>{escape(_GREEK.get(head, head))}</mi>" if head else f"<mi>{escape(name)}</mi>"
    if head and index:
        below = ",".join(_GREEK.get(part, part) for part in index.split("_"))
        text = f"<msub>{text}<mtext>{escape(below)}</mtext></msub>"
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
