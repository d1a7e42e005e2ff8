"""Which manoeuvre would tell a cause from its rivals."""
