"""Runs and their files: `cosim.run`, `cosim.Simulation`, checkpoints, results."""
