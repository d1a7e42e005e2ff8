"""A fit with the functions on it as methods: what `estimate` returns.

A method imports its function when it is called: all of them take several times as long to import as an estimation
takes.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .fit_result import FitResult

if TYPE_CHECKING:
    from concurrent.futures import Executor

    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ._core import Expr
    from .data.experiment import Experiment
    from .diagnosis import Diagnosis, Improvement
    from .discrepancy.misfit.misfit import Misfit
    from .estimation.starts import Outcome
    from .goodness_of_fit import Tolerance
    from .parameters import Estimates
    from .records import Record
    from .simulation import IntegrationError
    from .solvers import Iteration
    from .uncertainty.bands import Bands
    from .uncertainty.bootstrap import Bootstrap
    from .uncertainty.coloured import CorrectedErrors
    from .uncertainty.correlation import Correlation
    from .uncertainty.profile import Profiles
    from .validation import Validation

__all__ = ["Fit"]


class Fit(FitResult):
    """The result of `estimate`: the data, which `FitResult` explains, and the functions on a fit as methods."""

    def derived(self, **expressions: Expr) -> Estimates:
        """Return estimates of expressions in the parameters, with standard errors to first order (the delta method).

        ``fit.derived(natural_frequency=sqrt(k / mass))``; a quantity of the model is given by its expression,
        ``fit.derived(static_margin=fit.model.equations["static_margin"])``. Raises ModelError for other symbols.
        """
        from .parameters import derived

        return derived(self.parameters, self.covariance, expressions)

    def conf_int(self, level: float = 0.95, *, robust: bool = False) -> dict[str, tuple[float, float]]:
        """Return the intervals of the free parameters at a confidence level, from their standard errors; with
        ``robust`` from those of `robust`. `profile` gives intervals where the likelihood is not a parabola.

        Raises OptionError for a level that is not between 0 and 1.
        """
        return (self.robust().parameters if robust else self.parameters).conf_int(level)

    def robust(self) -> CorrectedErrors:
        """Return standard errors corrected for autocorrelated residuals: of parameters and initial states, by name; the
        covariance; and the ratios to the plain standard errors.

        The Cramér-Rao bounds in ``parameters`` assume white residuals; where residuals are autocorrelated, as those of
        flight records are, these bounds are optimistic (Maine & Iliff 1981; Morelli & Klein 1997). The noise of each
        output is modelled as an autoregressive process, with cross-correlations between outputs. A fit by shooting, or
        one without its solution (from a file of version 1), is estimated again by collocation first.

        Raises OptionError for a fit by the filter-error method.
        """
        from .uncertainty.coloured import coloured

        return coloured(self)

    @property
    def coloured(self) -> CorrectedErrors:
        """The result of `robust`. This property is removed in the next release."""
        from .uncertainty.coloured import coloured

        warnings.warn("Fit.coloured is now the method Fit.robust()", DeprecationWarning, stacklevel=2)
        return coloured(self)

    def misfit(self) -> Misfit:
        """Return the misfit of the model, by output: when, in which regime, at which frequencies it is large; see
        `phugoid.misfit`."""
        from .discrepancy.misfit.misfit import misfit

        return misfit(self)

    def diagnose(self, candidates: Any = None, validation: Any = None, **options: Any) -> Diagnosis[Fit]:
        """Find what the model is missing; see `phugoid.diagnose`, which has the same arguments."""
        from .diagnosis import Diagnosis
        from .discrepancy.diagnose import diagnose

        return Diagnosis._of(diagnose(self, candidates, validation, **options), Fit)

    def improve(self, validation: Any = None, **options: Any) -> Improvement[Fit]:
        """Diagnose and extend the model until nothing more is named; see `phugoid.improve`, which has the same
        arguments."""
        from .diagnosis import Improvement
        from .discrepancy.improve import improve

        return Improvement._of(improve(self, validation, **options), Fit)

    def predict(self, data: Experiment, values: Mapping[str, float] | None = None, **options: Any) -> Record:
        """Return the outputs and states of the fitted model over the inputs of an experiment, simulated from its first
        sample; see `phugoid.simulate`, which has the same options (``initial``, ``method``, ``rtol``, ``time_limit``).

        ``values``: name -> value of parameters that are not those of the fit, such as a trim that each experiment has
        its own of. `validate` estimates initial states and biases first.
        """
        from .simulation import simulate

        if not values:
            return simulate(self.model, self, data, **options)
        own = {n: e.value for n, e in self.parameters.items() if n not in self.noise_parameters}
        return simulate(self.model, own | dict(values), data, **options)

    @property
    def correlation(self) -> Correlation:
        """Correlations of the estimates: ``fit.correlation["Cm0", "Cma"]``, ``.matrix`` (n, n), ``.pairs(0.9)``, and
        ``.weak``: combinations that the data hardly determine."""
        from .uncertainty.correlation import correlation

        return correlation(self)

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
        """Return intervals by profile likelihood (Venzon & Moolgavkar 1988): each parameter is moved, all others
        re-estimated, until twice the log-likelihood has dropped by the quantile of chi-square. They follow a likelihood
        that is not a parabola, where standard errors do not.

        ``names``: of parameters of the model (``"b[run1]"`` of one experiment's own); None: all that are free.
        ``coloured``: the drop is enlarged by the factors of `robust`, as for a composite likelihood (Chandler & Bate
        2007); without it, intervals take residuals for white.
        ``executor``, ``progress``: as of `multistart`; a task is one side of a parameter.
        ``time_limit``: in seconds, of the whole.

        An interval ends at a bound where the likelihood is still high there, and is infinite where it stays high at any
        distance: ``.ends`` reports it. Ctrl-C, and the time limit, keep the sides that are done.

        With process noise (`FilterError`) the likelihood is the marginal one, with the intensities re-estimated too.

        Raises OptionError for names without a profile, and a fit that has not converged.
        """
        from .uncertainty.profile import profile

        return profile(
            self, names, level=level, coloured=coloured, executor=executor, progress=progress, time_limit=time_limit
        )

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
        """Return standard errors and intervals from estimates with resampled data (Efron & Tibshirani 1993): the fitted
        model's outputs with other noise, at the samples that were measured.

        ``kind``: "parametric" draws white noise from the fit's noise model; "coloured" Gaussian noise with
        the autocorrelation and cross-correlation of the residuals, as `robust` finds them; "block" puts blocks of the
        residuals themselves together, all channels at once, without reaching over gaps (Künsch 1989).
        ``block``: samples of a block; None: from the correlation time of the noise, a sixth of a record at most.
        ``seed``: draw i has its own random numbers, independent of n and executor.
        ``executor``, ``progress``: as of `multistart`. Each run starts from this fit.
        ``time_limit``: in seconds, of all runs together. It keeps the runs that are done, as Ctrl-C does.

        With process noise (`FilterError`) "parametric" is the only kind: it draws process noise too, so other motions.

        Raises OptionError for invalid options, a fit that has not converged, and a vehicle that other process noise
        would carry far away with the recorded inputs, such as an unstable one with its controller.
        """
        from .uncertainty.bootstrap import bootstrap

        return bootstrap(
            self, n, kind, block=block, seed=seed, executor=executor, progress=progress, time_limit=time_limit
        )

    def prediction_bands(
        self,
        experiment: str | int | Experiment | None = None,
        *,
        level: float = 0.95,
        coloured: bool = True,
        biases: Sequence[str] | None = None,
        values: Mapping[str, float] | None = None,
        progress: bool | Callable[[Iteration], None] = False,
    ) -> Bands:
        """Return bands about the outputs: for the true model's outputs, by the uncertainty of parameters and initial
        states to first order, and for a new measurement, with noise of its own.

        ``experiment``: name or number of one of the fit; None: the only one; or another `Experiment`, of which initial
        states and biases are re-estimated as `validate` does, with ``biases`` and ``values`` as there: their errors
        follow those of the parameters.
        ``coloured``: errors for coloured residuals, or else for white ones. Each band holds at each sample by itself.
        ``progress``: True prints the iterations of this re-estimation; a function is called with each. After Ctrl-C
        there are no bands: KeyboardInterrupt is raised.
        ``.plot()`` draws them.

        With process noise (`FilterError`) they are about the most probable path, which follows the measurements, with
        the variance of the smoother and the uncertainty of the parameters. Innovations are white, ``coloured`` or not.

        Raises OptionError, DataError or UnknownName for invalid arguments.
        """
        from .uncertainty.bands import prediction_bands

        return prediction_bands(
            self, experiment, level=level, coloured=coloured, biases=biases, values=values, progress=progress
        )

    def summary(self) -> str:
        """Return the fit as a plain-text table: for each parameter the Cramér-Rao standard error and, where the fit has
        its data, the one corrected for coloured residuals."""
        from .summary import fit_summary

        return fit_summary(self)

    def integration_error(self) -> tuple[IntegrationError, ...]:
        """Return the error that each segment of the mesh adds to the path, one result for each experiment.

        Raises OptionError for a fit that was not transcribed by collocation.
        """
        from .simulation import integration_error

        return integration_error(self)

    def plot(
        self,
        record: int | str = 0,
        channels: Sequence[str] | None = None,
        tolerances: Mapping[str, float | Tolerance] | None = None,
    ) -> tuple[Figure, dict[str, Axes]]:
        """Plot the proof of match of an experiment: measured points, model, residuals, inputs; see `plot_fit`.

        ``tolerances``: output -> greatest deviation in its unit, or a `Tolerance`, drawn as bands (14 CFR Part 60).
        """
        from .figures.fit import plot_fit

        return plot_fit(self, record, channels, tolerances=tolerances)

    def plot_residuals(
        self, record: int | str = 0, channels: Sequence[str] | None = None
    ) -> tuple[Figure, dict[str, Axes]]:
        """Plot the residuals of an experiment over time, their autocorrelation and their spectrum; see
        `plot_residuals`."""
        from .discrepancy.misfit.residuals_figure import plot_residuals

        return plot_residuals(self, record, channels)

    def plot_parameters(
        self, *others: Any, names: Sequence[str] | None = None, labels: Sequence[str] | None = None
    ) -> tuple[Figure, dict[str, Axes]]:
        """Plot the estimates with 95 % intervals, of this fit or side by side with others; see `plot_parameters`."""
        from .figures.estimates import plot_parameters

        return plot_parameters([self, *others], names, labels)

    def plot_correlation(self, names: Sequence[str] | None = None) -> tuple[Figure, dict[str, Axes]]:
        """Plot the correlation matrix of the estimates as a heat map; see `plot_correlation`."""
        from .uncertainty.correlation import plot_correlation

        return plot_correlation(self, names)

    def plot_convergence(self) -> tuple[Figure, dict[str, Axes]]:
        """Plot log-likelihood, defects, distance from the optimum and step of every iteration; see
        `plot_convergence`."""
        from .figures.estimates import plot_convergence

        return plot_convergence(self)

    def validate(
        self,
        other: Experiment | Sequence[Experiment],
        *,
        biases: Sequence[str] | None = None,
        values: Mapping[str, float] | None = None,
        tolerances: Mapping[str, float | Tolerance] | None = None,
        initial_samples: int | None = None,
        progress: bool | Callable[[Iteration], None] = False,
        time_limit: float | None = None,
    ) -> Validation:
        """Validate the fitted model on other experiments: only initial states and biases are re-estimated.

        Parameters and noise are fixed at this fit, so that log-likelihoods on the same experiments compare; the
        transcription is that of the fit. Gaps, delays and channels with times of their own are as in `estimate`.

        ``biases``: the parameters that are re-estimated, with bounds and priors as declared. None: parameters that
        enter outputs only, each as a term with a constant coefficient, as a sensor's bias does; those declared fixed
        stay. Names of parameters of any kind: these; () for none. A parameter with ``per_experiment`` has one value an
        experiment here too, any other one for all.
        ``values``: name -> value of parameters to fix elsewhere than at the fit. A parameter with ``per_experiment``
        that is not a bias needs one, or must be named in ``biases``.
        ``tolerances``: output -> greatest deviation in its unit, or a `Tolerance` where it grows with what is measured,
        in the style of flight-simulator qualification (14 CFR Part 60): the part of the samples within is reported, and
        the bands are drawn.
        ``initial_samples``: initial states and biases are re-estimated from so many samples at the beginning of each
        experiment, and the model is simulated from there on; ``log_likelihood`` is that of these samples. None: from
        all samples.
        ``progress``: True prints the iterations; a function is called with each.
        ``time_limit``: in seconds; the result is then the best point so far, as after Ctrl-C, which ``status`` and a
        warning say.

        Raises ModelError, DataError or OptionError for invalid arguments: unknown names, an experiment without the
        model's channels or with fewer samples than unknowns. An experiment that the fit was made on, and a fit that has
        not converged, are among the ``warnings`` of the result.
        """
        from .validation import validate

        return validate(
            self,
            other,
            biases=biases,
            values=values,
            tolerances=tolerances,
            initial_samples=initial_samples,
            progress=progress,
            time_limit=time_limit,
        )

    def report(
        self,
        path: str | os.PathLike[str],
        *,
        validation: Validation | None = None,
        files: Sequence[str | os.PathLike[str]] = (),
        command: str = "",
    ) -> None:
        """Write one HTML page that needs no network: how the fit ended, warnings, parameters with standard errors, the
        goodness of fit of each output in numbers and figures, residuals, equations, convergence, data, versions.

        ``validation``: of this fit, as a section. ``files``, such as data and model, are listed with their SHA-256;
        ``command`` is quoted.
        """
        from .report import report

        report(self, path, validation=validation, files=files, command=command)

    def export_c(self, folder: str | os.PathLike[str], **options: Any) -> tuple[Path, Path]:
        """Write the model with the estimates as C source, a header and a source file; return their paths. Options and
        content of the files are those of `phugoid.export_c`."""
        from .export import export_c

        return export_c(self, folder, **options)

    def export_fmu(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write the model with the estimates as a functional mock-up unit (FMI 2.0); return its path. Options are those
        of `phugoid.export_fmu`."""
        from .export.fmu import export_fmu

        return export_fmu(self, path, **options)

    def to_pandas(self) -> pandas.DataFrame:
        """Return the parameters, one row each; see `Estimates.to_pandas`. Time histories:
        ``fit.records[0].to_pandas()``."""
        return self.parameters.to_pandas()

    def to_xarray(self) -> xarray.Dataset:
        """Return time histories of all experiments, estimates and covariance, with units among the attributes.

        Variables are those of `Record.to_xarray`. Several experiments are along ``experiment``, over the times of all
        of them: NaN where one has no sample. Raises MissingDependency without xarray.
        """
        from .tabular import fit_dataset

        facts = {"log_likelihood": self.log_likelihood, "status": self.status, "model": self.model.name}
        return fit_dataset(self.records, self.parameters, self.covariance, facts)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the fit with its data to a versioned file, which `load` reads: HDF5 for ``.h5`` and ``.hdf5``, where
        arrays are datasets with units (extra ``hdf5``); JSON otherwise. Raises DataError where that is impossible."""
        from .saving import save

        save(self, path)

    def _repr_html_(self) -> str:
        from .summary import fit_html

        return fit_html(self)

    def __str__(self) -> str:
        return self.summary()
