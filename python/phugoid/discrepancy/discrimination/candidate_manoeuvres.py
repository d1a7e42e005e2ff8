"""Candidate manoeuvres, simulated with a cause, and its expected gain over an alias in each of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ...design.steps import PATTERNS, multistep, sweep
from ...design.steps import step as step_input
from ...fit_result import dataset
from ...residual_noise import uniform_segments
from ...residual_noise.whitening import Filter, RowStructure
from ...time_unit import SECONDS, TimeUnit
from ..misfit.phrases import number, with_unit
from ..search.refit import Refit
from .manoeuvre_response import ManoeuvreResponse

__all__ = ["GREATEST", "KINDS", "SLOW", "CandidateManoeuvre", "CandidateManoeuvres", "manoeuvres_of_size"]

_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]

# Of the greatest: what is below is rounding.
_NOTHING = 1e-12


class RivalAdjustment:
    """``moved`` (k, n_y, N): how the alternative's outputs move with what is free in it, by units; ``tied`` (k,) is how
    firmly each is held to its estimate, in units too. ``present`` (n_y, N) marks the samples that there are."""

    def __init__(self, present: _Mask, channels: Filter, moved: _Array, tied: _Array) -> None:
        self._present, self._tied = present, tied
        self._filter = channels.on(rows_of(present))
        self._columns = self._filter(moved[:, present])
        # Of initial states and parameters of any unit: as large as each other.
        gram = self._columns @ self._columns.T + np.diag(tied**2)
        size = np.sqrt(np.diag(gram))
        self._size = np.where(size > 0.0, size, 1.0)
        values, self._vectors = np.linalg.eigh(gram / np.outer(self._size, self._size))
        self._inverse = np.where(values > _NOTHING * values[-1], 1.0 / np.maximum(values, 1e-300), 0.0)

    def whitened(self, difference: _Array) -> _Array:
        """Return a difference (n_y, N) of outputs in units of the noise, (n_rows,)."""
        return self._filter(difference[self._present])

    def step(self, whitened: _Array, at: _Array) -> _Array:
        """Return (k,) units by which to move from ``at`` (k,), so that the least is left of the difference."""
        slope = (self._columns @ whitened - self._tied**2 * at) / self._size
        return np.asarray((self._vectors @ (self._inverse * (self._vectors.T @ slope))) / self._size)

    def gain(self, whitened: _Array, at: _Array) -> float:
        """Half the sum of squares of what is left of the difference then, to first order."""
        left = whitened - self.step(whitened, at) @ self._columns
        return 0.5 * float(left @ left)

    def cost(self, whitened: _Array, at: _Array) -> float:
        """Minus the log-likelihood, of the estimates too."""
        with np.errstate(over="ignore", invalid="ignore"):  # where the motion ran away
            return 0.5 * float(whitened @ whitened) + 0.5 * float(np.sum((self._tied * at) ** 2))


def rows_of(present: _Mask) -> RowStructure:
    """Return how rows of equally spaced samples hang together, those of one output after those of another."""
    table = np.full(present.shape, -1)
    table[present] = np.arange(int(present.sum()))
    ends = np.cumsum([0, *present.sum(axis=1)]).tolist()
    segments = [
        [s.from_row(a) for s in uniform_segments(np.flatnonzero(line).astype(float))]
        for (a, _), line in zip(pairwise(ends), present, strict=True)
    ]
    pattern = 2.0 ** np.arange(present.shape[0]) @ present
    together = []
    for which in np.unique(pattern[pattern > 0.0]).tolist():
        there = np.flatnonzero(present[:, np.argmax(pattern == which)])
        together.append((tuple(there.tolist()), np.ascontiguousarray(table[there][:, pattern == which].T)))
    whole = np.flatnonzero(present.all(axis=0))
    complete = [table[:, whole[s.rows][run]].T for s in uniform_segments(whole.astype(float)) for run in s.runs]
    return RowStructure(segments, together, complete)


# Samples of a planned record. More of them discriminate no better, and slower effects need another plan.
_SAMPLES = 400
# Sizes to try, in units of how far the input went in the record: the greatest that keeps the vehicle within the
# envelope, and for manoeuvres that dwell near the trim small ones.
GREATEST, _SMALL = 1.5, (0.4, 0.15)
_SIZES = (GREATEST, 1.2, 1.0, 0.8, 0.6, *_SMALL)
# The envelope: where the model was identified, and this often as far from the beginning. Or so many sigmas.
_ENVELOPE, _STILL = 2.0, 10.0
# Parts of the step towards the cause's outputs that the alternative's parameters try, and how often.
_PARTS, _ROUNDS = (1.0, 0.3), 2
# Manoeuvres whose gain is this far below that required, to first order, are not evaluated further.
_HOPELESS = 0.3
# A gain that a step changes by less is taken as it is then.
_SETTLED = 0.1
# Numbers that derivatives of outputs may be: of a large model fewer manoeuvres are looked at.
_ROOM = 2e7
# Of a value, in an integration.
_ROUNDING = 1e-9
# Room for the delay of a sensor to move.
_MARGIN = 1.5


def _signs(records: Sequence[_Array]) -> tuple[float, float]:
    """Return between which values a channel may go: one that never was negative, or positive, stays so, as a flow or a
    concentration does."""
    low, high = min(float(r.min()) for r in records), max(float(r.max()) for r in records)
    return (0.0 if low >= 0.0 else -np.inf), (0.0 if high <= 0.0 < -low else np.inf)


class CandidateManoeuvres:
    """The manoeuvres that the model with the cause flies within the envelope."""

    def __init__(self, final: Refit) -> None:
        self.final = final
        self._data = dataset(final.fit)
        data = self._data[0]
        step = float(np.median(np.diff(data.t)))
        self.t = data.t[0] + step * np.arange(min(data.n, _SAMPLES))
        model = final.fit.model
        self.trim = np.array([data.input(name)[0] for name in model.input_names])
        self.every = [_spacing(self._data, name, step) for name in model.output_names]
        self.cause = ManoeuvreResponse(final, self.t, self.trim)
        listed = self._listed()
        if not listed:
            self.manoeuvres: list[CandidateManoeuvre] = []
            return
        y, x = self.cause.simulate(self._inputs(listed))
        ends = self._within(y, x)
        kept: dict[tuple[str, str, str, float], int] = {}
        for i, m in enumerate(listed):
            if ends[i] >= m.done:
                size = self._sizes[i] if self._sizes[i] in _SMALL else GREATEST
                kept.setdefault((m.input, m.kind, m.pace, size), i)
        which = list(kept.values())
        self.manoeuvres = [listed[i] for i in which]
        self.ends, self.y = ends[which], y[which]
        self.inputs = self._inputs(self.manoeuvres)

    def _listed(self) -> list[CandidateManoeuvre]:
        """All, the greatest first; none of conditions, which are not commanded."""
        model, data = self.final.fit.model, self._data
        listed: list[CandidateManoeuvre] = []
        self._sizes: list[float] = []
        for name in [n for n in model.input_names if not model.is_condition(n)]:
            away = np.concatenate([e.input(name) - e.input(name)[0] for e in data])
            farthest = float(away[np.argmax(np.abs(away))])
            if abs(farthest) <= 1e-9 * float(np.abs(data[0].input(name)).max()):
                continue
            low, high = _signs([e.input(name) for e in data])
            start = float(data[0].input(name)[0])
            for size in _SIZES:
                some = list(
                    manoeuvres_of_size(name, model.units.get(name, ""), self.t, size * farthest, model.time_unit)
                )
                if size in _SMALL:
                    some = [m for m in some if m.kind in SLOW]
                some = [m for m in some if low <= start + float(m.moves.min()) and start + float(m.moves.max()) <= high]
                listed += some
                self._sizes += [size] * len(some)
        return listed

    def _inputs(self, manoeuvres: Sequence[CandidateManoeuvre]) -> _Array:
        """Return the inputs (M, n_u, N)."""
        names = self.final.fit.model.input_names
        u = np.tile(self.trim[:, None], (len(manoeuvres), 1, self.t.size))
        for i, m in enumerate(manoeuvres):
            u[i, names.index(m.input)] += m.moves
        return u

    def _within(self, y: _Array, x: _Array) -> NDArray[np.intp]:
        """Return (M,) samples until the vehicle leaves the envelope."""
        fit, model = self.final.fit, self.final.fit.model
        limits = [
            np.array([max(_reach(getattr(r, kind)[n]) for r in fit.records) for n in names])
            for kind, names in (("outputs", model.output_names), ("states", model.state_names))
        ]
        limits[0] = np.maximum(_ENVELOPE * limits[0], _STILL * self.final.linear.sigmas)
        limits[1] = _ENVELOPE * limits[1]
        inside = np.ones((y.shape[0], y.shape[2]), dtype=bool)
        for v, limit in zip((y, x), limits, strict=True):
            with np.errstate(invalid="ignore"):
                away = np.abs(v - v[:, :, :1])
                inside &= (away <= limit[:, None] + _ROUNDING * np.abs(v[:, :, :1])).all(axis=1)
        ranges = np.array([_signs([r.states[n] for r in fit.records]) for n in model.state_names])
        with np.errstate(invalid="ignore"):
            inside &= ((x >= ranges[:, :1]) & (x <= ranges[:, 1:])).all(axis=1)
        return np.where(inside.all(axis=1), inside.shape[1], np.argmin(inside, axis=1))

    def record(self, i: int) -> Experiment:
        """Return times and inputs of a manoeuvre."""
        n = int(self.ends[i])
        names = self.final.fit.model.input_names
        inputs = {name: u[:n] for name, u in zip(names, self.inputs[i], strict=True)}
        return Experiment(self.t[:n], inputs, name=str(self.manoeuvres[i]))

    def gains(self, alternative: Refit, least: float) -> _Array:
        """Return (M,) expected gains in log-likelihood over an alternative from data of each manoeuvre; 0 where it is
        below ``least``, NaN where the alternative has no solution.

        The alternative takes a few steps with the derivatives at its estimates towards the outputs of the cause: what
        then counts is the difference itself, less what another step would still take, to first order.
        """
        response = ManoeuvreResponse(alternative, self.t, self.trim)
        found = np.zeros(len(self.manoeuvres))
        late = np.vstack([self.cause.late, response.late])
        y, _ = response.simulate(self.inputs)
        present = [self._present(i, late) for i in range(found.size)]
        # Where the difference is small as it stands, nothing has to follow.
        channels = self.final.own.filter
        whitened = [channels.on(rows_of(p))((self.y[i] - y[i])[p]) for i, p in enumerate(present)]
        sizes = np.array([0.5 * float(e @ e) for e in whitened])
        found[~np.isfinite(sizes)] = np.nan
        some = np.flatnonzero(sizes >= least)
        if not some.size:
            return found
        room = max(int(_ROOM / (response.units.size * y[0].size)), 1)
        some = some[np.argsort(-sizes[some], kind="stable")[:room]]
        moved = response.tangents(self.inputs[some])
        views: dict[int, RivalAdjustment] = {}
        for i, m in zip(some.tolist(), moved, strict=True):
            found[i] = np.nan
            if np.isfinite(m[:, present[i]]).all():
                view = RivalAdjustment(present[i], channels, m, response.tied)
                found[i] = view.gain(whitened[i], np.zeros(response.units.size))
                if found[i] >= _HOPELESS * least:
                    views[i] = view
        at = {i: np.zeros(response.units.size) for i in views}
        errors = {i: whitened[i] for i in views}
        for _ in range(_ROUNDS):
            if not views:
                break
            tries = [(i, at[i] + part * view.step(errors[i], at[i])) for i, view in views.items() for part in _PARTS]
            y, _ = response.simulate(self.inputs, np.array([to for _, to in tries]), np.array([i for i, _ in tries]))
            for (i, to), outputs in zip(tries, y, strict=True):
                e = views[i].whitened(self.y[i] - outputs)
                if np.isfinite(e).all() and views[i].cost(e, to) < views[i].cost(errors[i], at[i]):
                    at[i], errors[i] = to, e
            gains = {i: view.gain(errors[i], at[i]) for i, view in views.items()}
            views = {i: view for i, view in views.items() if abs(gains[i] - found[i]) > _SETTLED * gains[i]}
            found[list(gains)] = list(gains.values())
        return found

    def _present(self, i: int, late: _Array) -> NDArray[np.bool_]:
        """Return (n_y, N) samples of a manoeuvre. What a late sensor (``late``, s) shows first was before the record,
        and what an early one shows last comes after it."""
        present = np.zeros((len(self.every), self.t.size), dtype=bool)
        for row, every in enumerate(self.every):
            begin, lost = (
                int(np.ceil(_MARGIN * max(float((sign * late[:, row]).max()), 0.0) / (self.t[1] - self.t[0])))
                for sign in (1.0, -1.0)
            )
            present[row, begin : max(self.ends[i] - lost, begin) : every] = True
        return present


def _reach(v: _Array) -> float:
    """Return how far a series goes from where it begins; a late sensor shows nothing at first."""
    v = v[np.isfinite(v)]
    return float(np.abs(v - v[0]).max()) if v.size else 0.0


def _spacing(data: Sequence[Experiment], name: str, step: float) -> int:
    """Return steps between samples of an output."""
    for e in data:
        t = e.t[np.isfinite(e.output(name))]
        if t.size > 1:
            return max(round(float(np.median(np.diff(t))) / step), 1)
    return 1


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
class CandidateManoeuvre:
    """An input over time.

    kind     "doublet", "3-2-1-1", "row of growing doublets", "step", "sine sweep" or "slow ramp".
    input    that moves.
    size     how far from its trim at most, in its unit; with a sign where it goes to one side only.
    unit     of the input.
    pace     how fast, in words.
    moves    (N,) distance from the trim at the samples, in its unit.
    done     number of samples until it is over, or has been seen whole.
    time_unit  of the model.
    """

    kind: str
    input: str
    size: float
    unit: str
    pace: str
    moves: _Array
    done: int
    time_unit: TimeUnit = SECONDS

    def __str__(self) -> str:
        one_sided = self.kind in ("step", "slow ramp")
        sign = "" if one_sided else "±"
        size = self.size if one_sided else abs(self.size)
        return f"{self.kind} on {self.input} of {sign}{with_unit(size, self.unit)}{self.pace}"


def manoeuvres_of_size(
    name: str, unit: str, t: _Array, size: float, time: TimeUnit = SECONDS
) -> Iterator[CandidateManoeuvre]:
    """Manoeuvres of one size, (N,) equally spaced times ``t`` (in the unit ``time``) long."""
    n, step = t.size, float(t[1] - t[0])
    lead = max(int(_LEAD * n), 1)

    def made(kind: str, pace: str, moves: _Array, done: int) -> CandidateManoeuvre:
        return CandidateManoeuvre(kind, name, size, unit, pace, size * moves, min(done, n), time)

    longest = max(int(_LONGEST * n), _FEWEST)
    shortest = min(max(_FEWEST, n // 100), longest)
    units = sorted({round(k) for k in np.geomspace(shortest, longest, _LENGTHS).tolist()})
    begin = float(t[lead])
    for kind, (lengths, heights) in _PATTERNS.items():
        for samples in units:
            end, width = lead + samples * sum(lengths), samples * step
            if end < n:
                moves = multistep(t, 1.0, lengths, width=width, heights=heights, start=begin)
                yield made(kind, f" with steps of {number(width)} {time}", moves, end + samples)
    yield made("step", "", step_input(t, 1.0, start=begin), lead + longest)
    length = (n - 1 - lead) * step
    slowest, fastest = 2.0 / length, 1.0 / (_PERIOD * step)
    for part in _ENDS if fastest > 2.0 * slowest else ():
        # Each octave takes as long as the others.
        highest = slowest * (fastest / slowest) ** part
        pace = f" from {number(slowest)} to {number(highest)} {time.frequency} within {number(length)} {time}"
        yield made("sine sweep", pace, sweep(t, 1.0, band=(slowest, highest), start=begin), n)
    for part in _RISES:
        rise = max(int(part * n), 1)
        since_lead = np.arange(n) - lead
        moves = np.clip(np.minimum(since_lead, 2 * rise - since_lead) / rise, 0.0, 1.0)
        yield made("slow ramp", f" within {number(rise * step)} {time} and back", moves, lead + 2 * rise)
