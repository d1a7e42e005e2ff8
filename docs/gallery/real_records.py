"""
What it says about real records
===============================

Simulated records show that the search finds what was hidden in them. They do not show what it does with records in
which nothing was hidden. Here are measured records of two aircraft in flight, of one on the ground, and of three
laboratory rigs. Each is fitted with a model that lacks something; the diagnosis is computed when this page is built,
and stands beside what other sources say. It is not always right, and for some records the truth is not known.

A verdict is one of these:

- **named**: a cause that is significant by the likelihood, with noise that has the autocorrelation of the residuals,
  and that explains 5 % of the misfit or more in free simulation of data that the fit has not seen. Names in brackets
  are causes that the data do not distinguish from it.
- **minor**: significant, but it explains less than that.
- **surrogate**: it fits, but its value is outside of what is physical, or what it leaves is not noise: the cause may
  be another.
- **unexplained**: the residuals have structure, and no candidate predicts it on other data.
- **nothing**: the residuals are not significantly coloured.

"Explains 90 %" is a part of the misfit held out: of the mean square of the residuals of the model that was diagnosed,
less the part that no model can predict. A finding that explains 30 % leaves most of the misfit open, whatever its
name.

The records are not part of this project. The example ``examples/real_records.py`` says where they come from and how
each is prepared. A record that was not there when this page was built is reported as skipped.
"""

import matplotlib.pyplot as plt
import numpy as np
from real_records import CASES, judged, said  # examples/real_records.py

import phugoid as ph

diagnoses, verdicts = {}, {}


def diagnose(*names: str) -> None:
    """Fit and diagnose records, print what is said of each beside what is known, and draw what the first explains."""
    for name in names:
        case = CASES[name]()
        if case is None:
            verdicts[name] = "skipped: the record was not there when this page was built"
            print(f"{name}: {verdicts[name]}")
            continue
        fit = ph.estimate(case.model, list(case.fitted))
        d = ph.diagnose(fit, validation=list(case.held_out), biases=case.biases)
        diagnoses[name], verdicts[name] = d, f"{d.verdict}; {judged(d, case)}"
        print(f"{name}: {verdicts[name]}")
        for line in [*said(d), f"known: {case.known}"]:
            print(f"    {line}")
    if names[0] in diagnoses:
        diagnoses[names[0]].figures()


# %%
# A vane ahead of the centre of gravity
# -------------------------------------
#
# ATTAS, two elevator manoeuvres, one fitted and one held out (R. V. Jategaonkar, *Flight Vehicle System
# Identification*, 2nd edition, 2015). The model here has the vane of the angle of attack at the centre of gravity. It
# is on a boom 13.08 m ahead of it, and measures :math:`\alpha - 13.08\,q/V`, which at this airspeed is :math:`\alpha`
# less 0.102 s times :math:`q`. A delay of the vane by 0.102 s has almost the same effect, and is the wrong
# answer here.

diagnose("attas")

# %%
# A business jet
# --------------
#
# HFB-320, of the same source: the first 20 s are fitted and the rest is held out, with the eleven constant
# derivatives of the textbook. What that model lacks is not known. Later models of such aircraft have unsteady lift,
# and a downwash that reaches the tail with a delay. The record is open: a name here would be a proposal.

diagnose("hfb320")

# %%
# Two pendulums with dry friction
# -------------------------------
#
# Two rods that swing down to rest, measured by encoders of 2,000 counts (N. Skov, master's thesis, 2019). The model
# has viscous damping alone; large swings are fitted, small ones held out. The bearings have dry friction,
# :math:`f\,\mathrm{sign}(w)`, of 0.18 and 0.54 rad/s² by the author's values; and a rod that swings has some drag of
# the air, :math:`d\,w|w|`. Which value of :math:`f` is right depends on the damping beside it. A polynomial in
# :math:`w` without dry friction is the wrong answer: it can follow the large swings, and fails in the small ones.

diagnose("pendulum1", "pendulum2")

# %%
# A cart on a rail
# ----------------
#
# A relay keeps a cart in a limit cycle about a place on its rail (the same thesis). The model has viscous friction
# alone. The friction depends on the direction and on the place. In one record, with one speed, a friction that
# depends on the direction is the same as a constant force and a symmetric friction, so that ``v':bias`` is right. The
# mean velocity over whole cycles is zero: that force is known from the mean motor current, without any fit. In the
# third of these records it is nearly zero, and no such force is to be named there. Whether the symmetric part is dry
# or viscous one record cannot tell; the diagnosis should not claim it.

diagnose("cart2_08", "cart2_42", "cart3_42")

# %%

if "cart2_08" in diagnoses:
    print("\n".join(diagnoses["cart2_08"].notes))

# %%
# A ball on a beam
# ----------------
#
# A closed loop of the DaISy collection (KU Leuven): the tilt of the beam and the position of the ball. A solid ball
# that rolls on its lowest point has :math:`y'' = 7.0\,\sin u`. Nothing else is known of the rig: what is missing is
# open. The weight of the ball tilts a beam that is not stiff, which would be a term in :math:`y`; the controller
# works at the sampling rate, which would be a delay of about a sample, 0.1 s. Dry friction would be a surprise, for a
# ball rolls.

diagnose("ball")

# %%
# A mounting that slips
# ---------------------
#
# An F-16 on the ground, shaken by a multisine from 2 to 15 Hz (J. P. Noël and M. Schoukens, F-16 aircraft benchmark,
# 2017); the model has six linear modes, in coordinates of their own. The mounting of a payload has clearance and dry
# friction, so that the fifth mode, near 7.3 Hz, falls in frequency with its amplitude. Two periods of the force are
# fitted and one is held out. A resonance that unmeasured disturbances excite would look alike in the residuals, but
# not repeat with the force: a term that simulates most of the misfit of another period is none.
#
# This record takes many minutes and gigabytes, so that it is not computed here but by
# ``python examples/real_records.py f16``. It said in November 2026: named, ``x_5a':hysteresis_x_5b`` (hysteresis, or
# dry friction that yields), 2.2 ± 0.4, explains 71 % (63 to 76 %) of the misfit held out; minor, a lag of the first
# accelerometer, which explains 2 %.

# %%
# All of them
# -----------
#
# "Agrees" and "does not agree" are by the causes that ``examples/real_records.py`` lists as right; "open" where no
# source knows the cause.

for name, text in verdicts.items():
    print(f"{name:10s} {text}")

named = [(f"{name}: {f.cause}", f) for name, d in diagnoses.items() for f in d.findings if f.status == "named"]
figure, axes = plt.subplots(figsize=(7, 1 + 0.35 * max(len(named), 1)), layout="constrained")
if named:
    low, high = zip(*(f.explained_interval for _, f in named), strict=True)
    axes.barh([label for label, _ in named], [100 * f.explained for _, f in named], color="0.8")
    axes.hlines(range(len(named)), 100 * np.array(low), 100 * np.array(high), color="black")
    axes.invert_yaxis()
    axes.set_xlabel("part of the misfit explained in free simulation of data held out, %; interval of 95 %")
else:
    axes.text(0.5, 0.5, "No record was there when this page was built.", ha="center", va="center")
    axes.set_axis_off()
