"""What an estimation gives back."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _core, summary, tabular
from ._core import Expr
from .data.experiment import Experiment
from .errors import DataError, ModelError, OptionError, did_you_mean
from .figures import fit as plot
from .figures.convergence import plot_convergence
from .figures.correlation import plot_correlation
from .figures.parameters import plot_parameters
from .integration import IntegrationError, integration_error
from .modelling.model import Model
from .noise.kinds import PerExperiment
from .noise.noise import Noise
from .parameters import Estimate, Estimates
from .records import Record
from .refinement import Refinement
from .solvers import Iteration, Solution
from .tolerance import Tolerance
from .transcription.collocation import Collocation
from .transcription.filter_error import FilterError
from .transcription.shooting import Transcription

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .starts.outcome import Outcome
    from .uncertainty.bands import Bands
    from .uncertainty.bootstrap import Bootstrap
    from .uncertainty.coloured import Coloured
    from .uncertainty.correlation import Correlation
    from .uncertainty.profile import Profiles
    from .validation.result import Validation

__all__ = ["Fit"]

_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """The result of `estimate`.

    parameters      by name, what was estimated of the noise (``sigma_<output>``, and more) among them.
    initial_states  experiment -> state -> estimate of the state at the first sample.
    log_likelihood  of the measurements (Eq. ellz_defn), without the constant -N n_y/2 ln 2 pi, whatever the noise.
    records         one an experiment: measured, outputs, residuals, states.
    status          "converged", or what else happened; ``message`` says what to do.
    warnings        what to beware of in the result, in words.
    covariance      (n, n) of the parameters in their order; NaN where there is none.
    refinement      what ``Collocation(refine=True)`` did.
    experiments     the data it was fitted to; empty for a fit of a file of version 1, which had none.
    """

    model: Model
    noise: Noise
    transcription: Transcription | FilterError
    parameters: Estimates
    initial_states: Mapping[str, Estimates]
    covariance: _Array
    log_likelihood: float
    records: Sequence[Record]
    status: str
    message: str
    iterations: int
    time: float
    warnings: tuple[str, ...] = ()
    history: Sequence[Iteration] = ()
    solution: Solution | None = field(default=None)
    refinement: Refinement | None = None
    experiments: Sequence[Experiment] = ()
    # Where something is late: the fit of the model without delays to data moved by them.
    _moved: Fit | None = field(default=None, repr=False)

    @property
    def converged(self) -> bool:
        """Whether the solver met its tolerances."""
        return self.status == "converged"

    @property
    def feasible(self) -> bool:
        """Tell whether the states satisfy the equations of the model. Where a run ended elsewhere, log-likelihood,
        standard errors and how well outputs match are NaN."""
        return all(record.feasible for record in self.records)

    def _only(self, what: str) -> Record:
        if len(self.records) > 1:
            names = ", ".join(f"'{r.name}'" for r in self.records)
            raise DataError(f"the fit has {len(self.records)} experiments ({names}): use fit.records[i].{what}")
        return self.records[0]

    @property
    def states(self) -> Mapping[str, _Array]:
        """State -> (N,) at the samples, of the only experiment."""
        return self._only("states").states

    @property
    def outputs(self) -> Mapping[str, _Array]:
        """Output -> (N,) of the model, of the only experiment."""
        return self._only("outputs").outputs

    @property
    def residuals(self) -> Mapping[str, _Array]:
        """Output -> (N,) measured minus model, NaN where missing, of the only experiment."""
        return self._only("residuals").residuals

    @property
    def _intensities(self) -> set[str]:
        t = self.transcription
        return {f"q_{name}" for name in t.states} if isinstance(t, FilterError) else set()

    @property
    def noise_parameters(self) -> set[str]:
        """Names of the parameters that are those of the noise, not of the model."""
        names = {*self.noise.names(self.model.output_names), *(f"sigma_{n}" for n in self.model.output_names)}
        # Also of a single experiment, as in sigma_q[run 1].
        return {n for n in self.parameters if n.partition("[")[0] in names} | self._intensities

    def _solution_of(self, problem: _core.Problem) -> Solution:
        """The solution, of which a problem made of model and data anew is that of the fit.

        Raises DataError where it is not, as in a file whose parts belong to different fits.
        """
        s = self.solution
        if s is None or (s.xi.size, s.multipliers.size) != (problem.n, problem.m):
            raise DataError(
                f"fit of '{self.model.name}': its solution is not one of its model and data ({problem.n} unknowns and "
                f"{problem.m} equations); estimate it again with start=fit"
            )
        return s

    def as_start(self, noise: Noise | None = None) -> dict[str, float]:
        """Parameters as start values of another estimation; of the noise those that ``noise`` has, or all."""
        outputs = self.model.output_names
        gone = set() if noise is None else {*self.noise.names(outputs)}.difference(noise.names(outputs))
        gone |= {f"sigma_{name}" for name in self.noise.known_sigmas(outputs)} | self._intensities
        if isinstance(self.noise, PerExperiment):  # starts are for all experiments
            gone |= {name for name in self.parameters if name.partition("[")[0] in self.noise.names(outputs)}
        return {name: e.value for name, e in self.parameters.items() if name not in gone}

    def derived(self, **expressions: Expr) -> Estimates:
        """Estimates of expressions in the parameters, with standard errors to first order (the delta method).

        ``fit.derived(natural_frequency=sqrt(k / mass))``; a quantity of the model is given by its expression,
        ``fit.derived(static_margin=fit.model.equations["static_margin"])``. Raises ModelError for other symbols.
        """
        names = list(self.parameters)
        values = self.parameters.to_dict()
        found = []
        for name, expression in expressions.items():
            e = Expr(expression)
            for symbol in e.symbols:
                if symbol not in values:
                    if own := [n for n in names if n.startswith(f"{symbol}[")]:
                        raise ModelError(
                            f"derived '{name}': '{symbol}' has a value for each experiment ({', '.join(own)}): "
                            "ask for one of them, or of fits to single experiments"
                        )
                    raise ModelError(f"derived '{name}': '{symbol}' is no parameter.{did_you_mean(symbol, names)}")
            numbers = {symbol: values[symbol] for symbol in e.symbols}
            slope = np.zeros(len(names))
            for symbol in e.symbols:
                d = e.diff(symbol)
                slope[names.index(symbol)] = d.evaluate({s: values[s] for s in d.symbols})
            # What is held has no error of its own.
            held = [i for i, p in enumerate(self.parameters.values()) if p.fixed or p.bounds_active]
            free = (slope != 0) & ~np.isin(np.arange(len(names)), held)
            variance = slope[free] @ self.covariance[np.ix_(free, free)] @ slope[free]
            found.append(Estimate(name, e.evaluate(numbers), float(np.sqrt(variance))))
        return Estimates(found)

    @cached_property
    def coloured(self) -> Coloured:
        """Standard errors corrected for coloured residuals: of parameters and initial states, by name; the covariance;
        by how much they are larger than the plain ones.

        The Cramér-Rao bounds in ``parameters`` take residuals for white; where they are coloured, as those of flight
        records are, these bounds are optimistic (Maine & Iliff 1981; Morelli & Klein 1997). The noise of each output is
        taken for an autoregressive process, also common to outputs, as `uncertainty.colour` says. A fit by shooting, or
        one that was loaded from a file, is estimated again by collocation first.

        Raises OptionError for a fit by the filter-error method.
        """
        from .uncertainty.coloured import coloured

        return coloured(self)

    @cached_property
    def correlation(self) -> Correlation:
        """Correlations of the estimates: ``fit.correlation["Cm0", "Cma"]``, ``.matrix`` (n, n), ``.pairs(0.9)``, and
        ``.weak``: combinations that the data hardly determine."""
        from .uncertainty.correlation import correlation_of

        noise = self.noise_parameters
        physical = [n for n in self.parameters if n not in noise]
        return correlation_of(list(self.parameters), self.parameters.values_array, self.covariance, physical)

    def profile(
        self,
        names: str | Iterable[str] | None = None,
        *,
        level: float = 0.95,
        coloured: bool = False,
        executor: Executor | None = None,
        progress: bool | Callable[[Outcome], None] = False,
        time_limit: float | None = None,
    ) -> Profiles:
        """Intervals by profile likelihood (Venzon & Moolgavkar 1988): each parameter is moved, all others estimated
        anew, until twice the log-likelihood has dropped by chi-square's quantile. They follow a likelihood that is no
        parabola, where standard errors do not.

        ``names``: of parameters of the model (``"b[run1]"`` of one experiment's own); None: all that are free.
        ``coloured``: the drop is made larger by what `coloured` finds, as for a composite likelihood (Chandler & Bate
        2007); without it, intervals take residuals for white.
        ``executor``, ``progress``: as of `multistart`; a task is one side of a parameter.
        ``time_limit``: in seconds, of the whole.

        An interval ends at a bound where the likelihood is still high there, and is infinite where it stays high
        however far one goes: ``.ends`` says so. Ctrl-C, and the time limit, keep the sides that are done.

        With process noise (`FilterError`) the likelihood is the marginal one, with the intensities estimated anew too.

        Raises OptionError for names without a profile, and a fit that has not converged.
        """
        from .uncertainty.profile import profile

        options = {"executor": executor, "progress": progress, "time_limit": time_limit}
        return profile(self, names, level=level, coloured=coloured, **options)  # type: ignore[arg-type]

    def bootstrap(
        self,
        n: int = 200,
        kind: Literal["parametric", "coloured", "block"] = "parametric",
        *,
        block: int | None = None,
        seed: int = 0,
        executor: Executor | None = None,
        progress: bool | Callable[[Outcome], None] = False,
        time_limit: float | None = None,
    ) -> Bootstrap:
        """Standard errors and intervals from estimates with data as they might have been (Efron & Tibshirani 1993):
        the fitted model's outputs with other noise, where there were measurements.

        ``kind``: "parametric" draws white noise from the fit's noise model; "coloured" Gaussian noise as coloured as
        the residuals, also in common to outputs, as `coloured` finds it; "block" puts blocks of the residuals
        themselves together, all channels at once, without reaching over gaps (Künsch 1989).
        ``block``: samples of a block; None: from how long the noise remembers, a sixth of a record at most.
        ``seed``: draw i has random numbers of its own, whatever n and executor.
        ``executor``, ``progress``: as of `multistart`. Each run starts from this fit.
        ``time_limit``: in seconds, of all runs together. It keeps the runs that are done, as Ctrl-C does.

        With process noise (`FilterError`) "parametric" is the only kind: it draws process noise too, so other motions.

        Raises OptionError for options that cannot be right, a fit that has not converged, and a vehicle that other
        process noise would carry far away with the inputs as recorded, such as an unstable one with its controller.
        """
        from .uncertainty.bootstrap import bootstrap

        options = {"executor": executor, "progress": progress, "time_limit": time_limit}
        return bootstrap(self, n, kind, block=block, seed=seed, **options)  # type: ignore[arg-type]

    def prediction_bands(
        self,
        experiment: str | int | Experiment | None = None,
        *,
        level: float = 0.95,
        coloured: bool = True,
        biases: Sequence[str] | None = None,
        values: Mapping[str, float] | None = None,
    ) -> Bands:
        """Bands about the outputs: in which the true model's outputs lie, by the uncertainty of parameters and initial
        states to first order, and in which a new measurement lies, with noise of its own.

        ``experiment``: name or number of one of the fit; None: the only one; or another `Experiment`, of which initial
        states and biases are found anew as `validate` does, with ``biases`` and ``values`` as there: their errors
        follow those of the parameters.
        ``coloured``: errors for coloured residuals, or else for white ones. Each band holds at each sample by itself.
        ``.plot()`` draws them.

        With process noise (`FilterError`) they are about the most probable path, which follows the measurements: what
        the smoother leaves open, and the uncertainty of the parameters. Innovations are white, ``coloured`` or not.

        Raises OptionError, DataError or UnknownName for what is not there.
        """
        from .uncertainty.bands import prediction_bands

        return prediction_bands(self, experiment, level=level, coloured=coloured, biases=biases, values=values)

    def summary(self) -> str:
        """The fit as a plain-text table: of each parameter the Cramér-Rao standard error and, where the fit has its
        data at hand, the one corrected for coloured residuals."""
        text = summary.fit_summary(self) + (f"\n\n{self.refinement.summary()}" if self.refinement else "")
        return text + "".join(f"\n\nWarning: {w}" for w in self.warnings)

    def integration_error(self) -> tuple[IntegrationError, ...]:
        """The error that each segment of the mesh adds to the path, one for each experiment.

        Raises OptionError for a fit that was not transcribed by collocation.
        """
        if not isinstance(self.transcription, Collocation):
            raise OptionError("integration_error: only collocation has a mesh whose error can be estimated")
        named = {n: f"sigma_{n}" for n in self.model.output_names}
        sigmas = {n: self.parameters[s].value for n, s in named.items() if s in self.parameters} | self.noise.known
        order = self.transcription.order
        return tuple(integration_error(self.model, self._own(r.name), sigmas, r, order) for r in self.records)

    def _own(self, experiment: str) -> dict[str, float]:
        """The model's parameters as they are in one experiment."""
        labels = {name: f"{name}[{experiment}]" for name in self.model.parameter_names}
        return {n: self.parameters[label if label in self.parameters else n].value for n, label in labels.items()}

    def plot(
        self,
        record: int | str = 0,
        channels: Sequence[str] | None = None,
        tolerances: Mapping[str, float | Tolerance] | None = None,
    ) -> tuple[Figure, dict[str, Axes]]:
        """The proof-of-match figure of an experiment: measured points, model, residuals, inputs; see `plot_fit`.

        ``tolerances``: output -> greatest deviation in its unit, or a `Tolerance`, drawn as bands (14 CFR Part 60).
        """
        return plot.plot_fit(self, record, channels, tolerances=tolerances)

    def plot_residuals(
        self, record: int | str = 0, channels: Sequence[str] | None = None
    ) -> tuple[Figure, dict[str, Axes]]:
        """The residuals of an experiment over time, their autocorrelation and their spectrum; see `plot_residuals`."""
        from .discrepancy.misfit.residuals_figure import plot_residuals

        return plot_residuals(self, record, channels)

    def plot_parameters(
        self, *others: Any, names: Sequence[str] | None = None, labels: Sequence[str] | None = None
    ) -> tuple[Figure, dict[str, Axes]]:
        """The estimates with 95 % intervals, of this fit or side by side with others; see `plot_parameters`."""
        return plot_parameters([self, *others], names, labels)

    def plot_correlation(self, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """The correlation matrix of the estimates as a heat map; see `plot_correlation`."""
        return plot_correlation(self, names)

    def plot_convergence(self) -> tuple[Figure, dict[str, Axes]]:
        """Log-likelihood, defects, distance from the optimum and step of every iteration; see `plot_convergence`."""
        return plot_convergence(self)

    def validate(
        self,
        other: Experiment | Sequence[Experiment],
        *,
        biases: Sequence[str] | None = None,
        values: Mapping[str, float] | None = None,
        tolerances: Mapping[str, float | Tolerance] | None = None,
        time_limit: float | None = None,
    ) -> Validation:
        """Tries the fitted model on other experiments: only initial states and biases are found anew.

        Parameters and noise are held at this fit, so that log-likelihoods on the same experiments compare; the
        transcription is that of the fit. Gaps, delays and channels with times of their own are as in `estimate`.

        ``biases``: what is found anew, with bounds and priors as declared. None: parameters that enter outputs only,
        each as a term with a constant coefficient, as a sensor's bias does; those declared fixed stay. Names of
        parameters of any kind: these; () for none. A parameter with ``per_experiment`` has one value an experiment here
        too, any other one for all.
        ``values``: name -> value of parameters to hold elsewhere than at the fit. A parameter with ``per_experiment``
        that is no bias needs one, or must be named in ``biases``.
        ``tolerances``: output -> greatest deviation in its unit, or a `Tolerance` where it grows with what is measured,
        in the style of flight-simulator qualification (14 CFR Part 60): the part of the samples within is reported, and
        the bands are drawn.
        ``time_limit``: in seconds; what is found anew then is the best so far, which ``status`` and a warning say.

        Raises ModelError, DataError or OptionError for what cannot be right: unknown names, an experiment without the
        model's channels or with fewer samples than unknowns. An experiment that the fit was
        made on, and a fit that has not converged, are among the ``warnings`` of the result.
        """
        from .validation.validate import validate

        return validate(self, other, biases=biases, values=values, tolerances=tolerances, time_limit=time_limit)

    def report(
        self,
        path: str | os.PathLike[str],
        *,
        validation: Validation | None = None,
        files: Sequence[str | os.PathLike[str]] = (),
        command: str = "",
    ) -> None:
        """Writes one HTML page that needs no network: how the fit ended, what to beware of, parameters with standard
        errors, the match of each output in numbers and figures, residuals, equations, the solver's way, data, versions.

        ``validation``: of this fit, as a section. ``files``, such as data and model, are listed with their SHA-256;
        ``command`` is quoted.
        """
        from .report.report import report

        report(self, path, validation=validation, files=files, command=command)

    def export_c(self, folder: str | os.PathLike[str], **options: Any) -> tuple[Path, Path]:
        """Writes the model with the estimates as C source, a header and a source file; returns their paths. Options are
        those of `phugoid.export_c`, which also says what there is in the files."""
        from .export import export_c

        return export_c(self, folder, **options)

    def export_fmu(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Writes the model with the estimates as a functional mock-up unit (FMI 2.0); returns its path. Options are
        those of `phugoid.export_fmu`."""
        from .export import export_fmu

        return export_fmu(self, path, **options)

    def to_pandas(self) -> pandas.DataFrame:
        """The parameters, a row each; see `Estimates.to_pandas`. Time histories: ``fit.records[0].to_pandas()``."""
        return self.parameters.to_pandas()

    def to_xarray(self) -> xarray.Dataset:
        """Time histories of all experiments, estimates and covariance, with units among the attributes.

        Variables are those of `Record.to_xarray`. Several experiments are along ``experiment``, over the times of all
        of them: NaN where one has no sample. Raises MissingDependency without xarray.
        """
        return tabular.fit_dataset(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the fit with its data to a versioned file, which `load` reads: HDF5 for ``.h5`` and ``.hdf5``, where
        arrays are datasets with units (extra ``hdf5``); JSON else. Raises DataError where that cannot be done."""
        from .saving.fit_file import save

        save(self, path)

    def __repr__(self) -> str:
        return (
            f"<Fit of '{self.model.name}': {self.status}, log-likelihood {self.log_likelihood:.6g}, "
            f"{len(self.parameters)} parameters>"
        )

    def __str__(self) -> str:
        return self.summary()
