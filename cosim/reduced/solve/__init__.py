"""Equilibria and implicit time steps of a section model."""
