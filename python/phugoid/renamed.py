"""Former names of attributes, which stay for one release."""

import warnings
from typing import Any


class Renamed:
    """An attribute by its former name: returns the present one, with a DeprecationWarning that gives its name."""

    def __init__(self, now: str) -> None:
        self._now = now

    def __set_name__(self, owner: type, name: str) -> None:
        self._was = name

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        warnings.warn(
            f"{owner.__name__}.{self._was} is now {owner.__name__}.{self._now}", DeprecationWarning, stacklevel=2
        )
        return getattr(instance, self._now)
