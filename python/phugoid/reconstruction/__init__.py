"""Flight-path reconstruction: sensors made to agree with kinematics, and the record that follows."""
