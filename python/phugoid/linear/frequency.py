"""Frequency responses by one function: of a record (without a model), a fit, a model, or a numeric system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..data.experiment import Experiment
from ..data.filtering import even_rate
from ..errors import DataError, OptionError, positive, whole
from ..fit_result import FitResult
from ..modelling.model import Model
from ..time_unit import time_unit_of
from .linearise import model_response
from .response import FrequencyResponse
from .state_space import StateSpace

__all__ = ["find_period", "frequency_response"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]
Method = Literal["etfe", "h1"]

# A signal repeats with a lag at which its autocorrelation is at least this.
_REPEATS = 0.95
# The period is the first lag with an autocorrelation within this of the best; the others are its multiples.
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
    """Estimate the response of ``output`` to ``input`` from a record; arguments as in `frequency_response`."""
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
        length = find_period(u, where) if period == "auto" else whole("frequency_response: period", period, 2)
        f, U, Y = _periods(u, y, length, rate, where)
        words = f"{'ETFE' if method == 'etfe' else 'H1'}, {len(U)} periods of {length} samples"
        suu, syy, suy = _power(U).mean(axis=0), _power(Y).mean(axis=0), (U.conj() * Y).mean(axis=0)
        response = _ratio(Y.mean(axis=0), U.mean(axis=0)) if method == "etfe" else _ratio(suy, suu)
        averages = float(len(U)) if len(U) > 1 else None
    elif method == "h1":
        length = u.size // 8 if segment is None else whole("frequency_response: segment", segment, 8)
        if not 8 <= length <= u.size:
            raise DataError(f"experiment '{data.name}': {u.size} samples are too few for segments of {length} samples")
        f, suu, syy, suy = _welch(u, y, length, rate)
        response, words = _ratio(suy, suu), f"H1, segments of {length} samples"
        averages = _independent(u.size, length)
    else:
        f, U, Y = _periods(u, y, u.size, rate, where)
        suu, syy, suy, words = _power(U[0]), _power(Y[0]), U[0].conj() * Y[0], "ETFE"
        if smoothing is not None:
            width = positive("frequency_response: smoothing", smoothing)
            kernel = _kernel(width, rate / u.size, f.size, data.name)
            suu, syy, suy = (np.convolve(s, kernel, mode="same") for s in (suu, syy, suy))
            time = time_unit_of(data.units)
            averages, words = (
                float(kernel.sum() ** 2 / (kernel**2).sum()),
                f"ETFE, smoothed over {time.per(f'{width:g}')}",
            )
        response = _ratio(suy, suu)
    kept = (f > 0.0) & (suu > 10.0 ** (floor_db / 10.0) * suu.max(initial=0.0))
    if not kept.any():
        raise DataError(f"{where}: is constant, so that there is no response to it")
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
        time_unit_of(data.units),
    )
    return found if band is None else found.band(*band)


def find_period(values: _Array, where: str = "the signal") -> int:
    """Return the number of samples after which a signal repeats, by its autocorrelation; raise DataError where it does
    not.

    >>> find_period(np.tile([0.0, 1.0, 0.0, -2.0, 0.5], 20))
    5
    """
    n = values.size
    centred = values - values.mean()
    spectrum = np.fft.rfft(centred, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[: n // 2 + 1]
    # Normalised by the overlap, so that a long period counts as much as a short one.
    squares = np.concatenate([[0.0], np.cumsum(centred**2)])
    lags = np.arange(n // 2 + 1)
    norm = np.sqrt(squares[n - lags] * (squares[-1] - squares[lags]))
    alike = np.divide(products, norm, out=np.zeros_like(products), where=norm > 1e-12 * squares[-1])
    # At small lags any smooth signal is correlated with itself.
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
    """Return the sampling rate (Hz), input and output, without their means."""
    u, y = data.input(input), data.output(output)
    rate = even_rate(data.t, u, f"experiment '{data.name}', input '{input}'", "frequency_response")
    even_rate(data.t, y, f"experiment '{data.name}', output '{output}'", "frequency_response")
    if data.n < 8:
        raise DataError(f"experiment '{data.name}': {data.n} samples are too few for a frequency response")
    own = data.signal(input)
    if own is not None and (own[0].size - 1) / (own[0][-1] - own[0][0]) < (1.0 - 1e-6) * rate:
        raise DataError(
            f"experiment '{data.name}', input '{input}': is sampled more coarsely than output '{output}' "
            f"(at a rate of {rate:g}), and interpolation between its samples alters its spectrum: bring both to the "
            "lower rate first"
        )
    return rate, u - u.mean(), y - y.mean()


def _periods(u: _Array, y: _Array, length: int, rate: float, where: str) -> tuple[_Array, _Complex, _Complex]:
    """Return frequencies (F,), and the Fourier transforms of the last whole periods of input and output,
    (periods, F)."""
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
    """Return the number of independent segments that are worth as much as these, which overlap by half.

    (P. D. Welch, IEEE Trans. Audio Electroacoustics AU-15(2), 1967.) The Hann window of neighbours has a correlation
    of 1/6.
    """
    count = (n - length // 2) // (length - length // 2)
    return count / (1.0 + 2.0 * (1.0 - 1.0 / count) / 36.0)


def _kernel(width: float, resolution: float, bins: int, name: str) -> _Array:
    """Return the weights of a Hann window of full width ``width`` (Hz) at half its height."""
    half = round(width / resolution)
    if half < 2 or 2 * half - 1 > bins:
        raise OptionError(
            f"frequency_response: smoothing over {width:g} is not possible: experiment '{name}' shows {bins} "
            f"frequencies, {resolution:.3g} apart; take at least {2 * resolution:.3g}"
        )
    kernel = np.hanning(2 * half + 1)[1:-1]
    return np.asarray(kernel / kernel.sum())


def _power(transform: _Complex) -> _Array:
    return np.asarray(np.abs(transform) ** 2)


def _ratio(above: _Complex | _Array, below: _Complex | _Array) -> _Complex:
    """Divide without a warning where the denominator is zero: such frequencies are dropped."""
    return np.asarray(above / np.where(below == 0, 1.0, below), dtype=np.complex128)


def _unit(data: Experiment, input: str, output: str) -> str:
    above, below = data.units.get(output, ""), data.units.get(input, "")
    if not above or not below:
        return ""
    return "1" if above == below else f"{above}/({below})" if "/" in below else f"{above}/{below}"


@overload
def frequency_response(
    source: Experiment,
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
) -> FrequencyResponse: ...


@overload
def frequency_response(
    source: FitResult | Model | StateSpace,
    frequencies_hz: ArrayLike,
    input: str | None = None,
    output: str | None = None,
    *,
    parameters: Mapping[str, Any] | None = None,
    at: Mapping[str, float] | None = None,
    experiment: str | None = None,
) -> FrequencyResponse: ...


def frequency_response(
    source: Experiment | FitResult | Model | StateSpace, *args: Any, **options: Any
) -> FrequencyResponse:
    """Return the frequency response of a record, or of a fit, a model or a `StateSpace`.

    **Of a record**, ``frequency_response(data, input, output, method="etfe", *, period, smoothing, segment, band,
    floor_db, label)``: how ``output`` responds to ``input``; means are removed first.

    method     ``"etfe"``: ratio of the discrete Fourier transforms of the whole record, at multiples of 1/length. Noisy
               unless smoothed or periodic.
               ``"h1"``: cross-spectrum over the input's spectrum, averages over segments with Hann windows that
               overlap by half (`scipy.signal.csd`, `welch`); with coherence.
    period     samples in which the input repeats (a multisine), or ``"auto"`` to find it: exact, without leakage. The
               last whole periods are used, so that a transient at the start is left out first. ETFE: ratio of the means
               over periods; H1: the cross-spectrum of each, averaged.
    smoothing  Hz, of the ETFE: cross-spectrum and input's spectrum are averaged with a Hann window of this width at
               half its height before they are divided. Resonances narrower than that are flattened.
    segment    samples of a segment of H1; None: an eighth of the record.
    band       ``(low, high)`` in Hz keeps a part.
    floor_db   frequencies where the input's power lies so far below its maximum are left out, since noise dominates the
               ratio there.
    label      for legends; None: the method, in words.

    Averaged spectra give ``coherence`` and ``std_error`` (Bendat and Piersol, table 9.6). These count noise at the
    output as error; noise at the input biases H1 and the smoothed ETFE to low values, not the ETFE over periods, which
    averages it out. In closed loop the result is not the response of the system alone.

    Input and output need complete, evenly spaced samples at the same times. An input that has finer samples of its own
    (``decimate(..., inputs=...)``) is taken at the times of the record, which is right where it holds nothing above
    the Nyquist frequency; one with coarser samples is refused, since interpolation alters its spectrum. Of an input
    that is held between its samples the response is that from sample to sample, with the lag of half an interval that
    holding brings.

    **Of a model**, ``frequency_response(fit, frequencies_hz, input=None, output=None, *, parameters, at,
    experiment)``: C (j 2 pi f - A)^-1 B + D, with its delays.

    frequencies_hz  (F,) in Hz.
    input, output   names; may be left out where there is only one.
    parameters      values by name, of a model; of a fit instead of its own.
    at              states, inputs and time at the point about which it is linearised, by name: of a model that is not
                    linear all that its derivatives depend on.
    experiment      whose parameters to take, where experiments have their own.

    Of a fit with its own parameters ``std_error`` is that of the magnitude, to first order from the covariance of the
    parameters (the delta method); NaN where the data do not determine the response. A `StateSpace` takes the
    frequencies and the names alone.

    Raises, of a record, OptionError for options that make no sense together, and DataError for gaps, uneven sampling, a
    signal that does not repeat, or a record too short; of a model, ModelError for unknown names, values that
    are missing, and a frequency that meets an undamped mode, EvaluationError where a derivative is not finite;
    DataError for a source of another kind.

    >>> lag = StateSpace([[-2.0]], [[2.0]], [[1.0]])
    >>> frequency_response(lag, [0.0]).response
    array([1.+0.j])
    """
    if isinstance(source, Experiment):
        return empirical_response(source, *args, **options)
    if isinstance(source, (FitResult, Model, StateSpace)):
        return model_response(source, *args, **options)
    raise DataError(
        f"frequency_response: the first argument is one Experiment, a Fit, a Model or a StateSpace, not a "
        f"{type(source).__name__}"
    )
