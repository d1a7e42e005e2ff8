"""How fine must the mesh be? Integration error and mesh refinement on the HFB-320 record.

The trapezoid at the sample times (order 2) is the usual choice. A linear system with eigenvalue s, sampled every h
seconds, is to the trapezoid one with eigenvalue (2/h) tanh(s h/2), about s - s^3 h^2/12: fitted to the same data, it
must find that one. The short period of this aircraft, s = -0.90 + 1.90 j 1/s at h = 0.1 s, is moved by 0.8 % in
damping, which the estimator can do with the pitch damping Cmq (1.3 %), the elevator's Cmde (0.6 %) and Cma (0.5 %).
All are within the standard errors, but they are an error of method, which no longer record averages out. Halving the
step divides it by four; one more point a segment does more.

    python examples/mesh_refinement.py

Uses the real record hfb320_1_10.asc where it finds it, else a simulated twin. Writes out/mesh_refinement.png.
"""

from __future__ import annotations

from pathlib import Path

import hfb320
import numpy as np
from records import find

import phugoid as ph

SHOWN = ("Cma", "Cmq", "Cmde")


def short_period(fit: ph.Fit) -> complex:
    """Eigenvalue of the fastest oscillation of the model linearised about the mean states, 1/s."""
    model, record = fit.model, fit.records[0]
    point = fit.parameters.to_dict() | {n: float(x.mean()) for n, x in record.states.items()}
    point |= {n: float(u.mean()) for n, u in record.inputs.items()}
    equations = dict(model.equations)
    known: dict[str, ph.Expr] = {}
    for name in [n for n in equations if not n.endswith("'") and not n.startswith("y:")]:
        known[name] = equations[name].substitute(known)
    rows = []
    for state in model.state_names:
        slope = equations[f"{state}'"].substitute(known)
        derivatives = [slope.diff(other) for other in model.state_names]
        rows.append([d.evaluate({n: point[n] for n in d.symbols}) for d in derivatives])
    values = np.linalg.eigvals(np.array(rows))
    return complex(values[np.argmax(values.imag)])


def trapezoidal(s: complex, h: float) -> complex:
    """The eigenvalue that the trapezoid of step h must have to decay and turn as ``s`` does from step to step."""
    return complex(2.0 / h * np.tanh(s * h / 2.0))


def main() -> None:
    """Fits on several meshes, prints what they do to the estimates, refines, and draws both."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    path = find(hfb320.RECORD)
    data = hfb320.experiment(path) if path else hfb320.twin()
    model = hfb320.model()
    exact = ph.estimate(model, data, transcription=ph.Collocation(order=6))

    steps = (1, 2, 4, 8)
    trapezoid = [ph.estimate(model, data, transcription=ph.Collocation(order=2, substeps=n)) for n in steps]
    higher = {m: ph.estimate(model, data, transcription=ph.Collocation(order=m)) for m in (3, 4)}
    labelled = [(f"order 2, {n} a sample interval", f) for n, f in zip(steps, trapezoid, strict=True)]
    labelled += [(f"order {m}", f) for m, f in higher.items()]
    names = "".join(f"{n:>11s}" for n in SHOWN)
    print(f"{'difference from order 6, %':34s}{names}   error of a segment / noise")
    for label, fit in labelled:
        off = [100 * (fit.parameters[n].value / exact.parameters[n].value - 1) for n in SHOWN]
        (error,) = fit.integration_error()
        print(f"{label:34s}" + "".join(f"{x:+11.5f}" for x in off) + f"   {error.worst.max():.1e}")

    s, h = short_period(exact), float(np.median(np.diff(data.t)))
    print(f"\nshort period, 1/s: {s:.4f}; found by the trapezoid {short_period(trapezoid[0]):.4f}, ", end="")
    print(f"expected of it {trapezoidal(s, h):.4f}\n")

    refined = ph.estimate(model, data, transcription=ph.Collocation(order=2, refine=True))
    assert refined.refinement is not None
    print(refined.refinement.summary())

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    for label, fit in (("trapezoid", trapezoid[0]), ("order 3", higher[3]), ("order 4", higher[4])):
        (error,) = fit.integration_error()
        left.stairs(np.maximum(error.worst, 1e-12), error.edges, label=label, linewidth=0.8, baseline=None)
    left.axhline(1e-4, color="0.3", linestyle="--", linewidth=0.8, label="tolerance")
    left.set(yscale="log", xlabel="time, s", ylabel="error of a segment / noise", ylim=(1e-11, 1.0))
    left.legend(fontsize="small", frameon=False, ncols=2)
    for name in SHOWN:
        sizes = [abs(f.parameters[name].value / exact.parameters[name].value - 1) for f in trapezoid]
        right.loglog([h / n for n in steps], sizes, "o-", markersize=3, label=name)
    right.set_xticks([h / n for n in steps], [f"{h / n:g}" for n in steps])
    right.minorticks_off()
    right.set(xlabel="step of the trapezoid, s", ylabel="relative error of the estimate")
    right.legend(fontsize="small", frameon=False)
    out = Path("out")
    out.mkdir(exist_ok=True)
    figure.savefig(out / "mesh_refinement.png", dpi=150)
    print(f"\nWritten: {out / 'mesh_refinement.png'}")


if __name__ == "__main__":
    main()
