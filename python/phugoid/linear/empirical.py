"""The frequency response that a record shows, without a model.

The ratio of discrete Fourier transforms (empirical transfer-function estimate, ETFE) and Welch's average of spectra
(H1), as in L. Ljung, System Identification: Theory for the User, 2nd edition, 1999, ch. 6, and J. S. Bendat and
A. G. Piersol, Random Data, 4th edition, 2010, ch. 6 and 9.
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..data.filtering import even_rate, number, whole_from
from ..errors import DataError, OptionError
from .response import FrequencyResponse

__all__ = ["Method", "empirical_response", "find_period"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]
Method = Literal["etfe", "h1"]

# A signal repeats where it is correlated with itself, so many samples later, at least this much.
_REPEATS = 0.95
# Of times at which it repeats, the first within this of the best is the period; the others are its multiples.
_AS_GOOD = 0.01


def empirical_response(
    data: Experiment,
    input: str,
    output: str,
    method: Method = "etfe",
    *,
    period: int | Literal["auto"] | None = None,
    smoothing: float | None = None,
    segment: int | None = None,
    band: tuple[float, float] | None = None,
    floor_db: float = -40.0,
    label: str | None = None,
) -> FrequencyResponse:
    """Response of ``output`` to ``input`` as the record shows it; arguments as in `frequency_response`."""
    if method not in get_args(Method):
        raise OptionError(f"frequency_response: method is 'etfe' or 'h1', not {method!r}")
    if smoothing is not None and (method != "etfe" or period is not None):
        raise OptionError("frequency_response: smoothing is for the ETFE of a record that does not repeat")
    if segment is not None and (method != "h1" or period is not None):
        raise OptionError("frequency_response: segment is for 'h1' on a record that does not repeat")
    rate, u, y = _channels(data, input, output)
    where = f"experiment '{data.name}', input '{input}'"
    averages = None  # number of independent averages, for standard errors
    if period is not None:
        length = find_period(u, where) if period == "auto" else whole_from(2, period, "frequency_response: period")
        f, U, Y = _periods(u, y, length, rate, where)
        words = f"{'ETFE' if method == 'etfe' else 'H1'}, {len(U)} periods of {length} samples"
        suu, syy, suy = _power(U).mean(axis=0), _power(Y).mean(axis=0), (U.conj() * Y).mean(axis=0)
        response = _ratio(Y.mean(axis=0), U.mean(axis=0)) if method == "etfe" else _ratio(suy, suu)
        averages = float(len(U)) if len(U) > 1 else None
    elif method == "h1":
        length = u.size // 8 if segment is None else whole_from(8, segment, "frequency_response: segment")
        if not 8 <= length <= u.size:
            raise DataError(f"experiment '{data.name}': {u.size} samples are too few for segments of {length} samples")
        f, suu, syy, suy = _welch(u, y, length, rate)
        response, words = _ratio(suy, suu), f"H1, segments of {length} samples"
        averages = _independent(u.size, length)
    else:
        f, U, Y = _periods(u, y, u.size, rate, where)
        suu, syy, suy, words = _power(U[0]), _power(Y[0]), U[0].conj() * Y[0], "ETFE"
        if smoothing is not None:
            width = number(smoothing, "frequency_response: smoothing (Hz)")
            kernel = _kernel(width, rate / u.size, f.size, data.name)
            suu, syy, suy = (np.convolve(s, kernel, mode="same") for s in (suu, syy, suy))
            averages, words = float(kernel.sum() ** 2 / (kernel**2).sum()), f"ETFE, smoothed over {width:g} Hz"
        response = _ratio(suy, suu)
    kept = (f > 0.0) & (suu > 10.0 ** (floor_db / 10.0) * suu.max(initial=0.0))
    if not kept.any():
        raise DataError(f"{where}: does not move, so that there is no response to it")
    coherence = std_error = None
    if averages is not None and averages > 1.0:
        coherence = np.clip(_ratio(_power(suy), suu * syy).real, 0.0, 1.0)
        with np.errstate(divide="ignore"):
            relative = np.sqrt((1.0 - coherence) / (2.0 * averages * coherence))
        std_error = np.abs(response) * relative
    found = FrequencyResponse(
        f[kept],
        response[kept],
        input,
        output,
        words if label is None else label,
        None if coherence is None else coherence[kept],
        None if std_error is None else std_error[kept],
        _unit(data, input, output),
    )
    return found if band is None else found.band(*band)


def find_period(values: _Array, where: str = "the signal") -> int:
    """Samples after which a signal repeats, by its correlation with itself; DataError where it does not.

    >>> find_period(np.tile([0.0, 1.0, 0.0, -2.0, 0.5], 20))
    5
    """
    n = values.size
    centred = values - values.mean()
    spectrum = np.fft.rfft(centred, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: n // 2 + 1]
    # Of what overlaps only, so that a long period counts as much as a short one.
    squares = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(n // 2 + 1)
    norm = np.sqrt(squares[n - lags] * (squares[-1] - squares[lags]))
    alike = np.divide(products, norm, out=np.zeros_like(products), where=norm > 1e-12 * squares[-1])
    # Next to no lag any smooth signal is like itself.
    apart = np.flatnonzero(alike < 0.5)
    first = int(apart[0]) if apart.size else alike.size
    best = float(alike[first:].max(initial=0.0))
    if best < _REPEATS:
        raise DataError(
            f"{where}: does not repeat within half the record (at most {best:.2f} of it does); give period in samples, "
            "or none"
        )
    start = first + int(np.flatnonzero(alike[first:] >= best - _AS_GOOD)[0])
    end = start + int(np.argmax(alike[start:] < best - _AS_GOOD)) if (alike[start:] < best - _AS_GOOD).any() else None
    return start + int(np.argmax(alike[start:end]))


def _channels(data: Experiment, input: str, output: str) -> tuple[float, _Array, _Array]:
    """Samples a second, input and output less their means."""
    u, y = data.input(input), data.output(output)
    rate = even_rate(data.t, u, f"experiment '{data.name}', input '{input}'", "frequency_response")
    even_rate(data.t, y, f"experiment '{data.name}', output '{output}'", "frequency_response")
    if data.n < 8:
        raise DataError(f"experiment '{data.name}': {data.n} samples are too few for a frequency response")
    own = data.signal(input)
    if own is not None and (own[0].size - 1) / (own[0][-1] - own[0][0]) < (1.0 - 1e-6) * rate:
        raise DataError(
            f"experiment '{data.name}', input '{input}': is sampled more coarsely than output '{output}' "
            f"({rate:g} Hz), and interpolation between its samples alters its spectrum: bring both to the lower rate "
            "first"
        )
    return rate, u - u.mean(), y - y.mean()


def _periods(u: _Array, y: _Array, length: int, rate: float, where: str) -> tuple[_Array, _Complex, _Complex]:
    """Frequencies (F,), and the Fourier transforms of the last whole periods of input and output, (periods, F)."""
    count = u.size // length
    if count < 1:
        raise DataError(f"{where}: a period of {length} samples is longer than the record of {u.size}")
    U, Y = (np.fft.rfft(signal[u.size - count * length :].reshape(count, length), axis=1) for signal in (u, y))
    return np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64), U, Y


def _welch(u: _Array, y: _Array, length: int, rate: float) -> tuple[_Array, _Array, _Array, _Complex]:
    from scipy.signal import csd, welch

    options = {"fs": rate, "nperseg": length, "detrend": "constant"}
    f, suu = welch(u, **options)
    return f, suu, welch(y, **options)[1], csd(u, y, **options)[1]


def _independent(n: int, length: int) -> float:
    """Averages of independent segments that are worth as much as these, which overlap by half.

    (P. D. Welch, IEEE Trans. Audio Electroacoustics AU-15(2), 1967.) The Hann window of neighbours has a correlation
    of 1/6.
    """
    count = (n - length // 2) // (length - length // 2)
    return count / (1.0 + 2.0 * (1.0 - 1.0 / count) / 36.0)


def _kernel(width: float, resolution: float, bins: int, name: str) -> _Array:
    """Weights of a Hann window as wide as ``width`` (Hz) at half its height."""
    half = round(width / resolution)
    if half < 2 or 2 * half - 1 > bins:
        raise OptionError(
            f"frequency_response: smoothing over {width:g} Hz is not possible: experiment '{name}' shows {bins} "
            f"frequencies, {resolution:.3g} Hz apart; take at least {2 * resolution:.3g} Hz"
        )
    kernel = np.hanning(2 * half + 1)[1:-1]
    return np.asarray(kernel / kernel.sum())


def _power(transform: _Complex) -> _Array:
    return np.asarray(np.abs(transform) ** 2)


def _ratio(above: _Complex | _Array, below: _Complex | _Array) -> _Complex:
    """Without a warning where there is nothing below: such frequencies are dropped."""
    return np.asarray(above / np.where(below == 0, 1.0, below), dtype=np.complex128)


def _unit(data: Experiment, input: str, output: str) -> str:
    above, below = data.units.get(output, ""), data.units.get(input, "")
    if not above or not below:
        return ""
    return "1" if above == below else f"{above}/({below})" if "/" in below else f"{above}/{below}"
