"""A diagnosis in words, in figures and as a page; the diagnosis itself is made by hand here."""

from __future__ import annotations

import dataclasses
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib import pyplot as plt

import phugoid as ph
from phugoid.discrepancy.misfit.misfit import misfit
from phugoid.discrepancy.page import diagnosis_summary, headline, outcome, report
from phugoid.discrepancy.page.figures import explained_figure, findings_figure, gain_figure, ranking_figure
from phugoid.discrepancy.search.finding import DiagnosisResult, Finding, Scored
from phugoid.errors import DataError, UnknownName
from phugoid.notebook import equation
from phugoid.results import Extension, Gain

NAN = math.nan
VOID = {"meta", "img", "mspace", "br", "source"}
FINDING = Finding(
    cause="q':q|q|",
    aliases=("q':q^2",),
    status="named",
    coefficient=-0.8,
    std_error=0.05,
    interval=(-0.9, -0.7),
    unit="1/rad",
    parameters={"Mqq": (-0.8, 0.05)},
    gain=120.0,
    held_out_gain=31.5,
    threshold=17.0,
    explanation="Damping grows with the rate <b>itself</b> & more.",
    advice="A manoeuvre with rates of both signs.",
    alternatives={"q':q^2": 96.0},
)
SURROGATE = dataclasses.replace(FINDING, cause="de:scale", aliases=(), status="surrogate", alternatives={}, advice="")
MINOR = dataclasses.replace(
    FINDING,
    cause="q:bias",
    aliases=(),
    status="minor",
    alternatives={},
    explained=0.012,
    explained_interval=(-0.004, 0.03),
    explained_outputs={"q": 0.01, "theta": 0.002},
)
UNCERTAIN = dataclasses.replace(MINOR, explained=0.6, explained_interval=(-0.4, 1.0))
UNEXPLAINED = dataclasses.replace(
    SURROGATE, cause="", status="unexplained", coefficient=NAN, std_error=NAN, interval=(NAN, NAN), held_out_gain=NAN
)


class Told(SimpleNamespace):
    """What a diagnosis says of given findings."""

    found = DiagnosisResult.found
    verdict = DiagnosisResult.verdict
    structured_outputs = DiagnosisResult.structured_outputs
    is_extended = DiagnosisResult.is_extended
    _extension = None


def model(complete: bool) -> ph.Model:
    m = ph.Model('pitch <i>&amp;</i> "quoted"')
    q, theta = m.states(q="rad/s", theta="rad")
    (de,) = m.inputs(de="rad")
    Mq, Mde = m.parameters(Mq=-1.0, Mde=-5.0)
    late = de
    if complete:
        Mqq, tau = m.parameters(Mqq=0.0, tau=ph.Parameter(0.0, bounds=(-0.2, 0.4), unit="s"))
        late = m.delay(de, tau)
    m.dynamics(q=Mq * q + Mde * late + (Mqq * q * abs(q) if complete else 0.0), theta=q)
    m.outputs(q=(q, "rad/s"), theta=(theta, "rad"))
    return m


@pytest.fixture(scope="module")
def fits() -> tuple[ph.Fit, ph.Fit]:
    """Without and with quadratic damping and a delay, of a record that has both."""
    t = 0.05 * np.arange(400)
    de = 0.2 * np.sign(np.sin(1.3 * t)) * (t > 1.0)
    truth = {"Mq": -0.6, "Mde": -4.0, "Mqq": -0.8, "tau": 0.1}
    run = ph.Experiment(t, {"de": de}, name="<flight> & 1")
    simulated = ph.simulate(model(True), truth, run, initial={"q": 0.0, "theta": 0.0})
    rng = np.random.default_rng(0)
    outputs = {
        n: y + s * rng.standard_normal(t.size)
        for (n, y), s in zip(simulated.outputs.items(), (0.01, 0.004), strict=True)
    }
    data = ph.Experiment(t, {"de": de}, outputs, name="<flight> & 1")
    return ph.estimate(model(False), data), ph.estimate(model(True), data)


@pytest.fixture(scope="module")
def extension(fits: tuple[ph.Fit, ph.Fit]) -> Extension:
    base, extended = fits
    before, after = base.records[0].rms(), extended.records[0].rms()
    gained = extended.log_likelihood - base.log_likelihood
    gain = Gain(gained, 120.0, -2.0 * gained + 12.0, 31.5, before, after, before, {"q": after["q"], "theta": NAN})
    return Extension(extended.model, extended, ("q':q|q|", "de:delay"), gain)


@pytest.fixture(scope="module")
def whole(fits: tuple[ph.Fit, ph.Fit], extension: Extension) -> Any:
    ranking = [
        Scored(
            f"q':term{i}", "Adds <script>alert(1)</script>.", {"c": 0.1}, 200 * 0.6**i, 220 * 0.6**i, 900 * 0.7**i, 0.4
        )
        for i in range(20)
    ]
    ranking[1] = dataclasses.replace(ranking[1], remark="nearly Mq & Mde")
    return Told(
        interrupted=False,
        fit=fits[0],
        misfit=misfit(fits[0]),
        findings=[FINDING, SURROGATE, UNEXPLAINED],
        ranking=ranking,
        threshold=17.0,
        notes=("Half of the record <was> held out.",),
        seconds=1.25,
        extend=lambda minor=False: extension,
    )


@pytest.fixture
def diagnosis(whole: Any) -> Any:
    return Told(**vars(whole))  # for tests to change


@pytest.fixture(scope="module")
def written(whole: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Page]:
    plt.close("all")  # those of other tests
    return page(whole, tmp_path_factory.mktemp("page"))


class Page(HTMLParser):
    """Elements in order, with their attributes and the text within; fails where they are not nested well."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(source)
        self.close()
        assert self.open == [], self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, (tag, self.open)
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.text += data


def page(diagnosis: Any, tmp_path: Path) -> tuple[str, Page]:
    path = tmp_path / "report.html"
    report(diagnosis, path)
    source = path.read_text(encoding="utf-8")
    return source, Page(source)


def test_page_holds_all_sections_and_figures(written: tuple[str, Page]) -> None:
    source, parsed = written
    heads = re.findall(r"<h2>(.*?)</h2>", source)
    assert heads == [
        "Residuals of the model",
        "The causes",
        "The evidence",
        "The new equations",
        "The gain",
        "Open questions",
        "Data and versions",
    ]
    assert sum(tag == "img" for tag, _ in parsed.tags) == 5
    for words in ("one of {q':q|q|, q':q^2}", "+31.5", "surrogate", "A manoeuvre with rates of both signs."):
        assert words in parsed.text
    assert not plt.get_fignums()  # figures are closed


def test_page_needs_no_network(written: tuple[str, Page]) -> None:
    source, parsed = written
    tags = {tag for tag, _ in parsed.tags}
    assert not tags & {"link", "a", "iframe", "object", "base"}
    for tag, attributes in parsed.tags:
        for key, value in attributes.items():
            assert not key.startswith("on") and key != "href", (tag, key)
            if key in ("src", "srcset"):
                assert value is not None and value.startswith("data:image/png;base64,")
    assert "//" not in re.sub(r"base64,[^']*", "", source)
    assert "url(" not in source and "@import" not in source


def test_page_escapes_what_users_write(written: tuple[str, Page]) -> None:
    _, parsed = written
    tags = [tag for tag, _ in parsed.tags]
    assert not {"b", "i", "flight", "was"} & set(tags)
    assert [attributes.get("type") for tag, attributes in parsed.tags if tag == "script"] == ["application/json", None]
    for words in (
        'pitch <i>&amp;</i> "quoted"',
        "<flight> & 1",
        "Damping grows with the rate <b>itself</b> & more.",
        "Half of the record <was> held out.",
        "Adds <script>alert(1)</script>.",
        "nearly Mq & Mde",
    ):
        assert words in parsed.text


def test_page_shows_the_new_equation_and_parameters(diagnosis: Any, written: tuple[str, Page]) -> None:
    source, parsed = written
    formulas = re.findall(r"<span class='formula'>.*?</span>", source)
    assert len(formulas) == 1  # theta' and the outputs are as they were
    assert source.count("class='new'") == 2  # Mqq, de_delayed
    assert "de_delayed(t) = de(t − tau)" in parsed.text
    estimate = diagnosis.extend().fit.parameters["tau"]
    assert f"{estimate.value:.3f}"[:4] in parsed.text


def test_page_without_findings_does_not_extend(diagnosis: Any, fits: tuple[ph.Fit, ph.Fit], tmp_path: Path) -> None:
    diagnosis.findings, diagnosis.misfit = [], misfit(fits[1])
    diagnosis.extend = None
    source, parsed = page(diagnosis, tmp_path)
    assert "The gain" not in source and "The new equations" not in source
    assert "No effect that these data" in parsed.text
    diagnosis.findings = [UNEXPLAINED]
    _, parsed = page(diagnosis, tmp_path)
    assert "its cause is not established" in parsed.text


def test_page_without_candidates_or_held_out_data(diagnosis: Any, extension: Extension, tmp_path: Path) -> None:
    diagnosis.ranking = []
    gain = dataclasses.replace(extension.gain, held_out=NAN, held_out_rms_before={}, held_out_rms_after={})
    diagnosis.extend = lambda minor=False: dataclasses.replace(extension, gain=gain)
    _, parsed = page(diagnosis, tmp_path)
    assert "No candidates were tried." in parsed.text
    assert "No data were held out" in parsed.text and "nan" not in parsed.text


@pytest.mark.parametrize(
    ("findings", "kind", "words"),
    [
        ([], "unexplained", "No cause was found, but the residuals are not white"),
        ([UNEXPLAINED], "unexplained", "The misfit is significant, but its cause is not established."),
        ([FINDING], "named", "The model misses one of {q':q|q|, q':q^2}."),
        ([SURROGATE], "unexplained", "de:scale is a surrogate, which fits but may represent another cause"),
        ([MINOR], "unexplained", "Minor: q:bias, significant, but less than 5 % of the misfit."),
        ([UNCERTAIN], "unexplained", "q:bias is significant, but what it explains of held-out data may be chance."),
        ([FINDING, MINOR], "named", "The model misses one of {q':q|q|, q':q^2}. Minor: q:bias, significant, but"),
        ([FINDING, UNEXPLAINED], "named", "A part of the misfit has no established cause."),
    ],
)
def test_the_outcomes(diagnosis: Any, findings: list[Finding], kind: str, words: str) -> None:
    diagnosis.findings = findings
    assert outcome(diagnosis) == kind
    assert words in headline(diagnosis)
    assert words in " ".join(diagnosis_summary(diagnosis).split())


@pytest.mark.parametrize(
    ("findings", "verdict", "words"),
    [
        ([], "nothing", "No effect that these data"),
        ([MINOR], "minor", "Minor: q:bias"),
        ([SURROGATE, MINOR], "surrogate", "de:scale is a surrogate"),
    ],
)
def test_white_residuals_leave_nothing_unexplained(
    diagnosis: Any, fits: tuple[ph.Fit, ph.Fit], findings: list[Finding], verdict: str, words: str
) -> None:
    diagnosis.findings, diagnosis.misfit = findings, misfit(fits[1])
    assert diagnosis.verdict == verdict and not diagnosis.found and outcome(diagnosis) == "nothing"
    assert words in headline(diagnosis)


def test_the_part_explained_is_told(diagnosis: Any) -> None:
    diagnosis.findings = [MINOR]
    said = " ".join(diagnosis_summary(diagnosis).split())
    assert "Explains 1.2 % of the misfit in free simulation of data held out (95 %: -0.4 % to 3 %), most in q." in said


def test_summary_has_evidence_rivals_and_what_is_open(diagnosis: Any) -> None:
    text = diagnosis_summary(diagnosis)
    for words in (
        "Estimated: -0.80 ± 0.05 1/rad (95 %: -0.9 to -0.7).",
        "Gain in log-likelihood, each model with its own coloured noise: +120.0 (threshold 17.0); on held-out data, "
        "both with the noise of the extended model: +31.5.",
        "The data do not distinguish it from: q':q^2 (gain +96.0).",
        "A surrogate: it fits the data, but may represent another cause.",
        "3. a cause not established",
        "Half of the record <was> held out.",
        diagnosis.misfit.worst[0] + ": residual",
    ):
        assert words in " ".join(text.split())
    assert max(map(len, text.split("\n"))) <= 110
    assert "nan" not in text


def test_summary_says_how_near_the_best_candidate_came(diagnosis: Any) -> None:
    diagnosis.findings = []
    diagnosis.ranking = [dataclasses.replace(diagnosis.ranking[0], name="q':q^2", statistic=9.5)]
    assert "The best candidate is q':q^2, with a gain of 4.8 in log-likelihood" in diagnosis_summary(diagnosis)


def test_gain_in_words(extension: Extension) -> None:
    text = extension.gain.summary()
    before, after = extension.gain.rms_before["q"], extension.gain.rms_after["q"]
    assert f"{before:.4g}" in text and f"{100 * (after / before - 1):+.0f} %" in text
    assert math.isnan(extension.gain.change("theta", held_out=True)) and "nan" not in text


def test_findings_figure_shows_residuals_and_their_change(diagnosis: Any, extension: Extension) -> None:
    _, axes = findings_figure(diagnosis.fit, extension)
    assert set(axes) == {"q", "q change", "theta", "theta change"}
    lines = {x.get_label(): x.get_ydata() for x in axes["q"].get_lines()}
    change = {x.get_label(): x.get_ydata() for x in axes["q change"].get_lines()}["change of the model's output"]
    np.testing.assert_allclose(lines["before"] - lines["after"], change, atol=1e-12)
    with pytest.raises(UnknownName, match="no channel 'Q'. Did you mean 'q'"):
        findings_figure(diagnosis.fit, extension, ["Q"])


def test_explained_figure_has_named_causes_and_their_rivals() -> None:
    named = dataclasses.replace(
        FINDING,
        explained=0.8,
        explained_interval=(0.7, 0.85),
        explained_outputs={"q": 0.9, "theta": 0.2},
        alternatives_explained={"q':q^2": 0.6},
    )
    figure, axes = explained_figure([named, MINOR, UNEXPLAINED])
    left = axes["explained"]
    assert [t.get_text() for t in left.get_yticklabels()] == ["q':q|q|", "or q':q^2", "q:bias (minor)"]
    assert [bar.get_width() for bar in left.patches] == [80.0, pytest.approx(1.2)]
    assert left.patches[0].get_facecolor() != left.patches[1].get_facecolor()
    points = [
        line.get_xdata()[0]
        for line in axes["outputs"].get_lines()
        if line.get_marker() == "o" and len(line.get_xdata())
    ]
    assert points == pytest.approx([90.0, 20.0, 1.0, 0.2])
    with pytest.raises(DataError, match="no finding has a part"):
        explained_figure([UNEXPLAINED])


def test_explained_figure_has_what_differs_from_record_to_record(diagnosis: Any, tmp_path: Path) -> None:
    change = dataclasses.replace(
        MINOR, cause="k:per_experiment", status="named", explained=0.9, explained_in="the fitted records"
    )
    _, axes = explained_figure([change, MINOR])
    left = axes["explained"]
    assert [t.get_text() for t in left.get_yticklabels()] == ["k:per_experiment (fitted records)", "q:bias (minor)"]
    assert [bool(bar.get_hatch()) for bar in left.patches] == [True, False]
    diagnosis.findings = [change]
    assert "Explains 90 % of the misfit in free simulation of the fitted records" in diagnosis_summary(diagnosis)
    source, _ = page(diagnosis, tmp_path)
    assert "Explained misfit" in source and "hatched: effects that differ from record to record" in source


def test_ranking_figure_has_the_best_in_order(diagnosis: Any) -> None:
    _, axes = ranking_figure(list(reversed(diagnosis.ranking)), 17.0)
    axis = axes["ranking"]
    assert [text.get_text() for text in axis.get_yticklabels()] == [f"q':term{i}" for i in range(12)]
    assert [bar.get_width() for bar in axis.patches] == [s.statistic / 2 for s in diagnosis.ranking[:12]]
    assert any(line.get_xdata()[0] == 8.5 for line in axis.get_lines())
    with pytest.raises(DataError, match="no candidates"):
        ranking_figure([], 17.0)


def test_gain_figure_is_in_per_cent_of_before(extension: Extension) -> None:
    _, axes = gain_figure(extension.gain, {"q": "rad/s"})
    points = {x.get_label(): x.get_xdata() for x in axes["gain"].get_lines()}
    ratio = [100 * extension.gain.rms_after[n] / extension.gain.rms_before[n] for n in ("q", "theta")]
    np.testing.assert_allclose(points["fitted"], ratio)
    assert axes["gain"].get_yticklabels()[0].get_text().endswith("rad/s")


a, q, Mq = (ph.Expr.symbol(name) for name in ("alpha", "q", "M_q"))


@pytest.mark.parametrize(
    ("e", "text"),
    [
        (Mq * q + a, "y=MqqNq+α"),
        (a - (q - a), "y=α−(q−α)"),
        (a * (q + 1), "y=α(q+1)"),
        ((a + 1) ** 2, "y=(α+1)2"),
        (a + (-q), "y=α−q"),
        (-2.5 * a, "y=−2.5α"),
        ((-a) * q, "y=−αq"),
        (0.5 * ph.Expr(0.25) * a, "y=0.5·0.25α"),
        (abs(a), "y=|α|"),
        (ph.maximum(a, q), "y=max(α,q)"),
        (ph.where(a < q, a, q), "y=where(α<q,α,q)"),
        (-(a**2), "y=−α2"),
        (ph.Expr(1e-7) * a, "y=1·10−7α"),
        (a - 2.5 * q, "y=α−2.5q"),
        (a + (-2.5) * q, "y=α−2.5q"),
        ((a - 1) * q, "y=(α−1)q"),
        (-0.004028123 * ph.Expr(0.396) * q, "y=−0.00402812·0.396q"),
        ((a - 1) * (q + 2) - (a - q) + 2 * a, "y=(α−1)(q+2)−(α−q)+2α"),
        (a + (-q + Mq), "y=α+(−q+Mq)"),
        (a - (-2.5 * q), "y=α−(−2.5q)"),
        (Mq * (ph.Expr(2.5) * q), "y=Mq·2.5q"),
    ],
)
def test_mathml_keeps_the_order_of_operations(e: ph.Expr, text: str) -> None:
    markup = equation("y", e)
    found = "".join(ElementTree.fromstring(markup).itertext())  # well-formed
    assert found == text.replace("qN", "")


def test_mathml_of_quotients_roots_and_rates() -> None:
    markup = equation("q", ph.sqrt(a / (q * a)) + 1, rate=True)
    assert "<mfrac>" in markup and "<msqrt>" in markup
    assert "".join(ElementTree.fromstring(markup).itertext()) == "dqdt=αqα+1"


def test_an_equation_without_end_is_shown_as_text() -> None:
    long = a
    for k in range(3000):
        long = long + k * q
    assert equation("y", long).startswith("<code>y = alpha")
