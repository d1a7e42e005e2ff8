"""How exactly a fit's state path solves its differential equations: the integration error of each segment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .errors import OptionError
from .figures.style import LIMIT, SERIES, plain
from .fit_result import FitResult
from .transcription import Collocation, records_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["IntegrationError", "integration_error"]

_Array: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class IntegrationError:
    """The error that each of S segments of one experiment adds to the path.

    name    the experiment's.
    edges   (S + 1,) ends of the segments, s.
    errors  state -> (S,): how far, at most, the collocation polynomial departs within the segment from the exact
            solution through its first point, in the state's unit.
    scales  state -> what is small for it: the standard deviation of the noise of its measurement; one hundredth of
            the standard deviation of its path where it is not measured; at least 1e-6 of that.
    """

    name: str
    edges: _Array
    errors: Mapping[str, _Array]
    scales: Mapping[str, float]

    @property
    def relative(self) -> dict[str, _Array]:
        """State -> (S,): errors over scales."""
        return {name: e / self.scales[name] for name, e in self.errors.items()}

    @property
    def worst(self) -> _Array:
        """(S,): the largest relative error of any state in each segment."""
        return np.asarray(np.max(list(self.relative.values()), axis=0))

    def plot(self, axes: Axes, tolerance: float | None = None) -> None:
        """Relative errors over time, on a logarithmic scale, into axes of your own."""
        for i, (name, e) in enumerate(self.relative.items()):
            colour = SERIES[i % len(SERIES)][0]
            axes.stairs(
                np.maximum(e, 1e-300), self.edges, label=plain(name), color=colour, linewidth=0.9, baseline=None
            )
        axes.set_yscale("log")
        largest = float(self.worst.max())
        axes.set_ylim(max(1e-8 * largest, 1e-14), 3.0 * max(largest, tolerance or 0.0))
        if tolerance is not None:
            axes.axhline(tolerance, color=LIMIT, linestyle="--", linewidth=0.8, label="tolerance")
        axes.set_xlabel("time, s")
        axes.set_ylabel("error of a segment / noise")
        axes.legend(fontsize="small", frameon=False, ncols=3)

    def __repr__(self) -> str:
        size = f"{self.edges.size - 1} segments, at most {self.worst.max():.1e} of the noise in one"
        return f"<IntegrationError of '{self.name}': {size}>"


def integration_error(fit: FitResult) -> tuple[IntegrationError, ...]:
    """Return the error that each segment of the mesh adds to the path, one for each experiment of a fit.

    On a segment, collocation replaces f along the path by its polynomial through the segment's points (Eq. fhat_interp
    of the paper). What f is in truth between the points, at those of a finer Lobatto rule, leaves a defect d; the error
    follows from the linearised state equations e' = f_x e + d, e = 0 at the start of the segment.

    Raises OptionError for a fit that was not transcribed by collocation, or has delays and no fit without them within,
    and EvaluationError where the state equations are not finite between the points of the mesh.
    """
    if not isinstance(fit.transcription, Collocation):
        raise OptionError("integration_error: only collocation has a mesh whose error can be estimated")
    if fit.model.delays:  # the mesh is that of the model without delays, on records moved by them
        if fit._moved is None:
            raise OptionError("integration_error: estimate this fit with delays again first, with start=fit")
        return integration_error(fit._moved)
    # A mesh for smoothed kinks resolves these, and no jumps.
    model = fit._moved.model if fit.smoothing and fit._moved else fit.model
    found = []
    for record, run in zip(fit.records, fit._runs(), strict=True):
        edges, errors, scales = _core.integration_error(
            model._core,
            records_of(model, [run])[0],
            [fit._own(record.name)[name] for name in model.parameter_names],
            [_sigma(fit, record.name, name) for name in model.output_names],
            fit.transcription.order,
            np.ascontiguousarray(record.mesh_t),
            [np.ascontiguousarray(record.mesh_states[name]) for name in model.state_names],
        )
        by_state = dict(zip(model.state_names, errors, strict=True))
        found.append(IntegrationError(record.name, edges, by_state, dict(zip(model.state_names, scales, strict=True))))
    return tuple(found)


def _sigma(fit: FitResult, experiment: str, output: str) -> float | None:
    """Return the standard deviation of an output's noise in an experiment; None where there is none."""
    if output in fit.noise.known:
        return fit.noise.known[output]
    for name in (f"sigma_{output}[{experiment}]", f"sigma_{output}"):
        if name in fit.parameters:
            return fit.parameters[name].value
    return None
