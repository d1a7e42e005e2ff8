"""Many starts, and tasks on any executor."""
