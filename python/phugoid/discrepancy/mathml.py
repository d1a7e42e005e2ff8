"""Expressions as MathML Core, which browsers set without any script."""

from __future__ import annotations

from collections.abc import Collection
from html import escape

from .._core import Expr

__all__ = ["equation"]

_SUM, _PRODUCT, _POWER, _ATOM = 1, 2, 3, 4

_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta": "θ",
    "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ", "sigma": "σ", "tau": "τ",
    "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω",
}  # fmt: skip
_RELATIONS = {"lt": "&lt;", "le": "≤", "gt": "&gt;", "ge": "≥", "eq": "=", "ne": "≠"}
_LONGEST = 600  # characters of the plain text; longer equations are shown as that


def equation(left: str, right: Expr, new: Collection[str] = (), *, rate: bool = False) -> str:
    """HTML of ``left = right``, with the symbols ``new`` marked; ``rate`` puts a dot on the left side."""
    plain = str(right)
    if len(plain) > _LONGEST:
        prime = "'" if rate else ""
        return f"<code>{escape(left)}{prime} = {escape(plain)}</code>"
    name = _symbol(left, new)
    head = f"<mover accent='true'>{name}<mo>˙</mo></mover>" if rate else name
    return f"<math display='block'><mrow>{head}<mo>=</mo>{_markup(right, new)[0]}</mrow></math>"


def _markup(e: Expr, new: Collection[str]) -> tuple[str, int]:
    """Markup, and how tightly its outermost operation binds."""
    operation, arguments = e.operation
    if operation == "symbol":
        return _symbol(e.name or str(e), new), _ATOM
    if operation == "constant":
        return _constant(e.constant if e.constant is not None else float("nan"))
    of = [_markup(a, new) for a in arguments]
    if operation in ("add", "sub"):
        return _sum(operation, of), _SUM
    if operation == "mul":
        # A dot where two numbers would else run together.
        numbers = "<mn>" in of[0][0][-20:] and of[1][0].startswith("<mn>")
        between = "<mo>·</mo>" if numbers else "<mspace width='0.17em'/>"
        # A sign in front is that of the whole product.
        signed = _leads(of[0]) and arguments[0].operation[0] in ("constant", "neg")
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


def _sum(operation: str, of: list[tuple[str, int]]) -> str:
    sign, (right, tightness) = "+" if operation == "add" else "−", of[1]
    if tightness == _SUM and (operation == "sub" or _leads(of[1])):
        right = f"<mrow><mo>(</mo>{right}<mo>)</mo></mrow>"
    return f"<mrow>{of[0][0]}<mo>{sign}</mo>{right}</mrow>"


def _leads(part: tuple[str, int]) -> bool:
    """Whether it begins with a sign, which must not follow another operator."""
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
