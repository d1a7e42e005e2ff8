"""
What it says about real records
===============================

Simulated records show that the search finds what was hidden in them. They cannot show what it does with records in
which nobody hid anything. Here are eleven measured records, of two aircraft and of three laboratory rigs. Each is fitted
with a model that is known to lack something, or that may; the diagnosis is computed when this page is built, and stands
beside what other sources say. It is not always right, and for some records nobody knows what is right.

A verdict is one of these:

- **named**: a cause that is significant by the likelihood, with noise as coloured as the residuals are, and that
  improves the free simulation of records which the fit has not seen by 5 % of the misfit or more. Names in brackets
  are causes that the data do not tell from it.
- **minor**: significant, but it explains less than that.
- **surrogate**: it fits, but its value is outside of what is physical, or what it leaves is still no noise: something
  else stands behind it.
- **unexplained**: the residuals have structure, and no candidate predicts it on other data.
- **nothing**: the residuals are not significantly coloured.

"Explains 90 %" is the part of the misfit on records held out: the mean square of the residuals of the model that was
diagnosed, less the part that no model can predict. A finding that explains 30 % is a correct hint at best, with most of
the cause still open.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import phugoid as ph

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

from real_records import CASES, judged, said

diagnoses: dict[str, ph.Diagnosis] = {}


def verdict(*names: str) -> None:
    """Fit and diagnose records, and print what is said of each beside what is known."""
    for name in names:
        case = CASES[name]()
        if case is None:
            print(f"{name}: skipped, since the record is not on the machine that built this page.\n")
            continue
        fit = ph.estimate(case.model, list(case.fitted))
        d = ph.diagnose(fit, validation=list(case.held_out), biases=case.biases)
        diagnoses[name] = d
        print(f"{name}: {judged(d, case)}")
        for line in said(d):
            print(f"  {line}")
        print(f"  known: {case.known}\n")


def drawn(name: str) -> None:
    """Draw the misfit that the findings of a record explain."""
    if name in diagnoses:
        diagnoses[name].plot()


# %%
# A vane ahead of the centre of gravity
# -------------------------------------
#
# ATTAS, two elevator manoeuvres, one fitted and one held out (R. V. Jategaonkar, *Flight Vehicle System Identification*,
# 2nd edition, 2015, whose records these are). The model here has the vane of the angle of attack at the centre of
# gravity. It is on a boom 13.08 m ahead of it, so that the vane sees :math:`\\alpha - 13.08\\,q/V`, at this airspeed
# :math:`-0.102\\,\\mathrm{s}\\; q`. A delay of the vane of 0.102 s would look almost the same, and is
# what the search preferred in an earlier version.

verdict("attas")
drawn("attas")

# %%
# A business jet
# --------------
#
# HFB-320, the first 20 s fitted and the rest held out, with the model of the textbook: eleven derivatives, constant over
# the record. What it lacks is not known. Later models of such aircraft have unsteady lift and downwash that arrives late
# at the tail, and the record is known for residuals that no choice of these derivatives removes.

verdict("hfb320")
drawn("hfb320")

# %%
# Two pendulums with dry friction
# -------------------------------
#
# Two rods that swing down to rest, measured by an encoder of 2,000 counts (N. Skov, master's thesis, 2019). The model
# has viscous damping. The bearing has dry friction, :math:`f\\,\\mathrm{sign}(w)`: the author gives 0.18 and
# 0.54 rad/s² beside viscous damping; fits of our own 0.14 to 0.23 and 0.49 to 0.55, depending on what damping stands
# beside it. The swinging rod also has some drag :math:`d\\,w|w|`, of 0.001 to 0.002 and 0.0005 to 0.001 1/rad. A
# polynomial in :math:`w` without dry friction would fit the large swings, with a negative coefficient, and fail in the
# small ones, which are held out.

verdict("pendulum1", "pendulum2")
drawn("pendulum1")

# %%
# A cart on a rail
# ----------------
#
# A relay keeps a cart in a limit cycle about one of three places on its rail, on two occasions (the same thesis). The
# model has viscous friction and no other. The friction differs with the direction: by the mean of the motor current
# over whole cycles, without any fit, a constant force of +0.21, -0.13 and -0.06 m/s² acts at 0.08, 0.42 and 0.60 m on the
# first occasion, and +0.21, 0.00 and +0.04 m/s² on the second. Friction that differs with direction is symmetric
# friction and a constant force; one record in which the speed is always about the same cannot tell these apart,
# nor dry friction from viscous. So ``v':bias`` is right, and a note on the law of friction is too; the fifth of these
# records is the control, in which no such force is to be found.

verdict("cart2_08", "cart2_42", "cart2_60", "cart3_08", "cart3_42", "cart3_60")
drawn("cart2_08")

# %%
# A ball on a beam
# ----------------
#
# A closed loop of the DaISy collection (KU Leuven), of which only the tilt of the beam and the position of the ball are
# known. A solid ball that rolls on its lowest point has :math:`y'' = 7.0\\,\\sin u`; the record does not support that, nor any
# constant gain: fits over longer windows give smaller ones. With :math:`\\kappa y`, :math:`\\kappa` = 0.11 to
# 0.13 1/s², the error of free simulation over held-out windows of 5 s is halved, and the gain no longer depends
# on the window. That the weight of the ball bends or tilts the beam is a guess. What is missing in truth is open; a
# verdict that names the term in :math:`y` agrees with these fits, and dry friction would not.

verdict("ball")
drawn("ball")

# %%
# All of them
# -----------

for name, d in diagnoses.items():
    case = CASES[name]()
    print(f"{name:10s} {d.verdict:12s} {judged(d, case) if case else ''}")
if not diagnoses:
    print("No record was on the machine that built this page: nothing was diagnosed.")
plt.show()
