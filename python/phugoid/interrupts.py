"""Deferred Ctrl-C: a result that is being put together is not lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["interrupts"]

# Number of presses that are counted; one more raises KeyboardInterrupt, for a user who needs no result at all.
_COUNTED = 2


@contextmanager
def interrupts() -> Iterator[Callable[[], int]]:
    """Defer Ctrl-C within the context; yield a function that returns how often it was pressed. The third one raises.

    In another thread than the main one, and where someone has a handler of their own, nothing is changed, and nothing
    counted.
    """
    count = 0

    def pressed() -> int:
        return count

    def on_interrupt(number: int, frame: Any) -> None:
        nonlocal count
        count += 1
        if count >= _COUNTED:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield pressed
        return
    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
