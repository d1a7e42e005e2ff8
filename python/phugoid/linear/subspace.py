"""Identification of linear systems without start values: the subspace method, then least squares for the inputs."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import DataError, OptionError
from .modal_regression import ModalRegression, identified, regression
from .sampled import Observability, Sampled, chosen_outputs, observability
from .state_space import StateSpace, modal_parts

__all__ = ["subspace"]

_Array: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]
Weighting = Literal["cva", "moesp"]

# Block rows that are tried where none are given, in multiples of the order, and at least so many; greatest order that
# is suggested.
_TIMES, _BLOCK_ROWS, _MOST = (2, 3, 4), 20, 40
# Least part of a state that remains after a sample, for the logarithm.
_FASTEST = 0.01
# Damping ratio below which, and part of the Nyquist frequency up to which, a mode is distinguished from a background.
_LIGHT, _BELOW = 0.15, 0.75


def subspace(
    data: Experiment | Sequence[Experiment],
    order: int | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    block_rows: int | None = None,
    feedthrough: bool | Collection[str] = True,
    offset: bool = True,
    weighting: Weighting = "cva",
    stable: bool = False,
    background: bool = False,
    prune: bool = False,
) -> StateSpace:
    """Identify a linear system in continuous time from evenly sampled records, without start values or iterations.

    The states are estimated as the prediction of future outputs from past samples, by an LQ factorisation and a
    singular value decomposition of block Hankel matrices (MOESP: Verhaegen, Automatica 30(1), 1994; canonical variates
    and the weights: Van Overschee and De Moor, Subspace Identification for Linear Systems, Kluwer 1996). Its A and C
    give the modes; their eigenvalues pass to continuous time by the logarithm. B, D, initial states and offsets are
    then those that simulate the outputs best: linear least squares, in which inputs run between samples as each
    experiment says (linear, cubic, or sampled faster than the outputs, as `multirate` has them).

    The result starts an estimation: ``ph.estimate(ph.models.modal(start=ph.linear.subspace(run, 8)), run)``. It has no
    standard errors, and is not the maximum of the likelihood.

    ``data``        one experiment or several, of one sampling rate; they are pooled.
    ``order``       number of states. None: where the singular values fall to the noise level (see ``suggested_order``);
                    look at ``singular_values``, which hold the canonical correlations.
    ``inputs``, ``outputs``  channels to use; all inputs and outputs of the first experiment unless given.
    ``block_rows``  samples of past, and of future, that are compared. More of them separate close and lightly damped
                    modes better, at the price of noise and of time, which grows with their square. None: two, three and
                    four times the order (and at least 20) as far as the records are long enough; the system that
                    simulates the outputs best is kept.
    ``feedthrough`` whether inputs act on outputs directly: on all, or on those named.
    ``offset``      a constant in each output of each experiment, such as a sensor's bias or the trim.
    ``weighting``   ``"cva"`` (canonical variates) weights a direction by how well it is predicted, so that units and
                    sizes of outputs do not matter; ``"moesp"`` weights it by its part of the outputs.
    ``stable``      reflects growing modes into decaying ones, exp(lambda T) -> 1 / conj exp(lambda T), before B is
                    found.
    ``background``  a record determines little but the sum of the modes that are damped by more than 0.15 of critical,
                    or lie near the Nyquist frequency. True replaces them by as many heavily damped pairs, spread over
                    the band of the other modes, one after the other where it simulates the output best: the start of a
                    model of oscillators only. For one output.
    ``prune``       removes, one after another, modes without which the sum of squares grows by less than BIC allows for
                    their parameters, since they fit noise. The order is then lower. For the start of an estimation, in
                    which such modes would drift without any effect.

    In closed loop the estimate is biased, as noise then reaches the inputs.

    Raises DataError for missing channels, uneven sampling, missing samples, and records that are too short;
    OptionError for an order, or other options, out of range.
    """
    records = Sampled.of(data, inputs, outputs)
    direct = chosen_outputs("subspace", feedthrough, records.outputs)
    if weighting not in get_args(Weighting):
        raise OptionError(f'subspace: weighting is "cva" or "moesp", not {weighting!r}')
    _whole("order", order)
    _whole("block_rows", block_rows)
    if order is None:
        # From as much past as any order needs.
        rows = [block_rows] if block_rows else _block_rows(_MOST // 2, records, at_most=True)
        order = _suggested(_observability(records, rows[-1], weighting), records)
    best: _Tried | None = None
    for i in [block_rows] if block_rows else _block_rows(order, records):
        tried = _tried(records, i, order, direct, offset, weighting, (stable, prune))
        if best is None or tried.misfit < best.misfit:
            best = tried
    assert best is not None
    if background:
        best = _with_background(records, best, direct, offset)
    return identified(
        records,
        best.values,
        best.C,
        best.regression,
        singular_values=best.shared.singular_values,
        suggested_order=_suggested(best.shared, records),
        warnings=best.warnings,
    )


@dataclass(frozen=True)
class _Tried:
    """The result with one number of block rows: eigenvalues (r,) in 1/s, one of each pair; their C (p, r), complex; the
    rest."""

    shared: Observability
    values: _Complex
    C: _Complex
    warnings: tuple[str, ...]
    regression: ModalRegression

    @property
    def misfit(self) -> float:
        """Half the logarithm of the determinant of the residuals' covariance, were they uncorrelated."""
        return float(np.sum(np.log(np.maximum(self.regression.rms, np.finfo(np.float64).tiny))))


def _tried(
    records: Sampled,
    i: int,
    n: int,
    direct: Sequence[bool],
    offset: bool,
    weighting: str,
    chosen: tuple[bool, bool],
) -> _Tried:
    stable, prune = chosen
    p = len(records.outputs)
    if n > p * (i - 1):
        raise OptionError(
            f"subspace: order {n} is too high for {i} block rows, which hold {p * (i - 1)} states of {p} outputs: "
            f"lower the order, or give block_rows={-(-n // p) + 1} or more"
        )
    shared = _observability(records, i, weighting)
    A, C = shared.system(n, p)
    values, seen, warnings = _continuous(A, C * records.y_size[:, None], records.rate, stable)
    while True:
        found = regression(
            [driven.answers(values) for driven in records.driven], seen, records.outputs, direct, offset, gains=prune
        )
        if not prune or values.size == 1:
            break
        worst = int(np.argmin(found.gains))
        # Parameters of a mode: eigenvalue, initial states, row of B, and a column of C.
        numbers = (2 if values[worst].imag else 1) * (len(records.runs) + len(records.inputs) + p)
        if found.gains[worst] > numbers * np.log(sum(records.lengths)):
            break
        values, seen = np.delete(values, worst), np.delete(seen, worst, axis=1)
    return _Tried(shared, values, seen, warnings, found)


def _observability(records: Sampled, i: int, weighting: str) -> Observability:
    """Return the observability matrix; raise DataError for too few columns for i block rows."""
    if not _enough(records, i):
        lengths, channels = records.lengths, len(records.inputs) + len(records.outputs)
        least = min(range(len(lengths)), key=lengths.__getitem__)
        raise DataError(
            f"subspace: {sum(lengths)} samples are too few for {i} block rows of {channels} channels, which need "
            f"{2 * i * channels + (2 * i - 1) * len(lengths)} in all, and {2 * i} in each experiment "
            f"('{records.runs[least].name}' has {lengths[least]}): take fewer block_rows, a lower order, or more data"
        )
    return observability(records.columns, i, weighting)


def _enough(records: Sampled, i: int) -> bool:
    """Return whether the Hankel matrices have more columns than rows."""
    channels = len(records.inputs) + len(records.outputs)
    return min(records.lengths) >= 2 * i and sum(n - 2 * i + 1 for n in records.lengths) >= 2 * i * channels


def _block_rows(order: int, records: Sampled, at_most: bool = False) -> list[int]:
    """Return the numbers of block rows to try: enough for the states and the shift, as far as the records allow.

    ``at_most``: the order may be lower.
    """
    least = 2 if at_most else max(2, -(-order // len(records.outputs)) + 1)
    found = set()
    for times in _TIMES:
        i = max(least, times * order, _BLOCK_ROWS)
        while i > least and not _enough(records, i):
            i -= 1
        found.add(i)
    return sorted(found)


def _continuous(A: _Array, C: _Array, rate: float, stable: bool) -> tuple[_Complex, _Complex, tuple[str, ...]]:
    """Return eigenvalues in 1/s, one of each pair, and their columns of C, of a discrete A and C."""
    parts = modal_parts(A, np.zeros((A.shape[0], 1)), C)
    z = parts.values
    warnings = []
    # A real eigenvalue from minus infinity to 0 is that of no real continuous system.
    lost = (z.imag == 0.0) & (z.real <= 0.0)
    if lost.any():
        warnings.append(
            f"{int(lost.sum())} of {A.shape[0]} states alternate from sample to sample, which no state does in "
            "continuous time; modes near half the sampling rate replace them: the order may be too high"
        )
    size = np.abs(z)
    if stable:
        z = np.where(size > 1.0, z / size**2, z)
    elif np.any(size > 1.0):
        count = int(np.sum(size > 1.0))
        warnings.append(f"{count} mode{'s' if count > 1 else ''} grow{'' if count > 1 else 's'} with time")
    values, seen = np.log(z[~lost]) * rate, parts.outputs[:, ~lost]
    decay = np.log(np.maximum(size[lost], _FASTEST)) * rate
    c = parts.outputs[:, lost]
    for k in range(0, decay.size - 1, 2):
        # All eigenvalues must differ.
        values = np.append(values, decay[k : k + 2].mean() + 1j * np.pi * rate * (1.0 + 0.05 * k))
        seen = np.column_stack([seen, c[:, k] + 1j * c[:, k + 1]])
    if decay.size % 2:
        values = np.append(values, -np.pi * rate)
        seen = np.column_stack([seen, c[:, -1]])
    return values, seen, tuple(warnings)


def _with_background(records: Sampled, tried: _Tried, direct: Sequence[bool], offset: bool) -> _Tried:
    """Return the lightly damped modes, and pairs in place of all others, each where the sum of squares falls most."""
    if len(records.outputs) > 1:
        raise OptionError("subspace: background=True is for one output; the residues of more are not of one rank")
    size = np.abs(tried.values)
    light = (tried.values.imag > 0.0) & (-tried.values.real < _LIGHT * size) & (size < _BELOW * np.pi * records.rate)
    states = int(np.sum(1 + (tried.values.imag > 0.0)))
    values, found = tried.values[light], tried.regression
    if not values.size:
        return tried
    grid = np.geomspace(0.8 * size[light].min(), 1.15 * size[light].max(), 6)
    places = [w * (-z + 1j * np.sqrt(1.0 - z * z)) for w in grid for z in (0.5, 0.8)]
    for _ in range((states - 2 * values.size) // 2):
        best = None
        for place in places:
            if np.any(values == place):
                continue
            more = np.append(values, place)
            seen = np.ones((1, more.size), dtype=np.complex128)
            here = regression(
                [driven.answers(more) for driven in records.driven], seen, records.outputs, direct, offset
            )
            if best is None or here.rms[0] < best[1].rms[0]:
                best = more, here
        if best is None:
            break
        values, found = best
    seen = np.ones((1, values.size), dtype=np.complex128)
    return _Tried(tried.shared, values, seen, tried.warnings, found)


def _suggested(shared: Observability, records: Sampled) -> int:
    """Return the order with the least s_{n+1}^2 + d(n) log(T) / T; d(n) = n (2 p + m) parameters for n more states.

    (D. Bauer, Order estimation for subspace methods, Automatica 37(10), 2001: SVC.)
    """
    each, T = 2 * len(records.outputs) + len(records.inputs), sum(records.lengths)
    # One block row is for the shift.
    most = min(_MOST, shared.singular_values.size - len(records.outputs))
    s2 = shared.singular_values[: most + 1] ** 2
    n = np.arange(1, s2.size)
    return int(n[np.argmin(s2[1:] + n * each * np.log(T) / T)]) if n.size else 1


def _whole(what: str, value: int | None) -> None:
    if value is not None and (not isinstance(value, Integral) or isinstance(value, bool) or value < 1):
        raise OptionError(f"subspace: {what} is a whole number from 1, or None to choose it, not {value!r}")
