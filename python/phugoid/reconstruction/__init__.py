"""Flight-path reconstruction: sensor errors from the kinematic equations, and the corrected record."""
