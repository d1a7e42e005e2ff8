"""What phugoid raises: one base class, and one subclass for each place where the fault may lie.

Each subclass is also the built-in exception that a reader would expect, so ``except ValueError`` works.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

__all__ = [
    "DataError",
    "EvaluationError",
    "MissingDependency",
    "ModelError",
    "OptionError",
    "PhugoidError",
    "UnknownName",
    "did_you_mean",
    "listing",
]


_LONGEST = 2000


def _shortened(text: str) -> str:
    """The beginning and the end of a text of more than 2,000 characters, such as an error with a large expression."""
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


class MissingDependency(PhugoidError, ImportError):
    """An optional package that this call needs is not installed."""


class UnknownName(PhugoidError, KeyError):
    """A name was looked up that is not there; a ``KeyError``, so mappings behave as usual."""

    def __str__(self) -> str:
        # KeyError prints the repr of its argument, which would put our sentence in quotes.
        return str(self.args[0]) if self.args else ""


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """The end of an error message: ``" Did you mean 'x'?"`` for the nearest of ``candidates``, or ``""``.

    Letter case is ignored, since a wrong case is the commonest slip.

    >>> did_you_mean("Alpha", ["q", "alpha"])
    " Did you mean 'alpha'?"
    >>> did_you_mean("V", ["q", "alpha"])
    ''
    """
    from difflib import get_close_matches

    lowered: dict[str, str] = {}
    for candidate in candidates:
        lowered.setdefault(candidate.lower(), candidate)
    near = get_close_matches(str(name).lower(), lowered, n=1)  # a number, where text was meant, is no reason to fail
    return f" Did you mean '{lowered[near[0]]}'?" if near else ""


def listing(name: str, available: Collection[str]) -> str:
    """The end of a message on a missing name: the nearest name, and what there is.

    >>> listing("Q", ["q", "alpha"])
    " Did you mean 'q'? There are: q, alpha."
    """
    return f"{did_you_mean(name, available)} There are: {', '.join(available) or 'none'}."
