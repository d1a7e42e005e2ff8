"""Shows how far long work has come: in one line on a terminal and in a notebook, in new lines elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["StatusLine", "bar", "remaining", "steps_shown"]

_CELLS = 20
# Seconds between steps that are shown where each takes a line.
_EVERY = 5.0


def bar(done: int, total: int) -> str:
    """Return a bar of what is done, with the numbers.

    >>> bar(5, 20)
    '━━━━━─────────────── 5/20'
    """
    full = _CELLS * done // max(total, 1)
    return f"{'━' * full}{'─' * (_CELLS - full)} {done}/{total}"


def remaining(began: float, done: int, total: int) -> str:
    """Return the time that the rest will take at the rate so far, "" where that is not known.

    ``began``: `time.monotonic` when the work began. ``done``: what has been done since.
    """
    if not 0 < done < total:
        return ""
    seconds = round((time.monotonic() - began) / done * (total - done))
    return f"{seconds // 60}:{seconds % 60:02d} left"


class StatusLine:
    """Shows one line of text on stderr, or beneath the cell of a notebook."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._notebook = not self._terminal and _in_notebook()
        self._handle: Any = None
        self._shown = False

    @property
    def is_overwritten(self) -> bool:
        """Return whether a text takes the place of the one before, so that texts may come often."""
        return self._terminal or self._notebook

    def show(self, text: str) -> None:
        """Show a text of one line."""
        self._shown = True
        if self._notebook:
            from IPython.display import display  # there, since a notebook runs

            said = {"text/plain": text}
            if self._handle is None:
                self._handle = display(said, raw=True, display_id=True)
            else:
                self._handle.update(said, raw=True)
        elif self._terminal:
            # A line that wraps could not be overwritten.
            import shutil  # not at import: it takes its time

            print(f"\r\x1b[K{text[: shutil.get_terminal_size().columns - 1]}", end="", file=sys.stderr, flush=True)
        else:
            print(text, file=sys.stderr, flush=True)

    def keep(self) -> None:
        """End the line: it stays, and the next text is shown on a new one."""
        if self._terminal and self._shown:
            print(file=sys.stderr)
        self._handle, self._shown = None, False


@contextmanager
def steps_shown(work: str, progress: bool | Callable[[str], None]) -> Iterator[Callable[[str], None]]:
    """Yield a function to call with each step of a work: it shows the step, and the time since the first, or calls
    ``progress``, where that is a function; where that is False it does nothing."""
    if callable(progress) or not progress:
        yield progress if callable(progress) else lambda _: None
        return
    line, began, shown = StatusLine(), time.monotonic(), -math.inf

    def show(text: str) -> None:
        nonlocal shown
        now = time.monotonic()
        if line.is_overwritten or now - shown > _EVERY:
            shown = now
            line.show(f"{work}, {now - began:.0f} s: {text}")

    try:
        yield show
        line.show(f"{work}: done after {time.monotonic() - began:.1f} s")
    finally:
        line.keep()


def _in_notebook() -> bool:
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in shell.config
