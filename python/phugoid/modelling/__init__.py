"""Models: what is declared, equations, and what is late."""
