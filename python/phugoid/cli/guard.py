"""How a command ends: exit codes, and one clear line where something is wrong."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from ..errors import PhugoidError
from ..interrupts import interrupts

__all__ = ["BAD_INPUT", "INTERRUPTED", "NOT_CONVERGED", "guard", "told"]

NOT_CONVERGED = 1
BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells have it


@contextmanager
def guard(debug: bool) -> Iterator[None]:
    """Turns errors of phugoid and of the file system into a line on stderr and exit code 2, Ctrl-C into 130.

    ``debug`` shows the traceback too. Other errors are faults of phugoid itself, and pass.
    """
    try:
        yield
    except BrokenPipeError:  # whoever read stdout, such as `head`, has enough; typer ends quietly
        raise
    except (PhugoidError, OSError) as error:
        if debug:
            traceback.print_exc()
        # A message of several lines, as of an equation with its place, is told whole.
        print(f"phugoid: {_text(error)}", file=sys.stderr)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        print("phugoid: interrupted", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


def told(result: Any) -> str:
    """The summary; where Ctrl-C is pressed while it is made, what is at hand."""
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
