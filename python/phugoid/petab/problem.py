"""A parameter estimation problem in the PEtab format (Schmiester et al. 2021)."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .._core import Expr
from ..data.experiment import Experiment
from ..data.readers import existing
from ..errors import DataError, EvaluationError, ModelError, OptionError, counted
from ..fit_result import FitResult
from ..modelling.model import Model
from ..simulation import simulate
from ..writing import write
from .assembly import NamedValues, Records, declared_parameters, model_of, prior_outputs
from .measurements import Conditions, Measurements, Phase, set_after_rest
from .sbml import Formulas, SbmlModel, petab_library

__all__ = ["PetabProblem", "read_petab"]

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class PetabProblem:
    """A PEtab problem as a model and experiments of ours.

    model        its parameters start at the nominal values, within the bounds of the table; those declared on a
                 logarithmic scale have ``transform="log"``. Conditions are input signals, observables outputs, noise
                 formulas expressions.
    experiments  one for each pair of conditions that is measured.
    nominal      values of the parameter table by name, of the parameters that are estimated.
    constant     what the log-likelihood of the PEtab problem has beside ``Fit.log_likelihood``: the normalisation of
                 Gaussian densities and the Jacobian of logarithms of measurements.
    unused       parameters of the table that no formula holds.
    """

    name: str
    model: Model
    experiments: Sequence[Experiment]
    nominal: Mapping[str, float]
    constant: float
    unused: Sequence[str]
    _table: Any
    _records: Records
    _phases: Sequence[Phase]

    def log_likelihood(
        self, values: Mapping[str, float] | FitResult | None = None, *, time_limit: float | None = None
    ) -> float:
        """Return the log-likelihood of the PEtab problem, priors included, by an adaptive integration of the ODE.

        ``values``: parameters by name (those left out have their nominal values), or a fit; None for the nominal point.
        Steady states are as long as the model takes to come to rest with these values.
        Raises EvaluationError where the solution does not exist, or the model does not come to rest, and ModelError for
        an unknown name.
        """
        given = dict(self.nominal)
        if values is not None:
            own = values.parameters if isinstance(values, FitResult) else values
            for name, value in own.items():
                if name not in self.nominal and name not in self.unused:
                    raise ModelError(f"log_likelihood: '{name}' is not a parameter of the problem {self.name}")
                given[name] = float(value)
        return self._at_rest(given, time_limit)._log_likelihood(given, time_limit)

    def at_rest(self, values: Mapping[str, float] | FitResult) -> PetabProblem:
        """Return this problem with steady states that are long enough for these values of the parameters.

        The experiments have steady states that are far longer than the model takes to come to rest at the nominal
        point. With parameters for which it is still on its way after that, the likelihood is not that of the problem:
        estimate again with the problem that this method returns.
        Raises EvaluationError where the model does not come to rest.
        """
        own = values.parameters if isinstance(values, FitResult) else values
        return self._at_rest({n: float(own.get(n, self.nominal[n])) for n in self.model.parameter_names}, None)

    def _at_rest(self, at: Mapping[str, float], time_limit: float | None) -> PetabProblem:
        at = {n: at[n] for n in self.model.parameter_names}
        experiments = list(self.experiments)
        for i, phase in enumerate(self._phases):
            if not self._records.rests(phase):
                continue
            record = self._records.integrated(at, experiments[i], time_limit)
            if not self._records.settled(phase, record):
                experiments[i] = self._records.experiment(phase, at)
        same = all(a is b for a, b in zip(experiments, self.experiments, strict=True))
        return self if same else replace(self, experiments=experiments)

    def _log_likelihood(self, given: Mapping[str, float], time_limit: float | None) -> float:
        parameters = {n: given[n] for n in self.model.parameter_names}
        total = self.constant
        sigma_of = self._with_sigmas()
        for experiment in self.experiments:
            record = simulate(sigma_of, parameters, experiment, time_limit=time_limit)
            for name in experiment.outputs:
                z = experiment.output(name)
                there = np.isfinite(z)
                sigma = record.outputs[f"sigma of {name}"][there]
                e = (z[there] - record.outputs[name][there]) / sigma
                if not (sigma > 0.0).all():
                    raise EvaluationError(f"log_likelihood: the standard deviation of {name} is not positive")
                total += float(np.sum(self._log_density(name, e) - np.log(sigma)))
        return total

    def _log_density(self, output: str, e: _Array) -> _Array:
        if self.model.noise_model.of(output).kind == "laplace":
            return np.asarray(0.5 * math.log(2.0 * math.pi) - math.log(2.0) - np.abs(e))
        return np.asarray(-0.5 * e**2)

    def _with_sigmas(self) -> Model:
        """Return the model with the standard deviation of each output as an output of its own."""
        scales = self.model.noise_model.sigma
        # All are known numbers or expressions.
        sigmas: dict[str, Any] = {f"sigma of {n}": Expr(cast(Any, scales[n])) for n in self.model.output_names}
        return self.model._changed(outputs=sigmas)

    def starts(self, n: int, *, seed: int = 0, screened_from: int | None = None) -> list[dict[str, float]]:
        """Return n starts within the bounds of the table, for ``multistart(..., starts=...)``.

        They are a Latin hypercube, of the logarithms of those parameters that are declared on a logarithmic scale.
        ``screened_from``: so many are drawn and simulated, and the n of the highest log-likelihood are returned, the
        best first. Raises OptionError for numbers that cannot be.
        """
        from scipy.stats import qmc

        total = n if screened_from is None else screened_from
        if not (isinstance(n, int) and isinstance(total, int) and 1 <= n <= total):
            raise OptionError(f"starts: n is a whole number from 1 to screened_from, not {n!r} of {total!r}")
        declared = self.model.declared_parameters
        unit = qmc.LatinHypercube(len(declared), seed=seed).random(total)
        drawn = []
        for row in unit:
            values = {}
            for u, (name, p) in zip(row, declared.items(), strict=True):
                low, high = p.bounds
                value = low * (high / low) ** u if p.transform == "log" and low > 0.0 else low + u * (high - low)
                values[name] = float(min(max(value, low), high))
            drawn.append(values)
        if total == n:
            return drawn
        rank = [self._screened(values) for values in drawn]
        best = sorted(range(total), key=lambda i: -rank[i])[:n]
        return [drawn[i] for i in best]

    def _screened(self, values: Mapping[str, float]) -> float:
        try:
            return self.log_likelihood(values, time_limit=1.0)
        except EvaluationError:
            return -math.inf

    def write_parameters(self, values: Mapping[str, Any] | FitResult, path: str | os.PathLike[str]) -> None:
        """Write a parameter table of PEtab with these values, or those of a fit, in the place of the nominal ones.

        Raises ModelError for a name that is not a parameter of the table, DataError where the file cannot be written.
        """
        table = self._table.copy()
        own = values.parameters if isinstance(values, FitResult) else values
        for name, value in own.items():
            if name not in table.index:
                raise ModelError(f"write_parameters: '{name}' is not in the parameter table")
            table.loc[name, "nominalValue"] = float(value)
        write(path, table.to_csv(sep="\t"), "the parameter table")

    def __repr__(self) -> str:
        return f"<PetabProblem '{self.name}': {self.model!r}, {counted(len(self.experiments), 'experiment')}>"


def read_petab(path: str | os.PathLike[str]) -> PetabProblem:
    """Read a problem in the PEtab format, version 1: a YAML file that names an SBML model and tables.

    What an observable's formula, noise and overrides say becomes outputs of the model; conditions and steps in time
    become input signals that are held; a steady state before a record (pre-equilibration) becomes a part of the record
    without samples that is long enough for the model to come to rest.

    Raises MissingDependency without the packages petab and python-libsbml, DataError where a file cannot be read, and
    ModelError that names what is not supported: algebraic rules, delays, events that depend on states, switching times
    that are estimated, and others.
    """
    library, _ = petab_library()
    if not str(path).startswith(("http:", "https:")):
        existing(Path(path))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what the package uses
            problem = library.Problem.from_yaml(str(Path(path)))
    except Exception as error:  # of its many readers
        what = f"the entry {error} is missing" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise DataError(f"{path}: it cannot be read as a PEtab problem ({what})") from error
    name = Path(path).stem
    if getattr(problem.model, "type_id", "sbml") != "sbml":
        raise ModelError(f"{path}: its model is of the type {problem.model.type_id}; SBML is supported")
    for kind in ("measurement_df", "observable_df", "parameter_df"):
        if getattr(problem, kind) is None:
            raise DataError(f"{path}: the problem has no {kind.removesuffix('_df')} table")

    phases = _phases(problem.measurement_df)
    used = list(dict.fromkeys(c for p in phases for c in (p.before, p.during) if c is not None))
    columns = [] if problem.condition_df is None else [c for c in problem.condition_df if c != "conditionName"]
    parameters, table = declared_parameters(problem.parameter_df)
    formulas = Formulas()
    sbml = SbmlModel.read(problem.model.sbml_document, formulas, {*columns, *table})
    if problem.condition_df is None:
        conditions = Conditions()
    else:
        conditions = Conditions.read(problem.condition_df, used, {**sbml.initial, **table})
        for state in set_after_rest(problem.condition_df, phases, sbml.slopes):
            sbml.set_after_rest(state, conditions.values[state], formulas)
    values = NamedValues(sbml, conditions, table)
    measured = Measurements.read(problem.measurement_df, problem.observable_df, formulas, table)
    for label, (output, mean, beside) in prior_outputs(problem.parameter_df).items():
        measured.outputs[label] = output
        measured.samples[phases[0]][label] = [(0.0, mean)]
        measured.constant += beside - 0.5 * math.log(2.0 * math.pi)
    model = model_of(sbml, values, formulas, measured, parameters)
    nominal = {n: p.start for n, p in model.declared_parameters.items()}
    records = Records(model, values, formulas, measured)
    return PetabProblem(
        name=name,
        model=model,
        experiments=[records.experiment(phase, nominal) for phase in phases],
        nominal=nominal,
        constant=measured.constant,
        unused=[n for n in parameters if n not in nominal],
        _table=problem.parameter_df,
        _records=records,
        _phases=phases,
    )


def _phases(measurements: Any) -> list[Phase]:
    """Return the pairs of conditions that are measured, in the order of the table."""
    before = measurements.get("preequilibrationConditionId")
    found: dict[Phase, None] = {}
    for i, during in enumerate(measurements["simulationConditionId"]):
        first = None if before is None else before.iloc[i]
        found[Phase(str(first) if isinstance(first, str) and first else None, str(during))] = None
    return list(found)
