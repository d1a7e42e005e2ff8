"""Exceptions of phugoid: one base class, and one subclass for each place where the fault may lie; and checks of
options, one rule and one wording for each kind.

Each subclass is also the built-in exception that a reader would expect, so ``except ValueError`` works. Errors about a
number begin with ``what``, which names the function and the option: "bootstrap: n".
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, NoReturn, TypeVar

__all__ = [
    "ByName",
    "DataError",
    "EvaluationError",
    "MissingDependency",
    "ModelError",
    "OptionError",
    "PhugoidError",
    "ReadOnly",
    "UnknownAttribute",
    "UnknownName",
    "check_progress",
    "check_time_limit",
    "counted",
    "did_you_mean",
    "finite",
    "is_whole",
    "joined",
    "listing",
    "nearest",
    "part",
    "positive",
    "refuse_attribute",
    "some",
    "whole",
]

_LONGEST = 2000


def _shortened(text: str) -> str:
    """Return the beginning and the end of a text of more than 2,000 characters, such as an error with a large
    expression."""
    if len(text) <= _LONGEST:
        return text
    note = f" ... ({len(text)} characters) ... "
    left = _LONGEST - len(note)
    return text[: left - left // 3] + note + text[-(left // 3) :]


class PhugoidError(Exception):
    """Base of everything that phugoid raises on purpose. No message has more than 2,000 characters."""

    def __init__(self, *args: object) -> None:
        super().__init__(*(_shortened(a) if isinstance(a, str) else a for a in args))


class ModelError(PhugoidError, ValueError):
    """The model as written cannot be right: an unknown symbol, a missing equation, impossible bounds."""


class DataError(PhugoidError, ValueError):
    """The measured data, or a file that holds them, cannot be used as they are."""


class OptionError(PhugoidError, ValueError):
    """An option is out of range, or two options contradict each other."""


class EvaluationError(PhugoidError, ArithmeticError):
    """An equation gave NaN or infinity where a number is needed."""


class UnknownAttribute(PhugoidError, AttributeError):
    """A value was assigned to a method, to a read-only attribute, or to an attribute that does not exist."""


class MissingDependency(PhugoidError, ImportError):
    """An optional package that this call needs is not installed."""


class UnknownName(PhugoidError, KeyError):
    """A name was looked up that is not there; a ``KeyError``, so mappings behave as usual."""

    def __str__(self) -> str:
        # KeyError prints the repr of its argument, which would put our sentence in quotes.
        return str(self.args[0]) if self.args else ""


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Return the candidate that a name is likely to mean, or "". Letter case is ignored: a wrong case is the commonest
    slip."""
    from difflib import get_close_matches

    lowered: dict[str, str] = {}
    for candidate in candidates:
        lowered.setdefault(candidate.lower(), candidate)
    near = get_close_matches(str(name).lower(), lowered, n=1)  # a number, where text was meant, is no reason to fail
    return lowered[near[0]] if near else ""


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """Return the end of an error message: ``" Did you mean 'x'?"`` for the nearest of ``candidates``, or ``""``.

    >>> did_you_mean("Alpha", ["q", "alpha"])
    " Did you mean 'alpha'?"
    >>> did_you_mean("V", ["q", "alpha"])
    ''
    """
    meant = nearest(name, candidates)
    return f" Did you mean '{meant}'?" if meant else ""


def listing(name: str, available: Collection[str]) -> str:
    """Return the end of a message on a missing name: the nearest name, and the names there are.

    >>> listing("Q", ["q", "alpha"])
    " Did you mean 'q'? There are: q, alpha."
    """
    return f"{did_you_mean(name, available)} There are: {', '.join(available) or 'none'}."


_T = TypeVar("_T")


class ByName(dict[str, _T]):
    """A dictionary whose KeyError for an unknown name says which names there are.

    >>> ByName("output", {"q": 1, "alpha": 2})["alfa"]
    Traceback (most recent call last):
        ...
    phugoid.errors.UnknownName: there is no output 'alfa'. Did you mean 'alpha'? There are: q, alpha.
    """

    def __init__(self, what: str, values: Mapping[str, _T], hint: str = "") -> None:
        super().__init__(values)
        self._what, self._hint = what, f" {hint}" if hint else ""

    def __missing__(self, name: object) -> NoReturn:
        raise UnknownName(f"there is no {self._what} '{name}'.{listing(str(name), self)}{self._hint}")

    def _ipython_key_completions_(self) -> list[str]:
        return list(self)


class ReadOnly(Mapping[str, _T]):
    """A mapping by name that cannot be changed, with the KeyError and the completion of names of `ByName`.

    >>> ReadOnly("output", {"q": 1, "alpha": 2})
    {'q': 1, 'alpha': 2}
    """

    def __init__(self, what: str, values: Mapping[str, _T], hint: str = "") -> None:
        self._values = ByName(what, values, hint)

    def __getitem__(self, name: str) -> _T:
        return self._values[name]

    # What Mapping has for these two would make the message of a KeyError for every name that is not there.
    def get(self, name: str, default: Any = None, /) -> Any:
        """Return the value of a name, or ``default``."""
        return self._values.get(name, default)

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(dict(self._values))

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._values)


def refuse_attribute(instance: Any, kind: type, name: str, value: Any) -> None:
    """Raise UnknownAttribute unless ``value`` may be assigned as ``name`` to an instance of the public class ``kind``.

    Private names may be assigned, and a subclass may have attributes of its own.
    """
    what, public = type(instance).__name__, getattr(kind, name, None)
    if name.startswith("_"):
        return
    if callable(public):
        given = repr(value)
        given = given if len(given) <= 60 else "..."
        raise UnknownAttribute(f"{what}.{name} is a method: call it, `.{name}({given})`, instead of assigning to it")
    if public is not None:
        raise UnknownAttribute(f"{what}.{name} is read-only")
    if type(instance) is kind:
        known = [n for n in dir(kind) if not n.startswith("_")]
        article = "an" if what[0] in "AEIOU" else "a"
        raise UnknownAttribute(f"{article} {what} has no attribute '{name}'.{did_you_mean(name, known)}")


def joined(names: Sequence[str], last: str = "and") -> str:
    """Return names as a sentence lists them.

    >>> joined(["p"]), joined(["p", "q", "r"])
    ('p', 'p, q and r')
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def counted(n: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1.

    >>> counted(1, "state"), counted(0, "input")
    ('1 state', '0 inputs')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def some(names: Sequence[str], most: int = 40) -> str:
    """Return names separated by commas, the first few only where there are many."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def is_whole(value: Any) -> bool:
    """Return whether a value is a whole number."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def whole(what: str, value: Any, least: int) -> int:
    """Return a whole number not below ``least``; raise OptionError for anything else."""
    if not is_whole(value) or value < least:
        raise OptionError(f"{what} is a whole number from {least}, not {value!r}")
    return int(value)


def positive(what: str, value: Any, of: str = "") -> float:
    """Return a positive finite number; raise OptionError for anything else. ``of``: what it counts, for the message."""
    try:
        number = math.nan if isinstance(value, (bool, str)) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise OptionError(f"{what} is a positive number{f' of {of}' if of else ''}, not {value!r}")
    return number


def part(what: str, value: Any, example: str = "") -> float:
    """Return a number between 0 and 1; raise OptionError for anything else."""
    if not isinstance(value, Real) or not 0.0 < float(value) < 1.0:
        such = f", such as {example}" if example else ""
        raise OptionError(f"{what} is a number between 0 and 1{such}, not {value!r}")
    return float(value)


def finite(what: str, value: Any, error: type[PhugoidError]) -> float:
    """Return a finite number; raise the error given for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise error(f"{what} is {value!r}, not a finite number")
    return number


def check_progress(caller: str, progress: Any) -> None:
    """Raise OptionError, in the caller's name, for what is neither a truth value nor a function."""
    if not isinstance(progress, bool) and not callable(progress):
        raise OptionError(f"{caller}: progress is True, False or a function, not {progress!r}")


def check_time_limit(caller: str, time_limit: Any) -> None:
    """Raise OptionError, in the caller's name, unless a limit is a number of seconds from 0, or None."""
    number = isinstance(time_limit, Real) and not isinstance(time_limit, bool)
    if time_limit is not None and not (number and float(time_limit) >= 0):
        raise OptionError(f"{caller}: time_limit is a number of seconds from 0, or None, not {time_limit!r}")
