"""Equations as HTML with MathML Core, which every current browser draws by itself."""

from __future__ import annotations

from collections.abc import Collection
from html import escape

from ._core import Expr
from .notebook import Html

__all__ = ["equation"]

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


def equation(left: str, right: Expr, new: Collection[str] = (), *, rate: bool = False, cut: int | None = None) -> Html:
    """Return HTML of ``left = right``, with the symbols ``new`` marked; ``rate`` makes the left side a derivative.

    ``cut``: greatest number of characters of an equation as plain text; a longer one ends with an ellipsis.
    """
    plain = str(right)
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
