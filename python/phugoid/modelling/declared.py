"""The symbols that a declaration returns."""

from __future__ import annotations

from typing import Any, NoReturn

from .._core import Expr
from ..errors import ModelError

__all__ = ["Declared"]


class Declared(tuple[Expr, ...]):
    """A tuple of symbols, which says what is wrong where it is taken for the one symbol in it.

    ``q = m.states(q="rad/s")`` lacks a comma; Python alone would tell of a sequence that cannot be multiplied.

    >>> import phugoid as ph
    >>> q = ph.Model("m").states(q="rad/s")
    >>> 2 * q  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    phugoid.errors.ModelError: (q,) is a tuple, as declarations return it even for one symbol: ...
    """

    __slots__ = ()

    def no_expression(self, *_: Any) -> NoReturn:
        """Raises ModelError."""
        names = ", ".join(map(str, self)) + ("," if len(self) == 1 else "")
        raise ModelError(
            f"({names}) is a tuple, as declarations return it even for one symbol: write `{names} = ...`, with a comma"
        )

    def __add__(self, other: Any) -> Any:  # tuples are joined, as ever
        return tuple.__add__(self, other) if isinstance(other, tuple) else self.no_expression()

    __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = no_expression
    __truediv__ = __rtruediv__ = __pow__ = __rpow__ = __neg__ = __abs__ = no_expression
