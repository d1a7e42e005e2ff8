"""Known constants as the user declares them, and their table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..errors import ModelError, finite
from ..notebook import Rows

__all__ = ["Constant", "constants_table", "declared_constant"]


@dataclass(frozen=True)
class Constant:
    """A known constant of the model, as declared: ``m.constants(S=Constant(30.1, "m²", "wing area"))``.

    value    in the unit.
    unit     for labels and tables only; nothing is converted.
    meaning  a few words for the table of constants.

    Raises ModelError where the value is not a finite number, or unit and meaning are not text.

    >>> Constant(30.1, "m²", "wing area").value
    30.1
    """

    value: float
    unit: str = ""
    meaning: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", finite("a constant's value", self.value, ModelError))
        for field in ("unit", "meaning"):
            if not isinstance(text := getattr(self, field), str):
                raise ModelError(f"a constant's {field} is text, not {text!r}: Constant(30.1, 'm²', 'wing area')")


def declared_constant(name: str, value: Constant | float | None) -> Constant:
    """Return what `Model.constants` was given for a name; raises as that does."""
    if value is None:
        raise ModelError(f"constant '{name}' needs a value: constants({name}=9.81) or Constant(9.81, \"m/s²\")")
    try:
        return value if isinstance(value, Constant) else Constant(value)
    except ModelError as error:
        raise ModelError(f"constant '{name}': {error}") from None


def constants_table(constants: Mapping[str, Constant]) -> Rows:
    """Return heads, rows and alignment of the table of constants."""
    rows = [[name, f"{c.value:.10g}", c.unit, c.meaning] for name, c in constants.items()]
    return ["constant", "value", "unit", "meaning"], rows, "srll"
