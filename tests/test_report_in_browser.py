"""Reports in headless Chromium: nothing overflows on a phone, nothing is complained of, print is whole."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import jinja2
import numpy as np
import pytest

import phugoid as ph
from phugoid.discrepancy.page import report
from phugoid.discrepancy.search.finding import DiagnosisResult
from phugoid.pages import PageTable

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium to render the pages with")

PHONE, DESKTOP = 390, 1200
# Written by the page around the report when that is laid out.
MEASURE = """
const page = document.getElementById('page').contentDocument, root = page.documentElement;
const point = (canvas, kind, x) => {
  const {left, top, width} = canvas.getBoundingClientRect(), at = {clientX: left + x * width, clientY: top + 20};
  canvas.dispatchEvent(new page.defaultView.PointerEvent(kind, {...at, pointerId: 1}));
};
for (const canvas of [...page.querySelectorAll('.panel canvas')].slice(0, 1)) {
  canvas.setPointerCapture = () => 0;
  point(canvas, 'pointerdown', 0.4);
  point(canvas, 'pointermove', 0.6);
  point(canvas, 'pointerup', 0.6);
}
const box = root.getBoundingClientRect(), out = [];
for (const e of page.body.querySelectorAll('h1,h2,h3,p,li,dd,dt,summary,article,figcaption,.wide,.shot,.equation')) {
  const r = e.getBoundingClientRect();
  if (r.width && (r.right > box.right + 1 || r.left < -1)) out.push(e.tagName + ' ' + e.textContent.slice(0, 40));
}
const pictures = [...page.images].filter(i => i.getBoundingClientRect().width);
const result = {
  scroll: root.scrollWidth, width: root.clientWidth, out: out,
  broken: [...page.images].filter(i => !i.naturalWidth).length, pictures: page.images.length,
  wide: pictures.filter(i => i.getBoundingClientRect().width > box.width).length,
  coarsest: Math.min(...pictures.map(i => 200 * i.getBoundingClientRect().width / i.naturalWidth)),
  formulas: [...page.querySelectorAll('math')].filter(m => m.getBoundingClientRect().height > 8).length,
  zoomed: page.querySelector('.bar button')?.disabled === false,
  drawn: [...page.querySelectorAll('canvas')].filter(c => c.clientWidth && c.width &&
    c.getContext('2d').getImageData(0, 0, c.width, c.height).data.some(v => v)).length,
  spoken: [...page.querySelectorAll('.head')].map(e => e.textContent),
  lost: [...page.querySelectorAll('.formula')].filter(m => m.getBoundingClientRect().width < 20).length,
};
document.body.innerHTML = '<p id="result">' + JSON.stringify(result).replaceAll('<', '&lt;') + '</p>';
"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A report of a fit, with long names and equations, and one of a diagnosis."""
    folder = tmp_path_factory.mktemp("pages")
    m = ph.Model("a rather long name of a model: pitch with everything")
    q, theta = m.states(q="rad/s", theta="rad")
    (de,) = m.inputs(de="rad")
    Mq, Mde, bias, Mqq = m.parameters("Mq Mde a_rather_long_name_of_a_bias Mqq")
    m.dynamics(q=Mq * q + Mde * de + Mqq * q * abs(q) + 0.01 * (q + theta) * (q - theta) / (1 + q**2), theta=q)
    m.outputs(q=(q + bias, "rad/s"), theta=(theta, "rad"), a_rather_long_name_of_an_output=(q * q + theta, "rad²/s²"))
    t = 0.05 * np.arange(240)
    run = ph.Experiment(t, {"de": 0.2 * np.sign(np.sin(1.3 * t))}, name="a flight with_a_long_name_without_any_space")
    truth = {"Mq": -0.6, "Mde": -4.0, "Mqq": -0.8, "a_rather_long_name_of_a_bias": 0.01}
    clean = ph.simulate(m, truth, run, initial={"q": 0.0, "theta": 0.0})
    rng = np.random.default_rng(0)
    data = run.with_outputs({n: y + 0.01 * rng.standard_normal(t.size) for n, y in clean.outputs.items()})
    fit = ph.estimate(m, data)
    fit.report(folder / "fit.html", command="phugoid fit a_model.py a_record.csv --report fit.html")
    nothing = DiagnosisResult(fit, (), (), 17.0, ("A note.",), interrupted=False, seconds=1.0)
    report(nothing, folder / "diagnosis.html")
    return {"fit": folder / "fit.html", "diagnosis": folder / "diagnosis.html"}


def browse(folder: Path, *options: str, url: str = "") -> subprocess.CompletedProcess[str]:
    sandbox = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []  # root has none
    command = [
        str(BROWSER),
        "--headless",
        "--disable-gpu",
        "--hide-scrollbars",
        f"--user-data-dir={folder / 'profile'}",
    ]
    command += ["--no-first-run", "--disable-extensions", "--disable-background-networking", *sandbox]
    return subprocess.run([*command, *options, url], capture_output=True, text=True, timeout=120, check=False)


def measure(page: Path, width: int, folder: Path) -> tuple[dict[str, object], list[str]]:
    """Sizes of the page in a window so wide, and what the console says."""
    inner = html.escape(page.read_text(encoding="utf-8"), quote=True)
    frame = f"<iframe id='page' style='border:0;width:{width}px;height:800px' srcdoc=\"{inner}\"></iframe>"
    around = folder / "around.html"
    script = f"<script>window.onload = () => {{ {MEASURE} }};</script>"
    around.write_text(
        f"<!DOCTYPE html><meta charset='utf-8'><body style='margin:0'>{frame}{script}</body>", encoding="utf-8"
    )
    done = browse(folder, "--enable-logging=stderr", "--virtual-time-budget=5000", "--dump-dom", url=around.as_uri())
    found = re.search(r'<p id="result">(.*?)</p>', done.stdout)
    assert found, done.stderr[-2000:]
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(found[1])), said


@pytest.mark.parametrize("kind", ["fit", "diagnosis"])
@pytest.mark.parametrize("width", [PHONE, DESKTOP])
def test_page_fits_the_screen(kind: str, width: int, pages: dict[str, Path], tmp_path: Path) -> None:
    found, said = measure(pages[kind], width, tmp_path)
    assert said == []
    assert found["width"] == width and found["scroll"] == width
    assert found["out"] == []
    assert found["broken"] == 0 and found["lost"] == 0
    assert int(str(found["pictures"])) >= 2
    if kind == "fit":
        # Three outputs, an input and the residuals over two variables; each panel says the values where one points.
        assert found["drawn"] == 5 and found["zoomed"] is True
        spoken = found["spoken"]
        assert isinstance(spoken, list) and all(re.search(r"(measured|input) -?\d", text) for text in spoken[:4])
        assert int(str(found["formulas"])) >= 5
    if kind == "diagnosis":  # its figures have a version for phones
        assert found["wide"] == 0
    # Pixels of the screen an inch of the figure: letters of 8 points need 75. On a phone figures scroll by themselves.
    assert float(str(found["coarsest"])) > 75.0


def test_a_page_that_overflows_would_be_found(tmp_path: Path) -> None:
    wide = tmp_path / "wide.html"
    wide.write_text("<!DOCTYPE html><title>w</title><body style='margin:0'><p style='width:900px'>x</p>"
                    "<script>console.error('bad')</script></body>")  # fmt: skip
    found, said = measure(wide, PHONE, tmp_path)
    assert found["scroll"] == 900 and found["out"] and len(said) == 1


def printed(page: Path, folder: Path) -> list[str]:
    """The text of each printed page of a report."""
    text = shutil.which("pdftotext")
    if text is None:
        pytest.skip("no pdftotext to read the printed page with")
    paper = folder / f"{page.stem}.pdf"
    browse(folder, "--no-pdf-header-footer", f"--print-to-pdf={paper}", url=page.as_uri())
    done = subprocess.run([text, "-layout", str(paper), "-"], capture_output=True, text=True, check=True)
    return done.stdout.split("\f")[:-1]


def test_print_shows_what_the_screen_folds(pages: dict[str, Path], tmp_path: Path) -> None:
    sheets = printed(pages["fit"], tmp_path)
    for words in ("Warnings and remarks", "Initial states", "largest defect", "trials", "versions"):
        assert any(words in sheet for sheet in sheets), words
    assert len(sheets) <= 8


def test_print_leaves_out_what_needs_a_screen(pages: dict[str, Path], tmp_path: Path) -> None:
    asked = "Time histories, and residuals over two variables"
    assert asked in pages["diagnosis"].read_text(encoding="utf-8")
    sheets = printed(pages["diagnosis"], tmp_path)
    assert not any(asked in sheet for sheet in sheets) and any("A note." in sheet for sheet in sheets)


@pytest.mark.parametrize("rows", [12, 25])
def test_print_divides_long_tables_alone(rows: int, tmp_path: Path) -> None:
    """A table of many rows is divided, with its heads on each page; one of few rows goes to the next page whole."""
    templates = jinja2.Environment(loader=jinja2.PackageLoader("phugoid", "templates"), autoescape=True)
    text = "<!DOCTYPE html><style>{% include 'style.css' %}</style><p style='height: 20cm'>before</p>"
    text += "{% import 'pieces.html' as p %}{{ p.table(table) }}"
    table = PageTable(["name", "value"], [[f"row {i}", "1"] for i in range(rows)], "lr")
    page = tmp_path / "rows.html"
    page.write_text(templates.from_string(text).render(table=table), encoding="utf-8")
    first, second = printed(page, tmp_path)
    assert "value" in second and f"row {rows - 1}" in second
    assert ("row 0" in first, "row 0" in second) == ((True, False) if rows == 25 else (False, True))


def test_print_begins_an_article_where_its_text_has_room(tmp_path: Path) -> None:
    """Its figure goes to the next page alone, so that the first is not left half empty."""
    templates = jinja2.Environment(loader=jinja2.PackageLoader("phugoid", "templates"), autoescape=True)
    text = "<!DOCTYPE html><style>{% include 'style.css' %}</style><p style='height: 12cm'>before</p>"
    text += "<article><h3>A cause</h3><p>Estimated.</p>"
    text += "<figure><div style='height: 12cm'></div><figcaption>Drawn</figcaption></figure></article>"
    page = tmp_path / "article.html"
    page.write_text(templates.from_string(text).render(), encoding="utf-8")
    first, second = printed(page, tmp_path)
    assert "A cause" in first and "Estimated." in first and "Drawn" in second
