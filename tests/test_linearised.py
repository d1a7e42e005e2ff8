"""A fit linearised: the identity of scores, and columns against fits that were made again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import hidden
import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import phugoid as ph
from phugoid import _core, solvers
from phugoid.discrepancy.candidates.candidate import Candidate
from phugoid.frozen_model import freeze_model
from phugoid.initialisation import spread
from phugoid.residual_noise.autoregression import Autoregression
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities.linearised import Linearised
from phugoid.sensitivities.tangents import collocated
from phugoid.sensitivities.whitened import Whitened

SIGMA = {"x": 0.01, "v": 0.02, "a": 0.03}
NOISE = ph.Gaussian(SIGMA)
# Refits are to end at their optimum, not near it.
EXACT = ph.Newton(tolerance=1e-9)


def white(linear: Linearised) -> Whitened:
    """Seen through the noise that was fitted."""
    channels = [Autoregression((np.empty(0),), np.array([sigma**2])) for sigma in linear.sigmas]
    return Whitened(linear, Whitening(channels, linear.structure))


# ---------------------------------------------------------------- scores


def score(fit: ph.Fit, linear: Linearised, candidate: Candidate) -> np.ndarray:
    """dl/dc - lambda' dh/dc at c = 0, by the extended model's own problem: nothing here is the linearisation's.

    Multipliers are those of -l(xi) + lambda' h(xi).
    """
    inner = linear.inner
    model = candidate.extended(linear.model)
    spreads = {name: spread(linear.experiments, name) for name in model.output_names}
    noise = inner.noise.resolve(model.output_names, spreads, inner.as_start(inner.noise))
    assert isinstance(inner.transcription, ph.Collocation) and inner.solution is not None
    old = inner.transcription.problem(linear.model, linear.experiments, noise)
    new = inner.transcription.problem(model, linear.experiments, noise)
    at = dict(zip([name for name, *_ in old.estimands], inner.solution.xi, strict=False))
    names = [name for name, *_ in new.estimands]
    estimands = [at.get(name, 0.0) for name in names]
    xi = np.r_[estimands, inner.solution.xi[len(at) :]]
    assert new.objective(xi) == pytest.approx(old.objective(inner.solution.xi), abs=1e-7)
    gradient, values = new.gradient(xi), new.jacobian(xi)
    assert gradient is not None and values is not None
    rows, columns = new.jacobian_structure()
    np.add.at(gradient, columns, values * inner.solution.multipliers[rows])
    return -gradient[[names.index(c) for c in candidate.coefficients]]


@pytest.mark.parametrize("truth", [(), ("Cm:alpha^2",)], ids=str)
def test_scores_come_from_the_multipliers(truth: tuple[str, ...]) -> None:
    """s = j_perp' R^-1 r for every term of the library, in units of the standard deviation of s."""
    case = hidden.make("hfb320", truth, "medium", "white", 1) if truth else hidden.nothing("hfb320", "white", 2)
    fit = ph.estimate(case.model, case.data, solver=EXACT)
    assert fit.converged
    linear = Linearised(fit)
    seen = white(linear)
    library = ph.candidates(case.model, points=linear.points, equations="all")
    terms = [c for c in library if c.coefficients and not c.shape_names]
    assert len(terms) > 300
    if not truth:
        some = [*terms[::7], *{c.place.kind: c for c in terms}.values()]
        terms = list({c.name: c for c in some}.values())
    assert {c.place.kind for c in terms} == {"quantity", "equation", "output", "input", "parameter"}
    columns, _, groups = linear.columns([(c, {}) for c in terms])
    whole, beside = seen.filter(columns), seen.beside(columns)
    errors = seen.filter(linear.residuals)
    scores = []
    for c, group in zip(terms, groups, strict=True):
        s, size = score(fit, linear, c), np.linalg.norm(whole[group], axis=1)
        assert np.abs(s - whole[group] @ errors).max() < 2e-9 * size.min(), c.name
        assert np.abs(s - beside[group] @ errors).max() < 2e-9 * size.min(), c.name
        scores.append(float(np.abs(s / np.linalg.norm(beside[group], axis=1)).max()))
    # What is hidden has a score that noise has not.
    assert max(scores) > 10.0 if truth else max(scores) < 5.0


# ---------------------------------------------------------------- columns


def smooth(n: int, seed: int = 0) -> np.ndarray:
    u = sosfiltfilt(butter(4, 0.1, output="sos"), np.random.default_rng(seed).standard_normal(n))
    return np.asarray(u / u.std())


def oscillator(*, conditions: bool = False, late: bool = False, **declared: ph.Parameter) -> ph.Model:
    """A mass on a hardening spring, of which the acceleration is measured with a bias."""
    m = ph.Model("oscillator")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N/kg")
    given: dict[str, Any] = {"k": 1.0, "c": 0.1, "h": 0.0, "b": 0.0, "x0": 0.2, **declared}
    given |= {"tau": ph.Parameter(0.0, bounds=(-1.0, 1.0)), "slow": ph.Parameter(0.0)} if late else {}
    if not conditions:
        del given["x0"]
    p = dict(zip(given, m.parameters(**given), strict=True))
    (F,) = m.quantities(F=-p["k"] * x - p["c"] * v - p["h"] * x**3)
    m.dynamics(x=v, v=F + (m.delay(u, p["tau"]) if late else u))
    m.outputs(x=x, v=v, a=F + p["b"])
    if conditions:
        m.initial(x=p["x0"], v=p["x0"] ** 2 - 0.1)
    if late:
        m.sensor_delay(x=p["slow"], a=p["slow"])
    return m


TRUTH = {"k": 2.0, "c": 0.5, "h": 0.3, "b": 0.2}


def record(m: ph.Model, name: str = "run", seed: int = 0, n: int = 200, **values: float) -> ph.Experiment:
    t = 0.1 * np.arange(n)
    # From rest: an input that is late bends where it begins to move, and with it all that follows.
    u = smooth(n, seed) * -np.expm1(-((t / 1.5) ** 4))
    e = ph.Experiment(t, {"u": u}, name=name, interpolation="cubic")
    first = {} if "x0" in m.parameter_names else {"x": 0.3, "v": -0.2}
    path = ph.simulate(m, {**TRUTH, **values}, e, initial=first)
    random = np.random.default_rng(seed + 50)
    return e.with_outputs({name: y + SIGMA[name] * random.standard_normal(n) for name, y in path.outputs.items()})


def matched(fit: ph.Fit, data: Sequence[ph.Experiment]) -> tuple[ph.Fit, list[ph.Experiment]]:
    """The fit to its own outputs, where measured: of residuals that are nothing, Gauss-Newton is Newton."""
    own = []
    for r, e in zip(fit.records, data, strict=True):
        seen = {n: np.where(np.isfinite(e.output(n)), y, np.nan) for n, y in r.outputs.items()}
        own.append(e.with_outputs(seen))
    again = ph.estimate(fit.model, own, noise=fit.noise, start=fit, transcription=fit.transcription, solver=EXACT)
    assert again.converged and max(np.nanmax(np.abs(y)) for r in again.records for y in r.residuals.values()) < 1e-7
    return again, own


def outputs(fit: ph.Fit, data: Sequence[ph.Experiment]) -> np.ndarray:
    """Of all samples that were measured."""
    parts = []
    for name in fit.model.output_names:
        parts += [r.outputs[name][np.isfinite(e.output(name))] for r, e in zip(fit.records, data, strict=True)]
    return np.concatenate(parts)


def of_refits(
    fit: ph.Fit, data: Sequence[ph.Experiment], candidate: Candidate, size: float, free: Sequence[str]
) -> np.ndarray:
    """How the outputs change with the coefficient when free parameters and initial states are estimated again: central
    differences."""
    found = []
    for c in (size, -size):
        model = candidate.extended(fit.model, {candidate.coefficients[0]: c})
        values = {n: e.value for n, e in fit.parameters.items()} | {candidate.coefficients[0]: c}
        held = freeze_model(model, values, free)
        again = ph.estimate(held, data, noise=fit.noise, start=fit, transcription=fit.transcription, solver=EXACT)
        assert again.converged
        found.append(outputs(again, data))
    return (found[0] - found[1]) / (2.0 * size)


def compare(
    fit: ph.Fit, data: list[ph.Experiment], names: Sequence[str], size: float = 1e-3, within: float = 1e-5
) -> Linearised:
    """j_perp against refits, in units of the noise and relative to its largest entry; and the same with parameters as
    they are, where none is an experiment's own."""
    fit, data = matched(fit, data)
    linear = Linearised(fit)
    seen = white(linear)
    library = ph.candidates(fit.model, points=linear.points, equations="all")
    free = [n for n, p in fit.model.declared_parameters.items() if not p.fixed]
    local = any(p.per_experiment for p in fit.model.declared_parameters.values())
    for name in names:
        columns, parameters, _ = linear.columns([(library[name], {})])
        beside = {"all": seen.beside(columns)[0]}
        if not local:  # they cannot be fixed
            beside["states"] = linear.without_states(columns / linear.scale(), parameters)[0]
        for which, found in beside.items():
            changes = of_refits(fit, data, library[name], size, free if which == "all" else [])
            wanted = changes[linear.measured_rows] / linear.scale()
            largest = float(np.abs(wanted).max())
            assert largest > 0.1, f"{name}, {which}: nothing to compare"
            assert np.abs(found - wanted).max() < within * largest, f"{name}, {which}"
    return linear


PLACES = ("F:x*v", "v':x^2", "a:u", "u:scale")


@pytest.mark.parametrize("order", [2, 4])
def test_columns_are_those_of_refits(order: int) -> None:
    m = oscillator()
    data = [record(m)]
    linear = compare(ph.estimate(m, data, noise=NOISE, transcription=ph.Collocation(order=order)), data, PLACES)
    assert linear.tangents.shape == (600, 6)


def test_a_parameter_that_is_fixed_or_at_a_bound_does_not_follow() -> None:
    declared = {"c": ph.Parameter(0.4, fixed=True), "h": ph.Parameter(0.04, bounds=(0.0, 0.05))}
    m, data = oscillator(**declared), [record(oscillator())]
    fit = ph.estimate(m, data, noise=NOISE)
    assert fit.parameters["h"].bounds_active
    # Fitted to its own outputs it would be at its bound by chance: held there it is the same fit.
    held = oscillator(**{**declared, "h": ph.Parameter(0.05, fixed=True)})
    assert compare(ph.estimate(held, data, noise=NOISE), data, PLACES).tangents.shape[1] == 4
    columns, fixed = (
        white(linear).beside(linear.columns([(ph.candidates(m)["F:x*v"], {})])[0])
        for linear in (Linearised(fit), Linearised(ph.estimate(held, data, noise=NOISE)))
    )
    assert columns == pytest.approx(fixed, abs=1e-5 * np.abs(fixed).max())


def test_initial_conditions_are_met() -> None:
    m = oscillator(conditions=True)
    data = [record(m, f"run {i}", i, x0=0.5) for i in range(2)]
    linear = compare(ph.estimate(m, data, noise=NOISE), data, PLACES)
    # Five parameters; initial states are functions of one of them.
    assert linear.tangents.shape[1] == 5


def test_experiments_with_parameters_of_their_own_and_logarithms() -> None:
    m = oscillator(b=ph.Parameter(0.0, per_experiment=True), k=ph.Parameter(1.0, transform="log"))
    lengths, data = (200, 120, 150), []
    for i, n in enumerate(lengths):
        data.append(record(oscillator(), f"run {i}", i, n, b=0.1 * i))
    fit = ph.estimate(m, data, noise=NOISE)
    linear = compare(fit, data, PLACES)
    assert linear.tangents.shape[1] == 3 + 3 + 2 * 3
    # A step of the logarithm, and the standard errors of the fit where noise is white.
    linear = Linearised(fit)
    seen = white(linear)
    for name in ("k", "c", "h", "b[run 0]", "b[run 2]"):
        value, error = seen.parameter(name)
        e = fit.parameters[name]
        assert value == pytest.approx(e.value, abs=1e-3 * e.std_error) and error == pytest.approx(e.std_error, rel=0.02)
    i = linear.place("k")
    step = np.zeros(len(seen.step))
    step[i] = 0.1
    variance = np.zeros((step.size, step.size))
    variance[i, i] = 0.01**2
    k = fit.parameters["k"].value
    assert linear.value("k", step, variance) == pytest.approx((k * np.exp(0.1), k * 0.01))


def test_samples_that_are_missing_leave_the_others_as_they_are() -> None:
    m = oscillator()
    e = record(m)
    x, v = e.output("x").copy(), e.output("v").copy()
    x[30:60], v[1::3] = np.nan, np.nan
    data = [e.with_outputs({"x": x, "v": v, "a": e.output("a")}), record(m, "other", 1)]
    linear = compare(ph.estimate(m, data, noise=NOISE), data, PLACES)
    assert linear.counts == [170 + 200, 133 + 200, 400] and linear.n_rows == linear.n_measured == sum(linear.counts)
    assert np.array_equal(linear.measured_rows, np.arange(linear.n_rows))
    strands, together = linear.structure.segments, linear.structure.together
    # A gap is one in the grid of a channel's times; experiments are apart.
    assert [strand.rows for strand in strands[0]] == [slice(0, 170), slice(170, 370)]
    assert strands[0][0].places.tolist() == [*range(30), *range(60, 200)]
    assert strands[1][0].places.tolist() == [i for i in range(200) if i % 3 != 1]
    assert [strand.rows for strand in strands[2]] == [slice(703, 903), slice(903, 1103)]
    counts = {which: rows.shape[0] for which, rows in together}
    assert counts[0, 1, 2] == 113 + 200 and sum(len(which) * n for which, n in counts.items()) == linear.n_rows
    for which, rows in together:
        assert all(np.ptp(linear.times[line]) == 0.0 for line in rows), which


def test_channels_at_their_own_rates() -> None:
    m, t = oscillator(), np.arange(0, 20, 0.02)
    e = ph.Experiment(t, {"u": smooth(t.size)}, interpolation="cubic")
    path = ph.simulate(m, TRUTH, e, initial={"x": 0.3, "v": 0.0})
    parts = {"x": slice(0, None, 5), "v": slice(3, None, 7), "a": slice(1, None, 11)}
    random = np.random.default_rng(3)
    seen = {n: (t[s], path.outputs[n][s] + SIGMA[n] * random.standard_normal(t[s].size)) for n, s in parts.items()}
    data = [ph.multirate({"u": (t, e.input("u"))}, seen, interpolation="cubic")]
    fit = ph.estimate(m, data, noise=NOISE, transcription=ph.Collocation(order=5))
    linear = compare(fit, data, PLACES)
    assert linear.counts == [t[s].size for s in parts.values()]
    # Each channel is one strand at its own rate; only a few samples of channels fall together.
    assert [[s.runs for s in line] for line in linear.structure.segments] == [[[slice(0, n)]] for n in linear.counts]
    for (first, *_), s in zip(linear.rows, parts.values(), strict=True):
        assert linear.times[first] == pytest.approx(t[s])
    assert sum(rows.size for _, rows in linear.structure.together) == linear.n_rows


def test_what_is_late() -> None:
    """Samples of a late sensor are moved: some are lost, and rows know which are left."""
    m = oscillator(late=True)
    data = [record(m, f"run {i}", i, tau=0.237, slow=0.163) for i in range(2)]
    # The simulation knows nothing of what a late sensor saw before the record: the first samples stand still.
    first = {n: [np.where(np.isfinite(e.output(n)), e.output(n), e.output(n)[2]) for e in data] for n in SIGMA}
    data = [e.with_outputs({n: z[i] for n, z in first.items()}) for i, e in enumerate(data)]
    fit = ph.estimate(m, data, noise=NOISE)
    assert fit.converged
    linear = compare(fit, data, ("F:x*v", "v':x^2", "a:u", "u:scale"))
    late = linear.fit.parameters["slow"].value
    assert linear.counts == [400 - 4, 400, 400 - 4]  # those that reach back are not data of the matched fit
    linear = Linearised(fit)
    assert linear.counts == [400, 400, 400] and linear.n_rows == 3 * 400 - 2 * 4
    measured = np.concatenate([e.t for _ in SIGMA for e in data])[linear.measured_rows]
    delay = measured - linear.times
    x, v = slice(0, 396), slice(396, 796)
    assert delay[x] == pytest.approx(late, abs=1e-4) and np.abs(delay[v]).max() < 1e-9
    assert np.unique(linear.measured_rows).size == linear.n_rows
    # Together is what was measured together, although the sensors saw it at other times.
    whole = [rows for which, rows in linear.structure.together if which == (0, 1, 2)]
    assert sum(rows.shape[0] for rows in whole) == 396
    assert all(np.ptp(measured[line]) == 0.0 for rows in whole for line in rows)
    densities = white(linear).log_densities
    assert densities.size == 1200 and np.isnan(densities).sum() == 8


def unstable() -> ph.Model:
    """A pitching motion that diverges with a time constant of half a second."""
    m = ph.Model("unstable")
    x, v = m.states(x="m", v="m/s")
    (u,) = m.inputs(u="N/kg")
    k, c, b = m.parameters(k=1.0, c=0.5, b=0.0)
    (F,) = m.quantities(F=k * x - c * v)
    m.dynamics(x=v, v=F + u)
    m.outputs(x=x, v=v, a=F + b)
    return m


def controlled(n: int) -> ph.Experiment:
    """A record under control: the input is what a regulator and a pilot give, a sample late."""
    steps, h, pilot = 100, 0.1, smooth(n)
    path, us = np.zeros((n, 2)), np.zeros(n)
    path[0] = 0.1, 0.0
    for i in range(1, n):
        us[i] = 2.0 * pilot[i] - 12.0 * path[i - 1, 0] - 4.0 * path[i - 1, 1]
        x, v = path[i - 1]
        for u in us[i - 1] + (us[i] - us[i - 1]) * (np.arange(steps) + 0.5) / steps:
            v += h / steps * (5.0 * x - 0.5 * v + u)
            x += h / steps * v
        path[i] = x, v
    t, random = h * np.arange(n), np.random.default_rng(5)
    clean = {"x": path[:, 0], "v": path[:, 1], "a": 5.0 * path[:, 0] - 0.5 * path[:, 1]}
    z = {name: y + SIGMA[name] * random.standard_normal(n) for name, y in clean.items()}
    return ph.Experiment(t, {"u": us}, z)


@pytest.mark.parametrize(("n", "forward"), [(40, True), (200, False)])
def test_unstable_motion(n: int, forward: bool) -> None:
    """Where a simulation from the first state loses its digits, the answers are those of the KKT system."""
    m, data = unstable(), [controlled(n)]
    fit = ph.estimate(m, data, noise=NOISE)
    assert fit.converged
    linear = compare(fit, data, ("F:x*v", "v':x^2", "a:u"), size=1e-4)
    _, way = _core.tangents(linear._problem, linear._xi, [], [0], lambda: False) or (None, None)
    assert way is forward
    assert linear.tangents.shape[1] == 5
    with pytest.raises(KeyboardInterrupt):
        _core.tangents(linear._problem, linear._xi, [], [0], lambda: True)


def test_answers_end_at_the_time_limit() -> None:
    m, data = oscillator(), [record(oscillator())]
    linear = Linearised(ph.estimate(m, data, noise=NOISE))
    place = next(p for p in sorted(linear.places, key=str) if p.kind != "output")
    signals = [np.ones((1, p.t.size)) for p in linear.points]
    assert np.isfinite(linear.answers(place, signals)).all()
    with solvers.Deadline(0.0).in_force(), pytest.raises(KeyboardInterrupt):
        linear.answers(place, signals)
    assert np.isfinite(linear.answers(place, signals)).all()


def test_a_shooting_fit_is_made_again_by_collocation() -> None:
    m, data = oscillator(), [record(oscillator())]
    near = {"k": 1.8, "c": 0.4}
    fit = ph.estimate(m, data, noise=NOISE, transcription=ph.SingleShooting(), start=near)
    again = collocated(fit)
    assert isinstance(again.transcription, ph.Collocation) and again.solution is not None
    for name, e in fit.parameters.items():
        assert again.parameters[name].value == pytest.approx(e.value, abs=0.05 * e.std_error)
    same = ph.estimate(m, data, noise=NOISE)
    assert collocated(same) is same
