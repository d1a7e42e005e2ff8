"""Measures of how well a model matches a record, and tolerances that the user gives for it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from numbers import Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .errors import OptionError, UnknownName, did_you_mean, listing
from .modelling.noise import Gaussian, Noise
from .notebook import Rows, overview
from .records import Record

__all__ = [
    "Match",
    "Tolerance",
    "chi_square",
    "chi_square_quantile",
    "chi_square_tail",
    "chi_square_warning",
    "match",
    "match_rows",
    "no_match",
    "r_squared",
    "tolerance_of",
    "tolerances_by_output",
]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True)
class Tolerance:
    """A tolerance as flight simulators are qualified with (14 CFR Part 60): "±3 kt, or ±5 %, whichever is greater".

    ``absolute``  greatest deviation, in the unit of the output; 0 for none.
    ``relative``  the same as a part of the measured value at each sample, 0.05 for 5 %; 0 for none. Where a standard
                  means a part of the greatest value, that is one number, and so absolute.

    A sample z may be off by ``max(absolute, relative * abs(z))``. Where tolerances are taken, a number is an absolute
    one. Raises OptionError where neither is positive, or ``relative`` is above 1.

    >>> Tolerance(absolute=1.5, relative=0.05).at(np.array([10.0, -60.0]))
    array([1.5, 3. ])
    """

    absolute: float = 0.0
    relative: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("absolute", self.absolute), ("relative", self.relative)):
            if not isinstance(value, Real) or isinstance(value, bool) or not 0.0 <= value < math.inf:
                raise OptionError(f"Tolerance: {name} is a number from 0, not {value!r}")
        if self.relative > 1.0:
            raise OptionError(
                f"Tolerance: relative is a part of the measured value, 0.05 for 5 %, not {self.relative!r}"
            )
        if not (self.absolute or self.relative):
            raise OptionError("Tolerance: give an absolute or a relative part above 0, or both")

    def at(self, measured: _Array) -> _Array:
        """Return the greatest allowed deviation of samples (N,); NaN where one is missing."""
        sizes = np.abs(np.asarray(measured, dtype=float))
        return np.asarray(np.where(np.isnan(sizes), np.nan, np.maximum(self.absolute, self.relative * sizes)))

    def text(self, unit: str = "") -> str:
        """Return a short text for tables and figures.

        >>> Tolerance(absolute=1.5, relative=0.05).text("m/s")
        '±1.5 m/s or ±5 %'
        """
        unit = "" if unit in ("1", "-") else unit
        parts = [f"±{self.absolute:.4g} {unit}".rstrip()] if self.absolute else []
        parts += [f"±{100.0 * self.relative:.4g} %"] if self.relative else []
        return " or ".join(parts)


def tolerance_of(whose: str, value: Any) -> Tolerance:
    """Return the tolerance given for one output; ``whose`` names it in errors."""
    if isinstance(value, Tolerance):
        return value
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise OptionError(f"{whose} must be a number, or a Tolerance(absolute, relative), not {value!r}") from None
    if not 0.0 < number < math.inf:
        raise OptionError(f"{whose} must be positive and finite, not {value!r}")
    return Tolerance(number)


def tolerances_by_output(caller: str, outputs: Sequence[str], given: Any) -> dict[str, Tolerance]:
    """Return the tolerances given to ``caller``, in the order of ``outputs``; {} for None.

    Raises OptionError for anything but a mapping, an unknown output, or an invalid tolerance.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise OptionError(f"{caller}: tolerances are given by output, such as {{'q': 0.035}}, not as {given!r}")
    limits = {}
    for name, value in given.items():
        if name not in outputs:
            hint = did_you_mean(str(name), outputs)
            raise OptionError(f"{caller}: tolerance of '{name}', which is not an output.{hint}")
        limits[name] = tolerance_of(f"{caller}: the tolerance of '{name}'", value)
    return {name: limits[name] for name in outputs if name in limits}


_Piece = tuple[_Array, _Array, _Array]  # of one record at its measured samples: times, measured, model

# Most lags of the Ljung-Box test, and the part of the samples that they may be.
_LAGS, _SHARE = 20, 0.2


# R² below zero by no more than this is a channel that contains noise alone.
_NO_BETTER = -0.01
# Where all R² are below this, hardly any of the motion is explained.
_POOR = 0.5


def no_match(r_squared: Mapping[str, float]) -> str:
    """Return a sentence on the outputs whose R² is below 0, or on all outputs where none is matched well; else "". The
    cause is mostly data in other units, or a poor optimum.

    >>> no_match({"q": 0.98, "alpha": -1.28})
    'A constant would match alpha better than the model does (R² below 0): look at its unit, its sign and its column.'
    >>> no_match({"hares": 0.05, "lynxes": 0.4})
    'No output is matched well (R² at most 0.40): a poor local optimum, which ph.multistart gets past, or a poor model.'
    """
    known = [value for value in r_squared.values() if math.isfinite(value)]
    if known and min(known) >= _NO_BETTER and max(known) < _POOR:
        return (
            f"No output is matched well (R² at most {max(known):.2f}): a poor local optimum, which ph.multistart gets "
            "past, or a poor model."
        )
    names = [name for name, value in r_squared.items() if value < _NO_BETTER]
    whose, last = ("its", "its column") if len(names) == 1 else ("their", "their columns")
    what = f"{whose} unit, {whose} sign" if len(names) == 1 else f"{whose} units, {whose} signs"
    return (
        f"A constant would match {', '.join(names)} better than the model does (R² below 0): look at {what} and {last}."
        if names
        else ""
    )


@dataclass(frozen=True)
class Match:
    """One output of the model against its measurements z, with residuals r = z - y; missing samples are left out.

    Where states do not satisfy the equations (`Record.feasible`), outputs are not those of the model: all numbers but
    ``samples`` are NaN then.

    Over several records, squares and products about a mean are taken about the mean of each record and then summed, so
    that differences between records do not improve the match, and offsets of opposite sign do not cancel.

    With process noise (`FilterError`) y is the prediction from the preceding samples, and r the innovations: the most
    probable path follows the measurements for any model, and its residuals are not white for a right one.

    output, unit  name and unit.
    samples       measured values.
    rms           root mean square of the residuals, in the unit.
    sigma         standard deviation of the fit's noise (the scale of other than Gaussian noise), in the unit.
    r_squared     1 - sum r**2 / sum (z - mean z)**2: 1 for a perfect match, 0 for one no better than a constant; NaN
                  where the measurements stand still.
    theil         Theil's inequality coefficient U = rms(r) / (rms(z) + rms(y)): 0 for a perfect match, 1 for none;
                  below 0.25 to 0.3 counts as a good match.
    theil_about_mean  the same with z and y about the mean of z; a large offset such as gravity would make any U small.
    bias, variance, covariance  parts of the mean square of r: of the difference of means, of the difference of
                  standard deviations, and of what is left, 2 (1 - correlation) std(z) std(y). Their sum is 1; without a
                  systematic error only ``covariance`` is large. NaN where r is 0.
    lag_one       autocorrelation of r from one sample of this output to the next; 0 for white residuals.
    whiteness     p-value of the Ljung-Box test that r is white, over ``lags`` lags: small where it is not. NaN where
                  there are fewer than 8 samples, or r is constant.
    tolerance     as given, or None; ``inside`` is the part of the samples with abs(r) <= tolerance, NaN without one.

    R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd edition (AIAA, 2015), chapter 11; G. M. Ljung and
    G. E. P. Box, Biometrika 65 (1978), with lagged pairs counted where samples are missing (D. S. Stoffer and C. M. C.
    Toloi, Statistics & Probability Letters 13, 1992).
    """

    output: str
    unit: str
    samples: int
    rms: float
    sigma: float
    r_squared: float
    theil: float
    theil_about_mean: float
    bias: float
    variance: float
    covariance: float
    lag_one: float
    whiteness: float
    lags: int
    tolerance: Tolerance | None = None
    inside: float = math.nan

    def _repr_html_(self) -> str:
        return overview(f"Match of {self.output}", match_rows([self]))


def match(
    records: Record | Sequence[Record],
    output: str,
    sigma: float = math.nan,
    tolerance: float | Tolerance | None = None,
) -> Match:
    """Return the goodness of fit of an output over one record or several that measured it; NaN where there are no
    samples.

    ``match(fit.records, "q")``; ``sigma`` and ``tolerance`` (in the output's unit, or a `Tolerance`) are passed on.
    Raises UnknownName for an output that a record has no measurements of, OptionError for an invalid tolerance.
    """
    limit = None if tolerance is None else tolerance_of("match: the tolerance", tolerance)
    records = [records] if isinstance(records, Record) else records
    for record in records:
        if output not in record.measured:
            raise UnknownName(f"record '{record.name}' has no measured '{output}'.{listing(output, record.measured)}")
    pieces = [piece for record in records if (piece := _present(record, output))[0].size]
    samples = sum(t.size for t, _, _ in pieces)
    if not all(record.feasible for record in records):
        pieces = []
    n = sum(t.size for t, _, _ in pieces)
    r2 = sum(_squares(z - y) for _, z, y in pieces)
    scatter = sum(_squares((z - y) - (z - y).mean()) for _, z, y in pieces)
    sizes = [math.sqrt(sum(_squares(piece[i]) for piece in pieces)) for i in (1, 2)]
    about = sum(_squares(z - z.mean()) for _, z, _ in pieces)
    sizes_about = [math.sqrt(about), math.sqrt(sum(_squares(y - z.mean()) for _, z, y in pieces))]
    offset = sum(t.size * float(np.square(z.mean() - y.mean())) for t, z, y in pieces)
    spread = sum(t.size * float(np.square(z.std() - y.std())) for t, z, y in pieces)
    p_value, lag_one, lags = _whiteness(pieces)
    residuals = np.concatenate([np.empty(0), *(z - y for _, z, y in pieces)])
    measured = np.concatenate([np.empty(0), *(z for _, z, _ in pieces)])
    return Match(
        output=output,
        unit=next((r.units[output] for r in records if output in r.units), ""),
        samples=samples,
        rms=math.sqrt(r2 / n) if n else math.nan,
        sigma=sigma,
        r_squared=1.0 - r2 / about if about > 0 else math.nan,
        theil=_share(math.sqrt(r2), sum(sizes)),
        theil_about_mean=_share(math.sqrt(r2), sum(sizes_about)),
        bias=_share(offset, r2),
        variance=_share(spread, r2),
        # The remaining scatter of r about its mean: 2 (1 - correlation) std(z) std(y), without the division.
        covariance=_share(max(scatter - spread, 0.0), r2),
        lag_one=lag_one,
        whiteness=p_value,
        lags=lags,
        tolerance=limit,
        inside=float(np.mean(np.abs(residuals) <= limit.at(measured))) if limit is not None and n else math.nan,
    )


def match_rows(matches: Iterable[Match]) -> Rows:
    """Return heads, rows and alignment of a table with a row for each match."""
    rows = []
    for m in matches:
        parts = "/".join(_number(100 * part, ".0f") for part in (m.bias, m.variance, m.covariance))
        rows.append(
            [
                m.output,
                m.unit,
                _number(m.rms, ".4g"),
                _number(m.sigma, ".4g"),
                _number(m.r_squared, ".4f"),
                _number(m.theil, ".4f"),
                _number(m.theil_about_mean, ".4f"),
                parts if math.isfinite(m.bias) else "",
                _number(m.lag_one, ".2f"),
                "<0.001" if m.whiteness < 0.001 else _number(m.whiteness, ".3f"),
                _number(100 * m.inside, ".1f"),
                str(m.samples),
            ]
        )
    parts_of = "bias/var/cov, %"
    heads = ["output", "unit", "RMS", "σ of fit", "R²", "Theil U", "about mean", parts_of, "lag-1", "p white"]
    return [*heads, "inside, %", "samples"], rows, "llrrrrrrrrrr"


def _number(value: float, spec: str) -> str:
    return format(value, spec) if math.isfinite(value) else ""


def r_squared(records: Sequence[Record], output: str) -> float:
    """Return `Match.r_squared` alone, without the cost of the tests in `match`."""
    if not all(record.feasible for record in records):
        return math.nan
    pieces = [piece for record in records if (piece := _present(record, output))[0].size]
    about = sum(_squares(z - z.mean()) for _, z, _ in pieces)
    return 1.0 - sum(_squares(z - y) for _, z, y in pieces) / about if about > 0 else math.nan


def _present(record: Record, output: str) -> _Piece:
    z, y = record.measured[output], record.outputs[output]
    if output in record.innovations:
        y = z - record.innovations[output]
    there = np.isfinite(z) & np.isfinite(y)
    return record.t[there], z[there], y[there]


def _squares(x: _Array) -> float:
    return float(np.sum(x**2))


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else math.nan


def _whiteness(pieces: Sequence[_Piece]) -> tuple[float, float, int]:
    """Return the p-value of the Ljung-Box test, the autocorrelation at lag 1, and the number of lags.

    Each record's residuals are put on the grid of the output's own sampling, with gaps where samples are missing.
    """
    grids = [_on_grid(t, z - y) for t, z, y in pieces]
    n = sum(t.size for t, _, _ in pieces)
    squares = sum(float(np.nansum(g**2)) for g in grids)
    if n < 2 or squares <= 0.0:
        return math.nan, math.nan, 0
    products = [_lagged(grids, lag) for lag in range(1, min(_LAGS, max(int(_SHARE * n), 1)) + 1)]
    pairs = [(total / squares, count) for total, count in products if count > 0]
    lag_one = products[0][0] / squares if products[0][1] else math.nan
    if n < 8 or not pairs:
        return math.nan, lag_one, 0
    q = n * (n + 2.0) * sum(r**2 / count for r, count in pairs)
    return chi_square_tail(q, len(pairs)), lag_one, len(pairs)


def chi_square_tail(x: float, freedom: int) -> float:
    """Return the probability that a chi-square variable with so many degrees of freedom is greater than ``x``.

    The finite sums of Abramowitz & Stegun, 26.4.4 and 26.4.5. scipy.special, which has this too, takes longer to import
    than a fit.

    >>> round(chi_square_tail(3.841459, 1), 6), round(chi_square_tail(5.991465, 2), 6)
    (0.05, 0.05)
    """
    half = 0.5 * x
    odd = freedom % 2
    term = math.exp(-half) * (math.sqrt(half / math.pi) * 2.0 if odd else 1.0)
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    for i in range(freedom // 2):
        total += term
        term *= half / (i + (1.5 if odd else 1.0))
    return total


@cache
def chi_square_quantile(freedom: float, tail: float) -> float:
    """Return the value that a chi-square variable with so many degrees of freedom, also a fraction, exceeds with
    probability ``tail``.

    By bisection of the incomplete gamma function; scipy.special takes longer to import than a fit.

    >>> round(chi_square_quantile(1, 0.05), 6), round(chi_square_quantile(2, 0.05), 6)
    (3.841459, 5.991465)
    """
    low, high = 0.0, 1.0
    while _gamma_tail(0.5 * freedom, 0.5 * high) > tail:
        low, high = high, 2.0 * high
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        low, high = (middle, high) if _gamma_tail(0.5 * freedom, 0.5 * middle) > tail else (low, middle)


def _gamma_tail(a: float, x: float) -> float:
    """Return the regularised upper incomplete gamma function Q(a, x): Abramowitz & Stegun, 6.5.29 and 6.5.31."""
    factor = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > 1e-17 * total:
            n += 1.0
            term *= x / n
            total += term
        return 1.0 - factor * total
    # The continued fraction, by the method of Lentz.
    b = x + 1.0 - a
    c, d = math.inf, 1.0 / b
    value, change, i = d, 0.0, 0
    while abs(change - 1.0) > 1e-16:
        i += 1
        b += 2.0
        d = 1.0 / (b - i * (i - a) * d)
        c = b - i * (i - a) / c
        change = c * d
        value *= change
    return factor * value


def _on_grid(t: _Array, r: _Array) -> _Array:
    """Return residuals about their mean, one for each sampling interval, NaN where a sample is missing.

    Where almost all samples of a record are missing, a grid would be too large: there the samples are taken one by one.
    """
    r = r - r.mean()
    # Equal residuals leave only rounding errors.
    r = np.where(np.abs(r) > 1e-12 * np.abs(r).max(initial=0.0), r, 0.0)
    if t.size < 3:
        return r
    gaps = np.diff(t)
    steps = np.maximum(np.round(gaps / np.median(gaps)), 1.0)
    if steps.sum() > 100.0 * t.size:
        return r
    at = np.concatenate([[0], np.cumsum(steps.astype(np.int64))])
    grid = np.full(int(at[-1]) + 1, np.nan)
    grid[at] = r
    return grid


def _lagged(grids: Sequence[_Array], lag: int) -> tuple[float, int]:
    """Return the sum of the products of residuals ``lag`` intervals apart, and their number."""
    products = [g[lag:] * g[:-lag] for g in grids if g.size > lag]
    return sum(float(np.nansum(p)) for p in products), sum(int(np.isfinite(p).sum()) for p in products)


def chi_square(noise: Noise, outputs: Sequence[str], records: Sequence[Record]) -> tuple[float, int]:
    """Return the sum of r' R^-1 r over the samples, each with the rows and columns of R that are measured, and the
    number of measured values in it.

    Outputs whose standard deviation is not known are left out. NaN and 0 where none is known, where noise is not
    Gaussian, and where the states of a record do not satisfy the equations.
    """
    known = noise.known_sigmas(outputs) if isinstance(noise, Gaussian) else {}
    names = [name for name in outputs if name in known]
    if not names or not all(record.feasible for record in records):
        return math.nan, 0
    assert isinstance(noise, Gaussian)
    R = np.diag([known[name] ** 2 for name in names]) if noise.covariance is None else noise.matrix(outputs)
    total, count = 0.0, 0
    for record in records:
        residuals = np.array([record.residuals[name] for name in names])
        there = np.isfinite(residuals)
        count += int(there.sum())
        for pattern in np.unique(there, axis=1).T:
            if pattern.any():
                r = residuals[np.ix_(pattern, (pattern == there.T).all(axis=1))]
                total += float(np.sum(r * np.linalg.solve(R[np.ix_(pattern, pattern)], r)))
    return total, count


def chi_square_warning(noise: Noise, outputs: Sequence[str], records: Sequence[Record], unknowns: int) -> str:
    """Return a sentence where the residuals are not those of the noise that was declared, else "".

    ``unknowns``: the number of parameters and initial states that were estimated.
    """
    total, count = chi_square(noise, outputs, records)
    return _core.unlike_noise(total, max(count - unknowns, 0))
