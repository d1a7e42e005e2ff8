"""Code on pages, run while the documentation is built: what a block prints and draws is shown below it.

The blocks of a page run in order and share their names, in a folder with the files of the examples that the page
mentions, as the tests run them. A block that fails ends the build. Where a page shows what is printed itself, only
figures are added. ``-D run_pages=0`` leaves all that out.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

EXAMPLES = ("hfb320", "unstable", "quadrotor", "car", "uav", "servo", "tank")
LINES = 60  # printed by a block; of more, the first
FIGURES = "examples/executed"  # below the source folder, with the gallery, which is made as well


def run_pages(app: Sphinx, doctree: nodes.document) -> None:
    """Run the blocks of Python of a page, and put below each what it printed and drew."""
    found = [n for n in doctree.findall(nodes.literal_block) if n.get("language") == "python"]
    if not app.config.run_pages or not found or app.env.docname.startswith(("examples/", "api/")):
        return
    import matplotlib.pyplot as plt

    plt.close("all")  # what plot directives of the page have left open is shown by these
    names: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, _inside(Path(folder), doctree.astext()):
        for block in found:
            printed = io.StringIO()
            try:
                with contextlib.redirect_stdout(printed):
                    exec(compile(block.astext(), f"{app.env.docname}:{block.line}", "exec"), names)
            except Exception as error:
                raise ExtensionError(f"{app.env.docname}: the block at line {block.line} fails: {error!r}") from error
            below = _text(printed.getvalue(), block) + _figures(app, plt)
            for node in reversed(below):
                block.parent.insert(block.parent.index(block) + 1, node)


@contextlib.contextmanager
def _inside(folder: Path, text: str) -> Iterator[None]:
    """Work in a folder with the files of the examples that a text mentions; modules in it are forgotten at the end."""
    from typer.testing import CliRunner

    from phugoid.cli import app as program

    before = os.getcwd()
    for name in EXAMPLES:
        if name in text:
            CliRunner().invoke(program, ["example", name, "--out", str(folder)])
    known = {*sys.modules}
    sys.path.insert(0, str(folder))
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
        sys.path.remove(str(folder))
        for name in {*sys.modules} - known:
            if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
                del sys.modules[name]


def _text(printed: str, block: nodes.literal_block) -> list[nodes.Node]:
    """Return what a block printed, unless the page shows it."""
    after = block.next_node(nodes.Element, descend=False, siblings=True)
    shown = isinstance(after, nodes.literal_block) and after.get("language") == "text"
    if shown or not printed.strip():
        return []
    lines = printed.rstrip().split("\n")
    text = "\n".join([*lines[:LINES], *(["..."] if len(lines) > LINES else [])])
    return [nodes.literal_block(text, text, language="text", classes=["printed"])]


def _figures(app: Sphinx, plt: Any) -> list[nodes.Node]:
    """Return the figures that are open, as images, and close them."""
    (Path(app.srcdir) / FIGURES).mkdir(parents=True, exist_ok=True)
    made: list[nodes.Node] = []
    page = app.env.docname.replace("/", "-")
    for number in plt.get_fignums():
        app.env.temp_data["executed"] = count = app.env.temp_data.get("executed", 0) + 1
        uri = f"{FIGURES}/{page}-{count}.png"
        plt.figure(number).savefig(Path(app.srcdir) / uri, dpi=110)
        image = nodes.image(uri=f"/{uri}", alt="What the code above draws")
        made.append(nodes.container("", image, classes=["wide-figure"]))
    plt.close("all")
    return made


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx, before its own collection of images."""
    app.add_config_value("run_pages", True, "env", types=[bool, str, int])
    app.connect("doctree-read", run_pages, priority=400)
    return {"parallel_read_safe": False}
