"""Manoeuvres that a model with a cause flies, and how much likelier than a rival it would be there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...data.experiment import Experiment
from ..search.linearised import dataset
from ..search.refit import Refit
from .flown import Flown
from .imitation import Imitation, rows_of
from .manoeuvres import SLOW, Manoeuvre, planned

__all__ = ["GREATEST", "Flights"]

_Array = NDArray[np.float64]

# Samples of a planned record: what tells in more tells in these, and what takes longer is for another day.
_SAMPLES = 400
# Sizes to try, in units of how far the input went in the record: the greatest that keeps the vehicle within the
# envelope, and for manoeuvres that dwell near the trim small ones.
GREATEST, _SMALL = 1.5, (0.4, 0.15)
_SIZES = (GREATEST, 1.2, 1.0, 0.8, 0.6, *_SMALL)
# The envelope: where the model was identified, and this often as far from the beginning. Or so many sigmas.
_ENVELOPE, _STILL = 2.0, 10.0
# Parts of the step towards the cause's outputs that the rival's parameters try, and how often.
_PARTS, _ROUNDS = (1.0, 0.3), 2
# What is this far below what tells, to first order, is not looked at again.
_HOPELESS = 0.3
# A gain that a step changes by less is taken as it is then.
_SETTLED = 0.1
# Numbers that derivatives of outputs may be: of a large model fewer manoeuvres are looked at.
_ROOM = 2e7
# Of a value, in an integration.
_ROUNDING = 1e-9
# Room for the delay of a sensor to move.
_MARGIN = 1.5


class Flights:
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
        self.cause = Flown(final, self.t, self.trim)
        listed = self._listed()
        if not listed:
            self.manoeuvres: list[Manoeuvre] = []
            return
        y, x = self.cause.fly(self._inputs(listed))
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

    def _listed(self) -> list[Manoeuvre]:
        """All, the greatest first."""
        model, data = self.final.fit.model, self._data
        listed: list[Manoeuvre] = []
        self._sizes: list[float] = []
        for name in model.input_names:
            away = np.concatenate([e.input(name) - e.input(name)[0] for e in data])
            farthest = float(away[np.argmax(np.abs(away))])
            if abs(farthest) <= 1e-9 * float(np.abs(data[0].input(name)).max()):
                continue
            for size in _SIZES:
                some = list(planned(name, model.units.get(name, ""), self.t, size * farthest))
                if size in _SMALL:
                    some = [m for m in some if m.kind in SLOW]
                listed += some
                self._sizes += [size] * len(some)
        return listed

    def _inputs(self, manoeuvres: Sequence[Manoeuvre]) -> _Array:
        """(M, n_u, N)."""
        names = self.final.fit.model.input_names
        u = np.tile(self.trim[:, None], (len(manoeuvres), 1, self.t.size))
        for i, m in enumerate(manoeuvres):
            u[i, names.index(m.input)] += m.moves
        return u

    def _within(self, y: _Array, x: _Array) -> NDArray[np.intp]:
        """(M,) samples until the vehicle leaves the envelope."""
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
        return np.where(inside.all(axis=1), inside.shape[1], np.argmin(inside, axis=1))

    def record(self, i: int) -> Experiment:
        """Times and inputs of a manoeuvre."""
        n = int(self.ends[i])
        names = self.final.fit.model.input_names
        inputs = {name: u[:n] for name, u in zip(names, self.inputs[i], strict=True)}
        return Experiment(self.t[:n], inputs, name=str(self.manoeuvres[i]))

    def gains(self, rival: Refit, least: float) -> _Array:
        """(M,) expected gains in log-likelihood over a rival from data of each manoeuvre; 0 where it is below
        ``least``, NaN where the rival has no solution.

        The rival takes a few steps with the derivatives at its estimates towards the outputs of the cause: what then
        counts is the difference itself, less what another step would still take, to first order.
        """
        flown = Flown(rival, self.t, self.trim)
        found = np.zeros(len(self.manoeuvres))
        late = np.vstack([self.cause.late, flown.late])
        y, _ = flown.fly(self.inputs)
        present = [self._present(i, late) for i in range(found.size)]
        # Where the difference is small as it stands, nothing has to follow.
        channels = self.final.own.filter
        whitened = [channels.on(rows_of(p))((self.y[i] - y[i])[p]) for i, p in enumerate(present)]
        sizes = np.array([0.5 * float(e @ e) for e in whitened])
        found[~np.isfinite(sizes)] = np.nan
        some = np.flatnonzero(sizes >= least)
        if not some.size:
            return found
        room = max(int(_ROOM / (flown.units.size * y[0].size)), 1)
        some = some[np.argsort(-sizes[some], kind="stable")[:room]]
        moved = flown.tangents(self.inputs[some])
        views: dict[int, Imitation] = {}
        for i, m in zip(some.tolist(), moved, strict=True):
            found[i] = np.nan
            if np.isfinite(m[:, present[i]]).all():
                view = Imitation(present[i], channels, m, flown.tied)
                found[i] = view.gain(whitened[i], np.zeros(flown.units.size))
                if found[i] >= _HOPELESS * least:
                    views[i] = view
        at = {i: np.zeros(flown.units.size) for i in views}
        errors = {i: whitened[i] for i in views}
        for _ in range(_ROUNDS):
            if not views:
                break
            tries = [(i, at[i] + part * view.step(errors[i], at[i])) for i, view in views.items() for part in _PARTS]
            y, _ = flown.fly(self.inputs, np.array([to for _, to in tries]), np.array([i for i, _ in tries]))
            for (i, to), outputs in zip(tries, y, strict=True):
                e = views[i].whitened(self.y[i] - outputs)
                if np.isfinite(e).all() and views[i].cost(e, to) < views[i].cost(errors[i], at[i]):
                    at[i], errors[i] = to, e
            gains = {i: view.gain(errors[i], at[i]) for i, view in views.items()}
            views = {i: view for i, view in views.items() if abs(gains[i] - found[i]) > _SETTLED * gains[i]}
            found[list(gains)] = list(gains.values())
        return found

    def _present(self, i: int, late: _Array) -> NDArray[np.bool_]:
        """(n_y, N) samples of a manoeuvre. What a late sensor (``late``, s) shows first was before the record, and what
        an early one shows last comes after it."""
        present = np.zeros((len(self.every), self.t.size), dtype=bool)
        for row, every in enumerate(self.every):
            begin, lost = (
                int(np.ceil(_MARGIN * max(float((sign * late[:, row]).max()), 0.0) / (self.t[1] - self.t[0])))
                for sign in (1.0, -1.0)
            )
            present[row, begin : max(self.ends[i] - lost, begin) : every] = True
        return present


def _reach(v: _Array) -> float:
    """How far a series goes from where it begins; a late sensor shows nothing at first."""
    v = v[np.isfinite(v)]
    return float(np.abs(v - v[0]).max()) if v.size else 0.0


def _spacing(data: Sequence[Experiment], name: str, step: float) -> int:
    """Steps between samples of an output."""
    for e in data:
        t = e.t[np.isfinite(e.output(name))]
        if t.size > 1:
            return max(round(float(np.median(np.diff(t))) / step), 1)
    return 1
