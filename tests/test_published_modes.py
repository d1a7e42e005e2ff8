"""The published model of a ground vibration test (24 states, modes close to each other and hardly damped), found again.

The matrices gvt_A.txt, gvt_B.txt and gvt_C.txt are looked for in the folder ``reference`` beside the records.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt

import phugoid as ph
from phugoid.linear.state_space import modal_parts

RECORDS = Path(os.environ.get("PHUGOID_DATA", Path(__file__).parents[2] / "shared" / "data"))
FILES = [RECORDS.parent / "reference" / f"gvt_{name}.txt" for name in "ABC"]

pytestmark = pytest.mark.skipif(
    not all(file.is_file() for file in FILES), reason="gvt_A.txt, gvt_B.txt or gvt_C.txt is not in ../shared/reference"
)


def published() -> ph.linear.StateSpace:
    A, B, C = (np.loadtxt(file, ndmin=2) for file in FILES)
    return ph.linear.StateSpace(A, B.reshape(-1, 1), C.reshape(1, -1), inputs=("force",), outputs=("acceleration",))


def record(truth: ph.linear.StateSpace, n: int) -> ph.Experiment:
    """n samples at 100 Hz of the response to a random force of 6 to 32 Hz, known at 400 Hz; noise of one part in 20."""
    random = np.random.default_rng(0)
    noisy = random.normal(size=20 * n + 4000)
    for kind, edge in (("high", 6), ("low", 32)):
        noisy = sosfilt(butter(5, edge, kind, fs=2000, output="sos"), noisy)
    fine = np.arange(4 * n - 3) / 400
    force = noisy[4000::5][: fine.size]
    h = 1 / 6400  # between these times the force is as good as linear
    u = CubicSpline(fine, force)(np.arange(16 * (fine.size - 1) + 1) * h)
    parts, y = modal_parts(truth.A, truth.B, truth.C), np.zeros(u.size)
    for pole, b, c in zip(parts.values, parts.inputs[:, 0], parts.outputs[0], strict=True):
        e = np.exp(pole * h)
        last = (e - 1 - pole * h) / (pole**2 * h)
        first = (e - 1) / pole - last
        y += (c * b * lfilter([1], [1, -e], np.concatenate([[0], first * u[:-1] + last * u[1:]]))).real
    y = y[::64]
    y += 0.05 * y.std() * random.normal(size=n)
    return ph.multirate({"force": (fine, force)}, {"acceleration": (np.arange(n) / 100, y)}, interpolation="cubic")


def test_a_minute_of_data_gives_the_modes_and_the_response() -> None:
    truth = published()
    found = ph.linear.subspace(record(truth, 6000), 24)
    # What is hardly damped is found to a part in a thousand; the mode at 15.3 Hz hides in an antiresonance.
    hardly = [m for m in truth.modes if m.damping.value < 0.012]
    assert len(hardly) == 5
    for mode in hardly:
        nearest = min(found.modes, key=lambda m: abs(m.eigenvalue - mode.eigenvalue))
        assert nearest.frequency.value == pytest.approx(mode.frequency.value, rel=1e-3)
        hidden = 15.3 < mode.frequency.value < 15.4
        assert nearest.damping.value == pytest.approx(mode.damping.value, abs=2e-3 if hidden else 2e-4)
    f = np.linspace(6, 32, 1000)
    G, H = (system.frequency_response(f) for system in (truth, found))
    off = np.abs(H.magnitude_db - G.magnitude_db)
    assert np.median(off) < 0.15 and np.quantile(off, 0.9) < 1.0
    assert np.sum(np.abs(H.response - G.response) ** 2) < 0.03**2 * np.sum(G.magnitude**2)
