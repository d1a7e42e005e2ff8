"""What the user declares of a state beside its unit."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ModelError
from ..parameters import Parameter

__all__ = ["State"]


@dataclass(frozen=True)
class State:
    """A state as declared: ``m.states(x=State("m", start=1.0, bounds=(0.01, 10)))``.

    unit    for labels and tables only; nothing is converted.
    start   where its path starts that no output measures; None leaves the choice to `estimate`: the value that
            `Model.initial` gives, else 0, or 1 where the model has no finite derivative at 0, as sqrt(x).
    bounds  ``(lower, upper)``, kept at the points of the mesh (`Collocation`), where segments start
            (`MultipleShooting`), or at the first sample (`SingleShooting`). A bound where the model has no finite
            derivative, as 0 for sqrt(x), does not help: give a small number above it.

    Raises ModelError where a value is not a number, the bounds leave no room, or ``start`` lies outside them.

    >>> State("m", start=0.5, bounds=(0, 1)).bounds
    (0.0, 1.0)
    """

    unit: str = ""
    start: float | None = None
    bounds: tuple[float, float] = (-math.inf, math.inf)

    def __post_init__(self) -> None:
        inside = self.start
        if inside is None:  # any number between the bounds
            try:
                low, high = (float(b) for b in self.bounds)
            except (TypeError, ValueError):
                low, high = -math.inf, math.inf  # wrong in itself, as is told below
            inside = min(max(0.0, low), high)
            inside = inside if math.isfinite(inside) else 0.0
        try:
            checked = Parameter(inside, self.bounds, self.unit)
        except ModelError as error:
            raise ModelError(str(error).replace("a parameter's", "a state's").split(": use Parameter(")[0]) from None
        object.__setattr__(self, "bounds", checked.bounds)
        if self.start is not None:
            object.__setattr__(self, "start", checked.start)
