"""Search for manoeuvres in a long record: where an input departs from its trim, and what shape it then has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import DataError, OptionError, listing
from .manoeuvre_list import Kind, Manoeuvre, Manoeuvres
from .steps import number

__all__ = ["manoeuvres"]

_Array: TypeAlias = NDArray[np.float64]
_Span: TypeAlias = tuple[float, float]

# Excursions count from this part of the peak on, so that noise about the trim is none.
_HYSTERESIS = 0.3
# An input that is excited in the span of another one for this part of it is excited together with it.
_TOGETHER = 0.2
# Third differences of white noise have this standard deviation in that of the noise: sqrt(1 + 9 + 9 + 1).
_THIRD = math.sqrt(20.0)
# A span is at least so many times the greatest deviation of the quiet half of the record.
_ABOVE_QUIET = 4.0
# A manoeuvre starts from trim and ends at rest: for so many s before and after it the input moves by no more than
# this part (standard deviation) of its amplitude.
_BEFORE, _AFTER, _CALM = 2.0, 1.0, 0.12
# s at the edges of a span that are neither: the departure is below the threshold there.
_EDGE = 0.3
# Nor does the input move without such rest for more than this part of so many s before and after it.
_RESTING, _RESTLESS = 20.0, 0.2
# A manoeuvre is larger by this factor than what the input does for half of the time, outside of manoeuvres, so many s
# before it or after it: the standard deviation over so many s, less white noise. The pilot of the HFB-320 moves the
# elevator by a fortieth of its manoeuvres, an autopilot in turbulence by a tenth of its largest departures.
_LARGER, _AROUND, _WINDOW = 20.0, 30.0, 4.0
# Spans that are not manoeuvres, and no further apart than so many s, are one span of the kind "continuous".
_APART = 30.0
# Lengths of the steps of a 3-2-1-1 in sevenths of their sum, and by how much they may be off; the last two, which are
# as long as each other, differ by no more than this factor (those of a 4-3-2-1 by two).
_STEPS, _STEPS_OFF, _LAST_STEPS = np.array([3.0, 2.0, 1.0, 1.0]), np.array([0.75, 0.5, 0.5, 0.5]), 1.7
# Standard deviation of a normal variable over its median absolute value.
_MAD = 1.4826


def manoeuvres(
    run: Experiment,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    *,
    threshold: float = 0.2,
    gap: float = 2.0,
    shortest: float = 0.2,
    longest: float = 120.0,
    trim: float = 30.0,
) -> Manoeuvres:
    """Find the manoeuvres in a long record: the spans in which an input is excited, their kind, signal-to-noise ratios.

    An input is excited where it departs from its trim, the median of the last ``trim`` s. A manoeuvre starts from an
    input at rest for 2 s and ends in one, and is large beside what the input does around it, outside of manoeuvres
    (20 times the standard deviation over 4 s, less noise). Controls that a pilot or an autopilot moves all the time are
    spans of the kind "continuous". A 3-2-1-1 is recognised where its steps are a bit off, as in manoeuvres flown by
    hand.

    run        the record, such as `read` gives it of a log.
    inputs     names of the inputs to look at; None: all of the record.
    outputs    names of the outputs whose signal-to-noise ratios are given; None: all of the record.
    threshold  departure that counts, as a part of the largest one of the input. Where the input is noisy, no less
               than four times the departures of the quiet half of the record.
    gap        s for which an input may be back at its trim within a manoeuvre.
    shortest   s below which a departure is a spike and none.
    longest    s beyond which a span is "continuous".
    trim       s over which the median is taken: twice as long as the longest pulse.

    Returns `Manoeuvres`: a table to print, a figure (``.plot()``), and records to fit (``.cut()``).

    Raises DataError for an unknown channel or a record without inputs, OptionError for options out of range.

    >>> t = np.arange(0.0, 60.0, 0.02)
    >>> de = np.where((t >= 40) & (t < 41), 0.05, 0.0) - np.where((t >= 41) & (t < 42), 0.05, 0.0)
    >>> [str(m) for m in manoeuvres(Experiment(t, {"de": de}))]
    ['doublet of de, 40.0 to 42.0']
    """
    if not isinstance(run, Experiment):
        raise DataError(f"manoeuvres: the first argument is an Experiment, not a {type(run).__name__}")
    part = number("manoeuvres", "threshold", threshold, positive=True)
    if part >= 1.0:
        raise OptionError(f"manoeuvres: threshold is a part of the largest departure, below 1, not {threshold!r}")
    gap, shortest, longest, trim = (
        number("manoeuvres", name, value, positive=True)
        for name, value in (("gap", gap), ("shortest", shortest), ("longest", longest), ("trim", trim))
    )
    names = _chosen(run, inputs, run.inputs, "inputs")
    if not names:
        raise DataError(
            f"manoeuvres: '{run.name}' has no inputs; name some of its channels, inputs=[...]."
            f"{listing('', run.channels)}"
        )
    observed = _chosen(run, outputs, run.outputs, "outputs")
    excited = {n: _Excitation(*run.samples(n), part, gap, shortest, trim) for n in names}
    noise = {n: _noise(run.output(n)) for n in observed}
    found = []
    for name, e in excited.items():
        for span, calm in e.sorted_out():
            kind, amplitude, band = e.described(span)
            found.append(
                Manoeuvre(
                    input=name,
                    kind=kind if calm and span[1] - span[0] <= longest else "continuous",
                    start=span[0],
                    end=span[1],
                    amplitude=amplitude,
                    band=band,
                    unit=run.units.get(name, ""),
                    snr={n: _ratio(run.t, run.output(n), span, noise[n]) for n in observed},
                    together=_together(name, span, excited),
                    time_unit=run.time_unit,
                )
            )
    return Manoeuvres(run, sorted(found, key=lambda m: (m.start, names.index(m.input))))


def _chosen(run: Experiment, given: Sequence[str] | None, usual: Mapping[str, _Array], what: str) -> list[str]:
    if given is None:
        return list(usual)
    if isinstance(given, str):
        raise OptionError(f"manoeuvres: {what}='{given}' is text: give a list of names, such as {what}=['{given}']")
    for name in given:
        (run.input if what == "inputs" else run.output)(name)  # a DataError that says which there are
    return list(given)


class _Excitation:
    """One input on an even grid: its departure from trim, and the spans in which it is excited."""

    def __init__(self, t: _Array, u: _Array, part: float, gap: float, shortest: float, trim: float) -> None:
        if not np.isfinite(u).all():
            there = np.isfinite(u)
            t, u = t[there], u[there]
        self.spans: list[_Span] = []
        self.step = max(float(np.median(np.diff(t))), 1e-9) if t.size > 1 else 1.0
        count = max(int((t[-1] - t[0]) / self.step) + 1, 2) if t.size > 1 else 2
        self.t = t[0] + self.step * np.arange(count)
        # The last sample, as commands have it: lines between steps would be none.
        self.u = u[np.clip(np.searchsorted(t, self.t + 0.01 * self.step, side="right") - 1, 0, t.size - 1)]
        self.departure = self.u - _past_median(self.u, max(round(trim / self.step), 1))
        size = np.abs(self.departure)
        largest = float(size.max())
        if not largest > 1e-12 * float(np.abs(self.u).max() or 1.0):
            return
        quiet = _MAD * float(np.median(size))
        level = max(part * largest, min(_ABOVE_QUIET * quiet, 0.5 * largest))
        self.level = level
        for i, j in _runs(size > level, max(round(gap / self.step), 1)):
            # The edges lie where the departure begins and ends, not where it crosses the level.
            i, j = self._outward(self.departure, i, -1, level), self._end(i, j, level)
            if (j - i + 1) * self.step >= shortest * (1.0 - 1e-9):
                self.spans.append((float(self.t[i]), float(self.t[min(j + 1, count - 1)])))
        self._movement = self._moves()

    def _outward(self, departure: _Array, i: int, way: int, level: float) -> int:
        """Return the number of the sample at which the departure begins or ends, within 1 s."""
        last = i
        for _ in range(round(1.0 / self.step)):
            k = last + way
            if not 0 <= k < self.u.size or abs(departure[k]) < 0.25 * level:
                break
            last = k
        return last

    def _end(self, i: int, j: int, level: float) -> int:
        """Return the last sample of the span that begins at sample i and in which the departure counts until j.

        Where the input goes to both sides of its trim, or is back where it was, it ends with its motion: the median of
        the past is no longer the trim then, and the input seems to depart while it is at rest.
        """
        half = round(0.5 / self.step)
        rest = float(np.median(self.u[max(j - half, i) : j + 1]))
        v = self.u[i : j + 1] - rest
        moving = np.flatnonzero(np.abs(v) > level)
        both = moving.size and v.max() > level and v.min() < -level
        before = self.u[max(i - round(2.0 / self.step), 0) : max(i - half, 0)]  # without the edge
        back = moving.size and before.size and abs(float(np.median(before)) - rest) < level
        if both or back:
            return self._outward(self.u - rest, i + int(moving[-1]), 1, level)
        return self._outward(self.departure, j, 1, level)

    def inside(self, span: _Span) -> NDArray[np.bool_]:
        """Return which samples lie in a span."""
        return np.asarray((self.t >= span[0] - 0.5 * self.step) & (self.t < span[1] - 0.5 * self.step))

    def sorted_out(self) -> list[tuple[_Span, bool]]:
        """Return the spans with whether they are manoeuvres; neighbours that are not are one span."""
        calm = [self._calm(span) for span in self.spans]
        changed = True
        while changed:
            changed = False
            for i, span in enumerate(self.spans):
                kept, others = (
                    [s for s, c in zip(self.spans, calm, strict=True) if c is is_calm] for is_calm in (True, False)
                )
                if calm[i] and (self._restless(span, others) or not self._stands_out(span, kept)):
                    calm[i], changed = False, True
        found: list[tuple[_Span, bool]] = []
        for span, is_calm in zip(self.spans, calm, strict=True):
            if not is_calm and found and not found[-1][1] and span[0] - found[-1][0][1] < _APART:
                found[-1] = (found[-1][0][0], span[1]), False
            else:
                found.append((span, is_calm))
        return found

    @staticmethod
    def _restless(span: _Span, others: Sequence[_Span]) -> bool:
        """Return whether the input moves without rest for a good part of the time around a span."""
        around = (span[0] - _RESTING, span[1] + _RESTING)
        return sum(max(min(b, around[1]) - max(a, around[0]), 0.0) for a, b in others) > _RESTLESS * 2.0 * _RESTING

    def _stands_out(self, span: _Span, kept: Sequence[_Span]) -> bool:
        """Return whether a span is large beside what the input does before it and after it, outside of the spans that
        are kept."""
        start, moves = self._movement
        outside = np.ones(start.size, dtype=np.bool_)
        for a, b in kept:
            outside &= (start + _WINDOW < a - _EDGE) | (start > b + _EDGE)
        before = (start > span[0] - _AROUND) & (start < span[0])
        after = (start > span[1]) & (start + _WINDOW < span[1] + _AROUND)
        sides = [moves[outside & side] for side in (before, after)]
        amplitude = self.described(span)[1]
        return all(float(np.median(side)) * _LARGER <= amplitude for side in sides if side.size)

    def _moves(self) -> tuple[_Array, _Array]:
        """Return the starts of windows, s, and the standard deviation of the input within each, less white noise."""
        width = min(max(round(_WINDOW / self.step), 2), self.u.size)
        u = self.u - self.u.mean()
        sums, squares = (np.concatenate([[0.0], np.cumsum(v)]) for v in (u, u * u))
        first = np.arange(0, u.size - width + 1, max(width // 4, 1))
        mean, square = ((s[first + width] - s[first]) / width for s in (sums, squares))
        # Zeros count here, so that what a computer holds has no noise.
        noise = _MAD * float(np.median(np.abs(np.diff(u, 3)))) / _THIRD if u.size > 3 else 0.0
        return self.t[first], np.sqrt(np.maximum(square - mean**2 - noise**2, 0.0))

    def _calm(self, span: _Span) -> bool:
        amplitude = self.described(span)[1]
        parts = [(span[0] - _BEFORE, span[0] - _EDGE), (span[1] + _EDGE, span[1] + _EDGE + _AFTER)]
        rest = [self.u[(self.t >= a) & (self.t <= b)] for a, b in parts]
        return all(u.std() <= _CALM * amplitude for u in rest if u.size)

    def described(self, span: _Span) -> tuple[Kind, float, _Span]:
        """Return kind, amplitude and band of the excitation in a span."""
        chosen = self.inside(span)
        u = self.u[chosen]
        before = self.u[(self.t >= span[0] - 2.0) & (self.t < span[0] - 0.5 * self.step)]
        after = self.u[(self.t >= span[1]) & (self.t < span[1] + 2.0)]
        level = float(np.median(before)) if before.size else float(u[0])
        v = u - level
        peak = float(np.abs(v).max())
        band = _band(v - v.mean(), self.step)
        moved = abs(float(np.median(after)) - level) if after.size else 0.0
        return _kind(v, peak, moved, self.step), peak, band


def _past_median(u: _Array, width: int) -> _Array:
    """Return the median of the last ``width`` samples at each sample, on a grid of some 50 a window."""
    stride = max(width // 50, 1)
    coarse = u[::stride]
    n = max(width // stride, 1)
    padded = np.concatenate([np.full(n - 1, coarse[0]), coarse])
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, n), axis=1)
    return np.asarray(medians[np.minimum(np.arange(u.size) // stride, medians.size - 1)])


def _runs(active: NDArray[np.bool_], gap: int) -> list[tuple[int, int]]:
    """Return first and last sample of the runs of active samples; runs apart by no more than ``gap`` are one."""
    at = np.flatnonzero(active)
    if at.size == 0:
        return []
    cuts = np.flatnonzero(np.diff(at) > gap)
    firsts, lasts = at[np.concatenate([[0], cuts + 1])], at[np.concatenate([cuts, [at.size - 1]])]
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]


def _kind(v: _Array, peak: float, moved: float, step: float) -> Kind:
    """Return what an excitation is, by its excursions to both sides of the level before it.

    v      (n,) departures from that level; ``peak`` the largest; ``moved`` by how much the level afterwards differs.
    """
    sign = np.where(np.abs(v) > _HYSTERESIS * peak, np.sign(v), 0.0)
    at = np.flatnonzero(sign)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(sign[at]) != 0) + 1, [at.size]])
    lengths = np.array([step * (at[b - 1] - at[a] + 1) for a, b in pairwise(edges)])
    n = lengths.size
    flat = float(np.mean(np.abs(v[at]) > 0.6 * peak))
    if n == 1:
        return "step" if moved > 0.5 * peak else "pulse"
    if n == 2 and 0.5 < lengths[0] / lengths[1] < 2.0:
        return "doublet"
    if n == 4 and _is_3211([at[a:b] for a, b in pairwise(edges)], np.abs(v)):
        return "3-2-1-1"
    if n <= 4:
        return "multistep" if flat > 0.5 else "other"
    half = np.log(lengths)
    order = np.corrcoef(np.arange(n), half)[0, 1] if np.ptp(half) > 0.0 else 0.0
    third = max(n // 3, 1)
    change = abs(float(np.median(half[:third]) - np.median(half[-third:])))
    if abs(order) > 0.8 and change > math.log(1.8) and flat < 0.9:
        return "sweep"
    return _oscillation(v - v.mean(), n, flat)


def _is_3211(excursions: Sequence[NDArray[np.intp]], size: _Array) -> bool:
    """Return whether four excursions, each the numbers of its samples, are the steps of a 3-2-1-1.

    size  (n,) absolute departures.

    A pilot who flies one by hand holds the first step too briefly, and not all steps at one height.
    """
    # A step ends halfway between its last sample and the first one of the next, so that lengths are known to a sample.
    inner = [0.5 * (a[-1] + b[0]) for a, b in pairwise(excursions)]
    lengths = np.diff([excursions[0][0] - 0.5, *inner, excursions[-1][-1] + 0.5])
    unit = lengths.sum() / 7.0
    off = np.maximum(np.abs(lengths / unit - _STEPS) - 1.0 / unit, 0.0)
    last = (lengths[2:].max() - 1.0) / (lengths[2:].min() + 1.0)
    # The share of each step that is near its own height, so that a low step is not taken for a slope.
    flat = np.mean([np.mean(size[at] > 0.6 * np.quantile(size[at], 0.9)) for at in excursions])
    return bool(flat > 0.5 and np.all(off < _STEPS_OFF) and last < _LAST_STEPS)


def _oscillation(v: _Array, excursions: int, flat: float) -> Kind:
    power = np.abs(np.fft.rfft(v * np.hanning(v.size))) ** 2
    total = float(power.sum())
    top = int(np.argmax(power))
    if power[max(top - 2, 0) : top + 3].sum() > 0.8 * total:
        return "sine"
    if excursions <= 12 and flat > 0.6:
        return "multistep"
    share = np.cumsum(power) / total
    low, high = (int(np.searchsorted(share, part)) for part in (0.05, 0.9))
    # A multisine fills its band evenly, and ends there; turbulence and feedback decay with frequency.
    if high - low >= 6:
        inside = power[low : high + 1]
        thirds = [float(p.mean()) for p in np.array_split(inside, 3)]
        beyond = power[int(1.5 * high) :]
        if max(thirds) < 5.0 * min(thirds) and (not beyond.size or beyond.mean() < 0.05 * inside.mean()):
            return "multisine"
    return "other"


def _band(v: _Array, step: float) -> _Span:
    """Return the frequencies below which 5 % and 95 % of the energy are, Hz; NaN where there is none."""
    if v.size < 8 or not np.any(v):
        return math.nan, math.nan
    # Padded, so that the frequencies are finer than those of the span.
    share = np.cumsum(np.abs(np.fft.rfft(v, 4 * v.size)) ** 2)
    frequency = np.fft.rfftfreq(4 * v.size, step)
    low, high = np.interp([0.05, 0.95], share / share[-1], frequency)
    return float(low), float(high)


def _noise(z: _Array) -> float:
    """Return the standard deviation of white noise in an output, from its third differences; NaN for few samples."""
    there = z[np.isfinite(z)]
    third = np.diff(there, 3)
    third = third[third != 0.0] if third.size else third  # a channel that repeats its samples
    return _MAD * float(np.median(np.abs(third))) / _THIRD if third.size > 10 else math.nan


def _ratio(t: _Array, z: _Array, span: _Span, noise: float) -> float:
    chosen = z[(t >= span[0]) & (t <= span[1])]
    chosen = chosen[np.isfinite(chosen)]
    if chosen.size < 2 or not noise > 0.0:
        return math.nan
    return math.sqrt(max(float(chosen.var()) - noise**2, 0.0)) / noise


def _together(name: str, span: _Span, excited: Mapping[str, _Excitation]) -> dict[str, float]:
    own = excited[name]
    at = own.t[own.inside(span)]
    u = own.u[own.inside(span)]
    found = {}
    for other, e in excited.items():
        overlap = sum(max(min(b, span[1]) - max(a, span[0]), 0.0) for a, b in e.spans)
        if other != name and overlap > _TOGETHER * (span[1] - span[0]):
            v = np.interp(at, e.t, e.u)
            moving = np.ptp(u) > 0.0 and np.ptp(v) > 0.0
            found[other] = float(np.corrcoef(u, v)[0, 1]) if moving else math.nan
    return found
