"""What notebooks show: short tables with the names and numbers of an object, small pictures, and all text escaped."""

from __future__ import annotations

import dataclasses
import math
import os
import pickle
import re
import subprocess
import sys
import types
import xml.etree.ElementTree as xml
from collections.abc import Callable
from pathlib import Path
from typing import Any

import flight_path_twin as twin
import numpy as np
import pictures
import pytest

import phugoid as ph
from phugoid.fit_result import SmoothingStep
from phugoid.notebook import MOST, Html, bullets, equation, notebook_page, paragraph, sparkline, symbol, table
from phugoid.parameters import Estimate, Estimates

EVIL = "<script>alert('1')</script> & more"


def parsed(html: str) -> Any:
    """The element; raises where the HTML is not well-formed."""
    return xml.fromstring(html)


def texts(html: str) -> str:
    """The text, and the names of typeset symbols."""
    names = [symbol.get("title") for symbol in parsed(html).iterfind(".//span[@title]")]
    return " ".join(" ".join(["".join(parsed(html).itertext()), *names]).split())


def rows(html: str) -> list[list[str]]:
    """The texts of the cells; of a typeset symbol its name."""
    return [[named(cell) or "".join(cell.itertext()) for cell in row] for row in parsed(html).iter("tr")]


def named(cell: Any) -> str | None:
    symbol = cell.find("span[@title]")
    return None if symbol is None else symbol.get("title")


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    return ph.estimate(pictures.pitch(), pictures.flights()[0])


@pytest.fixture(scope="module")
def diagnosis(fit: ph.Fit) -> ph.results.Diagnosis:
    return ph.diagnose(fit, validation=pictures.flights()[1])


def test_a_fit_shows_estimates_outputs_and_how_it_ended(fit: ph.Fit) -> None:
    shown = rows(fit._repr_html_())
    mtheta = next(row for row in shown if row[0] == "Mtheta")
    assert mtheta[1] in fit.summary() and mtheta[3]  # the estimate, and its error in %
    q = next(row for row in shown if row[0] == "q")
    assert f"{fit.records[0].rms()['q']:.4g}" in q
    text = texts(fit._repr_html_())
    assert "converged" in text and "pitch" in text and f"log-likelihood {fit.log_likelihood:.3f}" in text
    assert fit._repr_html_().count("<svg") == 2 and len(fit._repr_html_()) < 40_000


def test_tables_of_a_fit(fit: ph.Fit) -> None:
    names = [row[0] for row in rows(fit.parameters._repr_html_())[1:]]
    assert names == list(fit.parameters)
    coloured = rows(fit.robust()._repr_html_())
    ratio = fit.robust().inflation["Mq"]
    assert next(row for row in coloured if row[0] == "Mq")[4] == f"{ratio:.2f}"
    correlation = fit.correlation
    assert f"{len(correlation.pairs())} pair" in texts(correlation._repr_html_())


def test_names_of_parameters_are_typeset_in_tables(fit: ph.Fit) -> None:
    typeset = "<span title='Mtheta'>M<sub>θ</sub></span>"
    profile = fit.profile("Mtheta")["Mtheta"]
    for shown in (fit, fit.parameters, fit.robust(), fit.model, profile):
        assert typeset in shown._repr_html_()
    assert "Mtheta" in str(fit.parameters) and "<" not in str(fit.parameters)
    for name, markup in {
        "Cma": "C<sub>mα</sub>",
        "sigma_az": "σ<sub>az</sub>",
        "Nbeta[run 1]": "N<sub>β</sub>[run 1]",
    }.items():
        assert symbol(name) == f"<span title='{name}'>{markup}</span>"
    for name in ("mass", "q", "a_b_c_d", "_x", "x_", "y z"):
        assert symbol(name) == name
    assert symbol(EVIL) == bullets([EVIL])[bullets([EVIL]).index("&lt;") : bullets([EVIL]).index("</li>")]


def test_an_experiment_shows_its_channels(fit: ph.Fit) -> None:
    t = np.arange(0, 10, 0.1)
    q = np.sin(t)
    q[5:8] = np.nan
    run = ph.Experiment(t, {"de": np.cos(t)}, {"q": q}, name="run 7", units={"q": "rad/s"}).window(0, 5)
    html = run._repr_html_()
    assert rows(html)[2][:3] == ["q", "output", "rad/s"] and "3" in rows(html)[2]
    assert "run 7" in texts(html) and f"{run.n} samples" in texts(html) and html.count("<svg") == 2
    assert all(step in texts(html) for step in run.history)
    record = fit.records[0]._repr_html_()
    assert {"input", "output", "state", "residual"} <= {row[1] for row in rows(record)[1:]}


def test_a_diagnosis_and_what_it_found(diagnosis: ph.results.Diagnosis) -> None:
    text = texts(diagnosis._repr_html_())
    assert "The model misses q':q|q|." in text and "named" in text and "100 %" in text
    finding = diagnosis.findings[0]
    said = texts(finding._repr_html_())
    assert "q':q|q|" in said and finding.explanation in said and "-1.99" in said
    misfit = diagnosis.misfit
    assert [row[0] for row in rows(misfit._repr_html_())[1:]] == list(misfit.worst)
    assert misfit._repr_html_().count("<svg") == len(misfit.worst)
    extension = diagnosis.extend()
    assert "-95 %" in texts(extension._repr_html_()) and "q_dot_q_abs_q" in texts(extension._repr_html_())
    assert "-95 %" in texts(extension.gain._repr_html_())


def test_iterations_and_findings_are_sequences_shown_as_tables(fit: ph.Fit, diagnosis: ph.results.Diagnosis) -> None:
    history = fit.history
    shown = rows(history._repr_html_())
    assert [row[0] for row in shown[1:]] == [str(i.number) for i in history]
    assert history == list(history) and history[:2] == list(history)[:2] and history[-1].number == len(history) - 1
    assert ph.estimate(fit.model, fit.experiments[0]).history[-1] == history[-1]
    findings = diagnosis.findings
    assert [row[0] for row in rows(findings._repr_html_())[1:]] == [f.cause for f in findings]
    assert findings == tuple(findings) and findings[:1] == tuple(findings)[:1] and isinstance(findings, tuple)
    for each in (history, findings):
        again = pickle.loads(pickle.dumps(each))
        assert type(again) is type(each) and again._repr_html_() == each._repr_html_()
    nothing = dataclasses.replace(diagnosis, findings=())
    assert nothing.findings == () and "0 findings" in texts(nothing.findings._repr_html_())


def test_candidates_are_cut_short(fit: ph.Fit) -> None:
    library = ph.candidates(fit.model)
    html = library._repr_html_()
    assert len(rows(html)) == MOST + 1 and f"and {len(library) - MOST} more" in texts(html)
    assert rows(html)[1][0] == library.names[0]


def test_a_model_shows_its_equations() -> None:
    m = pictures.pitch()
    latex = m._repr_latex_()
    assert latex is not None and m.latex() in latex and latex.startswith("$$") and latex.endswith("$$")
    m = ph.Model("long")
    x = m.states(" ".join(f"x{i}" for i in range(60)))
    m.dynamics(**{f"x{i}": sum(x, 0 * x[0]) for i in range(60)})
    m.outputs(y=x[0])
    assert m._repr_latex_() is None


def test_dead_bands_and_saturations_are_readable_in_latex() -> None:
    m = ph.Model("servo")
    (x,) = m.states("x")
    (u,) = m.inputs("u")
    b, c, s = m.parameters("b c s")

    def limited(e: ph.Expr) -> ph.Expr:
        return 0.5 * (ph.smooth_abs(e + s, 3e-3) - ph.smooth_abs(e - s, 3e-3))

    m.dynamics(x=b * (u - limited(u)) + c * (x + (-limited(x))) + (u + limited(u) - u))
    m.outputs(x=limited(x))
    latex = m._repr_latex_()
    assert latex is not None and "sqrt" not in latex
    clip = r"\operatorname{clip}\left(%s, \pm s\right)"
    assert rf"b \, \left(u - {clip % 'u'}\right) + c \, \left(x - {clip % 'x'}\right) + {clip % 'u'} \\" in latex
    assert rf"\tilde{{x}} &= {clip % 'x'}" in latex
    assert "b*(u - clip(u, ±s)) + c*(x - clip(x, ±s)) + clip(u, ±s)" in str(m)


def planned(fit: ph.Fit) -> ph.results.Plan:
    return ph.design.plan(fit, fit.experiments[0], limits={"q": 0.1})


def path(_: ph.Fit) -> ph.results.Reconstruction:
    return ph.reconstruct(twin.measured(twin.flown(), 0), ("V", "alpha", "beta", "phi", "theta"), delayed=("alpha",))


def response(fit: ph.Fit) -> ph.results.FrequencyResponse:
    return ph.linear.frequency_response(fit.experiments[0], "de", "q", "h1")


def trimmed(fit: ph.Fit) -> ph.results.Trim:
    return ph.linear.trim(fit, at={"de": 0.1})


# What makes a result, the words and numbers that it shows, and how many pictures.
SHOWN: dict[str, tuple[Callable[[ph.Fit], Any], Callable[[Any], list[str]], int]] = {
    "Validation": (
        lambda fit: fit.validate(pictures.flights()[1]),
        lambda v: [
            "converged",
            "second manoeuvre",
            f"{v.matches['q'].rms:.4g}",
            f"{v.log_likelihood:.3f}",
            *v.in_words(),
        ],
        2,
    ),
    "Match": (
        lambda fit: fit.validate(pictures.flights()[1]).matches["q"],
        lambda m: ["Match of q", f"{m.theil:.4f}", f"{m.r_squared:.4f}", str(m.samples)],
        0,
    ),
    "Multistart": (
        lambda fit: ph.multistart(fit.model, fit.experiments[0], dict.fromkeys(("Mq", "Mtheta"), (-3, 1)), n=3),
        lambda m: ["complete", "3, all finished", f"{m.optima[0].log_likelihood:.3f}", "Mtheta", "evidence that it is"],
        0,
    ),
    "Bootstrap": (
        lambda fit: fit.bootstrap(4),
        lambda b: ["4 of 4 runs converged", f"{b.std_errors['Mq']:.2g}", f"{b.intervals()['Mde'][1]:.5g}"],
        5,
    ),
    "StateSpace": (
        lambda fit: ph.linear.linearise(fit),
        lambda s: ["q'", f"{s.A[0, 0]:.4g}", f"{s.B[0, 0]:.4g}", f"{s.modes[0].eigenvalue.real:.6g}", "2 states"],
        0,
    ),
    "Profiles": (
        lambda fit: fit.profile(["Mq", "Mde"]),
        lambda p: ["complete", "95 % from", *(f"{end:.5g}" for name in p for end in p[name].interval)],
        2,
    ),
    "Profile": (
        lambda fit: fit.profile("Mq")["Mq"],
        lambda p: ["Mq", f"{p.value:.5g}", f"{p.interval[0]:.5g}", "drops by 1.92"],
        1,
    ),
    "Modes": (
        lambda fit: ph.linear.modes(fit),
        lambda m: [
            "1 oscillating, 0 not",
            "damping ratio",
            f"{m.eigenvalues[0].real:.6g} ± {m.eigenvalues[0].imag:.6g}j",
        ],
        0,
    ),
    "Plan": (
        planned,
        lambda p: ["Planned", "Mtheta", f"{p.parameters['Mq'].std_error:.3g}", "-0.1 to 0.1", "determined least"],
        3,
    ),
    "Plans": (
        lambda fit: ph.design.plans(fit, {"one": fit.experiments[0], "other": pictures.flights()[1]}),
        lambda p: ["2 plans", "one", "other", f"{100 * p['one'].criteria['worst']:.3g}", "limits kept"],
        0,
    ),
    "Trim": (trimmed, lambda t: ["state", "theta", f"{t['theta']:.6g}", "held"], 0),
    "Improvement": (
        lambda fit: fit.improve(pictures.flights()[1]),
        lambda i: ["pitch: improvement", "q':q|q|", i.verdict, "-95 %"],
        0,
    ),
    "Reconstruction": (path, lambda r: ["Flight path of", "b_q", f"{r.fit.parameters['b_q'].std_error:.2g}", "RMS"], 5),
    "Bands": (
        lambda fit: fit.prediction_bands(),
        lambda b: ["95 % for coloured noise", f"{b.std_errors['q'].mean():.3g}", "measured inside"],
        2,
    ),
    "FrequencyResponse": (
        response,
        lambda r: ["de to q", "coherence", f"{r.magnitude_db.max():.4g}", f"{r.frequencies_hz.size} frequencies"],
        3,
    ),
    "Model": (lambda fit: fit.model, lambda m: ["pitch", "2 states", "Mtheta", "rad/s", "output", "parameter"], 0),
}


@pytest.mark.parametrize("kind", SHOWN)
def test_a_result_shows_its_names_and_numbers(kind: str, fit: ph.Fit) -> None:
    make, words, drawn = SHOWN[kind]
    result = make(fit)
    assert type(result).__name__ == kind
    html = result._repr_html_()
    shown, text = rows(html), texts(html)  # well-formed, or else an error
    assert [word for word in words(result) if " ".join(word.split()) not in text] == []
    assert html.count("<svg") == drawn and len(html) < 40_000 and 2 <= len(shown) <= 2 * (MOST + 1)


def test_passes_of_an_estimation_are_shown_as_tables(fit: ph.Fit) -> None:
    refined = ph.estimate(fit.model, fit.experiments[0], transcription=ph.Collocation(refine=True)).refinement
    assert refined is not None
    html = refined._repr_html_()
    assert "tolerance" in texts(html) and str(refined.steps[-1].segments) in [row[1] for row in rows(html)]
    smoothed = ph.results.Smoothing(
        {"sign(q) in q'": (0.01, "rad/s")},
        (SmoothingStep(0.1, 40, 5, 12.5),),
        {"Mq": (0.002, 0.05)},
    )
    assert "over 0.01 rad/s" in texts(smoothed._repr_html_()) and ["Mq", "+0.002"] in [
        row[:2] for row in rows(smoothed._repr_html_())
    ]


def test_a_large_model_is_cut_short() -> None:
    m = ph.Model("large")
    x = m.states(" ".join(f"x{i}" for i in range(60)))
    m.dynamics(**{f"x{i}": sum(x, 0 * x[0]) for i in range(60)})
    m.outputs(y=x[0])
    html = m._repr_html_()
    assert "and 36 more" in texts(html) and "…" in texts(html) and len(rows(html)) == 2 * (MOST + 1)


def test_a_frequency_response_from_zero_without_any_motion() -> None:
    silent = ph.results.FrequencyResponse(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 0.0]), "u", "y")
    assert "3 frequencies" in texts(silent._repr_html_()) and not math.isfinite(silent.magnitude_db[0])


def test_keys_are_completed(fit: ph.Fit) -> None:
    assert fit.parameters._ipython_key_completions_() == list(fit.parameters)
    library = ph.candidates(fit.model)
    assert library._ipython_key_completions_() == list(library.names)
    record = pictures.flights()[0]
    assert record.outputs._ipython_key_completions_() == list(record.outputs)
    profiles = fit.profile("Mq")
    assert profiles._ipython_key_completions_() == ["Mq"]


def test_text_is_escaped(fit: ph.Fit) -> None:
    for html in (
        notebook_page(EVIL, paragraph(EVIL), bullets([EVIL]), table([EVIL], [[EVIL]], "l"), note=EVIL),
        ph.Experiment([0, 1], {EVIL: [0, 1]}, name=EVIL, units={EVIL: EVIL})._repr_html_(),
        Estimates([Estimate(EVIL, 1.0, 0.1, EVIL)])._repr_html_(),
    ):
        assert "<script" not in html and "&lt;script&gt;" in html and EVIL in texts(html)
    assert table(["a"], [[Html("<i>b</i>")]], "l").count("<i>") == 1


def test_a_sparkline_is_small_keeps_peaks_and_gaps() -> None:
    long = np.zeros(1_000_000)
    long[123_456] = 5.0
    html = sparkline(long)
    assert len(html) < 6000 and "0 to 5" in html
    (points,) = (line.get("points") for line in parsed(html).iter("polyline"))
    assert min(float(y) for _, y in (p.split(",") for p in points.split())) == 2.0  # the top
    gap = np.sin(np.arange(100.0))
    gap[40:60] = np.nan
    assert len(re.findall("<polyline", sparkline(gap, gap))) == 4
    assert sparkline([np.nan, 1.0]) == "" and sparkline([]) == ""
    assert "<polyline" in sparkline([1.0, 1.0])  # a constant


@pytest.mark.parametrize(
    ("kind", "said"), [("deadband", "- clip(de, ±deadband_de)"), ("saturation", "clip(de, ±saturation_de)")]
)
def test_dead_bands_and_saturations_read_as_such(kind: str, said: str, fit: ph.Fit) -> None:
    extended = ph.candidates(fit.model)[f"de:{kind}"].extended(fit.model)
    assert said in str(extended) and "sqrt" not in str(extended) and "(clip(" not in str(extended)
    markup = equation("q", extended.equations["q'"], rate=True)
    assert (
        "<mi>clip</mi>" in markup
        and "<msqrt>" not in markup
        and ("<mo>−</mo><mi>clip" in markup) == (kind == "deadband")
    )


def test_a_plot_prints_the_names_of_its_axes(fit: ph.Fit) -> None:
    figure, axes = shown = fit.plot(channels=["q"])
    assert repr(axes) == "<axes: q, q residual>" and repr(shown) == f"({figure!r}, <axes: q, q residual>)"
    with pytest.raises(KeyError, match="there is no panel 'Q'. Did you mean 'q'"):
        axes["Q"]


def test_progress_takes_one_line_of_a_notebook(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    shown: list[str] = []

    class Handle:
        def update(self, data: dict[str, str], raw: bool) -> None:
            shown[-1] = data["text/plain"]

    def display(data: dict[str, str], raw: bool, display_id: bool) -> Handle:
        shown.append(data["text/plain"])
        return Handle()

    kernel = types.SimpleNamespace(config={"IPKernelApp": {}})
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: kernel))
    monkeypatch.setitem(sys.modules, "IPython.display", types.SimpleNamespace(display=display))
    fit = ph.estimate(pictures.pitch(), pictures.flights()[0], progress=True)
    assert len(shown) == 1 and f"iteration {fit.iterations:3d}" in shown[0]
    fit.bootstrap(4, progress=True)
    assert len(shown) == 2 and shown[1].endswith("4/4")
    assert capsys.readouterr().err == ""


def test_a_flow_that_equations_share_is_declared(diagnosis: ph.results.Diagnosis) -> None:
    assert not diagnosis.fit.model.quantity_names
    assert not any("m.quantities(...)" in note for note in diagnosis.notes)  # its equations share nothing
    m = ph.Model("tanks")
    h1, h2 = m.states(h1="m", h2="m")
    (u,) = m.inputs(u="m/s")
    k, c = m.parameters(k=0.5, c=0.3)
    m.dynamics(h1=u - k * h1, h2=k * h1 - c * h2)
    m.outputs(h1=h1, h2=h2)
    t = np.arange(0.0, 30.0, 0.2)
    run = ph.Experiment(t, {"u": 0.3 + 0.2 * np.sign(np.sin(0.5 * t))}, {}, name="a")
    flow = ph.simulate(m, {"k": 0.4, "c": 0.2}, run, initial={"h1": 1.0, "h2": 1.0})
    rng = np.random.default_rng(0)
    noisy = {n: y + 0.01 * rng.standard_normal(t.size) for n, y in flow.outputs.items()}
    d = ph.diagnose(ph.estimate(m, ph.Experiment(t, {"u": run.inputs["u"]}, noisy, name="a")))
    assert any("k_term = k*h1" in note for note in d.notes)


def test_every_figure_of_a_notebook_is_shown(tmp_path: Path) -> None:
    """A backend of notebooks turns interactive drawing on when it is loaded, and shows figures made while it is on."""
    (tmp_path / "backend_of_notebooks.py").write_text(
        "import matplotlib\nfrom matplotlib.backends.backend_agg import *\nmatplotlib.interactive(True)\n"
    )
    program = (
        "import matplotlib.pyplot as plt\nfrom phugoid.figures import styled\n"
        "with styled():\n    plt.subplots()\nprint(plt.get_backend(), plt.isinteractive())\n"
    )
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    said = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "MPLBACKEND": "module://backend_of_notebooks", "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.split() == ["module://backend_of_notebooks", "True"]
