"""Records for methods that need even sampling: one rate, no gaps, channels scaled to unit size."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment, as_experiments
from ..data.filtering import EVEN, intervals
from ..errors import DataError, OptionError, listing
from .modal_response import Driven

__all__ = ["Sampled", "chosen_outputs"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sampled:
    """Experiments, and of each inputs (m, N) and outputs (p, N) over their sizes ``u_size`` (m,), ``y_size`` (p,).

    Sizes are standard deviations about the mean of each experiment. ``rate`` is that of the samples, Hz.
    """

    runs: Sequence[Experiment]
    inputs: Sequence[str]
    outputs: Sequence[str]
    columns: Sequence[tuple[_Array, _Array]]
    u_size: _Array
    y_size: _Array
    rate: float

    @cached_property
    def driven(self) -> list[Driven]:
        """The experiments prepared for modal responses."""
        return [Driven(run, self.inputs) for run in self.runs]

    @property
    def lengths(self) -> list[int]:
        """Samples of each experiment, N."""
        return [run.n for run in self.runs]

    @classmethod
    def of(
        cls,
        data: Any,
        inputs: str | Sequence[str] | None,
        outputs: str | Sequence[str] | None,
        caller: str = "subspace",
        complete: bool = True,
    ) -> Sampled:
        """Return the experiments with scaled channels. Raises DataError where a channel is missing or never changes, or
        time is uneven; and, with ``complete``, where a sample is missing."""
        runs = as_experiments(data, caller)
        u_names = _names(caller, "inputs", inputs, runs[0])
        y_names = _names(caller, "outputs", outputs, runs[0])
        rate = _rate(caller, runs)
        columns = [_columns(caller, run, u_names, y_names, complete) for run in runs]
        u_size, y_size = (_sizes([pair[k] for pair in columns]) for k in (0, 1))
        for name, size in zip([*u_names, *y_names], [*u_size, *y_size], strict=True):
            if not size > 0.0:
                raise DataError(f"{caller}: '{name}' never changes: leave it out")
        scaled = [(u / u_size[:, None], y / y_size[:, None]) for u, y in columns]
        return cls(runs, u_names, y_names, scaled, u_size, y_size, rate)


def _names(
    caller: str, kind: Literal["inputs", "outputs"], given: str | Sequence[str] | None, run: Experiment
) -> list[str]:
    if given is None:
        names = list(run.inputs if kind == "inputs" else run.outputs)
        if not names:
            raise DataError(
                f"{caller}: experiment '{run.name}' does not say which channels are {kind}: name them, {kind}=..."
            )
        return names
    names = given.replace(",", " ").split() if isinstance(given, str) else list(given)
    if not names or len(set(names)) < len(names):
        raise OptionError(f"{caller}: {kind} names channels, each once, not {given!r}")
    return names


def _rate(caller: str, runs: Sequence[Experiment]) -> float:
    """Return the sampling rate of all experiments, Hz."""
    rates = []
    for run in runs:
        step, steps, uneven = intervals(run.t)
        if uneven.size:
            worst = int(np.argmax(np.abs(steps - step)))
            raise DataError(
                f"{caller}: needs evenly spaced samples, but in experiment '{run.name}' the interval after "
                f"t = {run.t[worst]:g} s is {steps[worst]:g} s and others are {step:g} s: cut the record there with "
                ".window, or resample it"
            )
        rates.append((run.n - 1) / float(run.t[-1] - run.t[0]))
    for run, rate in zip(runs, rates, strict=True):
        if abs(rate - rates[0]) > EVEN * rates[0]:
            raise DataError(
                f"{caller}: needs one sampling rate, but experiment '{runs[0].name}' has {rates[0]:g} Hz and "
                f"'{run.name}' {rate:g} Hz"
            )
    return rates[0]


def _columns(
    caller: str, run: Experiment, inputs: Sequence[str], outputs: Sequence[str], complete: bool
) -> tuple[_Array, _Array]:
    """Return inputs (m, N) and outputs (p, N)."""
    run.check_for(inputs, outputs, outputs)
    for name in outputs if complete else ():
        missing = np.flatnonzero(np.isnan(run.output(name)))
        if missing.size:
            k = int(missing[0])
            raise DataError(
                f"{caller}: experiment '{run.name}', output '{name}': sample {k} (t = {run.t[k]:.6g} s) is missing"
                f"{f' (and {missing.size - 1} more)' if missing.size > 1 else ''}: cut the record there with .window "
                "and give the parts as several experiments, or fill the gap"
            )
    u = np.array([run.input(name) for name in inputs]).reshape(len(inputs), run.n)
    return u, np.array([run.output(name) for name in outputs])


def _sizes(channels: Sequence[_Array]) -> _Array:
    """Return the standard deviation of each channel about the mean of each experiment."""
    squares = [np.nansum((c - np.nanmean(c, axis=1, keepdims=True)) ** 2, axis=1) for c in channels]
    count = np.sum([np.isfinite(c).sum(axis=1) for c in channels], axis=0)
    size = np.sqrt(np.sum(squares, axis=0) / count)
    level = np.max([np.nanmax(np.abs(c), axis=1) for c in channels], axis=0)
    return np.asarray(np.where(size > 1e-13 * level, size, 0.0))


def chosen_outputs(caller: str, feedthrough: bool | Collection[str], outputs: Sequence[str]) -> list[bool]:
    """Return for each output whether inputs act on it directly: on all, or on those named."""
    if isinstance(feedthrough, bool):
        return [feedthrough] * len(outputs)
    chosen = [feedthrough] if isinstance(feedthrough, str) else list(feedthrough)
    for name in chosen:
        if name not in outputs:
            raise OptionError(f"{caller}: feedthrough: '{name}' is no output.{listing(str(name), outputs)}")
    return [name in chosen for name in outputs]
