"""Loads and flange poses that bring the tip of a soft body to a target."""
