"""Known answers of motions: frequencies, orders of convergence, flight."""
