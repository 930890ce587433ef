"""Figures of a run, gathered tick by tick, and as they are in its summary."""
