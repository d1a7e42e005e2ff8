"""Noise densities for measurements with outliers, those that the user writes (the metrics of Dutra 2019), and
noise that differs between outputs or experiments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import phugoid._core as _core

from .._core import Expr
from ..errors import ModelError, did_you_mean
from ..parameters import Parameter
from .noise import KINDS, Gaussian, Noise, Sigma, positive, saved_sigma

__all__ = ["Density", "Huber", "Laplace", "PerExperiment", "PerOutput", "StudentT", "noise_from_dict", "stated_noise"]


@dataclass(frozen=True)
class StudentT(Noise):
    """Student's t noise, independent on each output: heavy tails, so that outliers have little influence.

    ``sigma`` as for `Gaussian`; it is the scale of the density: the standard deviation is sigma sqrt(dof/(dof - 2)) for
    dof > 2.
    ``dof``: degrees of freedom: a number (known, the same for all outputs), None (unknown, estimated for each output as
    ``dof_<output>``), or either of them by output name. Few degrees of freedom mean heavy tails, many mean nearly
    Gaussian noise.
    ``bounds``: of unknown degrees of freedom. At the upper bound the noise is not distinguishable from Gaussian noise.
    """

    dof: float | Mapping[str, float | None] | None = 4.0
    bounds: tuple[float, float] = (1.0, 100.0)
    kind: ClassVar[str] = "student t"

    def __post_init__(self) -> None:
        super().__post_init__()
        by_name = self.dof if isinstance(self.dof, Mapping) else {"": self.dof}
        for name, dof in by_name.items():
            if dof is not None and not positive(dof):
                of = f" of '{name}'" if name else ""
                raise ModelError(f"StudentT: dof{of} is a positive number, or None where unknown, not {dof!r}")
        try:
            low, high = self.bounds
            sound = positive(low) and positive(high) and low < high
        except (TypeError, ValueError):
            sound = False
        if not sound:
            raise ModelError(f"StudentT: bounds of dof are a positive pair that increases, not {self.bounds!r}")
        object.__setattr__(self, "bounds", (float(low), float(high)))
        plain = {name: None if dof is None else float(dof) for name, dof in by_name.items()}
        object.__setattr__(self, "dof", plain if isinstance(self.dof, Mapping) else plain[""])

    def _dof(self, output: str) -> float | None:
        # An output that is not named has the default.
        return self.dof.get(output, 4.0) if isinstance(self.dof, Mapping) else self.dof

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return ``sigma_<output>``, then ``dof_<output>``."""
        return super().names(outputs) + tuple(f"dof_{name}" for name in outputs if self._dof(name) is None)

    @property
    def description(self) -> str:
        """The density, and the meaning of sigma."""
        dof = f"{self.dof:g} degrees of freedom" if isinstance(self.dof, float) else "degrees of freedom estimated"
        dof = "degrees of freedom by output" if isinstance(self.dof, Mapping) else dof
        return f"Student's t, {dof}; sigma is its scale"

    def saved(self, outputs: Sequence[str]) -> str:
        """Return the noise as the core reads it. Raises ModelError for names that are not outputs."""
        for name in self.dof if isinstance(self.dof, Mapping) else ():
            if name not in outputs:
                raise ModelError(f"StudentT: dof of '{name}', which is not an output.{did_you_mean(name, outputs)}")
        return super().saved(outputs)


@dataclass(frozen=True)
class Huber(Noise):
    """Noise that is Gaussian up to ``k`` times its scale and exponential beyond (Huber, 1964), independent on each
    output: least squares for small residuals, absolute values for large ones.

    ``sigma`` as for `Gaussian`; it is the scale of the density, and the standard deviation of its middle.
    ``k``: the default 1.345 keeps 95 % of the efficiency of least squares where noise is Gaussian.
    """

    k: float = 1.345
    kind: ClassVar[str] = "huber"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not positive(self.k):
            raise ModelError(f"Huber: k is a positive number, not {self.k!r}")

    @property
    def description(self) -> str:
        """The density, and the meaning of sigma."""
        return f"Huber's, k = {self.k:g}; sigma is its scale"


@dataclass(frozen=True)
class Laplace(Noise):
    """Laplace's noise, independent on each output: estimates minimise the sum of absolute residuals, but for a
    smooth bottom, sqrt(e**2 + smoothing**2) instead of abs(e), e = residual / sigma.

    ``sigma`` as for `Gaussian`; it is the scale of the density, which without smoothing is the mean absolute residual
    (the standard deviation is sqrt(2) times that).
    ``smoothing``: the smaller it is, the nearer the density is to Laplace's, and the more iterations are needed.
    Standard errors come from the curvature, which only residuals below it contribute to: they are rough where it is
    small.
    """

    smoothing: float = 0.1
    kind: ClassVar[str] = "laplace"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not positive(self.smoothing):
            raise ModelError(f"Laplace: smoothing is a positive number, not {self.smoothing!r}")

    @property
    def description(self) -> str:
        """The density, and the meaning of sigma."""
        return f"Laplace's, smoothing {self.smoothing:g}; sigma is its scale"


@dataclass(frozen=True, init=False)
class Density(Noise):
    """Noise with a log-density that you write, independent on each output.

    ``log_density``: a function of the symbols of the residual (measured minus model), of its scale sigma, and, by name,
    of the parameters; or an expression in symbols of these names (``residual``, ``sigma``, ...).
    ``parameters``: name -> start, or a `Parameter` with bounds, of the density itself. Every output has its own,
    estimated as ``<name>_<output>``.
    ``sigma`` as for `Gaussian`. A log-density that does not depend on sigma needs known ones: ``sigma={"q": 1.0}``.

    The log-density must be normalised by the user: its integral over the residual may be any constant, but where it
    depends on an unknown sigma or on parameters, the estimates are wrong. ``log_likelihood`` compares with that of
    other noise when the integral is sqrt(2 pi). Convergence is best where the density falls off on both sides of 0.

    >>> from phugoid import exp, log
    >>> cauchy = Density(lambda r, sigma: -log(1 + (r/sigma)**2) - log(sigma))
    >>> good = lambda e: exp(-e**2/2)
    >>> def some_bad(r, sigma, share):
    ...     return log((1 - share)*good(r/sigma) + share/10*good(r/(10*sigma))) - log(sigma)
    >>> with_outliers = Density(some_bad, parameters={"share": Parameter(0.05, bounds=(0.001, 0.5))})
    >>> with_outliers.names(["q"])
    ('sigma_q', 'share_q')
    """

    log_density: Any = None
    parameters: Mapping[str, Parameter | float] = field(default_factory=dict)
    kind: ClassVar[str] = "custom"

    def __init__(
        self,
        log_density: Callable[..., Any] | Expr,
        sigma: Mapping[str, float | Sigma | Expr] | None = None,
        parameters: Mapping[str, Parameter | float] | None = None,
    ) -> None:
        object.__setattr__(self, "sigma", {} if sigma is None else sigma)
        super().__post_init__()
        given = {} if parameters is None else parameters
        if not isinstance(given, Mapping):
            raise ModelError(f"Density: parameters are given by name, not as {given!r}")
        declared: dict[str, Parameter] = {}
        for name, value in given.items():
            if not str(name).isidentifier() or name in ("residual", "sigma"):
                raise ModelError(f"Density: {name!r} cannot be the name of a parameter")
            try:
                declared[name] = value if isinstance(value, Parameter) else Parameter(value)
            except ModelError as error:
                raise ModelError(f"Density: parameter '{name}': {error}") from None
            if declared[name].prior is not None:
                raise ModelError(f"Density: the parameter '{name}' has a prior, which parameters of noise cannot have")
        object.__setattr__(self, "parameters", declared)
        expression: Any = log_density
        if not isinstance(log_density, Expr):
            if not callable(log_density):
                raise ModelError(f"Density: log_density is a function of residual and sigma, not {log_density!r}")
            symbols = {name: Expr.symbol(name) for name in declared}
            expression = log_density(Expr.symbol("residual"), Expr.symbol("sigma"), **symbols)
            if not isinstance(expression, Expr):
                raise ModelError(f"Density: log_density returned {expression!r}, not an expression of its symbols")
        object.__setattr__(self, "log_density", expression)

    def _free(self) -> dict[str, Parameter]:
        return {name: p for name, p in self.parameters.items() if isinstance(p, Parameter) and not p.fixed}

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return ``sigma_<output>``, then the parameters of each output."""
        return super().names(outputs) + tuple(f"{p}_{name}" for name in outputs for p in self._free())

    @property
    def description(self) -> str:
        """The density, and the meaning of sigma."""
        return f"log-density {self.log_density}; sigma is its scale"

    def to_dict(self) -> dict[str, Any]:
        """Return the noise as JSON takes it."""
        declared = {
            # JSON has no infinity.
            name: [p.start, *(None if abs(b) == float("inf") else b for b in p.bounds), p.unit, p.fixed]
            for name, p in self.parameters.items()
            if isinstance(p, Parameter)
        }
        return {**super().to_dict(), "log_density": self.log_density.to_json(), "parameters": declared}


@dataclass(frozen=True, init=False)
class PerOutput(Noise):
    """Independent noise of a different kind on different outputs.

    ``outputs``: name -> `Gaussian`, `StudentT`, `Huber`, `Laplace` or `Density`; those not named have Gaussian noise.
    ``sigma`` is taken from each: ``PerOutput({"az": StudentT({"az": 0.05})})``.
    """

    outputs: Mapping[str, Noise] = field(default_factory=dict)
    kind: ClassVar[str] = "per output"

    def __init__(self, outputs: Mapping[str, Noise], sigma: Mapping[str, float | Sigma | Expr] | None = None) -> None:
        if not isinstance(outputs, Mapping):
            raise ModelError(f"PerOutput: give noise by output, such as {{'az': StudentT()}}, not {outputs!r}")
        scales = dict(sigma or {})
        for name, noise in outputs.items():
            joint = isinstance(noise, Gaussian) and (noise.correlated or noise.covariance is not None)
            if not isinstance(noise, Noise) or isinstance(noise, PerOutput) or joint:
                raise ModelError(f"PerOutput: the noise of '{name}' is an independent noise model, not {noise!r}")
            if name in noise.sigma:
                scales[name] = noise.sigma[name]
        object.__setattr__(self, "sigma", scales)
        object.__setattr__(self, "outputs", dict(outputs))
        super().__post_init__()

    def of(self, output: str) -> Noise:
        """Return the noise of one output."""
        return self.outputs.get(output, Gaussian())

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return ``sigma_<output>``, then the parameters of the densities."""
        own = (n for name in outputs for n in self.of(name).names([name]) if n != f"sigma_{name}")
        return super().names(outputs) + tuple(own)

    @property
    def description(self) -> str:
        """The noise of each output."""
        return "; ".join(f"{name}: {noise.description or 'Gaussian'}" for name, noise in self.outputs.items())

    def to_dict(self) -> dict[str, Any]:
        """Return the noise as JSON takes it."""
        return {**super().to_dict(), "outputs": {name: noise.to_dict() for name, noise in self.outputs.items()}}


@dataclass(frozen=True, init=False)
class PerExperiment(Noise):
    """Noise of one kind whose scales, correlations and other parameters each experiment has of its own.

    ``noise``: any other noise model. The fit calls its parameters ``sigma_<output>[<experiment>]``; known ones are the
    same everywhere.
    """

    noise: Noise = field(default_factory=Gaussian)
    kind: ClassVar[str] = "per experiment"

    def __init__(self, noise: Noise | None = None) -> None:
        noise = Gaussian() if noise is None else noise
        if not isinstance(noise, Noise) or isinstance(noise, PerExperiment):
            raise ModelError(f"PerExperiment: give another noise model, such as Gaussian(), not {noise!r}")
        object.__setattr__(self, "sigma", dict(noise.sigma))
        object.__setattr__(self, "noise", noise)
        super().__post_init__()

    def known_sigmas(self, outputs: Sequence[str]) -> dict[str, float]:
        """Return the known scales of the inner noise."""
        return self.noise.known_sigmas(outputs)

    def names(self, outputs: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the inner noise: starts are for all experiments."""
        return self.noise.names(outputs)

    @property
    def description(self) -> str:
        """The noise of each experiment."""
        return f"{self.noise.description or 'Gaussian'}, of each experiment its own"

    def to_dict(self) -> dict[str, Any]:
        """Return the noise as JSON takes it."""
        return {"kind": self.kind, "noise": self.noise.to_dict()}


def stated_noise(before: Noise, args: Sequence[Noise], sigma: Mapping[str, float | Sigma | Expr | Noise]) -> Noise:
    """Return the noise of a model that had ``before``, for what `Model.noise` is given."""
    if (args and sigma) or len(args) > 1:
        raise ModelError("noise: give a noise model or standard deviations by output, not both")
    if args and not isinstance(args[0], Noise):
        raise ModelError(f"noise: a noise model is {KINDS}, not {args[0]!r}; name outputs, as in noise(q=0.01)")
    if args:
        return args[0]
    densities = dict(before.outputs) if isinstance(before, PerOutput) else {}
    densities |= {name: noise for name, noise in sigma.items() if isinstance(noise, Noise)}
    scales = {name: s for name, s in sigma.items() if not isinstance(s, Noise)}
    joint = isinstance(before, Gaussian) and (before.correlated or before.covariance is not None)
    if joint or not isinstance(before, (Gaussian, PerOutput)):
        raise ModelError(
            f"noise: the model has {before.kind} noise for all outputs; give the complete noise model, with sigma"
        )
    scales = {**before.sigma, **scales}
    return PerOutput(densities, scales) if densities else Gaussian(scales)


def noise_from_dict(saved: Mapping[str, Any]) -> Noise:
    """Read the result of `to_dict` of any noise model. Raises ModelError for an unknown kind."""
    kind = saved.get("kind")
    if not isinstance(kind, str) or kind == Gaussian.kind:
        return Gaussian.from_dict(saved)
    if kind == PerExperiment.kind:
        return PerExperiment(noise_from_dict(saved["noise"]))
    sigma = saved_sigma(saved["sigma"])
    if kind == StudentT.kind:
        return StudentT(sigma, saved["dof"], tuple(saved["bounds"]))
    if kind == Huber.kind:
        return Huber(sigma, saved["k"])
    if kind == Laplace.kind:
        return Laplace(sigma, saved["smoothing"])
    if kind == PerOutput.kind:
        return PerOutput({name: noise_from_dict(n) for name, n in saved["outputs"].items()}, sigma)
    if kind == Density.kind:

        def parameter(start: float, low: float | None, high: float | None, unit: str, fixed: bool) -> Parameter:
            bounds = (-float("inf") if low is None else low, float("inf") if high is None else high)
            return Parameter(start, bounds, unit, fixed=fixed)

        parameters = {name: parameter(*p) for name, p in saved["parameters"].items()}
        return Density(_core.load_expression(saved["log_density"]), sigma, parameters)
    raise ModelError(f"noise of kind '{kind}' is not known; was it saved by a newer version?")
