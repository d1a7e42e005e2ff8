"""Messages on kinks and jumps of the state equations."""

from __future__ import annotations

from .. import _core

__all__ = ["kink_advice"]

_SMOOTH = {
    "sign": "smooth_sign(x, width)",
    "abs": "smooth_abs(x, width)",
    "min": "smooth_min(a, b, width)",
    "max": "smooth_max(a, b, width)",
    "lt": "smooth_step(x, width)",
    "le": "smooth_step(x, width)",
}
# Greatest number of expressions that are named.
_NAMED = 4


def kink_advice(core: _core.Model) -> str:
    """Name the kinks and jumps of a model, and the smooth functions that can stand for them; "" without any."""
    kinks = core.kinks()
    if not kinks:
        return ""
    functions = " and ".join(dict.fromkeys(f"ph.{_SMOOTH[name]}" for name, _ in kinks))
    return (
        f"the state equations have kinks or jumps: {_listed([place for _, place in kinks])}. No smooth path satisfies "
        f"such equations at the points of a mesh: write {functions}, with a width that is small beside the motion, "
        "and reduce it in steps, each with start=fit of the last"
    )


def _listed(texts: list[str]) -> str:
    """Join the first of some texts, and say how many more there are."""
    more = f" and {len(texts) - _NAMED} more" if len(texts) > _NAMED else ""
    return ", ".join(texts[:_NAMED]) + more
