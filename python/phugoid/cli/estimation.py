"""An estimation as commands ask for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from .. import _core
from ..api import estimate
from ..data.experiment import Experiment
from ..errors import ModelError, OptionError, listing
from ..modelling.model import Model
from ..modelling.rebuilt import rebuilt
from ..result import Fit
from ..solvers import Ipopt, Newton
from ..transcription.collocation import Collocation
from ..transcription.filter_error import FilterError
from ..transcription.shooting import Transcription
from .bar import bar
from .options import fixes, numbers

__all__ = ["Estimation", "with_fixed"]

_SOLVERS: Mapping[str, type[Newton] | type[Ipopt]] = {"newton": Newton, "ipopt": Ipopt}


@dataclass(frozen=True)
class Estimation:
    """What the options say of how to estimate. ``fixed``: name -> value, None for the start as declared. ``order`` of
    collocation, None for 4, or the transcription of the fit to go on from."""

    order: int | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float | None] = field(default_factory=dict)
    solver: Newton | Ipopt = field(default_factory=Newton)

    @classmethod
    def of(
        cls,
        order: int | None = None,
        start: Sequence[str] | None = None,
        fix: Sequence[str] | None = None,
        solver: str = "newton",
        iterations: int | None = None,
    ) -> Estimation:
        """From the texts of the options; raises OptionError for what they cannot be."""
        if solver not in _SOLVERS:
            raise OptionError(f"--solver: there is no '{solver}'.{listing(solver, _SOLVERS)}")
        kind = _SOLVERS[solver]
        values = numbers("--start", start)
        return cls(order, values, fixes(fix, values), kind() if iterations is None else kind(max_iterations=iterations))

    def run(self, model: Model, data: Sequence[Experiment], before: Fit | None = None) -> Fit:
        """Estimates with progress on stderr; goes on from a fit ``before`` where there is one, with its noise."""
        model = with_fixed(model, self.fixed)
        begin: dict[str, Any] = {} if before is None else dict(before.as_start(before.noise))
        begin = {n: v for n, v in {**begin, **self.start}.items() if n.partition("[")[0] not in self.fixed}
        mesh: Transcription | FilterError = Collocation(order=4 if self.order is None else self.order)
        if before is not None and self.order is None:
            mesh = before.transcription
        with bar(model.name, self.solver.max_iterations) as watch:
            return estimate(
                model,
                data,
                transcription=mesh,
                noise=None if before is None else before.noise,
                start=begin,
                solver=None if isinstance(mesh, FilterError) else self.solver,  # which has its own
                progress=watch,
            )


def with_fixed(model: Model, fixed: Mapping[str, float | None]) -> Model:
    """The model with parameters held at values, or (None) where they start."""
    for name in fixed:
        if name not in model.parameter_names:
            raise ModelError(f"--fix: '{name}' is no parameter.{listing(name, model.parameter_names)}")
    if not fixed:
        return model

    def declare(core: _core.Model, declared: Any) -> None:
        name, unit, start, low, high, prior, held, local, log, scale = declared
        if name in fixed:
            value = fixed[name]
            start, held = start if value is None else value, True
            if not low <= start <= high:
                raise ModelError(f"--fix: {name} = {start:g} lies outside its bounds ({low:g}, {high:g})")
        core.parameter(name, unit, start, low, high, prior, held, local, log, scale)

    return model._around(rebuilt(model._core, model._core.inputs, declare), model.delays)
