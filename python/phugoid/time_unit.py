"""The unit of a model's time, and the units of frequencies and rates that follow from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .errors import ModelError, PhugoidError

__all__ = ["SECONDS", "UNKNOWN", "TimeUnit", "time_unit_of"]

# Ways to write one unit: a rate may be in "g/h" where time is in "hours".
_SPELLINGS = (
    ("s", "sec", "second", "seconds"),
    ("ms", "msec", "millisecond", "milliseconds"),
    ("min", "minute", "minutes"),
    ("h", "hr", "hour", "hours"),
    ("day", "d", "days"),
)
# One rate alone may be in a unit of its own.
_RATES = 2


class TimeUnit(str):
    """A unit of time as text, empty where it is not known.

    >>> hours = TimeUnit("h")
    >>> hours.frequency, hours.rate("g"), hours.rate("g/h"), hours.rate(""), hours.axis("lag")
    ('1/h', 'g/h', 'g/h²', '1/h', 'lag, h')
    >>> hours.of("3 to 4"), hours.per("0.5"), TimeUnit("").of("3 to 4"), TimeUnit("").per("0.5")
    ('3 to 4 h', '0.5 1/h', '3 to 4', '0.5')
    >>> TimeUnit("s").frequency, hours.is_rate("g/hour"), hours.is_rate("m/s")
    ('Hz', True, False)
    """

    @classmethod
    def checked(cls, given: Any, who: str, error: type[PhugoidError] = ModelError) -> TimeUnit:
        """Return the unit that a user gave; raise an error, in the name of ``who``, unless it is one."""
        text = given.strip() if isinstance(given, str) else ""
        if not text or not text.isprintable() or "/" in text or text[0].isdigit():
            raise error(
                f"{who}: time_unit is a unit of time as text, such as 's', 'ms', 'min', 'h' or 'day', not {given!r}"
            )
        return cls(text)

    @property
    def frequency(self) -> str:
        """The unit of frequencies."""
        return "Hz" if "s" in self._spellings else f"1/{self}" if self else ""

    @property
    def angular_rates(self) -> tuple[str, ...]:
        """Units of angular rates, in all spellings."""
        return tuple(f"{angle}/{unit}" for angle in ("rad", "deg", "°", "1") for unit in self._spellings)

    @property
    def _spellings(self) -> tuple[str, ...]:
        return next((group for group in _SPELLINGS if self in group), (str(self),))

    def rate(self, unit: str) -> str:
        """Return the unit of a derivative with respect to time."""
        return f"{unit}²" if self.is_rate(unit) else f"{unit or '1'}/{self}"

    def is_rate(self, unit: str) -> bool:
        """Return whether a unit is one per unit of time."""
        return unit.endswith(tuple(f"/{spelling}" for spelling in self._spellings))

    def other(self, units: Mapping[str, str]) -> tuple[str, list[str]]:
        """Return another unit of time that all rates among some units by name have, and the names of these rates; ""
        and none where there is none, or only one rate.

        >>> SECONDS.other({"k": "1/h", "dose": "mg/h", "V": "L"}), SECONDS.other({"k": "1/h", "v": "m/s"})
        (('h', ['k', 'dose']), ('', []))
        """
        rates = {group[0]: [n for n, u in units.items() if TimeUnit(group[0]).is_rate(u)] for group in _SPELLINGS}
        found = [(unit, names) for unit, names in rates.items() if names]
        if len(found) != 1 or len(found[0][1]) < _RATES or found[0][0] in self._spellings:
            return "", []
        return found[0]

    def axis(self, what: str = "time") -> str:
        """Return the label of an axis of times."""
        return f"{what}, {self}" if self else what

    def of(self, number: str) -> str:
        """Return a number of times with its unit."""
        return f"{number} {self}" if self else number

    def per(self, number: str) -> str:
        """Return a number of frequencies with its unit."""
        return f"{number} {self.frequency}" if self else number


SECONDS, UNKNOWN = TimeUnit("s"), TimeUnit("")


def time_unit_of(units: Mapping[str, str], default: str = SECONDS) -> TimeUnit:
    """Return the unit of time from units by name, which have it under the name of time's symbol; else the default."""
    return TimeUnit(units.get("time", default))
