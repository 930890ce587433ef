"""Joins the parts of a checked scenario into a simulation."""
