"""Records that a planned manoeuvre is predicted to give, with measured conditions that it does not state.

The record is fitted, without noise, from the very parameters that it was made with; there the Hessian of the
log-likelihood is the Fisher information, which `parameter_sensitivities` gives with the initial states free.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..data.experiment import Experiment
from ..errors import EvaluationError
from ..estimation import estimate
from ..fit_result import FitResult
from ..modelling.model import Model
from ..modelling.noise import Gaussian
from ..records import Record, record_of
from ..simulation import first_values, simulate
from ..solvers import Newton
from ..transcription import Collocation, SingleShooting

__all__ = ["condition_warnings", "predicted", "with_conditions"]

# A condition that changes by less than this part of its size is constant.
_CONSTANT = 1e-9


def with_conditions(model: Model, fit: FitResult | None, runs: Sequence[Experiment]) -> list[Experiment]:
    """Return the manoeuvres with the conditions that they do not give: constant, at their mean in the records of the
    fit. Without a fit the manoeuvres are returned as they are."""
    if fit is None:
        return list(runs)
    return [_completed(model, fit, run) for run in runs]


def _completed(model: Model, fit: FitResult, run: Experiment) -> Experiment:
    lacking = [n for n in model.condition_names if n not in run.inputs and n not in run.channels]
    if not lacking:
        return run
    means = {n: float(np.mean(np.concatenate([r.inputs[n] for r in fit.records]))) for n in lacking}
    columns = run._columns_of()
    held = {n: np.full(run.n, mean) for n, mean in means.items()}
    said = ", ".join(f"{n} = {mean:.6g}" for n, mean in means.items())
    return run._stepped(
        f"conditions as in the records: {said}",
        {**columns, "input": {**columns["input"], **held}},
        run._signals_of(),
    )


def condition_warnings(model: Model, runs: Sequence[Experiment]) -> tuple[str, ...]:
    """Return a warning for each condition that a manoeuvre is planned to change."""
    found = []
    for run in runs:
        for name in model.condition_names:
            u = run.input(name)
            if np.ptp(u) > _CONSTANT * float(np.abs(u).max()):
                found.append(
                    f"'{name}' is a measured condition, not a control, and changes from {u.min():.4g} to "
                    f"{u.max():.4g} in '{run.name}': the plan holds only where it does so in flight"
                )
    return tuple(found)


_Array = NDArray[np.float64]

# The fit must lie on the simulation, in units of the noise: else the mesh is too coarse for this manoeuvre.
_ON_PATH = 0.05
# Steps in an interval between samples.
_STEPS = 2


def predicted(
    model: Model,
    run: Experiment,
    values: Mapping[str, float],
    initial: Mapping[str, float],
    sigmas: Mapping[str, float],
    mesh: Collocation,
) -> tuple[Record, FitResult]:
    """Return the record that the model predicts for the inputs of ``run``, and the fit to it at these parameters.

    Raises EvaluationError where there is no solution, or where the fit does not lie on it.
    """
    noise = Gaussian(sigmas)
    # Steps of fixed length are a hundred times as fast; where they do not do, the careful way does, or says why not.
    for simulator in (simulate,) if model.delays else (_stepped, simulate):
        try:
            record = simulator(model, values, run, initial=initial)
            return record, _fitted(model, record, run, values, noise, mesh)
        except EvaluationError:
            if simulator is simulate:
                raise
    raise AssertionError


def _stepped(model: Model, values: Mapping[str, float], run: Experiment, *, initial: Mapping[str, float]) -> Record:
    """Simulate by Runge-Kutta steps of fixed length, in the core; arguments as of `simulate`."""
    run.check_for(model.input_names, [], conditions=model.condition_names)
    silent = run.with_outputs({n: np.zeros(run.n) for n in model.output_names})
    noise = Gaussian(dict.fromkeys(model.output_names, 1.0)).resolve(model.output_names, {}, {})
    problem = SingleShooting("dopri5", substeps=_STEPS, threads=1).problem(model, [silent], noise)
    first = first_values(model, values, values, run, initial)
    xi = np.array([*problem.variables([values[model.parameter_names[p]] for _, p, _ in problem.estimands]), *first])
    outputs, states = problem.outputs(xi, 0), problem.states(xi, 0)
    if not all(np.isfinite(v).all() for v in (*outputs, *states)):
        raise EvaluationError(f"plan: the solution of '{run.name}' is not finite")
    return record_of(model, run, outputs, states)


def _fitted(
    model: Model, record: Record, run: Experiment, values: Mapping[str, float], noise: Gaussian, mesh: Collocation
) -> FitResult:
    outputs = {}
    for name in model.output_names:
        outputs[name] = record.outputs[name].copy()
        if name in {*run.outputs, *run.channels}:  # sampled as there
            outputs[name][~np.isfinite(run.output(name))] = np.nan
    start = {n: v for n, v in values.items() if n in model.parameter_names} | dict(record.states)
    fit = estimate(
        model, run.with_outputs(outputs), transcription=mesh, noise=noise, start=start, solver=Newton(regression=False)
    )
    for name in model.output_names:
        residual = fit.records[0].residuals[name] / noise.known[name]
        off = float(np.sqrt(np.nanmean(residual**2))) if np.isfinite(residual).any() else 0.0
        if not off < _ON_PATH:
            raise EvaluationError(
                f"plan: manoeuvre '{run.name}': the fit of '{name}' to its own prediction is off by {off:.2g} sigma: "
                "give a finer mesh, transcription=Collocation(substeps=4), or smaller inputs"
            )
    return fit
