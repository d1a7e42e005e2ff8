"""Ctrl-C returns the outcomes so far."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import Executor

import pytest
from many import Slow, interrupt_after, run

from phugoid.results import Outcome


@pytest.mark.parametrize("anywhere", [None, "threads", "pool"], indirect=True)
def test_ctrl_c_returns_the_outcomes_so_far(anywhere: Executor | None) -> None:
    seen: list[Outcome] = []

    def watch(outcome: Outcome) -> None:
        if not seen:
            threading.Timer(0.12, os.kill, (os.getpid(), signal.SIGINT)).start()
        seen.append(outcome)

    result = run(1000, executor=anywhere, solver=Slow(seconds=0.05), progress=watch)
    assert result.status == "interrupted"
    assert {o.index for o in seen} <= {o.index for o in result.outcomes}
    assert 1 <= len(result.outcomes) < 100
    assert all(o.converged for o in result.outcomes)
    assert result.n == 1000
    assert "of 1000 finished; the same call with the same journal goes on" in result.summary()
    assert "interrupted" in repr(result)
    assert result.best.converged


def test_ctrl_c_is_as_ever_afterwards() -> None:
    before = signal.getsignal(signal.SIGINT)
    run(2, progress=interrupt_after(1))
    assert signal.getsignal(signal.SIGINT) is before
