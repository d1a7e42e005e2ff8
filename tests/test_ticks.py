"""Ticks of figures: those of matplotlib that are in view, also after a figure was pickled; and images for phones."""

from __future__ import annotations

import base64
import io
import pickle
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from phugoid.figures.ticks import label_decades, linear_ticks, log_ticks
from phugoid.pages import picture


def shown(axis: Any) -> list[float]:
    """The places of ticks in view."""
    low, high = sorted(axis.get_view_interval())
    return [float(tick) for tick in axis.get_majorticklocs() if low <= tick <= high]


@pytest.mark.parametrize("limits", [(0.0, 1.0), (-3.7, 12.2), (5.0, -2.0), (1e-7, 3e-7), (100.0, 100.4)])
def test_linear_ticks_are_those_of_matplotlib_in_view(limits: tuple[float, float]) -> None:
    figure, (ours, theirs) = plt.subplots(1, 2)
    ours.xaxis.set_major_locator(linear_ticks())
    for axis in (ours, theirs):
        axis.set_xlim(*limits)
    np.testing.assert_allclose(ours.xaxis.get_majorticklocs(), shown(theirs.xaxis))
    plt.close(figure)


def test_powers_of_ten_are_text_and_survive_pickling() -> None:
    figure, axis = plt.subplots()
    axis.loglog([1.0, 2.0], [3e-5, 4e2])
    axis.yaxis.set_major_locator(log_ticks(numticks=9))
    label_decades(axis.yaxis)
    again = pickle.loads(pickle.dumps(figure))
    for one in (figure, again):
        one.canvas.draw()
        texts = [text.get_text() for text in one.axes[0].get_yticklabels()]
        assert texts[0] == "10⁻⁴" and texts[-1] == "10²" and len(texts) == 7
        plt.close(one)


def test_tiles_stand_below_each_other_on_a_phone() -> None:
    figure, axes = plt.subplots(2, 2, figsize=(6.0, 3.0), squeeze=False)
    for axis, colour in zip(axes.flat, ("red", "lime", "blue", "yellow"), strict=True):
        axis.set_facecolor(colour)
        axis.set_axis_on()
    made = picture(figure, tiles=[[[axis] for axis in row] for row in axes])
    assert made.narrow is not None
    assert (made.width, made.height) == (576, 288) and made.narrow.width < 340 and made.narrow.height > 480
    with Image.open(io.BytesIO(base64.b64decode(made.narrow.data))) as image:
        narrow = np.asarray(image.convert("RGB")).astype(int)
    assert (narrow[0, 0] == 255).all()
    middle = narrow[:, narrow.shape[1] // 2]
    order = [int(np.median(np.flatnonzero(np.abs(middle - colour).sum(axis=1) < 30)))
             for colour in ((255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 0))]  # fmt: skip
    assert order == sorted(order)
