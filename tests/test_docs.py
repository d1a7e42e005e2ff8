"""The documentation: its code runs page by page, the API is complete, and Sphinx builds it without a warning."""

from __future__ import annotations

import importlib.util
import inspect
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import real_records
from pages import ROOT, Block, blocks, run
from typer.testing import CliRunner

import phugoid as ph
from phugoid.cli import app

DOCS = ROOT / "docs"
GALLERY = sorted((DOCS / "gallery").glob("*.py"))
PAGES = [p for p in sorted(DOCS.rglob("*.md")) if "_build" not in p.parts and blocks(p)]
EXAMPLES = ("hfb320", "unstable", "quadrotor", "car", "uav", "servo", "tank")
# Packages beyond the package's own, without which a page is skipped.
NEEDS = {"howto/files.md": ["pandas"], "howto/export.md": ["h5py", "pandas", "xarray"]}
# What shells run on these pages besides phugoid: each is checked in another way.
ELSEWHERE = {"pip", "make", "cargo", "python", "pre-commit"}


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of all examples."""
    folder = tmp_path_factory.mktemp("examples")
    for name in EXAMPLES:
        assert CliRunner().invoke(app, ["example", name, "--out", str(folder)]).exit_code == 0
    return folder


@pytest.fixture
def modules() -> Iterator[None]:
    """Model files are imported from the page's folder; `examples` has a module of the same name."""
    others = {name: sys.modules.pop(name) for name in EXAMPLES if name in sys.modules}
    yield
    for name in EXAMPLES:
        sys.modules.pop(name, None)
    sys.modules.update(others)


def shell(block: Block) -> None:
    """Runs the commands of the package; others must be such as are run elsewhere."""
    for line in block.code.splitlines():
        if not line.startswith("$ "):
            continue
        program, *arguments = shlex.split(line[2:])
        if program == "phugoid":
            result = CliRunner().invoke(app, arguments)
            assert result.exit_code == 0, f"{line}\n{result.output}\n{result.stderr}"
        else:
            assert program in ELSEWHERE, line


def shape(text: str) -> list[str]:
    """Printed lines without what differs from machine to machine: digits, and how wide columns are."""
    lines = [re.sub(r"-{2,}", "--", re.sub(r"[-+]?\d[\d.e+-]*", "0", line)) for line in text.splitlines()]
    return [" ".join(line.split()) for line in lines if line.strip()]


def contains(printed: list[str], wanted: list[str]) -> bool:
    return any(printed[i : i + len(wanted)] == wanted for i in range(len(printed) - len(wanted) + 1))


def close(fit: Any, **truth: float) -> None:
    """Estimates lie within four standard errors of what was put in."""
    for name, true in truth.items():
        estimate = fit.parameters[name]
        assert abs(estimate.value - true) < 4 * estimate.std_error, estimate


def started(n: dict[str, Any]) -> None:
    close(n["fit"], Mw=0.2163, Mde=-12.784)
    assert n["check"].converged and ph.load("hfb320_fit.json").parameters["CLa"].value == n["lift"].value


def with_gaps(n: dict[str, Any]) -> None:
    assert np.isnan(n["iced"].output("alpha")).sum() == 150 and n["fit"].converged
    close(n["fit"], Cma=-0.9941, Cmde=-1.4714)


def several(n: dict[str, Any]) -> None:
    close(n["both"], Cmq=-28.65, CLa=3.0904)
    assert n["check"].converged and n["check"].matches["q"].inside == 1.0


def late(n: dict[str, Any]) -> None:
    close(n["delayed"], **n["truth"])
    assert abs(n["fit"].initial_states["run"]["q"].value) < 1e-12


def noisy(n: dict[str, Any]) -> None:
    assert n["robust"].log_likelihood > n["plain"].log_likelihood + 100
    close(n["robust"], Mw=0.2163, Mq=-3.7067)


def converging(n: dict[str, Any]) -> None:
    assert n["many"].success_rate == 1.0 and n["best"].converged
    close(n["fit"], Mw=0.2163, Mq=-3.7067)


def missing(n: dict[str, Any]) -> None:
    assert abs(n["linear"].parameters["Mq"].value + 2) > 10 * n["linear"].parameters["Mq"].std_error
    assert n["extended"].added == ("q':q|q|",) and n["extended"].gain.held_out > 10
    close(n["extended"].fit, Mq=-2.0, Mde=-6.0, **{n["hidden"]: -2.0})


def modes(n: dict[str, Any]) -> None:
    assert np.allclose(n["system"].modes.frequencies_hz, [2, 5], rtol=0.01)
    found = ph.linear.modes(n["fit"])  # of the unstable aircraft
    assert not found[0].stable


def exported(n: dict[str, Any]) -> None:
    assert n["again"].parameters["CLa"].value == n["fit"].parameters["CLa"].value
    assert n["header"].exists() and n["source"].exists()
    assert abs(n["trim"].rates["q"]) < 1e-9


def sure(n: dict[str, Any]) -> None:
    assert 0.9 < n["fit"].robust().inflation["CLa"] < 1.1  # the noise put in is white
    low, high = n["profiles"]["CLa"].interval
    assert low < 3.0904 < high


def from_a_log(n: dict[str, Any]) -> None:
    assert [m.kind for m in n["found"]] == ["doublet", "3-2-1-1", "sweep", "doublet"]
    close(n["fit"], CLa=4.8, Cma=-0.8, Cmq=-12.0, Cmde=-1.0, CDk=0.06)
    assert n["missing"].verdict == "nothing"


def looked_at(n: dict[str, Any]) -> None:
    assert n["gentle"].parameters["Bf"].std_error > 10 * n["fit"].parameters["Bf"].std_error
    assert n["one_way"].parameters["dry"].std_error > 100 * n["fits"]["servo"].parameters["dry"].std_error
    assert all(fit.converged for fit in n["fits"].values()) and len(n["fits"]) == 5


def regressed(n: dict[str, Any]) -> None:
    assert n["found"].selection["q'"].dropped == ("Mww", "Mwq")  # what the truth has not
    assert set(n["best"].selection["Cm"].selected) > {"Cma", "Cmq", "Cmde"}
    close(n["fit"], Mw=0.2163, Mq=-3.7067)


def designed(n: dict[str, Any]) -> None:
    best, others = n["best"], n["planned"]
    assert best.within_limits and not others["3-2-1-1"].within_limits


def agreeing(n: dict[str, Any]) -> None:
    assert abs(n["path"].fit.parameters["b_ax"].value + 0.1208) < 4 * n["path"].coloured_errors["b_ax"]


def featured(n: dict[str, Any]) -> None:
    assert n["fit"].converged and [r.name for r in n["fit"].records] == ["unstable", "unstable_other"]
    assert "sigma_az" not in n["fit"].parameters and ph.load("fit.json").log_likelihood == n["fit"].log_likelihood
    close(n["pitch"], **n["truth"], **{"b[run1]": 0.02, "b[run2]": -0.01})
    assert n["axes"].keys() == {"q", "theta"}


# What has come out at the end of a page, beyond that it ran.
CLAIMS: dict[str, Callable[[dict[str, Any]], None]] = {
    "start.md": started,
    "features.md": featured,
    "howto/gaps.md": with_gaps,
    "howto/several.md": several,
    "howto/biases_delays.md": late,
    "howto/noise.md": noisy,
    "howto/convergence.md": converging,
    "howto/missing.md": missing,
    "howto/linear.md": modes,
    "howto/design.md": designed,
    "howto/examples.md": looked_at,
    "howto/from_log.md": from_a_log,
    "howto/regression.md": regressed,
    "howto/flight_path.md": agreeing,
    "howto/uncertainty.md": sure,
    "howto/export.md": exported,
}


@pytest.mark.parametrize("page", PAGES, ids=[str(p.relative_to(DOCS)) for p in PAGES])
def test_code_runs(
    page: Path,
    written: Path,
    modules: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import matplotlib.pyplot as plt

    for package in NEEDS.get(page.relative_to(DOCS).as_posix(), []):
        pytest.importorskip(package)
    text = page.read_text(encoding="utf-8")
    for name in EXAMPLES:
        if f"$ phugoid example {name}" not in text:  # else the page writes them itself
            for file in written.glob(f"{name}*"):
                shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    names: dict[str, Any] = {}
    printed = ""
    for block in blocks(page):
        if block.language == "python":
            run(block, page, names)
            printed = capsys.readouterr().out
        elif block.language == "console":
            shell(block)
        elif block.language == "text":
            assert contains(shape(printed), shape(block.code)), f"{page}:{block.line}: it prints\n{printed}"
    if claim := CLAIMS.get(page.relative_to(DOCS).as_posix()):
        claim(names)
    plt.close("all")


@pytest.mark.parametrize("script", GALLERY, ids=[p.stem for p in GALLERY])
def test_gallery_runs(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    if script.stem == "real_records":  # with the records it takes minutes: `make docs` does that
        for module in (real_records, real_records.attas, real_records.hfb320):
            monkeypatch.setattr(module, "find", lambda name: None, raising=False)
    names: dict[str, object] = {"__name__": "__main__"}  # the gallery knows no __file__
    exec(compile(script.read_text(encoding="utf-8"), str(script), "exec"), names)
    assert plt.get_fignums(), "a page of the gallery shows a figure"
    plt.close("all")


def test_all_names_are_documented() -> None:
    text = "\n".join(p.read_text(encoding="utf-8") for p in (DOCS / "api").glob("*.rst"))
    there = re.findall(r"^\.\. auto\w+:: (?:phugoid\.)?([\w.]+)", text, re.M)
    assert len(there) == len({*there})
    spaces = [n for n in ph.__all__ if inspect.ismodule(getattr(ph, n))]
    public = {n for n in ph.__all__ if n != "__version__" and n not in spaces}
    # What is at the top, too, is documented there.
    public |= {f"{space}.{n}" for space in spaces for n in getattr(ph, space).__all__ if n not in ph.__all__}
    assert public <= {*there}, "not in docs/api: " + ", ".join(sorted(public - {*there}))


def test_docstrings_become_restructured_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(DOCS / "_ext")
    pytest.importorskip("sphinx")
    converted = importlib.import_module("docstrings").converted

    def made(text: str) -> str:
        return "\n".join(converted(text.splitlines())).strip()

    table = "t          (N,) times, s; |t| is\n           small.\nlong_name_ one blank.\n``x``, ``y``  two names."
    assert made(table) == (
        "``t``\n    (N,) times, s; \\|t\\| is\n    small.\n\n``long_name_``\n    one blank.\n\n"
        "``x``, ``y``\n    two names."
    )
    assert made("``a``: first,\ngoes on.\n``b``: second.") == "``a``\n    first,\n    goes on.\n\n``b``\n    second."
    assert made("Formula:\n\n    y = a*x\n\nEnd.") == "Formula:\n\n::\n\n    y = a*x\n\nEnd."
    assert made("q*alpha, 2**3, *A Title*, `estimate`, ``a*b``") == (
        "q\\*alpha, 2\\*\\*3, *A Title*, `estimate`, ``a*b``"
    )
    assert made(">>> f(1)\n2") == ">>> f(1)\n2"
    # What is not a table stays a paragraph.
    assert made("One sentence.  Another one\nthat goes on.") == "One sentence.  Another one\nthat goes on."


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_pages_can_be_read_where_sphinx_does_not_build_them(page: Path) -> None:
    """GitHub shows directives of reStructuredText as they are written."""
    assert "{eval-rst}" not in page.read_text(encoding="utf-8")


def test_commands_and_files_that_pages_name_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {*re.findall(r"^([a-z-]+):", makefile, re.M)}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for path in re.findall(r"`((?:examples|benchmarks|tests|tools|rust)/[\w/.-]+\.\w+)`", text):
            assert (ROOT / path).exists(), f"{page}: {path}"
        for target in re.findall(r"(?:\$ |`)make ([a-z-]+)", text):
            assert target in targets, f"{page}: make {target}"


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/develop/architecture.md"])
def test_files_of_the_map_exist(page: str) -> None:
    """A path may begin anywhere in the tree: `solver/start.rs` is a file whose path ends so."""
    folders = ("rust", "python", "tests", "tools", "docs", "examples", "benchmarks")
    paths = [p for folder in folders for p in (ROOT / folder).rglob("*") if "__pycache__" not in p.parts]
    there = [f"/{p.relative_to(ROOT).as_posix()}" + "/" * p.is_dir() for p in [*paths, *ROOT.iterdir()]]
    named = re.findall(r"`([\w./-]+(?:\.(?:py|rs|toml|md)|/))`", (ROOT / page).read_text(encoding="utf-8"))
    missing = [n for n in named if not n.startswith("..") and not any(p.endswith(f"/{n}") for p in there)]
    assert len(named) > 10 and not missing


def test_map_names_every_folder_of_the_package() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    folders = [p.name for p in (ROOT / "python" / "phugoid").iterdir() if p.is_dir() and p.name != "__pycache__"]
    assert [name for name in sorted(folders) if f"`{name}/`" not in text] == []


PAGE = """# One

```python
import matplotlib.pyplot as plt
from servo import m
print("of", len(m.state_names), "states")
figure, axes = plt.subplots()
```

```python
print("known")
```

```text
known
```
"""


@pytest.mark.parametrize("switch", ["1", "0"])
def test_pages_show_what_their_code_prints_and_draws(switch: str, tmp_path: Path) -> None:
    pytest.importorskip("myst_parser")
    (tmp_path / "conf.py").write_text(f"import sys\nsys.path.insert(0, {str(DOCS / '_ext')!r})\n"
                                      "extensions = ['myst_parser', 'executed']\n")  # fmt: skip
    page = tmp_path / "index.md"
    page.write_text(PAGE, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-q",
        "-W",
        "-D",
        f"run_pages={switch}",
        str(tmp_path),
        str(tmp_path / "html"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    made = (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
    text = re.sub("<[^>]+>", "", made)
    assert ("of 2 states" in text) == ("_images/index-1.png" in made) == (switch == "1") and text.count("\nknown") == 1
    page.write_text(PAGE.replace("servo", "nothing"), encoding="utf-8")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode != 0 and "nothing" in done.stderr) == (switch == "1")


@pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("sphinx", "furo", "myst_parser", "sphinx_gallery")),
    reason="building the documentation needs the extra 'docs'",
)
def test_pages_build_without_a_warning(tmp_path: Path) -> None:
    """The gallery and the code of the pages are left out: they have tests of their own."""
    source = tmp_path / "docs"
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns("_build", "examples", "__pycache__"))
    for name in ("CHANGELOG.md", "CONTRIBUTING.md", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    for part in ("rust/core/README.md", "benchmarks/README.md"):
        (tmp_path / part).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / part, tmp_path / part)
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-D", "plot_gallery=0", "-D", "run_pages=0"]
    done = subprocess.run([*command, str(source), str(tmp_path / "html")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    start = (tmp_path / "html" / "start.html").read_text(encoding="utf-8")
    assert "_images/fit.png" in start
    method = (tmp_path / "html" / "method.html").read_text(encoding="utf-8")
    assert method.count("<math") > 80 and "https://cdn" not in method
