"""HTML pages from templates, which escape all text: their tables, pictures and sources."""

from __future__ import annotations

import base64
import datetime
import hashlib
import io
import math
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import phugoid._core as _core

from .data.experiment import Experiment
from .data.filtering import kind_of
from .errors import DataError
from .figures import NARROW, WIDTH, labelled
from .notebook import symbol
from .records import Record
from .time_unit import time_unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from PIL import Image

__all__ = ["PageTable", "Picture", "histories", "picture", "picture_in_widths", "render", "sources"]

Tiles: TypeAlias = "Sequence[Sequence[Sequence[Axes]]]"
FloatArray = NDArray[np.float64]

_DPI = 200  # sharp on a page of paper, and on a phone held close
_COLOURS = 128  # a palette of so many shades takes a third of the bytes, and looks the same
_WHITE = 248  # what is paler is made white
_EACH = 4  # pixel of a row and of a column, of which the palette is made
_PIXELS = 96.0  # of a screen in an inch
_BESIDE, _ABOVE = 0.08, 0.17  # inches: what a panel takes on its right, and above it for its title
_SAMPLES = 3000  # drawn by the page's script; of more, every second one, or third, ...
_STEPS = 5000  # into which the range of a channel is divided, where values are written with fewer digits
_SMALL = 6.0  # inches; what is narrower is not drawn out to the width of the page


def render(template: str, **names: Any) -> str:
    """Return the page of a template; a name that it needs and is not given is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    templates = PackageLoader("phugoid", "templates")
    pages = Environment(
        loader=templates, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    pages.filters["symbol"] = symbol
    return pages.get_template(template).render(**names)


@dataclass(frozen=True)
class PageTable:
    """A table of texts; ``align`` holds l or r for each column, s for one of the names of symbols, t for one of
    sentences."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    align: str

    @property
    def columns(self) -> list[tuple[int, str, str]]:
        """Number, class and head of each column that is shown: columns without any text are left out."""
        kept = [j for j in range(len(self.heads)) if not self.rows or any(row[j] for row in self.rows)]
        return [(j, self.align[j], self.heads[j]) for j in kept]


@dataclass(frozen=True)
class Picture:
    """A figure as data within the page, with its size in pixels of a screen."""

    data: str
    width: int
    height: int
    small: bool
    narrow: Picture | None = None  # the same for a narrow screen


def picture(figure: Figure, tiles: Tiles = ()) -> Picture:
    """Return a figure as data within the page, and close it.

    Narrow screens show its ``tiles`` below each other: for each row of panels the axes of each tile, from the left.
    """
    drawn = _drawn(figure)
    narrow = _picture(_stacked(drawn, tiles)) if tiles else None
    return replace(_picture(drawn), narrow=narrow)


def picture_in_widths(draw: Callable[[float], tuple[Figure, Any]]) -> Picture:
    """Return what ``draw`` draws for a width in inches as data within the page, with another for narrow screens."""
    wide, narrow = (_picture(_drawn(draw(width)[0])) for width in (WIDTH, NARROW))
    return replace(wide, narrow=narrow)


def _drawn(figure: Figure) -> Image.Image:
    """Draw a figure once, at the resolution of the page; matplotlib's ``savefig`` lays it out and draws it twice."""
    from matplotlib import pyplot as plt
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(_DPI)
    canvas.draw()  # type: ignore[no-untyped-call]
    plt.close(figure)
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return Image.fromarray(pixels).convert("RGB")


def _picture(drawn: Image.Image) -> Picture:
    from PIL import Image

    # The palette is made of white, and of what is found at one pixel of 16, which takes a tenth of the time.
    some = drawn.resize((drawn.width // _EACH, drawn.height // _EACH), Image.Resampling.NEAREST)
    colours = np.array(some.quantize(_COLOURS - 1, dither=Image.Dither.NONE).getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) >= _WHITE] = 255  # Pillow looks colours up in steps of 8
    palette = Image.new("P", (1, 1))
    palette.putpalette([255, 255, 255, *colours.ravel().tolist()])
    content = io.BytesIO()
    drawn.quantize(palette=palette, dither=Image.Dither.NONE).save(content, "PNG", dpi=(_DPI, _DPI))
    width, height = (round(_PIXELS / _DPI * size) for size in drawn.size)
    return Picture(base64.b64encode(content.getvalue()).decode("ascii"), width, height, drawn.width < _SMALL * _DPI)


def _stacked(drawn: Image.Image, tiles: Tiles) -> Image.Image:
    """Return the tiles of a figure one below the other, row by row, beneath what stands above all panels."""
    from PIL import Image, ImageChops

    width, height = drawn.size
    rights = [max(a.get_position().x1 for row in tiles for a in row[j]) for j in range(len(tiles[0]))]
    cuts = [0, *(round(width * right + _BESIDE * _DPI) for right in rights[:-1]), width]
    tops = [round(height * (1.0 - max(a.get_position().y1 for a in row[0])) - _ABOVE * _DPI) for row in tiles]
    pieces = [
        drawn.crop((left, top, right, bottom))
        for top, bottom in pairwise([*tops, height])
        for left, right in pairwise(cuts)
    ]
    narrow = max(piece.width for piece in pieces)
    head = drawn.crop((0, 0, width, tops[0]))
    _, _, end, _ = ImageChops.invert(head).getbbox() or (0, 0, 0, 0)
    if end > narrow:
        head = head.resize((width * narrow // end, head.height * narrow // end))
    stacked = Image.new("RGB", (narrow, sum(piece.height for piece in [head, *pieces])), "white")
    at = 0
    for piece in [head, *pieces]:
        stacked.paste(piece, (0, at))
        at += piece.height
    return stacked


def histories(record: Record, sigmas: Mapping[str, float] = {}, first: str = "") -> dict[str, Any]:
    """Return the time histories of a record for the script of a page (``explore.js``), which zooms and reads them.

    Residuals get a band of ±2 ``sigmas``; ``first`` is the output whose residual is shown over two variables at first.
    """
    record = record.without_rest()
    each = -(-record.n // _SAMPLES)
    groups = {"y": record.outputs, "u": record.inputs, "x": record.states, "z": record.measured, "r": record.residuals}
    values = {f"{g} {name}": _numbers(v[::each]) for g, group in groups.items() for name, v in group.items()}
    residuals = [f"r {name}" for name in record.residuals if f"z {name}" in values]
    variables = [f"x {n}" for n in record.states] + [f"u {n}" for n in record.inputs]
    variables += [f"y {n}" for n in record.outputs if n not in record.states]
    panels: list[dict[str, Any]] = []
    for name in record.outputs:
        lines = [[f"y {name}", "model", False]]
        if f"z {name}" in values:
            lines.insert(0, [f"z {name}", "measured", False])
        residual = f"r {name}" if f"r {name}" in residuals else None
        band = 2.0 * sigmas.get(name, 0.0)
        panels.append({"title": labelled(name, record.units), "lines": lines, "residual": residual, "band": band})
    for name in record.inputs:
        lines = [[f"u {name}", "input", kind_of(record.interpolation, name) == "hold"]]
        panels.append({"title": labelled(name, record.units), "lines": lines, "residual": None, "band": 0.0})
    unit = time_unit_of(record.units)
    note = f"Time in {unit}. Drag over a stretch of time to look closer; point at a sample to read it."
    if each > 1:
        note += f" One sample of {each} is drawn."
    return {
        "t": [float(f"{t:.9g}") for t in record.t[::each]],
        "values": values,
        "panels": panels,
        "residuals": residuals,
        "variables": variables,
        "first": f"r {first}",
        "over": variables[:2],
        "labels": {key: labelled(key[2:], record.units) for key in (*residuals, *variables)},
        "note": note,
        "unit": unit,
    }


def _numbers(values: FloatArray) -> list[float | None]:
    """Return values with the digits that a screen shows, and None for a missing one."""
    there = values[np.isfinite(values)]
    size = (float(np.ptp(there)) or float(np.abs(there).max()) or 1.0) if there.size else 1.0
    digits = math.ceil(math.log10(_STEPS / size))
    return [v if v == v and abs(v) != math.inf else None for v in np.round(values, digits).tolist()]


def sources(
    records: Sequence[Record],
    known: Mapping[str, str],
    experiments: Sequence[Experiment] = (),
    files: Sequence[str | os.PathLike[str]] = (),
) -> dict[str, Any]:
    """Return which data and versions a page comes from: records, what was done to them, facts, files with SHA-256.

    Raises DataError for a file that cannot be read.
    """
    import matplotlib
    import numpy
    import scipy

    rows = []
    for r in records:
        missing = sum(int((z != z).sum()) for z in r.measured.values())
        span = f"{r.t[0]:g} to {r.t[-1]:g} {time_unit_of(r.units)}"
        rows.append([r.name, str(r.n), span, str(missing), ", ".join(r.inputs), ", ".join(r.outputs)])
    versions = f"phugoid {_core.__version__}, Python {platform.python_version()}, numpy {numpy.__version__}, "
    versions += f"scipy {scipy.__version__}, matplotlib {matplotlib.__version__}"
    return {
        "records": PageTable(["experiment", "samples", "time", "missing values", "inputs", "outputs"], rows, "lrrrlt"),
        "steps": [f"{e.name}: {'; '.join(e.history)}" for e in experiments if e.history],
        "facts": {**known, "versions": versions, "written": datetime.date.today().isoformat()},
        "files": [_file(Path(path)) for path in files],
    }


def _file(path: Path) -> tuple[str, str, str]:
    """Return name, size and SHA-256 of a file."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read for the report ({error.strerror or error})") from error
    return path.name, f"{len(content):,}".replace(",", " "), hashlib.sha256(content).hexdigest()
