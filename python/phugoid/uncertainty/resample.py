"""Resampled data: the model's outputs with other noise of the same kind."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..errors import OptionError
from ..fit_result import FitResult, dataset
from ..modelling.densities import Density, Huber, Laplace, PerExperiment, PerOutput, StudentT
from ..modelling.noise import Gaussian, Noise
from ..sensitivities.tangents import Tangents, noise_values
from .coloured import Colouring, coloured

__all__ = ["Blocks", "ColouredNoise", "Parametric", "Resampler", "block_length"]

_Array: TypeAlias = NDArray[np.float64]

# Points at which a density is tabulated, and how far out, in scales.
_TABLE, _FAR = 4001, 1e4


@dataclass(frozen=True, eq=False)
class Resampler:
    """Draws noise for all records of a fit: ``draw`` returns outputs by name, NaN where nothing was measured.

    times   (N,) of each experiment, s.
    model   experiment by experiment, output -> (N,) of the model.
    there   where something was measured.
    """

    times: Sequence[_Array]
    model: Sequence[Mapping[str, _Array]]
    there: Sequence[Mapping[str, NDArray[np.bool_]]]

    def noise(self, random: np.random.Generator, e: int) -> Mapping[str, _Array]:
        """Return output -> (N,) noise of experiment ``e``."""
        raise NotImplementedError

    def draw(self, random: np.random.Generator) -> list[dict[str, _Array]]:
        """Return the outputs of all experiments."""
        found = []
        for e, (model, there) in enumerate(zip(self.model, self.there, strict=True)):
            noise = self.noise(random, e)
            found.append({n: np.where(there[n], y + noise[n], np.nan) for n, y in model.items()})
        return found

    @staticmethod
    def parts(fit: FitResult) -> dict[str, Any]:
        """Return the fields of the base class."""
        names = fit.model.output_names
        model = [{n: np.asarray(r.outputs[n]) for n in names} for r in fit.records]
        there = [
            {n: np.isfinite(e.output(n)) & np.isfinite(y[n]) for n in names}
            for e, y in zip(dataset(fit), model, strict=True)
        ]
        return {"times": [r.t for r in fit.records], "model": model, "there": there}


@dataclass(frozen=True, eq=False)
class Parametric(Resampler):
    """White noise of the fit's noise model: for each experiment a joint covariance, or for each output a scale and the
    quantiles of its density at equal steps of probability."""

    covariances: Sequence[_Array | None] = ()
    tables: Sequence[Mapping[str, tuple[_Array, _Array]]] = ()

    @classmethod
    def of(cls, fit: FitResult) -> Parametric:
        """Return the resampler with the noise of a fit."""
        noise = fit.noise.noise if isinstance(fit.noise, PerExperiment) else fit.noise
        names, covariances, tables = fit.model.output_names, [], []
        for record in fit.records:
            value = noise_values(fit, record.name)
            joint = isinstance(noise, Gaussian) and (noise.correlated or noise.covariance is not None)
            covariances.append(noise.matrix(names, value) if isinstance(noise, Gaussian) and joint else None)
            known = noise.known_sigmas(names)
            tables.append(
                {}
                if joint
                else {
                    n: _table(
                        noise.of(n) if isinstance(noise, PerOutput) else noise,
                        n,
                        known[n] if n in known else value[f"sigma_{n}"],
                        value,
                    )
                    for n in names
                }
            )
        return cls(**cls.parts(fit), covariances=covariances, tables=tables)

    def noise(self, random: np.random.Generator, e: int) -> Mapping[str, _Array]:
        n, names = self.times[e].size, list(self.model[e])
        covariance = self.covariances[e]
        if covariance is not None:
            drawn = random.standard_normal((n, len(names))) @ np.linalg.cholesky(covariance).T
            return dict(zip(names, drawn.T, strict=True))
        found = {}
        for name in names:
            probability, quantile = self.tables[e][name]
            if probability.size:
                found[name] = np.interp(random.random(n), probability, quantile)
            else:
                found[name] = float(quantile[0]) * random.standard_normal(n)
        return found

    def quantiles(self, e: int, output: str, p: float) -> tuple[float, float]:
        """Return how far below and above 0 the noise of an output lies, with probability ``p`` beyond on each side."""
        covariance = self.covariances[e]
        if covariance is None:
            probability, quantile = self.tables[e][output]
            if probability.size:
                low, high = np.interp([p, 1.0 - p], probability, quantile).tolist()
                return -low, high
            sigma = float(quantile[0])
        else:
            sigma = math.sqrt(float(np.diag(covariance)[list(self.model[e]).index(output)]))
        reach = sigma * NormalDist().inv_cdf(1.0 - p)
        return reach, reach


def _table(kind: Noise, output: str, sigma: float, value: Mapping[str, float]) -> tuple[_Array, _Array]:
    """Return probabilities and quantiles of a density; for a Gaussian only its standard deviation."""
    if isinstance(kind, Gaussian):
        return np.empty(0), np.array([sigma])
    e = np.sinh(np.linspace(-1.0, 1.0, _TABLE) * math.asinh(_FAR))
    if isinstance(kind, StudentT):
        known = kind._dof(output)
        dof = value[f"dof_{output}"] if known is None else known
        log = -0.5 * (dof + 1) * np.log1p(e**2 / dof)
    elif isinstance(kind, Huber):
        size = np.abs(e)
        log = -np.where(size <= kind.k, 0.5 * e**2, kind.k * size - 0.5 * kind.k**2)
    elif isinstance(kind, Laplace):
        log = -np.sqrt(e**2 + kind.smoothing**2)
    else:
        assert isinstance(kind, Density)
        numbers = {"sigma": sigma} | {
            n: value.get(f"{n}_{output}", float(getattr(p, "start", math.nan))) for n, p in kind.parameters.items()
        }
        expression = Expr(kind.log_density)
        known_to = {n: numbers[n] for n in expression.symbols if n != "residual"}
        log = np.array([expression.evaluate({**known_to, "residual": r}) for r in (e * sigma).tolist()])
    density = np.exp(log - log.max())
    steps = 0.5 * (density[1:] + density[:-1]) * np.diff(e)
    total = np.r_[0.0, np.cumsum(steps)] / steps.sum()
    kept = np.r_[True, np.diff(total) > 0.0]
    return total[kept], sigma * e[kept]


@dataclass(frozen=True, eq=False)
class ColouredNoise(Resampler):
    """Noise with the autocorrelation and cross-correlation of the residuals, drawn by its spectrum.

    places  for each experiment, output -> (N,) points of an even grid.
    roots   for each experiment, groups of outputs on one grid, the size of the transform, and (F, n, n) roots of the
            spectral matrix; ``scale`` what makes it noise in the output's unit.
    """

    places: Sequence[Mapping[str, NDArray[np.intp]]] = ()
    roots: Sequence[Sequence[tuple[Sequence[str], int, NDArray[np.complex128]]]] = ()
    scale: Sequence[Mapping[str, float]] = ()

    @classmethod
    def of(cls, fit: FitResult) -> ColouredNoise:
        """Return the resampler with the autocorrelation of a fit's residuals. Raises OptionError for noise that is not
        independent and Gaussian."""
        c = Colouring(Tangents.of(fit, "bootstrap"))
        scores = c.tangents.scores
        if not scores.gaussian or scores._joint:
            raise OptionError(
                'bootstrap: kind="coloured" is for independent Gaussian noise; use kind="block", which needs no model '
                "of the noise"
            )
        names, linear = list(fit.model.output_names), c.tangents.linear
        places, roots = [], []
        scale: list[dict[str, float]] = []
        for e, record in enumerate(fit.records):
            steps = [line[e].step for line in c.segments]
            places.append(
                {n: np.rint((record.t - record.t[0]) / s).astype(np.intp) for n, s in zip(names, steps, strict=True)}
            )
            groups = []
            for step in dict.fromkeys(steps):
                members = [i for i, s in enumerate(steps) if s == step]
                whole = int(max(places[-1][names[i]][-1] for i in members)) + 1
                size = 1 << (4 * whole - 1).bit_length()
                groups.append(([names[i] for i in members], size, c.spectral_root(members, whole, size)))
            roots.append(groups)
            scale.append({})
            for i, n in enumerate(names):
                rows = linear.rows[i][e]
                # A score is the residual over the variance, in units of the fit's scale.
                ratio = (
                    linear.residuals[rows]
                    @ scores.values[rows]
                    / max(float(scores.values[rows] @ scores.values[rows]), 1e-300)
                )
                scale[-1][n] = float(ratio * (c.sizes[rows][0] if rows.stop > rows.start else 1.0))
        return cls(**cls.parts(fit), places=places, roots=roots, scale=scale)

    def noise(self, random: np.random.Generator, e: int) -> Mapping[str, _Array]:
        found = {}
        for names, size, root in self.roots[e]:
            bins = size // 2 + 1
            drawn = random.standard_normal((bins, len(names), 2)) @ np.array([1.0, 1.0j]) * math.sqrt(0.5)
            drawn[[0, -1]] = math.sqrt(2.0) * drawn[[0, -1]].real
            series = np.fft.irfft(np.einsum("fij,fj->if", root, drawn), size) * math.sqrt(size)
            for name, line in zip(names, series, strict=True):
                found[name] = self.scale[e][name] * line[self.places[e][name]]
        return found


# Blocks are no longer than this part of a record.
_LONGEST = 6


@dataclass(frozen=True, eq=False)
class Blocks(Resampler):
    """Blocks of the residuals themselves, all channels together (Künsch 1989).

    residuals  for each experiment (N, n_y), centred, the missing ones filled with the nearest in time.
    starts     for each experiment where a block may begin, by its length.
    """

    residuals: Sequence[_Array] = ()
    lengths: Sequence[int] = ()
    starts: Sequence[NDArray[np.intp]] = ()

    @classmethod
    def of(cls, fit: FitResult, block: int) -> Blocks:
        """Return the resampler with blocks of ``block`` samples, or fewer where gaps leave no room for them."""
        names = list(fit.model.output_names)
        parts = cls.parts(fit)
        raw = [np.column_stack([r.residuals[n] for n in names]) for r in fit.records]
        stacked = np.vstack(raw)
        n = int(np.isfinite(stacked).sum())
        free = sum(1 for e in fit.parameters.values() if not e.fixed and not e.bounds_active)
        free += len(fit.model.state_names) * len(fit.records) - len(fit.noise_parameters)
        # Residuals are smaller than the noise, since parameters were fitted to them.
        larger = math.sqrt(n / max(n - free, 1))
        mean = np.nanmean(stacked, axis=0)
        residuals, lengths, starts = [], [], []
        for r, record in zip(raw, fit.records, strict=True):
            filled, near = _filled(record.t, r)
            residuals.append(larger * (filled - mean))
            length, begin = _beginnings(record.t, near, block)
            lengths.append(length)
            starts.append(begin)
        return cls(**parts, residuals=residuals, lengths=lengths, starts=starts)

    def noise(self, random: np.random.Generator, e: int) -> Mapping[str, _Array]:
        n, length = self.times[e].size, self.lengths[e]
        begin = random.choice(self.starts[e], size=-(-n // length))
        at = (begin[:, None] + np.arange(length)).ravel()[:n]
        return dict(zip(self.model[e], self.residuals[e][at].T, strict=True))


def _filled(t: _Array, residuals: _Array) -> tuple[_Array, NDArray[np.bool_]]:
    """Return residuals with the nearest in place of missing ones, and whether all channels were measured within their
    usual spacing."""
    out, near = residuals.copy(), np.ones(t.size, dtype=np.bool_)
    for column in out.T:
        there = np.flatnonzero(np.isfinite(column))
        if not there.size:
            column[:] = 0.0
            continue
        after = np.clip(np.searchsorted(t[there], t), 0, there.size - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(t - t[there[before]] < t[there[after]] - t, before, after)
        spacing = float(np.median(np.diff(t[there]))) if there.size > 1 else math.inf
        near &= np.abs(t[there[nearer]] - t) <= spacing
        column[:] = column[there[nearer]]
    return out, near


def _beginnings(t: _Array, near: NDArray[np.bool_], block: int) -> tuple[int, NDArray[np.intp]]:
    """Return the length of blocks and where they may begin: they do not reach over gaps, in time or in the
    measurements."""
    usual = float(np.median(np.diff(t)))
    whole = near.copy()
    broken = np.r_[False, np.diff(t) > 1.5 * usual]
    run = np.zeros(t.size, dtype=np.intp)  # samples from here on without a gap
    for k in range(t.size - 1, -1, -1):
        following = k + 1 < t.size and whole[k + 1] and not broken[k + 1]
        run[k] = (1 + (run[k + 1] if following else 0)) if whole[k] else 0
    length = max(min(block, int(run.max())), 1)
    begin = np.flatnonzero(run >= length)
    return length, begin if begin.size else np.arange(t.size)


def block_length(fit: FitResult) -> int:
    """Return the samples of a block, from the correlation time of the noise (Carlstein 1986): as for a process of order
    one with the longest correlation time of all outputs; at most a sixth of a record."""
    colour = coloured(fit)
    n = min(r.n for r in fit.records)
    length = 1.0
    for name, memory in colour.times.items():
        step = colour.times[name] / max(2.0 * float(colour.autocorrelation[name].sum()) - 1.0, 1e-3)
        usual = float(np.median([np.median(np.diff(r.t)) for r in fit.records]))
        tau = max(memory / step, 1.0)
        rho = (tau - 1.0) / (tau + 1.0)
        own = (2.0 * rho / max(1.0 - rho**2, 1e-9)) ** (2.0 / 3.0) * n ** (1.0 / 3.0)
        length = max(length, own * step / usual)
    return max(1, min(round(length), n // _LONGEST))
