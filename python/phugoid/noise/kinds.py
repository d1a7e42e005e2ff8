"""Noise that differs between outputs or experiments, and noise read from a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from .. import _core
from .._core import Expr
from ..errors import ModelError
from ..parameters import Parameter
from .densities import Density, Huber, Laplace, StudentT
from .noise import KINDS, Gaussian, Noise, Sigma, saved_sigma

__all__ = ["PerExperiment", "PerOutput", "noise_from_dict", "stated_noise"]


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
            f"noise: the model has {before.kind} noise for all outputs; give the whole noise model anew, with sigma"
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
