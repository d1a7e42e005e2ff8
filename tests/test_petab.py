"""Problems in the PEtab format: what is read is compared with an integration and densities written out by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_case import run
from scipy.integrate import solve_ivp
from scipy.stats import laplace, lognorm, norm

import phugoid as ph

libsbml = pytest.importorskip("libsbml", reason="python-libsbml is not installed")
pytest.importorskip("petab", reason="petab is not installed")

COLLECTION = Path(__file__).parents[2] / "shared" / "data" / "petab"


def sbml(change: Callable[[Any], None] = lambda model: None) -> str:
    """A -> B -> nothing in a volume of 2, with a rule, an initial assignment and a step in time."""
    document = libsbml.SBMLDocument(3, 1)
    model = document.createModel()
    model.setId("chain")

    def parameter(name: str, value: float, constant: bool = True) -> None:
        p = model.createParameter()
        p.setId(name)
        p.setValue(value)
        p.setConstant(constant)

    c = model.createCompartment()
    c.setId("cell")
    c.setSize(2.0)
    c.setConstant(True)
    for name, initial in (("A", 3.0), ("B", 0.0)):
        s = model.createSpecies()
        s.setId(name)
        s.setCompartment("cell")
        s.setInitialConcentration(initial)
        s.setConstant(False)
        s.setBoundaryCondition(False)
        s.setHasOnlySubstanceUnits(False)
    for name, value in (("k1", 0.7), ("k2", 0.3), ("dose", 0.0), ("b0", 0.5), ("half", 1.5)):
        parameter(name, value)
    parameter("inflow", 0.0, False)
    assigned = model.createInitialAssignment()
    assigned.setSymbol("B")
    assigned.setMath(libsbml.parseL3Formula("b0 * k2"))
    rule = model.createAssignmentRule()
    rule.setVariable("inflow")
    rule.setMath(libsbml.parseL3Formula("dose * piecewise(1, time < half, 0.25)"))
    for name, law, before, after in (
        ("into", "cell * inflow", None, "A"),
        ("first", "cell * k1 * A", "A", "B"),
        ("second", "cell * k2 * B", "B", None),
    ):
        r = model.createReaction()
        r.setId(name)
        r.setReversible(False)
        r.setFast(False)
        r.createKineticLaw().setMath(libsbml.parseL3Formula(law))
        for species, create in ((before, r.createReactant), (after, r.createProduct)):
            if species is not None:
                reference = create()
                reference.setSpecies(species)
                reference.setStoichiometry(1.0)
                reference.setConstant(True)
    change(model)
    return str(libsbml.writeSBMLToString(document))


PARAMETERS = """parameterId\tparameterScale\tlowerBound\tupperBound\tnominalValue\testimate
k1\tlog10\t0.001\t100\t0.9\t1
k2\tlog10\t0.001\t100\t0.4\t1
scale\tlin\t0\t10\t2\t1
noise_a\tlog10\t0.001\t10\t0.05\t1
noise_b\tlin\t0\t1\t0.1\t1
fixed\tlin\t0\t10\t1.25\t0
"""
OBSERVABLES = """observableId\tobservableFormula\tnoiseFormula\tobservableTransformation\tnoiseDistribution
a\tobservableParameter1_a * A\tnoise_a + noise_b * A\tlin\tnormal
b\tB + 0.1\tnoiseParameter1_b\tlog10\tnormal
sum\tA + B\t0.2\tlin\tlaplace
"""
HEAD = (
    "observableId\tpreequilibrationConditionId\tsimulationConditionId\tmeasurement\ttime\tobservableParameters\t"
    "noiseParameters\n"
)
MEASUREMENTS = (
    HEAD
    + """a\t\tlow\t2.1\t1\tscale\t
a\t\tlow\t2.3\t1\tscale\t
a\t\thigh\t1.1\t2\tfixed\t
b\t\tlow\t0.8\t0.5\t\t0.1
b\t\tlow\t0.9\t3\t\t0.2
b\t\thigh\t1.4\t3\t\tnoise_a
sum\t\thigh\t2.5\t4\t\t
"""
)
CONDITIONS = "conditionId\tdose\tb0\nlow\t0.2\t0.5\nhigh\t1.5\tscale\n"


def problem(
    folder: Path,
    model: str | None = None,
    measurements: str = MEASUREMENTS,
    conditions: str = CONDITIONS,
    parameters: str = PARAMETERS,
    observables: str = OBSERVABLES,
) -> Path:
    """Write a problem, and return the path of its YAML file."""
    (folder / "model.xml").write_text(model or sbml())
    tables = {
        "measurements": measurements,
        "conditions": conditions,
        "parameters": parameters,
        "observables": observables,
    }
    for name, text in tables.items():
        (folder / f"{name}.tsv").write_text(text)
    path = folder / "problem.yaml"
    path.write_text(
        "format_version: 1\nparameter_file: parameters.tsv\nproblems:\n- condition_files: [conditions.tsv]\n"
        "  measurement_files: [measurements.tsv]\n  observable_files: [observables.tsv]\n  sbml_files: [model.xml]\n"
    )
    return path


def concentrations(
    t: float, k1: float, k2: float, dose: float, b0: float, first: Sequence[float] | None = None
) -> tuple[float, float]:
    """Integrate the chain, its step at 1.5 an end of an integration."""

    def slope(inflow: float) -> Callable[[float, Any], list[float]]:
        return lambda _, x: [inflow - k1 * x[0], k1 * x[0] - k2 * x[1]]

    x = np.array([3.0, b0 * k2] if first is None else first)
    for begin, end, inflow in ((0.0, min(t, 1.5), dose), (1.5, t, 0.25 * dose)):
        if end > begin:
            x = solve_ivp(slope(inflow), (begin, end), x, rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]
    return float(x[0]), float(x[1])


def by_hand(k1: float, k2: float, scale: float, noise_a: float, noise_b: float) -> float:
    """The log-likelihood of the problem as its tables say."""

    def log10_density(z: float, y: float, sigma: float) -> float:
        return float(norm.logpdf(math.log10(z), math.log10(y), sigma)) - math.log(z * math.log(10))

    low, high = ((k1, k2, 0.2, 0.5), (k1, k2, 1.5, scale))
    A = concentrations(1, *low)[0]
    total = sum(norm.logpdf(z, scale * A, noise_a + noise_b * A) for z in (2.1, 2.3))
    A = concentrations(2, *high)[0]
    total += norm.logpdf(1.1, 1.25 * A, noise_a + noise_b * A)
    total += log10_density(0.8, concentrations(0.5, *low)[1] + 0.1, 0.1)
    total += log10_density(0.9, concentrations(3, *low)[1] + 0.1, 0.2)
    total += log10_density(1.4, concentrations(3, *high)[1] + 0.1, noise_a)
    total += laplace.logpdf(2.5, sum(concentrations(4, *high)), 0.2)
    return float(total)


NOMINAL = {"k1": 0.9, "k2": 0.4, "scale": 2.0, "noise_a": 0.05, "noise_b": 0.1}


@pytest.mark.parametrize("change", [{}, {"k1": 0.5, "noise_b": 0.3}, {"scale": 0.7, "noise_a": 0.4}])
def test_the_log_likelihood_is_that_of_the_tables(tmp_path: Path, change: dict[str, float]) -> None:
    p = ph.read_petab(problem(tmp_path))
    assert dict(p.nominal) == NOMINAL
    assert p.log_likelihood(change) == pytest.approx(by_hand(**{**NOMINAL, **change}), abs=1e-6)


@pytest.mark.parametrize(("multiplier", "unit"), [(60.0, "min"), (3600.0, "h"), (1.0, "s"), (7.0, "tick")])
def test_the_unit_of_time_is_that_of_the_model(tmp_path: Path, multiplier: float, unit: str) -> None:
    def with_unit(model: Any) -> None:
        definition = model.createUnitDefinition()
        definition.setId("tick")
        tick = definition.createUnit()
        tick.setKind(libsbml.UNIT_KIND_SECOND)
        tick.setMultiplier(multiplier)
        tick.setExponent(1)
        tick.setScale(0)
        model.setTimeUnits("tick")

    assert ph.read_petab(problem(tmp_path, sbml(with_unit))).model.time_unit == unit


def test_an_estimate_has_the_likelihood_of_the_integration(tmp_path: Path) -> None:
    p = ph.read_petab(problem(tmp_path))
    held = p.model.with_parameters({n: ph.Parameter(NOMINAL[n], fixed=True) for n in ("noise_a", "noise_b", "scale")})
    fit = ph.estimate(held, p.experiments)
    assert fit.feasible and fit.parameters["k1"].value != 0.9
    values = {n: e.value for n, e in fit.parameters.items()}
    # The Laplace density is smoothed by 1e-4.
    assert fit.log_likelihood + p.constant == pytest.approx(by_hand(**values), abs=1e-3)
    assert fit.log_likelihood + p.constant > p.log_likelihood()


def test_a_steady_state_comes_before(tmp_path: Path) -> None:
    rows = "a\tlow\thigh\t2.1\t0\tscale\t\nb\tlow\thigh\t0.9\t2\t\t0.1\n"
    p = ph.read_petab(problem(tmp_path, measurements=HEAD + rows))
    # At rest before the step: inflow = k1 A = k2 B.
    rest = (0.2 / 0.9, 0.2 / 0.4)
    B = concentrations(2, 0.9, 0.4, 1.5, 0.0, rest)[1]
    expected = norm.logpdf(2.1, 2 * rest[0], 0.05 + 0.1 * rest[0])
    expected += norm.logpdf(math.log10(0.9), math.log10(B + 0.1), 0.1) - math.log(0.9 * math.log(10))
    assert p.log_likelihood() == pytest.approx(float(expected), abs=1e-5)
    held = p.model.with_parameters(
        {n: ph.Parameter(v, fixed=True) for n, v in NOMINAL.items() if n in p.nominal and n != "k1"}
    )
    fit = ph.estimate(held, p.experiments)
    assert fit.feasible
    assert fit.log_likelihood + p.constant == pytest.approx(
        p.log_likelihood({n: e.value for n, e in fit.parameters.items()}), abs=1e-3
    )


@pytest.mark.parametrize("k1", [0.9, 0.05, 1e-5])
def test_a_steady_state_is_as_long_as_the_parameters_need(tmp_path: Path, k1: float) -> None:
    p = ph.read_petab(problem(tmp_path, measurements=HEAD + "a\tlow\thigh\t2.1\t0\tscale\t\n"))
    rest = 0.2 / k1
    expected = float(norm.logpdf(2.1, 2 * rest, 0.05 + 0.1 * rest))
    assert p.log_likelihood({"k1": k1}) == pytest.approx(expected, abs=1e-4)
    longer = p.at_rest({"k1": k1})
    assert (longer is p) == (k1 > 0.01)
    assert longer.experiments[0].t[0] <= p.experiments[0].t[0]
    assert longer.at_rest({"k1": k1}) is longer


@pytest.mark.parametrize(("given", "first"), [("5", 5.0), ("scale", 2.0), ("", 0.2 / 0.9)])
def test_a_condition_sets_a_state_anew_after_the_steady_state(tmp_path: Path, given: str, first: float) -> None:
    rows = "a\tlow\thigh\t2.1\t0\tscale\t\nb\tlow\thigh\t0.9\t2\t\t0.1\n"
    conditions = f"conditionId\tdose\tb0\tA\nlow\t0.2\t0.5\t3\nhigh\t1.5\tscale\t{given}\n"
    p = ph.read_petab(problem(tmp_path, measurements=HEAD + rows, conditions=conditions))
    # B stays at rest, inflow = k2 B; A begins anew unless the entry is empty.
    B = concentrations(2, 0.9, 0.4, 1.5, 0.0, (first, 0.2 / 0.4))[1]
    expected = norm.logpdf(2.1, 2 * first, 0.05 + 0.1 * first)
    expected += norm.logpdf(math.log10(0.9), math.log10(B + 0.1), 0.1) - math.log(0.9 * math.log(10))
    assert p.log_likelihood() == pytest.approx(float(expected), abs=1e-5)


def test_a_state_set_anew_in_some_conditions_only_is_named(tmp_path: Path) -> None:
    rows = "a\tlow\thigh\t2.1\t0\tscale\t\na\tlow\tlow\t2.1\t1\tscale\t\n"
    conditions = "conditionId\tdose\tb0\tA\nlow\t0.2\t0.5\t\nhigh\t1.5\tscale\t5\n"
    with pytest.raises(ph.ModelError, match=r"the state A is set after the steady state in some conditions.*\(low\)"):
        ph.read_petab(problem(tmp_path, measurements=HEAD + rows, conditions=conditions))


def test_an_event_at_a_given_time_is_a_step(tmp_path: Path) -> None:
    def with_event(model: Any) -> None:
        model.getParameter("dose").setConstant(False)
        event = model.createEvent()
        event.setId("stop")
        event.setUseValuesFromTriggerTime(True)
        trigger = event.createTrigger()
        trigger.setMath(libsbml.parseL3Formula("time >= 1"))
        trigger.setInitialValue(False)
        trigger.setPersistent(True)
        assignment = event.createEventAssignment()
        assignment.setVariable("dose")
        assignment.setMath(libsbml.parseL3Formula("0.5"))
        model.getRuleByVariable("inflow").setMath(libsbml.parseL3Formula("dose"))

    conditions = "conditionId\tb0\nlow\t0.5\n"
    rows = "b\t\tlow\t0.9\t3\t\t0.1\n"
    p = ph.read_petab(problem(tmp_path, sbml(with_event), HEAD + rows, conditions))
    x = np.array([3.0, 0.5 * 0.4])
    for begin, end, inflow in ((0.0, 1.0, 0.0), (1.0, 3.0, 0.5)):
        slope = lambda _, x, u=inflow: [u - 0.9 * x[0], 0.9 * x[0] - 0.4 * x[1]]  # noqa: E731
        x = solve_ivp(slope, (begin, end), x, rtol=1e-11, atol=1e-12).y[:, -1]
    expected = norm.logpdf(math.log10(0.9), math.log10(x[1] + 0.1), 0.1) - math.log(0.9 * math.log(10))
    assert p.log_likelihood() == pytest.approx(float(expected), abs=1e-6)


def _set_at(model: Any, name: str, time: float, variable: str, formula: str) -> None:
    """Add an event that sets a variable at a time."""
    event = model.createEvent()
    event.setId(name)
    event.setUseValuesFromTriggerTime(True)
    trigger = event.createTrigger()
    trigger.setMath(libsbml.parseL3Formula(f"time >= {time}"))
    trigger.setInitialValue(False)
    trigger.setPersistent(True)
    assignment = event.createEventAssignment()
    assignment.setVariable(variable)
    assignment.setMath(libsbml.parseL3Formula(formula))


_DOSES = ((1.0, "0.5 * A + 2"), (2.0, "1.5"), (2.5, "A + b0"))
_AFTER: tuple[Callable[[float], float], ...] = (lambda a: 0.5 * a + 2, lambda _: 1.5, lambda a: a + 0.7)


@pytest.mark.parametrize("chosen", [(0,), (1,), (2,), (0, 2), (1, 0, 2)])
def test_events_at_given_times_make_states_jump(tmp_path: Path, chosen: tuple[int, ...]) -> None:
    def with_events(model: Any) -> None:
        for k in chosen:
            _set_at(model, f"dose_{k}", _DOSES[k][0], "A", _DOSES[k][1])

    at = (0.5, 1.0, 1.7, 2.2, 3.0)
    rows = "".join(f"a\t\tlow\t2.1\t{t}\t1\t\n" for t in at)
    observables = OBSERVABLES.replace("noise_a + noise_b * A", "0.1")
    conditions = "conditionId\tdose\tb0\nlow\t0\t0.7\n"
    p = ph.read_petab(problem(tmp_path, sbml(with_events), HEAD + rows, conditions, observables=observables))
    jumps = sorted((_DOSES[k][0], k) for k in chosen)
    expected = 0.0
    for t in at:
        a, begin = 3.0, 0.0
        for time, k in (j for j in jumps if j[0] <= t):
            a = _AFTER[k](a * math.exp(-0.9 * (time - begin)))
            begin = time
        expected += float(norm.logpdf(2.1, a * math.exp(-0.9 * (t - begin)), 0.1))
    assert p.log_likelihood() == pytest.approx(expected, abs=1e-5)


def test_a_state_jumps_after_its_steady_state(tmp_path: Path) -> None:
    def with_event(model: Any) -> None:
        model.getRuleByVariable("inflow").setMath(libsbml.parseL3Formula("dose"))
        _set_at(model, "bolus", 0.0, "A", "A + 2")

    rows = "a\tlow\tlow\t2.1\t1\t1\t\n"
    observables = OBSERVABLES.replace("noise_a + noise_b * A", "0.1")
    conditions = "conditionId\tdose\tb0\nlow\t0.9\t0.7\n"
    p = ph.read_petab(problem(tmp_path, sbml(with_event), HEAD + rows, conditions, observables=observables))
    # It rests at inflow / k1 = 1, jumps to 3, and returns.
    expected = float(norm.logpdf(2.1, 1.0 + 2.0 * math.exp(-0.9), 0.1))
    assert p.log_likelihood() == pytest.approx(expected, abs=1e-5)


def test_a_jump_that_depends_on_another_state_is_named(tmp_path: Path) -> None:
    text = sbml(lambda model: _set_at(model, "mix", 1.0, "A", "A + B"))
    with pytest.raises(ph.ModelError, match="event mix: not supported: the value of A depends on B, other than"):
        ph.read_petab(problem(tmp_path, text))


def test_a_comparison_of_conditions_is_decided_before(tmp_path: Path) -> None:
    p = ph.read_petab(
        problem(tmp_path, sbml(_rule("piecewise(0.2, dose == 0.2, 1.5) * piecewise(1, time < half, 0.25)")))
    )
    assert p.log_likelihood() == pytest.approx(by_hand(**NOMINAL), abs=1e-6)


def _rule(formula: str) -> Callable[[Any], None]:
    return lambda model: model.getRuleByVariable("inflow").setMath(libsbml.parseL3Formula(formula))


def _algebraic(model: Any) -> None:
    model.createAlgebraicRule().setMath(libsbml.parseL3Formula("A + B - 3"))


def _event_of_a_state(model: Any) -> None:
    event = model.createEvent()
    event.setId("full")
    event.createTrigger().setMath(libsbml.parseL3Formula("A > 2"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_algebraic, "algebraic rule"),
        (_event_of_a_state, "event full: not supported: its trigger is not that a known time is reached"),
        (_rule("dose * delay(A, 1)"), "rule of inflow: a delay is not supported"),
        (_rule("dose * floor(time)"), "rule of inflow: floor is not supported"),
        (_rule("dose * piecewise(1, time < k1, 0)"), "is positive depends on k1, which is estimated"),
        (_rule("dose * piecewise(1, time^2 < 2, 0)"), "a condition that is not linear in time"),
    ],
)
def test_what_is_not_supported_is_named(tmp_path: Path, change: Callable[[Any], None], words: str) -> None:
    with pytest.raises(ph.ModelError, match=words):
        ph.read_petab(problem(tmp_path, sbml(change)))


def test_bad_tables_are_errors_that_say_where(tmp_path: Path) -> None:
    unknown = OBSERVABLES.replace("A + B", "A + C")
    with pytest.raises(ph.ModelError, match="nothing says what C is"):
        ph.read_petab(problem(tmp_path, observables=unknown))
    with pytest.raises(ph.DataError, match="measurement of b is -0.8, which has no logarithm"):
        ph.read_petab(problem(tmp_path, measurements=MEASUREMENTS.replace("\t0.8\t", "\t-0.8\t")))
    with pytest.raises(ph.DataError, match="there is no such file"):
        ph.read_petab(tmp_path / "absent.yaml")


def test_results_go_back_as_a_parameter_table(tmp_path: Path) -> None:
    p = ph.read_petab(problem(tmp_path))
    p.write_parameters({"k1": 0.5}, tmp_path / "parameters.tsv")
    assert ph.read_petab(tmp_path / "problem.yaml").nominal["k1"] == 0.5
    with pytest.raises(ph.ModelError, match="'k9' is not in the parameter table"):
        p.write_parameters({"k9": 0.5}, tmp_path / "parameters.tsv")


def test_the_command_line_estimates_and_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = problem(tmp_path)
    # With three noise parameters for seven samples the likelihood has no maximum.
    table = PARAMETERS.replace("0.05\t1", "0.05\t0").replace("0.1\t1", "0.1\t0")
    (tmp_path / "parameters.tsv").write_text(table)
    out = tmp_path / "found.tsv"
    done = run("petab", str(path), "--starts", "4", "--out", str(out), "--plot", str(tmp_path / "w.png"), "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    p = ph.read_petab(path)
    assert facts["nominal_log_likelihood"] == pytest.approx(p.log_likelihood())
    assert facts["at_best"] >= 2 and facts["log_likelihood"] > facts["nominal_log_likelihood"]
    assert (tmp_path / "w.png").stat().st_size > 1000
    (tmp_path / "parameters.tsv").write_text(out.read_text())
    assert ph.read_petab(path).log_likelihood() == pytest.approx(facts["log_likelihood"], abs=1e-3)
    assert run("petab", str(tmp_path / "no.yaml")).exit_code == 2


def test_starts_fill_the_bounds_and_may_be_screened(tmp_path: Path) -> None:
    p = ph.read_petab(problem(tmp_path))
    starts = p.starts(20, seed=3)
    assert starts == p.starts(20, seed=3) != p.starts(20, seed=4)
    decades = sorted(math.floor(math.log10(s["k1"])) for s in starts)
    assert decades == [-3] * 4 + [-2] * 4 + [-1] * 4 + [0] * 4 + [1] * 4  # a Latin hypercube of logarithms
    screened = p.starts(3, seed=3, screened_from=20)
    ranks = sorted((p._screened(s) for s in starts), reverse=True)
    assert [p.log_likelihood(s) for s in screened] == ranks[:3]


@pytest.mark.parametrize(
    ("kind", "density"),
    [
        ("parameterScaleNormal", float(norm.logpdf(math.log10(0.9), 0.1, 0.5))),
        ("logNormal", float(lognorm.logpdf(0.9, 0.5, scale=math.exp(0.1)))),
        ("normal", float(norm.logpdf(0.9, 0.1, 0.5))),
    ],
)
def test_a_prior_counts_as_a_measurement(tmp_path: Path, kind: str, density: float) -> None:
    head, *rows = PARAMETERS.splitlines()
    rows = [r + (f"\t{kind}\t0.1;0.5" if r.startswith("k1") else "\t\t") for r in rows]
    table = "\n".join([f"{head}\tobjectivePriorType\tobjectivePriorParameters", *rows, ""])
    p = ph.read_petab(problem(tmp_path, parameters=table))
    assert p.log_likelihood() == pytest.approx(by_hand(**NOMINAL) + density, abs=1e-6)


# Log-likelihoods at the published points, as the benchmark collection gives them (Hass et al. 2019).
PUBLISHED = {
    "Boehm_JProteomeRes2014": -138.22200,
    "Bruno_JExpBot2016": 46.68818,
    "Crauste_CellSystems2017": -190.96398,
    "Elowitz_Nature2000": 63.20279,
    "Fiedler_BMCSystBiol2016": 58.58387,
    "Rahman_MBS2016": -21.15349,
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_points_have_their_published_likelihood_and_are_kept(name: str) -> None:
    path = COLLECTION / name / f"{name}.yaml"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    p = ph.read_petab(path)
    assert p.log_likelihood() == pytest.approx(PUBLISHED[name], abs=1e-3)
    fit = ph.estimate(p.model, p.experiments, solver=ph.Newton(time_limit=15))
    assert fit.log_likelihood + p.constant > PUBLISHED[name] - 1e-3
