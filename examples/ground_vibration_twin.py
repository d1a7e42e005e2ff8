"""Simulated twins of the paper's ground vibration test: 12 modes, shaken by a band-limited random force.

The structure is the one that the paper identified where gvt_A.txt, gvt_B.txt and gvt_C.txt are found, in a folder
``reference`` beside that of the records (README says where these are looked for), else an invented one of its kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from records import find
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

import phugoid as ph

BAND = (6.0, 32.0)  # Hz, as the paper's records were filtered
RATE = 100.0  # Hz, of the accelerometer after decimation
FINE = 20  # the structure is simulated at so many times the rate, with straight lines between
FORCE = 4  # and the force is known at so many times the rate
NOISE, SIGNAL = 5e-4, 1e-2  # rms of the accelerometer's noise, and of the force
WARM = 30.0  # s, before the record begins
# The paper's start for the frequencies, rad/s (its table of starting values, from N4SID on its record).
PAPER_START = (199.06, 186.17, 178.44, 172.64, 144.37, 121.47, 96.515, 59.572, 58.567, 59.029, 48.989, 48.901)
_INVENTED = (7.8, 9.4, 11.9, 13.6, 15.3, 17.8, 19.3, 21.6, 23.0, 25.4, 27.2, 30.3)  # Hz
_DAMPING = (0.002, 0.006, 0.02, 0.012, 0.003, 0.02, 0.011, 0.015, 0.004, 0.018, 0.02, 0.012)

_Array = NDArray[np.float64]


def structure() -> ph.linear.StateSpace:
    """The published model, or one of the same kind."""
    paths = [find(f"../reference/gvt_{name}.txt") for name in "ABC"]
    if all(path is not None for path in paths):
        a, b, c = (np.loadtxt(path) for path in paths if path is not None)
        b, c = b.reshape(-1, 1), c.reshape(1, -1)
    else:
        a, b, c = np.zeros((24, 24)), np.zeros((24, 1)), np.zeros((1, 24))
        for i, (hz, zeta) in enumerate(zip(_INVENTED, _DAMPING, strict=True)):
            w = 2 * np.pi * hz
            a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[-zeta * w, w], [-w, -zeta * w]]
            b[2 * i], c[0, 2 * i], c[0, 2 * i + 1] = 1.0, 0.3 * (-1) ** i, -(4.0 + i % 3)
    return ph.linear.StateSpace(a, b, c, np.zeros((1, 1)), inputs=("force",), outputs=("acceleration",))


@dataclass(frozen=True)
class Twin:
    """A simulated record, the accelerometer without its noise, and the structure behind it."""

    data: ph.Experiment
    clean: _Array
    structure: ph.linear.StateSpace


def twin(samples: int, seed: int = 0) -> Twin:
    """A record of so many samples at 100 Hz (the paper's has 30,001), its force sampled at 400 Hz."""
    system, rng, rate = structure(), np.random.default_rng(seed), RATE * FINE
    before = int(WARM * rate)
    force = rng.standard_normal(before + (samples - 1) * FINE + 1)
    for kind, corner in (("highpass", BAND[0]), ("lowpass", BAND[1])):
        force = sosfilt(butter(5, corner, kind, fs=rate, output="sos"), force)
    force *= SIGNAL / force.std()
    clean = sum(_mode(system, i, rate, force) for i in range(0, system.order, 2))[before::FINE]
    step = FINE // FORCE
    force = force[before::step]
    t = np.arange(samples) / RATE
    data = ph.multirate(
        {"force": (np.arange(force.size) / (RATE * FORCE), force)},
        {"acceleration": (t, clean + NOISE * rng.standard_normal(samples))},
        name=f"ground vibration test, twin of {samples:,} samples",
        interpolation="cubic",
    )
    return Twin(data, clean, system)


def _mode(system: ph.linear.StateSpace, i: int, rate: float, force: _Array) -> _Array:
    """What one mode adds to the acceleration, exact for straight lines between the force's samples."""
    own = slice(i, i + 2)
    a, b, c, d, _ = cont2discrete(
        (system.A[own, own], system.B[own], system.C[:, own], np.zeros((1, 1))), 1 / rate, "foh"
    )
    # From states to a difference equation: two poles, so that the numerator has three numbers.
    (a1, a2) = -np.trace(a), np.linalg.det(a)
    h = [d.item(), (c @ b).item(), (c @ a @ b).item()]
    return np.asarray(lfilter([h[0], h[1] + a1 * h[0], h[2] + a1 * h[1] + a2 * h[0]], [1.0, a1, a2], force))


def paper_model() -> tuple[ph.Model, dict[str, float]]:
    """The paper's modal form, with its redundant b, and its start: all sigma 0, b = c = 1."""
    m = ph.models.modal(12, "force", "acceleration", frequencies_hz=np.array(PAPER_START) / (2 * np.pi), scale="free")
    start = {name: 1.0 for name in m.parameter_names} | {f"sigma_{i}": 0.0 for i in range(1, 13)}
    return m, start | {f"omega_{i}": w for i, w in enumerate(PAPER_START, 1)}
