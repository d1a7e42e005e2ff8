"""Experiment: what it holds, and what it refuses, with which words."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from phugoid.data.experiment import Experiment
from phugoid.data.multirate import multirate
from phugoid.errors import DataError, PhugoidError, did_you_mean

T = np.linspace(0.0, 1.0, 11)
NAN, INF = float("nan"), float("inf")


def run(**changes: Any) -> Experiment:
    fields: dict[str, Any] = {"t": T, "inputs": {"de": np.sin(T)}, "outputs": {"q": T**2}, "name": "run1"}
    return Experiment(**{**fields, **changes})


def spoilt(index: int, value: float) -> np.ndarray:
    values = np.cos(T)
    values[index] = value
    return values


def refusal(**changes: Any) -> str:
    with pytest.raises(DataError) as caught:
        run(**changes)
    return str(caught.value)


def has(message: str, *parts: str) -> bool:
    return all(part in message for part in parts)


def test_holds_what_was_given() -> None:
    e = run(units={"q": "rad/s"})
    assert (e.n, len(e), e.name, e.interpolation) == (11, 11, "run1", "linear")
    np.testing.assert_array_equal(e.t, T)
    np.testing.assert_array_equal(e.input("de"), np.sin(T))
    np.testing.assert_array_equal(e.outputs["q"], T**2)
    assert dict(e.units) == {"q": "rad/s"}


def test_units_are_of_channels_that_the_record_has() -> None:
    for refused in (
        lambda: run(units={"q": "rad/s", "dE": "rad"}),
        lambda: run().with_channels({"V": T}, units={"dE": "rad"}),
        lambda: multirate({"de": (T, T)}, {"q": (T, T)}, "run1", units={"dE": "rad"}),
    ):
        with pytest.raises(DataError, match=r"experiment 'run1': units: there is no channel 'dE'.*Did you mean 'de'"):
            refused()
    replaced = run(units={"de": "rad", "q": "rad/s"}).with_outputs({"az": T})
    assert dict(replaced.units) == {"de": "rad"}


def test_repr_counts_missing_samples() -> None:
    e = run(outputs={"q": spoilt(3, NAN)})
    assert repr(e) == "Experiment('run1', 11 samples, 0 to 1, inputs: de, outputs: q (1 missing))"


def test_arrays_are_copies_and_read_only() -> None:
    mine = T.copy()
    e = run(outputs={"q": mine})
    mine[0] = 99.0
    assert e.outputs["q"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        e.outputs["q"][0] = 1.0
    with pytest.raises(TypeError):
        e.outputs["new"] = mine  # type: ignore[index]
    with pytest.raises(AttributeError):
        e.t = mine  # type: ignore[misc]


def test_stays_read_only_after_pickling() -> None:
    e = pickle.loads(pickle.dumps(run()))
    np.testing.assert_array_equal(e.t, T)
    assert not e.t.flags.writeable and not e.input("de").flags.writeable


@pytest.mark.parametrize("values", [[0, 1, True], (0.0, 1.0, 1.0), np.array([0, 1, 1], dtype=np.float32)])
def test_takes_lists_tuples_and_other_types(values: Any) -> None:
    e = Experiment([0, 1, 2], outputs={"q": values})
    assert e.outputs["q"].dtype == np.float64
    np.testing.assert_array_equal(e.outputs["q"], [0.0, 1.0, 1.0])


def test_takes_pandas_series_with_missing_values() -> None:
    pd = pytest.importorskip("pandas")
    index = pd.Index([7, 8, 9])
    q = pd.Series([1.0, None, 3.0], index=index, dtype="Float64")
    e = Experiment(pd.Series([0.0, 0.1, 0.2], index=index), outputs={"q": q})
    np.testing.assert_array_equal(e.outputs["q"], [1.0, NAN, 3.0])


def test_masked_samples_are_missing() -> None:
    e = Experiment([0, 1, 2], outputs={"q": np.ma.masked_equal([1.0, -999.0, 3.0], -999.0)})
    np.testing.assert_array_equal(e.outputs["q"], [1.0, NAN, 3.0])


def test_refuses_too_few_samples() -> None:
    assert has(refusal(t=[0.0], inputs={}, outputs={}), "experiment 'run1', time", "1 sample", "at least 2")


def test_refuses_time_in_two_dimensions() -> None:
    assert has(refusal(t=T.reshape(1, 11)), "time", "(1, 11)", "1-D")


@pytest.mark.parametrize("bad", [NAN, INF])
def test_refuses_time_that_is_not_finite(bad: float) -> None:
    assert has(refusal(t=spoilt(4, bad)), "time", f"sample 4 is {bad}")


@pytest.mark.parametrize("later", [0.3, 0.25])
def test_refuses_time_that_does_not_increase(later: float) -> None:
    message = refusal(t=[0.1, 0.2, 0.3, later, 0.5], inputs={}, outputs={})
    assert has(message, "run1", f"sample 3 ({later})", "sample 2 (0.3)", "sort", "repeated")


def test_refuses_wrong_length() -> None:
    assert has(refusal(outputs={"q": T[:-1]}), "output 'q'", "10 values", "time has 11")


def test_refuses_two_dimensional_channel() -> None:
    assert has(refusal(inputs={"de": T[:, None]}), "input 'de'", "(11, 1)", "1-D")


def test_refuses_scalar_channel() -> None:
    assert has(refusal(inputs={"de": 1.0}), "input 'de'", "one value per sample")


@pytest.mark.parametrize("bad", [NAN, INF, -INF])
def test_refuses_gaps_in_inputs(bad: float) -> None:
    message = refusal(inputs={"de": spoilt(7, bad)})
    assert has(message, "input 'de'", f"sample 7 (t = 0.7) is {bad}", "interpolate them, or cut")


def test_refuses_infinity_in_outputs() -> None:
    message = refusal(outputs={"q": spoilt(2, -INF)})
    assert has(message, "output 'q'", "sample 2 (t = 0.2) is -inf", "NaN")


def test_refuses_output_that_is_missing_throughout() -> None:
    assert has(refusal(outputs={"q": np.full(11, NAN)}), "output 'q'", "NaN throughout")


@pytest.mark.parametrize(
    ("values", "word"),
    [
        (np.cos(T) + 0j, "complex"),
        (["0.1"] * 11, "text"),
        (np.arange(11).astype("datetime64[s]"), "dates"),
        ([[1.0]] * 10 + [[1.0, 2.0]], "is not an array of numbers"),
        ([1.0, "high", *T[2:]], "text"),
    ],
)
def test_refuses_what_is_not_real_numbers(values: Any, word: str) -> None:
    assert has(refusal(outputs={"q": values}), "run1", "output 'q'", word)


def test_names_the_sample_of_an_odd_object() -> None:
    values = np.array([*T[:5], "high", *T[6:]], dtype=object)
    assert has(refusal(outputs={"q": values}), "output 'q'", "sample 5 (t = 0.5) is 'high'")


def test_refuses_unknown_interpolation() -> None:
    assert has(refusal(interpolation="spline"), "run1", "'spline'", "'linear', 'cubic' or 'hold'")


def test_refuses_a_list_for_the_channels() -> None:
    assert has(refusal(inputs=[T]), "inputs must be a mapping", "list")


def test_window_keeps_its_ends_in_spite_of_rounding() -> None:
    e = Experiment(0.1 * np.arange(11), outputs={"q": T})
    cut = e.window(0.3, 0.7)  # 0.1*3 is a little more than 0.3, 0.1*7 than 0.7
    np.testing.assert_allclose(cut.t, [0.3, 0.4, 0.5, 0.6, 0.7])
    np.testing.assert_allclose(cut.outputs["q"], cut.t)


def test_window_outside_the_record_says_where_it_is() -> None:
    with pytest.raises(DataError, match=r"'run1': the window 5 to 6 holds 0 samples.*0 to 1$"):
        run().window(5.0, 6.0)


def test_window_and_rename_keep_the_rest() -> None:
    e = run(interpolation="cubic", channels={"az": T}, units={"de": "rad"}).window(0.0, 0.5, name="first")
    e = e.rename({"de": "elevator", "az": "nz"})
    assert (e.name, e.interpolation, dict(e.units)) == ("first", "cubic", {"elevator": "rad"})
    assert (list(e.inputs), list(e.outputs), list(e.channels)) == (["elevator"], ["q"], ["nz"])


def test_rename_can_swap() -> None:
    e = run(outputs={"a": T, "b": -T}).rename({"a": "b", "b": "a"})
    np.testing.assert_array_equal(e.outputs["a"], -T)


def test_rename_refuses_unknown_and_taken_names() -> None:
    e = run(outputs={"alpha": T, "q": T})
    with pytest.raises(DataError, match=r"no channel 'Alfa'.*Did you mean 'alpha'"):
        e.rename({"Alfa": "a"})
    with pytest.raises(DataError, match="two channels would be called 'q'"):
        e.rename({"alpha": "q"})


def test_with_outputs_replaces_the_measured_ones() -> None:
    e = run().with_outputs({"az": T}, name="simulated")
    assert (list(e.inputs), list(e.outputs), e.name) == (["de"], ["az"], "simulated")


def test_channels_serve_as_inputs_and_outputs() -> None:
    e = Experiment(T, channels={"de": T, "q": T**2, "spare": np.full(11, NAN)})
    np.testing.assert_array_equal(e.input("de"), T)
    np.testing.assert_array_equal(e.output("q"), T**2)
    e.check_for(["de"], ["q"])


def test_explicit_channel_goes_before_an_undetermined_one() -> None:
    e = Experiment(T, outputs={"q": -T}, channels={"q": T})
    np.testing.assert_array_equal(e.output("q"), -T)
    np.testing.assert_array_equal(e.input("q"), T)


def test_check_for_passes_with_extra_channels() -> None:
    run(inputs={"de": T, "da": T}, outputs={"q": T, "r": np.zeros(11)}).check_for(["de"], ["q"])


def test_check_for_names_an_absent_input() -> None:
    with pytest.raises(DataError, match=r"'run1' has no input 'DE'\. Did you mean 'de'\? There are: de\."):
        run().check_for(["DE"], ["q"])


def test_check_for_names_an_absent_output() -> None:
    with pytest.raises(DataError, match=r"'run1' has no output 'az'\. There are: q\."):
        run().check_for(["de"], ["q", "az"])


def test_check_for_says_where_an_output_is_needed_as_input() -> None:
    with pytest.raises(DataError, match=r"no input 'q'\. It is there as an output: give it among the inputs"):
        run().check_for(["q"], ["q"])


def test_check_for_finds_gaps_in_a_channel_used_as_input() -> None:
    e = Experiment(T, channels={"de": spoilt(7, NAN), "q": T}, name="run1")
    with pytest.raises(DataError, match=r"input 'de': sample 7 \(t = 0.7\) is nan; .*interpolate them, or cut"):
        e.check_for(["de"], ["q"])


def test_check_for_finds_infinity_and_dead_channels_used_as_outputs() -> None:
    e = Experiment(T, channels={"q": np.full(11, NAN), "r": spoilt(0, INF)})
    with pytest.raises(DataError, match="output 'q': is NaN throughout"):
        e.check_for([], ["q"])
    with pytest.raises(DataError, match=r"output 'r': sample 0 \(t = 0\) is inf"):
        e.check_for([], ["r"])


@pytest.mark.parametrize("level", [0.0, 101325.1])
def test_check_for_refuses_an_output_that_never_changes(level: float) -> None:
    values = np.full(11, level)
    values[3] = NAN
    e = run(outputs={"q": values})
    with pytest.raises(DataError, match=r"output 'q': is .* throughout \(zero variance\).*σ"):
        e.check_for(["de"], ["q"])
    e.check_for(["de"], ["q"], known_sigma={"q"})


def test_every_error_is_a_phugoid_error_and_a_value_error() -> None:
    assert issubclass(DataError, PhugoidError) and issubclass(DataError, ValueError)


def test_did_you_mean_ignores_case_and_keeps_silent_when_far() -> None:
    assert did_you_mean("ALPHA", ["alpha", "q"]) == " Did you mean 'alpha'?"
    assert did_you_mean("xyz", ["alpha", "q"]) == ""


def test_with_channels_adds_and_replaces() -> None:
    e = Experiment([0, 1, 2], {"de": [0, 1, 1]}, {"q": [0.0, 0.1, 0.2]}, "r", {"de": "hold"}, units={"q": "rad/s"})
    other = e.window(0, 1).with_channels({"V": [90, 91], "q": [5.0, 6.0]}, units={"V": "m/s"}, name="more")
    assert other.output("q").tolist() == [5.0, 6.0] and other.input("V").tolist() == [90.0, 91.0]
    assert other.interpolation_of("de") == "hold" and other.units == {"q": "rad/s", "V": "m/s"} and other.name == "more"
    assert other.history[-1] == "channels given: V, q" and len(other.history) == 2
    assert e.output("q")[0] == 0.0  # which stays as it was
    with pytest.raises(DataError, match="'V'"):
        e.with_channels({"V": [1.0]})
