"""Selection of the terms of a regression: against truth, brute force, and under coloured residuals."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from matplotlib import pyplot as plt
from scipy.signal import lfilter

import phugoid as ph
from phugoid.regression.subsets import TermData, best_subsets, orthogonal, stepwise

TRUE = {"Cm_alpha": -0.5, "Cm_q": -0.3, "Cm_de": -1.2, "Cm_alpha2": 2.0}


def pitching_moment() -> tuple[ph.Model, list[ph.Expr]]:
    """A model without states: the constant alone, and the variables of its candidates."""
    m = ph.Model("Cm")
    variables = m.inputs(alpha="rad", q="rad/s", de="rad")
    (Cm0,) = m.parameters("Cm0")
    m.outputs(Cm=Cm0)
    return m, list(variables)


def record(seed: int, pole: float = 0.0, n: int = 1000, name: str = "run") -> ph.Experiment:
    rng = np.random.default_rng(seed)
    smooth = [0.3 * lfilter([0.05], [1, -0.95], rng.standard_normal(n)) for _ in range(3)]
    noise = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(n))
    a, q, de = smooth
    z = 0.1 - 0.5 * a - 0.3 * q - 1.2 * de + 2.0 * a**2 + 0.02 * noise
    return ph.Experiment(0.02 * np.arange(n), {"alpha": a, "q": q, "de": de}, {"Cm": z}, name=name)


def candidates(variables: list[ph.Expr]) -> dict[str, Any]:
    return {"Cm": ph.monomials(*variables, degree=3)}


def test_a_model_without_states_is_a_regression() -> None:
    m, (a, q, de) = pitching_moment()
    model = m.with_terms({"y:Cm": ph.Expr.symbol("k") * a + ph.Expr.symbol("d") * de}, {"k": 0.0, "d": 0.0})
    run = record(0)
    found = ph.equation_error(model, run)
    x = np.column_stack([np.ones(run.n), run.input("alpha"), run.input("de")])
    theta, *_ = np.linalg.lstsq(x, run.output("Cm"), rcond=None)
    assert [e.value for e in found.parameters.values()] == pytest.approx(theta, rel=1e-9)
    with pytest.raises(ph.ModelError, match="equation_error"):
        ph.estimate(model, run)
    with pytest.raises(ph.ModelError, match="neither states nor outputs"):
        ph.equation_error(ph.Model("empty"), run)


@pytest.mark.parametrize("select", ["stepwise", "orthogonal", ph.TermSelection("all", most=9)])
def test_the_true_terms_are_selected(select: Any) -> None:
    m, variables = pitching_moment()
    terms = candidates(variables)
    if not isinstance(select, str):
        terms = {"Cm": terms["Cm"][:9]}  # all of degree 2
    other = record(101, name="other")
    found = ph.equation_error(m, record(1), select=select, terms=terms, held_out=other)
    chosen = found.selection["Cm"]
    assert set(chosen.selected) == set(TRUE) and chosen.kept == ("Cm0",)
    assert set(chosen.dropped).isdisjoint(TRUE) and len(chosen.dropped) == len(terms["Cm"]) - len(TRUE)
    for name, value in {**TRUE, "Cm0": 0.1}.items():
        e = found.parameters[name]
        assert abs(e.value - value) < 4 * e.std_error
    assert all(found.parameters[n].fixed and found.parameters[n].value == 0.0 for n in chosen.dropped)
    assert found.model.declared_parameters[chosen.dropped[0]].fixed
    best = chosen.steps[chosen.chosen].statistics
    assert best.held_out == pytest.approx(0.02, rel=0.1) and best.rms == pytest.approx(found.sigmas["Cm"])
    # What was left out is in no table of the estimates.
    assert chosen.dropped[0] in chosen.summary() and f"\n{chosen.dropped[0]} " not in found.summary()


def test_coloured_residuals_do_not_bring_in_terms() -> None:
    """Checks that F for white residuals takes in half a dozen wrong terms where they are correlated over 50 samples."""
    m, variables = pitching_moment()
    extra = {True: 0, False: 0}
    for seed in range(12):
        for corrected in extra:
            select = ph.TermSelection(f_in=None if corrected else 4.0, corrected=corrected)
            found = ph.equation_error(m, record(seed, 0.98), select=select, terms=candidates(variables))
            extra[corrected] += len(set(found.selection["Cm"].selected) - set(TRUE))
    assert extra[True] <= 4 and extra[False] >= 36


def data(seed: int = 0, n: int = 40, p: int = 6, kept: int = 1) -> TermData:
    rng = np.random.default_rng(seed)
    x = np.column_stack([np.ones(n), rng.standard_normal((n, p))]) if kept else rng.standard_normal((n, p))
    y = x[:, kept] - 0.5 * x[:, kept + 2] + 0.3 * rng.standard_normal(n)
    return TermData(y, x, kept, float(y.var()), (y[:10], x[:10]))


@pytest.mark.parametrize("kept", [0, 1])
def test_statistics_are_those_of_their_definitions(kept: int) -> None:
    d = data(kept=kept)
    block = frozenset({kept, kept + 2})
    x = d.x[:, [*range(kept), kept, kept + 2]]

    def residual(rows: np.ndarray, at: Any) -> np.ndarray:
        theta = np.linalg.lstsq(x[rows], d.y[rows], rcond=None)[0]
        return d.y[at] - x[at] @ theta

    every = np.arange(d.n)
    e = residual(every, every)
    left_out = [residual(np.delete(every, i), i) for i in every]
    found = d.statistics(block)
    assert found.rms == pytest.approx(np.sqrt(np.mean(e**2)))
    assert found.press == pytest.approx(np.sqrt(np.mean(np.square(left_out))))
    assert found.r_squared == pytest.approx(1 - (e @ e) / ((d.y - d.y.mean()) @ (d.y - d.y.mean())))
    assert found.pse**2 == pytest.approx(np.mean(e**2) + d.y.var() * x.shape[1] / d.n)
    assert found.held_out == pytest.approx(np.sqrt(np.mean(e[:10] ** 2)))
    # Partial F: what the term takes off the sum of squares, over the variance of the residuals.
    smaller = x[:, [j for j in range(x.shape[1]) if j != x.shape[1] - 1]]
    before = d.y - smaller @ np.linalg.lstsq(smaller, d.y, rcond=None)[0]
    white = (before @ before - e @ e) / (e @ e / (d.n - x.shape[1]))
    assert d.partial_f(block, kept + 2)[0] == pytest.approx(white)


@pytest.mark.parametrize("kept", [0, 1])
def test_best_subsets_are_those_of_brute_force(kept: int) -> None:
    d = data(3, kept=kept)
    for block, _ in best_subsets(d):
        every = [frozenset(b) for b in combinations(d.candidates, len(block))]
        assert d.statistics(block).rms == pytest.approx(min(d.statistics(b).rms for b in every))


def test_dependent_candidates_enter_once() -> None:
    d = data()
    twice = TermData(d.y, np.column_stack([d.x, d.x[:, 1] + d.x[:, 0]]), 1, d.scatter)
    copy = twice.p - 1
    for path in (stepwise(twice, 4.0, 4.0, 0.0, False), orthogonal(twice), best_subsets(twice)):
        assert all(not {1, copy} <= block for block, _ in path)


def test_stepwise_drops_what_later_terms_replace() -> None:
    # z is near x1 + x2 and enters first; with both of these it has nothing left to explain.
    rng = np.random.default_rng(5)
    x1, x2 = rng.standard_normal((2, 500))
    z = x1 + x2 + 0.3 * rng.standard_normal(500)
    y = x1 + x2 + 0.05 * rng.standard_normal(500)
    path = stepwise(TermData(y, np.column_stack([z, x1, x2]), 0, float(y.var())), 4.0, 4.0, 0.0, False)
    assert path[1][0] == {0} and path[-1][0] == {1, 2}
    assert stepwise(TermData(y, np.column_stack([z, x1, x2]), 0, float(y.var())), 4.0, 4.0, 0.5, False)[-1][0] == {0}


def test_state_equations_have_their_own_selections() -> None:
    m = ph.Model("short period")
    w, q = m.states(w="m/s", q="rad/s")
    (de,) = m.inputs(de="rad")
    names = m.parameters("Zw Zq Zde Mw Mq Mde")
    m.dynamics(w=names[0] * w + names[1] * q + names[2] * de, q=names[3] * w + names[4] * q + names[5] * de)
    m.outputs(w=w, q=q)
    t = np.arange(0.0, 20.0, 0.02)
    u = 0.05 * (np.sin(1.3 * t) + np.sin(2.9 * t) + np.sin(0.4 * t))
    truth = {"Zw": -1.4, "Zq": 40.0, "Zde": 0.0, "Mw": -0.2, "Mq": -2.2, "Mde": -6.0}
    run = ph.Experiment(t, {"de": u}, interpolation="cubic")
    clean = ph.simulate(m, truth, run, initial={"w": 0.0, "q": 0.0}).outputs
    rng = np.random.default_rng(0)
    run = run.with_outputs({n: y + 0.01 * y.std() * rng.standard_normal(t.size) for n, y in clean.items()})
    found = ph.equation_error(m, run, select=ph.TermSelection(keep="Mq"), terms={"q'": {"Mww": w**2}})
    assert found.selection["w'"].dropped == ("Zde",) and found.selection["q'"].dropped == ("Mww",)
    assert found.selection["q'"].kept == ("Mq",) and found.selection["w'"].unit == "m/s²"
    with pytest.raises(KeyError, match="Did you mean"):
        found.selection["w"]
    assert ph.estimate(found.model, run, start=found).parameters["Zde"].fixed


def test_equations_that_are_not_linear_are_left() -> None:
    m, (a, _, de) = pitching_moment()
    k, b = m.parameters(k=1.0, b=1.0)
    m.outputs(Cn=k * ph.sin(b * a))
    run = record(0)
    run = run.with_outputs({"Cm": run.output("Cm"), "Cn": np.sin(run.input("alpha"))})
    found = ph.equation_error(m, run, select="stepwise", terms={"Cm": [a, de]})
    assert set(found.selection) == {"Cm"}
    assert any(w.startswith("Cn: not linear in k, b") for w in found.warnings)


def test_what_is_shown() -> None:
    m, variables = pitching_moment()
    found = ph.equation_error(m, record(1), select="orthogonal", terms=candidates(variables))
    chosen = found.selection["Cm"]
    lines = chosen.summary().splitlines()
    assert lines[0] == "Terms of Cm" and any(line.startswith("*") for line in lines)
    assert "+ Cm_de" in chosen.summary() and chosen.summary() in found.summary()
    assert "PRESS" in found._repr_html_() and "<table" in chosen._repr_html_()
    figure, axes = chosen.plot()
    assert list(axes) == ["error"] and len(axes["error"].lines) == 4  # the mark; RMS, PRESS, PSE
    plt.close(figure)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"select": "stepwize"}, "Did you mean 'stepwise'"),
        ({"select": 3}, "select is one of"),
        ({"held_out": "run"}, "held_out: data is an Experiment"),
        ({"select": ph.TermSelection(keep=("Cm1",))}, "'Cm1' is not a parameter. Did you mean 'Cm0'"),
        ({"select": ph.TermSelection("all", most=3)}, "19 candidates have 524,288 subsets"),
        ({"select": ph.TermSelection("all", most=20, criterion="held_out")}, "give held_out="),
        ({"select": "stepwise", "terms": {"CM": [1]}}, "'CM' is not an equation. Did you mean"),
        ({"select": "stepwise", "terms": {"Cm": "alpha"}}, "a list of expressions"),
        ({"select": "stepwise", "terms": {"Cm": ["alpha"]}}, "'alpha' is not an expression"),
        ({"select": "stepwise", "terms": ["alpha"]}, "terms holds expressions by equation"),
        ({"select": "stepwise", "terms": {}}, "no terms to select from"),
    ],
)
def test_bad_input(options: dict[str, Any], words: str) -> None:
    m, variables = pitching_moment()
    with pytest.raises(ph.PhugoidError, match=words):
        ph.equation_error(m, record(0), **{"terms": candidates(variables), **options})


def test_held_out_data_need_a_selection_and_common_parameters() -> None:
    m, (a, *_) = pitching_moment()
    run, other = record(0), record(1, name="other")
    with pytest.raises(ph.OptionError, match="held_out is for a selection"):
        ph.equation_error(m, run, held_out=other)
    own = m.with_parameters(Cm0=ph.Parameter(0.0, per_experiment=True))
    with pytest.raises(ph.OptionError, match="Cm0 has a value for each experiment"):
        ph.equation_error(own, run, select="stepwise", terms={"Cm": [a]}, held_out=other)
    assert ph.equation_error(own, run, select="stepwise", terms={"Cm": [a]}).selection["Cm"].kept == ("Cm0",)
    with pytest.raises(ph.ModelError, match="there is a parameter 'Cm0' already"):
        ph.equation_error(m, run, terms={"Cm": {"Cm0": a}})


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"method": "forward"}, "method is 'stepwise'"),
        ({"method": "all", "criterion": "aic"}, "criterion is 'press'"),
        ({"criterion": "press"}, "decides by f_in"),
        ({"f_in": -1.0}, "f_in is a number from 0"),
        ({"f_in": 3.0, "f_out": 4.0}, "f_out .* is no more than f_in"),
        ({"most": 40}, "most is a whole number"),
    ],
)
def test_bad_options(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ph.OptionError, match=words):
        ph.TermSelection(**options)


def test_monomials() -> None:
    a, q = ph.Model("m").inputs("a q")
    assert [str(e) for e in ph.monomials(a, q, degree=3, orders=[3, 1])] == ["a", "q", "a**2", "a*q", "a**3", "a**2*q"]
    for bad in ({"degree": 0}, {"degree": 2, "orders": [1]}):
        with pytest.raises(ph.OptionError, match="whole number"):
            ph.monomials(a, q, **bad)
    with pytest.raises(ph.OptionError, match="expressions of a model"):
        ph.monomials("a")


def test_the_name_of_a_state_that_is_an_output_as_well_is_refused() -> None:
    m = ph.Model("roll")
    (p,) = m.states(p="rad/s")
    L, D = m.parameters("L D")
    (da,) = m.inputs(da="rad")
    m.dynamics(p=L * p + D * da)
    m.outputs(p=p)
    t = np.linspace(0, 10, 201)
    run = ph.Experiment(t, {"da": np.sin(t)}, {"p": np.cos(t)})
    with pytest.raises(ph.ModelError, match="'p' is both a state and an output: write \"p'\" for the state"):
        ph.equation_error(m, run, terms={"p": [p**3]})
    assert "p_dot_p3" in ph.equation_error(m, run, terms={"p'": [p**3]}).parameters
