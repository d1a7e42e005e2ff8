"""A term that other records confirm goes before a parameter that drifts, which could follow any change in a record."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search import Search
from phugoid.discrepancy.search.refit import Refit
from phugoid.sensitivities.tangents import collocated

T = np.arange(0.0, 40.0, 0.08)
TERM, DRIFT = "v':x^3", "k:drift"


def model(stiffer: float = 0.0, softening: float = 0.0) -> ph.Model:
    """A spring that is stiffer where it is far out, or that is softer later on."""
    m = ph.Model("spring")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=1.0, c=0.3)
    spring = k * (1.0 - softening * ph.Expr.symbol("time") / T[-1]) * x if softening else k * x
    m.dynamics(x=v, v=u - spring - c * v - stiffer * x * abs(x))
    m.outputs(x=x, v=v)
    return m


def record(truth: ph.Model, seed: int, grows: bool) -> ph.Experiment:
    """The motion grows in the course of the record, or it decays."""
    rng = np.random.default_rng(seed)
    size = np.linspace(0.4, 1.6, T.size)[:: 1 if grows else -1]
    u = size * (np.sin(0.9 * T + 0.5 * seed) + 0.6 * np.sin(0.53 * T))
    run = ph.simulate(truth, {"k": 1.0, "c": 0.3}, ph.Experiment(T, {"u": u}), initial={"x": 0.0, "v": 0.0})
    y = {n: z + 0.02 * rng.standard_normal(T.size) for n, z in run.outputs.items()}
    return ph.Experiment(T, {"u": u}, y, name=f"record {seed}")


@functools.cache
def searched(stiffer: float, softening: float, validated: bool = True) -> tuple[Search, Refit, Refit, Refit]:
    """A search, its base, and refits with the term and with the drift. The record held out has no drift."""
    fit = ph.estimate(model(), record(model(stiffer, softening), 1, True))
    base = Refit((), collocated(fit))
    listed = [c for c in ph.candidates(fit.model, points=base.linear.points) if c.name in (TERM, DRIFT)]
    search = Search(base, listed, [record(model(stiffer), 2, False)] if validated else [])
    search.cache.try_validation()
    search.screen.shortlist(base)
    by_name = {c.name: c for c in search.cache.candidates}
    term, drift = (search.cache.refit([by_name[n]]) for n in (TERM, DRIFT))
    assert term is not None and drift is not None
    return search, base, term, drift


def test_a_term_that_explains_other_records_goes_before_a_drift() -> None:
    search, base, term, drift = searched(0.15, 0.0)
    assert search.assessment.goes_before(base, term, drift)
    assert not search.assessment.goes_before(base, drift, term)
    assert not search.assessment.goes_before(base, term, term)


def test_a_drift_goes_first_where_other_records_do_not_confirm_the_term() -> None:
    search, base, term, drift = searched(0.0, 0.4)
    assert search.assessment.gain(base, drift) > search.assessment.needed(drift, drift.candidates[0])
    assert not search.assessment.goes_before(base, term, drift)


def test_without_other_records_the_likelihood_decides() -> None:
    search, base, term, drift = searched(0.15, 0.0, validated=False)
    assert not search.assessment.goes_before(base, term, drift)


@pytest.mark.parametrize("confirmed", [True, False])
def test_the_term_is_tried_first_even_where_the_drift_is_likelier(
    confirmed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, base, term, drift = searched(0.15, 0.0)
    tried: list[str] = []

    def settled(t: Refit, rejected: object) -> Refit:
        tried.append(t.candidates[-1].name)
        return t

    monkeypatch.setattr(search.assessment, "margin", lambda base, t: 300.0 if t is drift else 200.0)
    monkeypatch.setattr(search.refitting, "settled", settled)
    # The simulation of the other record by the drift is worse beyond chance, and that is left aside here.
    monkeypatch.setattr(search.confirmation, "_behind", lambda current, tries: set())
    if not confirmed:
        monkeypatch.setattr(search.assessment, "goes_before", lambda *refits: False)
    search.confirmation.accepted(base, [drift, term])
    assert tried[0] == (TERM if confirmed else DRIFT)


def test_what_is_named_is_the_term() -> None:
    fit = ph.estimate(model(), record(model(0.15), 1, True))
    d = ph.diagnose(fit, validation=record(model(0.15), 2, False))
    assert [f.cause for f in d.findings if f.status == "named"] == ["v':x|x|"], d.summary()
