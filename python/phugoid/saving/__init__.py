"""Files of fits and of other results."""
