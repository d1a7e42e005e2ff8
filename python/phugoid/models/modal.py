"""The modal form: a sum of oscillators and lags, for structural dynamics."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from .._core import Expr
from ..errors import OptionError
from ..linear.state_space import ModalParts, StateSpace, as_state_space, modal_parts
from ..modelling.model import Model
from ..parameters import Parameter
from .general import add_feedthrough, add_outputs, channels_of, counted

__all__ = ["modal"]

Scale: TypeAlias = Literal["fixed", "free"]

# Without start values a mode has this damping ratio: it decays, and is still visible.
_DAMPING = 0.02


def modal(
    n_modes: int | None = None,
    inputs: str | Sequence[str] | None = None,
    outputs: str | Sequence[str] | None = None,
    *,
    n_real: int | None = None,
    start: StateSpace | Sequence[Any] | None = None,
    frequencies_hz: Sequence[float] | None = None,
    feedthrough: bool | Collection[str] | None = None,
    scale: Scale = "fixed",
    bias: bool = False,
    stable: bool = False,
    name: str = "modal form",
) -> Model:
    """Return a sum of ``n_modes`` oscillators (and ``n_real`` lags), in the real modal form of the paper's ground
    vibration test:

        x_1a' =  sigma_1 x_1a + omega_1 x_1b + b_1 u        y = c_1a x_1a + c_1b x_1b + ... + d u
        x_1b' = -omega_1 x_1a + sigma_1 x_1b                poles sigma_1 ± j omega_1

    Parameters are ``sigma_1`` (1/s), ``omega_1`` (rad/s), ``b_1``, ``c_1a``, ``c_1b``, and so on; with several outputs
    ``c_<output>_1a``; with several inputs, which may each act with a phase of its own, ``b_1a_<input>`` and
    ``b_1b_<input>``. A lag x_r1' = sigma_r1 x_r1 + b_r1 u adds c_r1 x_r1. States of the first sample are free.

    ``inputs``, ``outputs``  names of the channels, in one text or several; ``"u"`` and ``"y"``, or those of ``start``.
    ``start``        a numeric system with distinct eigenvalues, a `StateSpace` or (A, B, C[, D]): all parameters start
                     at the values that give its transfer function, and n_modes and n_real follow from it.
    ``frequencies_hz``  without ``start``: where the modes start, with a damping ratio of 0.02; else at 1, 2, ... Hz.
    ``feedthrough``  adds ``d`` (``d_<output>_<input>``) to all outputs, or to those named: an accelerometer on a
                     structure that a force acts on directly. None: where ``start`` has it.
    ``scale``        b and c of a mode enter as products only: b may double where c halves, and with several inputs the
                     phase of a mode is free too. ``"fixed"`` fixes b of one input at 1 (and 0 in the second equation),
                     so that c_1a and c_1b are the residue of the mode: nothing is redundant, and standard errors of all
                     parameters exist. The fixed input is the one that excites the mode most at ``start``, else the
                     first; a mode that this input does not excite has no such form. ``"free"`` is the form of the
                     paper: b is a parameter, the fit warns that b and c cannot be distinguished, has no standard
                     errors of them, and agrees in all quantities that do not depend on the scale.
    ``bias``         adds ``bias_<output>``, a constant of each experiment.
    ``stable``       bounds every sigma at 0, so that no mode grows; a growing mode of ``start`` is reflected. A mode
                     that represents all resonances above the band may end at the bound, without damping; neither it nor
                     its standard errors have a meaning of their own then.

    Two modes that are exchanged give the same model, so their starts must differ: equal ones would stay equal.

    Raises ModelError for a ``start`` that does not fit, OptionError for other options.

    >>> m = modal(2, "force", "accelerometer", feedthrough=True)
    >>> print(m)
    modal form
      x_1a' = sigma_1*x_1a + omega_1*x_1b + b_1*force
      x_1b' = sigma_1*x_1b - omega_1*x_1a
      x_2a' = sigma_2*x_2a + omega_2*x_2b + b_2*force
      x_2b' = sigma_2*x_2b - omega_2*x_2a
      accelerometer (measured) = c_1a*x_1a + c_1b*x_1b + c_2a*x_2a + c_2b*x_2b + d*force
    """
    if scale not in get_args(Scale):
        raise OptionError(f'modal: scale is "fixed" or "free", not {scale!r}')
    system = None if start is None else as_state_space("modal", start)
    u, y = channels_of("modal", inputs, outputs, system)
    first = _Start(system, scale) if system is not None else None
    modes = counted("n_modes", n_modes, first.pairs if first else None)
    reals = counted("n_real", n_real, first.reals if first else None, unless=0)
    if not modes + reals:
        raise OptionError("modal: n_modes says how many modes there are: at least 1, or n_real")
    if first is None:
        first = _Default(modes, reals, len(u), len(y), frequencies_hz)
    elif frequencies_hz is not None:
        raise OptionError("modal: give start or frequencies_hz, not both")

    labels = [f"{k + 1}" if k < modes else f"r{k - modes + 1}" for k in range(modes + reals)]
    for output in {*y}.intersection(labels):
        raise OptionError(f"modal: an output cannot be called '{output}': sigma_{output} is the damping of a mode")
    m = Model(name)
    for k, label in enumerate(labels):
        m.states(*([f"x_{label}a", f"x_{label}b"] if k < modes else [f"x_{label}"]))
    force = m.inputs(*u)
    parts: list[list[Expr | float]] = [[] for _ in y]
    form = _Form(m, first, force, y, scale, stable, parts)
    for k, label in enumerate(labels):
        (form.oscillator if k < modes else form.lag)(k, label)
    add_feedthrough(m, "modal", feedthrough, system, force, y, parts)
    add_outputs(m, y, parts, bias)
    return m


class _Start:
    """Start values of the modal form from a numeric system: of each mode the pole, b (m,) and c (p,), complex.

    With xi = x_a + j x_b the two equations of a mode are xi' = (sigma - j omega) xi + b u, and its part of the output
    is Re((c_a - j c_b) xi).
    """

    def __init__(self, system: StateSpace, scale: Scale) -> None:
        parts: ModalParts = modal_parts(system.A, system.B, system.C)
        order = np.argsort(~parts.paired, kind="stable")  # oscillators first
        self.pairs, self.reals = int(parts.paired.sum()), int((~parts.paired).sum())
        # The pole with the negative imaginary part is the conjugate one.
        self.pole = parts.values[order]
        self.b = parts.inputs[order].conj()
        self.c = parts.outputs.T[order].conj()
        self.held = [int(np.argmax(np.abs(b))) for b in self.b]
        for k, b in enumerate(self.b):
            by = b[self.held[k]]
            if by == 0.0:  # no input excites it, so that no output shows it
                self.b[k, self.held[k]] = by = 1.0
                self.c[k] = 0.0
            factor = 1.0 / by
            if scale == "free":  # b and c as large as each other
                size = np.sqrt(np.abs(self.c[k]).max() * np.abs(by))
                factor *= size or 1.0
            self.b[k] *= factor
            self.c[k] /= factor


class _Default(_Start):
    """Start values without a system: poles at given or evenly spaced frequencies; b and c are 1, as in the paper."""

    def __init__(self, modes: int, reals: int, m: int, p: int, frequencies_hz: Sequence[float] | None) -> None:
        if frequencies_hz is None:
            frequencies_hz = range(1, modes + 1)
        f = np.asarray(frequencies_hz, dtype=np.float64)
        if f.shape != (modes,) or not np.all(f > 0) or not np.isfinite(f).all():
            raise OptionError(
                f"modal: frequencies_hz holds a positive number for each of {modes} modes, not {frequencies_hz!r}"
            )
        omega = 2.0 * np.pi * f
        lags = -np.arange(1.0, reals + 1.0)
        self.pairs, self.reals = modes, reals
        self.pole = np.concatenate([(-_DAMPING + 1j * np.sqrt(1 - _DAMPING**2)) * omega, lags])
        self.b = np.ones((modes + reals, m), dtype=np.complex128)
        self.c = (
            np.ones((modes + reals, p), dtype=np.complex128)
            * np.where(np.arange(modes + reals) < modes, 1 - 1j, 1)[:, None]
        )
        self.held = [0] * (modes + reals)


@dataclass(frozen=True)
class _Form:
    """The parts that add the equations of modes to a model, and their contributions to the outputs, ``parts``."""

    model: Model
    start: _Start
    force: Sequence[Expr]
    outputs: Sequence[str]
    scale: Scale
    stable: bool
    parts: list[list[Expr | float]]

    def oscillator(self, k: int, label: str) -> None:
        m, (b_start, c_start) = self.model, (self.start.b[k], self.start.c[k])
        xa, xb = Expr.symbol(f"x_{label}a"), Expr.symbol(f"x_{label}b")
        sigma = self._sigma(k, label)
        (omega,) = m.parameters(**{f"omega_{label}": Parameter(self.start.pole[k].imag, unit="rad/s")})
        a, b = sigma * xa + omega * xb, sigma * xb - omega * xa
        for i, u in enumerate(self.force):
            held = self._held(k, i)
            if len(self.force) == 1:
                a += m.parameters(**{f"b_{label}": Parameter(b_start[i].real, fixed=held)})[0] * u
                continue
            a += m.parameters(**{f"b_{label}a_{u}": Parameter(b_start[i].real, fixed=held)})[0] * u
            if not held:
                b += m.parameters(**{f"b_{label}b_{u}": Parameter(b_start[i].imag)})[0] * u
        m.dynamics(**{f"x_{label}a": a, f"x_{label}b": b})
        for j, shown in enumerate(self.parts):
            c = self._factor_name(j, label)
            ca, cb = m.parameters(**{f"{c}a": float(c_start[j].real), f"{c}b": float(-c_start[j].imag)})
            shown += [ca * xa, cb * xb]

    def lag(self, k: int, label: str) -> None:
        m, x = self.model, Expr.symbol(f"x_{label}")
        right = self._sigma(k, label) * x
        for i, u in enumerate(self.force):
            named = f"b_{label}_{u}" if len(self.force) > 1 else f"b_{label}"
            right += m.parameters(**{named: Parameter(self.start.b[k, i].real, fixed=self._held(k, i))})[0] * u
        m.dynamics(**{f"x_{label}": right})
        for j, shown in enumerate(self.parts):
            shown.append(m.parameters(**{self._factor_name(j, label): float(self.start.c[k, j].real)})[0] * x)

    def _sigma(self, k: int, label: str) -> Expr:
        value = self.start.pole[k].real
        free = Parameter(value, unit="1/s")
        stable = Parameter(-abs(value), bounds=(-np.inf, 0.0), unit="1/s")
        return self.model.parameters(**{f"sigma_{label}": stable if self.stable else free})[0]

    def _held(self, k: int, i: int) -> bool:
        return self.scale == "fixed" and i == self.start.held[k]

    def _factor_name(self, j: int, label: str) -> str:
        """Return the name of the factor of the mode in output j."""
        return f"c_{self.outputs[j]}_{label}" if len(self.outputs) > 1 else f"c_{label}"
