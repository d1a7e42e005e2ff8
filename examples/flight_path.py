"""Flight-path reconstruction: what kinematics alone says of the sensors, and what that does to derivatives.

Accelerometers and gyros tell how an aircraft moves, whatever its aerodynamics are; airspeed, vanes and attitude must
agree. From two ATTAS records (elevator 3-2-1-1s of opposite signs) `phugoid.reconstruct` finds biases of the inertial
sensors, of each record its own, and scale factors of the vanes and a delay of the airspeed, which both share. The
corrected records then go into a plain regression of the short period.

Geometry before delay: both vanes are on the nose boom, 13.08 m ahead of the centre of gravity, where they see the air
that rotation adds. Taken for vanes at the centre of gravity they seem to be late, by 13.08/128.5 = 0.102 s. The example
does it right, and then asks for delays instead of the place, to show what that says.

What it finds on the real records (standard errors allow for coloured residuals; those for white noise are a third of
them or less):

    With the place of the boom known no scale factor is left: K_alpha is 1.001 ± 0.007, K_beta 0.99 ± 0.03. Airspeed is
    late by 0.39 ± 0.06 s, as pressure lines are.
    Asked for delays instead, it finds them, alpha by 0.105 ± 0.003 s and beta by 0.116 ± 0.011 s, with a vane that
    reads too little, K_alpha = 0.922 ± 0.006: a plausible story, and a wrong one. (The twin, whose vanes are in time,
    tells the same one: 0.109 s, and K_alpha 8 % too small.) The likelihood hardly minds: places estimated instead
    of delays fit better by 44 ± 40 on the same samples. But they come out near where the boom is, 12.7 ± 0.3 m by alpha
    and 16 ± 2 m by beta, and need no scale factor. Where two causes act alike, the one that a ruler tells comes first.
    Besides the place there may be a delay of beta, 0.018 ± 0.007 s; there is none of alpha.
    The aerodynamic model of `attas.py` says the same from the other side: K = 0.997 ± 0.014 with the place.
    Gyros are off by 0.001 to 0.003 rad/s, accelerometers by 0.01 to 0.09 m/s^2. The bias of q differs from record to
    record by 2e-4 rad/s, three times its standard error: what drifts is not a constant.
    Altitude does not follow the flight path: in the manoeuvre it is off by up to 10 m, downwards where the angle of
    attack is large, as it is where that changes the static pressure. So altitude is left out, and with it a bias of
    alpha, which nothing else would tell.
    A regression on the records as measured has Mq and Zde far off (-1.92 and +0.15), since the vane's reading stands in
    it for alpha; on the corrected records it comes near to the output-error method (-1.46 and -0.07; -1.51 and -0.08).

    python examples/flight_path.py

Uses the real records fAttasElv1.mat and fAttasElv2.mat where it finds them, else a simulated twin with known errors.
Writes out/flight_path.png.
"""

from __future__ import annotations

from pathlib import Path

import attas
import numpy as np
from flight_path_twin import DERIVATIVES, ERRORS, flown, measured
from records import find

import phugoid as ph

COLUMNS = {
    "ax": 1, "ay": 2, "az": 3, "p": 6, "q": 7, "r": 8, "phi": 9, "theta": 10, "psi": 11, "alpha": 12, "beta": 13,
    "V": 14, "h": 15, "de": 21,
}  # fmt: skip  # of 45
DEGREES = ("p", "q", "r", "phi", "theta", "psi", "alpha", "beta", "de")
FOOT = 0.3048  # m
OUTPUTS = ("V", "alpha", "beta", "phi", "theta", "psi")
INERTIAL = ("ax", "ay", "az", "p", "q", "r")


def experiment(path: str | Path, name: str) -> ph.Experiment:
    """A record in SI units."""
    from scipy.io import loadmat

    (table,) = (v for k, v in loadmat(path).items() if not k.startswith("__"))
    c = {n: np.ascontiguousarray(table[:, k]) for n, k in COLUMNS.items()}
    c |= {n: np.deg2rad(c[n]) for n in DEGREES} | {"h": FOOT * c["h"]}
    # As in attas.py: sampling is 25 Hz, and both ends show what a filter left there.
    return ph.Experiment(0.04 * np.arange(table.shape[0]), channels=c, name=name).window(0.4, 24.6)


def records() -> list[ph.Experiment]:
    """Both records, or the twin."""
    paths = [find(name) for name in attas.RECORDS]
    if all(paths):
        return [experiment(path, name) for path, name in zip(paths, ("first", "second"), strict=True) if path]
    return [measured(flown(), boom=attas.BOOM)]


def reconstruct(runs: list[ph.Experiment], boom: bool = True) -> ph.results.Reconstruction:
    """Air data share their errors; biases are each record's own. Without the boom, vanes may be late."""
    options = {"per_experiment": INERTIAL if len(runs) > 1 else (), "delayed": ("V", "alpha", "beta")}
    if boom:
        options |= {"delayed": ("V",), "alpha_vane": attas.BOOM, "beta_vane": attas.BOOM, "flank": True}
    return ph.reconstruct(runs, OUTPUTS, **options)


def main() -> None:
    """Reconstructs, corrects, tries what that does to a regression, and writes the figure."""
    runs = records()
    real = runs[0].name != "twin"
    path = reconstruct(runs)
    print(path.summary())
    if not real:
        told = {n: v for n, v in ERRORS.items() if n in path.fit.parameters}
        print("\ntrue errors: " + ", ".join(f"{n} {v:g}" for n, v in told.items()))
    elif len(runs) == 2:
        for n in INERTIAL:
            a, b = (path.fit.parameters[f"b_{n}[{r.name}]"].value for r in runs)
            spread = np.hypot(*(path.coloured_errors[f"b_{n}[{r.name}]"] for r in runs))
            print(f"b_{n}: second - first {b - a:+.5f} ({(b - a) / spread:+.1f} std errors)")

    late = reconstruct(runs, boom=False)
    print("\nDelays in place of the boom:")
    for n in ("tau_alpha", "tau_beta", "K_alpha", "K_beta"):
        print(f"  {n} = {late.fit.parameters[n].value:.3f} ± {late.coloured_errors[n]:.3f}")
    print(late.vane_positions)

    short_period = attas.model(vane=False)
    raw = ph.equation_error(short_period, runs)
    right = ph.equation_error(short_period, list(path.corrected))
    print("\nderivatives  as measured          corrected            " + ("output error with vane" if real else "true"))
    both = attas.estimate(attas.records()) if real else None
    for n in attas.SHARED:
        cells = [f"{e.value:8.3f} ± {e.std_error:5.3f}" for e in (raw.parameters[n], right.parameters[n])]
        last = f"{DERIVATIVES[n]:8.3f}" if both is None else f"{both.parameters[n].value:8.3f}"
        print(f"{n:11s}  " + "     ".join(cells) + f"     {last}")

    out = Path("out")
    out.mkdir(exist_ok=True)
    figure(path, runs).savefig(out / "flight_path.png", dpi=150)
    print(f"\nWritten: {out / 'flight_path.png'}")


def figure(path: ph.results.Reconstruction, runs: list[ph.Experiment]):  # type: ignore[no-untyped-def]
    """What was measured and the path, and how they differ; alpha also as it was."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    names = [n for n in (*OUTPUTS, "h") if n in runs[0].channels]
    drawn, axes = plt.subplots(
        len(names), len(runs), figsize=(4.6 * len(runs), 1.35 * len(names)), sharex=True, squeeze=False,
        layout="constrained",
    )  # fmt: skip
    for column, (record, run, whole) in enumerate(zip(path.fit.records, runs, path.corrected, strict=True)):
        axes[0, column].set_title(f"{record.name} record" if len(runs) > 1 else record.name, fontsize="medium")
        for row, n in enumerate(names):
            a = axes[row, column]
            a.plot(run.t, run.channels[n], ".", color="#0072B2", markersize=1.5, label="measured")
            if n in record.outputs:
                a.plot(
                    record.t, record.outputs[n], color="#D55E00", linewidth=1.0, label="path, as the sensor reads it"
                )
            if n == "h":  # less a straight line: where it begins and how it climbs is not told
                V, alpha, theta = (whole.channels[c] for c in ("V", "alpha", "theta"))
                climb = V * np.sin(theta - alpha)
                steps = np.diff(run.t) * 0.5 * (climb[1:] + climb[:-1])
                h = np.concatenate([[0.0], np.cumsum(steps)])
                h += np.polyval(np.polyfit(run.t, run.channels[n] - h, 1), run.t)
                a.plot(run.t, h, "k--", linewidth=0.8)
            if n in ("alpha", "beta"):
                a.plot(whole.t, whole.channels[n], "k--", linewidth=0.8, label="path")
            a.set_ylabel(f"{n}, {record.units.get(n, 'm')}", fontsize="small")
            a.tick_params(labelsize="x-small")
        axes[-1, column].set_xlabel("time, s", fontsize="small")
    handles, labels = axes[1, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=3, fontsize="small", frameon=False, markerscale=4)
    drawn.align_ylabels()
    return drawn


if __name__ == "__main__":
    main()
