"""Manoeuvres that could be flown: an input moved from its trim, the others held."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inputs.manoeuvres import PATTERNS, multistep, sweep
from ...inputs.manoeuvres import step as step_input
from ..misfit.phrases import number, with_unit

__all__ = ["KINDS", "SLOW", "Manoeuvre", "planned"]

_Array = NDArray[np.float64]

KINDS = "doublets, also growing, 3-2-1-1s, steps, sine sweeps, slow ramps"

SLOW = ("sine sweep", "slow ramp")
"""Kinds that pass all distances from the trim."""

# Steps: their lengths in units, and their heights.
_THIRD = 1.0 / 3.0
_PATTERNS = {
    **{kind: PATTERNS[kind] for kind in ("doublet", "3-2-1-1")},
    # Small and large in one record: of nonlinear effects of which each has its own size.
    "row of growing doublets": ((1,) * 8, (_THIRD, -_THIRD, 0.0, 2 * _THIRD, -2 * _THIRD, 0.0, 1.0, -1.0)),
}
# Of the time that there is: trim before anything moves, and the longest unit of a pattern.
_LEAD, _LONGEST = 0.05, 0.1
# Samples in the shortest unit of a pattern, and in the shortest period of a sweep.
_FEWEST, _PERIOD = 4, 12
# How many lengths of a unit are tried.
_LENGTHS = 3
# Ramps rise, and fall again, within these parts of the time; sweeps end at these parts (in logarithm) of their range.
_RISES, _ENDS = (0.2, 0.45), (0.6, 1.0)


@dataclass(frozen=True, eq=False)
class Manoeuvre:
    """An input over time.

    kind     "doublet", "3-2-1-1", "row of growing doublets", "step", "sine sweep" or "slow ramp".
    input    that moves.
    size     how far from its trim at most, in its unit; with a sign where it goes to one side only.
    unit     of the input.
    pace     how fast, in words.
    moves    (N,) distance from the trim at the samples, in its unit.
    done     number of samples until it is over, or has been seen whole.
    """

    kind: str
    input: str
    size: float
    unit: str
    pace: str
    moves: _Array
    done: int

    def __str__(self) -> str:
        one_sided = self.kind in ("step", "slow ramp")
        sign = "" if one_sided else "±"
        size = self.size if one_sided else abs(self.size)
        return f"{self.kind} on {self.input} of {sign}{with_unit(size, self.unit)}{self.pace}"


def planned(name: str, unit: str, t: _Array, size: float) -> Iterator[Manoeuvre]:
    """Manoeuvres of one size, (N,) equally spaced times ``t`` (s) long."""
    n, step = t.size, float(t[1] - t[0])
    lead = max(int(_LEAD * n), 1)

    def made(kind: str, pace: str, moves: _Array, done: int) -> Manoeuvre:
        return Manoeuvre(kind, name, size, unit, pace, size * moves, min(done, n))

    longest = max(int(_LONGEST * n), _FEWEST)
    shortest = min(max(_FEWEST, n // 100), longest)
    units = sorted({round(k) for k in np.geomspace(shortest, longest, _LENGTHS).tolist()})
    begin = float(t[lead])
    for kind, (lengths, heights) in _PATTERNS.items():
        for samples in units:
            end, width = lead + samples * sum(lengths), samples * step
            if end < n:
                moves = multistep(t, 1.0, lengths, width=width, heights=heights, start=begin)
                yield made(kind, f" with steps of {number(width)} s", moves, end + samples)
    yield made("step", "", step_input(t, 1.0, start=begin), lead + longest)
    length = (n - 1 - lead) * step
    slowest, fastest = 2.0 / length, 1.0 / (_PERIOD * step)
    for part in _ENDS if fastest > 2.0 * slowest else ():
        # Each octave takes as long as the others.
        highest = slowest * (fastest / slowest) ** part
        pace = f" from {number(slowest)} to {number(highest)} Hz within {number(length)} s"
        yield made("sine sweep", pace, sweep(t, 1.0, band=(slowest, highest), start=begin), n)
    for part in _RISES:
        rise = max(int(part * n), 1)
        since_lead = np.arange(n) - lead
        moves = np.clip(np.minimum(since_lead, 2 * rise - since_lead) / rise, 0.0, 1.0)
        yield made("slow ramp", f" within {number(rise * step)} s and back", moves, lead + 2 * rise)
