"""The tables of scenario and robot files."""
