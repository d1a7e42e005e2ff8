"""ATTAS: two elevator manoeuvres in one fit, each the validation of the other.

The short period of a transport-sized research aircraft from two repeats of an elevator 3-2-1-1 of opposite signs. The
derivatives are shared by both records; what differs from flight to flight, trim and bias of the accelerometer, each
record has of its own (``per_experiment``):

    alpha' = Z0 + Za alpha + q + Zde de      q' = M0 + Ma alpha + Mq q + Mde de      az = V (alpha' - q) + b_az

The vane for the angle of attack is on the nose boom, 13.08 m ahead of the centre of gravity, and sees the air that
rotation adds: K (alpha - 13.08 q/V), with a scale factor K. Without that the fit of alpha is visibly ahead (R^2 0.951
instead of 0.996). Geometry before delay: at 128.5 m/s such a vane reads much like one at the centre of gravity that is
late by 13.08/128.5 = 0.102 s, and with a delay instead of the place the fit finds 0.113 +- 0.005 s, and that the vane
reads too little, K = 0.92 +- 0.01. R^2 is the same to three digits then. What speaks for the place is that it is known,
that no scale factor is left with it (K = 0.997 +- 0.014), nor a delay (0.005 +- 0.004 s), that each record finds it
where it is when it is estimated (13.3 and 13.9 +- 0.7 m), and that on the same samples the log-likelihood of an exact
delay is less by 50 +- 21. (A delay to first order, alpha - tau alpha', fits as well as the place: 12 +- 15 more; K is
0.90 then.) The regression, which takes what the vane reads for the angle of attack at the centre of gravity, cannot see
that: its Mq and Zde are far off. As no output measures alpha itself then, a start with all parameters at 0 may lead
nowhere; the fit without the vane is a good one.

Simplifications. Airspeed is taken as constant (it stays within 2 % of its mean in both records), and with it dynamic
pressure, and weight (fuel changes by 28 kg from the first record to the end of the second); alpha, q and de are small;
the record's motions in roll and sideslip do not enter. A bias of alpha or q could not be told from trim, so there is
none: Z0 and M0 hold both. Z0 also holds gravity, which leaves b_az with -g and the accelerometer's bias. The engines'
and the tailplane's slight motions (0.1 degree) are left out.

Standard errors assume white noise, but residuals of flight records are coloured: the two records differ by up to seven
standard errors. With those corrected for coloured residuals they differ by less than two. The example prints both.

    python examples/attas.py

Uses the real records fAttasElv1.mat and fAttasElv2.mat where it finds them, else simulated twins. Writes out/attas.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from records import find

import phugoid as ph

RECORDS = ("fAttasElv1.mat", "fAttasElv2.mat")
COLUMNS = {"t": 0, "az": 3, "q": 7, "alpha": 12, "de": 21}  # of 45; angles in degrees
V0 = 128.5  # m/s, mean true airspeed of both records
SHARED = ("Za", "Zde", "Ma", "Mq", "Mde")
VANE = ("K",)
BOOM = (13.08, -0.010, -0.027)  # m from the centre of gravity, where both vanes are (the book's programs)
TRIM = ("Z0", "M0", "b_az")
OUTPUTS = ("alpha", "q", "az")

# The twins are made with what the fit of both real records finds, rounded.
TWIN = {"Za": -0.99, "Zde": -0.08, "Ma": -4.93, "Mq": -1.50, "Mde": -7.22, "K": 1.0}
TWIN_SIGMA = {"alpha": 0.0014, "q": 0.0026, "az": 0.23}


def model(vane: bool = True, late: bool = False) -> ph.Model:
    """Short period with trim and bias for each record; with ``late`` the vane has a delay instead of its place."""
    m = ph.Model("ATTAS short period")
    alpha, q = m.states(alpha="rad", q="rad/s")
    (de,) = m.inputs(de="rad")
    units = {"Za": "1/s", "Zde": "1/s", "Ma": "1/s²", "Mq": "1/s", "Mde": "1/s²"}
    Za, Zde, Ma, Mq, Mde = m.parameters(**{n: ph.Parameter(unit=units[n]) for n in SHARED})
    Z0, M0, b_az = m.parameters(
        Z0=ph.Parameter(unit="rad/s", per_experiment=True),
        M0=ph.Parameter(unit="rad/s²", per_experiment=True),
        b_az=ph.Parameter(unit="m/s²", per_experiment=True),
    )
    (Z,) = m.quantities(Z=Z0 + Za * alpha + Zde * de)
    m.dynamics(alpha=Z + q, q=M0 + Ma * alpha + Mq * q + Mde * de)
    seen: ph.Expr = alpha
    if vane:
        (K,) = m.parameters(K=1.0)
        seen = K * alpha if late else K * (alpha - BOOM[0] * q / V0)
    m.outputs(alpha=(seen, "rad"), q=q, az=(V0 * Z + b_az, "m/s²"))
    if late:
        m.sensor_delay(alpha=m.parameters(tau=ph.Parameter(0.05, bounds=(0.0, 1.0), unit="s"))[0])
    return m


def experiment(path: str | Path, name: str) -> ph.Experiment:
    """A record in radians."""
    from scipy.io import loadmat

    (table,) = (v for k, v in loadmat(path).items() if not k.startswith("__"))
    c = {n: np.ascontiguousarray(table[:, k]) for n, k in COLUMNS.items()}
    outputs = {"alpha": np.deg2rad(c["alpha"]), "q": np.deg2rad(c["q"]), "az": c["az"]}
    # The file's stamps carry rounding; the sampling is 25 Hz. At both ends q shows what a filter left there.
    run = ph.Experiment(0.04 * np.arange(c["t"].size), {"de": np.deg2rad(c["de"])}, outputs, name=name)
    return run.window(0.4, 24.6)


def twin(sign: float, name: str, seed: int) -> ph.Experiment:
    """A simulated record of the same shape."""
    t = 0.04 * np.arange(626)
    de = np.full(t.size, 2.2)
    for begin, end, side in ((5.6, 7.6, -1), (7.6, 9.6, 1), (9.6, 11.0, -1), (11.0, 12.0, 1)):
        de[(t >= begin) & (t < end)] += 2.5 * sign * side
    run = ph.Experiment(t, {"de": np.deg2rad(de)}, name=name)
    trim = {"Z0": 0.0445, "M0": 0.495, "b_az": -9.3}
    clean = ph.simulate(model(), TWIN | trim, run, initial={"alpha": 0.0445, "q": 0.003})
    rng = np.random.default_rng(seed)
    return run.with_outputs({n: clean.outputs[n] + s * rng.standard_normal(t.size) for n, s in TWIN_SIGMA.items()})


def records() -> list[ph.Experiment]:
    """Both records, or their twins."""
    paths = [find(name) for name in RECORDS]
    names = ("first", "second")
    if all(paths):
        return [experiment(path, name) for path, name in zip(paths, names, strict=True) if path]
    return [twin(sign, name, seed) for seed, (sign, name) in enumerate(zip((1.0, -1.0), names, strict=True))]


def estimate(runs: ph.Experiment | list[ph.Experiment]) -> ph.Fit:
    """All parameters, first without the vane."""
    return ph.estimate(model(), runs, start=ph.estimate(model(vane=False), runs))


def validate(fit: ph.Fit, run: ph.Experiment) -> ph.results.Validation:
    """The derivatives of a fit on another record: only trim, bias and the initial states are re-estimated."""
    return fit.validate(run, biases=TRIM)


def main() -> None:
    """Fits each record and both, validates, prints tables, and writes the figure."""
    runs = records()
    alone = [estimate(run) for run in runs]
    both = estimate(runs)
    regression = ph.equation_error(model(vane=False), runs)
    print(both.summary())
    late = ph.estimate(model(late=True), runs, start=ph.estimate(model(vane=False), runs))
    found = {n: late.robust().parameters[n] for n in ("tau", "K")}
    print(f"\nwith a delay instead of the place of the vane: {', '.join(map(repr, found.values()))}")

    print(f"\n{'':5s}{'first record':>20s}{'second record':>20s}{'both':>20s}{'regression':>12s}   second - first")
    for n in (*SHARED, *VANE):
        first, second, joint = (fit.parameters[n] for fit in (*alone, both))
        texts = "".join(f"{e.value:11.4f} ± {e.std_error:6.4f}" for e in (first, second, joint))
        plain, coloured = (
            (second.value - first.value) / np.hypot(*(fit.parameters[n].std_error for fit in fits))
            for fits in (alone, [fit.robust() for fit in alone])
        )
        by_regression = f"{regression.parameters[n].value:12.4f}" if n in SHARED else " " * 12
        print(f"{n:5s}{texts}{by_regression}{plain:+8.1f} std errors, {coloured:+.1f} coloured")

    checks = [validate(alone[1], runs[0]), validate(alone[0], runs[1])]
    # Theil's coefficient about the mean: an offset such as gravity would make any model look right.
    print("\nvalidation: derivatives of the other record (own fit)")
    for own, check in zip(alone, checks, strict=True):
        for n, m in check.matches.items():
            at_best = ph.match(own.records, n)
            print(
                f"{own.records[0].name:8s}{n:6s} RMS {m.rms:8.5f} ({at_best.rms:8.5f}) {m.unit:6s} "
                f"Theil {m.theil_about_mean:.3f} ({at_best.theil_about_mean:.3f})"
            )

    out = Path("out")
    out.mkdir(exist_ok=True)
    figure(checks, both).savefig(out / "attas.png", dpi=150)
    print(f"\nWritten: {out / 'attas.png'}")


def figure(checks: list[ph.results.Validation], both: ph.Fit):  # type: ignore[no-untyped-def]
    """Measurements, the fit of both records, and the prediction from the other one."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    drawn, axes = plt.subplots(4, 2, figsize=(9.0, 7.5), sharex=True, sharey="row", layout="constrained")
    for column, (check, record) in enumerate(zip(checks, both.records, strict=True)):
        axes[0, column].set_title(f"{record.name} record", fontsize="medium")
        for row, n in enumerate(OUTPUTS):
            a = axes[row, column]
            a.plot(record.t, record.measured[n], ".", color="#0072B2", markersize=1.5, label="measured")
            a.plot(record.t, record.outputs[n], color="#D55E00", linewidth=1.0, label="fit of both records")
            a.plot(record.t, check.records[0].outputs[n], "k--", linewidth=0.8, label="derivatives of the other record")
            axes[row, 0].set_ylabel(f"{n}, {record.units[n]}")
        axes[3, column].plot(record.t, record.inputs["de"], "k", linewidth=0.8)
        axes[3, column].set_xlabel("time, s")
    axes[3, 0].set_ylabel("de, rad")
    axes[0, 0].legend(fontsize="x-small", frameon=False)
    return drawn


if __name__ == "__main__":
    main()
