"""The common result of all solvers, and the display of their iterations."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["HINTS", "Iteration", "Progress", "Solution"]

HINTS = {
    "converged": "a local optimum was found; other starts (or ph.multistart) tell whether it is the global one",
    "acceptable": "stopped at an acceptable point: tolerances were not all met, often for want of precision; "
    "check the standard errors",
    "interrupted": "stopped by the user; this is the best point so far, and start=fit goes on from it",
    "iteration limit": "not converged; allow more iterations, or go on with start=fit",
    "time limit": "not converged; allow more time, or go on with start=fit",
    "infeasible": "no state path satisfies the equations near here; look at start values, bounds and units",
    "diverging": "the unknowns grow without limit; a parameter may be without influence: bound or fix it",
    "unidentifiable": "the data do not determine all parameters: fix some of those named, or give them priors",
    "failed": "the solver gave up; try other start values, bounds that keep functions finite, or another order",
}
"""For each status, what it means and what to do."""


@dataclass(frozen=True)
class Iteration:
    """One line of the iteration table."""

    number: int
    log_likelihood: float
    defect: float
    """Largest scaled constraint violation."""
    dual: float
    """Distance from the optimum: of Ipopt the largest scaled entry of the gradient of the Lagrangian; of Newton
    what the next step promises to gain in log-likelihood, half the square of the distance in standard errors."""
    step: float
    trials: int


@dataclass(frozen=True)
class Solution:
    """The end point of a solver, and how it was reached."""

    xi: NDArray[np.float64]
    """Decision variables, shape (n,)."""
    multipliers: NDArray[np.float64]
    """Multipliers of the constraints, shape (m,)."""
    bound_multipliers: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Multipliers of the lower and upper bounds, shape (n,) each."""
    status: str
    message: str
    iterations: int
    time: float
    history: list[Iteration] = field(default_factory=list, repr=False)
    evaluations: dict[str, int] = field(default_factory=dict, repr=False)
    """How often each function was evaluated and the Newton system solved, where the solver counts."""
    flops: int = 0
    """Floating-point operations of one factorisation, where the solver counts."""

    def multipliers_by_name(self) -> dict[str, NDArray[np.float64]]:
        """Return the multipliers under Ipopt's names."""
        lower, upper = self.bound_multipliers
        return {"mult_g": self.multipliers, "mult_x_L": lower, "mult_x_U": upper}


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
