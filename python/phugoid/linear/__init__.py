"""Linear systems and their modes: identified, fitted, linearised."""
