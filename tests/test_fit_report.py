"""The page of a fit: what it holds, and that it is whole."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import phugoid as ph
from phugoid.errors import DataError, OptionError
from phugoid.pages import histories
from phugoid.parameters import Estimate, Estimates
from phugoid.records import Record
from phugoid.report import remarks

VOID = {"meta", "img", "br", "source"}


class Page(HTMLParser):
    """The text of a page; tags that are left open or closed in a wrong place."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.text = ""
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def fit() -> ph.Fit:
    m = ph.Model("lag <b>&</b> delay")
    (x,) = m.states(x="m")
    (u,) = m.inputs(u="m/s")
    a, c, idle, tau = m.parameters(
        a=1.0, c=ph.Parameter(0.0, per_experiment=True), idle=2.0, tau=ph.Parameter(0.1, bounds=(0, 0.3), unit="s")
    )
    m.dynamics(x=-a * x + m.delay(u, tau))
    m.outputs(x=x + c + 0.0 * idle)
    t = np.arange(61) * 0.1
    runs = []
    for i, name in enumerate(("<run> 1", "run 2")):
        data = ph.Experiment(t, {"u": np.sin((1 + i) * t)}, name=name)
        truth = ph.simulate(m, {"a": 1.2, "c": 0.1 * i, "idle": 2.0, "tau": 0.15}, data, initial={"x": 0.2})
        z = truth.outputs["x"] + 0.01 * np.random.default_rng(i).standard_normal(t.size)
        z[5] = np.nan
        runs.append(data.with_outputs({"x": z}, name=name))
    return ph.estimate(m, runs)


def test_page_has_all_of_the_fit(fit: ph.Fit, tmp_path: Path) -> None:
    fit.report(tmp_path / "fit.html")
    source = (tmp_path / "fit.html").read_text(encoding="utf-8")
    page = Page(source)
    assert page.wrong == [] and page.open == []
    for words in ("lag <b>&</b> delay", "<run> 1", "c[run 2]", "σx", "(t − tau)", "idle", ph.__version__):
        assert words in page.text
    assert fit.warnings and all(w in page.text for w in fit.warnings)
    assert page.text.count("nan") == 0
    # Of each record the match and the residuals; intervals, correlations and the solver's way.
    assert source.count("<img ") == 2 * len(fit.records) + 3
    assert len(re.findall(r"<img [^>]*alt='[^']+'", source)) == source.count("<img ")
    assert re.search(r"<link\b|<script[^>]* src|src='http|url\(", source) is None


def test_page_holds_the_samples_that_its_script_draws(fit: ph.Fit, tmp_path: Path) -> None:
    """Values have the digits of a screen; a missing one is null, which JSON knows, and NaN is not."""
    fit.report(tmp_path / "fit.html")
    held = re.findall(
        r"<script type='application/json'>(.*?)</script>", (tmp_path / "fit.html").read_text("utf-8"), re.S
    )
    assert len(held) == len(fit.records)
    for text, record in zip(held, fit.records, strict=True):
        found = json.loads(text, parse_constant=lambda word: pytest.fail(word))
        assert found["t"] == pytest.approx(record.t) and found["values"]["z x"][5] is None
        assert found["values"]["y x"] == pytest.approx(record.outputs["x"], abs=np.ptp(record.outputs["x"]) / 5000)
        (output, drive) = found["panels"]
        assert output["band"] == pytest.approx(2 * fit.parameters["sigma_x"].value) and output["residual"] == "r x"
        assert drive["title"] == "u, m/s" and found["variables"] == ["x x", "u u"]


def test_of_a_long_record_some_samples_are_drawn() -> None:
    t = np.arange(10_001) * 0.01
    held = histories(Record(name="long", t=t, inputs={"u": t}, outputs={"y": np.full(t.size, np.nan)}, states={}))
    assert len(held["t"]) == len(held["values"]["u u"]) == 2501 and "One sample of 4" in held["note"]
    assert held["values"]["y y"] == [None] * 2501


def test_page_of_a_saved_fit_is_the_same(fit: ph.Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "fit.json")
    fit.report(tmp_path / "first.html")
    ph.load(tmp_path / "fit.json").report(tmp_path / "again.html")
    texts = [Page((tmp_path / f"{name}.html").read_text(encoding="utf-8")).text for name in ("first", "again")]
    assert all(f"{e.name}: {'; '.join(e.history)}" in texts[0] for e in fit.experiments)
    assert texts[0] == texts[1]


def test_page_says_in_words_what_to_beware_of(fit: ph.Fit) -> None:
    said = remarks(fit)
    assert [w for w in fit.warnings if not any(w in text for text in said)] == []
    quiet = dataclasses.replace(fit, warnings=())
    rng = np.random.default_rng(3)
    record = fit.records[0]

    def with_residuals(r: np.ndarray) -> list[str]:
        z = record.outputs["x"] + r
        records = [dataclasses.replace(record, measured={"x": z}, residuals={"x": r})]
        return remarks(dataclasses.replace(quiet, records=records))

    white = 0.01 * rng.standard_normal(record.n)
    assert not any("white" in text or "offset" in text for text in with_residuals(white))
    walk = np.cumsum(white) - np.mean(np.cumsum(white))
    (coloured,) = [text for text in with_residuals(walk) if "not white" in text]
    r = float(walk[1:] @ walk[:-1] / (walk @ walk))
    assert f"x ({r:.2f})" in coloured
    assert any(text.startswith("Residuals of x are mostly a constant offset") for text in with_residuals(white + 0.1))
    estimates = [
        Estimate("a", 1.0, 0.1),
        Estimate("b", 0.1, 0.1),
        Estimate("c", 2.0, 0.1),
        Estimate("d", 0.0, np.nan, bounds=(0, 1), bounds_active="lower"),
    ]
    covariance = np.array([[1, 0.1, -0.97, 0], [0.1, 1, 0, 0], [-0.97, 0, 1, 0], [0, 0, 0, np.nan]])
    quiet = dataclasses.replace(quiet, parameters=Estimates(estimates), covariance=covariance)
    text = " ".join(with_residuals(white))
    assert "interval of b includes zero" in text
    assert "a with c (−0.97)" in text and "b with" not in text


def test_page_holds_a_validation_files_and_the_command(fit: ph.Fit, tmp_path: Path) -> None:
    held = dataclasses.replace(fit.records[1])
    other = ph.Experiment(held.t, held.inputs, {"x": held.measured["x"]}, name="third & last")
    checked = fit.validate(other, values={"c": 0.1}, biases=(), tolerances={"x": 0.02})
    (tmp_path / "data <1>.csv").write_bytes(b"t,x\n0,1\n")
    fit.report(
        tmp_path / "fit.html",
        validation=checked,
        files=[tmp_path / "data <1>.csv"],
        command="phugoid fit <m>.py",
    )
    page = Page((tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert page.wrong == [] and page.open == []
    for words in (
        "Validation",
        "third & last",
        f"{100 * checked.matches['x'].inside:.1f} % of the samples lie within ±0.02 m",
        "phugoid fit <m>.py",
        "data <1>.csv",
        hashlib.sha256(b"t,x\n0,1\n").hexdigest(),
        "8 bytes",
    ):
        assert words in page.text


def test_what_cannot_be_in_a_report_is_refused(fit: ph.Fit, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"gone\.csv: cannot be read for the report"):
        fit.report(tmp_path / "fit.html", files=[tmp_path / "gone.csv"])
    with pytest.raises(OptionError, match="validation is what Fit.validate gives back, not a Fit"):
        fit.report(tmp_path / "fit.html", validation=fit)  # type: ignore[arg-type]
    stranger = SimpleNamespace(matches={}, model=SimpleNamespace(name="other"))
    with pytest.raises(OptionError, match="is of 'other'"):
        fit.report(tmp_path / "fit.html", validation=stranger)  # type: ignore[arg-type]
    assert not (tmp_path / "fit.html").exists()
