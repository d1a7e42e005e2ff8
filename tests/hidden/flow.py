"""How a system moves with effects in it, by numpy and scipy alone.

Inputs run linearly between samples; before the first they are constant. The order on the way of an input into the
equations: delay, lag, saturation, dead-band, then scale and bias; on the way of an output to its sample: terms, scale,
bias and drift, then delay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from .effect import Part, term
from .system import System, Vehicle

__all__ = ["Flow"]

METHOD, TOLERANCE = "RK45", 1e-8
FAR = 100.0
"""A motion that exceeds a limit of its states so many times has left them for good."""


class Flow:
    """A system with numbers in it over the inputs of a record, plain or in lanes.

    ``parameters`` are floats, or arrays of one value a lane; so are coefficients of ``parts``. ``inputs`` (name ->
    (N,)) are sampled at ``system.t``.
    """

    def __init__(
        self,
        system: System,
        vehicle: Vehicle,
        inputs: Mapping[str, np.ndarray],
        parts: Sequence[Part] = (),
        parameters: Mapping[str, Any] | None = None,
    ) -> None:
        self.system, self.p = system, parameters or vehicle.parameters
        self.t = system.t
        self.samples = [np.asarray(inputs[name]) for name in system.inputs]
        self.lists = [u.tolist() for u in self.samples]
        self.input_trim = [vehicle.inputs[name] for name in system.inputs]
        states, names = list(system.states), list(system.inputs)
        self.terms: dict[str, list[Callable[[float, Sequence[Any], Sequence[Any], Sequence[Any]], Any]]] = {}
        self.on_input: list[list[Part]] = [[] for _ in names]
        self.delayed: dict[str, Any] = {}
        self.drifts: dict[str, Any] = {}
        self.lags: list[tuple[Any, str, int]] = []  # time constant, what is lagged: "state" or "input", its number
        self.lag_of: dict[int, int] = {}  # input that acts lagged -> its lag
        trim = [vehicle.states[n] for n in states] + self.input_trim
        for part in parts:
            e, c = part.effect, part.coefficient
            if e.where in names:
                i = names.index(e.where)
                self.on_input[i].append(part)
                if e.form == "lag":
                    self.lag_of[i] = len(self.lags)
                    self.lags.append((c, "input", i))
            elif e.form == "delay":
                self.delayed[e.where] = c
            elif e.form == "lagged":
                number, of = len(self.lags), e.what.removeprefix("lag_")
                kind, among = ("state", states) if of in states else ("input", names)
                self.lags.append((part.shape["tau"], kind, among.index(of)))
                centre = (vehicle.states | vehicle.inputs)[of]
                self._add(e.where, lambda now, x, u, lag, c=c, k=number, a=centre: c * (lag[k] - a))
            elif e.form == "periodic":
                w, phase = 2 * np.pi * part.shape["frequency"], part.shape["phase"]
                self._add(e.where, lambda now, x, u, lag, c=c, w=w, phase=phase: c * np.sin(w * now + phase))
            elif e.form in ("scale", "bias", "drift"):
                self.drifts[e.where] = (e.form, c)
            else:
                product = term(e.what, [*states, *names], trim, system.steep)
                self._add(e.where, lambda now, x, u, lag, c=c, f=product: c * f([*x, *u]))

    def _add(self, where: str, signal: Callable[..., Any]) -> None:
        self.terms.setdefault(where, []).append(signal)

    def _plus(self, where: str, value: Any, *at: Any) -> Any:
        for signal in self.terms.get(where, ()):
            value = value + signal(*at)
        return value

    def _sampled(self, i: int, now: Any) -> Any:
        """Input ``i`` as recorded, at times of any shape."""
        if not isinstance(now, float):
            return np.interp(now, self.t, self.samples[i])
        share = now / self.system.step
        k = int(share)
        u = self.lists[i]
        if share <= 0.0 or k + 1 >= len(u):
            return u[0] if share <= 0.0 else u[-1]
        return u[k] + (share - k) * (u[k + 1] - u[k])

    def _commanded(self, i: int, now: Any) -> Any:
        """It with its delay."""
        late = [part.coefficient for part in self.on_input[i] if part.effect.form == "delay"]
        return self._sampled(i, now - late[0] if late else now)

    def _inputs(self, now: Any, lag: Sequence[Any]) -> list[Any]:
        """Inputs as they act."""
        found = []
        for i, parts in enumerate(self.on_input):
            u = self._commanded(i, now)
            for part in parts:
                form, c, d = part.effect.form, part.coefficient, u - self.input_trim[i]
                if form == "lag":
                    u = lag[self.lag_of[i]]
                elif form == "saturation":
                    u = self.input_trim[i] + np.minimum(np.maximum(d, -c), c)
                elif form == "deadband":
                    u = self.input_trim[i] + np.maximum(d - c, 0.0) + np.minimum(d + c, 0.0)
                elif form == "scale":
                    u = u * (1 + c)
                elif form == "bias":
                    u = u + c
            found.append(u)
        return found

    def _quantities(self, at: tuple[Any, ...]) -> dict[str, Any]:
        _, x, u, _ = at
        return {name: self._plus(name, q, *at) for name, q in self.system.quantities(x, u, self.p).items()}

    def rhs(self, now: float, z: Sequence[Any]) -> list[Any]:
        """Derivatives of the states and of the lags that follow them."""
        n = len(self.system.states)
        z = z.tolist() if isinstance(z, np.ndarray) and z.ndim == 1 else z  # plain floats are quicker
        x, lag = z[:n], z[n:]
        u = self._inputs(now, lag)
        at = now, x, u, lag
        f = self.system.dynamics(x, u, self._quantities(at), self.p)
        if self.terms:
            f = [self._plus(f"{name}'", slope, *at) for name, slope in zip(self.system.states, f, strict=True)]
        for k, (tau, kind, i) in enumerate(self.lags):
            f.append(((x[i] if kind == "state" else self._commanded(i, now)) - lag[k]) / tau)
        return f

    def start(self, x0: Sequence[Any]) -> list[Any]:
        """States and lags at time 0, lags steady."""
        return [*x0, *(x0[i] if kind == "state" else self._sampled(i, 0.0) for _, kind, i in self.lags)]

    def outputs(self, path: Callable[[Any], Sequence[Any]], t: np.ndarray) -> dict[str, Any]:
        """Samples of the outputs, noise-free; ``path`` gives states and lags at times."""

        def at(times: Any) -> dict[str, Any]:
            n = len(self.system.states)
            z = path(times)
            x, lag = z[:n], z[n:]
            here = times, x, self._inputs(times, lag), lag
            measured = self.system.measured(x, here[2], self._quantities(here), self.p)
            found = {name: self._plus(name, y, *here) for name, y in measured.items()}
            for name, (form, c) in self.drifts.items():
                y = found[name]
                found[name] = y * (1 + c) if form == "scale" else y + c if form == "bias" else y + c * times
            return found

        late = {name: at(t - tau)[name] for name, tau in self.delayed.items()}
        return at(t) | late

    def truth(self, x0: Sequence[float]) -> dict[str, np.ndarray]:
        """Outputs name -> (N,), integrated by scipy to a thousandth of the noise; NaN where the motion diverges.

        The motion came the same way.
        """
        z0 = np.array(self.start([float(x) for x in x0]))
        far = list(self.system.limits.values())
        far += [far[i] if kind == "state" else abs(z0[len(far)]) + 1e-3 for _, kind, i in self.lags]
        options = {"method": METHOD, "rtol": TOLERANCE, "atol": TOLERANCE * np.array(far), "dense_output": True}
        options["max_step"] = 0.9 * self.system.step
        sizes = np.maximum(np.abs(z0), far)

        def left(_: float, z: np.ndarray) -> float:
            return FAR - float(np.max(np.abs(z) / sizes))

        left.terminal = True  # type: ignore[attr-defined]
        forward = solve_ivp(self.rhs, (0.0, self.t[-1]), z0, events=left, **options)
        if forward.status != 0:
            return {name: np.full(self.t.size, np.nan) for name in self.system.outputs}
        forward = forward.sol
        if not self.delayed:
            return self.outputs(forward, self.t)
        before = solve_ivp(self.rhs, (0.0, -max(self.delayed.values()) - 1e-6), z0, **options).sol
        return self.outputs(lambda times: np.where(times >= 0, forward(times), before(times)), self.t)

    def states(self, x0: Sequence[float]) -> dict[str, np.ndarray]:
        """States name -> (N,), by the quicker rule of `lanes`."""
        z0, steps = np.array(self.start(x0))[:, None], self.system.substeps
        z = self._march(z0, 0.0, self.system.step / steps, steps * (self.t.size - 1))[::steps]
        return {name: z[:, i, 0] for i, name in enumerate(self.system.states)}

    def lanes(self, x0: Sequence[Any], count: int) -> dict[str, np.ndarray]:
        """Outputs name -> (N, count), all lanes at once by Runge and Kutta's fourth-order rule."""
        # The rule is stable for steps of up to 2.8 time constants.
        fastest = min((float(np.min(tau)) for tau, *_ in self.lags), default=np.inf)
        steps = max(self.system.substeps, int(np.ceil(self.system.step / (2 * fastest))))
        h = self.system.step / steps
        back = int(np.ceil(max((float(np.max(tau)) for tau in self.delayed.values()), default=0.0) / h))
        z0 = np.array([np.broadcast_to(z, count) for z in self.start(x0)], dtype=float)
        column = self.t[:, None]
        there = self._march(z0, 0.0, h, steps * (self.t.size - 1))
        f = None
        if back:
            z = np.concatenate([self._march(z0, 0.0, -h, back)[:0:-1], there])
            times = h * np.arange(-back, there.shape[0])
            f = np.array([np.broadcast_to(self.rhs(float(now), each), z0.shape) for now, each in zip(times, z)])  # noqa: B905
        else:
            z = there

        def path(times: Any) -> Any:
            if times is column:
                return np.moveaxis(z[back::steps], 1, 0)
            share = times / h + back
            k = np.clip(share.astype(int), 0, z.shape[0] - 2)
            s, lane = share - k, np.arange(count)
            found = []
            for a in range(z.shape[1]):  # Hermite's cubic
                z0, z1, f0, f1 = z[k, a, lane], z[k + 1, a, lane], h * f[k, a, lane], h * f[k + 1, a, lane]
                found.append(z0 + s * (f0 + s * (3 * (z1 - z0) - 2 * f0 - f1 + s * (2 * (z0 - z1) + f0 + f1))))
            return found

        with np.errstate(all="ignore"):
            y = self.outputs(path, column)
        return {name: np.broadcast_to(values, (self.t.size, count)) for name, values in y.items()}

    def _march(self, z0: np.ndarray, begin: float, h: float, steps: int) -> np.ndarray:
        """(steps + 1, states, lanes) from z0 on."""
        z = np.empty((steps + 1, *z0.shape))
        z[0] = z0

        def f(now: float, at: np.ndarray) -> np.ndarray:
            slopes = np.empty_like(z0)
            for i, slope in enumerate(self.rhs(now, at)):
                slopes[i] = slope
            return slopes

        with np.errstate(all="ignore"):  # a lane with too large an effect may diverge
            for k in range(steps):
                now = begin + k * h
                k1 = f(now, z[k])
                k2 = f(now + h / 2, z[k] + h / 2 * k1)
                k3 = f(now + h / 2, z[k] + h / 2 * k2)
                k4 = f(now + h, z[k] + h * k3)
                z[k + 1] = z[k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return z
