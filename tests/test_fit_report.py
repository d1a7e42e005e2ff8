"""The page of a fit: what it holds, and that it is whole."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import phugoid as ph

VOID = {"meta", "img", "br"}


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
    for words in ("lag <b>&</b> delay", "<run> 1", "c[run 2]", "sigma_x", "(t − tau)", "idle", ph.__version__):
        assert words in page.text
    assert fit.warnings and all(w in page.text for w in fit.warnings)
    assert page.text.count("nan") == 0
    assert source.count("<img ") == len(fit.records)
    assert re.search(r"<(script|link)\b|src='http|url\(", source) is None


def test_page_of_a_saved_fit_is_the_same(fit: ph.Fit, tmp_path: Path) -> None:
    fit.save(tmp_path / "fit.json")
    fit.report(tmp_path / "first.html")
    ph.load(tmp_path / "fit.json").report(tmp_path / "again.html")
    texts = [Page((tmp_path / f"{name}.html").read_text(encoding="utf-8")).text for name in ("first", "again")]
    assert texts[0] == texts[1]
