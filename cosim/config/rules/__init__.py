"""Checks of a scenario that take more than one table."""
