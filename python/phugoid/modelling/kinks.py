"""Advice on kinks and jumps in the state equations of a fit that did not converge."""

from __future__ import annotations

from .. import _core

__all__ = ["kink_advice"]

_SMOOTH = {
    "sign": "smooth_sign(x, width)",
    "abs": "smooth_abs(x, width)",
    "min": "smooth_min(a, b, width)",
    "max": "smooth_max(a, b, width)",
    "where": "smooth_step(x, width)",
}
# No more expressions are named, none in more characters.
_NAMED, _LONG = 4, 60


def kink_advice(core: _core.Model) -> str:
    """Name the kinks and jumps of a model, and the smooth functions that can stand for them; "" without any."""
    kinks = list(dict.fromkeys(core.kinks()))
    if not kinks:
        return ""
    named = [f"{text if len(text) <= _LONG else name + '(...)'} in {place}" for place, name, text in kinks[:_NAMED]]
    more = f" and {len(kinks) - _NAMED} more" if len(kinks) > _NAMED else ""
    functions = " and ".join(dict.fromkeys(f"ph.{_SMOOTH[name]}" for _, name, _ in kinks))
    return (
        f"the state equations have kinks or jumps: {', '.join(named)}{more}. No smooth path satisfies such equations "
        f"at the points of a mesh: write {functions}, with a width that is small beside the motion, and reduce it in "
        "steps, each with start=fit of the last"
    )
