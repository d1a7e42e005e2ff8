"""Records that begin at the steady state before a change of their inputs, as a user states it."""

from __future__ import annotations

import numpy as np
import pytest

import phugoid as ph

T = np.linspace(0.0, 6.0, 13)
TRUTH = {"on": 0.8, "off": 0.5, "total": 3.0}


def receptor(closed: bool) -> ph.Model:
    """A receptor that binds what is in the bath; ``closed``: its initial state is the steady state as a formula."""
    m = ph.Model("receptor")
    free, bound = m.states("free", "bound")
    (bath,) = m.inputs("bath")
    on, off, total = m.parameters(**{n: ph.Parameter(1.0, bounds=(1e-3, 1e3), transform="log") for n in TRUTH})
    binding = on * bath * free - off * bound
    m.dynamics(free=-binding, bound=binding)
    if closed:
        # That of a bath of 2, whatever is in it from t = 0 on.
        share = 2.0 * on / (2.0 * on + off)
        m.initial(free=(1.0 - share) * total, bound=share * total)
    else:
        m.initial(free=total, bound=0.0)
    m.outputs(bound_measured=bound)
    return m


def washed() -> ph.Experiment:
    """The bath has 2 before t = 0, and 0.3 after it."""
    bath = np.full(T.size, 0.3)
    clean = ph.simulate(receptor(True), TRUTH, ph.Experiment(T, {"bath": bath}, interpolation="hold"))
    noise = 0.02 * np.random.default_rng(5).standard_normal(T.size)
    outputs = {"bound_measured": clean.outputs["bound_measured"] + noise}
    return ph.Experiment(T, {"bath": bath}, outputs, name="washed", interpolation="hold")


@pytest.fixture(scope="module")
def fits() -> tuple[ph.Fit, ph.Fit]:
    """The estimates from the steady state as it is integrated, and from its formula."""
    run, noise = washed(), ph.Gaussian({"bound_measured": 0.02})
    m = receptor(False)
    whole = ph.from_steady_state(m, run, inputs={"bath": 2.0})
    return ph.estimate(m, whole, noise=noise), ph.estimate(receptor(True), run, noise=noise)


def test_estimates_are_those_of_the_steady_state_as_a_formula(fits: tuple[ph.Fit, ph.Fit]) -> None:
    found, exact = fits
    assert found.converged and exact.converged
    assert found.log_likelihood == pytest.approx(exact.log_likelihood, abs=1e-3)
    for name in TRUTH:
        off = found.parameters[name].value - exact.parameters[name].value
        assert abs(off) < 0.02 * exact.parameters[name].std_error


def test_standard_errors_follow_how_the_steady_state_depends_on_the_parameters(fits: tuple[ph.Fit, ph.Fit]) -> None:
    found, exact = fits
    for name in TRUTH:
        assert found.parameters[name].std_error == pytest.approx(exact.parameters[name].std_error, rel=1e-2)


def test_the_record_follows_the_rest_as_it_was() -> None:
    run = washed()
    whole = ph.from_steady_state(receptor(False), run, inputs={"bath": 2.0})
    rest = whole.n - run.n
    assert (whole.t[rest:] == run.t).all()
    assert (whole.input("bath")[:rest] == 2.0).all() and (whole.input("bath")[rest:] == 0.3).all()
    assert np.isnan(whole.output("bound_measured")[:rest]).all()
    assert (whole.output("bound_measured")[rest:] == run.output("bound_measured")).all()
    assert whole.name == "washed" and "steady state" in whole.history[-1]


def test_a_slower_model_rests_longer() -> None:
    m, run = receptor(False), washed()
    usual = ph.from_steady_state(m, run, inputs={"bath": 2.0})
    slow = ph.from_steady_state(m, run, {"on": 1e-3, "off": 1e-3}, inputs={"bath": 2.0})
    assert slow.t[0] < 50 * usual.t[0] < 0


def test_inputs_that_are_not_given_are_as_at_the_first_sample() -> None:
    run = washed().with_interpolation("linear")
    whole = ph.from_steady_state(receptor(False), run)
    assert (whole.input("bath") == 0.3).all()


def test_a_model_without_inputs_rests() -> None:
    m = ph.Model("drain")
    (x,), (k,) = m.states("x"), m.parameters(k=0.5)
    m.dynamics(x=1.0 - k * x)
    m.initial(x=0.0)
    m.outputs(y=x)
    whole = ph.from_steady_state(m, ph.Experiment([0.0, 1.0], outputs={"y": [2.0, 2.1]}))
    assert ph.simulate(m, {"k": 0.25}, whole).outputs["y"][-2:] == pytest.approx([4.0, 4.0], rel=1e-6)


def test_what_has_no_steady_state_is_an_error() -> None:
    run = washed()
    m = ph.Model("integrator")
    (x,), (u,), (k,) = m.states("x"), m.inputs("bath"), m.parameters(k=0.5)
    m.dynamics(x=k * u)
    m.outputs(bound_measured=x)
    with pytest.raises(ph.ModelError, match=r"'x' has no initial condition.*initial\(x=\.\.\.\)"):
        ph.from_steady_state(m, run)
    m.initial(x=0.0)
    with pytest.raises(ph.EvaluationError, match="does not come to rest"):
        ph.from_steady_state(m, run)
    timed = ph.Model("clock")
    (x,), (u,), (k,) = timed.states("x"), timed.inputs("bath"), timed.parameters(k=0.5)
    timed.dynamics(x=ph.sin(timed.time) - k * x)
    timed.initial(x=0.0)
    timed.outputs(bound_measured=x)
    with pytest.raises(ph.ModelError, match="'x' depends on time"):
        ph.from_steady_state(timed, run)


def test_inputs_that_cannot_be_are_errors() -> None:
    m, run = receptor(False), washed()
    with pytest.raises(ph.DataError, match=r"'bat' is not an input.*Did you mean 'bath'"):
        ph.from_steady_state(m, run, inputs={"bat": 2.0})
    with pytest.raises(ph.DataError, match=r"'bath' is 2 before the record and 0\.3 at its first.*'hold'"):
        ph.from_steady_state(m, run.with_interpolation("linear"), inputs={"bath": 2.0})
    with pytest.raises(ph.DataError, match="'bath' is nan"):
        ph.from_steady_state(m, run, inputs={"bath": float("nan")})
    with pytest.raises(ph.ModelError, match="'onn' is not a parameter"):
        ph.from_steady_state(m, run, {"onn": 1.0})


def test_figures_begin_with_the_record(fits: tuple[ph.Fit, ph.Fit]) -> None:
    found, _ = fits
    record = found.records[0]
    shown = record.without_rest()
    assert (shown.t == T).all() and (
        shown.outputs["bound_measured"] == record.outputs["bound_measured"][-T.size :]
    ).all()
    assert shown.mesh_t[0] == 0.0 and shown.mesh_states["free"].size == shown.mesh_t.size
    _, axes = found.plot()
    assert min(line.get_xdata()[0] for line in axes["bound_measured"].lines) == 0.0


def test_a_short_stretch_before_the_first_measurement_is_shown() -> None:
    z = np.where(T < 2.0, np.nan, 1.0 + T)
    m = receptor(True)
    run = ph.Experiment(T, {"bath": np.ones(T.size)}, {"bound_measured": z})
    record = ph.simulate(m, TRUTH, run)
    assert record.without_rest() is record


def test_a_fit_gives_the_parameters_with_which_the_model_rests(fits: tuple[ph.Fit, ph.Fit]) -> None:
    found, _ = fits
    values = {n: found.parameters[n].value for n in TRUTH}
    by_fit = ph.from_steady_state(receptor(False), washed(), found, inputs={"bath": 2.0})
    by_values = ph.from_steady_state(receptor(False), washed(), values, inputs={"bath": 2.0})
    assert (by_fit.t == by_values.t).all()
