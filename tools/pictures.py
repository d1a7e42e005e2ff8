"""Draw the pictures of the README and of the documentation's home page, from records that the package simulates.

    python tools/pictures.py [FOLDER]         FOLDER: docs/_static

Writes fit.png, the match of a fit to the simulated record of the HFB-320 that `phugoid example hfb320` writes, and
diagnosis.png, a manoeuvre that was held out, as predicted before and after a diagnosis. The numbers that a picture
shows are stored in it as well (`numbers_of`), so that a test can tell whether it is current.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import phugoid as ph
from phugoid.cli import app
from phugoid.cli.model_file import load_model
from phugoid.figures import BAND, MEASURED, MODEL, RESIDUAL, STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "_static"

# The flight of `flights`: the model of the README has no quadratic damping.
TRUTH = {"Mq": -0.4, "Mtheta": -2.0, "Mde": -6.0}
DAMPING = -2.0
SIGMA = 0.005
# Letters of 8 points on so narrow a picture can be read on a phone.
_WIDTH, _DPI = 5.6, 200


def pitch() -> ph.Model:
    """Return the model of the README."""
    m = ph.Model("pitch")
    q, theta = m.states(q="rad/s", theta="rad")
    (de,) = m.inputs(de="rad")
    Mq, Mtheta, Mde = m.parameters("Mq Mtheta Mde")
    m.dynamics(q=Mq * q + Mtheta * theta + Mde * de, theta=q)
    m.outputs(q=q, theta=theta)
    return m


def flights() -> tuple[ph.Experiment, ph.Experiment]:
    """Return two simulated records of a vehicle whose damping grows with the pitch rate, which `pitch` has not."""
    true = ph.candidates(pitch())["q':q|q|"].extended(pitch())
    (damping,) = {*true.parameter_names} - {*TRUTH}
    t = np.arange(0, 20, 0.05)
    random = np.random.default_rng(0)

    def flown(name: str, de: NDArray[np.float64]) -> ph.Experiment:
        run = ph.Experiment(t, {"de": de}, name=name)
        path = ph.simulate(true, TRUTH | {damping: DAMPING}, run, initial={"q": 0.0, "theta": 0.0})
        return run.with_outputs({n: y + SIGMA * random.standard_normal(t.size) for n, y in path.outputs.items()})

    def steps(size: float, rate: float) -> NDArray[np.float64]:
        return size * np.sign(np.sin(rate * t)) * np.sin(0.4 * t)

    return flown("first manoeuvre", steps(0.6, 1.5)), flown("second manoeuvre", steps(0.05, 1.1))


def fit_picture(folder: Path) -> tuple[Figure, dict[str, float]]:
    """Return the match of two outputs of the HFB-320; the example's files are written into ``folder``."""
    with contextlib.redirect_stdout(io.StringIO()):
        app(["example", "hfb320", "--out", str(folder)], standalone_mode=False)
    fit = ph.estimate(load_model(str(folder / "hfb320.py")), ph.read(folder / "hfb320.csv", name="simulated record"))
    figure, _ = fit.plot(channels=["alpha", "q"])
    figure.set_size_inches(1.13 * _WIDTH, 0.8 * _WIDTH)  # narrower, labels would touch numbers
    return figure, {
        "log-likelihood": fit.log_likelihood,
        "CLa": fit.parameters["CLa"].value,
        "RMS of q": fit.records[0].rms()["q"],
    }


def diagnosis_picture() -> tuple[Figure, dict[str, float]]:
    """Return the prediction of the second manoeuvre by the model as it was, and as its diagnosis extends it."""
    import matplotlib.pyplot as plt

    first, second = flights()
    fit = ph.estimate(pitch(), first)
    extension = ph.diagnose(fit, validation=second).extend()
    before, after = (f.validate(second).records[0] for f in (fit, extension.fit))
    was, now = (r.rms()["q"] for r in (before, after))
    titles = (f"before: RMS {was:.3f} rad/s", f"with {extension.added[0]}: RMS {now:.4f} rad/s")
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            2,
            2,
            figsize=(_WIDTH, 0.56 * _WIDTH),
            sharex=True,
            sharey="row",
            layout="constrained",
            height_ratios=[1.7, 1.0],
        )
        for (top, bottom), record, title in zip(axes.T, (before, after), titles, strict=True):
            top.plot(record.t, record.measured["q"], ".", color=MEASURED, ms=2.2, label="measured")
            top.plot(record.t, record.outputs["q"], color=MODEL, linewidth=1.2, label="predicted")
            top.set_title(title, loc="left", fontsize=9.0)
            bottom.axhspan(-2 * SIGMA, 2 * SIGMA, color=BAND, linewidth=0.0, label="±2σ of the sensor")
            bottom.plot(record.t, record.residuals["q"], color=RESIDUAL, linewidth=0.8, label="residual")
            bottom.set_xlabel("time, s")
            bottom.margins(x=0.01)
        axes[0, 0].set_ylabel("q, rad/s")
        axes[1, 0].set_ylabel("residual, rad/s")
        handles = [h for axis in axes[:, 0] for h in axis.get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside upper left", ncols=4, frameon=False, fontsize=8.0)
    damping = extension.fit.parameters[[*extension.fit.model.parameter_names][-1]]
    return figure, {"RMS before": was, "RMS after": now, "damping": damping.value}


def save(figure: Figure, path: Path, numbers: Mapping[str, float]) -> None:
    """Write a small PNG (64 colours) with ``numbers`` in it."""
    import matplotlib.pyplot as plt
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=_DPI, format="png", facecolor="white")
    plt.close(figure)
    info = PngInfo()
    info.add_text("Description", json.dumps(numbers))
    Image.open(buffer).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True, pnginfo=info)


def numbers_of(path: Path) -> dict[str, float]:
    """Return the numbers that were stored in a picture."""
    from PIL import Image

    with Image.open(path) as image:
        texts: dict[str, Any] = getattr(image, "text", {})
        return {str(name): float(value) for name, value in json.loads(texts["Description"]).items()}


def draw(folder: Path, scratch: Path) -> None:
    """Write all pictures into ``folder``; the records are simulated in ``scratch``."""
    for name, (figure, numbers) in {"fit.png": fit_picture(scratch), "diagnosis.png": diagnosis_picture()}.items():
        save(figure, folder / name, numbers)
        print(f"{folder / name}: {(folder / name).stat().st_size / 1000:.0f} kB, {numbers}")


if __name__ == "__main__":
    import tempfile

    with tempfile.TemporaryDirectory() as scratch:
        draw(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER, Path(scratch))
