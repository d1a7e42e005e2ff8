"""Frequency responses, asked for alike: of a record, a fit, a model, a numeric system."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, overload

from numpy.typing import ArrayLike

from ..data.experiment import Experiment
from ..errors import DataError
from ..fit_result import FitResult
from ..modelling.model import Model
from .empirical import Method, empirical_response
from .linearise import model_response
from .response import FrequencyResponse
from .state_space import StateSpace

__all__ = ["frequency_response"]


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
    """The frequency response that a record shows, or that of a fit, a model or a `StateSpace`.

    **Of a record**, ``frequency_response(data, input, output, method="etfe", *, period, smoothing, segment, band,
    floor_db, label)``: how ``output`` responds to ``input``; means are removed first.

    method     ``"etfe"``: ratio of the discrete Fourier transforms of the whole record, at multiples of 1/length. Noisy
               unless smoothed or periodic.
               ``"h1"``: cross-spectrum over the input's spectrum, averages over segments with Hann windows that
               overlap by half (`scipy.signal.csd`, `welch`); with coherence.
    period     samples in which the input repeats (a multisine), or ``"auto"`` to find it: exact, without leakage. The
               last whole periods are used, so that a transient at the start is the first thing to go. ETFE: ratio of
               the means over periods; H1: the cross-spectrum of each, averaged.
    smoothing  Hz, of the ETFE: cross-spectrum and input's spectrum are averaged with a Hann window of this width at
               half its height before they are divided. Resonances narrower than that are flattened.
    segment    samples of a segment of H1; None: an eighth of the record.
    band       ``(low, high)`` in Hz keeps a part.
    floor_db   frequencies where the input's power lies so far below its maximum are left out: a ratio of next to
               nothing says nothing.
    label      for legends; None: the method, in words.

    Where spectra were averaged, ``coherence`` and ``std_error`` are there (Bendat and Piersol, table 9.6). These count
    noise at the output as error; noise at the input biases H1 and the smoothed ETFE to low values, not the ETFE over
    periods, which averages it away. In closed loop the result is not the response of the system alone.

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
    signal that does not repeat, or a record too short; of a model, ModelError for names that are not there, values that
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
