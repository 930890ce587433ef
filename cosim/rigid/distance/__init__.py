"""Signed distances from points to the scene's shapes."""
