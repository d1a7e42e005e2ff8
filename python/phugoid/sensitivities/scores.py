"""What each residual says: derivatives of the log-density by the model's outputs, and how they answer to these."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..noise.densities import Density, Huber, Laplace, StudentT
from ..noise.kinds import PerExperiment, PerOutput
from ..noise.noise import Gaussian, Noise
from .linearised import Linearised

__all__ = ["Scores"]

_Array: TypeAlias = NDArray[np.float64]


class Scores:
    """Scores of a linearised fit's rows, in units of its noise.

    values   (n_rows,) scale times the derivative of the log-density by the output: of independent Gaussian noise the
             residual over its standard deviation.
    """

    def __init__(self, linear: Linearised) -> None:
        self.linear = linear
        self._noise = linear.inner.noise
        self._scale = linear.scale()
        self._joint: list[tuple[NDArray[np.intp], _Array]] = []  # rows (times, outputs) and their weights
        self._curvature = np.ones(linear.n_rows)
        noise = self._noise.noise if isinstance(self._noise, PerExperiment) else self._noise
        if isinstance(noise, Gaussian) and (noise.correlated or noise.covariance is not None):
            self._jointly(noise)
            self.values = self.weighted(linear.residuals[:, None] / self._scale[:, None])[:, 0]
        else:
            self.values = np.empty(linear.n_rows)
            self._each(noise)

    @property
    def own(self) -> bool:
        """Whether each experiment has noise of its own size."""
        return isinstance(self._noise, PerExperiment) and len(self.linear.experiments) > 1

    @property
    def gaussian(self) -> bool:
        """Whether the noise is Gaussian."""
        noise = self._noise.noise if isinstance(self._noise, PerExperiment) else self._noise
        kinds = list(noise.outputs.values()) if isinstance(noise, PerOutput) else [noise]
        return all(isinstance(kind, Gaussian) for kind in kinds)

    def weighted(self, columns: _Array) -> _Array:
        """By how much scores fall where the outputs change by columns (n_rows, k), in units of the noise."""
        if not self._joint:
            return np.asarray(self._curvature[:, None] * columns)
        out = np.zeros_like(columns)
        for rows, weight in self._joint:
            out[rows] = np.einsum("ij,tjk->tik", weight, columns[rows])
        return out

    def _value(self, name: str, experiment: int) -> float:
        """A number of the noise, as it is in an experiment."""
        parameters = self.linear.inner.parameters
        label = f"{name}[{self.linear.experiments[experiment].name}]"
        return parameters[label if label in parameters else name].value

    def _jointly(self, noise: Gaussian) -> None:
        """The weights of correlated noise: inverses of its covariance, of those outputs that are measured."""
        linear = self.linear
        outputs = linear.model.output_names
        first = np.concatenate([np.full(r.stop - r.start, e) for line in linear.rows for e, r in enumerate(line)])
        for e in range(len(linear.experiments)):
            covariance = self._covariance(noise, outputs, e)
            for which, at in linear.structure.together:
                mine = at[first[at[:, 0]] == e]
                sizes = self._scale[[linear.rows[i][e].start for i in which]] if mine.size else np.empty(0)
                if mine.size:
                    inverse = np.linalg.inv(covariance[np.ix_(which, which)])
                    self._joint.append((mine, inverse * np.outer(sizes, sizes)))

    def _covariance(self, noise: Gaussian, outputs: Sequence[str], experiment: int) -> _Array:
        if noise.covariance is not None:
            return noise.matrix(outputs)
        sigmas = np.array([self._value(f"sigma_{name}", experiment) for name in outputs])
        found = np.diag(sigmas**2)
        for i, a in enumerate(outputs):
            for j, b in enumerate(outputs[i + 1 :], i + 1):
                found[i, j] = found[j, i] = self._value(f"corr_{a}_{b}", experiment) * sigmas[i] * sigmas[j]
        return found

    def _each(self, noise: Noise) -> None:
        """Of independent noise, output by output."""
        linear = self.linear
        for i, name in enumerate(linear.model.output_names):
            kind = noise._of(name) if isinstance(noise, PerOutput) else noise
            known = noise.known_sigmas(linear.model.output_names)
            for e, rows in enumerate(linear.rows[i]):
                sigma = known[name] if name in known else self._value(f"sigma_{name}", e)
                r, scale = linear.residuals[rows] / sigma, self._scale[rows] / sigma
                psi, slope = self._influence(kind, name, e, r, sigma)
                self.values[rows], self._curvature[rows] = scale * psi, scale**2 * slope

    def _influence(self, kind: Noise, output: str, e: int, r: _Array, sigma: float) -> tuple[_Array, _Array]:
        """Minus the first and second derivative of the log-density by residuals in units of sigma."""
        if isinstance(kind, StudentT):
            known = kind._dof(output)
            dof = self._value(f"dof_{output}", e) if known is None else known
            below = dof + r**2
            return (dof + 1) * r / below, (dof + 1) * (dof - r**2) / below**2
        if isinstance(kind, Huber):
            return np.clip(r, -kind.k, kind.k), (np.abs(r) <= kind.k).astype(np.float64)
        if isinstance(kind, Laplace):
            size = np.sqrt(r**2 + kind.smoothing**2)
            return r / size, kind.smoothing**2 / size**3
        if isinstance(kind, Density):
            return self._custom(kind, output, e, r, sigma)
        return r, np.ones_like(r)

    def _custom(self, kind: Density, output: str, e: int, r: _Array, sigma: float) -> tuple[_Array, _Array]:
        numbers: dict[str, Any] = {"sigma": sigma}
        for name, p in kind.parameters.items():
            fixed = float(getattr(p, "start", math.nan))
            numbers[name] = self._value(f"{name}_{output}", e) if name in kind._free() else fixed
        first = Expr(kind.log_density).diff("residual")

        def at(e: Expr) -> _Array:
            known = {n: numbers[n] for n in e.symbols if n != "residual"}
            return np.array([e.evaluate({**known, **({"residual": v} if "residual" in e.symbols else {})}) for v in z])

        z = (r * sigma).tolist()
        return -sigma * at(first), -(sigma**2) * at(Expr(first).diff("residual"))
