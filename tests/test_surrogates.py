"""Terms that are surrogates of something that no candidate describes, and how a motion is distinguished from noise of a
sensor."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.search import Search, SearchResult
from phugoid.discrepancy.search.disturbance import histories_at, likeliest_function
from phugoid.discrepancy.search.free_run import Misfitting, Simulated
from phugoid.discrepancy.search.other_laws import unknown_function
from phugoid.discrepancy.search.refit import HeldOut, Refit
from phugoid.discrepancy.search.remainder import Remainder
from phugoid.discrepancy.search.surrogates import (
    CONTRADICTED,
    DIFFERS,
    HARMS,
    SurrogateSettings,
    is_motion,
    missing_in_all,
    persistence,
    without_surrogates,
)
from phugoid.residual_noise.whitening import Whitening
from phugoid.sensitivities import Place
from phugoid.sensitivities.tangents import collocated

STEP, LASTING = 0.01, 0.5
T = np.arange(0.0, 40.0, STEP)


def oscillator(cubic: float) -> ph.Model:
    m = ph.Model("oscillator")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=1.0, c=0.3)
    m.dynamics(x=v, v=u - k * x - c * v - cubic * x**3)
    m.outputs(x=x)
    return m


def fitted(cubic: float, coloured: bool, every: int) -> Refit:
    """A linear oscillator fitted to one that may be stiffer where it is far out, with one sample in ``every``."""
    rng = np.random.default_rng(2)
    u = 1.5 * np.sin(0.8 * T + 0.004 * T**2)
    record = ph.Experiment(T, {"u": u}, {})
    x = ph.simulate(oscillator(cubic), {"k": 1.0, "c": 0.3}, record, initial={"x": 0.0, "v": 0.0})
    noise = 0.02 * rng.standard_normal(T.size)
    if coloured:
        keep = float(np.exp(-STEP / LASTING))
        for i in range(1, T.size):
            noise[i] = keep * noise[i - 1] + np.sqrt(1.0 - keep**2) * noise[i]
    y = x.outputs["x"] + noise
    return Refit((), ph.estimate(oscillator(0.0), ph.Experiment(T[::every], {"u": u[::every]}, {"x": y[::every]})))


def predictable(at: Refit) -> float:
    """The part of the residuals' power that their past predicts from one sample to the next."""
    (channel,) = Whitening.of(at.linear.residuals, at.linear.structure).channels
    return 1.0 - channel.power / float(np.mean(at.linear.residuals**2))


def test_a_motion_is_told_from_coloured_noise_at_any_sampling_rate() -> None:
    least = SurrogateSettings.persistent
    by_rate = []
    for every in (1, 2, 4):
        motion, noise = fitted(0.2, False, every), fitted(0.0, True, every)
        assert is_motion(motion, least), f"one sample in {every}"
        assert not is_motion(noise, least), f"one sample in {every}"
        by_rate.append([*persistence(motion), *persistence(noise)])
    assert np.ptp(by_rate, axis=0) == pytest.approx(0.0, abs=0.03)
    # What the next sample is predicted to is another thing at each rate, and the noise is well predicted at the first.
    assert predictable(fitted(0.0, True, 1)) > 0.95 > 0.9 > predictable(fitted(0.0, True, 4))


BUMP, CUBE = "bump", "cube"


def spring(kind: str) -> ph.Model:
    """A force that no candidate has the shape of, or a cubic one."""
    m = ph.Model("spring")
    (u,), (x, v) = m.inputs("u"), m.states(x="m", v="m/s")
    k, c = m.parameters(k=1.0, c=0.3)
    force = {"": 0.0, BUMP: 1.2 * ph.exp(-(((x - 0.9) / 0.2) ** 2)), CUBE: 0.2 * x**3}[kind]
    m.dynamics(x=v, v=u - k * x - c * v - force)
    m.outputs(x=x, v=v)
    return m


def record(kind: str, seed: int, size: float = 1.0) -> ph.Experiment:
    t, rng = T[::4], np.random.default_rng(seed)
    u = size * (1.2 * np.sin(0.8 * t + 0.008 * t**2 + seed) + 0.5 * np.sin(0.31 * t))
    run = ph.simulate(spring(kind), {"k": 1.0, "c": 0.3}, ph.Experiment(t, {"u": u}), initial={"x": 0.0, "v": 0.0})
    y = {n: z + 0.01 * rng.standard_normal(t.size) for n, z in run.outputs.items()}
    return ph.Experiment(t, {"u": u}, y, name=f"record {seed}")


@functools.cache
def named(kind: str, cause: str, size: float = 1.0) -> tuple[Search, SearchResult]:
    """A search that named one cause; the input of the data held out is so many times as large."""
    fit = ph.estimate(spring(""), record(kind, 1))
    base = Refit((), collocated(fit))
    search = Search(base, ph.candidates(fit.model, points=base.linear.points), [record(kind, 2, size)])
    search.cache.try_validation()
    search.screen.shortlist(base)
    (candidate,) = [c for c in search.cache.candidates if c.name == cause][:1]
    final = search.cache.refit([candidate])
    assert final is not None
    return search, SearchResult(final, final, (search.confirmation.found(final, candidate, True),))


def test_a_term_that_leaves_a_larger_motion_is_a_surrogate() -> None:
    search, result = named(BUMP, "v':u^2")
    explained = search.assessment.explained(search.cache.base, result.final)
    assert explained is not None and explained.interval[0] < SurrogateSettings.most
    kept, remainder = without_surrogates(search, result, None)
    assert kept.surrogates.keys() == {"v':u^2"} and kept.final is search.cache.base and kept.full is result.full
    assert remainder is None


def test_a_term_with_which_data_held_out_are_predicted_worse_is_a_surrogate_unless_it_explains_most() -> None:
    search, result = named(CUBE, "v':x^3")
    (found,) = result.found
    assert found.explained is not None and found.explained.part > 0.9
    worse = HeldOut(-20.0, 5.0, -20.0)

    def surrogates(held_out: HeldOut, part: float) -> Mapping[str, str]:
        assert found.explained is not None
        other = replace(found, held_out=held_out, explained=replace(found.explained, part=part))
        return without_surrogates(search, replace(result, found=(other,)), None)[0].surrogates

    assert surrogates(worse, 0.3) == {"v':x^3": CONTRADICTED}
    assert not surrogates(worse, 0.7) and not surrogates(worse._replace(deviation=30.0), 0.3)
    assert not surrogates(found.held_out, 0.3)


def test_a_term_that_makes_other_outputs_worse_by_much_of_what_it_explains_is_a_surrogate() -> None:
    search, result = named(CUBE, "v':x^3")
    (found,) = result.found
    assert found.explained is not None and found.explained.harm == 0.0

    def surrogates(harm: float) -> Mapping[str, str]:
        assert found.explained is not None
        other = replace(found, explained=replace(found.explained, part=0.2, harm=harm))
        return without_surrogates(search, replace(result, found=(other,)), None)[0].surrogates

    assert surrogates(0.15) == {"v':x^3": HARMS} and not surrogates(0.05)


def test_harm_is_what_outputs_lose_that_become_worse_beyond_chance() -> None:
    rng = np.random.default_rng(1)
    n, blocks = 1200, 24
    noise, wrong = rng.standard_normal((3, n)), np.sin(0.05 * np.arange(n))

    def simulated(*size: float) -> Simulated:
        """Errors of three outputs: noise, and so much of the same motion in each."""
        errors = np.concatenate([e + s * wrong for e, s in zip(noise, size, strict=True)])
        block = np.tile(np.arange(n) * blocks // n, 3)
        return Simulated(("a", "b", "c"), errors, np.repeat(np.arange(3), n), block)

    before, after = simulated(3.0, 1.0, 0.0), simulated(1.0, 2.0, 0.02)
    powers = np.array([np.mean(e**2) for e in before.errors.reshape(3, n)])
    misfit = Misfitting(before.errors, powers, 1.0 - 1.0 / powers)
    explained = after.explained(before, misfit)
    assert explained.outputs["a"] > 0.5 and explained.outputs["b"] < -0.5
    # What is misfit of all, and what the second output loses of that; the third changes by no more than chance.
    whole = float((1.0 - 1.0 / powers).sum())
    assert explained.harm == pytest.approx(-explained.outputs["b"] / whole, rel=0.05)
    assert before.explained(after, misfit).harm == pytest.approx(explained.outputs["a"] / whole, rel=0.05)


def test_a_term_that_data_held_out_ask_to_be_different_is_a_surrogate() -> None:
    """x|x| for x^3 in a motion that is larger in the data held out, of which it explains 98 %."""
    search, result = named(CUBE, "v':x|x|", 4.0)
    settings = SurrogateSettings(whole=0.995, more=0.0)
    kept, remainder = without_surrogates(search, result, None, settings)
    assert kept.surrogates == {"v':x|x|": DIFFERS} and kept.final is search.cache.base
    assert remainder is not None and remainder.disturbance.name == "v':f(x)"
    # The whole function, and not only what the term lacks: minus the cubic force, but for a constant and a linear part.
    curve = remainder.disturbance
    true = -0.2 * curve.knots**3
    straight = np.polynomial.Polynomial.fit(curve.knots, curve.values - true, 1)(curve.knots)
    assert curve.values == pytest.approx(true + straight, abs=0.05 * float(np.ptp(true)))
    # By default a term that explains nearly all is left as it is, and so is the true one.
    assert without_surrogates(search, result, None) == (result, None)
    right, its = named(CUBE, "v':x^3", 4.0)
    assert without_surrogates(right, its, None, replace(settings, whole=2.0)) == (its, None)


def test_all_records_together_show_what_is_missing_beside_a_surrogate_unless_that_is_minor() -> None:
    search, result = named(BUMP, "v':u^2")
    found = missing_in_all(search, result.final)
    assert found is not None and found.function.name == "v':f(x)" and found.gain > SurrogateSettings.margin
    assert len(found.base.fit.records) == 2 and not found.base.candidates
    for cause in ("v':x|x|", "v':x^3"):  # the former leaves 2 % of the misfit
        right, its = named(CUBE, cause, 4.0)
        assert missing_in_all(right, its.final) is None


def test_no_function_of_an_input_with_two_levels_is_fitted() -> None:
    """Any such function is a constant and a linear part. A term of this input had the search ask for one."""
    t, rng = T[::4], np.random.default_rng(5)
    u = np.where(np.sin(0.5 * t + 0.01 * t**2) > 0.0, 0.8, -0.8)
    clean = ph.simulate(spring(""), {"k": 1.0, "c": 0.3}, ph.Experiment(t, {"u": u}), initial={"x": 0.0, "v": 0.0})
    y = {n: z + 0.01 * rng.standard_normal(t.size) for n, z in clean.outputs.items()}
    base = Refit((), collocated(ph.estimate(spring(""), ph.Experiment(t, {"u": u}, y))))
    search, place = Search(base, ph.candidates(spring(""), points=base.linear.points)), Place("equation", "v")
    assert likeliest_function(base, place, "u") is None and likeliest_function(base, place, "x") is not None
    assert unknown_function(search, base, SearchResult(base, base), place, "u") is None


def test_a_term_that_leaves_noise_is_a_cause() -> None:
    search, result = named(CUBE, "v':x^3")
    assert not is_motion(result.final, SurrogateSettings.persistent)
    assert without_surrogates(search, result, None) == (result, None)


def test_a_random_disturbance_beside_a_surrogate_is_not_told() -> None:
    """It holds what the term stands for. Beside the model without terms it stays."""
    search, result = named(BUMP, "v':u^2")
    of = histories_at(result.final, Place("equation", "v"))[0]
    beside, alone = (Remainder(of, at, 100.0, float("nan")) for at in (result.final, search.cache.base))
    assert without_surrogates(search, result, beside)[1] is None
    assert without_surrogates(search, result, alone)[1] is alone


def test_a_likelier_function_takes_the_place_of_a_named_term() -> None:
    search, result = named(CUBE, "v':x^3")
    (found,) = result.found
    of = replace(histories_at(search.cache.base, Place("equation", "v"))[0], kind="function", variables=("x",))
    assert found.explained is not None and found.explained.interval[0] > SurrogateSettings.sure
    part = replace(found, explained=replace(found.explained, part=0.7, interval=(0.6, 0.8)))
    # Not of one that explains nearly all of the misfit beyond doubt.
    for term, times, surrogates in ((part, 0.5, set()), (part, 2.0, {"v':x^3"}), (found, 2.0, set())):
        remainder = Remainder(of, search.cache.base, times * found.gain, float("nan"))
        kept, _ = without_surrogates(search, replace(result, found=(term,)), remainder)
        assert kept.surrogates.keys() == surrogates


def test_what_nothing_was_named_for_is_left_as_it_is() -> None:
    search, _ = named(CUBE, "v':x^3")
    nothing = SearchResult(search.cache.base, search.cache.base)
    assert without_surrogates(search, nothing, None) == (nothing, None)


def test_what_explains_most_of_the_rest_is_minor_only_where_its_amplitude_is_small_too() -> None:
    search, result = named(CUBE, "v':x^3")
    (found,) = result.found
    assert found.explained is not None and np.isnan(found.of_the_rest)

    def is_minor(part: float, of_the_rest: float, low: float = 0.001) -> bool:
        assert found.explained is not None
        explained = replace(found.explained, part=part, interval=(low, 1.0))
        return search.assessment.is_minor(explained, of_the_rest)

    assert is_minor(0.01, np.nan) and is_minor(0.01, 0.3) and not is_minor(0.01, 0.9)
    assert is_minor(0.002, 0.9) and is_minor(0.01, 0.9, low=-0.1) and not is_minor(0.06, np.nan)
