"""
A business jet from zero
========================

The longitudinal motion of the HFB-320 Hansa Jet, as in the paper: eleven derivatives, four biases,
seven standard deviations and four initial states, all derivatives from 0. The record is simulated
from the published optimum.
"""

import contextlib
import tempfile
from pathlib import Path

import phugoid as ph
from phugoid.cli import app

# As the command does: phugoid example hfb320
folder = Path(tempfile.mkdtemp())
with contextlib.redirect_stdout(None):
    app(["example", "hfb320", "--out", str(folder)], standalone_mode=False)
model = ph.models.hfb320()
record = ph.read(folder / "hfb320.csv")
other = ph.read(folder / "hfb320_other.csv")

# %%
# The model names its aerodynamic coefficients, so that a diagnosis can name missing terms
# of them:

model

# %%

fit = ph.estimate(model, record)
fit.parameters

# %%

figure, axes = fit.plot()

# %%
# The fit predicts another manoeuvre, with only initial states and biases re-estimated:

check = fit.validate(other, tolerances={"q": 0.006, "alpha": 0.006})
figure, axes = check.plot(channels=["alpha", "q", "az"])
