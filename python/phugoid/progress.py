"""Display of the iterations while a solver runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from .solvers.solution import Iteration

__all__ = ["Progress"]

Watch = Callable[[Iteration], None]


class Progress:
    """Prints the iterations: one line that is overwritten on a terminal, or every tenth iteration elsewhere."""

    def __init__(self, title: str) -> None:
        self.title = title
        self.terminal = sys.stderr.isatty()
        self.shown = -1

    def __call__(self, line: Iteration) -> None:
        text = (
            f"{self.title}: iteration {line.number:4d}  logL {line.log_likelihood:16.6f}  "
            f"defect {line.defect:8.1e}  dual {line.dual:8.1e}  step {line.step:7.1e}"
        )
        if self.terminal:
            if line.number < self.shown:  # another pass
                print(file=sys.stderr)
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
        elif line.number % 10 == 0:
            print(text, file=sys.stderr, flush=True)
        self.shown = line.number

    def close(self) -> None:
        """End the line."""
        if self.terminal and self.shown >= 0:
            print(file=sys.stderr)

    @staticmethod
    @contextmanager
    def of(progress: bool | Watch, title: str) -> Iterator[Watch | None]:
        """Yield the function to call with each iteration: None, a printed line, or the user's own function."""
        if callable(progress):
            yield progress
        elif progress:
            line = Progress(title)
            try:
                yield line
            finally:
                line.close()
        else:
            yield None
