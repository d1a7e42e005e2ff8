"""The figures of f16_vibration.py: frequency responses, a portion of the time responses, where residuals lie."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import phugoid as ph

MEASURED, LINEAR, NONLINEAR = "#0072B2", "#D55E00", "#009E73"
SHOWN = (41.0, 45.0)  # s


def response(run: ph.Experiment, fit: ph.Fit, outputs: Sequence[str], force: str, period: int):  # type: ignore[no-untyped-def]
    """Of each accelerometer: magnitude of the ETFE over the periods, of the model, and of their difference."""
    plt = _pyplot()
    drawn, axes = plt.subplots(len(outputs), 1, figsize=(7.2, 8.0), sharex=True, layout="constrained")
    for a, n in zip(axes, outputs, strict=True):
        seen = ph.linear.frequency_response(run, force, n, period=period, band=(2.0, 15.0))
        model = ph.linear.frequency_response(fit, seen.frequencies_hz, force, n)
        finer = ph.linear.frequency_response(fit, np.linspace(2.0, 15.0, 2000), force, n)
        apart = 20.0 * np.log10(abs(seen.response - model.response))
        a.plot(seen.frequencies_hz, seen.magnitude_db, ".", color=MEASURED, markersize=3.5, label="ETFE")
        a.plot(finer.frequencies_hz, finer.magnitude_db, color=LINEAR, linewidth=1.1, label="identified model")
        a.plot(seen.frequencies_hz, apart, color="0.6", linewidth=0.7, label="difference")
        a.set_ylabel(f"{n}\ndB re 1 m/s²/N")
        a.grid(color="0.9", linewidth=0.5)
    drawn.legend(
        *axes[0].get_legend_handles_labels(), fontsize="small", frameon=False, ncols=3, loc="outside upper right"
    )
    axes[-1].set_xlabel("frequency, Hz")
    axes[-1].set_xlim(2.0, 15.0)
    return drawn


def time(linear: ph.results.Record, nonlinear: ph.results.Record, outputs: Sequence[str]):  # type: ignore[no-untyped-def]
    """A portion of measurements and model, and the residuals of both models."""
    plt = _pyplot()
    drawn, axes = plt.subplots(2 * len(outputs), 1, figsize=(7.2, 8.5), sharex=True, layout="constrained")
    t = linear.t
    k = (t >= SHOWN[0]) & (t <= SHOWN[1])
    for i, n in enumerate(outputs):
        above, below = axes[2 * i], axes[2 * i + 1]
        above.plot(t[k], linear.measured[n][k], ".", color=MEASURED, markersize=3.0, label="measured")
        above.plot(t[k], linear.outputs[n][k], color=LINEAR, linewidth=0.9, label="linear model")
        below.plot(t[k], linear.residuals[n][k], color=LINEAR, linewidth=0.9, label="residual, linear")
        below.plot(t[k], nonlinear.residuals[n][k], color=NONLINEAR, linewidth=0.9, label="residual, softening mode")
        above.set_ylabel(f"{n}\nm/s²")
        below.set_ylabel("m/s²")
    for a in axes[:2]:
        low, high = a.get_ylim()
        a.set_ylim(low, high + 0.3 * (high - low))
        a.legend(fontsize="x-small", frameon=False, ncols=2, loc="upper right")
    axes[-1].set_xlabel("time, s")
    drawn.align_ylabels()
    return drawn


def residual(  # type: ignore[no-untyped-def]
    linear: ph.results.Record,
    nonlinear: ph.results.Record,
    outputs: Sequence[str],
    spectra: Callable[[ph.results.Record, str], Any],
    by_amplitude: Callable[[ph.results.Record, str], list[tuple[float, float, float]]],
):
    """Spectra of signal, of what repeats in the residuals, and of noise; and residuals over the envelope."""
    plt = _pyplot()
    size = {"figsize": (9.0, 8.0), "width_ratios": (2.4, 1.0), "layout": "constrained"}
    drawn, axes = plt.subplots(len(outputs), 2, sharex="col", **size)
    for (a, b), n in zip(axes, outputs, strict=True):
        s, better = spectra(linear, n), spectra(nonlinear, n)
        a.semilogy(s.f, s.signal, color=MEASURED, linewidth=0.9, label="signal")
        a.semilogy(s.f, s.repeats, color=LINEAR, linewidth=0.9, label="residual that repeats, linear")
        a.semilogy(better.f, better.repeats, color=NONLINEAR, linewidth=0.9, label="the same, softening mode")
        a.semilogy(s.f, s.noise, color="0.6", linewidth=0.7, label="noise of a period")
        a.set_ylabel(f"{n}\namplitude of a line, m/s²")
        for record, color in ((linear, LINEAR), (nonlinear, NONLINEAR)):
            rows = by_amplitude(record, n)
            b.plot([y for y, _, _ in rows], [r for _, r, _ in rows], "o-", color=color, markersize=4.0, linewidth=0.9)
        b.set_ylabel("residual's envelope, m/s²")
        b.set_ylim(bottom=0.0)
    axes[0, 0].legend(fontsize="x-small", frameon=False, ncols=2)
    top = axes[0, 0].get_ylim()[1]
    axes[0, 0].set_ylim(top=30.0 * top)
    axes[-1, 0].set_xlabel("frequency, Hz")
    axes[-1, 1].set_xlabel("envelope near 7.3 Hz, m/s²")
    axes[0, 1].set_title("RMS, quarters of the time", fontsize="small")
    return drawn


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot
