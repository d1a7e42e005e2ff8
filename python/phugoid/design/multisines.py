"""Orthogonal multisines, and the power spectrum of inputs beside the modes of a system.

u(t) = sum over k of A_k sin(2 pi k t/T + phi_k), with whole k, so that each input fills the period T with whole cycles;
two inputs with different harmonics are orthogonal over T, so their effects can be separated although they act together.
(E. A. Morelli, Flight test maneuvers for efficient aerodynamic modeling, J. Aircraft 49(6), 2012. Start of the phases:
M. R. Schroeder, Synthesis of low-peak-factor signals, IEEE Trans. Inf. Theory 16, 1970.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, did_you_mean
from ..linear.state_space import Mode
from .steps import grid, number, pair, placed

__all__ = ["multisine", "multisines", "peak_factor", "spectrum", "step_width"]

_Array = NDArray[np.float64]
_Kind: TypeAlias = Literal["doublet", "3-2-1-1", "pulse"]

# Numbers of one block of frequencies times samples.
_BLOCK = 1_000_000


def spectrum(t: ArrayLike, u: ArrayLike, frequency_hz: ArrayLike | None = None) -> tuple[_Array, _Array]:
    """Return frequencies (Hz) and the energy spectrum |U(f)|^2, U(f) = integral of u exp(-2 pi j f t) dt, unit²·s².

    ``u`` (N,), linear between the samples, as an experiment's inputs are: the integral is exact. ``frequency_hz`` (M,):
    400 from 0 to half the sampling rate, equally spaced, unless given. Subtract the trim first, if there is one.

    >>> f, energy = spectrum([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], [0.0, 0.5])
    >>> energy.round(4)
    array([1.    , 0.1643])
    """
    times = grid("spectrum", t)
    values = np.asarray(u, dtype=np.float64)
    if values.shape != times.shape or not np.isfinite(values).all():
        raise OptionError(f"spectrum: u holds a finite value for each of the {times.size} times")
    if frequency_hz is None:
        f = np.linspace(0.0, 0.5 / float(np.median(np.diff(times))), 400)
    else:
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
    if f.ndim != 1 or not np.isfinite(f).all() or (f < 0.0).any():
        raise OptionError("spectrum: frequency_hz holds frequencies in Hz, from 0")
    step = np.diff(times)
    middle, mean, half = 0.5 * (times[1:] + times[:-1]), 0.5 * (values[1:] + values[:-1]), 0.5 * np.diff(values)
    found = np.empty(f.size)
    each = max(_BLOCK // times.size, 1)
    for begin in range(0, f.size, each):
        omega = 2.0 * np.pi * f[begin : begin + each, None]
        x = 0.5 * omega * step
        # Over one interval: of the mean sin(x)/x, of the slope -j (sin x - x cos x)/x^2, by its series for small x.
        small = np.abs(x) < 1e-3
        safe = np.where(small, 1.0, x)
        slope = np.where(small, x / 3.0, (np.sin(safe) - safe * np.cos(safe)) / safe**2)
        parts = step * np.exp(-1j * omega * middle) * (mean * np.sinc(x / np.pi) - 1j * half * slope)
        found[begin : begin + each] = np.abs(parts.sum(axis=1)) ** 2
    return f, found


def step_width(mode: Mode | float, kind: _Kind = "3-2-1-1") -> float:
    """Return the length of a step of length 1 (s) with which a pattern excites a mode.

    ``mode``: one of `phugoid.linear.modes`, or its natural frequency in Hz.

    "doublet"   its spectrum, 4 sin²(ωT/2)/ω, is highest at the mode: T = 2.331/ω_n = 0.371/f_n.
    "3-2-1-1"   the step of length 2 is half a period of the mode: T = π/(2 ω_n) = 0.25/f_n. The energy at the mode is
                then 0.78 of the greatest (0.99 where it is balanced), and above a quarter of it up to 1.8 f_n.
    "pulse"     half a period, 0.5/f_n: most energy there, 4 sin²(ωT/2)/ω², that a pulse of this height can have.

    (See Jategaonkar, ch. 2, and Klein and Morelli, ch. 9, for such rules; the numbers here are those of the spectra.)

    >>> round(step_width(0.5, "doublet"), 3)
    0.742
    """
    if kind not in get_args(_Kind):
        hint = did_you_mean(str(kind), get_args(_Kind))
        raise OptionError(f"step_width: kind is one of {', '.join(get_args(_Kind))}, not {kind!r}.{hint}")
    if isinstance(mode, Mode):
        if not mode.oscillates:
            raise OptionError("step_width: this mode does not oscillate: give the frequency that is to be excited")
        frequency = number("step_width", "the mode's frequency", mode.frequency.value, positive=True)
    else:
        frequency = number("step_width", "mode (a Mode, or its frequency)", mode, positive=True)
    return {"doublet": 0.3710, "3-2-1-1": 0.25, "pulse": 0.5}[kind] / frequency


Phases: TypeAlias = Literal["optimised", "schroeder", "random"]
Power: TypeAlias = Callable[[float], float] | Sequence[float]

# Points a period of the highest harmonic, where peaks are looked for, and where norms are taken.
_FINE, _COARSE = 16, 10
# The peak is the limit of these norms, each from the optimum of the one before.
_NORMS = (4, 8, 16, 32, 64)


def multisine(
    t: ArrayLike,
    amplitude: float,
    *,
    band: tuple[float, float] | None = None,
    harmonics: Sequence[int] | None = None,
    power: Power | None = None,
    start: float | None = None,
    period: float | None = None,
    phases: Phases = "optimised",
    seed: int = 0,
) -> _Array:
    """Return a multisine on one input, (N,); see `multisines`."""
    chosen = None if harmonics is None else {"input": harmonics}
    options = {"start": start, "period": period, "phases": phases, "seed": seed}
    return _made("multisine", t, {"input": amplitude}, band, chosen, power, **options)["input"]  # type: ignore[arg-type]


def multisines(
    t: ArrayLike,
    amplitudes: Mapping[str, float],
    *,
    band: tuple[float, float] | None = None,
    harmonics: Mapping[str, Sequence[int]] | None = None,
    power: Power | None = None,
    start: float | None = None,
    period: float | None = None,
    phases: Phases = "optimised",
    seed: int = 0,
) -> dict[str, _Array]:
    """Return orthogonal multisines on several inputs at once: name -> (N,).

    t           (N,) times, s.
    amplitudes  input -> greatest deflection, in its unit.
    band        (lowest, highest) frequency, Hz. The harmonics of 1/period in it are dealt out to the inputs in turn, so
                that each spans the band.
    harmonics   input -> its whole multiples of 1/period, instead of a band.
    power       of the harmonics, which is the same for all unless given: a function of frequency in Hz, or, with
                ``harmonics`` and one input, one number each.
    start       s; the first time unless given. The signal is 0 at its beginning and end.
    period      T, s; all that is left of the times unless given. It is repeated as often as it fits whole.
    phases      "optimised": lowest peaks for the power (norms of growing order are minimised from Schroeder's phases,
                and from a few at random); "schroeder"; "random", for noise limited to a band.
    seed        of random phases.

    Raises OptionError where the band holds fewer harmonics than inputs, goes beyond half the sampling rate, or where a
    harmonic is given to two inputs.

    >>> import numpy as np
    >>> t = np.arange(0.0, 20.0, 0.02)
    >>> u = multisines(t, {"de": 0.05, "da": 0.1}, band=(0.1, 1.5), period=19.9, phases="schroeder")
    >>> {name: round(float(abs(v).max()), 3) for name, v in u.items()}
    {'de': 0.05, 'da': 0.1}
    """
    options = {"start": start, "period": period, "phases": phases, "seed": seed}
    return _made("multisines", t, amplitudes, band, harmonics, power, **options)  # type: ignore[arg-type]


def peak_factor(u: ArrayLike) -> float:
    """Return the relative peak factor (max - min)/(2 sqrt(2) rms) of a signal about its mean: 1 for a sine; a lower one
    needs smaller deflections for the same power. (Klein and Morelli, ch. 9.)

    >>> round(peak_factor([0.0, 1.0, 0.0, -1.0]), 6)
    1.0
    """
    values = np.asarray(u, dtype=np.float64)
    rms = float(np.std(values)) if values.size else 0.0
    if not rms > 0.0:
        raise OptionError("peak_factor: u does not move")
    return float(np.ptp(values) / (np.sqrt(8.0) * rms))


def _made(
    caller: str,
    t: ArrayLike,
    amplitudes: Mapping[str, float],
    band: tuple[float, float] | None,
    harmonics: Mapping[str, Sequence[int]] | None,
    power: Power | None,
    *,
    start: float | None,
    period: float | None,
    phases: Phases,
    seed: int,
) -> dict[str, _Array]:
    times = grid(caller, t)
    if not isinstance(amplitudes, Mapping) or not amplitudes:
        raise OptionError(f"{caller}: amplitudes gives the amplitude of each input, as in {{'de': 0.05, 'da': 0.1}}")
    sizes = {str(n): number(caller, f"the amplitude of {n}", a) for n, a in amplitudes.items()}
    if phases not in get_args(Phases):
        hint = did_you_mean(str(phases), get_args(Phases))
        raise OptionError(f"{caller}: phases is one of {', '.join(get_args(Phases))}, not {phases!r}.{hint}")
    begin = float(times[0]) if start is None else number(caller, "start", start)
    placed(caller, times, begin, None)
    length = times[-1] - begin if period is None else number(caller, "period", period, positive=True)
    placed(caller, times, begin, begin + length)
    assigned = _assigned_harmonics(caller, list(sizes), band, harmonics, float(length))
    highest = max(map(max, assigned.values())) / length
    if highest > 0.5 / np.diff(times).max():
        raise OptionError(
            f"{caller}: {highest:g} is above half the sampling rate ({0.5 / np.diff(times).max():g}); "
            "take 5 samples a period at least"
        )
    rng = np.random.default_rng(seed)
    whole = np.floor((times[-1] - begin) / length * (1.0 + 1e-12))
    active = (times >= begin) & (times <= begin + whole * length * (1.0 + 1e-12))
    made = {}
    for name, k in assigned.items():
        amplitude = np.sqrt(_powers(caller, power, k, float(length), single=len(assigned) == 1))
        phase = _at_zero(k, amplitude, _phases(k, amplitude, phases, rng))
        u = _signal(k, amplitude, phase, (times - begin) / length)
        peak = max(np.abs(_signal(k, amplitude, phase, _fine(k))).max(), np.abs(u).max())
        made[name] = np.asarray(np.where(active, sizes[name] / peak * u, 0.0))
    return made


def _assigned_harmonics(
    caller: str,
    names: Sequence[str],
    band: tuple[float, float] | None,
    harmonics: Mapping[str, Sequence[int]] | None,
    period: float,
) -> dict[str, NDArray[np.int64]]:
    """Return the harmonics of each input."""
    if (band is None) == (harmonics is None):
        raise OptionError(f"{caller}: give the band, or the harmonics: one of the two")
    if band is not None:
        low, high = pair(caller, "band", band)
        slack = 1e-9
        all_k = np.arange(int(np.ceil(low * period - slack)), int(np.floor(high * period + slack)) + 1)
        if all_k.size < len(names):
            raise OptionError(
                f"{caller}: the band {low:g} to {high:g} holds {all_k.size} harmonics of 1/{period:g} for "
                f"{len(names)} input(s): give a longer period, or a broader band"
            )
        return {n: all_k[i :: len(names)] for i, n in enumerate(names)}
    assert harmonics is not None
    if {*harmonics} != {*names}:
        raise OptionError(f"{caller}: harmonics are to be given for each of {', '.join(names)}")
    found = {}
    for n in names:
        k = np.asarray(harmonics[n])
        if k.ndim != 1 or not k.size or k.dtype.kind not in "iu" or (k < 1).any() or np.unique(k).size < k.size:
            raise OptionError(f"{caller}: harmonics of {n} are whole numbers from 1, each once, not {harmonics[n]!r}")
        found[n] = k.astype(np.int64)
    every = np.concatenate(list(found.values()))
    if np.unique(every).size < every.size:
        twice = next(k for k in every.tolist() if (every == k).sum() > 1)
        raise OptionError(
            f"{caller}: harmonic {twice} is given to two inputs: their effects could not be distinguished"
        )
    return found


def _powers(caller: str, power: Power | None, k: NDArray[np.int64], period: float, single: bool) -> _Array:
    """Return the powers of the harmonics, normalised to the sum 1."""
    if power is None:
        p = np.ones(k.size)
    elif callable(power):
        p = np.array([float(power(f)) for f in (k / period).tolist()])
    elif single and len(power) == k.size:
        p = np.array([float(v) for v in power])
    else:
        raise OptionError(f"{caller}: power is a function of the frequency, or one number for each harmonic")
    if not np.isfinite(p).all() or (p < 0.0).any() or not p.sum() > 0.0:
        raise OptionError(f"{caller}: power is not negative, and not 0 throughout")
    return np.asarray(p / p.sum())


def _phases(k: NDArray[np.int64], amplitude: _Array, kind: Phases, rng: np.random.Generator) -> _Array:
    # Schroeder: phi_n = phi_1 - 2 pi sum over l < n of (n - l) p_l.
    p = amplitude**2
    schroeder = -2.0 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(p))[:-1]])
    if kind == "random":
        return rng.uniform(0.0, 2.0 * np.pi, k.size)
    if kind == "schroeder" or k.size == 1:
        return np.asarray(schroeder)
    starts = [schroeder, *(rng.uniform(0.0, 2.0 * np.pi, k.size) for _ in range(3))]
    found = [_lowest_peak(k, amplitude, s) for s in starts]
    return min(found, key=lambda phase: float(np.ptp(_signal(k, amplitude, phase, _fine(k)))))


def _lowest_peak(k: NDArray[np.int64], amplitude: _Array, phase: _Array) -> _Array:
    from scipy.optimize import minimize

    angle = 2.0 * np.pi * np.outer(_fine(k, _COARSE), k)

    def size(x: _Array, norm: int) -> tuple[float, _Array]:
        """Return the logarithm of the norm, and its gradient."""
        u = np.sin(angle + x) @ amplitude
        top = np.abs(u).max()
        powers = (u / top) ** norm
        total = powers.sum()
        weights = (u / top) ** (norm - 1) / (top * total)
        return float(np.log(top) + np.log(total) / norm), amplitude * (weights @ np.cos(angle + x))

    for norm in _NORMS:
        phase = minimize(size, phase, args=(norm,), jac=True, method="L-BFGS-B", options={"maxiter": 200}).x
    return np.asarray(phase)


def _at_zero(k: NDArray[np.int64], amplitude: _Array, phase: _Array) -> _Array:
    """Return the phases of the same signal shifted in time, so that it begins at an upward zero crossing."""
    from scipy.optimize import brentq

    fine = np.append(_fine(k), 1.0)
    u = _signal(k, amplitude, phase, fine)
    rising = np.flatnonzero((u[:-1] <= 0.0) & (u[1:] > 0.0))
    # The gentlest of the crossings: the input begins without a jerk.
    i = rising[np.argmin((u[1:] - u[:-1])[rising])]
    if u[i] == 0.0:
        shift = fine[i]
    else:
        shift = brentq(lambda x: float(_signal(k, amplitude, phase, np.array([x]))[0]), fine[i], fine[i + 1])
    return np.asarray(phase + 2.0 * np.pi * k * shift)


def _fine(k: NDArray[np.int64], points: int = _FINE) -> _Array:
    """Return points in a period, as parts of it, ``points`` for a cycle of the highest harmonic."""
    n = points * int(k.max())
    return np.arange(n) / n


def _signal(k: NDArray[np.int64], amplitude: _Array, phase: _Array, parts: _Array) -> _Array:
    return np.asarray(np.sin(2.0 * np.pi * np.outer(parts, k) + phase) @ amplitude)
