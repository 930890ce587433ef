"""Known answers of equilibria."""
