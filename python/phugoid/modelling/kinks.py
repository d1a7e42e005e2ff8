"""Messages on kinks and jumps of the state equations."""

from __future__ import annotations

from .. import _core

__all__ = ["kink_advice", "name_kinks", "width_unit"]

_SMOOTH = {
    "sign": "smooth_sign(x, width)",
    "abs": "smooth_abs(x, width)",
    "min": "smooth_min(a, b, width)",
    "max": "smooth_max(a, b, width)",
    "lt": "smooth_step(x, width)",
    "le": "smooth_step(x, width)",
}
# Greatest number of expressions that are named, and of their characters.
_NAMED, _LONG = 4, 60


def kink_advice(core: _core.Model) -> str:
    """Name the kinks and jumps of a model, and the smooth functions that can stand for them; "" without any."""
    kinks = core.kinks()
    if not kinks:
        return ""
    functions = " and ".join(dict.fromkeys(f"ph.{_SMOOTH[name]}" for _, name, *_ in kinks))
    return (
        f"the state equations have kinks or jumps: {_listed(name_kinks(core))}. No smooth path satisfies such "
        f"equations at the points of a mesh: write {functions}, with a width that is small beside the motion, "
        "and reduce it in steps, each with start=fit of the last"
    )


def name_kinks(core: _core.Model) -> list[str]:
    """Return for each kink of a model its expression and its equation, as in "sign(v) in v'"."""
    return [f"{text if len(text) <= _LONG else name + '(...)'} in {place}" for place, name, text, _ in core.kinks()]


def _listed(texts: list[str]) -> str:
    """Join the first of some texts, and say how many more there are."""
    more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
    return ", ".join(texts[:_NAMED]) + more


def width_unit(core: _core.Model, argument: _core.Expr) -> str:
    """Return the unit of the argument of a kink: that of a state in which it has the slope 1 or -1; "" of others."""
    for name, unit in core.states:
        if name in argument.symbols and argument.diff(name).constant in (1.0, -1.0):
            return unit
    return ""
