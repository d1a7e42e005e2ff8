"""What a newcomer gets wrong is told where it happens: too few data, coarse meshes, poor optima, slips of the pen."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph
from phugoid.report import remarks

DOSE = 320.0  # mg


def lag(**options: object) -> ph.Model:
    m = ph.Model("lag")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="V")
    a, b = m.parameters(a=ph.Parameter(0.0, **options), b=0.0)  # type: ignore[arg-type]
    m.dynamics(x=a * x + b * u)
    m.outputs(x=x)
    return m


def lag_record(n: int) -> ph.Experiment:
    t = np.arange(n) * 0.1
    run = ph.Experiment(t, {"u": np.sign(np.sin(3.0 * t + 0.1))}, name="run")
    x = ph.simulate(lag(), {"a": -1.0, "b": 2.0}, run, initial={"x": 0.5}).outputs["x"]
    return run.with_outputs({"x": x + 0.05 * np.random.default_rng(0).standard_normal(n)})


def oral_dose() -> tuple[ph.Model, ph.Expr, list[ph.Experiment]]:
    """Pharmacokinetics of one compartment: blood samples are few, and far apart beside the absorption."""
    m = ph.Model("oral dose")
    gut, c = m.states(gut="mg", c="mg/l")
    ka, ke, V = m.parameters(
        ka=ph.Parameter(1.0, transform="log", unit="1/h"),
        ke=ph.Parameter(0.3, transform="log", unit="1/h", per_experiment=True),
        V=ph.Parameter(10.0, transform="log", unit="l"),
    )
    m.dynamics(gut=-ka * gut, c=ka * gut / V - ke * c)
    m.outputs(c=c)
    m.initial(gut=DOSE, c=0.0)
    t = np.array([0.0, 0.25, 0.6, 1.1, 5.1, 7.0, 9.0, 12.0, 24.0])
    random = np.random.default_rng(0)
    people = []
    for name, k in {"one": 0.06, "two": 0.12}.items():
        level = DOSE * 1.5 / 32.0 / (1.5 - k) * (np.exp(-k * t) - np.exp(-1.5 * t))
        people.append(ph.Experiment(t, outputs={"c": level + 0.1 * random.standard_normal(t.size)}, name=name))
    return m, ke, people


@pytest.mark.parametrize(("samples", "told"), [(3, True), (4, False)])
def test_a_path_through_all_samples_is_no_estimate(samples: int, told: bool) -> None:
    fit = ph.estimate(lag(), lag_record(samples))
    words = "3 measured values are no more than the 3 parameters and initial states"
    assert any(words in w for w in fit.warnings) == told


def test_what_is_known_is_not_counted_as_unknown() -> None:
    three = lag_record(3)
    assert not any("no more than" in w for w in ph.estimate(lag(prior=(-1.0, 0.1)), three).warnings)
    steady = lag()
    steady.initial(x=0.5)
    assert not any("no more than" in w for w in ph.estimate(steady, three).warnings)


def test_a_mesh_too_coarse_for_the_motion_is_told_of_until_it_is_refined() -> None:
    m, _, people = oral_dose()
    # By default the mesh follows the motion where samples are few.
    fine = ph.estimate(m, people)
    assert max(float(e.worst.max()) for e in fine.integration_error()) < 0.01
    assert "the mesh is coarse" not in fine.summary()
    coarse = ph.estimate(m, people, transcription=ph.Collocation(segments=[e.t for e in people]))
    assert max(float(e.worst.max()) for e in coarse.integration_error()) > 0.1
    (told,) = [w for w in coarse.warnings if "the mesh is coarse" in w]
    assert "from t = 1.1 to 5.1 of '" in told and "the option refine" in told
    assert told in coarse.summary()
    assert any("mesh is coarse" in r for r in remarks(coarse))
    refined = ph.estimate(m, people, transcription=ph.Collocation(refine=True))
    assert "the mesh is coarse" not in refined.summary()
    assert "the mesh is coarse" not in ph.estimate(lag(), lag_record(100)).summary()


@pytest.mark.parametrize(("samples_a_period", "told"), [(3.0, True), (3.5, True), (6.0, False), (20.0, False)])
def test_an_oscillation_of_few_samples_a_period_has_a_coarse_mesh(samples_a_period: float, told: bool) -> None:
    m = ph.Model("oscillator")
    x, v = m.states("x v")
    k, c = m.parameters(k=3.0, c=0.1)
    m.dynamics(x=v, v=-k * x - c * v)
    m.outputs(y=x)
    t = np.pi / samples_a_period * np.arange(int(12 * samples_a_period))
    noise = 0.05 * np.random.default_rng(1).standard_normal(t.size)
    record = ph.Experiment(t, {}, {"y": np.exp(-0.05 * t) * np.cos(np.sqrt(3.9975) * t) + noise})
    assert any("the mesh is coarse" in w for w in ph.estimate(m, record).warnings) == told
    refined = ph.estimate(m, record, transcription=ph.Collocation(refine=True))
    assert not any("the mesh is coarse" in w for w in refined.warnings)


def test_a_quantity_of_parameters_that_differ_by_experiment_says_which_there_are() -> None:
    m, ke, people = oral_dose()
    fit = ph.estimate(m, people)
    with pytest.raises(ph.ModelError, match=r"'ke' has a value for each experiment \(ke\[one\], ke\[two\]\)"):
        fit.derived(half_life=np.log(2) / ke)


def test_an_optimum_that_explains_nothing_says_so() -> None:
    record = lag_record(100)
    noise = np.random.default_rng(1).standard_normal(100)
    assert "No output is matched well (R² at most 0." in ph.estimate(lag(), record.with_outputs({"x": noise})).summary()
    assert "No output is matched well" not in ph.estimate(lag(), record).summary()


def test_a_product_of_zeros_is_fitted_with_one_factor_held() -> None:
    m = ph.Model("product")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c = m.parameters("a b c")
    m.dynamics(x=a * x + b * c * u)
    m.outputs(x=x)
    zeros = ph.estimate(m, lag_record(100))
    assert zeros.status == "unidentifiable" and "b, c: one scale is free" in zeros.message
    ones = ph.estimate(m, lag_record(100), start={"b": 1.0, "c": 1.0})
    assert zeros.log_likelihood == pytest.approx(ones.log_likelihood, abs=1e-6)


def sine_of_a_factor() -> ph.Model:
    m = ph.Model("product")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    a, b, c = m.parameters("a b c")
    m.dynamics(x=a * x + b * ph.sin(c) * u)
    m.outputs(x=x)
    return m


def test_a_saddle_of_zeros_is_left_by_another_way() -> None:
    m = sine_of_a_factor()
    zeros = ph.estimate(m, lag_record(100))
    ones = ph.estimate(m, lag_record(100), start={"b": 1.0, "c": 1.0})
    assert zeros.log_likelihood == pytest.approx(ones.log_likelihood, abs=1e-6)
    assert "reached after" in zeros.message and zeros.status == "unidentifiable"


def test_a_saddle_that_is_not_left_is_told_to_start_elsewhere() -> None:
    """Few iterations: no other way is tried."""
    m = sine_of_a_factor()
    zeros = ph.estimate(m, lag_record(100), solver=ph.Newton(max_iterations=100))
    assert any("start from elsewhere, above all with factors that are not 0" in w for w in zeros.warnings)


def test_slips_of_the_pen_are_named() -> None:
    (x,) = ph.Model("powers").states("x")
    with pytest.raises(TypeError, match=r"write x\*\*2, not x\^2"):
        x ^ 2
    with pytest.raises(TypeError, match=r"write x\*\*2, not x\^2"):
        2 ^ x
    with pytest.raises(ph.ModelError, match=r"bounds \(0, None\) hold None; where there is no bound, write \(0, inf\)"):
        ph.Parameter(1.0, bounds=(0, None))  # type: ignore[arg-type]


def test_a_report_asks_for_its_folder_before_it_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = ph.estimate(lag(), lag_record(20))
    monkeypatch.setattr("phugoid.report.write", lambda *_: pytest.fail("the page was made first"))
    with pytest.raises(ph.DataError, match="there is no folder"):
        fit.report(tmp_path / "none" / "fit.html")


def test_completion_offers_what_is_public() -> None:
    assert dir(ph) == sorted(ph.__all__)


def test_renamed_columns_are_asked_for_by_either_name(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("TIME,ELEV,Q\n0,1,2\n1,2,3\n2,3,5\n")
    names = {"TIME": "t", "ELEV": "de", "Q": "q"}
    new = ph.read(path, time="t", inputs=["de"], outputs=["q"], rename=names, units={"q": ("deg/s", "rad/s")})
    old = ph.read(path, time="TIME", inputs=["ELEV"], outputs=["Q"], rename=names, units={"Q": ("deg/s", "rad/s")})
    assert np.array_equal(old.t, new.t)
    assert np.array_equal(old.inputs["de"], [1.0, 2.0, 3.0])
    assert np.array_equal(old.outputs["q"], new.outputs["q"])
    assert new.outputs["q"][0] == pytest.approx(np.deg2rad(2.0))


def test_names_that_are_exchanged_are_those_after_renaming(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,a,b\n0,1,2\n1,2,3\n")
    run = ph.read(path, inputs=["a"], outputs=["b"], rename={"a": "b", "b": "a"})
    assert np.array_equal(run.inputs["a"], [2.0, 3.0])


def test_numbers_for_noise_are_told_what_to_write() -> None:
    with pytest.raises(ph.OptionError, match=r"ph\.Gaussian\(\{'x': 0\.1\}\)"):
        ph.estimate(lag(), lag_record(20), noise={"x": 0.1})  # type: ignore[arg-type]
    with pytest.raises(ph.OptionError, match=r"by output, as in ph\.Gaussian"):
        ph.multistart(lag(), lag_record(20), {"a": (-1, 0)}, n=2, noise=0.1)  # type: ignore[arg-type]


def test_quantities_without_effect_are_reported_and_no_candidates() -> None:
    model = lag()
    x, a = (ph.Expr.symbol(name) for name in ("x", "a"))
    model.quantities(drag=a * x, square=x**2)
    assert model.unused_quantities == ("drag", "square")
    # Without a parameter a quantity is there to be looked at.
    assert any("uses the quantity drag:" in text for text in ph.estimate(model, lag_record(20)).warnings)
    assert not [c.name for c in ph.candidates(model) if c.name.startswith(("drag:", "square:"))]


def test_sources_that_are_not_built_say_what_to_run(tmp_path: Path) -> None:
    (tmp_path / "phugoid").mkdir()
    shutil.copy(str(ph.__file__), tmp_path / "phugoid")
    code = [sys.executable, "-c", "import phugoid"]
    run = subprocess.run(code, cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 1 and "not built" in run.stderr and "pip install ." in run.stderr
    assert "During handling" not in run.stderr
