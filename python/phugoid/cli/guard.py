"""Run a command: its options, exit codes, and one clear line for an error."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature
from typing import Annotated, Any, get_type_hints

import typer

from ..errors import PhugoidError
from ..interrupts import interrupts

__all__ = ["INTERRUPTED", "NOT_CONVERGED", "command", "printed_summary"]

NOT_CONVERGED = 1
BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells have it


_DEBUG = Annotated[bool, typer.Option("--debug", help="Shows the traceback of an error.")]


def command(function: Callable[..., int | None]) -> Callable[..., None]:
    """Return the function that typer runs, made of a function that returns an exit code (None: 0).

    A parameter of a dataclass stands for the options that the fields of the class are; ``--debug`` is added.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[Parameter] = []
    for p in Signature.from_callable(function).parameters.values():
        if p.name in groups:
            of = get_type_hints(groups[p.name], include_extras=True)
            options = [(field.name, field.default, of[field.name]) for field in fields(groups[p.name])]
        else:
            options = [(p.name, p.default, hints[p.name])]
        parameters += [Parameter(n, Parameter.KEYWORD_ONLY, default=d, annotation=kind) for n, d, kind in options]
    parameters.append(Parameter("debug", Parameter.KEYWORD_ONLY, default=False, annotation=_DEBUG))

    @wraps(function)
    def called(debug: bool, **given: Any) -> None:
        with guard(debug):
            made = {n: kind(**{f.name: given.pop(f.name) for f in fields(kind)}) for n, kind in groups.items()}
            code = function(**made, **given)
        raise typer.Exit(code or 0)

    called.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    called.__annotations__ = {p.name: p.annotation for p in parameters}
    return called


@contextmanager
def guard(debug: bool) -> Iterator[None]:
    """Turn errors of phugoid and of the file system into a line on stderr and exit code 2, and Ctrl-C into 130.

    ``debug`` shows the traceback too. Other errors are faults of phugoid itself, and pass.
    """
    try:
        yield
    except BrokenPipeError:  # the reader of stdout, such as `head`, has closed it; typer ends quietly
        raise
    except (PhugoidError, OSError) as error:
        if debug:
            traceback.print_exc()
        # A message of several lines, as of an equation with its place, is printed whole.
        print(f"phugoid: {_text(error)}", file=sys.stderr)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        print("phugoid: interrupted", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def printed_summary(result: Any) -> str:
    """Return the summary of a result; where Ctrl-C interrupts it, a short listing of the parameters."""
    try:
        return str(result.summary())
    except KeyboardInterrupt:
        with interrupts():
            parameters = getattr(result, "parameters", {})
            return "\n".join(
                [repr(result), *(f"  {e.name} = {e.value:.6g} {e.unit}".rstrip() for e in parameters.values())]
            )


def _text(error: Exception) -> str:
    if isinstance(error, OSError) and not isinstance(error, PhugoidError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__
