"""Equilibria and implicit time steps of a soft body, and how they depend on the loads."""
