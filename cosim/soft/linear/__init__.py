"""Sparse symmetric systems: patterns, orderings and factorisations."""
