"""Parameters as declared, estimates as found, and both in print."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from phugoid import Gaussian
from phugoid.errors import ModelError, UnknownName
from phugoid.goodness_of_fit import match
from phugoid.parameters import Estimate, Estimates, Parameter, text_table
from phugoid.records import Record
from phugoid.summary import fit_summary

NAN, INF = float("nan"), float("inf")


def test_parameter_takes_numbers_of_any_kind() -> None:
    p = Parameter(np.float32(1.0), bounds=(0, 2), prior=[1, 2])  # type: ignore[arg-type]
    assert (p.start, p.bounds, p.prior) == (1.0, (0.0, 2.0), (1.0, 2.0))
    assert Parameter() == Parameter(0.0, (-INF, INF), "", None, False)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": NAN}, "start must be a finite number"),
        ({"start": "x"}, "start must be a number, but it is 'x'"),
        ({"bounds": (2, 1)}, r"bounds \(2, 1\) are reversed"),
        ({"start": 1.0, "bounds": (1, 1)}, r"fixed=True"),
        ({"bounds": (NAN, 1)}, "bounds .* holds NaN"),
        ({"bounds": 3.0}, r"pair \(lower, upper\)"),
        ({"bounds": (None, 1.0)}, r"hold None; where there is no bound, write \(-inf, 1.0\)"),
        ({"start": 3, "bounds": (0, 2)}, r"start 3 lies outside its bounds \(0, 2\)"),
        ({"prior": (0, 0)}, "standard deviation 0: it must be positive"),
        ({"prior": (0, -1)}, "must be positive"),
        ({"prior": (INF, 1)}, "mean inf"),
        ({"prior": 1.0}, r"pair \(mean, standard deviation\)"),
        ({"unit": 5}, "unit must be text"),
    ],
)
def test_parameter_refuses(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        Parameter(**options)


@pytest.mark.parametrize(
    ("value", "error", "unit", "text"),
    [
        (0.216611, 0.00031, "1/s", "Mw = 0.2166 ± 0.0003 1/s"),
        (-0.96, 0.0123, "", "Mw = -0.960 ± 0.012"),
        (123456.0, 2345.0, "kg m²", "Mw = 123500 ± 2300 kg m²"),
        (0.0, 0.5, "", "Mw = 0.0 ± 0.5"),
        (1.23456e-9, 3.1e-12, "", "Mw = 1.235e-09 ± 3.1e-12"),
        (1.225, NAN, "kg/m³", "Mw = 1.225 kg/m³"),
    ],
)
def test_estimate_prints_the_digits_that_its_error_justifies(value: float, error: float, unit: str, text: str) -> None:
    assert repr(Estimate("Mw", value, error, unit)) == text


def test_estimate_remarks() -> None:
    assert repr(Estimate("k", 1.0, fixed=True)) == "k = 1 (fixed)"
    assert repr(Estimate("k", 1.0, bounds_active="upper")) == "k = 1 (at upper bound)"


def test_estimate_is_a_number() -> None:
    assert float(Estimate("k", 0.25)) == 0.25
    assert math.isnan(Estimate("k", 0.0, 1.0).relative_std_error)
    assert Estimate("k", -2.0, 1.0).relative_std_error == 0.5


def estimates() -> Estimates:
    return Estimates([Estimate("Zw", -1.4, 0.02, "1/s"), Estimate("Mw", 0.2166, 0.0003), Estimate("k", 1.0)])


def test_estimates_are_an_ordered_mapping() -> None:
    e = estimates()
    assert (e.names, len(e), "Mw" in e, "Mq" in e) == (("Zw", "Mw", "k"), 3, True, False)
    np.testing.assert_array_equal(e.values_array, [-1.4, 0.2166, 1.0])
    np.testing.assert_array_equal(e.std_errors_array, [0.02, 0.0003, NAN])
    assert e.to_dict() == {"Zw": -1.4, "Mw": 0.2166, "k": 1.0}
    assert pickle.loads(pickle.dumps(e)).to_dict() == e.to_dict()


def test_estimates_are_read_only() -> None:
    with pytest.raises(TypeError):
        estimates()["Zw"] = Estimate("Zw", 0.0)  # type: ignore[index]


def test_unknown_estimate_names_the_nearest() -> None:
    with pytest.raises(KeyError) as caught:
        estimates()["mw"]
    assert isinstance(caught.value, UnknownName)
    assert str(caught.value) == "there is no parameter 'mw'. Did you mean 'Mw'?"
    with pytest.raises(UnknownName, match="There are: Zw, Mw, k"):
        estimates()["epsilon"]
    assert estimates().get("epsilon") is None


def test_estimates_refuse_a_name_twice() -> None:
    with pytest.raises(ModelError, match="two parameters are called 'a'"):
        Estimates([Estimate("a", 1.0), Estimate("a", 2.0)])


def test_estimates_print_as_a_table() -> None:
    assert str(estimates()).splitlines() == [
        "parameter  estimate  std error   in %  unit",
        "---------  --------  ---------  -----  ----",
        "Zw           -1.400      0.020   1.43  1/s",
        "Mw           0.2166     0.0003  0.139",
        "k                 1",
    ]


def test_table_without_rows_keeps_its_header() -> None:
    assert text_table(["a", "bb"], [], "lr") == "a  bb\n-  --"


def record(name: str = "run1", noise: float = 0.1) -> Record:
    t = np.linspace(0.0, 1.0, 5)
    model = {"q": t, "az": -t}
    residuals = {
        "q": noise * np.array([1.0, -1.0, 1.0, -1.0, NAN]),
        "az": noise * np.array([1.0, -1.0, 1.0, -1.0, 0.0]),
    }
    measured = {n: model[n] + r for n, r in residuals.items()}
    return Record(
        name=name,
        t=t,
        inputs={"de": t},
        outputs=model,
        states={"w": t},
        measured=measured,
        residuals=residuals,
        mesh_t=np.linspace(0.0, 1.0, 9),
        units={"q": "rad/s"},
    )


def fit(records: list[Record]) -> SimpleNamespace:
    found = [Estimate("Mw", 0.2166, 0.0003, "1/s"), Estimate("Zw", 5.0, bounds_active="upper")]
    noise = [Estimate("sigma_q", 0.1, 0.02, "rad/s"), Estimate("sigma_az", 0.09, 0.02)]
    return SimpleNamespace(
        model=SimpleNamespace(name="short period"),
        parameters=Estimates([*found, *noise]),
        status="converged",
        message="the gradient is small",
        iterations=12,
        log_likelihood=123.4567,
        records=records,
        time=0.25,
        transcription="collocation, LGL order 2",
        covariance=np.full((4, 4), NAN),
        noise=Gaussian(),
        noise_parameters={"sigma_q", "sigma_az"},
        _intensities=set(),
        experiments=(),
        refinement=None,
        smoothing=None,
        warnings=(),
    )


def test_record_rms_leaves_out_missing_samples() -> None:
    assert record().rms() == {"q": pytest.approx(0.1), "az": pytest.approx(0.1 * math.sqrt(0.8))}
    assert Record(name="s", t=np.arange(2.0), inputs={}, outputs={}, states={}).rms() == {}


def test_record_repr_is_short() -> None:
    expected = "Record('run1', 5 samples, 9 mesh points, inputs: de, outputs: q az, states: w)"
    assert repr(record()) == expected


def test_summary_says_all() -> None:
    assert fit_summary(fit([record()])).splitlines() == [
        "short period",
        "  status          converged: the gradient is small",
        "  iterations      12 in 250 ms",
        "  log-likelihood  123.457",
        "  data            5 samples, 9 mesh points",
        "  transcription   collocation, LGL order 2",
        "",
        "parameter  estimate  std error   in %  unit  remark",
        "---------  --------  ---------  -----  ----  --------------",
        "Mw           0.2166     0.0003  0.139  1/s",
        "Zw                5                          at upper bound",
        "",
        "noise     estimate  std error  in %  unit",
        "--------  --------  ---------  ----  -----",
        "sigma_q      0.100      0.020    20  rad/s",
        "sigma_az     0.090      0.020  22.2",
        "",
        "output     σ  RMS residual  unit       R²  samples",
        "------  ----  ------------  -----  ------  -------",
        "q        0.1           0.1  rad/s  0.8416        4",
        "az      0.09       0.08944         0.9477        5",
    ]


def test_summary_counts_over_all_experiments() -> None:
    lines = fit_summary(fit([record("a"), record("b", noise=0.3)])).splitlines()
    assert lines[4] == "  data            2 experiments, 10 samples, 18 mesh points"
    # Mean square of 0.1 and 0.3 over 8 samples.
    assert lines[-2].split()[:3] == ["q", "0.1", f"{math.sqrt((0.01 + 0.09) / 2):.4g}"]


def test_summary_and_match_have_the_same_r2_where_records_lie_apart() -> None:
    low, high = record("a"), record("b")
    high = replace(
        high,
        outputs={n: v + 5.0 for n, v in high.outputs.items()},
        measured={n: v + 5.0 for n, v in high.measured.items()},
    )
    table = fit_summary(fit([low, high])).splitlines()[-2:]
    # About the mean of each record: what differs from one to the other makes no match look good.
    assert [line.split()[-2] for line in table] == [
        line.split()[-2] for line in fit_summary(fit([low])).splitlines()[-2:]
    ]
    assert [float(line.split()[-2]) for line in table] == [
        pytest.approx(match([low, high], name).r_squared, abs=1e-4) for name in ("q", "az")
    ]


def test_summary_of_a_constant_output_has_no_r2() -> None:
    r = record()
    flat = Record(
        name="flat",
        t=r.t,
        inputs={},
        outputs={"q": r.t},
        states={},
        measured={"q": np.zeros(5)},
        residuals={"q": -r.t},
    )
    assert "R²" not in fit_summary(fit([flat]))


def test_an_estimate_that_rounds_to_zero_has_no_sign() -> None:
    assert repr(Estimate("b", -0.00001, 0.0003)) == "b = 0.0000 ± 0.0003"
