"""Models of the measurement noise: their common base, and Gaussian noise."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

import phugoid._core as _core

from .._core import Expr
from ..errors import ModelError, did_you_mean

__all__ = ["KINDS", "Gaussian", "Noise", "Sigma", "not_noise", "saved_sigma"]

KINDS = "a Gaussian, StudentT, Huber, Laplace, Density or PerOutput"
"""What a noise model is, for messages."""


def not_noise(given: object) -> str:
    """Return the end of a message on an argument that is not noise model: what one is, and what numbers may have meant.

    >>> not_noise({"az": 0.1}).partition("; ")[2]
    "known standard deviations are given as ph.Gaussian({'az': 0.1})"
    """
    text = f"noise is {KINDS}, not {given!r}"
    if isinstance(given, Mapping) and given and all(isinstance(x, (int, float)) for x in given.values()):
        return f"{text}; known standard deviations are given as ph.Gaussian({dict(given)!r})"
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return f"{text}; a known standard deviation is given by output, as in ph.Gaussian({{'q': {given!r}}})"
    return text


@dataclass(frozen=True)
class Sigma:
    """An unknown scale of the noise of one output, in the output's unit: its standard deviation, where it is Gaussian.

    ``start`` None starts at the standard deviation of the measurements, and a larger start is lowered to it;
    ``bounds`` None allows 1e-9 to 1e6 times that.
    """

    start: float | None = None
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.start is not None and not positive(self.start):
            raise ModelError(f"a standard deviation starts at a positive number, not {self.start!r}")
        if self.bounds is not None:
            try:
                low, high = self.bounds
                sound = 0 < low < high
            except (TypeError, ValueError):
                sound = False
            if not sound:
                raise ModelError(
                    f"bounds of a standard deviation are a positive pair that increases, not {self.bounds!r}"
                )
            if self.start is not None and not low <= self.start <= high:
                raise ModelError(
                    f"the start {self.start} of a standard deviation lies outside its bounds {self.bounds}"
                )


@dataclass(frozen=True)
class Noise:
    """Base of all noise models: ``sigma`` gives the scale by output name.

    It is a number (known), a `Sigma` (unknown), or an expression in the model's states, inputs, quantities and
    parameters, such as ``a + b*y``, which is positive at all samples.
    Outputs not named have an unknown one.
    """

    sigma: Mapping[str, float | Sigma | Expr] = field(default_factory=dict)
    kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not isinstance(self.sigma, Mapping):
            raise ModelError(f"noise: give standard deviations by output, such as {{'q': 0.01}}, not {self.sigma!r}")
        for name, value in self.sigma.items():
            if not isinstance(value, (Sigma, Expr)) and not positive(value):
                raise ModelError(
                    f"noise of '{name}': a known standard deviation is a positive number, not {value!r}; "
                    "an unknown one is a Sigma, one that depends on the model an expression"
                )
        plain = {name: s if isinstance(s, (Sigma, Expr)) else float(s) for name, s in self.sigma.items()}
        object.__setattr__(self, "sigma", plain)

    @property
    def known(self) -> dict[str, float]:
        """The known scales by output, of those named."""
        return {name: s for name, s in self.sigma.items() if not isinstance(s, (Sigma, Expr))}

    @property
    def expressions(self) -> dict[str, Expr]:
        """The scales that are expressions of the model, by output."""
        return {name: s for name, s in self.sigma.items() if isinstance(s, Expr)}

    def known_sigmas(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the known scales of a model with these outputs."""
        return self.known

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the estimated noise parameters: ``sigma_<output>`` and others, in the order of a fit."""
        said = {**self.known, **self.expressions}
        return tuple(f"sigma_{name}" for name in outputs if name not in said)

    @property
    def description(self) -> str:
        """Text for summaries; empty for the usual, independent Gaussian noise."""
        return ""

    def of(self, output: str) -> Noise:
        """Return the noise of an output: this, unless each has its own."""
        return self

    def saved(self, outputs: Sequence[str]) -> str:
        """Return the noise as the core reads it. Raises ModelError for names that are not outputs."""
        return json.dumps(self.to_dict())

    def resolve(self, outputs: Sequence[str], spread: Mapping[str, float], start: Mapping[str, float]) -> _core.Noise:
        """Return the noise of a problem, with all starts and bounds.

        ``spread`` is the standard deviation of the measurements, ``start`` holds starts by name (`names`).
        """
        named = [(name, float(value)) for name, value in start.items() if np.ndim(value) == 0]
        return _core.Noise(self.saved(outputs), list(outputs), [spread.get(name, 1.0) for name in outputs], named)

    def to_dict(self) -> dict[str, Any]:
        """Return the noise as JSON takes it; `noise_from_dict` reads it."""
        own = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "sigma"}
        plain = {name: list(value) if isinstance(value, tuple) else value for name, value in own.items()}
        return {"kind": self.kind, "sigma": self._sigma_dict(), **plain}

    def _sigma_dict(self) -> dict[str, Any]:
        def plain(s: float | Sigma | Expr) -> dict[str, Any]:
            if isinstance(s, Expr):
                return {"expression": s.to_json()}
            if not isinstance(s, Sigma):
                return {"known": s}
            return {"start": s.start, "bounds": list(s.bounds) if s.bounds else None}

        return {name: plain(s) for name, s in self.sigma.items()}


@dataclass(frozen=True)
class Gaussian(Noise):
    """Gaussian noise, independent on each output unless asked otherwise (Dutra 2019; Jategaonkar 2015, ch. 4).

    ``sigma`` gives, by output name, a number (a known standard deviation) or a `Sigma` (an unknown one); outputs
    not named have an unknown one.
    ``correlated``: the noise of different outputs may be correlated; the whole covariance matrix R is estimated, as
    ``sigma_<output>`` and ``corr_<output>_<output>``. All standard deviations are unknown then. Bounds of a `Sigma`
    hold for the conditional standard deviation given the noise of other outputs.
    ``covariance``: R, known: an array (n_y, n_y) in the order of the model's outputs, or covariances by names,
    ``{"q": {"q": 1e-4, "az": 2e-4}, "az": {"az": 1e-2}}`` (each pair once or twice; a pair left out is 0).

    A sample with missing outputs contributes the density of those that are present, with any covariance.

    >>> Gaussian({"q": 0.01, "az": Sigma(start=0.1)}).known
    {'q': 0.01}
    """

    correlated: bool = False
    covariance: ArrayLike | Mapping[str, Mapping[str, float]] | None = None
    kind: ClassVar[str] = "gaussian"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.correlated, bool):
            raise ModelError(f"Gaussian: correlated is True or False, not {self.correlated!r}")
        if self.covariance is None:
            said = {**self.known, **self.expressions}
            if self.correlated and said:
                raise ModelError(
                    f"Gaussian: sigma_{next(iter(said))} is known, but correlated noise has all of them known "
                    "(covariance=...) or none"
                )
            return
        if self.correlated or self.sigma:
            raise ModelError("Gaussian: covariance says all; leave out sigma and correlated")
        object.__setattr__(self, "covariance", _covariance(self.covariance))

    def known_sigmas(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the known standard deviations of a model with these outputs."""
        if self.covariance is None:
            return self.known
        return dict(zip(outputs, np.sqrt(np.maximum(np.diag(self.matrix(outputs)), 0)).tolist(), strict=True))

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return ``sigma_<output>``, and for correlated noise ``corr_<output>_<output>``."""
        if self.covariance is not None:
            return ()
        names = super().names(outputs)
        if self.correlated:
            names += tuple(f"corr_{a}_{b}" for i, a in enumerate(outputs) for b in outputs[i + 1 :])
        return names

    @property
    def description(self) -> str:
        """Text for summaries; empty for independent noise."""
        if self.covariance is not None:
            return "jointly Gaussian, covariance known"
        return "jointly Gaussian, covariance estimated" if self.correlated else ""

    def matrix(
        self, outputs: Sequence[str], values: Mapping[str, float] | None = None
    ) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the covariance, (n_y, n_y) in the order of the outputs: the known one, or that of correlated noise
        with ``values`` of its parameters. Raises ModelError where it does not fit."""
        n = len(outputs)
        if self.covariance is None and values is not None:
            sigmas = np.array([values[f"sigma_{name}"] for name in outputs])
            found = np.diag(sigmas**2)
            for i, a in enumerate(outputs):
                for j, b in enumerate(outputs[i + 1 :], i + 1):
                    found[i, j] = found[j, i] = values[f"corr_{a}_{b}"] * sigmas[i] * sigmas[j]
            return found
        if not isinstance(self.covariance, Mapping):
            matrix = np.array(self.covariance, dtype=np.float64)
            if matrix.shape != (n, n):
                raise ModelError(
                    f"noise: the covariance has shape {matrix.shape}, but there are {n} outputs ({', '.join(outputs)})"
                )
            return matrix
        matrix = np.zeros((n, n))
        for a, row in self.covariance.items():
            for b, value in row.items():
                for name in (a, b):
                    if name not in outputs:
                        raise ModelError(
                            f"noise: '{name}' of the covariance is not an output.{did_you_mean(name, outputs)}"
                        )
                matrix[outputs.index(a), outputs.index(b)] = value
        return matrix

    def to_dict(self) -> dict[str, Any]:
        """Return the noise as JSON takes it: output -> known value, or start and bounds; with its kind unless
        independent."""
        sigmas = self._sigma_dict()
        if not self.correlated and self.covariance is None:
            return sigmas
        return {"kind": self.kind, "sigma": sigmas, "correlated": self.correlated, "covariance": self.covariance}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> Gaussian:
        """Read the result of `to_dict`."""
        if isinstance(saved.get("kind"), str):
            return Gaussian(saved_sigma(saved["sigma"]), saved["correlated"], saved["covariance"])
        return Gaussian(saved_sigma(saved))


def saved_sigma(saved: Mapping[str, Any]) -> dict[str, float | Sigma | Expr]:
    """Read the scales by output from their saved form."""

    def sigma(s: Mapping[str, Any]) -> float | Sigma | Expr:
        if "expression" in s:
            return _core.load_expression(s["expression"])
        return s["known"] if "known" in s else Sigma(s["start"], tuple(s["bounds"]) if s["bounds"] else None)

    return {name: sigma(s) for name, s in saved.items()}


def positive(value: Any) -> bool:
    """Return whether a value is a positive, finite number."""
    try:
        return bool(value > 0 and math.isfinite(value))
    except (TypeError, ValueError):
        return False


def _covariance(given: Any) -> Any:
    """Return a covariance as plain data, so that options compare and can be saved: nested mappings, or a tuple
    of rows."""
    if isinstance(given, Mapping):
        rows: dict[str, dict[str, float]] = {}
        for a, row in given.items():
            if not isinstance(row, Mapping):
                raise ModelError(f"Gaussian: covariances by names are {{'a': {{'a': ..., 'b': ...}}}}, not {given!r}")
            for b, value in row.items():
                other = given.get(b, {}).get(a, value) if isinstance(given.get(b, {}), Mapping) else value
                if not isinstance(value, (int, float)) or not math.isfinite(value) or other != value:
                    raise ModelError(f"Gaussian: the covariance of '{a}' and '{b}' is not one number: {value!r}")
                rows.setdefault(a, {})[b] = rows.setdefault(b, {})[a] = float(value)
        return rows
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not np.isfinite(matrix).all():
        raise ModelError(f"Gaussian: covariance is a square matrix of numbers, or covariances by names, not {given!r}")
    return tuple(map(tuple, matrix.tolist()))
