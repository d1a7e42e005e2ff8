"""Standard errors corrected for residual autocorrelation (Maine & Iliff 1981; Morelli & Klein 1997)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..errors import EvaluationError
from ..fit_result import FitResult
from ..notebook import notebook_page, table
from ..parameters import Estimates, plus_minus, text_table
from ..residual_noise import output_segments
from ..residual_noise.autoregression import Autoregression
from ..residual_noise.whitening import (
    GridColumns,
    Links,
    cross_correlations,
    restricted_autoregressions,
    shared_covariance,
)
from ..sensitivities.tangents import Tangents
from ..time_unit import SECONDS, TimeUnit

__all__ = ["Colouring", "CorrectedErrors", "coloured"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class CorrectedErrors:
    """The result of `Fit.robust`: a fit's standard errors, corrected for coloured residuals.

    parameters      by name, with corrected standard errors; NaN where the fit has none, and for noise parameters of
                    densities that are not Gaussian.
    initial_states  experiment -> state -> estimate, with corrected standard errors.
    covariance      (n, n) of the parameters in their order, corrected.
    plain           (n,) standard errors of the fit, which assume white residuals.
    autocorrelation  output -> (L,) of the noise, from lag 0 on, with fewer than 1 % left at the end.
    times           output -> correlation time of the noise: the sum of its autocorrelation at positive and negative
                    lags times the step. White noise has its step.
    """

    parameters: Estimates
    initial_states: Mapping[str, Estimates]
    covariance: _Array
    plain: _Array
    autocorrelation: Mapping[str, _Array]
    times: Mapping[str, float]
    time_unit: TimeUnit = SECONDS

    @property
    def inflation(self) -> dict[str, float]:
        """Name -> corrected over plain standard error; NaN where there is none."""
        errors = self.parameters.std_errors_array
        with np.errstate(divide="ignore", invalid="ignore"):
            return dict(zip(self.parameters, (errors / self.plain).tolist(), strict=True))

    def summary(self) -> str:
        """Return a table of both standard errors of each parameter, and the correlation time of the noise of each
        output."""
        return "\n\n".join(text_table(*each) for each in self._tables())

    def _repr_html_(self) -> str:
        return notebook_page("Standard errors for coloured residuals", *(table(*each) for each in self._tables()))

    def _tables(self) -> tuple[tuple[list[str], list[list[str]], str], ...]:
        """Return heads, rows and alignment of both tables."""
        rows = []
        for (name, ratio), e, plain in zip(self.inflation.items(), self.parameters.values(), self.plain, strict=True):
            error = "" if math.isnan(plain) else f"{plain:.2g}"
            corrected = "" if math.isnan(e.std_error) else f"{e.std_error:.2g}"
            ratio_text = "" if math.isnan(ratio) else f"{ratio:.2f}"
            value = plus_minus(e.value, e.std_error).partition(" ± ")[0]
            rows.append([name, value, error, corrected, ratio_text, e.unit, e.remark])
        heads = ["parameter", "estimate", "std error", "corrected", "ratio", "unit", "remark"]
        noise = [
            [n, f"{r[1] if r.size > 1 else 0.0:.2f}", f"{self.times[n]:.3g}"] for n, r in self.autocorrelation.items()
        ]
        return (heads, rows, "srrrrll"), (["noise of", "lag-1", self.time_unit.axis("correlation time")], noise, "lrr")

    def __str__(self) -> str:
        return self.summary()

    def __repr__(self) -> str:
        known = [r for r in self.inflation.values() if math.isfinite(r)]
        return (
            f"<CorrectedErrors: standard errors {min(known):.2f} to {max(known):.2f} times as large>"
            if known
            else "<CorrectedErrors>"
        )


class Colouring:
    """The autocorrelated noise of a fit, and its effect on the estimates.

    The error of the estimate is M^-1 sum_k S_k' R^-1 v_k, so that its covariance is

        P = M^-1 [sum_k sum_l S_k' R^-1 C(k - l) R^-1 S_l] M^-1,

    M the information, S sensitivities, C the autocovariance of the noise v (Morelli & Klein 1997, Eq. 21; *Aircraft
    System Identification*, 2nd ed., Eq. 5.134). M is the exact one of the fit. C is made of the covariances of
    autoregressive processes, not of sums of lagged products of residuals: those weighted by S add up to 0 at the
    optimum.

    tangents   the space in which estimates scatter.
    processes  one an output: of scores, in units of the fit's noise.
    linked     correlations between channels.
    spread      (k, k) covariance of the sums of scores along the tangents.
    covariance  (k + j, k + j) of the coordinates, for the autocorrelated noise.
    """

    def __init__(self, tangents: Tangents) -> None:
        self.tangents = t = tangents
        linear, scores, k = t.linear, t.scores, t.k
        self.segments = output_segments(linear.times, linear.rows)
        # Where experiments have their own noise, all share one process, each with its own size.
        self.sizes = np.ones(linear.n_rows)
        if scores.own:
            for line in linear.rows:
                for rows in line:
                    self.sizes[rows] = (
                        math.sqrt(float(np.mean(scores.values[rows] ** 2)) or 1.0) if rows.stop > rows.start else 1.0
                    )
        self.values = scores.values / self.sizes
        columns = self._laid(t.basis * self.sizes[:, None])
        self.processes = restricted_autoregressions(
            self.segments, self.values, scores.weighted(t.basis) / self.sizes[:, None]
        )
        self.linked: Links = cross_correlations(self.segments, self.processes, self.values)
        spread = shared_covariance(self.linked, self.processes, columns)
        for process, laid in zip(self.processes, columns, strict=True):
            for a in laid:
                spread += a.columns @ a.times(process).T
        # For the noise's own unknowns, on which these estimates hardly depend, the curvature suffices.
        middle = np.linalg.inv(t.inverse)
        self.spread = _positive_semidefinite(0.5 * (spread + spread.T))
        middle[:k, :k] = self.spread + t.priors[:k, :k]
        middle[:k, k:] = middle[k:, :k] = 0.0
        self.covariance = t.inverse @ middle @ t.inverse

    def _laid(self, columns: _Array) -> list[list[GridColumns]]:
        return [[GridColumns(s, columns) for s in line] for line in self.segments]

    def spectral_root(self, members: Sequence[int], lags: int, size: int) -> NDArray[np.complex128]:
        """Return (size // 2 + 1, n, n) roots of the spectral matrix of the noise of some outputs, cross-spectra
        included, at the frequencies of `numpy.fft.rfft`."""
        n, bins = len(members), size // 2 + 1
        turn = 2j * np.pi * np.arange(bins) / size
        matrix = np.zeros((bins, n, n), dtype=np.complex128)
        responses = [
            np.fft.rfft(self.processes[i].response(lags), size) * math.sqrt(self.processes[i].power) for i in members
        ]
        for a, i in enumerate(members):
            matrix[:, a, a] = np.maximum(self.processes[i].spectrum(lags, size), 0.0)
        for (i, j, lag), rho in self.linked.items():
            if i in members and j in members:
                a, b = members.index(i), members.index(j)
                part = rho * np.exp(-turn * lag) * responses[a] * responses[b].conj()
                matrix[:, a, b] += part
                matrix[:, b, a] += part.conj()
        values, vectors = np.linalg.eigh(matrix)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])

    def lengthening(self, i: int, j: int, experiments: Sequence[int]) -> float:
        """Return the ratio of the variance of a mean square or product of outputs i and j to that for white noise: the
        mean over samples of sum_l rho_i(k - l) rho_j(k - l) (Bartlett 1946)."""
        total = count = 0.0
        for e in experiments:
            g, h = self.segments[i][e], self.segments[j][e]
            n = min(g.size, h.size)
            if not n:
                continue
            a, b = self.processes[i].covariance(n), self.processes[j].covariance(n)
            size = 1 << (2 * n - 1).bit_length()
            pairs = np.fft.irfft(np.abs(np.fft.rfft(g.mask[:n] * h.mask[:n], size)) ** 2, size)[:n]
            pairs[1:] *= 2.0
            total += float(pairs @ (a * b)) / (a[0] * b[0] or 1.0)
            count += float(np.sum(g.mask[:n] * h.mask[:n]))
        return total / count if count else 1.0


def _positive_semidefinite(matrix: _Array) -> _Array:
    """Return a symmetric matrix with its negative eigenvalues, which only an estimate has, set to 0."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def coloured(fit: FitResult) -> CorrectedErrors:
    """Return what `Fit.robust` gives, computed once for each fit; see there."""
    return fit._once("_coloured", lambda: _corrected(fit))


def _corrected(fit: FitResult) -> CorrectedErrors:
    try:
        c = Colouring(Tangents.of(fit, "coloured"))
    except np.linalg.LinAlgError as error:
        raise EvaluationError(f"coloured: the fit cannot be linearised ({error})") from error
    names = list(fit.parameters)
    model = c.tangents.names
    plain = fit.parameters.std_errors_array
    scale = _noise_inflations(fit, c)
    covariance = fit.covariance * np.outer(scale, scale)
    at = [names.index(n) for n in model]
    covariance[np.ix_(at, at)] = c.tangents.of_parameters(c.covariance)
    lost = ~(np.diag(fit.covariance) > 0.0)
    covariance[lost], covariance[:, lost] = np.nan, np.nan
    with np.errstate(invalid="ignore"):
        errors = np.where(np.isfinite(plain), np.sqrt(np.diag(covariance)), np.nan)
    grid = [max(line, key=lambda g: g.size) for line in c.segments]
    correlations = {
        n: _significant_autocorrelation(p, g.size)
        for n, p, g in zip(fit.model.output_names, c.processes, grid, strict=True)
    }
    steps = dict(zip(fit.model.output_names, (g.step for g in grid), strict=True))
    return CorrectedErrors(
        parameters=Estimates(
            replace(e, std_error=float(s)) for e, s in zip(fit.parameters.values(), errors, strict=True)
        ),
        initial_states=_initial(fit, c),
        covariance=covariance,
        plain=plain,
        autocorrelation=correlations,
        times={n: steps[n] * (2.0 * float(r.sum()) - 1.0) for n, r in correlations.items()},
        time_unit=fit.model.time_unit,
    )


def _significant_autocorrelation(process: Autoregression, most: int) -> _Array:
    """Return the autocorrelation up to the last lag where it is 0.01 or more."""
    c = process.autocorrelation(max(most, 1))
    return np.asarray(c[: int(np.flatnonzero(np.abs(c) >= 0.01)[-1]) + 2])


def _initial(fit: FitResult, c: Colouring) -> dict[str, Estimates]:
    linear = c.tangents.linear
    n_x, first, found = linear._problem.n_states, 0, {}
    for record, at in zip(linear.inner.records, linear.sample_points, strict=True):
        move = c.tangents.states[n_x * first : n_x * (first + 1)]
        first += at.size
        errors = np.sqrt(np.maximum(np.diag(move @ c.covariance @ move.T), 0.0))
        found[record.name] = Estimates(
            replace(e, std_error=float(s) if math.isfinite(e.std_error) else math.nan)
            for e, s in zip(fit.initial_states[record.name].values(), errors, strict=True)
        )
    return found


def _noise_inflations(fit: FitResult, c: Colouring) -> _Array:
    """Return (n,) factors on the standard errors of the noise's parameters; 1 for the model's."""
    outputs, records = list(fit.model.output_names), [r.name for r in fit.records]
    names = fit.noise_parameters
    single = {f"sigma_{n}": (i, i) for i, n in enumerate(outputs)}
    single |= {f"corr_{a}_{b}": (i, j) for i, a in enumerate(outputs) for j, b in enumerate(outputs)}
    found = []
    for name in fit.parameters:
        base, _, own = name.partition("[")
        if name not in names:
            found.append(1.0)
        elif c.tangents.scores.gaussian and base in single:
            experiments = [records.index(own[:-1])] if own else range(len(records))
            found.append(math.sqrt(c.lengthening(*single[base], experiments)))
        else:
            found.append(math.nan)
    return np.array(found)
