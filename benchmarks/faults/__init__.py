"""Hostile inputs and faults, seeded; a sample of each runs in the tests."""
