"""Pumps, winches and controllers: their laws and their loop."""
